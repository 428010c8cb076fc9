//! The cubic spline (Monaghan and Lattanzio 1985; Monaghan 1992, sec. 7), support 2 h.
//!
//! 4 w(q) = (2-q)^3 - 4 (1-q)^3, each term only where its bracket is positive: 1 - 3/2 q^2 + 3/4 q^3 for q < 1;
//! sigma = 2/(3 h), 10/(7 pi h^2), 1/(pi h^3) in 1, 2, 3 dimensions.
//!
//! w'/q = -3/4 (4 - 3 q) for q < 1, -3/4 (2-q)^2/q beyond; (w'/q)'/q = -3/4 (-3/q), -3/4 (-(2-q) (2+q)/q^3). Its second
//! derivative has a kink at 1: rougher sums than the quintic spline's, from fewer neighbours.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

#[derive(Debug, Clone, Copy)]
pub struct CubicSpline;

impl SmoothingKernel for CubicSpline {
    const SUPPORT: f64 = 2.0;
    const SLOPE: f64 = -0.75;

    fn sigma(dimension: usize, h: f64) -> f64 {
        ratio([(2.0, 3.0), (10.0, 7.0 * PI), (1.0, PI)], dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, inverse: L, _: L) -> (L, L, L) {
        let one = number::<L>(1.0);
        let q2 = (number::<L>(2.0) - q).positive();
        let q1 = (one - q).positive();
        let (s2, s1) = (q2 * q2, q1 * q1);
        let w = (s1 * q1).mul_add(number(-1.0), s2 * q2 * number(0.25));
        let inner_f = q.mul_add(number(-3.0), number(4.0));
        let inner_g = inverse * number(-3.0);
        let outer_f = s2 * inverse;
        let outer_g = -(q2 * (q + number(2.0)) * (inverse * inverse * inverse));
        (w, q.select_less(one, inner_f, outer_f), q.select_less(one, inner_g, outer_g))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let term = |from: f64| -> Result<(Tensor, Tensor)> {
            let a = q.affine(-1.0, from)?.relu()?;
            let square = a.sqr()?;
            Ok((square.mul(&a)?, square))
        };
        let ((w2, s2), (w1, s1)) = (term(2.0)?, term(1.0)?);
        let w = (w2.affine(0.25, 0.0)? - w1)?;
        Ok((w, (s2.affine(-0.75, 0.0)? + s1.affine(3.0, 0.0)?)?.div(q)?))
    }
}
