//! Fixed particles in time whose pressure follows from a speed of sound (`method.pressure = "weakly-compressible"`).

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::Config;
use hydrograd::scene::around_bodies::AroundBodies;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_in_time::Marching;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::{History, Of};
use std::fs;
use tempfile::TempDir;

const METHOD: &str =
    "scene = \"custom\"\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\nmethod.pressure = \"weakly-compressible\"\n";

fn config(text: &str, set: &[&str]) -> Config {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let set: Vec<String> = set.iter().map(|set| set.to_string()).collect();
    fs::write(&file, format!("{METHOD}{text}")).unwrap();
    Config::load(Some(file.to_str().unwrap()), None, &set).unwrap_or_else(|error| panic!("{error}")).config
}

/// A warm disc that turns back and forth in a stream that pulsates under a wall with a given heat flux, with buoyancy.
const WARM: &str =
    "region.size = [5.0, 3.0]\nfluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.reference_velocity = 1.5\n\
    fluid.expansion = 0.2\nregion.acceleration = [0.0, -1.0]\ninitial.velocity = [1, 0]\ninitial.temperature = \"0\"\n\
    resolution.dx = 0.2\n\
    region.sides.left = { kind = \"inflow\", velocity = [\"1 + 0.1*sin(3*t)\", 0], temperature = \"0\" }\n\
    region.sides.right = { kind = \"outflow\" }\nregion.sides.bottom = { kind = \"symmetry\" }\n\
    region.sides.top = { kind = \"wall\", heat_flux = \"0.1\" }\n";
const DISC: &str =
    "[[shapes]]\nkind = \"disc\"\ncentre = [1.6, 1.4]\nradius = 0.5\nparameters = [0.5]\ntemperature = 1\n\
    velocity = [\"0 - p0*cos(t)*(y - 1.4)\", \"p0*cos(t)*(x - 1.6)\"]\n";

/// A ball that turns in a duct.
const DUCT: &str =
    "region.size = [1.6, 1.0, 1.0]\nregion.periodic = [false, false, false]\nregion.acceleration = [0.0, 0.0, 0.0]\n\
    fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.reference_velocity = 1.0\nresolution.dx = 0.125\n\
    initial.velocity = [\"16*y*(1-y)*z*(1-z)\", \"0*x\", \"0*x\"]\ninitial.temperature = \"0\"\n\
    region.sides.left = { kind = \"inflow\", velocity = [\"16*y*(1-y)*z*(1-z)\", 0, 0], temperature = \"0\" }\n\
    region.sides.right = { kind = \"outflow\" }\n";
const BALL: &str =
    "[[shapes]]\nkind = \"disc\"\ncentre = [0.6, 0.5, 0.5]\nradius = 0.25\nparameters = [0.5]\ntemperature = 1\n\
    velocity = [\"0 - p0*cos(t)*(y - 0.5)\", \"p0*cos(t)*(x - 0.6)\", 0]\n";

fn last(history: &History, name: &str) -> f64 {
    let k = history.figures.iter().position(|(own, _)| own == name).unwrap();
    history.moments[history.moments.len() - 1].values[k]
}

/// Vortices of Taylor and Green between sides where the fluid slips decay as exp(-2 nu t), and turn without changing their shape.
#[test]
fn vortices_decay_as_they_must() {
    let sides: String = ["left", "right", "bottom", "top"]
        .map(|side| format!("region.sides.{side} = {{ kind = \"symmetry\" }}\n"))
        .concat();
    let error = |cells: f64, factor: f64| {
        let around = AroundShapes::new(&config(
            &format!(
                "region.size = [3.141592653589793, 3.141592653589793]\nregion.periodic = [false, false]\n{sides}\
             resolution.dx = {}\nfluid.viscosity = 0.1\nfluid.sound_speed_factor = {factor}\ntime.end = 1.0\n\
             initial.velocity = [\"sin(x)*cos(y)\", \"-cos(x)*sin(y)\"]\nobjective.kind = \"flow-rate\"\n",
                std::f64::consts::PI / cells
            ),
            &[],
        ))
        .unwrap();
        let (history, last) = around.march(&[], None, &mut |_, _| Ok(())).unwrap();
        let decay = (-0.2f64).exp();
        let ([x, y], [u, v, ..]) = (&last.shaped.position, &last.state.fields);
        let square = |i: usize| {
            let (sx, sy) = (x[i].sin() * y[i].cos(), -x[i].cos() * y[i].sin());
            (u[i] - decay * sx).powi(2) + (v[i] - decay * sy).powi(2)
        };
        let n = around.particles();
        let found = ((0..n).map(square).sum::<f64>() / n as f64).sqrt() / (decay * 0.5f64.sqrt());
        println!("{n} particles, sound {factor}, {} steps: {found:.2e}", history.sizes.len());
        found
    };
    let [coarse, fine] = [16.0, 32.0].map(|cells| error(cells, 20.0));
    assert!(fine < 5e-3 && fine < 0.4 * coarse, "{coarse:.2e} {fine:.2e}");
}

/// The mean drag of a disc that turns, over a period of the stream, hardly depends on how fast the sound is, and is that of an
/// incompressible fluid but for what five spacings across the disc leave.
#[test]
fn a_faster_sound_changes_little() {
    let drag = |more: &str| {
        let text = format!("{WARM}time.end = 4.2\nobjective.kind = \"flow-rate\"\n{DISC}");
        let around = AroundShapes::new(&config(&text, &[more])).unwrap();
        let (history, _) = around.march(&[], None, &mut |_, _| Ok(())).unwrap();
        let k = history.figures.iter().position(|(name, _)| name == "shapes[0].drag").unwrap();
        let own = history.moments.iter().filter(|moment| moment.time > 4.2 - 2.0 * std::f64::consts::PI / 3.0);
        let own: Vec<f64> = own.map(|moment| moment.values[k]).collect();
        own.iter().sum::<f64>() / own.len() as f64
    };
    let incompressible = drag("method.pressure=incompressible");
    let found = [10.0, 20.0, 40.0].map(|factor| drag(&format!("fluid.sound_speed_factor={factor}")));
    println!("{incompressible}, with sound {found:?}");
    assert!((found[2] / found[1] - 1.0).abs() < 0.01, "{found:?}");
    assert!((found[2] / incompressible - 1.0).abs() < 0.06, "{incompressible} {found:?}");
}

/// The exact gradient agrees with differences: by radius, place and a parameter of the wall's motion, in the plane and in space.
#[test]
fn the_gradient_agrees_with_differences() {
    let variables = |centre: f64| {
        format!(
            "[[variables]]\nnumber = \"shapes[0].radius\"\nlower = 0.2\nupper = 0.6\n\
             [[variables]]\nnumber = \"shapes[0].centre[0]\"\nlower = {}\nupper = {}\n\
             [[variables]]\nnumber = \"shapes[0].parameters[0]\"\nlower = 0.0\nupper = 3.0\n",
            centre - 0.1,
            centre + 0.1
        )
    };
    let plane =
        format!("{WARM}time.end = 0.3\nobjective.kind = \"drag\"\nobjective.window = 0.15\n{DISC}{}", variables(1.6));
    let space = format!(
        "{DUCT}time.end = 0.05\nobjective.kind = \"shape-heat\"\nobjective.window = 0.03\n{BALL}{}",
        variables(0.6)
    );
    for text in [plane, space] {
        let folder = TempDir::new().unwrap();
        fs::write(folder.path().join("scene.toml"), format!("{METHOD}{text}")).unwrap();
        let text = succeeds(folder.path(), &["check-gradient", "scene.toml", "--threads", "2"]);
        println!("{text}");
        assert!(text.contains("PASSED") && text.contains("allowed 1e-6"), "{text}");
    }
}

/// The same of what a line tells of a hot box on the floor of a pulsating stream, with buoyancy: heat and drag, with sound and without, and with
/// what its steps lack.
#[test]
fn heat_and_drag_by_a_line_have_exact_derivatives() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\nregion.size = [1.4, 0.8]\n\
        region.periodic = [false, false]\nregion.acceleration = [0.1, -1.0]\nfluid.viscosity = 0.05\nfluid.conductivity = 0.05\n\
        fluid.expansion = 0.5\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\nresolution.dx = 0.08\ntime.end = 0.1\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"6*y*(0.8-y)*(1 + 0.5*sin(9*t))\", 0], temperature = 0 }\n\
        region.sides.right = { kind = \"outflow\" }\nobjective.window = 0.06\n\
        objective.terms = [{ kind = \"shape-heat\", shapes = [0] }, { kind = \"drag\", shapes = [0], weight = 0.2 }]\n\
        [[shapes]]\nkind = \"box\"\nlower = [0.5, -0.2]\nupper = [0.7, 0.35]\ntemperature = \"1 + 0.5*x\"\n\
        [[variables]]\nnumber = \"shapes[0].upper[1]\"\nlower = 0.3\nupper = 0.4\n\
        [[variables]]\nnumber = \"shapes[0].lower[0]\"\nlower = 0.4\nupper = 0.6\n";
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("scene.toml"), text).unwrap();
    for key in
        ["method.pressure=incompressible", "method.deferred_correction=true", "method.pressure=weakly-compressible"]
    {
        let text = succeeds(folder.path(), &["check-gradient", "scene.toml", "--threads", "2", "--set", key]);
        println!("{key}: {text}");
        assert!(text.contains("PASSED") && text.contains("allowed 1e-6"), "{text}");
    }
}

/// With less memory states are made again, by the same steps.
#[test]
fn the_gradient_is_the_same_in_any_memory() {
    let text = format!(
        "{WARM}time.end = 0.6\nobjective.kind = \"drag\"\n{DISC}\
         [[variables]]\nnumber = \"shapes[0].radius\"\nlower = 0.2\nupper = 0.6\n\
         [[variables]]\nnumber = \"shapes[0].parameters[0]\"\nlower = 0.0\nupper = 3.0\n"
    );
    for pressure in ["weakly-compressible", "incompressible"] {
        let around = AroundShapes::new(&config(&text, &[&format!("method.pressure={pressure}")])).unwrap();
        let first = around.first();
        let (history, _) = around.march(&first, None, &mut |_, _| Ok(())).unwrap();
        // Four fields of eight bytes.
        let steps = history.sizes.len();
        assert!(steps > 8, "{steps} steps are too few for segments");
        let state = 8 * 4 * around.particles();
        // Of all stages, of those of some steps, of some states, and of none.
        let [all, some, few, least] = [100 * steps, 3 * steps, steps / 3, 0].map(|states| {
            let memory = states * state;
            let found = around.go_back(&first, &history, Of::Objective, memory).unwrap();
            found.by_variables
        });
        assert!(all.len() == 2 && all.iter().all(|by| by.abs() > 1e-6), "{all:?}");
        assert!(all == some && all == few && all == least, "{pressure}: {all:?} {some:?} {few:?} {least:?}");
    }
}

/// Steps do not depend on the number of threads.
#[test]
fn any_number_of_threads_gives_the_same_flow() {
    let folder = TempDir::new().unwrap();
    fs::write(
        folder.path().join("scene.toml"),
        format!("{METHOD}{WARM}time.end = 0.3\nobjective.kind = \"drag\"\n{DISC}"),
    )
    .unwrap();
    let of = |threads: &str| {
        succeeds(folder.path(), &["simulate", "scene.toml", "--threads", threads, "--out", threads]);
        fs::read(folder.path().join(threads).join("history.csv")).unwrap()
    };
    assert_eq!(of("1"), of("2"));
}

/// The heat of a ball in a duct is that of an incompressible fluid, and so is its drag, but for 3 %, where there is room for a surface around it.
#[test]
fn the_drag_and_heat_of_a_ball_in_a_duct_are_those_of_an_incompressible_fluid() {
    let of = |dx: f64, end: f64, figure: &str| {
        [[].as_slice(), &["method.pressure=incompressible"]].map(|set| {
            let text = format!("{DUCT}time.end = {end}\nobjective.kind = \"flow-rate\"\n{BALL}");
            let around = AroundBodies::new(&config(&text.replace("0.125", &dx.to_string()), set)).unwrap();
            let (history, _) = around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap();
            last(&history, figure)
        })
    };
    let [own, other] = of(0.125, 1.0, "shapes[0].heat");
    assert!((own / other - 1.0).abs() < 0.02, "{own} {other}");
    let [own, other] = of(0.1, 0.3, "shapes[0].drag");
    assert!((own / other - 1.0).abs() < 0.04, "{own} {other}");
}

/// Shapes that meet the sides of the box at a right angle: the flow over them is that of an incompressible fluid.
#[test]
fn shapes_that_meet_sides_have_the_flow_of_an_incompressible_fluid() {
    let channel = "region.size = [2.0, 1.0]\nregion.periodic = [true, false]\nregion.acceleration = [0.3, 0.0]\nfluid.viscosity = 0.05\n\
        fluid.reference_velocity = 0.5\nresolution.dx = 0.05\ntime.end = 1.0\nobjective.kind = \"flow-rate\"\n[[shapes]]\n";
    for shape in [
        "kind = \"disc\"\ncentre = [0.8, 0.0]\nradius = 0.25\n",
        "kind = \"polygon\"\npoints = [[0.8, -0.2], [1.2, -0.2], [1.2, 0.3], [0.8, 0.3]]\n",
    ] {
        let rate = |set: &[&str]| {
            let around = AroundShapes::new(&config(&format!("{channel}{shape}"), set)).unwrap();
            let (history, _) = around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap();
            last(&history, "flow_rate")
        };
        let [own, other] = [rate(&[]), rate(&["method.pressure=incompressible"])];
        println!("flow rates {own} and {other}");
        assert!((own / other - 1.0).abs() < 5e-3, "{shape}: {own} and {other}");
    }
}

/// What it does not have is refused by name, and a flow that is not finite ends with advice.
#[test]
fn what_cannot_be_is_refused() {
    let folder = TempDir::new().unwrap();
    let channel = "region.size = [1.0, 0.5]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\nfluid.viscosity = 0.05\n\
        resolution.dx = 0.05\ntime.end = 0.1\nobjective.kind = \"flow-rate\"\n";
    fs::write(folder.path().join("scene.toml"), format!("{METHOD}{channel}")).unwrap();
    succeeds(folder.path(), &["simulate", "scene.toml", "--out", "run"]);
    for (set, expected) in [
        ("fluid.drive=flow-rate", vec!["fluid.drive", "weakly-compressible", "body-force"]),
        ("method.pressure=none", vec!["pressure", "incompressible"]),
        ("method.flow=steady", vec!["method.pressure", "weakly-compressible", "method.flow=unsteady"]),
        ("region.periodic=[true, true]", vec!["method.pressure", "not all periodic"]),
    ] {
        let arguments = ["simulate", "scene.toml", "--set", set];
        refused(&arguments, &hydrograd(folder.path(), &arguments), &expected);
    }
}
