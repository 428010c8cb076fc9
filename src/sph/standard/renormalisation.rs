//! Renormalisation of an evolved density.
//!
//! rho_i = sum_j m_j W_ij / min(1, sum_j V_j W_ij) with j = i included, over fluid and wall particles (Zhang, Hu and
//! Adams 2017, eq. 16; JAX-SPH's `rho_renorm_fn`). At a free surface, where the kernel's support is not filled, this is
//! a Shepard average, elsewhere the plain sum.

use super::chain::Step;
use crate::numerics::lanes::Real;
use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

/// The renormalised density `[1, N]`, by candle's operators.
pub fn composed<R: Real>(step: &Step<R>, pairs: &Pairs, mass: &Tensor, density: &Tensor) -> Result<Tensor> {
    let kernel = &step.model.kernel;
    let w = kernel.composed(&pairs.distance)?.0.mul(&pairs.mask)?;
    let volume = mass.div(density)?;
    let sum = |x: &Tensor| pairs.other(x)?.mul(&w)?.sum(2)? + x.affine(kernel.at_zero(), 0.0)?;
    let filled = sum(&volume)?;
    sum(mass)?.div(&filled.minimum(&filled.ones_like()?)?)
}
