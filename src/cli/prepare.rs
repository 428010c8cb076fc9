//! Common preparations of runs.

use super::guard;
use crate::adjoint::RunError;
use crate::config::device::{Compute, DeviceName};
pub use crate::config::difference::difference;
use crate::config::scene::Kernels;
use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::numerics::ranks::Ranks;
use crate::numerics::threads::{self, available, cores, in_words};
use crate::scene::load::Loaded;
use crate::scene::record::relative_change;
pub use crate::scene::{build_design as build, require_design};
use crate::sph::divergence;
use crate::sph::solver::Snapshot;
use crate::sph::Model;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::ScopedJoinHandle;

/// Sets the number of threads, as [`threads::use_threads`] does, and warns of more than there are cores for.
pub fn use_threads(threads: usize) {
    threads::use_threads(threads);
    let (asked, cores) = (threads.max(threads::count()), cores());
    if asked > cores {
        let problem = format!("{} on {cores} core(s): no faster", in_words(asked));
        guard::warn(&problem, &format!("run.threads={cores}, or 0 (every core that the process may use)"));
    }
}

/// The same for one of several ranks, which share the cores of their machine.
pub fn use_threads_of(ranks: &Ranks, threads: usize) {
    use_threads(threads_of(ranks, threads));
}

/// Threads of one of several ranks; 0 where there is one process and nobody gave a number.
pub fn threads_of(ranks: &Ranks, threads: usize) -> usize {
    if threads == 0 {
        ranks.threads().unwrap_or(0)
    } else {
        threads
    }
}

/// Opens the device of a configuration, before anything is written.
pub fn open_device(loaded: &Loaded) -> Result<(), BadInput> {
    loaded.config.run.compute().map(drop).map_err(|bad| loaded.located(bad))
}

/// Checks the device of a command that runs only on the CPU.
pub fn require_cpu(loaded: &Loaded, command: &str) -> Result<(), BadInput> {
    match loaded.config.run.device {
        DeviceName::Cpu => Ok(()),
        device => Err(loaded.located(
            BadInput::new(format!("{command} runs on the CPU, not on {device}")).key("run.device").allowed("cpu"),
        )),
    }
}

/// Kernels and device by `--kernels` and `--device`, for commands without these keys.
pub fn compute(kernels: Kernels, device: DeviceName) -> Result<Compute, BadInput> {
    let opened = device.open().map_err(|bad| bad.located(|_| Some(format!("--device {device}"))))?;
    Ok(Compute::new(kernels, opened))
}

/// Number of workers for some jobs: `threads` (0: the number of cores), and at most the number of jobs.
pub fn workers(threads: usize, jobs: usize) -> usize {
    if threads > 0 { threads } else { available() }.min(jobs).max(1)
}

/// The results of `work` for all jobs, in order, by several workers. After an error no further job is started.
///
/// # Errors
/// The first error of `work`.
pub fn share_out<J: Sync, T: Send>(
    workers: usize,
    jobs: &[J],
    work: impl Fn(&J) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let next = AtomicUsize::new(0);
    let turn = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return done };
            let result = work(job);
            if result.is_err() {
                next.store(jobs.len(), Ordering::Relaxed);
            }
            done.push((number, result));
        }
    };
    let mut done: Vec<(usize, anyhow::Result<T>)> = std::thread::scope(|scope| {
        let begun: Vec<_> = (0..workers).map(|_| scope.spawn(turn)).collect();
        let end = |worker: ScopedJoinHandle<'_, _>| worker.join().unwrap_or_else(|panic| resume_unwind(panic));
        begun.into_iter().flat_map(end).collect()
    });
    done.sort_unstable_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Converts the error of a run that failed after a good state; other errors stay the same.
pub fn diverged<'a, R: Real>(
    model: &'a Model<R>,
    good: &'a Snapshot<R>,
) -> impl Fn(anyhow::Error) -> anyhow::Error + 'a {
    move |error| match error.downcast::<RunError>() {
        Ok(error) => divergence::told(&error, model, good).into(),
        Err(error) => error,
    }
}

/// A change in the form `a -> b (+1.2 %)`.
pub fn change(before: f64, after: f64) -> String {
    format!("{before:.6} -> {after:.6} ({:+.2} %)", 100.0 * relative_change(before, after))
}
