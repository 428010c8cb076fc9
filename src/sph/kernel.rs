//! Smoothing kernels.

use crate::numerics::lanes::{Lanes, Real};

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
    /// q = d/h and 1/q. At d = 0, which only self pairs and padding have, q is 0 and 1/q large but finite.
    #[inline(always)]
    fn q(&self, r2: L) -> (L, L) {
        let r2 = r2 * (self.inverse_h * self.inverse_h);
        let inverse = (r2 + number(1e-30)).inverse_sqrt();
        (r2 * inverse, inverse)
    }

    /// W, F and G from one distance; what the caller drops is not computed.
    #[inline(always)]
    pub fn all(&self, r2: L) -> (L, L, L) {
        let (q, inverse) = self.q(r2);
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
        (self.w * w, self.f * q.select_less(one, inner_f, outer_f), self.g * q.select_less(one, inner_g, outer_g))
    }

    /// W.
    #[inline(always)]
    pub fn value(&self, r2: L) -> L {
        self.all(r2).0
    }

    /// F = W'(d)/d.
    #[inline(always)]
    pub fn slope(&self, r2: L) -> L {
        self.all(r2).1
    }

    /// F and G = F'(d)/d.
    #[inline(always)]
    pub fn slope_and_curvature(&self, r2: L) -> (L, L) {
        let (_, f, g) = self.all(r2);
        (f, g)
    }
}
