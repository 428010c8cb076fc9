//! First half of a step: kick with the old rates, drift with the transport velocity.
//!
//! Semi-implicit Euler (as JAX-SPH): u' = u + dt a, w = f dt/2 b, r' = (r + dt (u' + w)) mod box,
//! T' = T + dt dT/dt, where b is the transport acceleration and f its strength (Adami, Hu and Adams 2013,
//! eq. 15, with their p_b = -p(0)).

use super::model::Standard;
use super::sweeps::Sweeps;
use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::particles::domain::wrapped;
use crate::sph::composed::fluid_mask;
use crate::sph::own::Own;
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// state `[F, N]` -> moved `[M, N]`.
pub struct Drift<R>(pub Arc<Standard<R>>, pub f64);

struct Forward<'a, R> {
    model: &'a Standard<R>,
    dt: f64,
    state: &'a [R],
    moved: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Forward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, step) = (self.model, R::of(self.dt));
        let (n, l, count) = (model.particles(), model.layout, rows.len());
        let shift = R::of(model.laws.transport * 0.5 * model.dt);
        let from = |k: usize| &self.state[k * n + rows.start..k * n + rows.end];
        // SAFETY (all): each range of rows writes its own particles, and each field is borrowed once at a time.
        let to = |k: usize| unsafe { self.moved.slice(k * n + rows.start..k * n + rows.end) };
        for d in 0..l.dimension {
            let (r, u, a) = (from(d), from(l.velocity() + d), from(l.acceleration() + d));
            let (position, velocity) = (to(d), to(l.dimension + d));
            for i in 0..count {
                velocity[i] = u[i] + step * a[i];
            }
            if l.transport {
                let (b, w) = (from(l.transport_acceleration() + d), to(l.moved_shift() + d));
                for i in 0..count {
                    w[i] = shift * b[i];
                    position[i] = r[i] + step * (velocity[i] + w[i]);
                }
            } else {
                for i in 0..count {
                    position[i] = r[i] + step * velocity[i];
                }
            }
            for i in stays(model, rows.clone()) {
                position[i] = r[i];
            }
            if model.domain.periodic[d] {
                for x in position.iter_mut() {
                    *x = wrapped(&model.domain, d, *x);
                }
            }
        }
        if l.heat {
            let (t, rate) = (from(l.temperature()), from(l.temperature_rate()));
            to(l.moved_old_temperature()).copy_from_slice(t);
            let after = to(l.moved_temperature());
            for i in 0..count {
                after[i] = t[i] + step * rate[i];
            }
        }
        if l.mass {
            to(l.moved_mass()).copy_from_slice(from(l.state_mass()));
        }
        if l.density {
            to(l.moved_density()).copy_from_slice(from(l.state_density()));
        }
    }
}

/// Those of some particles that do not move with their velocity, counted from the first of them.
fn stays<R: Real>(model: &Standard<R>, rows: Range<usize>) -> impl Iterator<Item = usize> + use<'_, R> {
    let first = rows.start;
    let rows = if model.walls_slide { rows } else { 0..0 };
    rows.filter(|&i| !model.is_fluid(i)).map(move |i| i - first)
}

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(model: &Standard<R>, dt: f64, state: &[R], moved: &mut [R]) {
    run_rows(&Forward { model, dt, state, moved: Own::new(moved) }, model.particles());
}

struct Backward<'a, R> {
    model: &'a Standard<R>,
    dt: f64,
    moved_bar: &'a [R],
    state_bar: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Backward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, step) = (self.model, R::of(self.dt));
        let (n, l, count) = (model.particles(), model.layout, rows.len());
        let shift = R::of(model.laws.transport * 0.5 * model.dt);
        let from = |k: usize| &self.moved_bar[k * n + rows.start..k * n + rows.end];
        // SAFETY (all): as in the forward pass.
        let to = |k: usize| unsafe { self.state_bar.slice(k * n + rows.start..k * n + rows.end) };
        for d in 0..l.dimension {
            let (r, u) = (from(d), from(l.dimension + d));
            let (position, velocity, acceleration) = (to(d), to(l.velocity() + d), to(l.acceleration() + d));
            for i in 0..count {
                let u = u[i] + step * r[i];
                position[i] = r[i];
                velocity[i] = u;
                acceleration[i] = step * u;
            }
            if l.transport {
                let (w, b) = (from(l.moved_shift() + d), to(l.transport_acceleration() + d));
                for i in 0..count {
                    b[i] = shift * (w[i] + step * r[i]);
                }
                for i in stays(model, rows.clone()) {
                    b[i] = shift * w[i];
                }
            }
            for i in stays(model, rows.clone()) {
                velocity[i] = u[i];
                acceleration[i] = step * u[i];
            }
        }
        if l.heat {
            let (before, after) = (from(l.moved_old_temperature()), from(l.moved_temperature()));
            let (t, rate) = (to(l.temperature()), to(l.temperature_rate()));
            for i in 0..count {
                t[i] = after[i] + before[i];
                rate[i] = step * after[i];
            }
        }
        if l.mass {
            to(l.state_mass()).copy_from_slice(from(l.moved_mass()));
        }
        if l.density {
            to(l.state_density()).copy_from_slice(from(l.moved_density()));
        }
    }
}

/// The adjoint: cotangent of `moved` -> cotangent of `state`.
pub fn backward<R: Real>(model: &Standard<R>, dt: f64, moved_bar: &[R], state_bar: &mut [R]) {
    run_rows(&Backward { model, dt, moved_bar, state_bar: Own::new(state_bar) }, model.particles());
}

impl<R: Sweeps> Operator<1> for Drift<R> {
    type Real = R;
    const NAME: &'static str = "drift";

    fn forward(&self, [state]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let (rows, n) = (self.0.layout.moved_rows(), self.0.particles());
        let mut moved = vec![R::default(); rows * n];
        R::drift(&self.0, self.1, state, &mut moved);
        Ok((moved, (rows, n).into()))
    }

    fn adjoint(&self, _: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let mut state_bar = vec![R::default(); self.0.layout.state_rows() * self.0.particles()];
        R::drift_bar(&self.0, self.1, bar, &mut state_bar);
        Ok([Some(state_bar)])
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(model: &Standard<R>, dt: f64, state: &Tensor) -> Result<Tensor> {
    let l = model.layout;
    let d = l.dimension;
    let velocity = (state.narrow(0, l.velocity(), d)? + state.narrow(0, l.acceleration(), d)?.affine(dt, 0.0)?)?;
    let mut drift = velocity.clone();
    let mut rows = vec![velocity];
    if l.transport {
        let shift =
            state.narrow(0, l.transport_acceleration(), d)?.affine(model.laws.transport * 0.5 * model.dt, 0.0)?;
        drift = (drift + &shift)?;
        rows.push(shift);
    }
    if model.walls_slide {
        drift = drift.broadcast_mul(&fluid_mask(model, state)?)?;
    }
    let position = (state.narrow(0, 0, d)? + drift.affine(dt, 0.0)?)?;
    let wrapped = (0..d).map(|k| model.domain.wrapped_of(k, &position.narrow(0, k, 1)?)).collect::<Result<Vec<_>>>()?;
    rows.insert(0, Tensor::cat(&wrapped, 0)?);
    if l.heat {
        let t = state.narrow(0, l.temperature(), 1)?;
        rows.push(t.clone());
        rows.push((t + state.narrow(0, l.temperature_rate(), 1)?.affine(dt, 0.0)?)?);
    }
    if l.mass {
        rows.push(state.narrow(0, l.state_mass(), 1)?);
    }
    if l.density {
        rows.push(state.narrow(0, l.state_density(), 1)?);
    }
    Tensor::cat(&rows, 0)
}
