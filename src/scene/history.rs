//! Figures of a flow around shapes over time, and how they go through a part of it.

use super::around_shapes::check_finite;
use super::periods::Window;
use crate::config::scene::Config;
use crate::error::Error;
use crate::numerics::curve::rises;
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::problem::Gradient;

/// The figures of one time, in the order of [`History::figures`].
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    pub time: f64,
    pub values: Vec<f64>,
    /// NaN in a scene without one.
    pub objective: f64,
    /// What each of `limits` is about; NaN for those that are about shapes alone.
    pub limits: Vec<f64>,
}

/// What is told each moment with its flow, and may stop a run.
pub type Watch<'a, S> = &'a mut dyn FnMut(&Moment, &S) -> Result<(), Error>;

/// Figures over time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct History {
    pub figures: Vec<(String, Figure)>,
    pub moments: Vec<Moment>,
    /// Sizes of steps.
    pub sizes: Vec<f64>,
    pub factorisations: usize,
}

/// How a figure goes through a part of a history.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Course {
    pub mean: f64,
    pub least: f64,
    pub most: f64,
    /// Of crossings of its mean, upwards; none with fewer than two of them.
    pub frequency: Option<f64>,
}

impl History {
    pub fn times(&self) -> Vec<f64> {
        self.moments.iter().map(|moment| moment.time).collect()
    }

    pub fn values(&self, value: &dyn Fn(&Moment) -> f64) -> Vec<f64> {
        self.moments.iter().map(value).collect()
    }

    /// A figure in a window; `value` takes it from a moment. Means are over time.
    pub fn course(&self, window: &Window, value: &dyn Fn(&Moment) -> f64) -> Course {
        let values = self.values(value);
        let mean = window.mean(&values);
        // Whole periods end between moments, so those beside belong to them.
        let beside = usize::from(!window.periods.is_empty());
        let last = values.len().saturating_sub(1);
        let first = self.moments.iter().position(|moment| moment.time >= window.from).unwrap_or(last);
        let end = self.moments.iter().rposition(|moment| moment.time <= window.to).unwrap_or(last);
        let first = first.saturating_sub(beside);
        let part = &values[first..=(end + beside).min(last)];
        let least = part.iter().copied().fold(f64::INFINITY, f64::min);
        let most = part.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let crossing = |j: usize| {
            let [before, after] = [&self.moments[first + j], &self.moments[first + j + 1]];
            before.time + (mean - part[j]) / (part[j + 1] - part[j]) * (after.time - before.time)
        };
        let crossings: Vec<f64> = rises(part, mean, 0.1 * (most - least)).into_iter().map(crossing).collect();
        let frequency = match (crossings.first(), crossings.last()) {
            (Some(first), Some(last)) if crossings.len() > 1 => Some((crossings.len() - 1) as f64 / (last - first)),
            _ => None,
        };
        Course { mean, least, most, frequency }
    }

    /// The mean objective in a window.
    pub fn objective(&self, window: &Window) -> f64 {
        window.mean(&self.values(&|moment| moment.objective))
    }

    /// The course of a figure by its index.
    pub fn of(&self, window: &Window, k: usize) -> Course {
        self.course(window, &|moment| moment.values[k])
    }
}

/// What of a flow in time is differentiated: the mean over a window of the objective, or of what a limit is about, by its index; or the
/// sum of the velocities on `output.grid` at the end, times these weights, `[points, D]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Of<'a> {
    Objective,
    Limit(usize),
    Grid(&'a [f64]),
}

/// The derivative by all that a flow is a function of.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivative {
    pub by_variables: Vec<f64>,
    /// By `fluid.viscosity`, where it is wanted.
    pub by_viscosity: Option<f64>,
    /// By the velocity that a grid gave at the start, `[points, D]`.
    pub by_start: Option<Vec<f64>>,
}

impl Derivative {
    /// That of a steady flow, in the units of a configuration.
    ///
    /// # Errors
    /// One that is not finite.
    pub fn of_steady(config: &Config, found: Gradient) -> Result<Self, Error> {
        check_finite(config, &found.by_numbers)?;
        let by_viscosity = Some(found.by_viscosity / config.fluid.density);
        Ok(Self { by_variables: found.by_numbers, by_viscosity, by_start: None })
    }
}
