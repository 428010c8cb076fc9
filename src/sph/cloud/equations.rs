//! The steady equations at fixed particles: residuals, their matrices, and their derivative by the positions.
//!
//! Inside, with the derivatives of [`super::fit`] and per unit of density,
//!
//! ```text
//!   momentum      u . grad u + grad p - nu lap u - f = 0
//!   continuity    div u - tau S p + lambda = 0          tau = 2 / (4 nu / h^2 + 1.4 U / h)
//!   heat          u . grad T - alpha lap T = 0.
//! ```
//!
//! On walls u and T are given, or the heat flux q, alpha (n . grad T + h S T) = -q. Where fluid flows out along x,
//!
//! ```text
//!   nu du/dx - p = 0,   n . grad v + h S v = 0
//! ```
//!
//! (the "do nothing" of finite elements: Heywood, Rannacher and Turek 1996). With du/dx = 0 and p = 0 the fluid could not go aside there,
//! since div u = 0: the drag of a disc that ends a third of a channel's height before the outflow was 0.9 % too small, and is 0.2 % too large.
//! Continuity holds on the boundary as well. S f is what a fit leaves of a field; it damps a checkerboard and nothing else.
//! The fits do not conserve volume exactly, so where no pressure is given, one number lambda takes the rest (about 1e-3 of
//! the flow rate per area), and p = 0 at one particle.

use super::fit::{Coefficients, COEFFICIENTS, LEFT};
use super::fits::Fits;
use super::outline::Dual;
use crate::numerics::sparse_lu::BlockMatrix;
use crate::sph::laws::buoyancy::Buoyancy;
use std::sync::Arc;

/// Weight of S beside the derivative across a boundary, in scales of the fit. (Without it the temperatures of a disc with a given flux
/// oscillate from point to point where it is badly resolved: its shape then meets one without a solution within 0.02 dx, with 1 in
/// none. At dx = 0.02 it costs 0.7 % of such a disc's temperature, at 0.01 0.2 %. Velocities where fluid flows out follow from their slope
/// in the same way: of 96 points on such a side one had a weight of its own of 0.03 where others have 1.2, and four times the velocity of
/// the stream.)
const SMOOTHING: f64 = 1.0;

/// The velocity at a point of the boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion<const D: usize = 2> {
    Given([f64; D]),
    /// No flow along direction d, and no derivative along it of the other components ([`Condition::across`]).
    Symmetry(usize),
    /// Out along direction d: no traction of the fluid beyond. In two dimensions it is that of p - nu du_d/dx_d, in space p = 0.
    Outflow(usize),
}

/// The temperature at a point of the boundary, relative to the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Warmth {
    Given(f64),
    /// Heat flux into the fluid per density and heat capacity.
    Flux(f64),
}

/// What holds at a point of the boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition<const D: usize = 2> {
    pub motion: Motion<D>,
    pub warmth: Warmth,
    /// Unit normal into the fluid.
    pub normal: [f64; D],
}

impl<const D: usize> Condition<D> {
    /// n . grad f + h S f of the derivatives of a field, or of the coefficients of a pair: 0 where a velocity has no slope across a side, and
    /// what a heat flux is of T. `smoothing`: h.
    pub fn across<const C: usize>(&self, d: &[f64; C], smoothing: f64) -> f64 {
        self.across_by(std::array::from_fn(|e| e), d, smoothing)
    }

    /// The same, given the `places` of the slopes among the derivatives.
    pub fn across_by<const C: usize>(&self, places: [usize; D], d: &[f64; C], smoothing: f64) -> f64 {
        (0..D).map(|e| self.normal[e] * d[places[e]]).sum::<f64>() + smoothing * d[C - 1]
    }

    /// Adds what [`Self::across`] makes of derivatives, given its cotangent.
    pub fn across_back<const C: usize>(&self, bar: f64, smoothing: f64, to: &mut [f64; C]) {
        self.across_by_back(std::array::from_fn(|e| e), bar, smoothing, to);
    }

    /// The same of [`Self::across_by`].
    pub fn across_by_back<const C: usize>(&self, places: [usize; D], bar: f64, smoothing: f64, to: &mut [f64; C]) {
        (0..D).for_each(|e| to[places[e]] += bar * self.normal[e]);
        to[C - 1] += bar * smoothing;
    }
}

/// Velocity, pressure and temperature of all particles, and the two numbers of the whole flow.
#[derive(Debug, Clone, PartialEq)]
pub struct State<const F: usize = 4> {
    /// u, v, p, T; in space u, v, w, p, T.
    pub fields: [Vec<f64>; F],
    /// The rest of continuity, and the acceleration along x that a drive adds.
    pub lambda: f64,
    pub drive: f64,
}

impl<const F: usize> State<F> {
    pub fn at_rest(particles: usize) -> Self {
        Self { fields: std::array::from_fn(|_| vec![0.0; particles]), lambda: 0.0, drive: 0.0 }
    }

    /// The fields that the equations have: all with heat, all but the temperature without.
    pub fn in_use(&self, has_heat: bool) -> Vec<&[f64]> {
        self.fields[..if has_heat { F } else { F - 1 }].iter().map(Vec::as_slice).collect()
    }
}

/// The materials, forces and conditions of a flow at fixed particles.
#[derive(Debug, Clone)]
pub struct Equations {
    /// Kinematic viscosity.
    pub viscosity: f64,
    /// Thermal diffusivity; none without heat.
    pub diffusivity: Option<f64>,
    pub force: [f64; 2],
    pub buoyancy: Option<Buoyancy>,
    /// tau of each particle.
    pub damping: Vec<f64>,
    /// The spacing h at each particle, on which tau depends.
    pub spacing: Vec<f64>,
    /// Number of particles inside; the others are on the boundary.
    pub inside: usize,
    /// Of each particle on the boundary.
    pub conditions: Vec<Condition>,
    pub fits: Arc<Fits>,
}

/// tau = 2 / (4 nu / h^2 + 1.4 U / h).
pub fn damping(viscosity: f64, velocity: f64, spacing: f64) -> f64 {
    2.0 / (4.0 * viscosity / (spacing * spacing) + 1.4 * velocity / spacing)
}

/// The derivative of tau by the viscosity, also of one whose 1 / tau has a part by the step in time.
pub fn damping_slope(damping: f64, spacing: f64) -> f64 {
    -2.0 * (damping / spacing).powi(2)
}

/// Derivatives of all F fields at all particles, `[N][C]` each.
#[derive(Debug, Clone)]
pub struct Derivatives<const F: usize = 4, const C: usize = COEFFICIENTS>(pub [Vec<[f64; C]>; F]);

impl<const F: usize, const C: usize> Derivatives<F, C> {
    pub fn zeros(particles: usize) -> Self {
        Self(std::array::from_fn(|_| vec![[0.0; C]; particles]))
    }
}

impl Equations {
    pub fn particles(&self) -> usize {
        self.fits.all.particles
    }

    /// The weight of S beside a derivative across the boundary.
    pub fn smoothing(&self, i: usize) -> f64 {
        SMOOTHING * self.fits.all.scale(i)
    }

    /// Whether a pressure is given somewhere; otherwise lambda is unknown, and p = 0 at particle 0.
    pub fn gives_pressure(&self) -> bool {
        self.conditions.iter().any(|condition| matches!(condition.motion, Motion::Outflow(_)))
    }

    /// Derivatives of the flow's fields, and of the temperature if `heat`.
    pub fn derivatives(&self, operators: &Coefficients, state: &State, heat: bool) -> Derivatives {
        let n = self.particles();
        let of = |f: usize| -> Vec<[f64; COEFFICIENTS]> {
            let value = &state.fields[f];
            match f {
                3 if !heat || self.diffusivity.is_none() => vec![[0.0; COEFFICIENTS]; n],
                _ => (0..n).map(|i| operators.derivatives(&self.fits.all, i, value)).collect(),
            }
        };
        Derivatives(std::array::from_fn(of))
    }

    /// Derivatives at the boundary and at some particles more; zeros at the others.
    pub fn derivatives_at(&self, operators: &Coefficients, state: &State, more: &[usize]) -> Derivatives {
        let mut d = Derivatives::zeros(self.particles());
        for f in (0..4).filter(|&f| f < 3 || self.diffusivity.is_some()) {
            for i in (self.inside..self.particles()).chain(more.iter().copied()) {
                d.0[f][i] = operators.derivatives(&self.fits.all, i, &state.fields[f]);
            }
        }
        d
    }

    /// Buoyancy on a particle along e.
    fn lift(&self, state: &State, i: usize, e: usize) -> f64 {
        self.buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, state.fields[3][i]))
    }

    /// Residuals of momentum and continuity, `[N, 3]`.
    pub fn flow_residual(&self, state: &State, d: &Derivatives) -> Vec<f64> {
        let [u, v, p, _] = &state.fields;
        let [du, dv, dp, _] = &d.0;
        let nu = self.viscosity;
        let mut residual = vec![0.0; 3 * self.particles()];
        for (i, row) in residual.chunks_exact_mut(3).enumerate() {
            row[2] = du[i][0] + dv[i][1] - self.damping[i] * dp[i][LEFT] + state.lambda;
            if i < self.inside {
                row[0] = u[i] * du[i][0] + v[i] * du[i][1] + dp[i][0]
                    - nu * (du[i][2] + du[i][4])
                    - self.force[0]
                    - self.lift(state, i, 0)
                    - state.drive;
                row[1] = u[i] * dv[i][0] + v[i] * dv[i][1] + dp[i][1]
                    - nu * (dv[i][2] + dv[i][4])
                    - self.force[1]
                    - self.lift(state, i, 1);
                continue;
            }
            let condition = self.conditions[i - self.inside];
            // With this sign a point has a positive weight in its own equation.
            let no_slope = |e: usize| -condition.across(&[du[i], dv[i]][1 - e], self.smoothing(i));
            match condition.motion {
                Motion::Given(given) => (row[0], row[1]) = (u[i] - given[0], v[i] - given[1]),
                Motion::Symmetry(e) => (row[e], row[1 - e]) = ([u[i], v[i]][e], no_slope(e)),
                Motion::Outflow(e) => (row[e], row[1 - e]) = (nu * [du[i], dv[i]][e][e] - p[i], no_slope(e)),
            }
        }
        residual
    }

    /// Residual of the heat, `[N]`.
    pub fn heat_residual(&self, state: &State, d: &Derivatives) -> Vec<f64> {
        let [u, v, _, t] = &state.fields;
        let (dt, alpha) = (&d.0[3], self.diffusivity.unwrap_or(0.0));
        let of = |i: usize| {
            if i < self.inside {
                return u[i] * dt[i][0] + v[i] * dt[i][1] - alpha * (dt[i][2] + dt[i][4]);
            }
            let condition = self.conditions[i - self.inside];
            match condition.warmth {
                Warmth::Given(given) => t[i] - given,
                Warmth::Flux(flux) => alpha * condition.across(&dt[i], self.smoothing(i)) + flux,
            }
        };
        (0..self.particles()).map(of).collect()
    }

    /// The derivative of [`Self::flow_residual`] by u, v, p, in the structure of `matrix`; in one of blocks of four that of the heat's
    /// residual too, and by T.
    pub fn flow_matrix(&self, state: &State, d: &Derivatives, operators: &Coefficients, matrix: &mut BlockMatrix) {
        let [u, v, ..] = &state.fields;
        let [du, dv, ..] = &d.0;
        matrix.values.fill(0.0);
        let size = matrix.size;
        let add = |to: &mut [f64], block: &[f64; 9]| {
            for (k, value) in block.iter().enumerate() {
                to[k / 3 * size + k % 3] += value;
            }
        };
        for i in 0..self.particles() {
            let diagonal = matrix.entry(i, i as u32);
            let mut own = [0.0; 9];
            let mut own_heat = 0.0;
            for k in 0..self.fits.all.count(i) {
                let c = operators.of(i, k);
                let mut block = [0.0; 9];
                (block[6], block[7], block[8]) = (c[0], c[1], -self.damping[i] * c[LEFT]);
                if i < self.inside {
                    let moved = u[i] * c[0] + v[i] * c[1] - self.viscosity * (c[2] + c[4]);
                    (block[0], block[2], block[4], block[5]) = (moved, c[0], moved, c[1]);
                } else {
                    let condition = self.conditions[i - self.inside];
                    if let Motion::Symmetry(e) | Motion::Outflow(e) = condition.motion {
                        block[4 * (1 - e)] = -condition.across(&c, self.smoothing(i));
                    }
                    if let Motion::Outflow(e) = condition.motion {
                        block[4 * e] = self.viscosity * c[e];
                    }
                }
                for (own, value) in own.iter_mut().zip(&block) {
                    *own -= value;
                }
                let entry = matrix.entry(i, self.fits.all.neighbour(i, k) as u32);
                add(matrix.block_mut(entry), &block);
                if size == 4 {
                    let heat = self.heat_entry(state, i, &c);
                    own_heat -= heat;
                    matrix.block_mut(entry)[15] += heat;
                }
            }
            if i < self.inside {
                own[0] += du[i][0];
                own[1] += du[i][1];
                own[3] += dv[i][0];
                own[4] += dv[i][1];
            } else {
                match self.conditions[i - self.inside].motion {
                    Motion::Given(_) => (own[0], own[4]) = (1.0, 1.0),
                    Motion::Symmetry(e) => own[4 * e] = 1.0,
                    Motion::Outflow(e) => own[3 * e + 2] -= 1.0,
                }
            }
            let block = matrix.block_mut(diagonal);
            add(block, &own);
            if size == 4 {
                block[15] += self.heat_diagonal(i, own_heat);
                if i < self.inside {
                    (0..2).for_each(|e| block[12 + e] += d.0[3][i][e]);
                    (0..2).for_each(|e| block[4 * e + 3] -= self.buoyancy.map_or(0.0, |buoyancy| buoyancy.by[e]));
                }
            }
        }
    }

    /// The derivative of the heat's residual at particle i by the temperature of a neighbour with coefficients c.
    fn heat_entry(&self, state: &State, i: usize, c: &[f64; COEFFICIENTS]) -> f64 {
        let ([u, v, ..], alpha) = (&state.fields, self.diffusivity.unwrap_or(0.0));
        match (i >= self.inside).then(|| self.conditions[i - self.inside]) {
            None => u[i] * c[0] + v[i] * c[1] - alpha * (c[2] + c[4]),
            Some(Condition { warmth: Warmth::Given(_), .. }) => 0.0,
            Some(condition) => alpha * condition.across(c, self.smoothing(i)),
        }
    }

    /// The same by its own temperature, given what the neighbours' entries leave for it.
    fn heat_diagonal(&self, i: usize, own: f64) -> f64 {
        match (i >= self.inside).then(|| self.conditions[i - self.inside].warmth) {
            Some(Warmth::Given(_)) => 1.0,
            _ => own,
        }
    }

    /// The derivative of [`Self::heat_residual`] by T.
    pub fn heat_matrix(&self, state: &State, operators: &Coefficients, matrix: &mut BlockMatrix) {
        matrix.values.fill(0.0);
        for i in 0..self.particles() {
            let mut own = 0.0;
            for k in 0..self.fits.all.count(i) {
                let value = self.heat_entry(state, i, &operators.of(i, k));
                own -= value;
                let entry = matrix.entry(i, self.fits.all.neighbour(i, k) as u32);
                matrix.values[entry] += value;
            }
            let diagonal = matrix.entry(i, i as u32);
            matrix.values[diagonal] += self.heat_diagonal(i, own);
        }
    }

    /// The cotangents of the derivatives and of the boundary's numbers, given those of the residuals: `flow` `[N, 3]`,
    /// `heat` `[N]`, added to `bar`.
    pub fn pull_back(&self, state: &State, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        self.pull_back_linear(d, flow, heat, bar);
        let [u, v, ..] = &state.fields;
        for i in 0..self.inside {
            let heat = heat.filter(|_| self.diffusivity.is_some()).map(|heat| (3, heat[i]));
            for (f, row) in [(0, flow[3 * i]), (1, flow[3 * i + 1])].into_iter().chain(heat) {
                let to = &mut bar.derivatives.0[f][i];
                to[0] += u[i] * row;
                to[1] += v[i] * row;
            }
        }
    }

    /// The same without what the flow carries.
    pub fn pull_back_linear(&self, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        let Derivatives([du_bar, dv_bar, dp_bar, dt_bar]) = &mut bar.derivatives;
        for i in 0..self.particles() {
            let row = &flow[3 * i..3 * i + 3];
            let condition = (i >= self.inside).then(|| self.conditions[i - self.inside]);
            du_bar[i][0] += row[2];
            dv_bar[i][1] += row[2];
            dp_bar[i][LEFT] -= self.damping[i] * row[2];
            bar.viscosity -= damping_slope(self.damping[i], self.spacing[i]) * d.0[2][i][LEFT] * row[2];
            match condition.map(|condition| condition.motion) {
                None => {
                    for (field, to, row) in [(0, &mut du_bar[i], row[0]), (1, &mut dv_bar[i], row[1])] {
                        let of = &d.0[field][i];
                        to[2] -= self.viscosity * row;
                        to[4] -= self.viscosity * row;
                        bar.viscosity -= (of[2] + of[4]) * row;
                    }
                    dp_bar[i][0] += row[0];
                    dp_bar[i][1] += row[1];
                }
                Some(Motion::Given(_)) => {
                    let given = &mut bar.boundary[i - self.inside];
                    (0..2).for_each(|e| given.velocity[e] -= row[e]);
                }
                Some(Motion::Symmetry(_)) => {}
                Some(Motion::Outflow(e)) => {
                    [&mut *du_bar, &mut *dv_bar][e][i][e] += self.viscosity * row[e];
                    bar.viscosity += d.0[e][i][e] * row[e];
                }
            }
            if let Some(condition @ Condition { motion: Motion::Symmetry(e) | Motion::Outflow(e), .. }) = condition {
                let to = [&mut *du_bar, &mut *dv_bar];
                condition.across_back(-row[1 - e], self.smoothing(i), &mut to[1 - e][i]);
            }
            let (Some(heat), Some(alpha)) = (heat, self.diffusivity) else { continue };
            if i < self.inside {
                let row = heat[i];
                dt_bar[i][2] -= alpha * row;
                dt_bar[i][4] -= alpha * row;
                continue;
            }
            let condition = self.conditions[i - self.inside];
            let of_boundary = &mut bar.boundary[i - self.inside];
            match condition.warmth {
                Warmth::Given(_) => of_boundary.temperature -= heat[i],
                Warmth::Flux(_) => {
                    condition.across_back(alpha * heat[i], self.smoothing(i), &mut dt_bar[i]);
                    (0..2).for_each(|e| of_boundary.normal[e] += alpha * d.0[3][i][e] * heat[i]);
                    of_boundary.temperature += heat[i];
                }
            }
        }
    }

    /// What the residuals of momentum get from a change of T's equation: d(heat residual)/d(u, v), transposed: `[N, 2]`.
    pub fn heat_by_velocity(&self, d: &Derivatives, heat: &[f64]) -> Vec<[f64; 2]> {
        let of = |i: usize| match i < self.inside {
            true => [heat[i] * d.0[3][i][0], heat[i] * d.0[3][i][1]],
            false => [0.0; 2],
        };
        (0..self.particles()).map(of).collect()
    }
}

/// Cotangents of a point of the boundary: of its given velocity, of its given temperature or flux, of its unit normal, and of normal
/// times length or area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryBar<const D: usize = 2> {
    pub velocity: [f64; D],
    pub temperature: f64,
    pub normal: [f64; D],
    pub area: [f64; D],
}

impl<const D: usize> Default for BoundaryBar<D> {
    fn default() -> Self {
        Self { velocity: [0.0; D], temperature: 0.0, normal: [0.0; D], area: [0.0; D] }
    }
}

/// Cotangents of all that depends on the shape, and of the state, in D dimensions with F fields and fits of C coefficients.
#[derive(Debug, Clone)]
pub struct Bar<const D: usize = 2, const F: usize = 4, const C: usize = COEFFICIENTS> {
    pub derivatives: Derivatives<F, C>,
    pub boundary: Vec<BoundaryBar<D>>,
    /// Of positions themselves, `[D][N]`.
    pub position: [Vec<f64>; D],
    /// Of the fields themselves, `[F][N]`.
    pub fields: [Vec<f64>; F],
    /// Of the drive's acceleration.
    pub drive: f64,
    /// Of the kinematic viscosity.
    pub viscosity: f64,
    /// Of the volume of the fluid, in space.
    pub volume: f64,
    /// Of the x and y of shapes' centres, with the shape.
    pub centres: Vec<(usize, [f64; 2])>,
    /// Of what slopes lack in the momentum inside ([`super::deferred_correction`]), `[inside]`, or empty.
    pub defect: Vec<[f64; D]>,
    /// The same in the equation of heat.
    pub heat_defect: Vec<f64>,
}

impl<const D: usize, const F: usize, const C: usize> Bar<D, F, C> {
    pub fn new(particles: usize, boundary: usize) -> Self {
        Self {
            derivatives: Derivatives::zeros(particles),
            boundary: vec![BoundaryBar::default(); boundary],
            position: std::array::from_fn(|_| vec![0.0; particles]),
            fields: std::array::from_fn(|_| vec![0.0; particles]),
            drive: 0.0,
            viscosity: 0.0,
            volume: 0.0,
            centres: vec![],
            defect: vec![],
            heat_defect: vec![],
        }
    }

    /// Adds to the cotangent of a shape's centre.
    pub fn add_centre(&mut self, shape: usize, centre: [f64; 2]) {
        match self.centres.iter_mut().find(|(of, _)| *of == shape) {
            Some((_, to)) => (0..2).for_each(|d| to[d] += centre[d]),
            None => self.centres.push((shape, centre)),
        }
    }

    /// Adds those of the viscosity, the volume and the centres of shapes of another one.
    pub fn add_of_whole_flow(&mut self, other: &Self) {
        self.viscosity += other.viscosity;
        self.volume += other.volume;
        other.centres.iter().for_each(|&(shape, centre)| self.add_centre(shape, centre));
    }

    /// What a shape's centre adds to the derivative by a number, given the centre with its derivative.
    pub fn by_centre(&self, shape: usize, centre: impl FnOnce() -> [Dual; 2]) -> f64 {
        let own = self.centres.iter().find(|(of, _)| *of == shape);
        own.map_or(0.0, |(_, bar)| {
            let [x, y] = centre();
            bar[0] * x.slope + bar[1] * y.slope
        })
    }

    /// Adds those of the points of the boundary of another one.
    pub fn add_walls(&mut self, other: &Self) {
        for (to, from) in self.boundary.iter_mut().zip(&other.boundary) {
            for e in 0..D {
                to.normal[e] += from.normal[e];
                to.area[e] += from.area[e];
                to.velocity[e] += from.velocity[e];
            }
            to.temperature += from.temperature;
        }
    }

    /// Becomes zero.
    pub fn clear(&mut self) {
        self.derivatives.0.iter_mut().for_each(|field| field.fill([0.0; C]));
        self.boundary.fill(BoundaryBar::default());
        self.position.iter_mut().chain(&mut self.fields).for_each(|field| field.fill(0.0));
        (self.drive, self.viscosity, self.volume) = (0.0, 0.0, 0.0);
        self.centres.clear();
        self.defect.clear();
        self.heat_defect.clear();
    }
}

impl Equations {
    /// The cotangents of the fields u, v, p, T, `[N]` each, given those of their derivatives and of themselves.
    pub fn by_fields(&self, operators: &Coefficients, bar: &Bar) -> [Vec<f64>; 4] {
        let mut fields = bar.fields.clone();
        for (f, to) in fields.iter_mut().enumerate() {
            if f == 3 && self.diffusivity.is_none() {
                continue;
            }
            operators.pull_back(&self.fits.all, &bar.derivatives.0[f], to);
        }
        fields
    }

    /// The cotangents of the positions, given those of the derivatives.
    pub fn by_positions(&self, position: &[Vec<f64>; 2], state: &State, bar: &Bar) -> [Vec<f64>; 2] {
        let mut found = bar.position.clone();
        let fields = state.in_use(self.diffusivity.is_some());
        self.fits.pull_back(position, &fields, &bar.derivatives.0[..fields.len()], &mut found);
        found
    }
}
