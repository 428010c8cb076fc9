//! Heat conduction.
//!
//! dT_i/dt = (1/m_i) (2 k/c_p) sum_j V_i V_j F_ij (T_i - T_j), V = m/rho, F = W'(d)/d < 0 (Cleary 1998; the harmonic
//! mean of equal conductivities is the conductivity). Where particles are of different materials, k is the harmonic
//! mean 2 k_i k_j/(k_i + k_j) of the pair, which keeps the flux continuous across a jump, and c_p that of i (Cleary and
//! Monaghan 1999, eq. 28). The rate is 0 in the inlet strip, where the temperature is reset, and in the outlet strip.

use super::pair_law::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use crate::sph::flow::Flow;
use crate::sph::masks;
use candle_core::{Result, Tensor};

/// 2 k/c_p.
pub fn factor<R>(flow: &Flow<R>) -> f64 {
    flow.heat.as_ref().map_or(0.0, |h| 2.0 * h.conductivity / h.capacity)
}

/// Heat capacity of a particle relative to [`Heat::capacity`](crate::sph::flow::Heat::capacity).
#[inline(always)]
pub fn capacity<R: Real>(flow: &Flow<R>, i: usize) -> R {
    flow.heat.as_ref().and_then(|heat| heat.materials.as_ref()).map_or(R::of(1.0), |of| of.capacity[i])
}

/// Whether fluid at this x conducts heat.
#[inline(always)]
pub fn conducts<R: Real>(flow: &Flow<R>, x: R) -> bool {
    flow.heat.as_ref().is_some_and(|h| !(x < R::of(h.inlet_below) || x > R::of(h.outlet_above)))
}

/// 1 where fluid at x `[1, N]` conducts heat, else 0.
pub fn conducts_composed<R: Real>(flow: &Flow<R>, x: &Tensor) -> Result<Tensor> {
    match &flow.heat {
        Some(heat) => (masks::below(x, heat.inlet_below)? + masks::above(x, heat.outlet_above)?)?.affine(-1.0, 1.0),
        None => x.zeros_like(),
    }
}

/// Whether fluid at this x is reset to the inlet temperature.
#[inline(always)]
pub fn is_inlet<R: Real>(flow: &Flow<R>, x: R) -> bool {
    flow.heat.as_ref().is_some_and(|h| x < R::of(h.inlet_below))
}

/// The harmonic mean 2 k_i k_j/(k_i + k_j).
#[inline(always)]
fn harmonic<L: Lanes>(a: L, b: L) -> L {
    let both = a * b;
    (both + both) / (a + b)
}

/// The pair flow V_i V_j F_ij (T_i - T_j) from the second particle to the first, to be multiplied with 2 k/c_p.
#[inline(always)]
pub fn flow(volume: [f64; 2], slope: f64, temperature: [f64; 2]) -> f64 {
    volume[0] * volume[1] * slope * (temperature[0] - temperature[1])
}

/// Heat conduction, with or without several materials.
#[derive(Debug, Clone, Copy)]
pub struct Conduction<const MATERIALS: bool>;

impl<const MATERIALS: bool> Conduction<MATERIALS> {
    /// F times the conductivity of the pair relative to that of the scene.
    #[inline(always)]
    fn conductance<L: Lanes, const D: usize>(pair: &Pair<L, D>) -> L {
        match MATERIALS {
            true => pair.slope * harmonic(pair.own.conductivity, pair.other.conductivity),
            false => pair.slope,
        }
    }
}

impl<const MATERIALS: bool> PairLaw for Conduction<MATERIALS> {
    const HEAT: bool = true;
    const MATERIALS: bool = MATERIALS;
    type Own<L: Lanes, const D: usize> = ();

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) {}

    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (a, b) = (pair.own, pair.other);
        let weight = a.volume * b.volume * Self::conductance(pair);
        sums.warmth = weight.mul_add(a.temperature - b.temperature, sums.warmth);
    }

    /// l gains gamma V_i V_j F k (T_i - T_j), k = 1 without materials.
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, bars: &Bars<L, D>, to: &mut PairBar<L, D>) {
        let (a, b) = (pair.own, pair.other);
        let weighted = bars.temperature * b.volume;
        let difference = a.temperature - b.temperature;
        let per_volume = weighted * Self::conductance(pair);
        to.own.temperature = per_volume.mul_add(a.volume, to.own.temperature);
        to.own.volume = per_volume.mul_add(difference, to.own.volume);
        let by_slope = match MATERIALS {
            true => weighted * harmonic(a.conductivity, b.conductivity),
            false => weighted,
        };
        to.by_slope = (by_slope * a.volume).mul_add(difference, to.by_slope);
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let Some(temperature) = &fields.temperature else { candle_core::bail!("conduction without temperature") };
        let difference = (pairs.own(temperature)? - pairs.other(temperature)?)?;
        let volumes = pairs.own(&fields.volume)?.mul(&pairs.other(&fields.volume)?)?;
        let mut flow = volumes.mul(&fields.slope)?.mul(&difference)?;
        if let Some(conductivity) = &fields.conductivity {
            let (a, b) = (pairs.own(conductivity)?, pairs.other(conductivity)?);
            flow = flow.mul(&a.mul(&b)?.affine(2.0, 0.0)?.div(&(a + b)?)?)?;
        }
        PairTensors::add(&mut sums.warmth, flow.sum(2)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push(if MATERIALS { "conduction in materials" } else { "conduction" });
    }
}
