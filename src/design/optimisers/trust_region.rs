//! A trust region method for an expensive function with a cheap, inexact model.
//!
//! At the best point c so far the model m is corrected so that its value and gradient equal those of the function
//! (first-order consistency: Alexandrov, Dennis, Lewis and Torczon 1998, "A trust-region framework for managing the use
//! of approximation models in optimization"):
//!
//! ```text
//!   m_c(x) = m(x) + f(c) - m(c) + (f'(c) - m'(c)) . (x - c)
//! ```
//!
//! An inner optimiser minimises m_c within |x_k - c_k| <= radius and the limits. The function is evaluated there, and
//!
//! ```text
//!   ratio = (f(c) - f(x)) / (m_c(c) - m_c(x))
//! ```
//!
//! is the fraction of the predicted decrease that occurred. The point is accepted if the ratio is at least 0.1. The
//! radius is halved if it is below 0.25 and doubled if it is above 0.75 (Conn, Gould and Toint 2000, algorithm 6.1.1).
//!
//! [`TrustRegion::propose`] finds the next point with the model; [`super::Optimiser::tell`] takes the function's value.

use super::{numbers, LBfgsB, Optimiser, Record};
use crate::design::limits::Limits;
use crate::design::problem::Evaluation;
use crate::error::{BadInput, Error};
use crate::io::tensor_file::TensorFile;

/// The ratio from which a point is accepted, and the ratios between which the radius stays.
const ACCEPTED: f64 = 0.1;
const POOR: f64 = 0.25;
const GOOD: f64 = 0.75;
/// The smallest radius relative to the first one; below it the search ends.
const SMALLEST: f64 = 1e-3;
/// The smallest predicted decrease relative to the value that is worth an evaluation.
const WORTH: f64 = 1e-6;

#[derive(Debug, Clone, PartialEq)]
pub struct TrustRegion {
    /// Largest change of a variable in the first step.
    pub first_radius: f64,
    /// Number of evaluations of the model per step.
    pub inner: usize,
    radius: f64,
    /// The best point, with the function's value and gradient; the value is NaN before the first evaluation.
    centre: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
    trial: Vec<f64>,
    /// The corrected model's value at the trial point; NaN without a trial point.
    expected: f64,
    done: bool,
}

impl TrustRegion {
    /// Starts at `x`, which is within the limits.
    pub fn new(first_radius: f64, inner: usize, x: &[f64]) -> Self {
        Self {
            first_radius,
            inner,
            radius: first_radius,
            centre: x.to_vec(),
            value: f64::NAN,
            gradient: vec![0.0; x.len()],
            trial: x.to_vec(),
            expected: f64::NAN,
            done: false,
        }
    }

    /// The largest present distance of a variable from the best point.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Finds the next point to evaluate by `model`'s loss and gradient. It does nothing before the first evaluation,
    /// and while a point waits to be evaluated.
    ///
    /// # Errors
    /// Those of `model`. Where it diverges it has no value; if it does so at the best point, the search ends.
    pub fn propose(
        &mut self,
        limits: &Limits,
        mut model: impl FnMut(&[f64]) -> Result<Evaluation, Error>,
    ) -> Result<(), Error> {
        if self.done || self.value.is_nan() || self.expected.is_finite() {
            return Ok(());
        }
        let here = match model(&self.centre) {
            // Without a model at the best point there is no proposal.
            Err(Error::Diverged { .. }) => {
                self.done = true;
                return Ok(());
            }
            found => found?,
        };
        let slope: Vec<f64> = self.gradient.iter().zip(&here.gradient).map(|(f, m)| f - m).collect();
        while self.radius >= SMALLEST * self.first_radius {
            let near = limits.near(&self.centre, self.radius);
            let mut inner = LBfgsB::new(self.radius, &self.centre);
            let (mut best, mut least) = (self.centre.clone(), self.value);
            for evaluation in 0..self.inner.max(2) {
                if inner.is_done() {
                    break;
                }
                let x = inner.ask().to_vec();
                let found = match evaluation {
                    0 => Ok(here.clone()),
                    _ => model(&x),
                };
                let found = match found {
                    Err(Error::Diverged { .. }) => Evaluation::rejected(x.len()),
                    found => found?,
                };
                let along: f64 = slope.iter().zip(x.iter().zip(&self.centre)).map(|(s, (x, c))| s * (x - c)).sum();
                let value = found.loss + self.value - here.loss + along;
                let gradient: Vec<f64> = found.gradient.iter().zip(&slope).map(|(g, s)| g + s).collect();
                if value < least {
                    (best, least) = (x, value);
                }
                inner.tell(&near, value, &gradient);
            }
            if self.value - least > WORTH * self.value.abs() {
                (self.trial, self.expected) = (best, least);
                return Ok(());
            }
            self.radius *= 0.25;
        }
        self.done = true;
        self.trial.clone_from(&self.centre);
        Ok(())
    }
}

impl Optimiser for TrustRegion {
    fn name(&self) -> &str {
        "trust region"
    }

    fn ask(&self) -> &[f64] {
        &self.trial
    }

    fn tell(&mut self, _: &Limits, value: f64, gradient: &[f64]) {
        let has_value = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        if self.value.is_nan() {
            (self.value, self.gradient) = (value, gradient.to_vec());
            self.done = !has_value;
            return;
        }
        let ratio = if has_value { (self.value - value) / (self.value - self.expected) } else { f64::NEG_INFINITY };
        let step = self.trial.iter().zip(&self.centre).map(|(x, c)| (x - c).abs()).fold(0.0, f64::max);
        if ratio < POOR {
            self.radius = 0.5 * self.radius.min(step);
        } else if ratio > GOOD && step > 0.9 * self.radius {
            self.radius *= 2.0;
        }
        if ratio >= ACCEPTED {
            self.centre.clone_from(&self.trial);
            (self.value, self.gradient) = (value, gradient.to_vec());
        }
        self.expected = f64::NAN;
        self.done = self.radius < SMALLEST * self.first_radius;
        self.trial.clone_from(&self.centre);
    }

    fn is_done(&self) -> bool {
        self.done
    }

    fn save(&self, record: &mut Record) {
        let k = self.centre.len();
        record.put("trust_region.centre", &[k], self.centre.clone());
        record.put("trust_region.gradient", &[k], self.gradient.clone());
        record.put("trust_region.numbers", &[2], vec![self.value, self.radius]);
        record.note("trust_region.done", self.done);
    }

    fn restore(&mut self, file: &TensorFile) -> Result<(), BadInput> {
        let k = self.centre.len();
        self.centre = numbers(file, "trust_region.centre", &[k])?;
        self.gradient = numbers(file, "trust_region.gradient", &[k])?;
        let found = numbers(file, "trust_region.numbers", &[2])?;
        (self.value, self.radius) = (found[0], found[1]);
        self.done = file.metadata.get("trust_region.done").is_some_and(|text| text == "true");
        (self.trial, self.expected) = (self.centre.clone(), f64::NAN);
        Ok(())
    }

    fn expectation(&self) -> Option<f64> {
        Some(self.expected).filter(|value| value.is_finite())
    }

    fn trust_region(&mut self) -> Option<&mut TrustRegion> {
        Some(self)
    }
}
