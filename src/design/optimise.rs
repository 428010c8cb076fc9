//! The optimisation loop: evaluate, record, step.

use super::limits::Limits;
use super::optimisers::Optimiser;
use super::problem::{Evaluation, Truth};
use crate::error::Error;
use crate::numerics::interrupt;

/// Everything that the next epoch depends on, and the record of those before.
#[derive(Debug)]
pub struct Optimisation {
    pub optimiser: Box<dyn Optimiser>,
    pub history: Vec<Epoch>,
    /// Epoch of the lowest loss: of those that the solver judged, if it judged any.
    pub best: usize,
    /// The epoch from which on the solver judges what a surrogate did before, once that is known.
    pub solver_from: Option<usize>,
}

/// One evaluated design.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Epoch {
    pub variables: Vec<f64>,
    /// The objective as it is reported, by whoever judged; NaN if the design was rejected.
    pub figure: f64,
    /// Infinite if the design was rejected.
    pub loss: f64,
    /// Norm of the loss's gradient by the variables; NaN if the design was rejected.
    pub gradient_norm: f64,
    pub seconds: f64,
    /// What the solver says of it, where it was asked.
    pub truth: Option<Truth>,
    /// The objective that a surrogate predicted.
    pub predicted: Option<f64>,
    /// See [`Evaluation::solver_steps`].
    pub solver_steps: usize,
    /// Of these, steps of [`Optimisation::judge`], when all epochs were over; none where it was not asked.
    pub judged_late: Option<usize>,
}

impl Epoch {
    /// Whether the design's run diverged, so that the optimiser had to step back.
    pub fn is_rejected(&self) -> bool {
        !self.loss.is_finite()
    }

    /// The objective: the solver's, where it was asked.
    pub fn shown(&self) -> f64 {
        self.truth.map_or(self.figure, |truth| truth.figure)
    }

    /// Whether it is better than another one: what the solver says counts, and more than what a surrogate says.
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
        let found = evaluate(&variables);
        self.record(limits, variables, found, clock)
    }

    fn record(
        &mut self,
        limits: &Limits,
        variables: Vec<f64>,
        found: Result<Evaluation, Error>,
        clock: std::time::Instant,
    ) -> Result<(), Error> {
        let found = match found {
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
            truth: found.truth,
            predicted: found.predicted,
            solver_steps: found.solver_steps,
            judged_late: None,
        });
        let last = self.history.len() - 1;
        if self.history[last].is_better(&self.history[self.best]) {
            self.best = last;
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
        seen: impl FnMut(&Self) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let number = |run: &Self| run.history.len();
        self.run_prepared(epochs, limits, |_| Ok(()), |run, variables| evaluate(number(run), variables), seen)
    }

    /// The same, until somebody asks to stop; `prepare` comes before each epoch, and before it is asked whether there is another one.
    ///
    /// # Errors
    /// Those of what it is given.
    pub fn run_prepared(
        &mut self,
        epochs: usize,
        limits: &Limits,
        mut prepare: impl FnMut(&mut Self) -> anyhow::Result<()>,
        mut evaluate: impl FnMut(&Self, &[f64]) -> Result<Evaluation, Error>,
        mut seen: impl FnMut(&Self) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        loop {
            let clock = std::time::Instant::now();
            if self.history.len() < epochs {
                prepare(self)?;
            }
            if self.is_finished(epochs) {
                return Ok(());
            }
            let variables = self.optimiser.ask().to_vec();
            let found = evaluate(self, &variables);
            self.record(limits, variables, found, clock)?;
            seen(self)?;
            interrupt::check()?;
        }
    }

    /// Asks the solver about designs that only a surrogate has judged, and takes the best of all that it knows.
    ///
    /// # Errors
    /// Those of `truth`, but for runs that diverge: such a design is worth nothing.
    pub fn judge(
        &mut self,
        epochs: &[usize],
        mut truth: impl FnMut(&[f64]) -> Result<(Truth, usize), Error>,
    ) -> Result<(), Error> {
        for &epoch in epochs {
            let one = &mut self.history[epoch];
            if one.truth.is_none() {
                let clock = std::time::Instant::now();
                let (found, steps) = match truth(&one.variables) {
                    Err(Error::Diverged { .. }) if epoch > 0 => (Truth { figure: f64::NAN, loss: f64::INFINITY }, 0),
                    found => found?,
                };
                one.truth = Some(found);
                one.seconds += clock.elapsed().as_secs_f64();
                one.solver_steps += steps;
                one.judged_late = Some(steps);
            }
        }
        for epoch in 0..self.history.len() {
            if self.history[epoch].is_better(&self.history[self.best]) {
                self.best = epoch;
            }
        }
        Ok(())
    }

    /// The design that was best before the solver was asked: the one of the lowest loss.
    pub fn predicted_best(&self) -> usize {
        let losses = self.history.iter().enumerate().filter(|(_, epoch)| epoch.predicted.is_some());
        losses.min_by(|a, b| a.1.loss.total_cmp(&b.1.loss)).map_or(self.best, |(epoch, _)| epoch)
    }

    /// Steps of the solver that all epochs took.
    pub fn solver_steps(&self) -> usize {
        self.history.iter().map(|epoch| epoch.solver_steps).sum()
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
