//! Smoothing kernels.

use crate::lanes::{Lanes, Real};

/// The quintic spline (Morris, Fox and Zhu 1997), support 3 h:
///
/// w(q) = (3-q)^5 - 6 (2-q)^5 + 15 (1-q)^5, each term only where its bracket is positive, W = sigma w(d/h),
/// sigma = 1/(120 h), 7/(478 pi h^2), 3/(359 pi h^3) in 1, 2, 3 dimensions.
///
/// What the operators need besides W is F = W'(d)/d and, for adjoints, G = F'(d)/d. For q < 1 both are
/// polynomials without a difference: w'/q = -5 (24 - 24 q^2 + 10 q^3), (w'/q)'/q = -5 (-48 + 30 q). The
/// textbook form subtracts numbers of size 100 to get 0 there, which ruins f32 gradients.
#[derive(Debug, Clone, Copy)]
pub struct Quintic {
    pub smoothing_length: f64,
    pub sigma: f64,
}

impl Quintic {
    pub fn new(dimension: usize, smoothing_length: f64) -> Self {
        use std::f64::consts::PI;
        let h = smoothing_length;
        let sigma = match dimension {
            1 => 1.0 / (120.0 * h),
            2 => 7.0 / (478.0 * PI * h * h),
            _ => 3.0 / (359.0 * PI * h * h * h),
        };
        Self { smoothing_length: h, sigma }
    }

    pub fn cutoff(&self) -> f64 {
        3.0 * self.smoothing_length
    }

    /// W(0): a particle's own share of its density sum.
    pub fn at_zero(&self) -> f64 {
        66.0 * self.sigma
    }

    /// The constants in lanes.
    #[inline(always)]
    pub fn lanes<L: Lanes>(&self) -> QuinticLanes<L> {
        let h = self.smoothing_length;
        QuinticLanes {
            inverse_h: L::splat(L::Real::of(1.0 / h)),
            w: L::splat(L::Real::of(self.sigma)),
            f: L::splat(L::Real::of(-5.0 * self.sigma / (h * h))),
            g: L::splat(L::Real::of(-5.0 * self.sigma / (h * h * h * h))),
        }
    }
}

/// [`Quintic`] over lanes, as functions of the squared distance.
#[derive(Clone, Copy)]
pub struct QuinticLanes<L> {
    inverse_h: L,
    w: L,
    f: L,
    g: L,
}

#[inline(always)]
fn number<L: Lanes>(value: f64) -> L {
    L::splat(L::Real::of(value))
}

impl<L: Lanes> QuinticLanes<L> {
    #[inline(always)]
    fn q(&self, r2: L) -> L {
        r2.sqrt() * self.inverse_h
    }

    /// W.
    #[inline(always)]
    pub fn value(&self, r2: L) -> L {
        let q = self.q(r2);
        let q3 = (number::<L>(3.0) - q).positive();
        let q2 = (number::<L>(2.0) - q).positive();
        let q1 = (number::<L>(1.0) - q).positive();
        let fifth = |a: L| {
            let s = a * a;
            s * s * a
        };
        self.w * (fifth(q3) - number::<L>(6.0) * fifth(q2) + number::<L>(15.0) * fifth(q1))
    }

    /// F = W'(d)/d.
    #[inline(always)]
    pub fn slope(&self, r2: L) -> L {
        let q = self.q(r2);
        let q3 = (number::<L>(3.0) - q).positive();
        let q2 = (number::<L>(2.0) - q).positive();
        let (s3, s2) = (q3 * q3, q2 * q2);
        let outer = (s3 * s3 - number::<L>(6.0) * (s2 * s2)) / q;
        let inner = (q * q).mul_add(number::<L>(10.0) * q - number::<L>(24.0), number(24.0));
        self.f * q.select_less(number(1.0), inner, outer)
    }

    /// F and G = F'(d)/d.
    #[inline(always)]
    pub fn slope_and_curvature(&self, r2: L) -> (L, L) {
        let q = self.q(r2);
        let q3 = (number::<L>(3.0) - q).positive();
        let q2 = (number::<L>(2.0) - q).positive();
        let (s3, s2) = (q3 * q3, q2 * q2);
        let inverse = number::<L>(1.0) / q;
        let outer_f = (s3 * s3 - number::<L>(6.0) * (s2 * s2)) * inverse;
        let derivative = number::<L>(24.0) * (s2 * q2) - number::<L>(4.0) * (s3 * q3);
        let outer_g = (derivative - outer_f) * (inverse * inverse);
        let inner_f = (q * q).mul_add(number::<L>(10.0) * q - number::<L>(24.0), number(24.0));
        let inner_g = q.mul_add(number(30.0), number(-48.0));
        let one = number(1.0);
        (self.f * q.select_less(one, inner_f, outer_f), self.g * q.select_less(one, inner_g, outer_g))
    }
}
