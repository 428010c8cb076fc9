//! Pressure force.
//!
//! e = -p_ij r_ij with the density-weighted pressure p_ij = (rho_j p_i + rho_i p_j)/(rho_i + rho_j)
//! (Adami, Hu and Adams 2013, eq. 7). It is symmetric in i and j, so momentum is conserved.

use super::equation_of_state::EquationOfState;
use super::pair_law::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use candle_core::Result;

#[derive(Debug, Clone, Copy)]
pub struct Pressure(pub EquationOfState);

/// p and dp/drho of the row's own particle.
#[derive(Clone, Copy)]
pub struct Prepared<L> {
    pressure: L,
    slope: L,
}

impl Pressure {
    /// p_ij, p_j and 1/(rho_i + rho_j).
    #[inline(always)]
    fn mean<L: Lanes, const D: usize>(&self, own: &Prepared<L>, pair: &Pair<L, D>) -> (L, L, L) {
        let (a, b) = (pair.own, pair.other);
        let other = self.0.pressure_lanes(b.density);
        let inverse = L::splat(L::Real::of(1.0)) / (a.density + b.density);
        (b.density.mul_add(own.pressure, a.density * other) * inverse, other, inverse)
    }
}

impl PairLaw for Pressure {
    type Own<L: Lanes, const D: usize> = Prepared<L>;

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, own: &Side<L, D>) -> Prepared<L> {
        Prepared { pressure: self.0.pressure_lanes(own.density), slope: self.0.slope_lanes(own.density) }
    }

    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, own: &Prepared<L>, pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (p, _, _) = self.mean(own, pair);
        for d in 0..D {
            sums.common[d] = sums.common[d] - p * pair.difference[d];
        }
    }

    /// s gains -p_ij (alpha.r). d p_ij/d rho_i = rho_j (p_j - p_i)/(rho_i + rho_j)^2 + p'(rho_i) rho_j/(rho_i + rho_j).
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        own: &Prepared<L>,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        to: &mut PairBar<L, D>,
    ) {
        let (p, other, inverse) = self.mean(own, pair);
        to.scalar = to.scalar - p * bars.along;
        for d in 0..D {
            to.by_difference[d] = to.by_difference[d] - p * bars.acceleration[d];
        }
        let weight = pair.other.density * inverse;
        let derivative = weight * ((other - own.pressure).mul_add(inverse, own.slope));
        to.own.density = to.own.density - pair.weight * bars.along * derivative;
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let (density, pressure) = (&fields.density, self.0.pressure_composed(&fields.density)?);
        let (rho_i, rho_j) = (pairs.own(density)?, pairs.other(density)?);
        let (p_i, p_j) = (pairs.own(&pressure)?, pairs.other(&pressure)?);
        let mean = ((&rho_j * p_i)? + (&rho_i * p_j)?)?.div(&(rho_i + rho_j)?)?;
        PairTensors::add(&mut sums.common, pairs.difference.broadcast_mul(&mean)?.neg()?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("pressure");
    }
}
