//! Transport velocity: particles drift with v = u + w instead of u, which keeps them evenly spread.
//!
//! Momentum: e = (A_i + A_j)/2 . r_ij with A = rho u (x) w (Adami, Hu and Adams 2013, eq. 8 and 9). Records hold
//! W = rho w/2, so e = u_i (W_i.r) + u_j (W_j.r). The background pressure's p(0) r is summed in [`crate::sph::operators::rates`].

use crate::numerics::lanes::Lanes;
use crate::sph::operators::composed;
use crate::sph::operators::rates::{dot, Side, SideBar};
use candle_core::{Result, Tensor};

#[inline(always)]
pub fn add<L: Lanes, const D: usize>(a: &Side<L, D>, b: &Side<L, D>, dr: &[L; D], e: &mut [L; D]) {
    let (own, other) = (dot(&a.transport, dr), dot(&b.transport, dr));
    for d in 0..D {
        e[d] = a.velocity[d].mul_add(own, b.velocity[d].mul_add(other, e[d]));
    }
}

/// s gains (alpha.u_i)(W_i.r) + (alpha.u_j)(W_j.r) + beta.r.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub fn adjoint<L: Lanes, const D: usize>(
    a: &Side<L, D>,
    b: &Side<L, D>,
    dr: &[L; D],
    alpha: &[L; D],
    beta: &[L; D],
    c: L,
    s: &mut L,
    by_position: &mut [L; D],
    bar: &mut SideBar<L, D>,
) {
    let (own, other) = (dot(&a.transport, dr), dot(&b.transport, dr));
    let (alpha_own, alpha_other) = (dot(alpha, &a.velocity), dot(alpha, &b.velocity));
    *s = alpha_own.mul_add(own, alpha_other.mul_add(other, *s)) + dot(beta, dr);
    let (c_own, c_alpha) = (c * own, c * alpha_own);
    for d in 0..D {
        by_position[d] += alpha_own.mul_add(a.transport[d], alpha_other.mul_add(b.transport[d], beta[d]));
        bar.velocity[d] = c_own.mul_add(alpha[d], bar.velocity[d]);
        bar.transport[d] = c_alpha.mul_add(dr[d], bar.transport[d]);
    }
}

/// `[D, N, K]`.
pub fn composed(pairs: &composed::Pairs, density: &Tensor, velocity: &Tensor, shift: &Tensor) -> Result<Tensor> {
    let w = shift.broadcast_mul(density)?.affine(0.5, 0.0)?;
    let along = |w: Tensor| w.mul(&pairs.difference)?.sum_keepdim(0);
    let own = pairs.own(velocity)?.broadcast_mul(&along(pairs.own(&w)?)?)?;
    let other = pairs.other(velocity)?.broadcast_mul(&along(pairs.other(&w)?)?)?;
    own + other
}
