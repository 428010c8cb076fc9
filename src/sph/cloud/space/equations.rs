//! The steady equations at fixed particles in space: residuals and cotangents.
//!
//! As in the plane ([`super::super::equations`]), with u, v, w, p and T at every particle:
//!
//! ```text
//!   momentum      u . grad u + grad p - nu lap u - f - b (T - T0) = 0      inside; u given on walls
//!   continuity    div u - tau S p + lambda = 0                             everywhere but where p is given
//!   heat          u . grad T - alpha lap T = 0                             inside; T or the flux given on walls.
//! ```
//!
//! b (T - T0) is [buoyancy](crate::sph::laws::buoyancy).

use super::super::equations::{self, damping_slope, Warmth};
use super::super::fit::{Coefficients, COEFFICIENTS_3D as C, LEFT_3D as LEFT};
use super::super::fits::Fits;
use crate::sph::consistent::stencil::{self, quadratic};
use crate::sph::laws::buoyancy::Buoyancy;
use std::sync::Arc;

/// Index of the pressure and of the temperature among the fields.
pub const PRESSURE: usize = 3;
pub const TEMPERATURE: usize = 4;
/// Unknowns of the flow at a particle.
pub const FLOW: usize = 4;

/// Where the temperature of a particle does not follow from conduction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It is 0, that of what enters.
    Inlet,
    /// It is that of another particle, which is next to it.
    Outlet(u32),
}

/// Heat that a point of the boundary with a given flux gives to the fluid besides: coefficient (T_0 - T), `temperature` T_0, in length / time
/// and as the fluid's.
#[derive(Debug, Clone, Copy, Default)]
pub struct Exchange {
    pub coefficient: f64,
    pub temperature: f64,
}

/// u, v, w, p, T of all particles, and the two numbers of the whole flow.
pub type State = equations::State<5>;
pub type Motion = equations::Motion<3>;
pub type Condition = equations::Condition<3>;
/// Derivatives of u, v, w, p, T at all particles.
pub type Derivatives = equations::Derivatives<5, C>;
pub type Bar = equations::Bar<3, 5, C>;

impl State {
    pub fn velocity(&self, i: usize) -> [f64; 3] {
        std::array::from_fn(|d| self.fields[d][i])
    }
}

/// The materials, forces and conditions of a flow at fixed particles.
#[derive(Debug, Clone)]
pub struct Equations {
    pub viscosity: f64,
    pub diffusivity: Option<f64>,
    pub force: [f64; 3],
    pub buoyancy: Option<Buoyancy>,
    /// tau of each particle.
    pub damping: Vec<f64>,
    /// The spacing h at each particle, on which tau depends.
    pub spacing: Vec<f64>,
    pub inside: usize,
    pub conditions: Vec<Condition>,
    /// By point of the boundary; none at all around bodies.
    pub exchange: Vec<Exchange>,
    /// The ends of a channel that is periodic for the flow and not for the heat, by particle; none at all around bodies.
    pub ends: Vec<Option<End>>,
    /// Weight of S beside the slope across the boundary at each of its points, in scales of the fit.
    pub smoothing: Vec<f64>,
    pub fits: Arc<Fits<3>>,
}

/// The sum of the second derivatives.
pub(super) fn laplacian(d: &[f64; C]) -> f64 {
    stencil::laplacian::<f64, 3>(|a| d[a])
}

pub(super) fn dot(a: [f64; 3], b: &[f64; C]) -> f64 {
    (0..3).map(|d| a[d] * b[d]).sum()
}

impl Equations {
    pub fn particles(&self) -> usize {
        self.fits.all.particles
    }

    pub(super) fn smoothing(&self, i: usize) -> f64 {
        self.smoothing[i - self.inside] * self.fits.scale(i)
    }

    /// Whether a pressure is given somewhere; otherwise lambda is unknown, and the mean of p is 0.
    pub fn gives_pressure(&self) -> bool {
        self.conditions.iter().any(|condition| matches!(condition.motion, Motion::Outflow(_)))
    }

    pub(super) fn condition(&self, i: usize) -> Option<&Condition> {
        i.checked_sub(self.inside).map(|k| &self.conditions[k])
    }

    pub(super) fn exchange(&self, i: usize) -> Exchange {
        i.checked_sub(self.inside).and_then(|k| self.exchange.get(k)).copied().unwrap_or_default()
    }

    /// The heat that particle i of the boundary exchanges at temperature `t`, over density and heat capacity: temperature * volume / (area * time).
    pub fn exchanged(&self, i: usize, t: f64) -> f64 {
        let Exchange { coefficient, temperature } = self.exchange(i);
        coefficient * (temperature - t)
    }

    pub(super) fn end(&self, i: usize) -> Option<End> {
        self.ends.get(i).copied().flatten()
    }

    pub fn derivatives(&self, operators: &Coefficients<C>, state: &State) -> Derivatives {
        let of = |f: usize| -> Vec<[f64; C]> {
            match f {
                TEMPERATURE if self.diffusivity.is_none() => vec![[0.0; C]; self.particles()],
                _ => {
                    (0..self.particles()).map(|i| operators.derivatives(&self.fits.all, i, &state.fields[f])).collect()
                }
            }
        };
        equations::Derivatives(std::array::from_fn(of))
    }

    /// Derivatives at the boundary and at some particles more; zeros at the others.
    pub fn derivatives_at(&self, operators: &Coefficients<C>, state: &State, more: &[usize]) -> Derivatives {
        let mut d = Derivatives::zeros(self.particles());
        for f in (0..5).filter(|&f| f < TEMPERATURE || self.diffusivity.is_some()) {
            for i in (self.inside..self.particles()).chain(more.iter().copied()) {
                d.0[f][i] = operators.derivatives(&self.fits.all, i, &state.fields[f]);
            }
        }
        d
    }

    /// The acceleration that drives the fluid.
    pub fn push(&self, state: &State, e: usize) -> f64 {
        self.force[e] + if e == 0 { state.drive } else { 0.0 }
    }

    /// Residuals of momentum and continuity, `[N, 4]`.
    pub fn flow_residual(&self, state: &State, d: &Derivatives) -> Vec<f64> {
        let mut residual = vec![0.0; FLOW * self.particles()];
        for (i, row) in residual.chunks_exact_mut(FLOW).enumerate() {
            let (u, dp) = (state.velocity(i), &d.0[PRESSURE][i]);
            let divergence: f64 = (0..3).map(|e| d.0[e][i][e]).sum();
            row[PRESSURE] = divergence - self.damping[i] * dp[LEFT] + state.lambda;
            for e in 0..3 {
                row[e] = match self.condition(i).map(|condition| (condition.motion, condition)) {
                    None => {
                        let lift = self.buoyancy.map_or(0.0, |b| b.along(e, state.fields[TEMPERATURE][i]));
                        let carried = dot(u, &d.0[e][i]) - self.viscosity * laplacian(&d.0[e][i]);
                        carried + dp[e] - self.push(state, e) - lift
                    }
                    Some((Motion::Given(given), _)) => u[e] - given[e],
                    Some((Motion::Symmetry(along), _)) if along == e => u[e],
                    // With this sign a point has a positive weight in its own equation.
                    Some((_, condition)) => -condition.across(&d.0[e][i], self.smoothing(i)),
                };
            }
            if let Some(Condition { motion: Motion::Outflow(_), .. }) = self.condition(i) {
                row[PRESSURE] = state.fields[PRESSURE][i];
            }
        }
        residual
    }

    /// Residual of the heat, `[N]`.
    pub fn heat_residual(&self, state: &State, d: &Derivatives) -> Vec<f64> {
        let alpha = self.diffusivity.unwrap_or(0.0);
        let of = |i: usize| {
            let (t, dt) = (state.fields[TEMPERATURE][i], &d.0[TEMPERATURE][i]);
            match self.end(i) {
                Some(End::Inlet) => return t,
                Some(End::Outlet(before)) => return t - state.fields[TEMPERATURE][before as usize],
                None => {}
            }
            match self.condition(i) {
                None => dot(state.velocity(i), dt) - alpha * laplacian(dt),
                Some(Condition { warmth: Warmth::Given(given), .. }) => t - given,
                Some(condition @ Condition { warmth: Warmth::Flux(flux), .. }) => {
                    let slope = condition.across_by(self.fits.across(), dt, self.smoothing(i));
                    alpha * slope + flux + self.exchanged(i, t)
                }
            }
        };
        (0..self.particles()).map(of).collect()
    }

    /// The cotangents of derivatives and boundary, given those of the residuals: `flow` `[N, 4]`, `heat` `[N]`, added to `bar`.
    pub fn pull_back(&self, state: &State, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        self.pull_back_linear(d, flow, heat, bar);
        for i in 0..self.inside {
            let u = state.velocity(i);
            let heat = heat.filter(|_| self.diffusivity.is_some() && self.end(i).is_none());
            let rows = (0..3).map(|e| (e, flow[FLOW * i + e])).chain(heat.map(|heat| (TEMPERATURE, heat[i])));
            for (f, row) in rows {
                (0..3).for_each(|along| bar.derivatives.0[f][i][along] += u[along] * row);
            }
        }
    }

    /// The same without what the flow carries.
    pub fn pull_back_linear(&self, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        for i in 0..self.particles() {
            let row = &flow[FLOW * i..FLOW * (i + 1)];
            let condition = self.condition(i).map(|condition| (condition.motion, condition));
            if !matches!(condition, Some((Motion::Outflow(_), _))) {
                (0..3).for_each(|e| bar.derivatives.0[e][i][e] += row[PRESSURE]);
                bar.derivatives.0[PRESSURE][i][LEFT] -= self.damping[i] * row[PRESSURE];
                let slope = damping_slope(self.damping[i], self.spacing[i]);
                bar.viscosity -= slope * d.0[PRESSURE][i][LEFT] * row[PRESSURE];
            }
            for e in 0..3 {
                match condition {
                    None => {
                        let to = &mut bar.derivatives.0[e][i];
                        (0..3).for_each(|a| to[quadratic(3, a, a)] -= self.viscosity * row[e]);
                        bar.derivatives.0[PRESSURE][i][e] += row[e];
                        bar.viscosity -= laplacian(&d.0[e][i]) * row[e];
                    }
                    Some((Motion::Given(_), _)) => bar.boundary[i - self.inside].velocity[e] -= row[e],
                    Some((Motion::Symmetry(along), _)) if along == e => {}
                    Some((_, condition)) => {
                        condition.across_back(-row[e], self.smoothing(i), &mut bar.derivatives.0[e][i]);
                    }
                }
            }
            let (Some(heat), Some(alpha), None) = (heat, self.diffusivity, self.end(i)) else { continue };
            let to = &mut bar.derivatives.0[TEMPERATURE][i];
            match self.condition(i) {
                None => (0..3).for_each(|a| to[quadratic(3, a, a)] -= alpha * heat[i]),
                Some(Condition { warmth: Warmth::Given(_), .. }) => {
                    bar.boundary[i - self.inside].temperature -= heat[i];
                }
                Some(condition) => {
                    let of_boundary = &mut bar.boundary[i - self.inside];
                    let (flux_bar, across) = (alpha * heat[i], self.fits.across());
                    condition.across_by_back(across, flux_bar, self.smoothing(i), to);
                    (0..3).for_each(|e| of_boundary.normal[e] += flux_bar * d.0[TEMPERATURE][i][across[e]]);
                    of_boundary.temperature += heat[i];
                    bar.fields[TEMPERATURE][i] -= self.exchange(i).coefficient * heat[i];
                }
            }
        }
    }

    /// d(heat residual)/d(u, v, w), transposed, at particle i.
    pub fn heat_by_velocity(&self, d: &Derivatives, heat: &[f64], i: usize) -> [f64; 3] {
        match i < self.inside && self.end(i).is_none() {
            true => std::array::from_fn(|e| heat[i] * d.0[TEMPERATURE][i][e]),
            false => [0.0; 3],
        }
    }

    /// The cotangents of the fields, given those of their derivatives and of themselves.
    pub fn by_fields(&self, operators: &Coefficients<C>, bar: &Bar) -> [Vec<f64>; 5] {
        let mut fields = bar.fields.clone();
        for (f, to) in fields.iter_mut().enumerate() {
            operators.pull_back(&self.fits.all, &bar.derivatives.0[f], to);
        }
        fields
    }

    /// The cotangents of the positions, given those of the derivatives.
    pub fn by_positions(&self, position: &[Vec<f64>; 3], state: &State, bar: &Bar) -> [Vec<f64>; 3] {
        let mut found = bar.position.clone();
        let fields = state.in_use(self.diffusivity.is_some());
        self.fits.pull_back(position, &fields, &bar.derivatives.0[..fields.len()], &mut found);
        found
    }
}
