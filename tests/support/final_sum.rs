//! An objective that sees every particle: a sum over rows of the final state.

use candle_core::Tensor;
use hydrograd::adjoint::segments::{Objective, Sph};
use hydrograd::numerics::lanes::Real;
use hydrograd::sph::solver::{Solver, SolverError, TensorSolver};

pub struct FinalSum {
    pub steps: usize,
    pub row: usize,
    pub rows: usize,
    /// Half the sum of squares, or the plain sum.
    pub squared: bool,
    pub fluid_only: bool,
}

impl<R: Real> Objective<Sph<R>> for FinalSum {
    fn weight(&self, step: usize) -> Option<f64> {
        (step == self.steps).then_some(1.0)
    }
    fn value(&self, run: &mut Solver<R>) -> Result<f64, SolverError> {
        let n = run.model.particles();
        Ok((0..self.rows * n)
            .filter(|k| !self.fluid_only || run.model.is_fluid(k % n))
            .map(|k| run.state[self.row * n + k].f64())
            .map(|x| if self.squared { 0.5 * x * x } else { x })
            .sum())
    }
    fn tensor(&self, run: &TensorSolver<R>, state: &Tensor) -> Result<Tensor, SolverError> {
        let go = || {
            let n = run.model.particles();
            let rows = state.narrow(0, self.row, self.rows)?;
            let rows = if self.squared { rows.sqr()?.affine(0.5, 0.0)? } else { rows };
            let keep: Vec<R> =
                (0..n).map(|i| R::of((!self.fluid_only || run.model.is_fluid(i)) as u8 as f64)).collect();
            rows.broadcast_mul(&Tensor::from_vec(keep, (1, n), state.device())?)?.sum_all()
        };
        go().map_err(|source| SolverError::Tensor { step: run.step, source })
    }
}
