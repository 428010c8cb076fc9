//! Fixed particles around bodies in space, whose flow goes on in time, and with buoyancy.

use crate::support::differences::of_mean;
use crate::support::program::succeeds;
use hydrograd::config::scene::Config;
use hydrograd::scene::around_bodies::AroundBodies;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_in_time::Marching;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::{History, Of};
use hydrograd::sph::cloud::figures::Figure;
use hydrograd::sph::cloud::space::equations::State;
use hydrograd::sph::cloud::space::march::LAG;
use hydrograd::sph::cloud::space::problem::Solution;
use hydrograd::sph::cloud::unsteady::{lagged, Guess, Scheme};
use std::f64::consts::PI;

fn config(text: &str) -> Config {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, format!("scene = \"custom\"\nmethod.name = \"fixed\"\n{text}")).unwrap();
    Config::load(Some(file.to_str().unwrap()), None, &[]).unwrap_or_else(|error| panic!("{error}")).config
}

fn march(around: &AroundBodies) -> (History, Solution) {
    around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap_or_else(|error| panic!("{error}"))
}

/// Vortices of Taylor and Green between sides where the fluid slips: u = sin x cos z, w = -cos x sin z in [0, pi]^2 decay as
/// exp(-2 nu t), and turn without changing their shape.
#[test]
fn vortices_decay_as_they_must() {
    let sides: String = ["left", "right", "back", "front"]
        .map(|side| format!("region.sides.{side} = {{ kind = \"symmetry\" }}\n"))
        .concat();
    let text = |dx: f64| {
        format!(
            "method.flow = \"unsteady\"\nregion.size = [3.141592653589793, 1.0, 3.141592653589793]\n\
             region.periodic = [false, true, false]\nregion.acceleration = [0.0, 0.0, 0.0]\n{sides}\
             resolution.dx = {dx}\nfluid.viscosity = 0.1\ntime.end = 1.0\n\
             initial.velocity = [\"sin(x)*cos(z)\", \"0*x\", \"-cos(x)*sin(z)\"]\nobjective.kind = \"flow-rate\"\n"
        )
    };
    let error = |dx: f64| {
        let around = AroundBodies::new(&config(&text(dx))).unwrap();
        let (history, last) = march(&around);
        let decay = (-0.2f64).exp();
        let [x, _, z] = &last.shaped.position;
        let square = |i: usize| {
            let exact = [x[i].sin() * z[i].cos(), 0.0, -x[i].cos() * z[i].sin()];
            last.state.velocity(i).iter().zip(exact).map(|(u, exact)| (u - decay * exact).powi(2)).sum::<f64>()
        };
        let n = around.particles();
        let found = ((0..n).map(square).sum::<f64>() / n as f64).sqrt() / (decay * 0.5f64.sqrt());
        println!("{n} particles, {} steps: {found:.2e}", history.sizes.len());
        found
    };
    let errors = [PI / 8.0, PI / 14.0].map(error);
    assert!(errors[1] < 0.01 && errors[1] < 0.5 * errors[0], "{errors:?}");
}

/// A column along z starts from rest as in the plane, with particles as far apart: the flow rate within 0.5 %, the drag by the surface within
/// 2.4 %, where the plane's own is 3.2 % above that of half the spacing.
#[test]
fn a_column_starts_as_in_the_plane() {
    let text = |size: &str, shape: &str| {
        format!(
            "method.flow = \"unsteady\"\nregion.size = {size}\nresolution.dx = 0.04\nresolution.surface = 0.02\n\
             fluid.viscosity = 0.006\ntime.end = 0.5\nobjective.kind = \"flow-rate\"\n{shape}"
        )
    };
    let plane = "region.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
                 [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.2]\nradius = 0.1\n";
    let space = "region.periodic = [true, false, true]\nregion.acceleration = [1.0, 0.0, 0.0]\n\
                 [[shapes]]\nkind = \"cylinder\"\naxis = \"z\"\ncentre = [0.5, 0.2, 0.06]\nradius = 0.1\n";
    let plane = AroundShapes::new(&config(&text("[1.0, 0.4]", plane))).unwrap();
    let space = AroundBodies::new(&config(&text("[1.0, 0.4, 0.12]", space))).unwrap();
    let (of_plane, end_of_plane) = plane.march(&[], None, &mut |_, _| Ok(())).unwrap();
    let (of_space, _) = march(&space);
    let last = |history: &History, name: &str| {
        let k = history.figures.iter().position(|(own, _)| own == name).unwrap();
        history.moments[history.moments.len() - 1].values[k]
    };
    // The plane's force is that through a line, the one in space that of the surface.
    let by_surface = plane.flow.measures.surface_force(&plane.flow.at(&end_of_plane), 0, 0);
    let figures = [("flow_rate", last(&of_plane, "flow_rate"), 0.01), ("shapes[0].drag", by_surface, 0.035)];
    for (name, known, tolerance) in figures {
        let found = last(&of_space, name) / 0.12;
        println!("{name}: {found}, in the plane {known}");
        assert!((found / known - 1.0).abs() < tolerance, "{name}: {found}, in the plane {known}");
    }
}

const BALL: &str = "region.size = [0.6, 0.4, 0.4]\nregion.periodic = [true, false, false]\n\
    region.acceleration = [1.0, 0.0, 0.0]\nresolution.dx = 0.0667\nresolution.surface = 0.04\n\
    fluid.viscosity = 0.02\nfluid.conductivity = 0.02\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
    region.sides.top = { kind = \"wall\", temperature = 0.0 }\nobjective.kind = \"flow-rate\"\n\
    [[shapes]]\nkind = \"disc\"\ncentre = [0.3, 0.2, 0.2]\nradius = 0.1\ntemperature = 1.0\n";

/// A flow in time becomes that of Newton's method, with the same rate, force and heat by the ball's surface: closely if that one has the
/// damping of the pressure that steps have, and else but for what this changes with three spacings across the ball.
#[test]
fn a_flow_in_time_becomes_the_steady_one() {
    let mut steady = AroundBodies::new(&config(BALL)).unwrap();
    let solution = steady.solve(&[]).unwrap();
    let text = format!("method.flow = \"unsteady\"\nmethod.tolerance = 1e-3\ntime.end = 6.0\n{BALL}");
    let around = AroundBodies::new(&config(&text)).unwrap();
    let (history, last) = march(&around);
    println!("{} particles, {} steps", around.particles(), history.sizes.len());
    let of = |around: &AroundBodies, solution: &Solution| {
        let (at, measures) = (around.flow.at(solution), &around.flow.measures);
        let rate = measures.value(Figure::FlowRate, &at);
        [rate, measures.surface_force(&at, 0, 0), measures.surface_heat(&at, 0)]
    };
    let (found, known) = (of(&around, &last), of(&steady, &solution));
    let dt = history.sizes[history.sizes.len() - 2];
    let equations = &mut steady.flow.solver.equations;
    equations.damping = lagged(&equations.damping, equations.inside, LAG, 1.5 / dt);
    let solution = steady.solve(&[]).unwrap();
    let as_in_steps = of(&steady, &solution);
    println!("{found:?}, steady {known:?}, with the damping of steps of {dt} {as_in_steps:?}");
    // The force was bounded by 1 % too, when tau was up to fourteen steps; with five, which more flows in short steps are stable with, it
    // is 1.2 %. That it is the damping is what the other bounds say. (The heat, which leaves through one wall only, is not steady yet.)
    for (k, bounds) in [[1e-2, 5e-4], [1.5e-2, 5e-4], [1e-2, 1e-2]].into_iter().enumerate() {
        for (known, bound) in [known[k], as_in_steps[k]].into_iter().zip(bounds) {
            assert!((found[k] / known - 1.0).abs() < bound, "{}, steady {known}", found[k]);
        }
    }
}

/// A box in a duct whose stream does not know it at the start: in steps that the flow chooses it has the forces of steps of one size. (Pressures
/// between box and wall grew in steps a tenth of what advection allows, with which it began: it was not finite after 20.) Nor do they grow in
/// steps a sixtieth of what it allows, whose force is that of four times as long ones within what this spacing can tell.
#[test]
fn a_flow_begins_in_steps_that_are_stable() {
    let text = "method.flow = \"unsteady\"\nregion.size = [1.41, 0.96, 1.24]\n\
        resolution.dx = 0.1\nfluid.viscosity = 0.1\nfluid.reference_velocity = 1.0\nobjective.kind = \"flow-rate\"\n\
        initial.velocity = [\"11.291*y*(0.96-y)*z*(1.24-z)\", \"0*x\", \"0*x\"]\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"11.291*y*(0.96-y)*z*(1.24-z)\", 0, 0] }\nregion.sides.right = { kind = \"outflow\" }\n\
        [[shapes]]\nkind = \"box\"\nlower = [0.256, 0.187, 0.503]\nupper = [0.704, 0.635, 0.951]\n";
    let drag = |step: &str| {
        let around = AroundBodies::new(&config(&format!("{step}{text}"))).unwrap();
        let (history, last) = march(&around);
        let drag = around.flow.measures.surface_force(&around.flow.at(&last), 0, 0);
        println!("{} steps, drag {drag}", history.sizes.len());
        drag
    };
    let [own, given] = ["time.end = 0.1\n", "time.end = 0.1\ntime.step = 0.01\n"].map(drag);
    assert!((own / given - 1.0).abs() < 0.02, "{own} and {given}");
    let [short, long] = ["time.end = 0.04\ntime.step = 0.0005\n", "time.end = 0.04\ntime.step = 0.002\n"].map(drag);
    assert!((short / long - 1.0).abs() < 0.1, "{short} and {long}");
}

/// The largest component of a velocity.
fn fastest(around: &AroundBodies, last: &Solution) -> f64 {
    let velocities = (0..around.particles()).flat_map(|i| last.state.velocity(i));
    velocities.fold(0.0, |fastest: f64, u| fastest.max(u.abs()))
}

/// A cylinder that stands on a wall and on a side where the fluid slips. What a point there has of its neighbours' velocities was up to 830
/// times as large as they are, and the flow was not finite after ten steps.
#[test]
fn a_flow_goes_on_around_a_cylinder_that_stands_on_sides() {
    let text = "method.flow = \"unsteady\"\ntime.end = 0.2\ntime.step = 0.01\nregion.size = [1.3, 0.8, 0.8]\nresolution.dx = 0.1\n\
        fluid.viscosity = 0.049\nfluid.reference_velocity = 1.0\nobjective.kind = \"drag\"\nobjective.shapes = [0]\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"y*(1.6-y)*z*(1.6-z)/0.4096\", 0, 0] }\n\
        region.sides.right = { kind = \"outflow\" }\nregion.sides.bottom = { kind = \"wall\" }\n\
        region.sides.top = { kind = \"symmetry\" }\nregion.sides.back = { kind = \"wall\" }\n\
        region.sides.front = { kind = \"symmetry\" }\n\
        [[shapes]]\nkind = \"cylinder\"\ncentre = [0.569, 0.434, 0.423]\nradius = 0.14\naxis = \"y\"\n";
    for pressure in ["incompressible", "weakly-compressible"] {
        let around = AroundBodies::new(&config(&format!("method.pressure = \"{pressure}\"\n{text}"))).unwrap();
        let (history, last) = march(&around);
        let fastest = fastest(&around, &last);
        println!("{pressure}: {} steps, velocities up to {fastest}", history.sizes.len());
        // Around the cylinder the stream, 1 at most, goes through 0.65 of the height and more.
        assert!(fastest > 1.0 && fastest < 2.0, "{fastest}");
    }
}

/// A cylinder between two walls in steps a third of those that its flow chooses. Where layers around it meet the lattice S hardly has a
/// particle's own value, and with tau of seven steps everywhere pressures grew there: the flow was not finite after 22.
#[test]
fn pressures_do_not_grow_where_layers_meet_the_lattice() {
    let text = "method.flow = \"unsteady\"\ntime.end = 0.09\ntime.step = 0.003\nregion.size = [1.4, 0.8, 0.7]\nresolution.dx = 0.065\n\
        fluid.viscosity = 0.063\nfluid.reference_velocity = 1.0\nobjective.kind = \"drag\"\nobjective.shapes = [0]\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"(1-(y/0.8)^2)*4*z/0.7*(1-z/0.7)\", 0, 0] }\n\
        region.sides.right = { kind = \"outflow\" }\nregion.sides.bottom = { kind = \"symmetry\" }\n\
        [[shapes]]\nkind = \"cylinder\"\ncentre = [0.626, 0.397, 0.33]\nradius = 0.126\naxis = \"z\"\n";
    let around = AroundBodies::new(&config(text)).unwrap();
    let (history, last) = march(&around);
    let fastest = fastest(&around, &last);
    println!("{} steps, velocities up to {fastest}", history.sizes.len());
    assert!(fastest > 1.0 && fastest < 2.0, "{fastest}");
}

/// A warm ball that turns back and forth in a stream that pulsates, with buoyancy: the exact derivative of drag, torque, heat and a
/// pressure together by radius, place, amplitude and frequency beside differences.
#[test]
fn the_gradient_is_that_of_differences() {
    let sides: String = ["bottom", "top", "back", "front"]
        .map(|side| format!("region.sides.{side} = {{ kind = \"symmetry\" }}\n"))
        .concat();
    let variables: String =
        [("radius", 0.05, 0.12), ("centre[1]", 0.15, 0.25), ("parameters[0]", 0.0, 1.0), ("parameters[1]", 1.0, 10.0)]
            .map(|(name, lower, upper)| {
                format!("[[variables]]\nnumber = \"shapes[0].{name}\"\nlower = {lower}\nupper = {upper}\n")
            })
            .concat();
    let text = format!(
        "method.flow = \"unsteady\"\nregion.size = [0.7, 0.4, 0.4]\nregion.periodic = [false, false, false]\n\
         region.acceleration = [0.0, -1.0, 0.0]\n{sides}\
         region.sides.left = {{ kind = \"inflow\", velocity = [\"1 + 0.3*sin(5*t)\", 0, 0], temperature = 0 }}\n\
         region.sides.right = {{ kind = \"outflow\" }}\nfluid.viscosity = 0.02\nfluid.conductivity = 0.02\n\
         fluid.inlet_temperature = 0.0\nfluid.expansion = 0.5\ninitial.temperature = 0.0\n\
         initial.velocity = [\"1 + 0*y\", \"0.1*sin(3*x)\", \"0*x\"]\nresolution.dx = 0.07\nresolution.surface = 0.045\n\
         time.step = 0.02\ntime.end = 0.1\nobjective.window = 0.05\n\
         objective.terms = [{{ kind = \"drag\", weight = 0.1 }}, {{ kind = \"torque\", weight = 20.0 }}, \
         {{ kind = \"shape-heat\", weight = 1.0 }}, {{ kind = \"pressure\", at = [0.5, 0.2, 0.1], weight = 0.1 }}]\n\
         [[shapes]]\nkind = \"disc\"\ncentre = [0.3, 0.2, 0.21]\nradius = 0.1\n\
         temperature = 1.0\nparameters = [0.5, 7.0]\n\
         velocity = [\"p0*cos(p1*t)*(0.2 - y)\", \"p0*cos(p1*t)*(x - 0.3)\", 0]\n{variables}"
    );
    let around = AroundBodies::new(&config(&text)).unwrap();
    let first = around.first();
    let (history, _) = march(&around);
    let exact = around.march_gradient(&first, &history, Of::Objective).unwrap().by_variables;
    let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
    println!("{} particles, {} steps, {exact:?}", around.particles(), history.sizes.len());
    for k in 0..first.len() {
        let step = if k < 2 { 4e-4 } else { 4e-2 };
        let difference = of_mean(&around, &first, &history.sizes, k, step);
        println!("{k}: {} and {difference}", exact[k]);
        assert!((difference - exact[k]).abs() < 1e-6 * norm, "{k}: {} and {difference}", exact[k]);
        assert!((difference - exact[k]).abs() < 1e-5 * exact[k].abs(), "{k}: {} and {difference}", exact[k]);
    }
}

/// The iterations for a step, and for its transpose, end where exact factors do.
#[test]
fn iterations_agree_with_factors() {
    let around = AroundBodies::new(&config(&format!("method.flow = \"unsteady\"\n{BALL}"))).unwrap();
    let shaped = around.shaped(&[]).unwrap();
    let (rate, now, before) = (40.0, State::at_rest(around.particles()), State::at_rest(0));
    let number = |k: usize| (12.9898 * (k + 1) as f64).sin();
    let right: Vec<f64> = (0..4 * around.particles() + 1).map(number).collect();
    let found = [true, false].map(|exact| {
        let mut march = around.scheme(&shaped);
        if !exact {
            march = march.without_factors();
        }
        let guess = Guess { now: &now, before: &before, ratio: 0.0 };
        [Some(guess), None].map(|guess| march.solve_flow(rate, &right, guess).unwrap())
    });
    for (exact, found) in found[0].iter().zip(&found[1]) {
        let size = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
        let off = exact.iter().zip(found).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        println!("{:.1e}", off / size);
        assert!(off < 1e-7 * size, "{off} of {size}");
    }
}

/// The heated cavity between adiabatic sides along z, at a Rayleigh number of 1e4.
fn cavity(depth: &str, more: &str) -> String {
    format!(
        "region.size = [1.0, 1.0{depth}]\nresolution.dx = 0.0625\nfluid.viscosity = 0.71\nfluid.conductivity = 1.0\n\
         fluid.inlet_temperature = 0.0\nfluid.reference_temperature = 0.5\nfluid.expansion = 7100.0\n\
         fluid.reference_velocity = 20.0\ninitial.temperature = 0.5\nobjective.kind = \"flow-rate\"\n{more}"
    )
}

/// The mean heat flux along x in that of a fluid at rest: 1 and what the flow carries, by trapezes. (By slopes of the temperature at the
/// hot wall it is 2.40 with these 16 spacings.)
fn nusselt(around: &AroundBodies, solution: &Solution) -> f64 {
    let ([u, .., t], size) = (&solution.state.fields, &around.config().region.size);
    let carried = |i: usize| {
        let z = solution.shaped.position[2][i];
        let part = if z < 1e-9 || z > size[2] - 1e-9 { 0.5 } else { 1.0 };
        part * u[i] * t[i]
    };
    let volume = around.config().resolution.dx.powi(3) / (size[0] * size[1] * size[2]);
    1.0 + volume * (0..around.particles()).map(carried).sum::<f64>()
}

#[test]
fn a_heated_cavity_has_the_heat_of_the_plane() {
    let walls = "region.sides.left = { kind = \"wall\", temperature = 1.0 }\n\
                 region.sides.right = { kind = \"wall\", temperature = 0.0 }\n";
    let space = format!(
        "{walls}region.periodic = [false, false, false]\nregion.acceleration = [0.0, -1.0, 0.0]\n\
         region.sides.back = {{ kind = \"symmetry\" }}\nregion.sides.front = {{ kind = \"symmetry\" }}\n"
    );
    let mut around = AroundBodies::new(&config(&cavity(", 0.1875", &space))).unwrap();
    let solution = around.solve(&[]).unwrap();
    let steady = nusselt(&around, &solution);
    println!("{} particles: {steady}, known 2.2448", around.particles());
    assert!((steady / 2.2448 - 1.0).abs() < 0.02, "{steady}");
    let in_time = format!("method.flow = \"unsteady\"\nmethod.tolerance = 1e-2\ntime.end = 0.15\n{space}");
    let around = AroundBodies::new(&config(&cavity(", 0.1875", &in_time))).unwrap();
    let (history, last) = march(&around);
    let found = nusselt(&around, &last);
    println!("{} steps: {found}", history.sizes.len());
    assert!((found / steady - 1.0).abs() < 1e-2, "{found}, steady {steady}");
}

/// The steady flow around a warm ball in a cold box, where the heat drives the flow: the exact derivative by radius and place beside
/// differences of flows that are solved for anew.
#[test]
fn the_gradient_of_a_steady_flow_that_heat_drives_is_that_of_differences() {
    let text = "region.size = [1.0, 1.0, 1.0]\nregion.periodic = [false, false, false]\nregion.acceleration = [0.0, -1.0, 0.0]\n\
        region.sides.left = { kind = \"wall\", temperature = 0 }\nregion.sides.right = { kind = \"wall\", temperature = 0 }\n\
        fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.reference_velocity = 0.3\nfluid.expansion = 2.0\n\
        fluid.inlet_temperature = 0.0\ninitial.temperature = 0\nresolution.dx = 0.1\nobjective.kind = \"shape-heat\"\n\
        [[variables]]\nnumber = \"shapes[0].radius\"\nlower = 0.15\nupper = 0.35\n\
        [[variables]]\nnumber = \"shapes[0].centre[1]\"\nlower = 0.4\nupper = 0.6\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.45, 0.5]\nradius = 0.2\ntemperature = 1\n";
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, format!("scene = \"custom\"\nmethod.name = \"fixed\"\n{text}")).unwrap();
    succeeds(folder.path(), &["check-gradient", "scene.toml", "--out", "check"]);
    let found = std::fs::read_to_string(folder.path().join("check/gradient_check.json")).unwrap();
    let found: serde_json::Value = serde_json::from_str(&found).unwrap();
    let difference = found["worst_relative_error"].as_f64().unwrap();
    assert!(difference < 1e-7, "{difference} of the gradient's length");
}
