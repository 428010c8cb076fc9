//! The objective of a wall and its derivative, for data sets.

use crate::config::layers::Setting;
use crate::error::{BadInput, Error};
use crate::scene::load::Loaded;
use crate::scene::Scene;

/// The heat that flows out of the steady flow over a wall with these heights at the nodes `[M]`, and its derivative by
/// them `[M]`, by fixed particles and their adjoint ([`crate::design::Problem`]).
///
/// # Errors
/// A flow that does not become steady, or a scene that has no fixed particles.
pub fn objective(loaded: &Loaded, offsets: &[f64]) -> Result<(f64, Vec<f64>), Error> {
    let set = |key: &str, value: String| Setting::option("the objective of a trajectory", key, value);
    let settings = [
        set("design.offsets", format!("{offsets:?}")),
        set("design.parametrisation", "nodes".into()),
        set("method.name", "fixed".into()),
        set("run.precision", "f64".into()),
        set("optimise.gradient", "steady".into()),
    ];
    let scene = Scene::<f64>::from_config(&loaded.with(&settings)?.config)?;
    let Some(problem) = scene.design else {
        return Err(BadInput::new("the scene has no wall to shape").key("objective").into());
    };
    let schedule = crate::adjoint::schedule::Schedule::taped(problem.steps);
    let found = problem.differentiate(&problem.first, &schedule, &mut |_| ())?;
    Ok((found.value * problem.figure.factor, found.by_variables.iter().map(|by| by * problem.figure.factor).collect()))
}
