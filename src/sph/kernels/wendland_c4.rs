//! Wendland's C4 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
//!
//! w(q) = (1 - q/2)^6 (35/12 q^2 + 3 q + 1) for q < 2, sigma = 9/(4 pi h^2), 495/(256 pi h^3) in 2, 3 dimensions. In one
//! dimension the same w with sigma = 27/(32 h) (see [`super::wendland_c2`]).
//!
//! w'/q = -14/3 (1 - q/2)^5 (5/2 q + 1), (w'/q)'/q = -14/3 (-15/2) (1 - q/2)^4. Narrower than C2 at the same h: it wants
//! an h of about 1.6 to 2 spacings.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

#[derive(Debug, Clone, Copy)]
pub struct WendlandC4;

impl SmoothingKernel for WendlandC4 {
    const SUPPORT: f64 = 2.0;
    const SLOPE: f64 = -14.0 / 3.0;

    fn sigma(dimension: usize, h: f64) -> f64 {
        ratio([(27.0, 32.0), (9.0, 4.0 * PI), (495.0, 256.0 * PI)], dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, _: L, _: L) -> (L, L, L) {
        let a = q.mul_add(number(-0.5), number(1.0)).positive();
        let square = a * a;
        let fourth = square * square;
        let w = q.mul_add(number(35.0 / 12.0), number(3.0)).mul_add(q, number(1.0));
        (fourth * square * w, fourth * a * q.mul_add(number(2.5), number(1.0)), fourth * number(-7.5))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let a = q.affine(-0.5, 1.0)?.relu()?;
        let square = a.sqr()?;
        let fourth = square.sqr()?;
        let w = (q.affine(35.0 / 12.0, 3.0)?.mul(q)? + 1.0)?;
        let slope = q.affine(-35.0 / 3.0, -14.0 / 3.0)?;
        Ok((fourth.mul(&square)?.mul(&w)?, fourth.mul(&a)?.mul(&slope)?))
    }
}
