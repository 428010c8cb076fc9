//! End of a step: the new state from its parts, with the inlet's temperature reset.
//!
//! The reset cuts the gradient, which is right: what the fluid carried before the inlet does not matter behind it.

use super::heat;
use super::step::{input, output, read, tensor, Step};
use crate::lanes::Real;
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use std::sync::Arc;

/// moved `[M, N]`, rates `[A, N]` -> state `[F, N]`.
pub struct Advance<R>(pub Arc<Step<R>>);

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], rates: &[R], state: &mut [R]) {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let d = l.dimension;
    state[..2 * d * n].copy_from_slice(&moved[..2 * d * n]);
    let accelerations = l.rate_temperature() * n;
    let from = l.acceleration() * n;
    state[from..from + accelerations].copy_from_slice(&rates[..accelerations]);
    if l.heat {
        for i in 0..n {
            let reset = model.is_fluid(i) && heat::is_inlet(model, moved[i]);
            let t = moved[l.moved_temperature() * n + i];
            state[l.temperature() * n + i] = if reset { R::default() } else { t };
            state[l.temperature_rate() * n + i] = rates[l.rate_temperature() * n + i];
        }
    }
    if l.mass {
        state[l.state_mass() * n..].copy_from_slice(&moved[l.moved_mass() * n..]);
    }
}

/// The adjoint, on plain numbers; the outputs must be zero.
pub fn backward<R: Real>(step: &Step<R>, moved: &[R], state_bar: &[R], moved_bar: &mut [R], rates_bar: &mut [R]) {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let d = l.dimension;
    moved_bar[..2 * d * n].copy_from_slice(&state_bar[..2 * d * n]);
    let accelerations = l.rate_temperature() * n;
    let from = l.acceleration() * n;
    rates_bar[..accelerations].copy_from_slice(&state_bar[from..from + accelerations]);
    if l.heat {
        for i in 0..n {
            let reset = model.is_fluid(i) && heat::is_inlet(model, moved[i]);
            let bar = if reset { R::default() } else { state_bar[l.temperature() * n + i] };
            moved_bar[l.moved_temperature() * n + i] = bar;
            rates_bar[l.rate_temperature() * n + i] = state_bar[l.temperature_rate() * n + i];
        }
    }
    if l.mass {
        moved_bar[l.moved_mass() * n..].copy_from_slice(&state_bar[l.state_mass() * n..]);
    }
}

impl<R: Real> CustomOp2 for Advance<R> {
    fn name(&self) -> &'static str {
        "advance"
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, n) = (self.0.model.layout.state_rows(), self.0.model.particles());
        let mut state = vec![R::default(); rows * n];
        forward(&self.0, input(s1, l1)?, input(s2, l2)?, &mut state);
        Ok(output(state, (rows, n)))
    }
    fn bwd(
        &self,
        moved: &Tensor,
        _: &Tensor,
        _: &Tensor,
        state_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (l, n) = (self.0.model.layout, self.0.model.particles());
        let mut moved_bar = vec![R::default(); l.moved_rows() * n];
        let mut rates_bar = vec![R::default(); l.rate_rows() * n];
        read(moved, |m| {
            read(&state_bar.contiguous()?, |bar| {
                backward(&self.0, m, bar, &mut moved_bar, &mut rates_bar);
                Ok(())
            })
        })?;
        Ok((Some(tensor(moved_bar, l.moved_rows(), n)?), Some(tensor(rates_bar, l.rate_rows(), n)?)))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, moved: &Tensor, rates: &Tensor) -> Result<Tensor> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let mut rows = vec![moved.narrow(0, 0, 2 * l.dimension)?, rates.narrow(0, 0, l.rate_temperature())?];
    if l.heat {
        let kept: Vec<R> = read(&moved.narrow(0, 0, 1)?.contiguous()?, |x: &[R]| {
            Ok((0..n).map(|i| R::of(!(model.is_fluid(i) && heat::is_inlet(model, x[i])) as u8 as f64)).collect())
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
