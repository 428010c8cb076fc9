//! `--explain`: prints what would be run, without running it.

use super::machine;
use super::prepare::require_design;
use crate::config::scene::{Config, Precision};
use crate::error::Error;
use crate::scene::load::Loaded;
use crate::scene::Scene;
use crate::sph::plan::Plan;
use crate::sph::Sweeps;
use serde_json::json;

/// Prints the plan of a scene, with that of its gradient if `gradient` is set.
pub fn explain(loaded: &Loaded, gradient: bool) -> anyhow::Result<()> {
    let config = &loaded.config;
    let plan = plan_of(config, gradient)?;
    machine::answer(&json!({
        "scene": config.scene,
        "steps": config.steps(),
        "time_step": config.time_step(),
        "plan": plan.to_string().lines().collect::<Vec<_>>(),
    }));
    println!("{}, {} steps", loaded.source, config.steps());
    print!("{plan}");
    Ok(())
}

/// The plan of a configuration, with that of its gradient if `gradient` is set.
pub fn plan_of(config: &Config, gradient: bool) -> anyhow::Result<Plan> {
    match config.run.precision {
        Precision::F32 => plan::<f32>(config, gradient),
        Precision::F64 => plan::<f64>(config, gradient),
    }
}

fn plan<R: Sweeps>(config: &Config, gradient: bool) -> anyhow::Result<Plan> {
    if gradient {
        require_design(config)?;
    }
    let scene = Scene::<R>::from_config(config)?;
    let plan = Plan::of(&scene.model, &scene.start.state, Some(limit(config)))
        .map_err(|error| Error::run(error.to_string(), "another resolution.dx or time.skin"))?;
    // The gradient of a steady state keeps one state and tapes nothing.
    let Some(design) = scene.design.filter(|design| gradient && !design.is_steady) else { return Ok(plan) };
    let schedule = design.schedule(&config.optimise, config.run.precision)?;
    let costs = design.costs()?;
    Ok(plan.with_gradient(&design.model, &schedule, costs, Some(config.optimise.memory.bytes())))
}

/// What limits the time step.
fn limit(config: &Config) -> String {
    let limits = config.time_step_limits();
    let which = match limits.acoustic <= limits.diffusive {
        _ if limits.force < limits.acoustic.min(limits.diffusive) => "the body force".to_string(),
        true if limits.acoustic == limits.growth => {
            format!(
                "sound that would grow in the flow, whatever time.cfl (heat and viscosity would allow {:.3e})",
                limits.diffusive
            )
        }
        true => {
            format!("sound (time.cfl = {}; heat and viscosity would allow {:.3e})", config.time.cfl, limits.diffusive)
        }
        false => format!(
            "diffusion (time.diffusion_number = {}; sound would allow {:.3e})",
            config.time.diffusion_number, limits.acoustic
        ),
    };
    match config.time_step() / config.time_step_limit() {
        share if share < 1.0 - 1e-6 => format!("{which}, and {:.2} % less to end at time.end", 100.0 * (1.0 - share)),
        _ => which,
    }
}
