//! Fields on grids, `output.grid` and `initial.file`, of moving particles and around shapes.

use super::periodic_box::{dataset, write_npy};
use super::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::Config;
use hydrograd::numerics::grid_field::Grid;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::Of;
use hydrograd::scene::start_field;
use std::f64::consts::{PI, TAU};
use std::path::Path;

/// Moving particles in disorder between two walls, in their first moment: fields are those of the formulas.
const FIRST: &str = r#"
scene = "custom"
region = { size = [1.0, 0.5], acceleration = [0.64, 0.0] }
fluid = { viscosity = 0.02, conductivity = 0.02, inlet_temperature = 0.5 }
resolution = { dx = 0.05 }
initial = { velocity = ["16*y*(0.5 - y)", 0], temperature = "1 + 2*y*y" }
shapes = [{ kind = "box", lower = [0.0, 0.5], upper = [1.0, 1.0], temperature = 1.5 }]
time = { end = 1e-9, step = 1e-9, jitter = 0.2 }
output = { grid = [7, 20], frames = 0 }
"#;

fn simulate(folder: &Path, text: &str, sets: &[&str]) -> String {
    std::fs::write(folder.join("scene.toml"), text).unwrap();
    let mut arguments = vec!["simulate", "scene.toml", "--out", "run"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    succeeds(folder, &arguments)
}

fn field(folder: &Path, name: &str) -> (Vec<usize>, Vec<f64>) {
    dataset(&folder.join("run/grid.h5"), name)
}

#[test]
fn quadratic_fields_of_moving_particles_are_exact() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let said = simulate(at, FIRST, &[]);
    assert!(said.contains("grid.h5, grid.vti") && at.join("run/grid.vti").is_file(), "{said}");
    let (shape, velocity) = field(at, "velocity");
    assert_eq!(shape, [7, 20, 2]);
    let (_, temperature) = field(at, "temperature");
    for k in 0..140 {
        let y = 0.5 * (k % 20) as f64 / 20.0;
        // A step of 1e-9 changes velocities of 1 by about as much.
        assert!((velocity[2 * k] - 16.0 * y * (0.5 - y)).abs() < 1e-7 && velocity[2 * k + 1].abs() < 1e-7, "{k}");
        assert!((temperature[k] - 1.0 - 2.0 * y * y).abs() < 1e-7, "{k}: {}", temperature[k]);
    }
    // In space, where no walls are along z.
    let sets = [
        "region.size=[0.6,0.5,0.6]",
        "region.periodic=[true,false,true]",
        "region.acceleration=[0.64,0.0,0.0]",
        "initial.velocity=['16*y*(0.5 - y)',0,0]",
        "output.grid=[3,9,5]",
        "shapes=[{kind='box',lower=[0.0,0.5,0.0],upper=[0.6,1.0,0.6],temperature=1.5}]",
    ];
    simulate(at, FIRST, &sets);
    let (shape, velocity) = field(at, "velocity");
    assert_eq!(shape, [3, 9, 5, 3]);
    for (k, u) in velocity.chunks_exact(3).enumerate() {
        let y = 0.5 * (k / 5 % 9) as f64 / 9.0;
        assert!((u[0] - 16.0 * y * (0.5 - y)).abs() < 1e-7 && u[1].abs() + u[2].abs() < 1e-7, "{k}: {u:?}");
    }
}

#[test]
fn decaying_vortices_on_a_grid_are_as_right_as_their_particles() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/scenes/exact/vortices.toml");
    let text = std::fs::read_to_string(scene).unwrap();
    simulate(at, &text, &["resolution.dx=0.04", "time.end=0.2", "output.grid=[9,16]", "output.frames=0"]);
    let text = std::fs::read_to_string(at.join("run/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let of_particles = summary["velocity_error"].as_f64().unwrap();
    let (_, velocity) = field(at, "velocity");
    let decay = (-0.08 * PI * PI * 0.2f64).exp();
    let mut square = 0.0;
    for (k, u) in velocity.chunks_exact(2).enumerate() {
        let (x, y) = (TAU * (k / 16) as f64 / 9.0, TAU * (k % 16) as f64 / 16.0);
        let exact = [-decay * x.cos() * y.sin(), decay * x.sin() * y.cos()];
        square += (u[0] - exact[0]).powi(2) + (u[1] - exact[1]).powi(2);
    }
    let on_grid = (square / 144.0).sqrt();
    // What the polynomial of second order leaves: (2 pi)^3 r^3 / 6 with r up to 0.6 spacings, 6e-4, and the particles' own.
    println!("{of_particles:.2e} of particles, {on_grid:.2e} on the grid");
    assert!(on_grid < of_particles + 6e-4, "{of_particles} and {on_grid}");
}

#[test]
fn there_is_nothing_inside_of_walls() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let disc = "[[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.25]\nradius = 0.12\n";
    let text = FIRST.lines().filter(|line| !line.starts_with("shapes")).collect::<Vec<_>>().join("\n") + "\n" + disc;
    for method in ["consistent", "standard"] {
        simulate(
            at,
            &text,
            &["output.grid=[20,20]", &format!("method.name={method}"), "time.end=0.01", "time.step=0.001"],
        );
        for (name, width) in [("velocity", 2), ("pressure", 1), ("temperature", 1)] {
            let (_, values) = field(at, name);
            for (k, value) in values.iter().enumerate() {
                let point = k / width;
                let away = ((point / 20) as f64 / 20.0 - 0.5).hypot(0.5 * (point % 20) as f64 / 20.0 - 0.25);
                // Points on the surface belong to neither side.
                if (away - 0.12).abs() > 1e-6 {
                    assert_eq!(value.is_nan(), away < 0.12, "{method} {name} {k}: {away}");
                }
            }
        }
    }
    let arguments = ["simulate", "scene.toml", "--out", "out", "--set", "output.grid=[20]"];
    refused(&arguments, &hydrograd(at, &arguments), &["output.grid", "2 whole numbers"]);
}

#[test]
fn cubic_fields_between_points_are_exact() {
    let grid = Grid { shape: [8, 5], size: [2.0, 1.0], periodic: [true, false] };
    let cubic = |y: f64| 1.0 - y + 3.0 * y * y * y;
    let field: Vec<f64> = (0..40).map(|k| cubic((k % 5) as f64 / 5.0)).collect();
    for y in [0.0, 0.13, 0.5, 0.81, 1.0] {
        assert!((grid.value(&field, [1.97, y]) - cubic(y)).abs() < 1e-12, "{y}");
    }
    // A wave of 64 points, across its ends.
    let grid = Grid { shape: [64, 4], size: [1.0, 1.0], periodic: [true, true] };
    let wave: Vec<f64> = (0..256).map(|k| (TAU * (k / 4) as f64 / 64.0).sin()).collect();
    for x in [0.0, 0.004, 0.51, 0.999] {
        assert!((grid.value(&wave, [x, 0.3]) - (TAU * x).sin()).abs() < 3e-6, "{x}");
    }
}

/// A disc that turns in a periodic stream, whose height and speed of turning may change.
const AROUND: &str = r#"
scene = "custom"
method = { name = "fixed", flow = "unsteady" }
region = { size = [1.0, 0.6] }
fluid = { viscosity = 0.02 }
resolution = { dx = 0.08, surface = 0.04 }
time = { end = 0.2, step = 0.02 }
output = { grid = [6, 7], frames = 0 }
objective = { kind = "drag", shapes = [0] }
variables = [
    { number = "shapes[0].centre[1]", lower = 0.2, upper = 0.4 },
    { number = "shapes[0].parameters[0]", lower = -2.0, upper = 2.0 },
]
[[shapes]]
kind = "disc"
centre = [0.5, 0.31]
radius = 0.12
velocity = ["p0*(0.31 - y)", "p0*(x - 0.5)"]
parameters = [0.5]
"#;

#[test]
fn a_flow_around_a_shape_begins_with_a_field() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let steady = AROUND
        .replace("\"unsteady\"", "\"steady\"")
        .replace("size = [1.0, 0.6]", "size = [1.0, 0.6], acceleration = [0.5, 0.0]");
    let load = |name: &str, text: &str| -> Config {
        std::fs::write(at.join(name), text).unwrap();
        Config::load(at.join(name).to_str(), None, &[]).unwrap().config
    };
    let (config, steady) = (load("time.toml", AROUND), load("steady.toml", &steady));
    let shape = [8, 9];
    let place = |k: usize| ((k / 9) as f64 / 8.0, (k % 9) as f64 / 9.0);
    let field = |e: usize| -> Vec<f64> {
        (0..72)
            .map(|k| {
                let (x, y) = place(k);
                [0.8 + 0.3 * (TAU * x).sin(), 0.2 * (TAU * (x + y)).cos()][e]
            })
            .collect()
    };
    let start = start_field::on_grid(&config, "start", shape, [field(0), field(1)]).unwrap();
    let mut around = AroundShapes::new(&config).unwrap();
    around.start = Some(start.clone());
    let first = around.first();
    let (history, last) = around.march(&first, None, &mut |_, _| Ok(())).unwrap();
    let on_grid = around.velocity_on_grid(&last).unwrap();
    let weights: Vec<f64> = (0..on_grid.len()).map(|k| (12.9898 * (k + 1) as f64).sin()).collect();
    let sum = |on_grid: &[f64]| -> f64 {
        on_grid.iter().zip(&weights).filter(|(u, _)| !u.is_nan()).map(|(u, w)| u * w).sum()
    };
    let found = around.march_gradient(&first, &history, Of::Grid(&weights)).unwrap();
    let by_start = found.by_start.unwrap();
    let mut value = |moved: &[f64], step: f64| {
        // Along another field.
        let mut moved_start = start.clone();
        for (e, field) in moved_start.velocity.iter_mut().enumerate() {
            field.iter_mut().enumerate().for_each(|(k, u)| *u += step * (0.7 * (2 * k + e) as f64).cos());
        }
        around.start = Some(moved_start);
        let (_, last) = around.march(moved, Some(&history.sizes), &mut |_, _| Ok(())).unwrap();
        sum(&around.velocity_on_grid(&last).unwrap())
    };
    let close = |exact: f64, difference: f64| {
        println!("{exact} and {difference}");
        // Differences of second order with a step of 1e-4.
        assert!((exact - difference).abs() < 1e-5 * exact.abs().max(1.0), "{exact} and {difference}");
    };
    let along: f64 = by_start.iter().enumerate().map(|(k, by)| by * (0.7 * k as f64).cos()).sum();
    close(along, (value(&first, 1e-4) - value(&first, -1e-4)) / 2e-4);
    for k in 0..2 {
        let mut at = |step: f64| {
            let mut moved = first.clone();
            moved[k] += step;
            value(&moved, 0.0)
        };
        let step = [1e-5, 1e-4][k];
        close(found.by_variables[k], (at(step) - at(-step)) / (2.0 * step));
    }
    // The drag's derivative by the field, too.
    let by_start = around.march_gradient(&first, &history, Of::Objective).unwrap().by_start.unwrap();
    assert!(by_start.iter().any(|by| by.abs() > 1e-6));
    // Of the steady flow.
    let mut around = AroundShapes::new(&steady).unwrap();
    let solution = around.solve(&first).unwrap();
    let exact = around.grid_gradient(&solution, &weights).unwrap().by_variables;
    for k in 0..2 {
        let mut at = |step: f64| {
            let mut moved = first.clone();
            moved[k] += step;
            let solution = around.solve(&moved).unwrap();
            sum(&around.velocity_on_grid(&solution).unwrap())
        };
        let step = [1e-5, 1e-4][k];
        close(exact[k], (at(step) - at(-step)) / (2.0 * step));
    }
    // The same by a file, at the command line: the field of a formula.
    let uniform: Vec<f64> = (0..72).flat_map(|_| [0.8, 0.0]).collect();
    write_npy(&at.join("start.npy"), "(8, 9, 2)", &uniform);
    for (out, start) in [("file", "initial.file=start.npy"), ("formula", "initial.velocity=[0.8,0]")] {
        succeeds(at, &["simulate", "time.toml", "--out", out, "--set", start]);
    }
    let [file, formula] = ["file", "formula"].map(|run| dataset(&at.join(run).join("grid.h5"), "velocity").1);
    assert!(file.iter().zip(&formula).all(|(a, b)| (a - b).abs() < 1e-11 || a.is_nan() && b.is_nan()));
    write_npy(&at.join("small.npy"), "(8, 3, 2)", &[0.0; 48]);
    write_npy(&at.join("flat.npy"), "(144)", &uniform);
    for (file, expected) in
        [("small.npy", ["initial.file", "4 points or more"]), ("flat.npy", ["flat.npy", "[N, N, 2]"])]
    {
        let file = format!("initial.file={file}");
        let arguments = ["simulate", "time.toml", "--out", "out", "--set", &file];
        refused(&arguments, &hydrograd(at, &arguments), &expected);
    }
}
