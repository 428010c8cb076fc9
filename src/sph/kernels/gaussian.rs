//! The Gaussian (Gingold and Monaghan 1977), cut off at 3 h as in JAX-SPH.
//!
//! w(q) = exp(-q^2) for q < 3, sigma = 1/(sqrt(pi) h)^D. w'/q = -2 exp(-q^2), (w'/q)'/q = 4 exp(-q^2).
//!
//! What is cut off is not made up for: W jumps by exp(-9) = 1.2e-4 of W(0) at the cut-off and integrates to 1 - 1.2e-4 in
//! two dimensions. A pair that comes or goes makes that jump, which no gradient sees.

use super::{number, SmoothingKernel};
use crate::numerics::exponential::exponential;
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

#[derive(Debug, Clone, Copy)]
pub struct Gaussian;

/// exp(-q^2) for q < [`Gaussian::SUPPORT`], 0 from there on.
#[inline(always)]
pub(super) fn bell<L: Lanes>(q: L) -> L {
    q.select_less(number(Gaussian::SUPPORT), exponential(-(q * q)), L::zero())
}

/// [`bell`] from candle's operators.
pub(super) fn composed_bell(q: &Tensor) -> Result<Tensor> {
    let inside = q.lt(Gaussian::SUPPORT)?.to_dtype(q.dtype())?;
    q.sqr()?.neg()?.exp()?.mul(&inside)
}

impl SmoothingKernel for Gaussian {
    const SUPPORT: f64 = 3.0;
    const SLOPE: f64 = -2.0;

    fn sigma(dimension: usize, h: f64) -> f64 {
        (PI.sqrt() * h).powi(-(dimension as i32))
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, _: L, _: L) -> (L, L, L) {
        let w = bell(q);
        (w, w, w * number(-2.0))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let w = composed_bell(q)?;
        let slope = w.affine(-2.0, 0.0)?;
        Ok((w, slope))
    }
}
