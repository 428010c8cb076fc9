//! The search for better shapes with fixed particles around them: exact gradients, limits, and a cloud that is made anew.
//!
//! In each round the particles follow the shapes from where they were placed, by no more than a share of a shape's size;
//! then they are placed anew, the same shapes are judged again (the jump is the error of the cloud, and is recorded),
//! and [`crate::design::sqp`] goes on from there.

use super::around_flow::Designed;
use super::around_shapes::Judged;
use crate::config::custom::Part;
use crate::config::scene::Config;
use crate::design::parametrisations::numbers::Numbers;
use crate::design::sqp::{Limited, Point, Sqp};
use crate::error::Error;
use crate::numerics::interrupt;
use std::f64::consts::PI;
use std::time::Instant;

/// One evaluated design.
#[derive(Debug, Clone, PartialEq)]
pub struct Epoch {
    pub variables: Vec<f64>,
    /// NaN where there is no flow.
    pub objective: f64,
    pub gradient_norm: f64,
    /// The largest excess of a limit, in the limit.
    pub excess: f64,
    pub seconds: f64,
    /// Number of clouds that were made before.
    pub round: usize,
    pub failure: Option<String>,
}

impl Epoch {
    /// Whether it is a better design than another one: one with a flow, then one that holds its limits, then one with
    /// the larger `sign` times objective, or with the smaller excess of a limit.
    pub fn is_better(&self, other: &Self, sign: f64) -> bool {
        let rank = |epoch: &Self| match epoch {
            Self { failure: Some(_), .. } => (0, 0.0),
            Self { excess, .. } if *excess > HELD => (1, -excess),
            Self { objective, .. } => (2, sign * objective),
        };
        rank(self) > rank(other)
    }
}

/// A finished search.
#[derive(Debug)]
pub struct Found {
    pub history: Vec<Epoch>,
    pub best: usize,
    /// The largest relative jump of the objective where particles were placed anew.
    pub jump: f64,
    /// Whether it ended because nothing better is near, and not for lack of epochs.
    pub converged: bool,
    /// Why particles could not be placed around the shapes that were found, where the search had to end.
    pub stopped: Option<String>,
}

/// How far a shape moves before particles are placed anew, in its own size; of angles in radians.
const TRUST: f64 = 0.12;
/// A limit that is exceeded by less counts as held.
pub const HELD: f64 = 1e-3;
/// Rounds end when the objective changes by less from one to the next.
const SETTLED: f64 = 2e-4;

/// The limits of the configuration as functions that are at most 0, or 0.
struct Limit {
    /// Its index among those of the configuration.
    entry: usize,
    /// +1 for `at_most`, -1 for `at_least`.
    sign: f64,
    bound: f64,
    is_equation: bool,
}

fn limits(config: &Config) -> Vec<Limit> {
    let mut all = vec![];
    for (k, entry) in config.limits.iter().enumerate() {
        let limit = |sign: f64, bound: f64, is_equation: bool| Limit { entry: k, sign, bound, is_equation };
        match (entry.at_least, entry.at_most) {
            (Some(low), Some(high)) if low == high => all.push(limit(1.0, low, true)),
            (low, high) => {
                all.extend(low.map(|low| limit(-1.0, low, false)));
                all.extend(high.map(|high| limit(1.0, high, false)));
            }
        }
    }
    all
}

/// A search of a configuration.
pub struct Search<'a> {
    pub config: &'a Config,
    around: Box<dyn Designed>,
    limits: Vec<Limit>,
    /// The objective of the first design, in which the others are measured.
    unit: f64,
    numbers: Numbers,
    width: Vec<f64>,
}

impl<'a> Search<'a> {
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(config: &'a Config) -> Result<Self, Error> {
        let around = <dyn Designed>::of_config(config)?;
        let width = config.variables.iter().map(|variable| variable.upper - variable.lower).collect();
        Ok(Self { config, around, limits: limits(config), unit: 0.0, numbers: Numbers::of_config(config), width })
    }

    /// How far each variable may move in a round, in its width.
    fn trust(&self) -> Vec<f64> {
        let of = |k: usize| {
            let most = match self.around.part(k) {
                (Part::Angle, _) => TRUST * 180.0 / PI,
                (Part::Parameter(_), _) => self.width[k],
                (_, size) => TRUST * size,
            };
            most / self.width[k]
        };
        (0..self.width.len()).map(of).collect()
    }

    /// Objective, limits and their derivatives at variables between 0 and 1.
    fn judge(&mut self, x: &[f64], progress: &mut dyn FnMut(f64)) -> Result<(f64, Point), Error> {
        let variables = self.numbers.values(x);
        let entries: Vec<usize> = self.limits.iter().map(|limit| limit.entry).collect();
        let (Judged { value: objective, by_variables }, of_limits) =
            self.around.judge(&variables, &entries, progress)?;
        if self.unit == 0.0 {
            self.unit = objective.abs().max(f64::MIN_POSITIVE);
        }
        let factor = self.factor();
        let scaled = |gradient: Vec<f64>, factor: f64, width: &[f64]| -> Vec<f64> {
            gradient.iter().zip(width).map(|(g, width)| factor * g * width).collect()
        };
        let gradient = scaled(by_variables, factor, &self.width);
        let mut limited = vec![];
        for (limit, Judged { value, by_variables }) in self.limits.iter().zip(of_limits) {
            let Limit { sign, bound, is_equation, .. } = *limit;
            let factor = sign / bound.abs().max(1e-12);
            limited.push(Limited {
                value: factor * (value - bound),
                gradient: scaled(by_variables, factor, &self.width),
                is_equation,
            });
        }
        Ok((objective, Point { x: x.to_vec(), value: factor * objective, gradient, limits: limited }))
    }

    /// Searches for at most `epochs` evaluations; `watch` is called after each, and `progress` with the share of a flow in time.
    ///
    /// # Errors
    /// A first design that cannot be judged; [`Error::Stopped`].
    pub fn run(
        &mut self,
        epochs: usize,
        watch: &mut dyn FnMut(&Epoch, usize),
        progress: &mut dyn FnMut(f64),
    ) -> Result<Found, Error> {
        let mut history: Vec<Epoch> = vec![];
        let (mut best, mut jump, mut converged) = (0, 0.0f64, false);
        let first = self.numbers.start();
        let bounds = |x: &[f64], trust: &[f64]| -> (Vec<f64>, Vec<f64>) {
            let of = |sign: f64| x.iter().zip(trust).map(|(x, t)| (x + sign * t).clamp(0.0, 1.0)).collect();
            (of(-1.0), of(1.0))
        };
        let (lower, upper) = bounds(&first, &self.trust());
        let mut sqp = Sqp::new(&first, &lower, &upper);
        let (mut round, mut of_last_round, mut stopped) = (0, f64::NAN, None);
        while history.len() < epochs {
            let clock = Instant::now();
            let x = sqp.ask().to_vec();
            let found = self.judge(&x, progress);
            let variables = self.numbers.values(&x);
            let mut epoch = Epoch {
                variables,
                objective: f64::NAN,
                gradient_norm: f64::NAN,
                excess: 0.0,
                seconds: 0.0,
                round,
                failure: None,
            };
            let point = match found {
                Ok((objective, point)) => {
                    let by = |k: usize| point.gradient[k] * self.unit / self.width[k];
                    epoch.objective = objective;
                    epoch.gradient_norm = (0..x.len()).map(|k| by(k).powi(2)).sum::<f64>().sqrt();
                    epoch.excess = point.limits.iter().map(Limited::excess).fold(0.0, f64::max);
                    Some(point)
                }
                Err(Error::Diverged { problem, .. } | Error::Run { problem, .. }) if !history.is_empty() => {
                    epoch.failure = Some(problem);
                    None
                }
                Err(error) => return Err(error),
            };
            epoch.seconds = clock.elapsed().as_secs_f64();
            if !of_last_round.is_nan() && history.last().is_some_and(|last| last.round < round) {
                jump = f64::max(jump, (epoch.objective / of_last_round - 1.0).abs());
            }
            history.push(epoch);
            let last = history.len() - 1;
            if history[last].is_better(&history[best], self.config.objective.goal.sign()) {
                best = last;
            }
            watch(&history[last], last);
            interrupt::check()?;
            sqp.tell(point);
            if sqp.is_done() {
                let Some(at) = sqp.best().cloned() else { break };
                let now = at.value / self.factor();
                let excess = at.limits.iter().map(Limited::excess).fold(0.0, f64::max);
                if ((now - of_last_round) / self.unit).abs() < SETTLED && excess <= HELD {
                    converged = true;
                    break;
                }
                of_last_round = now;
                // Particles are placed anew around the shapes where they are.
                let placed = self.config.with_shape_values(&self.numbers.values(&at.x));
                match <dyn Designed>::of_config(&placed) {
                    Ok(around) => self.around = around,
                    Err(error) => {
                        stopped = Some(error.to_string());
                        break;
                    }
                }
                round += 1;
                let (lower, upper) = bounds(&at.x, &self.trust());
                sqp.renew(&lower, &upper);
            }
        }
        Ok(Found { history, best, jump, converged, stopped })
    }

    /// What makes an objective a number of about 1 that is to become smaller.
    fn factor(&self) -> f64 {
        -self.config.objective.goal.sign() / self.unit
    }
}
