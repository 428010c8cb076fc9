//! What every run does first.

use crate::adjoint::RunError;
use crate::config::builtin::SCENES;
pub use crate::config::difference::difference;
use crate::config::scene::{Config, Family};
use crate::design::shape::Shape;
use crate::design::Problem;
use crate::error::{BadInput, Error};
use crate::numerics::lanes::Real;
use crate::scene::Scene;
use crate::sph::divergence;
use crate::sph::model::Model;
use crate::sph::solver::Snapshot;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Mutex;
use std::thread::ScopedJoinHandle;

/// Sets the number of worker threads; 0 takes every core. Must come before the first operator: candle's pools read it once.
pub fn use_threads(threads: usize) {
    if threads > 0 {
        // More than that only wait for each other, and the results do not depend on their number.
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = threads.min(2 * cores);
        let threads = threads.to_string();
        std::env::set_var("CANDLE_NUM_THREADS", &threads);
        std::env::set_var("RAYON_NUM_THREADS", &threads);
    }
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

/// An error for scenes without a design.
pub fn require_design(config: &Config) -> Result<(), BadInput> {
    if config.has_design() {
        return Ok(());
    }
    if config.scene == Family::Custom {
        return Err(BadInput::new("the scene names no number of a shape that may change")
            .key("variables")
            .allowed("variables = [{ number = \"shapes[0].radius\", lower = 0.05, upper = 0.1 }] or the like, with objective.kind")
            .advice("data/scenes/examples/cylinder.toml, which has some"));
    }
    let with_design = SCENES.iter().filter(|built_in| built_in.family().has_design());
    let with_design: Vec<&str> = with_design.map(|built_in| built_in.name).collect();
    let name = config.scene.name();
    Err(BadInput::new(format!("scene {name} has no design, so there is nothing to differentiate or optimise"))
        .allowed(format!("a scene with a design: {}", with_design.join(", ")))
        .advice(format!("hydrograd simulate {name}")))
}

/// Builds a scene with a design, and its start shape.
pub fn build<R: Real>(config: &Config) -> Result<(Problem<R>, Shape), Error> {
    require_design(config)?;
    let design = Scene::problem(config)?;
    let design = design.ok_or_else(|| Error::run("a scene with a design has none", "report this"))?;
    let shape = design.first_wall();
    Ok((design, shape))
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
