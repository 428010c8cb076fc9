//! Heat conduction.
//!
//! dT_i/dt = (1/m_i) (2 k/c_p) sum_j V_i V_j F_ij (T_i - T_j), V = m/rho, F = W'(d)/d < 0 (Cleary 1998; the
//! harmonic mean of equal conductivities is the conductivity). Where particles are of different materials, k is the harmonic
//! mean 2 k_i k_j/(k_i + k_j) of the pair, which keeps the flux continuous across a jump, and c_p that of i (Cleary and
//! Monaghan 1999, eq. 28). Fluid in the inlet strip (temperature reset) and in
//! the outlet strip has rate 0.

use super::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, SideBar, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::chain::Step;
use crate::sph::model::{Heat, Model};
use crate::sph::operators::composed::{self, Pairs};
use crate::sph::operators::pairs::Masses;
use candle_core::{Result, Tensor};

/// 2 k/c_p.
pub fn factor<R>(model: &Model<R>) -> f64 {
    model.heat.as_ref().map_or(0.0, |h| 2.0 * h.conductivity / h.capacity)
}

/// Heat capacity of a particle, over that of the scene.
#[inline(always)]
pub fn capacity<R: Real>(model: &Model<R>, i: usize) -> R {
    model.heat.as_ref().and_then(|heat| heat.materials.as_ref()).map_or(R::of(1.0), |of| of.capacity[i])
}

/// Whether fluid at this x conducts.
#[inline(always)]
pub fn conducts<R: Real>(model: &Model<R>, x: R) -> bool {
    model.heat.as_ref().is_some_and(|h| !(x < R::of(h.inlet_below) || x > R::of(h.outlet_above)))
}

/// 1 where fluid at x `[1, N]` conducts, else 0.
pub fn conducts_composed<R: Real>(model: &Model<R>, x: &Tensor) -> Result<Tensor> {
    match &model.heat {
        Some(heat) => {
            (composed::below(x, heat.inlet_below)? + composed::above(x, heat.outlet_above)?)?.affine(-1.0, 1.0)
        }
        None => x.zeros_like(),
    }
}

/// Whether fluid at this x is reset to the inlet temperature.
#[inline(always)]
pub fn is_inlet<R: Real>(model: &Model<R>, x: R) -> bool {
    model.heat.as_ref().is_some_and(|h| x < R::of(h.inlet_below))
}

/// 2 k_i k_j/(k_i + k_j).
#[inline(always)]
fn harmonic<L: Lanes>(a: L, b: L) -> L {
    let both = a * b;
    (both + both) / (a + b)
}

/// What the second of two particles gives to the first: V_i V_j F_ij (T_i - T_j), to be multiplied with 2 k/c_p.
#[inline(always)]
pub fn flow(volume: [f64; 2], slope: f64, temperature: [f64; 2]) -> f64 {
    volume[0] * volume[1] * slope * (temperature[0] - temperature[1])
}

/// Heat that walls give to conducting fluid with x < `until`, in units of density * temperature * volume per time (times
/// the heat capacity: power): sum over fluid i and walls j of the pair flow (2 k/c_p) V_i V_j F_ij (T_i - T_j).
pub fn wall_flux<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], until: f64) -> f64 {
    let (model, list) = (&*step.model, &*step.list);
    let (n, l) = (model.particles(), model.layout);
    let mass = Masses::new(model, moved);
    let volume = |i: usize| (mass.of(i) / primitives[i]).f64();
    let conductivities = model.heat.as_ref().and_then(Heat::conductivities);
    let conductivity = |i: usize, j: usize| match conductivities {
        Some(all) => 2.0 * all[i].f64() * all[j].f64() / (all[i].f64() + all[j].f64()),
        None => 1.0,
    };
    let temperature = |i: usize| primitives[l.primitive_temperature() * n + i].f64();
    let mut sum = 0.0;
    for &i in &list.fluid_rows {
        let i = i as usize;
        if !conducts(model, moved[i]) || moved[i].f64() >= until {
            continue;
        }
        for &j in &list.row(i)[list.fluid_count[i] as usize..list.count[i] as usize] {
            let j = j as usize;
            let mut r2 = 0.0;
            for d in 0..l.dimension {
                let dr = model.domain.nearest(d, moved[d * n + i].f64() - moved[d * n + j].f64());
                r2 += dr * dr;
            }
            let (_, slope) = model.kernel.pair(r2);
            sum += conductivity(i, j) * flow([volume(i), volume(j)], slope, [temperature(i), temperature(j)]);
        }
    }
    factor(model) * sum
}

/// With or without materials.
#[derive(Debug, Clone, Copy)]
pub struct Conduction<const MATERIALS: bool>;

impl<const MATERIALS: bool> Conduction<MATERIALS> {
    /// F, times the pair's conductivity over that of the scene.
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
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        _: &(),
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        pair_bar: &mut PairBar<L, D>,
        bar: &mut SideBar<L, D>,
    ) {
        let (a, b) = (pair.own, pair.other);
        let weighted = bars.temperature * b.volume;
        let difference = a.temperature - b.temperature;
        let per_volume = weighted * Self::conductance(pair);
        bar.temperature = per_volume.mul_add(a.volume, bar.temperature);
        bar.volume = per_volume.mul_add(difference, bar.volume);
        let by_slope = match MATERIALS {
            true => weighted * harmonic(a.conductivity, b.conductivity),
            false => weighted,
        };
        pair_bar.by_slope = (by_slope * a.volume).mul_add(difference, pair_bar.by_slope);
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
