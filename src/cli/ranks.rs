//! A command that several ranks run together: the first one speaks, and an error ends all.

use super::guard::{stopped_by, tell_error};
use super::machine;
use crate::config::device::DeviceName;
use crate::config::scene::{GradientMode, Kernels};
use crate::error::BadInput;
use crate::numerics::ranks::Ranks;
use crate::scene::load::Loaded;
use std::time::Duration;

/// Runs a command on every rank that was started with this one. Only the first prints.
///
/// # Errors
/// That of the command, on the first rank.
pub fn together(command: impl FnOnce(&Ranks) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let ranks = Ranks::of_environment()?;
    let (rank, size) = (ranks.rank(), ranks.size());
    if rank > 0 {
        machine::be_silent();
    }
    match command(&ranks) {
        // A signal ends all ranks at the same step.
        Err(error) if size > 1 && stopped_by(&error).is_none() => {
            let error = if rank > 0 { error.context(format!("rank {rank} of {size}")) } else { error };
            if rank > 0 {
                // The first rank probably has the same error, reports it, and ends this one.
                std::thread::sleep(Duration::from_secs(2));
            }
            let code = tell_error(&error);
            machine::end(code);
            ranks.abort(code);
            Err(error)
        }
        Err(_) if rank > 0 => Ok(()),
        result => result,
    }
}

/// Checks that a command which ranks do not share was started once.
///
/// # Errors
/// [`BadInput`]: there are several processes, each of which would do all of it.
pub fn alone(ranks: &Ranks) -> anyhow::Result<()> {
    match ranks.size() {
        1 => Ok(()),
        several => Err(BadInput::new(format!("{several} processes, each of which would do all of this command"))
            .place("mpirun")
            .allowed("simulate, check-gradient, optimize, generate and train, which share their work over ranks")
            .advice("start it without mpirun")
            .into()),
    }
}

/// Checks that several ranks can share the flow of a configuration.
///
/// # Errors
/// [`BadInput`]: a method, kernels or a device for one process.
pub fn check_flow(loaded: &Loaded) -> Result<(), BadInput> {
    let (config, alone) = (&loaded.config, "start it without mpirun, with --threads");
    if !config.method.facts().moves {
        return Err(loaded.located(
            BadInput::new(format!(
                "method.name = {} over several ranks: one matrix of the whole flow is solved",
                config.method.name()
            ))
            .key("method.name")
            .allowed("methods whose particles move, such as consistent")
            .advice(alone),
        ));
    }
    if config.run.kernels == Kernels::Composed || config.run.device != DeviceName::Cpu {
        return Err(loaded.located(
            BadInput::new("composed kernels over several ranks")
                .key("run.kernels")
                .allowed("fused, on the CPU")
                .advice(alone),
        ));
    }
    Ok(())
}

/// Checks that several ranks can share the gradients of a design.
///
/// # Errors
/// [`BadInput`]: as for [`check_flow`]; a gradient that is not that of a whole run.
pub fn check_design(loaded: &Loaded) -> Result<(), BadInput> {
    check_flow(loaded)?;
    let optimise = &loaded.config.optimise;
    if matches!(optimise.gradient, GradientMode::Truncated | GradientMode::Steady | GradientMode::Ensemble) {
        return Err(loaded.located(
            BadInput::new("a gradient over several ranks that is not that of one whole run")
                .key("optimise.gradient")
                .allowed("segments, taped, or differences of runs")
                .advice("optimise.gradient=segments"),
        ));
    }
    if optimise.clip > 0.0 {
        return Err(loaded.located(
            BadInput::new("a clipped gradient over several ranks")
                .key("optimise.clip")
                .allowed("0, the exact gradient")
                .advice("optimise.clip=0"),
        ));
    }
    Ok(())
}
