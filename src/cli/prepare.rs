//! What every run does first.

use crate::adjoint::RunError;
use crate::config::device::{Compute, DeviceName};
pub use crate::config::difference::difference;
use crate::config::scene::Kernels;
use crate::error::BadInput;
use crate::numerics::lanes::Real;
pub use crate::numerics::threads::use_threads;
use crate::scene::load::Loaded;
pub use crate::scene::{build_design as build, require_design};
use crate::sph::divergence;
use crate::sph::model::Model;
use crate::sph::solver::Snapshot;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Mutex;
use std::thread::ScopedJoinHandle;

/// Opens the device that a configuration names, before anything is written.
///
/// # Errors
/// A build or a machine without it.
pub fn open_device(loaded: &Loaded) -> Result<(), BadInput> {
    let opened = loaded.config.run.compute().map(drop);
    opened.map_err(|bad| bad.located(|key| loaded.place(key).map(str::to_owned)))
}

/// For a command that runs on the CPU alone.
///
/// # Errors
/// A configuration that names another device.
pub fn require_cpu(loaded: &Loaded, command: &str) -> Result<(), BadInput> {
    match loaded.config.run.device {
        DeviceName::Cpu => Ok(()),
        device => Err(BadInput::new(format!("{command} runs on the CPU, not on {device}"))
            .key("run.device")
            .allowed("cpu")
            .located(|key| loaded.place(key).map(str::to_owned))),
    }
}

/// What `--kernels` and `--device` ask for, where they stand for no key.
///
/// # Errors
/// As for [`open_device`].
pub fn compute(kernels: Kernels, device: DeviceName) -> Result<Compute, BadInput> {
    let opened = device.open().map_err(|bad| bad.located(|_| Some(format!("--device {device}"))))?;
    Ok(Compute::new(kernels, opened))
}

/// Workers that share out some jobs: as many as `threads` (0: as there are cores), and no more than there are jobs.
pub fn workers(threads: usize, jobs: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if threads > 0 { threads } else { cores }.min(jobs).max(1)
}

/// What `work` makes of each of the jobs, in their order, by several workers. After an error no job is begun any more.
///
/// # Errors
/// The first of `work`.
pub fn share_out<J: Sync, T: Send>(
    workers: usize,
    jobs: &[J],
    work: impl Fn(&J) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let (next, failed) = (AtomicUsize::new(0), Mutex::new(None));
    let turn = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return done };
            match work(job) {
                Ok(result) => done.push((number, result)),
                Err(problem) => {
                    next.store(jobs.len(), Ordering::Relaxed);
                    failed.lock().unwrap_or_else(|e| e.into_inner()).get_or_insert(problem);
                }
            }
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let begun: Vec<_> = (0..workers).map(|_| scope.spawn(turn)).collect();
        let end = |worker: ScopedJoinHandle<'_, _>| worker.join().unwrap_or_else(|panic| resume_unwind(panic));
        begun.into_iter().flat_map(end).collect()
    });
    match failed.into_inner().unwrap_or_else(|e| e.into_inner()) {
        Some(problem) => Err(problem),
        None => {
            done.sort_unstable_by_key(|(number, _)| *number);
            Ok(done.into_iter().map(|(_, result)| result).collect())
        }
    }
}

/// What a user is told of a run that failed after a state that was good; other errors as they are.
pub fn diverged<'a, R: Real>(
    model: &'a Model<R>,
    good: &'a Snapshot<R>,
) -> impl Fn(anyhow::Error) -> anyhow::Error + 'a {
    move |error| match error.downcast::<RunError>() {
        Ok(error) => divergence::told(&error, model, good).into(),
        Err(error) => error,
    }
}

/// `a -> b (+1.2 %)`.
pub fn change(before: f64, after: f64) -> String {
    format!("{before:.6} -> {after:.6} ({:+.2} %)", 100.0 * (after / before - 1.0))
}
