//! Laminar viscosity.
//!
//! e = eta_ij (u_i - u_j), eta_ij = 2 eta_i eta_j/(eta_i + eta_j) the harmonic mean (Adami, Hu and Adams 2013,
//! eq. 6 and 8). One viscosity in the whole scene: eta_ij = eta.

use crate::numerics::lanes::Lanes;
use crate::sph::operators::composed;
use crate::sph::operators::rates::{Side, SideBar};
use candle_core::{Result, Tensor};

#[inline(always)]
pub fn add<L: Lanes, const D: usize>(eta: L, a: &Side<L, D>, b: &Side<L, D>, e: &mut [L; D]) {
    for d in 0..D {
        e[d] = eta.mul_add(a.velocity[d] - b.velocity[d], e[d]);
    }
}

/// s gains eta alpha.(u_i - u_j).
#[inline(always)]
pub fn adjoint<L: Lanes, const D: usize>(
    eta: L,
    a: &Side<L, D>,
    b: &Side<L, D>,
    alpha: &[L; D],
    c: L,
    s: &mut L,
    bar: &mut SideBar<L, D>,
) {
    for d in 0..D {
        let weighted = eta * alpha[d];
        *s = weighted.mul_add(a.velocity[d] - b.velocity[d], *s);
        bar.velocity[d] = c.mul_add(weighted, bar.velocity[d]);
    }
}

/// `[D, N, K]`.
pub fn composed(eta: f64, pairs: &composed::Pairs, velocity: &Tensor) -> Result<Tensor> {
    (pairs.own(velocity)? - pairs.other(velocity)?)?.affine(eta, 0.0)
}
