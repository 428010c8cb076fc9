//! Gradient steps of Barzilai and Borwein (1988), for many variables and hardly any limits.
//!
//! x <- x - a g with a = s.s / s.y, where s and y are the last changes of x and of the gradient: the step for a
//! quadratic with the measured curvature, without a matrix. A value above the largest of the last ten is rejected
//! (Grippo, Lampariello and Lucidi 1986), and a quarter of the step is tried. The first step changes no variable by
//! more than `first_step`.

use super::{numbers, Optimiser, Record};
use crate::design::limits::Limits;
use crate::error::BadInput;
use crate::io::tensor_file::TensorFile;

/// Number of previous values with which a new one is compared.
const MEMORY: usize = 10;
/// The factor of a step that was too long, and the largest ratio of a step to the last one.
const SHORTER: f64 = 0.25;
const LONGEST: f64 = 1e3;

#[derive(Debug, Clone, PartialEq)]
pub struct BarzilaiBorwein {
    pub first_step: f64,
    /// The last accepted point and its gradient; empty before the first.
    point: Vec<f64>,
    gradient: Vec<f64>,
    length: f64,
    values: Vec<f64>,
    trial: Vec<f64>,
}

impl BarzilaiBorwein {
    pub fn new(first_step: f64, x: &[f64]) -> Self {
        Self { first_step, point: vec![], gradient: vec![], length: 0.0, values: vec![], trial: x.to_vec() }
    }

    fn propose(&mut self, limits: &Limits) {
        self.trial = self.point.iter().zip(&self.gradient).map(|(x, g)| x - self.length * g).collect();
        limits.clamp(&mut self.trial);
    }
}

impl Optimiser for BarzilaiBorwein {
    fn name(&self) -> &str {
        "barzilai-borwein"
    }

    fn ask(&self) -> &[f64] {
        &self.trial
    }

    fn tell(&mut self, limits: &Limits, value: f64, gradient: &[f64]) {
        let highest = self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let is_good = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        if !is_good || (!self.values.is_empty() && value > highest) {
            self.length *= SHORTER;
            return self.propose(limits);
        }
        if self.point.is_empty() {
            let steepest = gradient.iter().fold(0.0, |most: f64, g| most.max(g.abs()));
            self.length = self.first_step / steepest.max(f64::MIN_POSITIVE);
        } else {
            let (mut ss, mut sy) = (0.0, 0.0);
            for k in 0..gradient.len() {
                let (s, y) = (self.trial[k] - self.point[k], gradient[k] - self.gradient[k]);
                ss += s * s;
                sy += s * y;
            }
            let longest = LONGEST * self.length;
            self.length = if sy > 0.0 { (ss / sy).min(longest) } else { 2.0 * self.length };
        }
        self.point.clone_from(&self.trial);
        self.gradient = gradient.to_vec();
        self.values.push(value);
        if self.values.len() > MEMORY {
            self.values.remove(0);
        }
        self.propose(limits);
    }

    fn save(&self, record: &mut Record) {
        record.put("barzilai_borwein.point", &[self.point.len()], self.point.clone());
        record.put("barzilai_borwein.gradient", &[self.gradient.len()], self.gradient.clone());
        record.put("barzilai_borwein.values", &[self.values.len()], self.values.clone());
        record.put("barzilai_borwein.length", &[1], vec![self.length]);
    }

    fn restore(&mut self, file: &TensorFile) -> Result<(), BadInput> {
        let k = self.trial.len();
        self.point = numbers(file, "barzilai_borwein.point", &[k])?;
        self.gradient = numbers(file, "barzilai_borwein.gradient", &[k])?;
        let count = file.shape("barzilai_borwein.values").map_err(super::unreadable)?.iter().product();
        self.values = numbers(file, "barzilai_borwein.values", &[count])?;
        self.length = numbers(file, "barzilai_borwein.length", &[1])?[0];
        Ok(())
    }
}
