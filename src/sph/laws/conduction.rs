//! Heat conduction.
//!
//! dT_i/dt = (1/m_i) (2 k/c_p) sum_j V_i V_j F_ij (T_i - T_j), V = m/rho, F = W'(d)/d < 0 (Cleary 1998; the
//! harmonic mean of equal conductivities is the conductivity). Fluid in the inlet strip (temperature reset) and in
//! the outlet strip has rate 0.

use super::{Bars, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, SideBar, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::chain::Step;
use crate::sph::model::Model;
use crate::sph::operators::composed::{self, Pairs};
use crate::sph::operators::pairs::Masses;
use candle_core::{Result, Tensor};

/// 2 k/c_p.
pub fn factor<R>(model: &Model<R>) -> f64 {
    model.heat.as_ref().map_or(0.0, |h| 2.0 * h.conductivity / h.capacity)
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
            sum += flow([volume(i), volume(j)], slope, [temperature(i), temperature(j)]);
        }
    }
    factor(model) * sum
}

#[derive(Debug, Clone, Copy)]
pub struct Conduction;

impl PairLaw for Conduction {
    const HEAT: bool = true;
    type Own<L: Lanes, const D: usize> = ();

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) {}

    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (a, b) = (pair.own, pair.other);
        sums.warmth = (a.volume * b.volume * pair.slope).mul_add(a.temperature - b.temperature, sums.warmth);
    }

    /// l gains gamma V_i V_j F (T_i - T_j).
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
        let per_volume = weighted * pair.slope;
        bar.temperature = per_volume.mul_add(a.volume, bar.temperature);
        bar.volume = per_volume.mul_add(difference, bar.volume);
        pair_bar.by_slope = (weighted * a.volume).mul_add(difference, pair_bar.by_slope);
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let Some(temperature) = &fields.temperature else { candle_core::bail!("conduction without temperature") };
        let difference = (pairs.own(temperature)? - pairs.other(temperature)?)?;
        let volumes = pairs.own(&fields.volume)?.mul(&pairs.other(&fields.volume)?)?;
        PairTensors::add(&mut sums.warmth, volumes.mul(&fields.slope)?.mul(&difference)?.sum(2)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("conduction");
    }
}
