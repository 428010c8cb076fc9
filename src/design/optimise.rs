//! The optimisation loop: evaluate, record, step.

use super::limits::Limits;
use super::optimisers::Optimiser;
use super::problem::Evaluation;
use crate::error::Error;

/// Everything that the next epoch depends on, and the record of those before.
#[derive(Debug)]
pub struct Optimisation {
    pub optimiser: Box<dyn Optimiser>,
    pub history: Vec<Epoch>,
    /// Epoch of the lowest loss.
    pub best: usize,
}

/// One evaluated design.
#[derive(Debug, Clone, PartialEq)]
pub struct Epoch {
    pub variables: Vec<f64>,
    /// The objective as it is reported; NaN if the design was rejected.
    pub figure: f64,
    /// Infinite if the design was rejected.
    pub loss: f64,
    /// Norm of the loss's gradient by the variables; NaN if the design was rejected.
    pub gradient_norm: f64,
    pub seconds: f64,
}

impl Epoch {
    /// Whether the design's run diverged, so that the optimiser had to step back.
    pub fn is_rejected(&self) -> bool {
        !self.loss.is_finite()
    }
}

impl Optimisation {
    pub fn new(optimiser: Box<dyn Optimiser>) -> Self {
        Self { optimiser, history: Vec::new(), best: 0 }
    }

    /// Whether `epochs` designs are evaluated, or the optimiser has none left.
    pub fn is_finished(&self, epochs: usize) -> bool {
        self.history.len() >= epochs || self.optimiser.is_done()
    }

    /// One epoch: evaluates the present design, records it, and moves on to the next. A design after the first whose run
    /// diverges is rejected: it is recorded as one, and the optimiser steps back.
    ///
    /// # Errors
    /// Those of `evaluate`; nothing has changed then.
    pub fn epoch(
        &mut self,
        limits: &Limits,
        evaluate: impl FnOnce(&[f64]) -> Result<Evaluation, Error>,
    ) -> Result<(), Error> {
        let clock = std::time::Instant::now();
        let variables = self.optimiser.ask().to_vec();
        let found = match evaluate(&variables) {
            Err(Error::Diverged { .. }) if !self.history.is_empty() => Evaluation::rejected(variables.len()),
            found => found?,
        };
        let gradient_norm = match found.loss.is_finite() {
            true => found.gradient.iter().map(|g| g * g).sum::<f64>().sqrt(),
            false => f64::NAN,
        };
        self.history.push(Epoch {
            variables,
            figure: found.figure,
            loss: found.loss,
            gradient_norm,
            seconds: clock.elapsed().as_secs_f64(),
        });
        if found.loss < self.history[self.best].loss {
            self.best = self.history.len() - 1;
        }
        self.optimiser.tell(limits, found.loss, &found.gradient);
        Ok(())
    }

    /// Epochs until [`Self::is_finished`]; `seen` sees the record after each, to show it and to keep it.
    ///
    /// # Errors
    /// Those of `evaluate`, which is given the number of the epoch too, and of `seen`.
    pub fn run(
        &mut self,
        epochs: usize,
        limits: &Limits,
        mut evaluate: impl FnMut(usize, &[f64]) -> Result<Evaluation, Error>,
        mut seen: impl FnMut(&Self) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        while !self.is_finished(epochs) {
            let number = self.history.len();
            self.epoch(limits, |variables| evaluate(number, variables))?;
            seen(self)?;
        }
        Ok(())
    }

    /// Designs whose runs diverged.
    pub fn rejected(&self) -> usize {
        self.history.iter().filter(|epoch| epoch.is_rejected()).count()
    }

    /// A number of each epoch.
    pub fn column(&self, of: impl Fn(&Epoch) -> f64) -> Vec<f64> {
        self.history.iter().map(of).collect()
    }
}
