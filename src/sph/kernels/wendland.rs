//! Wendland's kernels.

use super::shape::ratio;
use super::{number, SmoothingKernel};
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};
use std::f64::consts::PI;

/// Wendland's C2 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
///
/// w(q) = (1 - q/2)^4 (2 q + 1) for q < 2 in two and three dimensions, sigma = 7/(4 pi h^2), 21/(16 pi h^3); in one
/// dimension (1 - q/2)^3 (3 q/2 + 1) would do (JAX-SPH has it, no scene here needs it); in its place stands the same w, whose
/// Fourier transform is positive there too, with sigma = 3/(4 h).
///
/// w'/q = -5 (1 - q/2)^3, (w'/q)'/q = -5 (-3/2) (1 - q/2)^2/q. Its Fourier transform is positive, so particles do not
/// pair however many neighbours they have; h of 1.3 to 2 spacings is usual.
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

/// Wendland's C4 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
///
/// w(q) = (1 - q/2)^6 (35/12 q^2 + 3 q + 1) for q < 2, sigma = 9/(4 pi h^2), 495/(256 pi h^3) in 2, 3 dimensions. In one
/// dimension the same w with sigma = 27/(32 h) (see [`WendlandC2`]).
///
/// w'/q = -14/3 (1 - q/2)^5 (5/2 q + 1), (w'/q)'/q = -14/3 (-15/2) (1 - q/2)^4. Narrower than C2 at the same h: it wants
/// an h of about 1.6 to 2 spacings.
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

/// Wendland's C6 kernel (Wendland 1995; Dehnen and Aly 2012, table 1), support 2 h.
///
/// w(q) = (1 - q/2)^8 (4 q^3 + 25/4 q^2 + 4 q + 1) for q < 2, sigma = 39/(14 pi h^2), 1365/(512 pi h^3) in 2, 3
/// dimensions. In one dimension the same w with sigma = 15/(16 h) (see [`WendlandC2`]).
///
/// w'/q = -11/2 (1 - q/2)^7 (4 q^2 + 7/2 q + 1), (w'/q)'/q = -11/2 (-6) (1 - q/2)^6 (3 q + 1). The smoothest and, at the
/// same h, the narrowest of the three: it wants an h of about 1.8 to 2.2 spacings.
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
