//! Evaluation of designs, by the solver ([`Scheduled`]) or by a surrogate that predicts the solver's result.

use super::parametrisations::Parametrisation;
use super::problem::{Derivative, Evaluation, Problem};
use crate::adjoint::gradient::Progress;
use crate::adjoint::schedule::Schedule;
use crate::error::Error;
use crate::sph::Sweeps;

/// Judges designs `[K]`.
pub trait Judge {
    /// The loss of a design and its gradient. `progress` is called with the completed fraction of the work.
    ///
    /// # Errors
    /// [`Error::Diverged`] for a run that diverges and for a gradient that is not finite; others.
    fn gradient(&self, variables: &[f64], progress: Progress<'_>) -> Result<Evaluation, Error>;

    /// The loss of a design without its gradient.
    fn value(&self, variables: &[f64]) -> Result<Evaluation, Error>;

    /// The reported objective of a design with this loss.
    fn figure(&self, variables: &[f64], loss: f64) -> f64;

    /// The parametrisation that gives the variables their meaning.
    fn parametrisation(&self) -> &dyn Parametrisation;
}

/// Evaluation by the solver: a problem, and the checkpointing schedule of its gradient.
#[derive(Debug)]
pub struct Scheduled<R> {
    pub problem: Problem<R>,
    pub schedule: Schedule,
}

impl<R: Sweeps> Scheduled<R> {
    /// The objective of a design and its derivative.
    pub fn differentiate(&self, variables: &[f64], progress: Progress<'_>) -> Result<Derivative, Error> {
        self.problem.differentiate(variables, &self.schedule, progress)
    }
}

impl<R: Sweeps> Judge for Scheduled<R> {
    fn gradient(&self, variables: &[f64], progress: Progress<'_>) -> Result<Evaluation, Error> {
        Ok(self.problem.confirmed(variables, &self.differentiate(variables, progress)?))
    }

    fn value(&self, variables: &[f64]) -> Result<Evaluation, Error> {
        self.problem.value(variables)
    }

    fn figure(&self, variables: &[f64], loss: f64) -> f64 {
        self.problem.figure_of(variables, loss)
    }

    fn parametrisation(&self) -> &dyn Parametrisation {
        &*self.problem.parametrisation
    }
}
