//! Laminar viscosity.
//!
//! e = eta_ij (u_i - u_j), where eta_ij = 2 eta_i eta_j/(eta_i + eta_j) is the harmonic mean (Adami, Hu and Adams 2013,
//! eq. 6 and 8). A scene has one viscosity, so eta_ij = eta.

use super::pair_law::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use candle_core::Result;

/// The dynamic viscosity eta.
#[derive(Debug, Clone, Copy)]
pub struct Viscosity(pub f64);

impl PairLaw for Viscosity {
    type Own<L: Lanes, const D: usize> = L;

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) -> L {
        L::splat(L::Real::of(self.0))
    }

    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, eta: &L, pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        for d in 0..D {
            sums.common[d] = eta.mul_add(pair.own.velocity[d] - pair.other.velocity[d], sums.common[d]);
        }
    }

    /// s gains eta alpha.(u_i - u_j).
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(&self, eta: &L, pair: &Pair<L, D>, bars: &Bars<L, D>, to: &mut PairBar<L, D>) {
        for d in 0..D {
            let weighted = *eta * bars.acceleration[d];
            let difference = pair.own.velocity[d] - pair.other.velocity[d];
            to.scalar = weighted.mul_add(difference, to.scalar);
            to.own.velocity[d] = pair.weight.mul_add(weighted, to.own.velocity[d]);
        }
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let difference = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?;
        PairTensors::add(&mut sums.common, difference.affine(self.0, 0.0)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("viscosity");
    }
}
