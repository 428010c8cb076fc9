//! Diffusion of the velocity, a term of delta-SPH in the momentum equation.
//!
//! du_i/dt gains alpha h c rho_0/rho_i sum_j V_j pi_ij grad_i W_ij over fluid j, pi_ij = (u_i - u_j) . r_ij/r_ij^2
//! (Marrone et al. 2011, eq. 4; JAX-SPH's `acceleration_delta_fn`). It damps compression and expansion. The force is
//! antisymmetric in i and j, so momentum is conserved.

use super::pair_law::{dot, Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Scales, Side, Sums};
use crate::config::scene::{FluxName, Standard};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use candle_core::Result;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VelocityDiffusion {
    /// alpha; 0.01 ... 0.1 is usual.
    pub strength: f64,
    /// Speed of sound c.
    pub sound_speed: f64,
    /// Smoothing length h.
    pub smoothing_length: f64,
    /// Reference density rho_0.
    pub reference_density: f64,
}

impl VelocityDiffusion {
    /// The one that the method's keys choose, none but in delta-SPH.
    pub fn of(own: &Standard, scales: &Scales) -> Option<Self> {
        let Scales { sound_speed, smoothing_length, reference_density } = *scales;
        let strength = own.velocity_diffusion;
        let acts = own.flux == FluxName::Delta && strength > 0.0;
        acts.then_some(Self { strength, sound_speed, smoothing_length, reference_density })
    }

    /// alpha h c rho_0.
    fn factor(&self) -> f64 {
        self.strength * self.smoothing_length * self.sound_speed * self.reference_density
    }
}

/// (u_i - u_j) . r_ij and, between fluid particles, 1/r_ij^2, else 0.
#[inline(always)]
fn parting<L: Lanes, const D: usize>(pair: &Pair<L, D>) -> ([L; D], L, L) {
    let mut velocity = [L::zero(); D];
    for d in 0..D {
        velocity[d] = pair.own.velocity[d] - pair.other.velocity[d];
    }
    let inverse = pair.fluid.apply(L::splat(L::Real::of(1.0)) / pair.square);
    (velocity, dot(&velocity, &pair.difference), inverse)
}

impl PairLaw for VelocityDiffusion {
    type Own<L: Lanes, const D: usize> = L;

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) -> L {
        L::splat(L::Real::of(self.factor()))
    }

    /// The force on i gains k r, k = alpha h c rho_0 V_i V_j F pi.
    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, factor: &L, pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (_, parting, inverse) = parting(pair);
        let k = *factor * pair.own.volume * pair.other.volume * pair.slope * parting * inverse;
        for d in 0..D {
            sums.force[d] = k.mul_add(pair.difference[d], sums.force[d]);
        }
    }

    /// l gains k (alpha.r). dk/dV_i = k/V_i, d pi/du_i = r/r^2, d pi/dr = (u_i - u_j - 2 pi r)/r^2.
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        factor: &L,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        to: &mut PairBar<L, D>,
    ) {
        let (velocity, parting, inverse) = parting(pair);
        let pi = parting * inverse;
        let per_volume = *factor * pair.other.volume * pi;
        let k = per_volume * pair.own.volume * pair.slope;
        to.own.volume = (per_volume * pair.slope).mul_add(bars.along, to.own.volume);
        to.by_slope = (per_volume * pair.own.volume).mul_add(bars.along, to.by_slope);
        // Derivative by pi, over r^2.
        let by_pi = *factor * pair.own.volume * pair.other.volume * pair.slope * bars.along * inverse;
        let twice = pi + pi;
        for d in 0..D {
            to.own.velocity[d] = by_pi.mul_add(pair.difference[d], to.own.velocity[d]);
            let by_position = by_pi * (velocity[d] - twice * pair.difference[d]);
            to.own.position[d] += k.mul_add(bars.acceleration[d], by_position);
        }
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let velocity = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?;
        let pi = velocity.mul(&pairs.difference)?.sum_keepdim(0)?.div(&pairs.distance.sqr()?)?;
        let fluid = pairs.other(&pairs.is_fluid)?;
        let weight = pairs.other(&fields.volume)?.mul(&fields.slope)?.mul(&pi)?.mul(&fluid)?;
        // m_i/rho_i = V_i.
        let sum = pairs.difference.broadcast_mul(&weight)?.sum(2)?;
        PairTensors::add(&mut sums.force, sum.broadcast_mul(&fields.volume)?.affine(self.factor(), 0.0)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("diffusion of velocity");
    }
}
