//! The kick of a [`crate::sph::laws::drive`] at the end of a step: u += kick, x += dt kick.

use super::geometry::Geometry;
use super::model::Consistent;
use crate::numerics::lanes::Real;
use crate::numerics::total::Total;
use crate::particles::domain::wrapped;
use crate::sph::laws::conduction;
use crate::sph::laws::drive::Kick;
use crate::sph::masks::below;
use candle_core::{Result, Tensor};

/// Fluid particles in index order, so that sums do not depend on the number of threads.
fn fluid<R: Real>(model: &Consistent<R>) -> impl Iterator<Item = usize> + '_ {
    (0..model.particles()).filter(|&i| model.is_fluid(i))
}

/// The kick for velocities `u` before it.
fn found<R: Real>(geometry: &Geometry<'_, R>, masses: &[R], u: &[R]) -> Kick {
    let model = geometry.model;
    let Some(drive) = model.drive else { return Kick::default() };
    let (mut momentum, mut mass) = (Total::default(), Total::default());
    for i in fluid(model).filter(|&i| model.is_own(i)) {
        let m = masses[i].f64();
        mass.add(m);
        momentum.add(m * u[i].f64());
    }
    let [momentum, mass] = model.over_ranks([momentum, mass]);
    drive.kick(geometry.times.now, momentum, mass)
}

/// Kicks a state `[F, N]` in place and returns the acceleration. `masses` `[N]` are those of
/// [`super::operators::masses`].
pub fn forward<R: Real>(geometry: &Geometry<'_, R>, masses: &[R], state: &mut [R]) -> f64 {
    let (model, n, l) = (geometry.model, geometry.model.particles(), geometry.model.layout);
    let dt = geometry.times.now;
    let kick = found(geometry, masses, &state[l.velocity() * n..]).kick;
    for i in fluid(model) {
        state[l.velocity() * n + i] += R::of(kick);
        state[i] = wrapped(&model.domain, 0, state[i] + R::of(dt * kick));
        if l.heat && conduction::is_inlet(model, state[i]) {
            state[l.temperature() * n + i] = R::default();
        }
    }
    kick / dt
}

/// The adjoint: maps `bar`, the cotangent of the state after the kick, to that before it, and adds to `masses_bar`.
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    masses: &[R],
    before: &[R],
    after: &[R],
    bar: &mut [R],
    masses_bar: &mut [R],
) {
    let (model, n, l) = (geometry.model, geometry.model.particles(), geometry.model.layout);
    let at = l.velocity() * n;
    let found = found(geometry, masses, &before[at..]);
    let own = fluid(model).filter(|&i| model.is_own(i));
    let kick_bar: Total = own.map(|i| bar[at + i].f64() + geometry.times.now * bar[i].f64()).collect();
    let [kick_bar] = model.over_ranks([kick_bar]);
    let (by_momentum, by_mass) = (R::of(kick_bar * found.by_momentum), R::of(kick_bar * found.by_mass));
    for i in fluid(model) {
        bar[at + i] += masses[i] * by_momentum;
        masses_bar[i] = before[at + i] * by_momentum + by_mass;
        if l.heat && conduction::is_inlet(model, after[i]) {
            bar[l.temperature() * n + i] = R::default();
        }
    }
}

/// [`forward`] by candle's operators; masses `[1, N]`.
pub fn composed<R: Real>(
    model: &Consistent<R>,
    dt: f64,
    fluid: &Tensor,
    masses: &Tensor,
    state: &Tensor,
) -> Result<Tensor> {
    let Some(drive) = model.drive else { return Ok(state.clone()) };
    let l = model.layout;
    let u = state.narrow(0, l.velocity(), 1)?;
    let sum = |f: &Tensor| f.sum_keepdim(1);
    let kick = drive.composed(dt, &sum(&masses.mul(&u)?)?, &sum(masses)?)?;
    let kick = fluid.broadcast_mul(&kick)?;
    let x = state.narrow(0, 0, 1)?;
    let moved = model.domain.wrapped_of(0, &(&x + kick.affine(dt, 0.0)?)?)?;
    let still = fluid.affine(-1.0, 1.0)?;
    let moved = (moved.mul(fluid)? + x.mul(&still)?)?;
    let mut rows = vec![moved.clone(), state.narrow(0, 1, l.velocity() - 1)?, (u + kick)?];
    let behind = l.velocity() + 1;
    match &model.heat {
        None => rows.push(state.narrow(0, behind, l.state_rows() - behind)?),
        Some(heat) => {
            rows.push(state.narrow(0, behind, l.temperature() - behind)?);
            let inlet = below(&moved, heat.inlet_below)?.mul(fluid)?;
            rows.push(state.narrow(0, l.temperature(), 1)?.mul(&inlet.affine(-1.0, 1.0)?)?);
            rows.push(state.narrow(0, l.last_rates(), l.state_rows() - l.last_rates())?);
        }
    }
    Tensor::cat(&rows, 0)
}
