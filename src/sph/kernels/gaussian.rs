//! The Gaussian, and the super-Gaussian that is made of it.

use super::{number, SmoothingKernel};
use crate::numerics::exponential::exponential;
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

/// The Gaussian (Gingold and Monaghan 1977), cut off at 3 h as in JAX-SPH.
///
/// w(q) = exp(-q^2) for q < 3, sigma = 1/(sqrt(pi) h)^D. w'/q = -2 exp(-q^2), (w'/q)'/q = 4 exp(-q^2).
///
/// What is cut off is not made up for: W jumps by exp(-9) = 1.2e-4 of W(0) at the cut-off and integrates to 1 - 1.2e-4 in
/// two dimensions. A pair that comes or goes makes that jump, which no gradient sees.
#[derive(Debug, Clone, Copy)]
pub struct Gaussian;

/// exp(-q^2) for q < [`Gaussian::SUPPORT`], 0 from there on.
#[inline(always)]
fn bell<L: Lanes>(q: L) -> L {
    q.select_less(number(Gaussian::SUPPORT), exponential(-(q * q)), L::zero())
}

/// [`bell`] from candle's operators.
fn composed_bell(q: &Tensor) -> Result<Tensor> {
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

/// The super-Gaussian (Monaghan 1992, eq. 2.7), cut off at 3 h as in JAX-SPH.
///
/// w(q) = exp(-q^2) (D/2 + 1 - q^2) for q < 3 in D dimensions, sigma as the Gaussian's: interpolation of fourth order,
/// where the particles are evenly spread. w'/q = -2 exp(-q^2) (D/2 + 2 - q^2), (w'/q)'/q = -2 exp(-q^2) (-2) (D/2 + 3 - q^2).
///
/// It pays with its sign: W < 0 for q^2 > D/2 + 1, and W' > 0 for q^2 > D/2 + 2. Sums over all of a particle's
/// neighbours, as the density's, stay positive. Whatever divides by a sum of W over some of them does not: the walls'
/// averages over the fluid in reach (all of it in the negative ring for the outer rows, and about zero in between), volumes
/// 1/sum W of particles that have neighbours on one side only; and weights of least squares must not be negative. So
/// configurations may name it in scenes without walls and in the standard formulation only.
#[derive(Debug, Clone, Copy)]
pub struct SuperGaussian;

impl SmoothingKernel for SuperGaussian {
    const SUPPORT: f64 = Gaussian::SUPPORT;
    const SLOPE: f64 = -2.0;

    fn at_zero(dimension: usize) -> f64 {
        0.5 * dimension as f64 + 1.0
    }

    fn sigma(dimension: usize, h: f64) -> f64 {
        Gaussian::sigma(dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, _: L, dimension: L) -> (L, L, L) {
        let bell = bell(q);
        let w = dimension.mul_add(number(0.5), number(1.0)) - q * q;
        let g = (w + number(2.0)) * number(-2.0);
        (bell * w, bell * (w + number(1.0)), bell * g)
    }

    fn composed(q: &Tensor, dimension: usize) -> Result<(Tensor, Tensor)> {
        let bell = composed_bell(q)?;
        let w = q.sqr()?.affine(-1.0, Self::at_zero(dimension))?;
        let slope = w.affine(-2.0, -2.0)?;
        Ok((bell.mul(&w)?, bell.mul(&slope)?))
    }
}
