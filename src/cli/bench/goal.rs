//! What the gradients of the bench differentiate.

use candle_core::Tensor;

use crate::adjoint::segments::{Objective, Sph};
use crate::design::objective::Outflow;
use crate::numerics::lanes::Real;
use crate::sph::solver::{Solver, SolverError, TensorSolver};

/// The heated channel's own objective, or, where there is no heat to measure, the sum of u^2 at the last step.
pub enum Goal {
    Outflow(Outflow),
    SquaredVelocity { steps: usize },
}

impl<R: Real> Objective<Sph<R>> for Goal {
    fn weight(&self, step: usize) -> Option<f64> {
        match self {
            Self::Outflow(outflow) => Objective::<Sph<R>>::weight(outflow, step),
            Self::SquaredVelocity { steps } => (step == *steps).then_some(1.0),
        }
    }

    fn value(&self, run: &mut Solver<R>) -> Result<f64, SolverError> {
        match self {
            Self::Outflow(outflow) => Objective::<Sph<R>>::value(outflow, run),
            Self::SquaredVelocity { .. } => {
                let (l, n) = (run.model.layout, run.model.particles());
                let velocity = &run.state[l.velocity() * n..][..l.dimension * n];
                Ok(velocity.iter().map(|u| u.f64().powi(2)).sum())
            }
        }
    }

    fn tensor(&self, run: &TensorSolver<R>, state: &Tensor) -> Result<Tensor, SolverError> {
        match self {
            Self::Outflow(outflow) => outflow.tensor(run, state),
            Self::SquaredVelocity { .. } => {
                let l = run.model.layout;
                let sum = || state.narrow(0, l.velocity(), l.dimension)?.contiguous()?.sqr()?.sum_all();
                sum().map_err(|source| SolverError::Tensor { step: run.step, source })
            }
        }
    }
}
