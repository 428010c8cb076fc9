//! The outflowing heat.
//!
//! Q = sum over the targets of rho u_x (T - T_in) (eq. 12 of the original report), times the spacing of the targets:
//! then it is the flux integral over the outlet section in units of rho u T, comparable between resolutions. At the
//! last step, or averaged over evenly spaced steps of a window at the run's end.

use crate::adjoint::segments::{Objective, Sph};
use crate::config::scene::Kernels;
use crate::numerics::lanes::Real;
use crate::sph::operators::interpolation::{Interpolation, Mode};
use crate::sph::operators::{density, wall_condition};
use crate::sph::solver::{Solver, SolverError, TensorSolver};
use crate::sph::step::{Chain, Step};
use candle_core::Tensor;
use std::collections::BTreeMap;
use std::sync::Arc;

#[derive(Debug, Clone)]
pub struct Outflow {
    pub targets: Arc<Vec<[f64; 3]>>,
    /// Factor on the sum over targets: their spacing for the flux form, 1 for the report's sum.
    pub scale: f64,
    pub mode: Mode,
    /// Weight of the state after each step that is looked at.
    pub samples: BTreeMap<usize, f64>,
}

impl Outflow {
    /// `count` evenly spaced samples among the last `window` steps of `steps`, the last step among them, equally weighted.
    pub fn window(steps: usize, window: usize, count: usize) -> BTreeMap<usize, f64> {
        let count = count.min(window.max(1)).max(1);
        let chosen: std::collections::BTreeSet<usize> =
            (0..count).map(|k| steps - k * window / count).filter(|&s| s > 0).collect();
        let weight = 1.0 / chosen.len().max(1) as f64;
        chosen.into_iter().map(|s| (s, weight)).collect()
    }

    fn interpolation<R: Real>(&self, step: Arc<Step<R>>) -> Interpolation<R> {
        Interpolation { step, targets: self.targets.clone(), mode: self.mode }
    }

    /// Interpolated fields of a plain run, `[3, targets]`: density, velocity, temperature above the inlet's.
    pub fn fields<R: Real>(&self, run: &mut Solver<R>) -> Vec<R> {
        run.look();
        let step = Arc::new(run.step_now());
        self.interpolation(step).forward(run.moved(), &run.primitives)
    }

    /// Q from interpolated fields.
    pub fn outflow<R: Real>(&self, fields: &[R]) -> f64 {
        self.scale * self.sum(fields, |rho, u, t| rho * u * t, 2)
    }

    /// The flow rate over `scale`: the sum of u over the targets.
    pub fn volume_flow<R: Real>(&self, fields: &[R]) -> f64 {
        self.sum(fields, |_, u, _| u, 1)
    }

    /// The sum of rho u over the targets.
    pub fn mass_flow<R: Real>(&self, fields: &[R]) -> f64 {
        self.sum(fields, |rho, u, _| rho * u, 0)
    }

    /// Sum over the targets: of a function of density, velocity and temperature, or of a row where fluxes are given.
    fn sum<R: Real>(&self, fields: &[R], f: impl Fn(f64, f64, f64) -> f64, row: usize) -> f64 {
        let m = self.targets.len();
        let at = |row: usize, k: usize| fields[row * m + k].f64();
        let term = |k: usize| if self.mode == Mode::Flux { at(row, k) } else { f(at(0, k), at(1, k), at(2, k)) };
        (0..m).map(term).sum()
    }
}

impl<R: Real> Objective<Sph<R>> for Outflow {
    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.get(&step).copied()
    }

    fn value(&self, run: &mut Solver<R>) -> Result<f64, SolverError> {
        let fields = self.fields(run);
        Ok(self.outflow(&fields))
    }

    fn tensor(&self, run: &TensorSolver<R>, state: &Tensor) -> Result<Tensor, SolverError> {
        let go = || {
            let step = run.step_now();
            let fused = run.kernels == Kernels::Fused;
            let moved = Step::drift(&run.model, 0.0, state, fused)?;
            let fields = if fused {
                let chain = Chain::new(step.clone());
                let density = moved.apply_op1(density::Density(chain.clone()))?;
                let primitives = moved.apply_op2(&density, wall_condition::Primitives(chain))?;
                moved.apply_op2(&primitives, self.interpolation(step))?
            } else {
                let pairs = crate::sph::operators::composed::Pairs::new(&step, &moved)?;
                let density = density::composed(&step, &pairs, &moved)?;
                let primitives = wall_condition::composed(&step, &pairs, &moved, &density)?;
                self.interpolation(step.clone()).composed(&moved, &primitives)?
            };
            let flux = match self.mode {
                Mode::Flux => fields.get(2)?,
                _ => fields.get(0)?.mul(&fields.get(1)?)?.mul(&fields.get(2)?)?,
            };
            flux.sum_all()?.affine(self.scale, 0.0)
        };
        go().map_err(|source| SolverError::Tensor { step: run.step, source })
    }
}
