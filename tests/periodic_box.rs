//! Scenes of fixed particles in a periodic box without shapes, at the command line.

use super::support::program::{hydrograd, refused, succeeds};
use hydrograd::io::npy::read_npy;
use hydrograd::sph::lattice::transform::resampled;
use std::f64::consts::TAU;
use std::path::Path;

/// Vortices that a stream carries along, and warm fluid that rises.
const SCENE: &str = r#"
scene = "custom"
method = { name = "fixed", flow = "unsteady" }
region = { size = [1.0, 1.5], periodic = [true, true], acceleration = [0.0, -0.5] }
fluid = { viscosity = 0.01, expansion = 0.5, reference_temperature = 1.0, inlet_temperature = 0.5 }
resolution = { dx = 0.125 }
initial = { velocity = ["0.3 + sin(2*PI*x)*cos(4*PI*y/3)", "0.2*cos(2*PI*x)"], temperature = "1 + 0.2*sin(2*PI*x)" }
time = { end = 0.5 }
output = { frames = 2, grid = [4, 12] }
"#;

fn write(folder: &Path, text: &str) {
    std::fs::write(folder.join("box.toml"), text).unwrap();
}

/// A `.npy` file of numbers in eight bytes.
pub fn write_npy(path: &Path, shape: &str, values: &[f64]) {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    header.push_str(&" ".repeat(63 - (10 + header.len()) % 64));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
    std::fs::write(path, bytes).unwrap();
}

pub fn dataset(path: &Path, name: &str) -> (Vec<usize>, Vec<f64>) {
    let dataset = hdf5::File::open(path).unwrap().dataset(name).unwrap();
    (dataset.shape(), dataset.read_raw().unwrap())
}

#[test]
fn a_flow_is_written_for_everybody() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(at, SCENE);
    let said = succeeds(at, &["simulate", "box.toml", "--out", "one"]);
    assert!(said.contains("96 fixed particles") && said.contains("grid.vti"), "{said}");
    for file in ["report.html", "history.csv", "flow.png", "temperature.png", "particles/particles.pvd", "grid.vti"] {
        assert!(at.join("one").join(file).is_file(), "{file}");
    }
    // The grid has the particles' own numbers where it meets them.
    let (shape, velocity) = dataset(&at.join("one/grid.h5"), "velocity");
    assert_eq!(shape, [4, 12, 2]);
    let (_, particles) = dataset(&at.join("one/state.h5"), "velocity");
    for (i, j) in [(0, 0), (1, 5), (3, 11)] {
        for a in 0..2 {
            let own = particles[(2 * i * 12 + j) * 2 + a];
            assert!((velocity[(i * 12 + j) * 2 + a] - own).abs() < 1e-13, "{i} {j} {a}");
        }
    }
    assert_eq!(dataset(&at.join("one/grid.h5"), "temperature").0, [4, 12]);
    // Results do not depend on the number of threads.
    write(at, &SCENE.replace("dx = 0.125", "dx = 0.0078125").replace("end = 0.5", "end = 0.02"));
    for threads in ["1", "2"] {
        succeeds(at, &["simulate", "box.toml", "--out", threads, "--threads", threads]);
    }
    let [one, two] = ["1", "2"].map(|threads| dataset(&at.join(threads).join("state.h5"), "velocity").1);
    assert!(one == two && one.len() == 2 * 128 * 192);
}

#[test]
fn a_field_of_a_file_is_a_formulas_field() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(at, SCENE);
    succeeds(at, &["simulate", "box.toml", "--out", "formula"]);
    let velocity: Vec<f64> = (0..96)
        .flat_map(|i| {
            let (x, y) = ((i / 12) as f64 * 0.125, (i % 12) as f64 * 0.125);
            [0.3 + (TAU * x).sin() * (2.0 * TAU * y / 3.0).cos(), 0.2 * (TAU * x).cos()]
        })
        .collect();
    write_npy(&at.join("start.npy"), "(8, 12, 2)", &velocity);
    assert_eq!(read_npy(&at.join("start.npy")).unwrap(), (vec![8, 12, 2], velocity.clone()));
    let file = ["--set", "initial.velocity=[]", "--set", "initial.file=start.npy"];
    succeeds(at, &[&["simulate", "box.toml", "--out", "npy"], &file[..]].concat());
    // What a run has written is read again.
    let grid = ["--set", "output.grid=[8,12]", "--set", "time.end=1e-9", "--set", "time.step=1e-9"];
    succeeds(at, &[&["simulate", "box.toml", "--out", "grid"], &grid[..]].concat());
    let file = ["--set", "initial.velocity=[]", "--set", "initial.file=grid/grid.h5"];
    succeeds(at, &[&["simulate", "box.toml", "--out", "hdf5"], &file[..]].concat());
    let of = |run: &str| dataset(&at.join(run).join("state.h5"), "velocity").1;
    let worst = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
    assert!(worst(&of("formula"), &of("npy")) < 1e-12 && worst(&of("formula"), &of("hdf5")) < 1e-7);
}

#[test]
fn its_gradient_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(at, SCENE);
    let said = succeeds(at, &["check-gradient", "box.toml", "--out", "checked"]);
    assert!(said.contains("PASSED") && said.contains("acceleration"), "{said}");
    let text = std::fs::read_to_string(at.join("checked/gradient_check.json")).unwrap();
    let found: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(found["worst_relative_error"].as_f64().unwrap() < 1e-8 && found["gradient_norm"].as_f64().unwrap() > 1e-3);
    // In three dimensions, by fits.
    let sets = [
        "region.size=[1.0,0.75,0.875]",
        "region.periodic=[true,true,true]",
        "region.acceleration=[0.1,0.0,-0.5]",
        "initial.velocity=['sin(2*PI*x)','cos(2*PI*x)',0.2]",
        "initial.temperature=1 + 0.2*sin(2*PI*x)",
        "method.derivatives=fits",
        "output.grid=[4,4,4]",
        "time.end=0.2",
    ];
    let mut arguments = vec!["check-gradient", "box.toml", "--out", "three"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    assert!(succeeds(at, &arguments).contains("336 fixed particles"));
    (arguments[0], arguments[3]) = ("simulate", "flow");
    succeeds(at, &arguments);
    assert_eq!(dataset(&at.join("flow/grid.h5"), "velocity").0, [4, 4, 4, 3]);
}

#[test]
fn what_cannot_be_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write(at, SCENE);
    write_npy(&at.join("small.npy"), "(8, 8, 2)", &[0.0; 128]);
    write_npy(&at.join("nan.npy"), "(8, 12, 2)", &[f64::NAN; 192]);
    std::fs::write(at.join("cut.npy"), &std::fs::read(at.join("small.npy")).unwrap()[..200]).unwrap();
    let refuse = |sets: &[&str], expected: &[&str]| {
        let mut arguments = vec!["simulate", "box.toml", "--out", "out"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        refused(&arguments, &hydrograd(at, &arguments), expected);
        assert!(!at.join("out/summary.json").exists());
    };
    let none = "initial.velocity=[]";
    refuse(&[none, "initial.file=small.npy"], &["small.npy", "[8, 8, 2]", "[8, 12, 2]"]);
    refuse(&[none, "initial.file=nan.npy"], &["initial.file", "finite"]);
    refuse(&[none, "initial.file=cut.npy"], &["cut.npy", "numpy.save"]);
    refuse(&[none, "initial.file=none.npy"], &["none.npy"]);
    refuse(&["initial.file=small.npy"], &["initial.file", "initial.velocity", "one of both"]);
    refuse(&["output.grid=[4]"], &["output.grid", "2 whole numbers"]);
    refuse(&["output.grid=[0,4]"], &["output.grid", "1 ... 4096"]);
    refuse(&["region.periodic=[true,false]", none, "initial.file=nan.npy"], &["initial.file", "finite"]);
    refuse(&["method.name=consistent"], &["method.flow", "method.name=fixed"]);
    refuse(&["method.derivatives=guesses"], &["derivatives", "fits"]);
    refuse(&["resolution.dx=0.11"], &["resolution.dx", "divide"]);
    refuse(&["initial.velocity=['1/x',0]"], &["initial.velocity[0]", "finite"]);
    refuse(&["fluid.drive=flow-rate", "fluid.flow_rate=1.0"], &["fluid.drive"]);
}

#[test]
fn flow_around_a_body_is_written_on_a_grid() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Between walls without a body the flow is a parabola, which fits have exactly.
    let channel = r#"
scene = "custom"
method.name = "fixed"
region = { size = [1.0, 0.5], acceleration = [0.64, 0.0] }
fluid = { viscosity = 0.02 }
resolution = { dx = 0.05 }
output = { grid = [5, 20], frames = 0 }
"#;
    write(at, channel);
    succeeds(at, &["simulate", "box.toml", "--out", "channel"]);
    let (shape, velocity) = dataset(&at.join("channel/grid.h5"), "velocity");
    assert_eq!(shape, [5, 20, 2]);
    for k in 0..100 {
        let y = 0.5 * (k % 20) as f64 / 20.0;
        let exact = 16.0 * y * (0.5 - y);
        assert!((velocity[2 * k] - exact).abs() < 1e-6 && velocity[2 * k + 1].abs() < 1e-6, "{k}: {}", velocity[2 * k]);
    }
    // Inside of a body there is nothing.
    write(at, &format!("{channel}[[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.25]\nradius = 0.1\n"));
    succeeds(at, &["simulate", "box.toml", "--out", "disc", "--set", "output.grid=[20,20]"]);
    let (_, pressure) = dataset(&at.join("disc/grid.h5"), "pressure");
    for (k, pressure) in pressure.iter().enumerate() {
        let away = ((k / 20) as f64 / 20.0 - 0.5).hypot(0.5 * (k % 20) as f64 / 20.0 - 0.25);
        // Points on the surface belong to neither side.
        if (away - 0.1).abs() > 1e-3 {
            assert_eq!(pressure.is_nan(), away < 0.1, "{k}: {away}");
        }
    }
}

#[test]
fn values_between_particles_are_those_of_the_modes() {
    let of = |x: f64, y: f64| 0.3 + (TAU * x).sin() * (2.0 * TAU * y).cos() + 0.2 * (3.0 * TAU * y).sin();
    for (shape, other) in [([9, 8], [4, 20]), ([7, 7], [7, 14]), ([16, 12], [5, 5])] {
        let on = |shape: [usize; 2]| -> Vec<f64> {
            let place = |i: usize| ((i / shape[1]) as f64 / shape[0] as f64, (i % shape[1]) as f64 / shape[1] as f64);
            (0..shape[0] * shape[1]).map(|i| of(place(i).0, place(i).1)).collect()
        };
        let (found, exact) = (resampled(&on(shape), &shape, &other), on(other));
        for (found, exact) in found.iter().zip(&exact) {
            assert!((found - exact).abs() < 1e-13, "{shape:?} {other:?}: {found} and {exact}");
        }
    }
}
