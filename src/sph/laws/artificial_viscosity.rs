//! Artificial viscosity (Monaghan 1992, Annu. Rev. Astron. Astrophys. 30, eq. 4.1 to 4.3).
//!
//! dv_i/dt gains -sum_j m_j Pi_ij F r_ij with Pi_ij = (-alpha c mu_ij + beta mu_ij^2)/rho_ij, mu_ij = h (v_ij .
//! r_ij)/(r_ij^2 + 0.01 h^2) where particles approach (v_ij . r_ij < 0), else 0. rho_ij is the mean density and c the
//! reference speed of sound. The force is antisymmetric in i and j, so momentum is conserved. alpha = 0.01 ... 0.1 is
//! usual for free-surface flow. beta is for strong shocks, where it is 2 alpha; its default here is 0.
//!
//! With `every_pair`, as in JAX-SPH, the law also acts on pairs that separate, but not on wall particles. Then it is a
//! viscosity, while otherwise it only resists compression.

use super::pair_law::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Scales, Side, Sums};
use crate::config::scene::{Standard, ViscousPairs};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use crate::sph::masks::below;
use candle_core::Result;

/// The fraction of h^2 in the denominator that keeps mu finite where particles meet.
const GUARD: f64 = 0.01;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArtificialViscosity {
    pub alpha: f64,
    pub beta: f64,
    /// Speed of sound c.
    pub sound_speed: f64,
    /// Smoothing length h.
    pub smoothing_length: f64,
    /// Whether it also acts on pairs that separate, and then only on pairs of fluid particles.
    pub every_pair: bool,
}

impl ArtificialViscosity {
    /// The one that the method's keys choose, none for a strength of 0.
    pub fn of(own: &Standard, scales: &Scales) -> Option<Self> {
        let Scales { sound_speed, smoothing_length, .. } = *scales;
        let every_pair = own.artificial_viscosity_pairs == ViscousPairs::All;
        (own.artificial_viscosity > 0.0).then_some(Self {
            alpha: own.artificial_viscosity,
            beta: 0.0,
            sound_speed,
            smoothing_length,
            every_pair,
        })
    }
}

/// alpha c, beta, h and 0.01 h^2 in lanes.
#[derive(Clone, Copy)]
pub struct Constants<L> {
    linear: L,
    quadratic: L,
    length: L,
    guard: L,
    every_pair: bool,
}

/// The terms of a pair that the forward pass and the adjoint share.
struct Approach<L> {
    /// mu, and 0 for pairs that the law does not act on.
    mu: L,
    /// alpha c - beta mu.
    strength: L,
    /// 1/(r^2 + 0.01 h^2), and 0 for pairs that the law does not act on.
    inverse: L,
    /// 2/(rho_i + rho_j).
    inverse_density: L,
}

impl<L: Lanes> Constants<L> {
    #[inline(always)]
    fn approach<const D: usize>(&self, pair: &Pair<L, D>) -> Approach<L> {
        let mut closing = L::zero();
        for d in 0..D {
            closing = (pair.own.velocity[d] - pair.other.velocity[d]).mul_add(pair.difference[d], closing);
        }
        let number = |x: f64| L::splat(L::Real::of(x));
        let inverse = number(1.0) / (pair.square + self.guard);
        let inverse = match self.every_pair {
            true => pair.fluid.apply(inverse),
            false => closing.select_less(L::zero(), inverse, L::zero()),
        };
        let mu = self.length * closing * inverse;
        Approach {
            mu,
            strength: self.linear - self.quadratic * mu,
            inverse,
            inverse_density: number(2.0) / (pair.own.density + pair.other.density),
        }
    }
}

impl PairLaw for ArtificialViscosity {
    type Own<L: Lanes, const D: usize> = Constants<L>;

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) -> Constants<L> {
        let number = |x: f64| L::splat(L::Real::of(x));
        Constants {
            linear: number(self.alpha * self.sound_speed),
            quadratic: number(self.beta),
            length: number(self.smoothing_length),
            guard: number(GUARD * self.smoothing_length * self.smoothing_length),
            every_pair: self.every_pair,
        }
    }

    /// The force on i gains k r, k = m_i m_j F mu (alpha c - beta mu)/rho_ij.
    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, own: &Constants<L>, pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (a, b, at) = (pair.own, pair.other, own.approach(pair));
        let masses = a.volume * a.density * (b.volume * b.density);
        let k = masses * pair.slope * at.mu * at.strength * at.inverse_density;
        for d in 0..D {
            sums.force[d] = k.mul_add(pair.difference[d], sums.force[d]);
        }
    }

    /// l gains k (alpha.r). With q = alpha c - beta mu: dk/dV_i = k/V_i, dk/drho_i = k (1/rho_i - 1/(rho_i + rho_j)),
    /// dk/dmu = m_i m_j F (q - beta mu)/rho_ij, dmu/du_i = h r/(r^2 + ..), dmu/dr = (h v - 2 mu r)/(r^2 + ..).
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        own: &Constants<L>,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        to: &mut PairBar<L, D>,
    ) {
        let (a, b, at) = (pair.own, pair.other, own.approach(pair));
        let number = |x: f64| L::splat(L::Real::of(x));
        let other_mass = b.volume * b.density;
        // k over (V_i F). The volume's derivative uses the same factor.
        let per_volume = a.density * other_mass * at.mu * at.strength * at.inverse_density;
        let k = per_volume * a.volume * pair.slope;
        to.own.volume = (per_volume * pair.slope).mul_add(bars.along, to.own.volume);
        let by_density = number(1.0) / a.density - number(0.5) * at.inverse_density;
        to.own.density = (k * bars.along).mul_add(by_density, to.own.density);
        to.by_slope = (per_volume * a.volume).mul_add(bars.along, to.by_slope);
        let masses = a.volume * a.density * other_mass;
        let by_mu =
            masses * pair.slope * (at.strength - own.quadratic * at.mu) * at.inverse_density * bars.along * at.inverse;
        for d in 0..D {
            let velocity = a.velocity[d] - b.velocity[d];
            let along = by_mu * own.length;
            to.own.velocity[d] = along.mul_add(pair.difference[d], to.own.velocity[d]);
            let by_distance = number(2.0) * at.mu * pair.difference[d];
            let by_position = by_mu * (own.length * velocity - by_distance);
            to.own.position[d] += k.mul_add(bars.acceleration[d], by_position);
        }
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let velocity = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?;
        let closing = velocity.mul(&pairs.difference)?.sum_keepdim(0)?;
        let acts = match self.every_pair {
            true => pairs.other(&pairs.is_fluid)?,
            false => below(&closing, 0.0)?,
        };
        let h = self.smoothing_length;
        let square = pairs.difference.sqr()?.sum_keepdim(0)?.affine(1.0, GUARD * h * h)?;
        let mu = closing.mul(&acts)?.affine(h, 0.0)?.div(&square)?;
        let strength = mu.affine(-self.beta, self.alpha * self.sound_speed)?;
        let densities = (pairs.own(&fields.density)? + pairs.other(&fields.density)?)?.affine(0.5, 0.0)?;
        let masses = pairs.own(&fields.mass)?.mul(&pairs.other(&fields.mass)?)?;
        let k = masses.mul(&fields.slope)?.mul(&mu)?.mul(&strength)?.div(&densities)?;
        PairTensors::add(&mut sums.force, pairs.difference.broadcast_mul(&k)?.sum(2)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("artificial viscosity");
    }
}
