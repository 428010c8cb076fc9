//! The run loop without a graph: advance, check, show.

use super::dynamics::Dynamics;
use crate::numerics::interrupt;

/// Number of steps between two checks that all values are finite and possible.
pub const CHECK_EVERY: usize = 64;

pub trait Observer<D: Dynamics> {
    /// Sees the run at its start and after each step.
    fn see(&mut self, dynamics: &D, run: &mut D::Run) -> anyhow::Result<()>;
    /// Whether it does anything after so many steps. Who makes them elsewhere shows it only those.
    fn wants(&self, _step: usize) -> bool {
        true
    }
}

impl<D: Dynamics, F: FnMut(&D, &mut D::Run) -> anyhow::Result<()>> Observer<D> for F {
    fn see(&mut self, dynamics: &D, run: &mut D::Run) -> anyhow::Result<()> {
        self(dynamics, run)
    }
}

/// Runs from `start` until `steps` steps are made in total. Every observer sees the start and every step. Values are
/// checked every 64 steps and at the end, before observers see them.
///
/// # Errors
/// A [`super::RunError`] if the run cannot continue; an observer's error; [`crate::error::Error::Stopped`].
pub fn run<D: Dynamics>(
    dynamics: &D,
    start: &D::Start,
    steps: usize,
    observers: &mut [&mut dyn Observer<D>],
) -> anyhow::Result<D::Run> {
    let mut run = dynamics.start(start)?;
    go_on(dynamics, &mut run, steps, observers)?;
    Ok(run)
}

/// [`run`] for a run that has already started.
pub fn go_on<D: Dynamics>(
    dynamics: &D,
    run: &mut D::Run,
    steps: usize,
    observers: &mut [&mut dyn Observer<D>],
) -> anyhow::Result<()> {
    loop {
        // Checked before the observers are called, so that one that keeps the state does so before the run ends.
        let stop = interrupt::check();
        let step = dynamics.step(run);
        if step.is_multiple_of(CHECK_EVERY) || step >= steps {
            dynamics.check(run)?;
        }
        for observer in observers.iter_mut() {
            observer.see(dynamics, run)?;
        }
        if step >= steps {
            return Ok(());
        }
        stop?;
        dynamics.advance(run)?;
    }
}
