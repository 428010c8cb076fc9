//! The end of a step: velocity, temperature and place of the fluid from their rates.
//!
//! ```text
//!   u += dt (-grad p / rho + nu lap u + g - beta (T - T0) g + w.grad u)
//!   T += dt (alpha lap T + w.grad T)            not upstream of the inlet's end, nor downstream of the outlet's beginning
//!   r += dt (u + w)                             with the new u
//! ```
//!
//! with the gradient of the new pressure (symplectic in velocity and pressure). Or, with the rates a, T' of the last step in the
//! state (`time.integrator = "verlet"`: velocity Verlet, Swope et al. 1982, with the velocity that the rates need predicted),
//!
//! ```text
//!   u_now = u + dt_before/2 (a - a_before)      u is what the last step predicted, u_before + dt_before a_before
//!   r += dt (u_now + dt/2 a + w)
//!   u = u_now + dt a,                           and likewise T
//! ```
//!
//! of second order in time at the same cost; there is no step before the first: dt_before = 0. Fluid that is in the inlet then
//! has the inlet's temperature. What walls have stays; the pressure and temperature of dummy particles are nobody's state: 0.

use super::blocks::Place;
use super::geometry::Geometry;
use super::kinds::rows;
use super::stencil::{laplacian, monomials, quadratic};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::laws::conduction;
use crate::sph::own::Own;
use crate::sph::pairs::with_dimension;
use std::ops::Range;

/// What the terms of the rates are multiplied with.
struct Factors<R> {
    /// 1/dx.
    scale: R,
    viscosity: R,
    diffusivity: R,
    inverse_density: R,
}

impl<R: Real> Factors<R> {
    #[inline(always)]
    fn of(geometry: &Geometry<'_, R>) -> Self {
        let (model, fits) = (geometry.model, &geometry.model.fits);
        let scale = R::of(1.0 / fits.spacing);
        Self {
            scale,
            viscosity: R::of(fits.viscosity) * scale * scale,
            diffusivity: R::of(fits.diffusivity) * scale * scale,
            inverse_density: R::of(1.0 / model.equation_of_state.reference_density) * scale,
        }
    }
}

struct Forward<'a, R, const D: usize> {
    geometry: Geometry<'a, R>,
    known: &'a [R],
    derivatives: &'a [R],
    gradient: &'a [R],
    state: Own<'a, R>,
}

impl<R: Real, const D: usize> Forward<'_, R, D> {
    /// Acceleration, warming and shift of a fluid particle.
    #[inline(always)]
    fn rates(&self, factors: &Factors<R>, place: usize) -> ([R; D], R, [R; D]) {
        let fields = self.geometry.model.layout.fields();
        let q = const { monomials(D) };
        let at = Place::of::<R>(place, rows(D, fields));
        let of_pressure = Place::of::<R>(place, rows(D, 1));
        let derivative = |row: usize| self.derivatives[at.row(row)];
        let mut shift = [R::default(); D];
        for k in 0..D {
            shift[k] = derivative(fields * q + 1 + k);
        }
        let carried = |field: usize| {
            let mut sum = R::default();
            for k in 0..D {
                sum += shift[k] * derivative(field * q + k);
            }
            sum * factors.scale
        };
        let spread = |field: usize| laplacian::<R, D>(|m| derivative(field * q + m));
        let mut acceleration = [R::default(); D];
        for k in 0..D {
            let pushed = factors.inverse_density * self.gradient[of_pressure.row(k)];
            acceleration[k] = carried(k) + factors.viscosity * spread(k) - pushed;
        }
        let warming = match self.geometry.model.heat.is_some() {
            true => carried(D + 1) + factors.diffusivity * spread(D + 1),
            false => R::default(),
        };
        (acceleration, warming, shift)
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, places: Range<usize>) {
        let geometry = &self.geometry;
        let (n, l, factors) = (geometry.model.particles(), geometry.model.layout, Factors::of(geometry));
        let dt = R::of(geometry.times.now);
        let (half, half_before) = (R::of(0.5 * geometry.times.now), R::of(0.5 * geometry.times.before));
        for place in places {
            let i = geometry.blocks.fluid.particle(place);
            let known = |row: usize| self.known[row * n + i];
            let (acceleration, warming, shift) = self.rates(&factors, place);
            let set = |row: usize, value: R| self.state.set(row * n + i, value);
            let mut x = R::default();
            for k in 0..D {
                let given = R::of(geometry.model.given(k, known(1).f64(), || known(l.temperature()).f64()));
                let rate = acceleration[k] + given;
                let (velocity, mean) = match l.rates {
                    true => {
                        set(l.last_rates() + k, rate);
                        let now = known(l.velocity() + k) + half_before * (rate - known(l.last_rates() + k));
                        (now + dt * rate, now + half * rate)
                    }
                    false => {
                        let velocity = known(l.velocity() + k) + dt * rate;
                        (velocity, velocity)
                    }
                };
                let moved = known(k) + dt * (mean + shift[k]);
                let moved = crate::particles::domain::wrapped(&geometry.model.domain, k, moved);
                set(l.velocity() + k, velocity);
                set(k, moved);
                if k == 0 {
                    x = moved;
                }
            }
            set(l.pressure(), self.gradient[Place::of::<R>(place, const { rows(D, 1) }).row(const { monomials(D) })]);
            if l.heat {
                let open = conduction::conducts(geometry.model, known(0));
                let reset = conduction::is_inlet(geometry.model, x);
                let mut after = known(l.temperature());
                if open {
                    after += dt * warming;
                }
                if l.rates {
                    let row = l.last_rates() + const { D };
                    if open {
                        after += half_before * (warming - known(row));
                    }
                    set(row, if open && !reset { warming } else { R::default() });
                }
                set(l.temperature(), if reset { R::default() } else { after });
            }
        }
    }
}

/// known `[F, N]`, derivatives, derivatives of the new pressure with itself behind them -> state `[F, N]`.
pub fn forward<R: Real>(geometry: &Geometry<'_, R>, known: &[R], derivatives: &[R], gradient: &[R], state: &mut [R]) {
    let (n, l, places) = (geometry.model.particles(), geometry.model.layout, geometry.blocks.fluid.places);
    if places < n {
        state.copy_from_slice(known);
        for &(dummy, _) in &geometry.model.fits.dummies {
            (l.pressure()..l.state_rows()).for_each(|row| state[row * n + dummy as usize] = R::default());
        }
    }
    let (geometry, state) = (*geometry, Own::new(state));
    with_dimension!(l.dimension, |D| run_rows(
        &Forward::<R, D> { geometry, known, derivatives, gradient, state },
        places,
    ));
}

struct Backward<'a, R, const D: usize> {
    geometry: Geometry<'a, R>,
    known: &'a [R],
    derivatives: &'a [R],
    /// The state at the step's end.
    state: &'a [R],
    state_bar: &'a [R],
    known_bar: Own<'a, R>,
    derivatives_bar: Own<'a, R>,
    gradient_bar: Own<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for Backward<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, places: Range<usize>) {
        let (geometry, model) = (&self.geometry, self.geometry.model);
        let (n, l, factors) = (model.particles(), model.layout, Factors::of(geometry));
        let fields = l.fields();
        let q = const { monomials(D) };
        let dt = R::of(geometry.times.now);
        let (half, half_before) = (R::of(0.5 * geometry.times.now), R::of(0.5 * geometry.times.before));
        for place in places {
            let i = geometry.blocks.fluid.particle(place);
            let at = Place::of::<R>(place, rows(D, fields));
            let of_pressure = Place::of::<R>(place, rows(D, 1));
            let bar = |row: usize| self.state_bar[row * n + i];
            let shift = |k: usize| self.derivatives[at.row(fields * q + 1 + k)];
            let add = |row: usize, value: R| self.known_bar.add(row * n + i, value);
            let derivative = |row: usize, value: R| self.derivatives_bar.set(at.row(row), value);
            let gradient = |row: usize, value: R| self.gradient_bar.set(of_pressure.row(row), value);
            let mut shift_bar = [R::default(); D];
            (0..fields * q + 1).for_each(|m| derivative(m, R::default()));
            (0..const { rows(D, 1) }).for_each(|m| gradient(m, R::default()));
            // What a field's rate is carried with and spread by.
            let carry = |field: usize, rate_bar: R, shift_bar: &mut [R; D]| {
                let scaled = rate_bar * factors.scale;
                for k in 0..D {
                    shift_bar[k] += scaled * self.derivatives[at.row(field * q + k)];
                    derivative(field * q + k, scaled * shift(k));
                }
            };
            let spread = |field: usize, bar: R| {
                (0..D).for_each(|a| derivative(field * q + quadratic(D, a, a), bar));
            };
            for k in 0..D {
                let place_bar = bar(k);
                add(k, place_bar);
                shift_bar[k] += dt * place_bar;
                let velocity_bar = bar(l.velocity() + k) + dt * place_bar;
                add(l.velocity() + k, velocity_bar);
                let mut rate_bar = dt * velocity_bar;
                if l.rates {
                    // The place has dt a / 2 of the velocity's dt a.
                    rate_bar += bar(l.last_rates() + k) + half_before * velocity_bar - dt * half * place_bar;
                    add(l.last_rates() + k, -(half_before * velocity_bar));
                }
                carry(k, rate_bar, &mut shift_bar);
                spread(k, factors.viscosity * rate_bar);
                gradient(k, -(factors.inverse_density * rate_bar));
                if let Some(buoyancy) = &model.buoyancy {
                    add(l.temperature(), R::of(buoyancy.by[k]) * rate_bar);
                }
            }
            gradient(q, bar(l.pressure()));
            if l.heat {
                // Which side of the inlet's end it is on does not change with an infinitesimal step.
                let reset = conduction::is_inlet(model, self.state[i]);
                let after_bar = if reset { R::default() } else { bar(l.temperature()) };
                add(l.temperature(), after_bar);
                if conduction::conducts(model, self.known[i]) {
                    let mut rate_bar = dt * after_bar;
                    if l.rates {
                        let row = l.last_rates() + const { D };
                        rate_bar += half_before * after_bar;
                        if !reset {
                            rate_bar += bar(row);
                        }
                        add(row, -(half_before * after_bar));
                    }
                    carry(D + 1, rate_bar, &mut shift_bar);
                    spread(D + 1, factors.diffusivity * rate_bar);
                }
            }
            for k in 0..D {
                derivative(fields * q + 1 + k, shift_bar[k]);
            }
        }
    }
}

/// The adjoint: adds to `known_bar`, and sets the other cotangents at the fluid's places.
#[allow(clippy::too_many_arguments)]
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    derivatives: &[R],
    state: &[R],
    state_bar: &[R],
    known_bar: &mut [R],
    derivatives_bar: &mut [R],
    gradient_bar: &mut [R],
) {
    let (model, n, l) = (geometry.model, geometry.model.particles(), geometry.model.layout);
    let places = geometry.blocks.fluid.places;
    if places < n {
        for i in (0..n).filter(|&i| !model.is_fluid(i)) {
            (0..l.state_rows()).for_each(|row| known_bar[row * n + i] += state_bar[row * n + i]);
        }
        for &(dummy, _) in &model.fits.dummies {
            let i = dummy as usize;
            (l.pressure()..l.state_rows()).for_each(|row| known_bar[row * n + i] -= state_bar[row * n + i]);
        }
    }
    let (geometry, known_bar) = (*geometry, Own::new(known_bar));
    let (derivatives_bar, gradient_bar) = (Own::new(derivatives_bar), Own::new(gradient_bar));
    with_dimension!(l.dimension, |D| run_rows(
        &Backward::<R, D> { geometry, known, derivatives, state, state_bar, known_bar, derivatives_bar, gradient_bar },
        places,
    ));
}
