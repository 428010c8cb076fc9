//! Wendland's C6 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
//!
//! w(q) = (1 - q/2)^8 (4 q^3 + 25/4 q^2 + 4 q + 1) for q < 2, sigma = 39/(14 pi h^2), 1365/(512 pi h^3) in 2, 3
//! dimensions. In one dimension the same w with sigma = 15/(16 h) (see [`super::wendland_c2`]).
//!
//! w'/q = -11/2 (1 - q/2)^7 (4 q^2 + 7/2 q + 1), (w'/q)'/q = -11/2 (-6) (1 - q/2)^6 (3 q + 1). The smoothest and, at the
//! same h, the narrowest of the three: it wants an h of about 1.8 to 2.2 spacings.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

#[derive(Debug, Clone, Copy)]
pub struct WendlandC6;

impl SmoothingKernel for WendlandC6 {
    const SUPPORT: f64 = 2.0;
    const SLOPE: f64 = -5.5;

    fn sigma(dimension: usize, h: f64) -> f64 {
        ratio([(15.0, 16.0), (39.0, 14.0 * PI), (1365.0, 512.0 * PI)], dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, _: L, _: L) -> (L, L, L) {
        let one = number::<L>(1.0);
        let a = q.mul_add(number(-0.5), one).positive();
        let square = a * a;
        let sixth = square * square * square;
        let w = q.mul_add(number(4.0), number(6.25)).mul_add(q, number(4.0)).mul_add(q, one);
        let f = q.mul_add(number(4.0), number(3.5)).mul_add(q, one);
        (sixth * square * w, sixth * a * f, sixth * q.mul_add(number(-18.0), number(-6.0)))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let a = q.affine(-0.5, 1.0)?.relu()?;
        let square = a.sqr()?;
        let sixth = square.sqr()?.mul(&square)?;
        let w = ((q.affine(4.0, 6.25)?.mul(q)? + 4.0)?.mul(q)? + 1.0)?;
        let slope = (q.affine(4.0, 3.5)?.mul(q)? + 1.0)?.affine(-5.5, 0.0)?;
        Ok((sixth.mul(&square)?.mul(&w)?, sixth.mul(&a)?.mul(&slope)?))
    }
}
