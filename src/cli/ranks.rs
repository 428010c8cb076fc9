//! A command that several ranks run together: the first one speaks, and an error ends all.

use super::guard::{stopped_by, tell_error};
use super::machine;
use crate::error::BadInput;
use crate::numerics::ranks::Ranks;
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
            .allowed("simulate and train, which share their work over ranks")
            .advice("start it without mpirun; several machines make one data set with generate --shard")
            .into()),
    }
}
