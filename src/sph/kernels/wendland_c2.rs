//! Wendland's C2 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
//!
//! w(q) = (1 - q/2)^4 (2 q + 1) for q < 2 in two and three dimensions, sigma = 7/(4 pi h^2), 21/(16 pi h^3); in one
//! dimension (1 - q/2)^3 (3 q/2 + 1) would do (JAX-SPH has it, no scene here needs it); in its place stands the same w, whose
//! Fourier transform is positive there too, with sigma = 3/(4 h).
//!
//! w'/q = -5 (1 - q/2)^3, (w'/q)'/q = -5 (-3/2) (1 - q/2)^2/q. Its Fourier transform is positive, so particles do not
//! pair however many neighbours they have; h of 1.3 to 2 spacings is usual.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

#[derive(Debug, Clone, Copy)]
pub struct WendlandC2;

impl SmoothingKernel for WendlandC2 {
    const SUPPORT: f64 = 2.0;
    const SLOPE: f64 = -5.0;

    fn sigma(dimension: usize, h: f64) -> f64 {
        ratio([(3.0, 4.0), (7.0, 4.0 * PI), (21.0, 16.0 * PI)], dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, inverse: L, _: L) -> (L, L, L) {
        let a = q.mul_add(number(-0.5), number(1.0)).positive();
        let square = a * a;
        let w = square * square * q.mul_add(number(2.0), number(1.0));
        (w, square * a, square * inverse * number(-1.5))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let a = q.affine(-0.5, 1.0)?.relu()?;
        let square = a.sqr()?;
        Ok((square.sqr()?.mul(&q.affine(2.0, 1.0)?)?, square.mul(&a)?.affine(-5.0, 0.0)?))
    }
}
