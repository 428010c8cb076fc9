//! Transport velocity: particles drift with v = u + w instead of u, which keeps them evenly spread.
//!
//! Momentum gains e = (A_i + A_j)/2 . r_ij with A = rho u (x) w (Adami, Hu and Adams 2013, eq. 8 and 9). Records hold W
//! = rho w/2, so e = u_i (W_i.r) + u_j (W_j.r). The transport acceleration is p(0) sum c r (their eq. 13).

use super::pair_law::{dot, Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, Sums};
use crate::numerics::lanes::Lanes;
use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

#[derive(Debug, Clone, Copy)]
pub struct TransportVelocity;

impl TransportVelocity {
    /// Adds only the transport acceleration by the background pressure.
    pub fn spread(pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        PairTensors::add(&mut sums.spread, pairs.difference.broadcast_mul(&fields.weight)?.sum(2)?)
    }
}

impl PairLaw for TransportVelocity {
    const TRANSPORT: bool = true;
    type Own<L: Lanes, const D: usize> = ();

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) {}

    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (a, b, dr) = (pair.own, pair.other, &pair.difference);
        let (own, other) = (dot(&a.transport, dr), dot(&b.transport, dr));
        for d in 0..D {
            sums.common[d] = a.velocity[d].mul_add(own, b.velocity[d].mul_add(other, sums.common[d]));
            sums.spread[d] = pair.weight.mul_add(dr[d], sums.spread[d]);
        }
    }

    /// s gains (alpha.u_i)(W_i.r) + (alpha.u_j)(W_j.r) + beta.r.
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, bars: &Bars<L, D>, to: &mut PairBar<L, D>) {
        let (a, b, dr) = (pair.own, pair.other, &pair.difference);
        let (alpha, beta) = (&bars.acceleration, &bars.transport);
        let (own, other) = (dot(&a.transport, dr), dot(&b.transport, dr));
        let (alpha_own, alpha_other) = (dot(alpha, &a.velocity), dot(alpha, &b.velocity));
        to.scalar = alpha_own.mul_add(own, alpha_other.mul_add(other, to.scalar)) + dot(beta, dr);
        let (c_own, c_alpha) = (pair.weight * own, pair.weight * alpha_own);
        for d in 0..D {
            to.by_difference[d] += alpha_own.mul_add(a.transport[d], alpha_other.mul_add(b.transport[d], beta[d]));
            to.own.velocity[d] = c_own.mul_add(alpha[d], to.own.velocity[d]);
            to.own.transport[d] = c_alpha.mul_add(dr[d], to.own.transport[d]);
        }
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let Some(shift) = &fields.shift else { candle_core::bail!("a transport velocity without shift") };
        let w = shift.broadcast_mul(&fields.density)?.affine(0.5, 0.0)?;
        let along = |w: Tensor| w.mul(&pairs.difference)?.sum_keepdim(0);
        let own = pairs.own(&fields.velocity)?.broadcast_mul(&along(pairs.own(&w)?)?)?;
        let other = pairs.other(&fields.velocity)?.broadcast_mul(&along(pairs.other(&w)?)?)?;
        PairTensors::add(&mut sums.common, (own + other)?)?;
        Self::spread(pairs, fields, sums)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("transport velocity: stress and background pressure");
    }
}
