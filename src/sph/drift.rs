//! First half of a step: kick with the old rates, drift with the transport velocity.
//!
//! Semi-implicit Euler (as JAX-SPH): u' = u + dt a, w = f dt/2 b, r' = (r + dt (u' + w)) mod box,
//! T' = T + dt dT/dt, where b is the transport acceleration and f its strength (Adami, Hu and Adams 2013,
//! eq. 15, with their p_b = -p(0)).

use super::model::Model;
use super::step::{self, output};
use crate::lanes::Real;
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use std::sync::Arc;

/// state `[F, N]` -> moved `[M, N]`.
pub struct Drift<R>(pub Arc<Model<R>>, pub f64);

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(model: &Model<R>, dt: f64, state: &[R], moved: &mut [R]) {
    let (n, l) = (model.particles(), model.layout);
    let (dimension, step) = (l.dimension, R::of(dt));
    let shift = R::of(model.transport * 0.5 * model.dt);
    let row = |k: usize| &state[k * n..(k + 1) * n];
    for d in 0..dimension {
        let (r, u, a) = (row(d), row(l.velocity() + d), row(l.acceleration() + d));
        let size = R::of(model.domain.size[d]);
        let periodic = model.domain.periodic[d];
        for i in 0..n {
            let velocity = u[i] + step * a[i];
            let mut drift = velocity;
            if l.transport {
                let w = shift * row(l.transport_acceleration() + d)[i];
                moved[(l.moved_shift() + d) * n + i] = w;
                drift += w;
            }
            let mut x = r[i] + step * drift;
            if periodic {
                if x < R::default() {
                    x += size;
                }
                // Not `else`: a tiny negative x plus the size rounds to the size itself.
                if x >= size {
                    x -= size;
                }
            }
            moved[d * n + i] = x;
            moved[(dimension + d) * n + i] = velocity;
        }
    }
    if l.heat {
        let (t, rate) = (row(l.temperature()), row(l.temperature_rate()));
        for i in 0..n {
            moved[l.moved_old_temperature() * n + i] = t[i];
            moved[l.moved_temperature() * n + i] = t[i] + step * rate[i];
        }
    }
    if l.mass {
        moved[l.moved_mass() * n..].copy_from_slice(row(l.state_mass()));
    }
}

/// The adjoint: cotangent of `moved` -> cotangent of `state`.
pub fn backward<R: Real>(model: &Model<R>, dt: f64, moved_bar: &[R], state_bar: &mut [R]) {
    let (n, l) = (model.particles(), model.layout);
    let (dimension, step) = (l.dimension, R::of(dt));
    let shift = R::of(model.transport * 0.5 * model.dt);
    for d in 0..dimension {
        for i in 0..n {
            let r = moved_bar[d * n + i];
            let u = moved_bar[(dimension + d) * n + i] + step * r;
            state_bar[d * n + i] = r;
            state_bar[(l.velocity() + d) * n + i] = u;
            state_bar[(l.acceleration() + d) * n + i] = step * u;
            if l.transport {
                state_bar[(l.transport_acceleration() + d) * n + i] =
                    shift * (moved_bar[(l.moved_shift() + d) * n + i] + step * r);
            }
        }
    }
    if l.heat {
        for i in 0..n {
            let t = moved_bar[l.moved_temperature() * n + i];
            state_bar[l.temperature() * n + i] = t + moved_bar[l.moved_old_temperature() * n + i];
            state_bar[l.temperature_rate() * n + i] = step * t;
        }
    }
    if l.mass {
        state_bar[l.state_mass() * n..].copy_from_slice(&moved_bar[l.moved_mass() * n..]);
    }
}

impl<R: Real> CustomOp1 for Drift<R> {
    fn name(&self) -> &'static str {
        "drift"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, n) = (self.0.layout.moved_rows(), self.0.particles());
        let mut moved = vec![R::default(); rows * n];
        forward(&self.0, self.1, step::input(s, l)?, &mut moved);
        Ok(output(moved, (rows, n)))
    }
    fn bwd(&self, _: &Tensor, _: &Tensor, moved_bar: &Tensor) -> Result<Option<Tensor>> {
        let (rows, n) = (self.0.layout.state_rows(), self.0.particles());
        let mut state_bar = vec![R::default(); rows * n];
        step::read(&moved_bar.contiguous()?, |bar| {
            backward(&self.0, self.1, bar, &mut state_bar);
            Ok(())
        })?;
        Ok(Some(step::tensor(state_bar, rows, n)?))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(model: &Model<R>, dt: f64, state: &Tensor) -> Result<Tensor> {
    let l = model.layout;
    let d = l.dimension;
    let velocity = (state.narrow(0, l.velocity(), d)? + state.narrow(0, l.acceleration(), d)?.affine(dt, 0.0)?)?;
    let mut drift = velocity.clone();
    let mut rows = vec![velocity];
    if l.transport {
        let shift = state.narrow(0, l.transport_acceleration(), d)?.affine(model.transport * 0.5 * model.dt, 0.0)?;
        drift = (drift + &shift)?;
        rows.push(shift);
    }
    let position = (state.narrow(0, 0, d)? + drift.affine(dt, 0.0)?)?;
    // The wrap is a constant as far as derivatives go.
    let mut wrapped = Vec::new();
    for k in 0..d {
        let x = position.narrow(0, k, 1)?;
        wrapped.push(if model.domain.periodic[k] {
            let size = model.domain.size[k];
            let turns = x.detach().affine(1.0 / size, 0.0)?.floor()?;
            (x - turns.affine(size, 0.0)?)?
        } else {
            x
        });
    }
    rows.insert(0, Tensor::cat(&wrapped, 0)?);
    if l.heat {
        let t = state.narrow(0, l.temperature(), 1)?;
        rows.push(t.clone());
        rows.push((t + state.narrow(0, l.temperature_rate(), 1)?.affine(dt, 0.0)?)?);
    }
    if l.mass {
        rows.push(state.narrow(0, l.state_mass(), 1)?);
    }
    Tensor::cat(&rows, 0)
}
