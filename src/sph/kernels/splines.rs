//! Splines.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

/// The quintic spline (Morris, Fox and Zhu 1997, eq. 4), support 3 h.
///
/// w(q) = (3-q)^5 - 6 (2-q)^5 + 15 (1-q)^5, each term only where its bracket is positive,
/// sigma = 1/(120 h), 7/(478 pi h^2), 3/(359 pi h^3) in 1, 2, 3 dimensions.
///
/// For q < 1 the slopes are polynomials without a difference: w'/q = -5 (24 - 24 q^2 + 10 q^3),
/// (w'/q)'/q = -5 (-48 + 30 q). The textbook form subtracts numbers of size 100 to get 0 there, which ruins f32 gradients.
#[derive(Debug, Clone, Copy)]
pub struct QuinticSpline;

impl SmoothingKernel for QuinticSpline {
    const SUPPORT: f64 = 3.0;
    const SLOPE: f64 = -5.0;

    fn at_zero(_: usize) -> f64 {
        66.0
    }

    fn sigma(dimension: usize, h: f64) -> f64 {
        ratio([(1.0, 120.0), (7.0, 478.0 * PI), (3.0, 359.0 * PI)], dimension, h)
    }

    #[inline(always)]
    fn shape<L: Lanes>(q: L, inverse: L, _: L) -> (L, L, L) {
        let one = number::<L>(1.0);
        let q3 = (number::<L>(3.0) - q).positive();
        let q2 = (number::<L>(2.0) - q).positive();
        let q1 = (one - q).positive();
        let (s3, s2, s1) = (q3 * q3, q2 * q2, q1 * q1);
        let (f3, f2, f1) = (s3 * s3, s2 * s2, s1 * s1);
        let w = (f2 * q2).mul_add(number(-6.0), f3 * q3);
        let w = (f1 * q1).mul_add(number(15.0), w);
        let outer_f = f2.mul_add(number(-6.0), f3) * inverse;
        let derivative = (s2 * q2).mul_add(number(24.0), s3 * q3 * number(-4.0));
        let outer_g = (derivative - outer_f) * (inverse * inverse);
        let inner_f = (q * q).mul_add(number::<L>(10.0).mul_add(q, number(-24.0)), number(24.0));
        let inner_g = q.mul_add(number(30.0), number(-48.0));
        (w, q.select_less(one, inner_f, outer_f), q.select_less(one, inner_g, outer_g))
    }

    fn composed(q: &Tensor, _: usize) -> Result<(Tensor, Tensor)> {
        let term = |from: f64| -> Result<(Tensor, Tensor)> {
            let a = q.affine(-1.0, from)?.relu()?;
            let fourth = a.sqr()?.sqr()?;
            Ok((fourth.mul(&a)?, fourth))
        };
        let ((w3, s3), (w2, s2), (w1, s1)) = (term(3.0)?, term(2.0)?, term(1.0)?);
        let sum = |a: Tensor, b: Tensor, c: Tensor| (a - b.affine(6.0, 0.0)?)? + c.affine(15.0, 0.0)?;
        Ok((sum(w3, w2, w1)?, sum(s3, s2, s1)?.div(q)?.affine(-5.0, 0.0)?))
    }
}

/// The cubic spline (Monaghan and Lattanzio 1985; Monaghan 1992, sec. 7), support 2 h.
///
/// 4 w(q) = (2-q)^3 - 4 (1-q)^3, each term only where its bracket is positive: 1 - 3/2 q^2 + 3/4 q^3 for q < 1;
/// sigma = 2/(3 h), 10/(7 pi h^2), 1/(pi h^3) in 1, 2, 3 dimensions.
///
/// w'/q = -3/4 (4 - 3 q) for q < 1, -3/4 (2-q)^2/q beyond; (w'/q)'/q = -3/4 (-3/q), -3/4 (-(2-q) (2+q)/q^3). Its second
/// derivative has a kink at 1: rougher sums than the quintic spline's, from fewer neighbours.
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
