//! The exact derivative of figures of fixed particles around shapes by the viscosity.

use hydrograd::config::scene::Config;
use hydrograd::scene::around_bodies::AroundBodies;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::Of;

/// What drives the fluid past a ball or a disc, and what it is judged by.
fn config(viscosity: f64, more: &str) -> Config {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    let text = format!(
        "scene = \"custom\"\nmethod.name = \"fixed\"\nfluid.density = 2.0\nfluid.viscosity = {viscosity}\n\
         objective.terms = [{{ kind = \"drag\", weight = 1.0 }}, {{ kind = \"torque\", weight = 20.0 }}, \
         {{ kind = \"pressure-drop\", weight = 0.3 }}]\n{more}"
    );
    std::fs::write(&file, text).unwrap();
    Config::load(Some(file.to_str().unwrap()), None, &[]).unwrap_or_else(|error| panic!("{error}")).config
}

const PLANE: &str =
    "region.size = [1.0, 0.6]\nregion.periodic = [true, false]\nresolution.dx = 0.08\nresolution.surface = 0.04\n\
    [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.33]\nradius = 0.12\nvelocity = [\"0.33 - y\", \"x - 0.5\"]\n";
const SPACE: &str = "region.size = [0.6, 0.4, 0.4]\nregion.periodic = [true, false, false]\nresolution.dx = 0.06\nresolution.surface = 0.04\n\
    [[shapes]]\nkind = \"disc\"\ncentre = [0.3, 0.22, 0.2]\nradius = 0.1\nvelocity = [\"0.22 - y\", \"x - 0.3\", 0]\n";

fn agrees<A: Around>(more: &str, new: &dyn Fn(&Config) -> A) {
    let viscosity = 0.04;
    let around = new(&config(viscosity, more));
    let first = around.first();
    let is_steady = around.config().unsteady().is_none();
    let history = (!is_steady).then(|| around.march(&first, None, &mut |_, _| Ok(())).unwrap().0);
    let value = |mut around: A| {
        let Some(history) = &history else {
            let solution = around.solve(&first).unwrap();
            return around.objective(&solution).0;
        };
        // Along the same steps.
        let (history, _) = around.march(&first, Some(&history.sizes), &mut |_, _| Ok(())).unwrap();
        history.objective(&around.window(&first, &history).unwrap())
    };
    let mut around = around;
    let exact = match &history {
        Some(history) => around.march_gradient(&first, history, Of::Objective).unwrap(),
        None => {
            let solution = around.solve(&first).unwrap();
            let (_, terms) = around.objective(&solution);
            around.gradient(&solution, &terms).unwrap()
        }
    };
    let exact = exact.by_viscosity.unwrap();
    let central = |step: f64| {
        let at = |sign: f64| value(new(&config(viscosity * (1.0 + sign * step), more)));
        (at(1.0) - at(-1.0)) / (2.0 * viscosity * step)
    };
    let difference = (4.0 * central(1e-3) - central(2e-3)) / 3.0;
    println!("{} particles: {exact} and {difference}", around.particles());
    assert!((exact / difference - 1.0).abs() < 1e-6, "{exact} and {difference}");
}

#[test]
fn the_derivative_by_the_viscosity_is_that_of_differences() {
    let plane = |config: &Config| {
        let mut around = AroundShapes::new(config).unwrap();
        around.by_viscosity = true;
        around
    };
    let space = |config: &Config| {
        let mut around = AroundBodies::new(config).unwrap();
        around.by_viscosity = true;
        around
    };
    let held = "fluid.drive = \"flow-rate\"\nfluid.flow_rate =";
    let in_time = "method.flow = \"unsteady\"\ntime.end = 0.1\ntime.step = 0.02\n";
    agrees(&format!("{held} 0.4\n{PLANE}"), &plane);
    agrees(&format!("{in_time}{held} 0.4\n{PLANE}"), &plane);
    agrees(&format!("region.acceleration = [1.0, 0.0]\n{in_time}{PLANE}"), &plane);
    agrees(&format!("{held} 0.1\nregion.acceleration = [0.0, 0.0, 0.0]\n{SPACE}"), &space);
    agrees(&format!("region.acceleration = [1.0, 0.0, 0.0]\n{in_time}{SPACE}"), &space);
}
