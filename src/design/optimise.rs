//! The record of an optimisation: every evaluated design, and the optimiser that proposes the next. The loop is
//! [`super::search`].

use super::judge::Judge;
use super::optimisers::Optimiser;
use super::problem::{Evaluation, Truth};
use crate::error::Error;
use std::time::Instant;

/// The state of an optimisation, with the record of all epochs.
#[derive(Debug)]
pub struct Optimisation {
    pub optimiser: Box<dyn Optimiser>,
    pub history: Vec<Epoch>,
    /// Epoch of the lowest loss, by the solver if it has evaluated any design.
    pub best: usize,
    /// First epoch that the solver evaluates after the surrogate's epochs, once it is known.
    pub solver_from: Option<usize>,
}

/// One evaluated design.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Epoch {
    pub variables: Vec<f64>,
    /// The reported objective, by solver or surrogate; NaN if the design was rejected.
    pub figure: f64,
    /// Loss; infinite if the design was rejected.
    pub loss: f64,
    /// Norm of the loss's gradient by the variables; NaN if the design was rejected.
    pub gradient_norm: f64,
    /// See [`Evaluation::gradient_error`].
    pub gradient_error: f64,
    pub seconds: f64,
    /// The solver's result, if the solver evaluated the design.
    pub truth: Option<Truth>,
    /// The objective predicted by a surrogate.
    pub predicted: Option<f64>,
    /// See [`Evaluation::solver_steps`].
    pub solver_steps: usize,
    /// The part of `solver_steps` that was made after all epochs; none if the solver did not evaluate the design then.
    pub judged_late: Option<usize>,
    /// Why the run of a rejected design failed. A checkpoint does not store it.
    pub failure: Option<String>,
}

impl Epoch {
    /// Whether the design was rejected because its run diverged.
    pub fn is_rejected(&self) -> bool {
        !self.loss.is_finite()
    }

    /// Whether the gradient may as well be 0, because its error is as large.
    pub fn is_within_error(&self) -> bool {
        self.gradient_error > 0.0 && self.gradient_norm <= self.gradient_error
    }

    /// The objective, by the solver where it evaluated the design.
    pub fn shown(&self) -> f64 {
        self.truth.map_or(self.figure, |truth| truth.figure)
    }

    /// Whether this epoch is better than another one. Losses by the solver take precedence over those by a surrogate.
    fn is_better(&self, other: &Self) -> bool {
        match (self.truth, other.truth) {
            (Some(own), Some(others)) => own.loss < others.loss,
            (Some(own), None) => own.loss.is_finite(),
            (None, Some(_)) => false,
            (None, None) => self.loss < other.loss,
        }
    }
}

impl Optimisation {
    pub fn new(optimiser: Box<dyn Optimiser>) -> Self {
        Self { optimiser, history: Vec::new(), best: 0, solver_from: None }
    }

    /// Whether `epochs` designs are evaluated, or no better one can be told from the last.
    pub fn is_finished(&self, epochs: usize) -> bool {
        self.history.len() >= epochs || self.is_done()
    }

    /// Whether the optimiser is done, or the last gradient is not larger than its own error.
    pub fn is_done(&self) -> bool {
        self.optimiser.is_done() || self.history.last().is_some_and(Epoch::is_within_error)
    }

    /// Records the evaluation of the design that the optimiser asked for, and tells the optimiser. If the run of a
    /// design other than the first diverges, the design is recorded as rejected and the optimiser steps back.
    ///
    /// # Errors
    /// That of `found`, without a change of the record.
    pub(super) fn record(
        &mut self,
        judge: &dyn Judge,
        variables: Vec<f64>,
        found: Result<Evaluation, Error>,
        clock: Instant,
    ) -> Result<(), Error> {
        let mut failure = None;
        let found = match found {
            Err(Error::Diverged { problem, .. }) if !self.history.is_empty() => {
                failure = Some(problem);
                Evaluation::rejected(variables.len())
            }
            found => found?,
        };
        let norm = found.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        self.history.push(Epoch {
            variables,
            figure: found.figure,
            loss: found.loss,
            gradient_norm: if found.loss.is_finite() { norm } else { f64::NAN },
            gradient_error: found.gradient_error,
            seconds: clock.elapsed().as_secs_f64(),
            truth: found.truth,
            predicted: found.predicted,
            solver_steps: found.solver_steps,
            judged_late: None,
            failure,
        });
        let last = self.history.len() - 1;
        if self.history[last].is_better(&self.history[self.best]) {
            self.best = last;
        }
        self.optimiser.tell(judge.parametrisation().limits(), found.loss, &found.gradient);
        Ok(())
    }

    /// Evaluates designs with the solver that only a surrogate has evaluated, and updates the best epoch.
    ///
    /// # Errors
    /// Those of the solver, except for diverged runs: such a design gets an infinite loss.
    pub(super) fn confirm(&mut self, epochs: &[usize], solver: &dyn Judge) -> Result<(), Error> {
        for &epoch in epochs {
            let one = &mut self.history[epoch];
            if one.truth.is_none() {
                let clock = Instant::now();
                let found = match solver.value(&one.variables) {
                    Err(Error::Diverged { .. }) if epoch > 0 => Evaluation::rejected(0),
                    found => found?,
                };
                one.truth = Some(Truth { figure: found.figure, loss: found.loss });
                one.seconds += clock.elapsed().as_secs_f64();
                one.solver_steps += found.solver_steps;
                one.judged_late = Some(found.solver_steps);
            }
        }
        for epoch in 0..self.history.len() {
            if self.history[epoch].is_better(&self.history[self.best]) {
                self.best = epoch;
            }
        }
        Ok(())
    }

    /// The epoch of the lowest loss by the surrogate.
    pub fn predicted_best(&self) -> usize {
        let losses = self.history.iter().enumerate().filter(|(_, epoch)| epoch.predicted.is_some());
        losses.min_by(|a, b| a.1.loss.total_cmp(&b.1.loss)).map_or(self.best, |(epoch, _)| epoch)
    }

    pub fn solver_steps(&self) -> usize {
        self.history.iter().map(|epoch| epoch.solver_steps).sum()
    }

    /// Number of designs whose runs diverged.
    pub fn rejected(&self) -> usize {
        self.history.iter().filter(|epoch| epoch.is_rejected()).count()
    }

    /// A value of each epoch.
    pub fn column(&self, of: impl Fn(&Epoch) -> f64) -> Vec<f64> {
        self.history.iter().map(of).collect()
    }
}
