//! Whether what a design gained is a property of its wall: the gain again, with what it must not depend on changed.
//!
//! A wall is handed over as nodes and offsets, so that it is the same at every spacing, and both walls are run under each
//! [`Check`]: the gain is Q of the best over Q of the reference, less one. What survives is the least of the gains. A gain
//! of a few tenths of a percent that was found at one spacing, or until the end of one run, may be an error of the solver
//! that the optimiser has learned to use.

use super::load::Loaded;
use super::Scene;
use crate::adjoint::RunError;
use crate::config::layers::Setting;
use crate::config::scene::{Config, DesignWalls, Formulation, GradientMode, Motion, Precision};
use crate::design::objectives::Figure;
use crate::design::parametrisations::SplineSurface;
use crate::design::shape::Shape;
use crate::design::Problem;
use crate::error::{BadInput, Error};
use crate::numerics::lanes::Real;
use crate::sph::Sweeps;
use std::time::Instant;

/// What is changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Check {
    /// Nothing: as it was optimised.
    AsOptimised,
    /// Half of `resolution.dx`; in three dimensions, where that is 16 times the work, the largest that fits up to four fifths.
    FinerSpacing,
    /// Fixed particles instead of moving ones, or the reverse.
    OtherMotion,
    /// A run of twice the time, measured over a window of the same length at its end.
    TwiceTime,
    /// The next `run.seed`, with moving particles: fixed ones draw no random numbers.
    OtherSeed,
}

impl Check {
    pub const EACH: [Self; 5] =
        [Self::AsOptimised, Self::FinerSpacing, Self::OtherMotion, Self::TwiceTime, Self::OtherSeed];

    /// Whether there is such a thing for a scene: there are no fixed particles in three dimensions.
    fn is_for(self, config: &Config) -> bool {
        self != Self::OtherMotion || config.dimension() == 2
    }
}

/// A configuration whose walls are compared, and what they are.
#[derive(Debug, Clone)]
pub struct Verification {
    /// The configuration that the best wall was found with.
    pub loaded: Loaded,
    pub reference: Shape,
    pub best: Shape,
    /// What the reference is, in words: `the flat wall`.
    pub reference_name: &'static str,
}

/// What was found of all checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Verified {
    /// What the walls are judged by.
    pub figure: Figure,
    pub reference_name: &'static str,
    pub checks: Vec<Finding>,
    pub seconds: f64,
}

/// What was found of one check.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What was changed, in words.
    pub check: String,
    /// The reference's and the best wall's figure, or why there are none.
    pub figures: Result<(f64, f64), String>,
}

impl Finding {
    /// Best over reference, less one; none if the check failed.
    pub fn gain(&self) -> Option<f64> {
        self.figures.as_ref().ok().map(|(reference, best)| best / reference - 1.0)
    }
}

impl Verified {
    /// The least gain of the checks that ran; none if none did.
    pub fn survives(&self) -> Option<f64> {
        self.checks.iter().filter_map(Finding::gain).reduce(f64::min)
    }

    /// Checks that have no gain to show.
    pub fn failed(&self) -> impl Iterator<Item = &Finding> {
        self.checks.iter().filter(|finding| finding.figures.is_err())
    }
}

/// A check's two configurations, the reference's and the best wall's.
pub type Pair = [Loaded; 2];

impl Verification {
    /// Runs both walls under every check; `progress` sees the share of the work that is done. A check that can not be run
    /// is a finding too.
    ///
    /// # Errors
    /// Walls that the configuration does not allow.
    pub fn run(&self, progress: &mut dyn FnMut(f64)) -> Result<Verified, Error> {
        let clock = Instant::now();
        // A wall that is not allowed as it is fails here, and is no finding.
        for wall in [&self.reference, &self.best] {
            self.loaded.with(&self.wall(wall))?;
        }
        let checks = Check::EACH.into_iter().filter(|check| check.is_for(&self.loaded.config));
        let pairs: Vec<(Check, Result<Pair, Error>)> = checks.map(|check| (check, self.pair(check))).collect();
        let work = |pair: &Result<Pair, Error>| pair.as_ref().map_or(0.0, |[one, _]| work(one));
        let total: f64 = pairs.iter().map(|(_, pair)| work(pair)).sum();
        let mut done = 0.0;
        let mut checks = Vec::new();
        for (check, pair) in pairs {
            let share = work(&pair) / total;
            let mut name = self.describe(check);
            let mut progress = |part: f64| progress((done + part * share).min(1.0));
            let found = pair.map_err(anyhow::Error::from).and_then(|pair| match figures(&pair, &mut progress) {
                // Rough walls may need it, and it is no part of the check.
                Err(error) if error.is::<RunError>() => match slower(&pair).map(|pair| figures(&pair, &mut progress)) {
                    Ok(Ok(found)) => {
                        name.push_str(", half the time step");
                        Ok(found)
                    }
                    _ => Err(error),
                },
                found => found,
            });
            done += share;
            checks.push(Finding { check: name, figures: found.map_err(|e| e.to_string()) });
        }
        let figure = Figure::of_config(&self.loaded.config);
        Ok(Verified { figure, reference_name: self.reference_name, checks, seconds: clock.elapsed().as_secs_f64() })
    }

    /// What a check runs.
    ///
    /// # Errors
    /// What the configuration does not allow.
    pub fn pair(&self, check: Check) -> Result<Pair, Error> {
        let settings = self.settings(check)?;
        let with = |wall: &Shape| self.loaded.with(&[&settings[..], &self.wall(wall)].concat());
        Ok([with(&self.reference)?, with(&self.best)?])
    }

    fn wall(&self, wall: &Shape) -> Vec<Setting> {
        wall_settings(wall, &self.loaded.config)
    }

    /// The keys that a check changes.
    fn settings(&self, check: Check) -> Result<Vec<Setting>, Error> {
        let before = &self.loaded.config;
        let mut after = before.clone();
        let mut settings = Vec::new();
        let mut set = |key: &str, value: &dyn std::fmt::Display| settings.push(Setting::set(&format!("{key}={value}")));
        match check {
            Check::AsOptimised => return Ok(settings),
            Check::FinerSpacing => {
                let dx = before.finer_spacing();
                after.resolution.dx = dx;
                set("resolution.dx", &dx);
                // The standard formulation's walls are as deep as its bound.
                let rows = (before.design.bound / dx - 1e-9).ceil().max(0.0) as usize;
                if before.fluid.formulation == Formulation::Standard && rows > before.channel.wall_rows {
                    set("channel.wall_rows", &rows);
                }
            }
            Check::OtherMotion => {
                if before.fluid.formulation == Formulation::Standard {
                    let problem = "the standard formulation has moving particles only";
                    return Err(BadInput::new(problem).advice("fluid.formulation=consistent").into());
                }
                after.fluid.motion = before.fluid.motion.other();
                set("fluid.motion", &after.fluid.motion.name());
            }
            Check::TwiceTime => after.time.end = 2.0 * before.duration(),
            Check::OtherSeed => {
                after.fluid.motion = Motion::Moving;
                set("run.seed", &next_seed(before.run.seed));
                if before.fluid.motion != Motion::Moving {
                    set("fluid.motion", &Motion::Moving.name());
                }
            }
        }
        // Moving particles have no steady state to take a gradient of (none is taken here, but the key must fit).
        if after.fluid.motion == Motion::Moving && before.optimise.gradient == GradientMode::Steady {
            set("optimise.gradient", &"segments");
        }
        // Each motion has a time step of its own, which the loader knows; for the samples the longer one will do.
        if after.fluid.motion == Motion::Moving {
            after.time.cfl = after.time.cfl.max(Config::default().time.cfl);
        }
        // A number of steps is another time with other steps.
        if check == Check::TwiceTime || before.time.steps.is_some() {
            if check != Check::TwiceTime {
                after.time.end = before.duration();
            }
            after.time.steps = None;
            set("time.end", &after.time.end);
        }
        // A window of the same length has a few steps more or less; as many samples as before, if it has so many.
        let window = before.objective.window;
        let steps = (window / after.time_step() - 1e-9).ceil().max(1.0) as usize;
        if window > 0.0 {
            set("objective.window", &window);
            set("objective.samples", &before.objective.samples.min(steps));
        }
        Ok(settings)
    }

    /// What a check changes, in words.
    pub fn describe(&self, check: Check) -> String {
        let config = &self.loaded.config;
        match check {
            Check::AsOptimised => "as optimised".into(),
            Check::FinerSpacing => match config.dimension() {
                2 => format!("half the spacing ({})", rounded(config.finer_spacing())),
                _ => format!("a finer spacing ({})", rounded(config.finer_spacing())),
            },
            Check::OtherMotion => format!("{} particles", config.fluid.motion.other().name()),
            Check::TwiceTime => format!("twice the time ({})", rounded(2.0 * config.duration())),
            Check::OtherSeed => match config.fluid.motion {
                Motion::Moving => format!("another seed ({})", next_seed(config.run.seed)),
                Motion::Fixed => format!("moving particles, another seed ({})", next_seed(config.run.seed)),
            },
        }
    }
}

/// A seed that TOML can hold.
fn next_seed(seed: u64) -> u64 {
    if seed < i64::MAX as u64 {
        seed + 1
    } else {
        0
    }
}

/// A length or a time without the digits of rounding.
fn rounded(x: f64) -> String {
    let text = format!("{x:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// The keys of a wall.
pub fn wall_settings(wall: &Shape, config: &Config) -> Vec<Setting> {
    if let Some(across) = &wall.across {
        let points = SplineSurface::of_config(config, &[]).fitted(&wall.nodes, across, &wall.offsets);
        return vec![Setting::set(&format!("design.offsets={points:?}"))];
    }
    let mut settings = vec![
        format!("design.nodes={:?}", wall.nodes),
        format!("design.offsets={:?}", wall.offsets),
        "design.parametrisation=nodes".to_string(),
    ];
    if wall.top.is_some() || config.design.walls == DesignWalls::Both {
        // A wall without a top has a flat one, whatever the scene's is.
        settings.push(format!("design.top_offsets={:?}", wall.top_wall().offsets));
        settings.push("design.walls=both".to_string());
    }
    settings.iter().map(|text| Setting::set(text)).collect()
}

/// Particles times steps: what a run costs.
fn work(loaded: &Loaded) -> f64 {
    let config = &loaded.config;
    (config.columns() * (config.rows() + 2 * config.channel.wall_rows) * config.layers() * config.steps()) as f64
}

/// The same runs with half the time step.
fn slower(pair: &Pair) -> Result<Pair, Error> {
    let half = |loaded: &Loaded| {
        let time = &loaded.config.time;
        let halves = [("time.cfl", time.cfl), ("time.diffusion_number", time.diffusion_number)];
        let halves = halves.map(|(key, value)| Setting::set(&format!("{key}={}", 0.5 * value)));
        loaded.with(&halves.into_iter().chain(loaded.same_time()).collect::<Vec<_>>())
    };
    Ok([half(&pair[0])?, half(&pair[1])?])
}

/// The figures of a check's walls.
fn figures(pair: &Pair, progress: &mut dyn FnMut(f64)) -> anyhow::Result<(f64, f64)> {
    let mut half = |loaded: &Loaded, first: f64| {
        let progress: &mut dyn FnMut(f64) = &mut |part| progress(first + 0.5 * part);
        match loaded.config.run.precision {
            Precision::F32 => figure::<f32>(loaded, progress),
            Precision::F64 => figure::<f64>(loaded, progress),
        }
    };
    let (reference, best) = (half(&pair[0], 0.0)?, half(&pair[1], 0.5)?);
    if !(reference > 0.0 && reference.is_finite() && best.is_finite()) {
        anyhow::bail!("the figures are {reference} and {best}: there is no gain over these");
    }
    Ok((reference, best))
}

/// The figure of a configuration's own wall.
fn figure<R: Sweeps>(loaded: &Loaded, progress: &mut dyn FnMut(f64)) -> anyhow::Result<f64> {
    let problem = problem::<R>(loaded)?;
    Ok(problem.evaluate_watched(&problem.first, progress)? * problem.figure.factor)
}

fn problem<R: Real>(loaded: &Loaded) -> Result<Problem<R>, Error> {
    let design = Scene::from_config(&loaded.config)?.design;
    design.ok_or_else(|| Error::run("a scene without a design has no wall to verify", "the scene heated-channel"))
}
