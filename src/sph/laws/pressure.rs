//! Pressure force.
//!
//! e = -p_ij r_ij with the density-weighted pressure p_ij = (rho_j p_i + rho_i p_j)/(rho_i + rho_j)
//! (Adami, Hu and Adams 2013, eq. 7). Symmetric in i and j, so momentum is conserved.

use crate::numerics::lanes::{Lanes, Real};
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::operators::composed;
use crate::sph::operators::rates::{Side, SideBar};
use candle_core::{Result, Tensor};

#[derive(Clone, Copy)]
pub struct Pressure(pub EquationOfState);

/// What a row's own side contributes to all of its pairs.
pub struct Prepared<L> {
    pressure: L,
    slope: L,
}

impl Pressure {
    #[inline(always)]
    pub fn prepare<L: Lanes, const D: usize>(&self, a: &Side<L, D>) -> Prepared<L> {
        Prepared { pressure: self.0.pressure_lanes(a.density), slope: self.0.slope_lanes(a.density) }
    }

    /// p_ij, p_j and 1/(rho_i + rho_j).
    #[inline(always)]
    fn mean<L: Lanes, const D: usize>(&self, a: &Side<L, D>, own: &Prepared<L>, b: &Side<L, D>) -> (L, L, L) {
        let other = self.0.pressure_lanes(b.density);
        let inverse = L::splat(L::Real::of(1.0)) / (a.density + b.density);
        (b.density.mul_add(own.pressure, a.density * other) * inverse, other, inverse)
    }

    #[inline(always)]
    pub fn add<L: Lanes, const D: usize>(
        &self,
        a: &Side<L, D>,
        own: &Prepared<L>,
        b: &Side<L, D>,
        dr: &[L; D],
        e: &mut [L; D],
    ) {
        let (p, _, _) = self.mean(a, own, b);
        for d in 0..D {
            e[d] = e[d] - p * dr[d];
        }
    }

    /// s gains -p_ij (alpha.r). d p_ij/d rho_i = rho_j (p_j - p_i)/(rho_i + rho_j)^2 + p'(rho_i) rho_j/(rho_i + rho_j).
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    pub fn adjoint<L: Lanes, const D: usize>(
        &self,
        a: &Side<L, D>,
        own: &Prepared<L>,
        b: &Side<L, D>,
        along: L,
        alpha: &[L; D],
        c: L,
        s: &mut L,
        by_position: &mut [L; D],
        bar: &mut SideBar<L, D>,
    ) {
        let (p, other, inverse) = self.mean(a, own, b);
        *s = *s - p * along;
        for d in 0..D {
            by_position[d] = by_position[d] - p * alpha[d];
        }
        let weight = b.density * inverse;
        let derivative = weight * ((other - own.pressure).mul_add(inverse, own.slope));
        bar.density = bar.density - c * along * derivative;
    }

    /// `[D, N, K]`.
    pub fn composed(&self, pairs: &composed::Pairs, density: &Tensor) -> Result<Tensor> {
        let eos = self.0;
        let ratio = density.affine(1.0 / eos.reference_density, 0.0)?;
        let power = if eos.gamma == 1 { ratio } else { ratio.powf(eos.gamma as f64)? };
        let pressure = power.affine(eos.reference_pressure, eos.at_vacuum())?;
        let (rho_i, rho_j) = (pairs.own(density)?, pairs.other(density)?);
        let (p_i, p_j) = (pairs.own(&pressure)?, pairs.other(&pressure)?);
        let mean = ((&rho_j * p_i)? + (&rho_i * p_j)?)?.div(&(rho_i + rho_j)?)?;
        pairs.difference.broadcast_mul(&mean)?.neg()
    }
}
