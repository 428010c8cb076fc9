//! The part of a run that figures are averaged over: the last time of it, or the last whole periods of a flow.
//!
//! A mean over whole periods has no error of where it begins, and its derivative is that of the periodic flow. With g the
//! [curve](crate::numerics::curve) of a figure through its values after each step, and a and b the ends of the periods,
//!
//! ```text
//!   M = 1 / (b - a) * integral of g from a to b,     dM = (sum of the weights of values times their change)
//!                                                          + (M - g(a)) / (b - a) da + (g(b) - M) / (b - a) db.
//! ```
//!
//! The ends lie between steps. Of a period T that is given b is the last time, and a = b - n T moves with the variables that T
//! depends on: that is what a forced flow's frequency as a variable needs. Otherwise a and b are times at which the
//! objective rises through its mean m of the run's last half, so that with w(m), w(c) the weights of m and of g(c)
//!
//! ```text
//!   dc = (sum of (w(m) - w(c)) times the change of values) / g'(c).
//! ```
//!
//! Vortices that no force keeps in time change their period with every number of the shape, and the values at a time t change by t
//! times as much; these two terms cancel in the exact derivative of the mean, and only there (Krakos, Wang, Hall and Darmofal
//! 2012, Journal of Computational Physics 231).

use crate::numerics::curve::{rises, sum, Curve};

/// Crossings of a mean count after the curve was below it by this share of its width.
const BAND: f64 = 0.1;
/// A figure whose width is a smaller share of its mean does not oscillate: what is left is rounding.
const STILL: f64 = 1e-6;

/// A period that is given, with its derivative by every variable.
#[derive(Debug, Clone, PartialEq)]
pub struct Period {
    pub length: f64,
    pub by_variables: Vec<f64>,
}

/// A part of a run, and how means over it depend on what they are taken of.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Window {
    pub from: f64,
    pub to: f64,
    /// Of each moment its weight in a mean.
    pub weights: Vec<f64>,
    /// The beginnings of whole periods, and the end of the last; empty for a window of a given time.
    pub periods: Vec<f64>,
    /// Of both ends the derivative by the objective at each moment, if they depend on it.
    ends: Option<[Vec<f64>; 2]>,
    /// Of the beginning, by every variable.
    by_variables: Vec<f64>,
}

/// The derivative of a mean by the figure's values at each moment, by the objective's (which say where periods end), and by variables.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Slopes {
    pub by_values: Vec<f64>,
    pub by_objective: Vec<f64>,
    pub by_variables: Vec<f64>,
}

/// Why there are no whole periods: those that the run has, or that fit into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooFew(pub usize);

impl Window {
    /// From a time on to the last, by trapezes; the last moment if rounding has put it before that.
    pub fn since(times: &[f64], from: f64) -> Self {
        // Times are sums of steps: whether a moment at the beginning counts must not hang on their rounding.
        let from = from - 1e-9 * times.last().copied().unwrap_or(from).abs();
        let first = times.iter().position(|&time| time >= from).unwrap_or(times.len().saturating_sub(1));
        let mut weights = vec![0.0; times.len()];
        for k in first + 1..times.len() {
            let half = 0.5 * (times[k] - times[k - 1]);
            weights[k - 1] += half;
            weights[k] += half;
        }
        let total: f64 = weights.iter().sum();
        match weights.last_mut() {
            Some(last) if total == 0.0 => *last = 1.0,
            _ => weights.iter_mut().for_each(|weight| *weight /= total),
        }
        Self { from, to: times.last().copied().unwrap_or(from), weights, ..Self::default() }
    }

    fn between(curve: Curve, periods: Vec<f64>) -> Self {
        let (from, to) = (periods[0], periods[periods.len() - 1]);
        let weights = curve.integral(from, to).into_iter().map(|weight| weight / (to - from)).collect();
        Self { from, to, weights, periods, ..Self::default() }
    }

    /// The last `count` periods of a length.
    ///
    /// # Errors
    /// A run that is shorter.
    pub fn of_length(times: &[f64], count: usize, period: &Period) -> Result<Self, TooFew> {
        let curve = Curve::new(times).ok_or(TooFew(0))?;
        let end = times[times.len() - 1];
        let most = ((end - times[0]) / period.length).floor().max(0.0) as usize;
        if most < count {
            return Err(TooFew(most));
        }
        let periods = (0..=count).rev().map(|k| end - k as f64 * period.length).collect();
        let by_variables = period.by_variables.iter().map(|by| -(count as f64) * by).collect();
        Ok(Self { by_variables, ..Self::between(curve, periods) })
    }

    /// The last `count` periods of an objective, between times at which it rises through its mean of the last half.
    ///
    /// # Errors
    /// Fewer periods.
    pub fn of_course(times: &[f64], objective: &[f64], count: usize) -> Result<Self, TooFew> {
        let curve = Curve::new(times).ok_or(TooFew(0))?;
        let end = times[times.len() - 1];
        let half = Self::between(curve, vec![(0.5 * end).max(times[0]), end]);
        let level = sum_of(&half.weights, objective);
        let late = || objective.iter().zip(times).filter(|(_, &time)| time >= half.from).map(|(value, _)| *value);
        let width = late().fold(f64::NEG_INFINITY, f64::max) - late().fold(f64::INFINITY, f64::min);
        let found = if width > STILL * level.abs() { rises(objective, level, BAND * width) } else { vec![] };
        if found.len() < count + 1 {
            return Err(TooFew(found.len().saturating_sub(1)));
        }
        let periods: Vec<f64> =
            found[found.len() - count - 1..].iter().map(|&j| curve.crossing(j, objective, level)).collect();
        let window = Self::between(curve, periods);
        let of_end = |time: f64| {
            let slope = sum(&curve.slope(time), objective);
            let mut by: Vec<f64> = half.weights.iter().map(|weight| weight / slope).collect();
            curve.value(time).into_iter().for_each(|(k, weight)| by[k] -= weight / slope);
            by
        };
        Ok(Self { ends: Some([of_end(window.from), of_end(window.to)]), ..window })
    }

    /// The mean of a figure's values at all moments.
    pub fn mean(&self, values: &[f64]) -> f64 {
        sum_of(&self.weights, values)
    }

    /// The derivative of the mean of a figure's values.
    pub fn slopes(&self, times: &[f64], values: &[f64]) -> Slopes {
        let mut found = Slopes { by_values: self.weights.clone(), ..Slopes::default() };
        let Some(curve) = Curve::new(times).filter(|_| !self.periods.is_empty()) else { return found };
        let (mean, length) = (self.mean(values), self.to - self.from);
        let at = |time: f64| sum(&curve.value(time), values);
        let by_ends = [(mean - at(self.from)) / length, (at(self.to) - mean) / length];
        if let Some([from, to]) = &self.ends {
            found.by_objective = from.iter().zip(to).map(|(a, b)| by_ends[0] * a + by_ends[1] * b).collect();
        }
        found.by_variables = self.by_variables.iter().map(|by| by_ends[0] * by).collect();
        found
    }

    /// How far the flow is from a periodic one: the largest relative difference of a period's length from their mean, and the largest
    /// difference of a figure's mean over one from that over all, relative to this or to half the figure's width. The period
    /// before the window counts as well, if the run has it. None without periods.
    pub fn irregularity(&self, times: &[f64], values: &[f64]) -> Option<[f64; 2]> {
        let curve = Curve::new(times)?;
        let count = self.periods.len().checked_sub(1)? as f64;
        let (mean, period) = (self.mean(values), (self.to - self.from) / count);
        let part = || values.iter().zip(times).filter(|(_, t)| **t >= self.from && **t <= self.to).map(|(v, _)| *v);
        let width = part().fold(f64::NEG_INFINITY, f64::max) - part().fold(f64::INFINITY, f64::min);
        let mut all = self.periods.clone();
        if self.from - period > times[0] {
            all.insert(0, self.from - period);
        }
        let most = |of: &dyn Fn(f64, f64) -> f64| all.windows(2).map(|p| of(p[0], p[1]).abs()).fold(0.0, f64::max);
        let size = mean.abs().max(0.5 * width);
        let off = |a: f64, b: f64| (sum_of(&curve.integral(a, b), values) / (b - a) - mean) / size;
        Some([most(&|a, b| (b - a) / period - 1.0), if size > 0.0 { most(&off) } else { 0.0 }])
    }
}

fn sum_of(weights: &[f64], values: &[f64]) -> f64 {
    // Values that do not count may be none.
    weights.iter().zip(values).filter(|(weight, _)| **weight != 0.0).map(|(weight, value)| weight * value).sum()
}
