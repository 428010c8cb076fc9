//! End of a step: the new state from its parts, with the inlet's temperature reset.
//!
//! The reset cuts the gradient, which is right: what the fluid carried before the inlet does not matter behind it.

use crate::numerics::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use crate::sph::laws::conduction;
use crate::sph::model::Model;
use crate::sph::step::{input, output, read, tensor, Chain, Step};
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]`, rates `[A, N]` -> state `[F, N]`.
pub struct Advance<R: Real>(pub Arc<Chain<R>>);

struct Forward<'a, R> {
    model: &'a Model<R>,
    moved: &'a [R],
    rates: &'a [R],
    state: Shared<'a, R>,
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
    }
}

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], rates: &[R], state: &mut [R]) {
    let model = &*step.model;
    run_rows(&Forward { model, moved, rates, state: Shared::new(state) }, model.particles());
}

struct Backward<'a, R> {
    model: &'a Model<R>,
    moved: &'a [R],
    state_bar: &'a [R],
    moved_bar: Shared<'a, R>,
    rates_bar: Shared<'a, R>,
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

/// The adjoint, on plain numbers; `moved_bar` must be zero.
pub fn backward<R: Real>(step: &Step<R>, moved: &[R], state_bar: &[R], moved_bar: &mut [R], rates_bar: &mut [R]) {
    let (model, moved_bar, rates_bar) = (&*step.model, Shared::new(moved_bar), Shared::new(rates_bar));
    run_rows(&Backward { model, moved, state_bar, moved_bar, rates_bar }, model.particles());
}

impl<R: Real> CustomOp2 for Advance<R> {
    fn name(&self) -> &'static str {
        "advance"
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        let step = &self.0.step;
        let (rows, n) = (step.model.layout.state_rows(), step.model.particles());
        let mut state = vec![R::default(); rows * n];
        R::advance(step, input(s1, l1)?, input(s2, l2)?, &mut state);
        Ok(output(state, (rows, n)))
    }
    fn bwd(
        &self,
        moved: &Tensor,
        _: &Tensor,
        _: &Tensor,
        state_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let step = &self.0.step;
        let (l, n) = (step.model.layout, step.model.particles());
        let mut moved_bar = self.0.moved_bar();
        let mut rates_bar = vec![R::default(); l.rate_rows() * n];
        read(moved, |m| {
            read(&state_bar.contiguous()?, |bar| {
                R::advance_bar(step, m, bar, &mut moved_bar, &mut rates_bar);
                Ok(())
            })
        })?;
        Ok((self.0.pass_on(moved_bar)?, Some(tensor(rates_bar, l.rate_rows(), n)?)))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, moved: &Tensor, rates: &Tensor) -> Result<Tensor> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let mut rows = vec![moved.narrow(0, 0, 2 * l.dimension)?, rates.narrow(0, 0, l.rate_temperature())?];
    if l.heat {
        let kept: Vec<R> = read(&moved.narrow(0, 0, 1)?.contiguous()?, |x: &[R]| {
            Ok((0..n).map(|i| R::of(!(model.is_fluid(i) && conduction::is_inlet(model, x[i])) as u8 as f64)).collect())
        })?;
        let kept = Tensor::from_vec(kept, (1, n), moved.device())?;
        rows.push(moved.narrow(0, l.moved_temperature(), 1)?.mul(&kept)?);
        rows.push(rates.narrow(0, l.rate_temperature(), 1)?);
    }
    if l.mass {
        rows.push(moved.narrow(0, l.moved_mass(), 1)?);
    }
    Tensor::cat(&rows, 0)
}
