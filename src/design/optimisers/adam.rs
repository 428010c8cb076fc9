//! Adam (Kingma and Ba 2015, algorithm 1) with moments that can be stored, and limits by projection.
//!
//! m <- b1 m + (1-b1) g, v <- b2 v + (1-b2) g^2, x <- x - lr m^ / (sqrt(v^) + eps), m^ = m/(1-b1^t), v^ = v/(1-b2^t).
//! A step changes each variable by about `learning_rate`, whatever the gradient's scale: for wall offsets, 2e-2 is one
//! spacing per step at dx = 0.02.
//!
//! Where the function has no value, the step was too long: the next point is half way back to the last point with a
//! value, and the momentum is reset.

use super::{count, numbers, Optimiser, Record};
use crate::design::limits::Limits;
use crate::error::BadInput;
use crate::io::tensor_file::TensorFile;

/// Adam accepts every evaluation with a finite value as a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    pub learning_rate: f64,
    x: Vec<f64>,
    /// The last point at which the function had a value.
    good: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
    steps: u64,
}

const FIRST_DECAY: f64 = 0.9;
const SECOND_DECAY: f64 = 0.999;
/// Smaller than any relevant gradient here (1e-4), larger than 0.
const EPSILON: f64 = 1e-12;

impl Adam {
    pub fn new(learning_rate: f64, x: &[f64]) -> Self {
        let zeros = || vec![0.0; x.len()];
        Self { learning_rate, x: x.to_vec(), good: x.to_vec(), first: zeros(), second: zeros(), steps: 0 }
    }

    fn step(&mut self, gradient: &[f64]) {
        self.steps += 1;
        let first_share = 1.0 - FIRST_DECAY.powi(self.steps as i32);
        let second_share = 1.0 - SECOND_DECAY.powi(self.steps as i32);
        for k in 0..self.x.len() {
            let g = gradient[k];
            self.first[k] = FIRST_DECAY * self.first[k] + (1.0 - FIRST_DECAY) * g;
            self.second[k] = SECOND_DECAY * self.second[k] + (1.0 - SECOND_DECAY) * g * g;
            let (m, v) = (self.first[k] / first_share, self.second[k] / second_share);
            self.x[k] -= self.learning_rate * m / (v.sqrt() + EPSILON);
        }
    }
}

impl Optimiser for Adam {
    fn name(&self) -> &str {
        "adam"
    }

    fn ask(&self) -> &[f64] {
        &self.x
    }

    fn tell(&mut self, limits: &Limits, value: f64, gradient: &[f64]) {
        if value.is_finite() && gradient.iter().all(|g| g.is_finite()) {
            self.good.clone_from(&self.x);
            self.step(gradient);
        } else {
            self.x.iter_mut().zip(&self.good).for_each(|(x, good)| *x = 0.5 * (*x + good));
            self.first.fill(0.0);
        }
        limits.project(&mut self.x);
    }

    fn save(&self, record: &mut Record) {
        let k = self.x.len();
        record.put("adam.last_good", &[k], self.good.clone());
        record.put("adam.first_moment", &[k], self.first.clone());
        record.put("adam.second_moment", &[k], self.second.clone());
        record.note("adam.steps", self.steps);
    }

    fn restore(&mut self, file: &TensorFile) -> Result<(), BadInput> {
        let k = self.x.len();
        self.first = numbers(file, "adam.first_moment", &[k])?;
        self.second = numbers(file, "adam.second_moment", &[k])?;
        // Earlier versions did not store this point.
        self.good = match file.tensors.contains_key("adam.last_good") {
            true => numbers(file, "adam.last_good", &[k])?,
            false => self.x.clone(),
        };
        self.steps = count(file, "adam.steps")? as u64;
        Ok(())
    }
}
