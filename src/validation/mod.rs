//! Scenes against their exact solutions and independent references: what `hydrograd validate` runs.
//!
//! A [`Case`] is a scene whose answer is known, a quantity that is compared ([`measure`]), the resolutions that it runs at and
//! what each must reach; every run is done in double and in single precision. The cases are a table, [`cases::all`].

pub mod benchmark;
pub mod cases;
pub mod found;
pub mod measure;
pub mod probe;
pub mod reference;
pub mod stress;

pub use cases::Case;
pub use found::{Curve, Found, Progress};
pub use measure::Measure;

use crate::config::scene::Config;
use crate::numerics::interrupt;
use crate::scene::load::Loaded;
use crate::scene::Scene;
use crate::sph::Sweeps;
use benchmark::Benchmark;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// One resolution of a case, run in both precisions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub case: String,
    pub quantity: String,
    pub reference: String,
    /// Particle spacing.
    pub dx: f64,
    pub particles: usize,
    pub steps: usize,
    /// In double precision; none if the run did not get to its end.
    pub error: Option<f64>,
    /// In single precision.
    pub error_f32: Option<f64>,
    /// ln(error / error of the row before) / ln(dx / its dx), of the same case.
    pub order: Option<f64>,
    pub tolerance: f64,
    /// Wall time of the run in double precision.
    pub seconds: f64,
    pub seconds_f32: f64,
    /// Whether both errors are within the tolerance.
    pub passed: bool,
    /// Why a run did not get to its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<String>,
}

/// Everything that was found of one case.
#[derive(Debug, Clone)]
pub struct Validated {
    pub case: Case,
    pub rows: Vec<Row>,
    /// Of the finest run in double precision, the reference's last.
    pub curves: Vec<Curve>,
}

impl Case {
    /// The resolutions that it runs at.
    pub fn levels_of(&self, quick: bool) -> impl Iterator<Item = &cases::Level> {
        self.levels.iter().filter(move |level| level.is_quick || !quick)
    }

    /// Runs the case at its resolutions; `quick`: at those that take little time. `progress` sees the share of the work done.
    ///
    /// # Errors
    /// A configuration that is not allowed, which is a mistake in the table.
    pub fn run(&self, quick: bool, progress: Progress) -> anyhow::Result<Validated> {
        let loaded = |precision: &str, level: &cases::Level| {
            let mut settings: Vec<String> =
                [self.settings, level.settings].concat().iter().map(|s| s.to_string()).collect();
            settings.push(format!("run.precision={precision}"));
            settings.push("output.frames=0".into());
            Config::load(Some(self.scene), None, &settings)
        };
        let mut runs = Vec::new();
        for level in self.levels_of(quick) {
            let double = loaded("f64", level)?;
            let work =
                double.config.steps() as f64 / double.config.resolution.dx.powi(double.config.dimension() as i32);
            runs.push((level, work, double, loaded("f32", level)?));
        }
        let (total, mut done) = (runs.iter().map(|run| run.1).sum::<f64>(), 0.0);
        let (mut rows, mut curves) = (Vec::<Row>::new(), Vec::new());
        for (level, work, double, single) in &runs {
            let error = |run: &Attempt| run.found.as_ref().ok().map(|found| found.error);
            let within = |run: &Attempt| error(run).is_some_and(|error| error <= level.tolerance);
            let (double, single) = match self.measure {
                // Fixed particles around shapes compute in double precision only.
                Measure::Published(benchmark) => {
                    let share = work / total;
                    let run = published(double, benchmark, &mut |part| progress(done + part * share))?;
                    done += share;
                    (run, None)
                }
                measure => {
                    let half = 0.5 * work / total;
                    let double = attempt::<f64>(double, measure, &mut |part| progress(done + part * half))?;
                    done += half;
                    let single = attempt::<f32>(single, measure, &mut |part| progress(done + part * half))?;
                    done += half;
                    (double, Some(single))
                }
            };
            let order = rows
                .last()
                .zip(error(&double))
                .and_then(|(before, error)| Some((before.error? / error).ln() / (before.dx / double.dx).ln()));
            rows.push(Row {
                case: self.name.into(),
                quantity: self.quantity.into(),
                reference: self.reference.into(),
                dx: double.dx,
                particles: double.particles,
                steps: double.steps,
                error: error(&double),
                error_f32: single.as_ref().and_then(error),
                order: order.filter(|order| order.is_finite()),
                tolerance: level.tolerance,
                seconds: double.seconds,
                seconds_f32: single.as_ref().map_or(0.0, |single| single.seconds),
                passed: within(&double) && single.as_ref().is_none_or(within),
                failure: double
                    .found
                    .as_ref()
                    .err()
                    .or(single.as_ref().and_then(|run| run.found.as_ref().err()))
                    .cloned(),
            });
            if let Ok(found) = double.found {
                curves = found.curves;
            }
        }
        Ok(Validated { case: self.clone(), rows, curves })
    }
}

/// One run.
struct Attempt {
    dx: f64,
    particles: usize,
    steps: usize,
    seconds: f64,
    /// Or why there is nothing.
    found: Result<Found, String>,
}

/// What was found, if it is a number; else why not.
fn finite(found: anyhow::Result<Found>) -> Result<Found, String> {
    found.map_err(|error| error.to_string()).and_then(|found| match found.error.is_finite() {
        true => Ok(found),
        false => Err(format!("the error is {}", found.error)),
    })
}

fn published(loaded: &Loaded, benchmark: Benchmark, progress: Progress) -> anyhow::Result<Attempt> {
    let clock = Instant::now();
    let done = benchmark.take(&loaded.config, progress);
    interrupt::check()?;
    let (particles, steps) = done.as_ref().map_or((0, 0), |done| (done.particles, done.steps));
    let found = finite(done.map(|done| done.found));
    Ok(Attempt { dx: loaded.config.resolution.dx, particles, steps, seconds: clock.elapsed().as_secs_f64(), found })
}

fn attempt<R: Sweeps>(loaded: &Loaded, measure: Measure, progress: Progress) -> anyhow::Result<Attempt> {
    let scene = Scene::<R>::from_config(&loaded.config)?;
    let clock = Instant::now();
    let found = measure.take(loaded, &scene, progress);
    // Not a failure of the case.
    interrupt::check()?;
    let seconds = clock.elapsed().as_secs_f64();
    let found = finite(found);
    let particles = scene.model.particles();
    Ok(Attempt { dx: scene.spacing, particles, steps: scene.steps, seconds, found })
}
