//! End of a step: the new state from its parts, with the inlet's temperature reset.
//!
//! The reset cuts the gradient, which is right: what the fluid carried before the inlet does not matter behind it.

use super::chain::Step;
use super::model::Standard;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed::fluid_mask;
use crate::sph::laws::conduction;
use crate::sph::masks::below;
use crate::sph::own::Own;
use candle_core::{Result, Tensor};
use std::ops::Range;

struct Forward<'a, R> {
    model: &'a Standard<R>,
    moved: &'a [R],
    primitives: &'a [R],
    rates: &'a [R],
    state: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Forward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, n, l) = (self.model, self.model.particles(), self.model.layout);
        let moved = |k: usize| &self.moved[k * n + rows.start..k * n + rows.end];
        let rates = |k: usize| &self.rates[k * n + rows.start..k * n + rows.end];
        // SAFETY (all): each range of rows writes its own particles, and each field is borrowed once at a time.
        let to = |k: usize| unsafe { self.state.slice(k * n + rows.start..k * n + rows.end) };
        for k in 0..2 * l.dimension {
            to(k).copy_from_slice(moved(k));
        }
        for k in 0..l.rate_temperature() {
            to(l.acceleration() + k).copy_from_slice(rates(k));
        }
        if l.heat {
            let (x, after, t) = (moved(0), moved(l.moved_temperature()), to(l.temperature()));
            for (at, i) in rows.clone().enumerate() {
                let reset = conduction::is_inlet(model, x[at]) && model.is_fluid(i);
                t[at] = if reset { R::default() } else { after[at] };
            }
            to(l.temperature_rate()).copy_from_slice(rates(l.rate_temperature()));
        }
        if l.mass {
            to(l.state_mass()).copy_from_slice(moved(l.moved_mass()));
        }
        if l.density {
            to(l.state_density()).copy_from_slice(&self.primitives[rows]);
        }
    }
}

/// The forward pass, on plain numbers; `primitives` are read where the density evolves.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], rates: &[R], state: &mut [R]) {
    let model = &*step.model;
    run_rows(&Forward { model, moved, primitives, rates, state: Own::new(state) }, model.particles());
}

struct Backward<'a, R> {
    model: &'a Standard<R>,
    moved: &'a [R],
    state_bar: &'a [R],
    moved_bar: Own<'a, R>,
    rates_bar: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Backward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, n, l) = (self.model, self.model.particles(), self.model.layout);
        let from = |k: usize| &self.state_bar[k * n + rows.start..k * n + rows.end];
        // SAFETY (all): as in the forward pass.
        let moved_bar = |k: usize| unsafe { self.moved_bar.slice(k * n + rows.start..k * n + rows.end) };
        let rates_bar = |k: usize| unsafe { self.rates_bar.slice(k * n + rows.start..k * n + rows.end) };
        for k in 0..2 * l.dimension {
            moved_bar(k).copy_from_slice(from(k));
        }
        for k in 2 * l.dimension..l.moved_rows() {
            moved_bar(k).fill(R::default());
        }
        for k in 0..l.rate_temperature() {
            rates_bar(k).copy_from_slice(from(l.acceleration() + k));
        }
        if l.heat {
            let (x, bar) = (&self.moved[rows.clone()], from(l.temperature()));
            let t = moved_bar(l.moved_temperature());
            for (at, i) in rows.clone().enumerate() {
                let reset = conduction::is_inlet(model, x[at]) && model.is_fluid(i);
                t[at] = if reset { R::default() } else { bar[at] };
            }
            rates_bar(l.rate_temperature()).copy_from_slice(from(l.temperature_rate()));
        }
        if l.mass {
            moved_bar(l.moved_mass()).copy_from_slice(from(l.state_mass()));
        }
    }
}

/// The adjoint, on plain numbers.
pub fn backward<R: Real>(step: &Step<R>, moved: &[R], state_bar: &[R], moved_bar: &mut [R], rates_bar: &mut [R]) {
    let (model, moved_bar, rates_bar) = (&*step.model, Own::new(moved_bar), Own::new(rates_bar));
    run_rows(&Backward { model, moved, state_bar, moved_bar, rates_bar }, model.particles());
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, moved: &Tensor, primitives: &Tensor, rates: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    let mut rows = vec![moved.narrow(0, 0, 2 * l.dimension)?, rates.narrow(0, 0, l.rate_temperature())?];
    if let Some(heat) = &model.heat {
        let fluid = fluid_mask(model, moved)?;
        let inlet = below(&moved.narrow(0, 0, 1)?, heat.inlet_below)?;
        let kept = fluid.mul(&inlet)?.affine(-1.0, 1.0)?;
        rows.push(moved.narrow(0, l.moved_temperature(), 1)?.mul(&kept)?);
        rows.push(rates.narrow(0, l.rate_temperature(), 1)?);
    }
    if l.mass {
        rows.push(moved.narrow(0, l.moved_mass(), 1)?);
    }
    if l.density {
        rows.push(primitives.narrow(0, 0, 1)?);
    }
    Tensor::cat(&rows, 0)
}
