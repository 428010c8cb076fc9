//! Flows at fixed particles in time whose pressure follows from a speed of sound: explicit steps without any system for the fluid.
//!
//! ```text
//!   du/dt = -u . grad u - grad p + nu lap u + f + b (T - T0)
//!   dp/dt = -c^2 (div u - tau S p)                                  tau = 0.3 h / c
//!   dT/dt = -u . grad T + alpha lap T
//! ```
//!
//! (artificial compressibility, Chorin 1967, with a sound so fast that the flow hardly knows of it: errors are of the order of the square of the Mach
//! number), by Runge and Kutta's method of fourth order. On the boundary u and T are what is given, or have no slope, and the pressure
//! balances the momentum across the wall,
//!
//! ```text
//!   n . grad p + h S p = n . (nu lap u + f + b (T - T0) - u . grad u - du/dt);
//! ```
//!
//! these are small systems for the points of the boundary alone, with factors that stay. (With continuity at walls, as in
//! [`super::unsteady`], sound grows on irregular particles by 0.03 c / h, and without S in this row pressures of points side by side oscillate: the flow
//! behind a cylinder was not finite after 30 steps.) Where no pressure is given its mean is 0.
//!
//! Where fluid leaves, the pressure is that of a plane sound that leaves too (what is 0 would send it back: in the channel of a cylinder the flow
//! rate swings by 4 % for ever),
//!
//! ```text
//!   p = c (mean velocity with which fluid leaves - what enters, over the area where it leaves),
//! ```
//!
//! which is 0 for a fluid without sound.
//!
//! A flow that begins as it does not fit to its walls makes a sound that runs to and fro in a channel for long, so the [first](FIRST) steps are those
//! of an incompressible fluid.

use super::equations::{Condition, Motion, State, Warmth};
use super::fit::{blocks, field, Coefficients};
use super::fit_adjoint::PairCotangents;
use super::fits::Fits;
use super::particles::Fluid;
use super::steady::NoSteadyState;
use super::unsteady::{Control, InTime};
use crate::numerics::lanes::{Lanes, WIDEST};
use crate::numerics::sparse_lu::{BlockMatrix, Order, SparseLu};
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::laplacian;
use std::borrow::Cow;
use std::sync::Arc;

/// tau in h / c.
const DAMPING: f64 = 0.3;
/// Over which part of a step velocities of walls are compared at the start.
pub(super) const START: f64 = 0.5;
/// Steps times the fastest rate of sound and viscosity. (The method of fourth order is stable up to 2.6 in all directions that decay.)
const STABLE: f64 = 2.0;
/// Iterations that find it.
const ITERATIONS: usize = 60;
/// Weight of S in the pressure of walls, in scales of the fit. (In space with 1 rates are ten times as fast as sound, and the flow around a
/// ball is not finite; with 3 and 6 they are not, and its drag is the same.)
const SMOOTHING: f64 = 3.0;
/// How far the fluid may go, in spacings, until its figures are looked at again.
const COURANT: f64 = 0.5;
/// Stages of a step: how far along each is, and its weight in the result.
pub(super) const STAGES: [(f64, f64); 4] = [(0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0)];

/// Steps of an incompressible fluid that a flow begins with. (The first makes the velocity fit to the walls, and its pressure is that of
/// the jolt; those after it have the pressure of the flow.)
pub const FIRST: usize = 3;

/// What positions get of the cotangents of coefficients.
pub type ByPairs<const D: usize, const C: usize> = fn(&Fits<D>, &[Vec<f64>; D], PairCotangents<C>, &mut [Vec<f64>; D]);

/// The fluid and its particles.
pub struct Medium<'a, const D: usize, const C: usize> {
    pub fits: Arc<Fits<D>>,
    pub operators: &'a Coefficients<C>,
    pub position: &'a [Vec<f64>; D],
    pub inside: usize,
    /// Spacing of each particle.
    pub spacing: &'a [f64],
    /// What holds on the boundary at the start; of what kind it is does not change.
    pub conditions: &'a [Condition<D>],
    pub fluid: Fluid<D>,
    /// The speed of sound.
    pub sound: f64,
    pub threads: usize,
    pub by_pairs: ByPairs<D, C>,
}

/// The equations of one field at the points of the boundary: of each the weights of the slopes, of the Laplacian and of S, or none where the
/// value itself is given; and their factors where values are not given everywhere.
pub(super) struct Edge<const F: usize> {
    pub rows: Vec<Option<[f64; F]>>,
    lu: Option<SparseLu>,
}

impl<const F: usize> Edge<F> {
    /// The values at all points, or the transposed solution.
    pub fn solve(&self, right: Vec<f64>, transposed: bool) -> Vec<f64> {
        match &self.lu {
            Some(lu) => lu.solve(&right, transposed),
            None => right,
        }
    }
}

/// A flow with sound in D dimensions, with F = D + 2 fields: velocity, pressure, temperature. Fields of particles are
/// `[blocks, F, WIDEST]`, coefficients of pairs, those of slopes, Laplacian and S, `[blocks, K, F, WIDEST]`.
pub struct WithSound<'a, const D: usize, const F: usize, const C: usize> {
    pub(super) medium: Medium<'a, D, C>,
    pub(super) table: Vec<f64>,
    /// Where the fields of each neighbour begin.
    pub(super) list: Vec<u32>,
    /// c^2 tau, `[blocks, WIDEST]`.
    pub(super) damping: Vec<f64>,
    /// Of each field.
    pub(super) edges: [Edge<F>; F],
    /// Whether the mean of the pressure is 0.
    floats: bool,
    /// The fastest rate of sound and viscosity.
    fastest: f64,
    /// The smallest spacing.
    least: f64,
    /// Area that a point of the boundary has, if sides are divided evenly, over that of all points where fluid leaves; empty if it leaves
    /// nowhere.
    pub(super) shares: Vec<f64>,
}

/// Conditions at a moment, and how fast given velocities change.
pub(super) struct Walls<'a, const D: usize> {
    pub conditions: Cow<'a, [Condition<D>]>,
    pub acceleration: Vec<[f64; D]>,
}

impl<'a, const D: usize, const F: usize, const C: usize> WithSound<'a, D, F, C> {
    /// # Errors
    /// Conditions on the boundary that do not determine its fields.
    pub fn new(medium: Medium<'a, D, C>) -> Result<Self, NoSteadyState> {
        let stencils = &medium.fits.all;
        let n = stencils.particles;
        let pairs = stencils.list.len();
        let mut table = vec![0.0; pairs * F];
        for i in 0..blocks(n) * WIDEST {
            for k in 0..stencils.count(i) {
                let c = medium.operators.of(i, k);
                let first = stencils.row(i, k) * F * WIDEST + i % WIDEST;
                (0..D).for_each(|d| table[first + d * WIDEST] = c[d]);
                table[first + D * WIDEST] = laplacian::<f64, D>(|a| c[a]);
                table[first + (D + 1) * WIDEST] = c[C - 1];
            }
        }
        let list = stencils.list.iter().map(|&j| field(F, j as usize, 0) as u32).collect();
        let mut damping: Vec<f64> = medium.spacing.iter().map(|h| DAMPING * h * medium.sound).collect();
        damping.resize(blocks(n) * WIDEST, 0.0);
        let gives_pressure = medium.conditions.iter().any(|c| matches!(c.motion, Motion::Outflow(_)));
        let edges = std::array::from_fn(|_| Edge { rows: vec![], lu: None });
        let least = smallest(medium.spacing);
        let own = |k: usize| medium.spacing[medium.inside + k].powi(D as i32 - 1);
        let leaves = |k: &usize| matches!(medium.conditions[*k].motion, Motion::Outflow(_));
        let points = 0..medium.conditions.len();
        let total: f64 = points.clone().filter(leaves).map(own).sum();
        let shares = if gives_pressure { points.map(|k| own(k) / total).collect() } else { vec![] };
        let mut found =
            Self { medium, table, list, damping, edges, floats: !gives_pressure, fastest: 0.0, least, shares };
        let order = found.order();
        for f in 0..F {
            found.edges[f] = found.edge(f, &order)?;
        }
        found.fastest = found.fastest_rate();
        Ok(found)
    }

    /// The largest modulus of the rates at which disturbances of a fluid at rest change, by von Mises' iteration.
    fn fastest_rate(&mut self) -> f64 {
        let (force, buoyancy) =
            (std::mem::replace(&mut self.medium.fluid.force, [0.0; D]), self.medium.fluid.buoyancy.take());
        let zero = |condition: &Condition<D>| Condition {
            motion: match condition.motion {
                Motion::Given(_) => Motion::Given([0.0; D]),
                other => other,
            },
            warmth: match condition.warmth {
                Warmth::Given(_) => Warmth::Given(0.0),
                Warmth::Flux(_) => Warmth::Flux(0.0),
            },
            ..*condition
        };
        let conditions: Cow<'_, [Condition<D>]> = self.medium.conditions.iter().map(zero).collect();
        let walls = Walls { acceleration: vec![[0.0; D]; conditions.len()], conditions };
        let width = F * WIDEST;
        let count = blocks(self.medium.inside) * width;
        // Every disturbance is in it, so small that it does not carry itself. Pressures are as large as those of sound.
        let mut y = vec![0.0; blocks(self.medium.fits.all.particles) * width];
        let (inside, sound) = (self.medium.inside, self.medium.sound);
        let scale = |f: usize| if f == D { sound } else { 1.0 };
        let each = || (0..inside).flat_map(|i| (0..F).map(move |f| (field(F, i, f), f)));
        each().for_each(|(k, f)| y[k] = scale(f) * ((1.0 + k as f64 * 0.754_877_666).fract() - 0.5));
        let (mut rate, mut length) = (0.0, 1.0);
        for iteration in 0..ITERATIONS {
            let size = each().map(|(k, f)| (y[k] / scale(f)).powi(2)).sum::<f64>().sqrt();
            // The mean over the second half: a pair of complex rates turns.
            if iteration == ITERATIONS / 2 {
                rate = 1.0;
            } else if iteration > ITERATIONS / 2 {
                rate *= size / length;
            }
            let small = 1e-6 * (inside as f64).sqrt() / size;
            y.iter_mut().for_each(|y| *y *= small);
            length = size * small;
            self.fill(&mut y, &walls);
            let (mut sum, mut next) = (vec![0.0; count], y.clone());
            let kernel = Rates { flow: self, now: &y, start: &y, weight: 1.0, ahead: None };
            run_parts(&kernel, sum.chunks_exact_mut(width).zip(next[..count].chunks_exact_mut(width)));
            y[..count].copy_from_slice(&sum);
        }
        (self.medium.fluid.force, self.medium.fluid.buoyancy) = (force, buoyancy);
        rate.powf(1.0 / (ITERATIONS - 1 - ITERATIONS / 2) as f64)
    }

    fn points(&self) -> usize {
        self.medium.conditions.len()
    }

    pub(super) fn has_heat(&self) -> bool {
        self.medium.fluid.diffusivity.is_some()
    }

    /// Which neighbours of a point are on the boundary, as points.
    fn neighbours(&self, point: usize) -> Vec<u32> {
        let (stencils, inside) = (&self.medium.fits.all, self.medium.inside);
        let i = inside + point;
        let all = (0..stencils.count(i)).map(|k| stencils.neighbour(i, k));
        all.filter_map(|j| j.checked_sub(inside).map(|j| j as u32)).filter(|&j| j as usize != point).collect()
    }

    fn order(&self) -> Arc<Order> {
        let (matrix, inside) = (BlockMatrix::of_lists(self.points(), 1, |k| self.neighbours(k)), self.medium.inside);
        let place = |k: usize| std::array::from_fn::<f64, D, _>(|d| self.medium.position[d][inside + k]);
        Arc::new(Order::new(&matrix, place))
    }

    /// The equations of a field on the boundary.
    fn edge(&self, f: usize, order: &Arc<Order>) -> Result<Edge<F>, NoSteadyState> {
        let along = |d: usize| Some(std::array::from_fn(|a| if a == d { 1.0 } else { 0.0 }));
        let across = |k: usize| -> Option<[f64; F]> {
            let (normal, scale) =
                (self.medium.conditions[k].normal, self.medium.fits.all.scale(self.medium.inside + k));
            Some(std::array::from_fn(|a| match a {
                a if a < D => normal[a],
                a if a == D + 1 => scale * SMOOTHING,
                _ => 0.0,
            }))
        };
        let row = |k: usize| match (self.medium.conditions[k], f) {
            (Condition { motion: Motion::Outflow(_), .. }, f) if f == D => None,
            (_, f) if f == D => across(k),
            (Condition { warmth: Warmth::Given(_), .. }, f) if f > D => None,
            (_, f) if f > D => across(k),
            (Condition { motion: Motion::Symmetry(d), .. }, e) if d != e => along(d),
            (Condition { motion: Motion::Outflow(d), .. }, _) => along(d),
            _ => None,
        };
        let rows: Vec<_> = (0..self.points()).map(row).collect();
        if rows.iter().all(Option::is_none) || (f > D && !self.has_heat()) {
            return Ok(Edge { rows, lu: None });
        }
        let (stencils, inside) = (&self.medium.fits.all, self.medium.inside);
        let mut matrix = BlockMatrix::of_lists(self.points(), 1, |k| self.neighbours(k));
        for (k, row) in rows.iter().enumerate() {
            let diagonal = matrix.entry(k, k as u32);
            let Some(weights) = row else {
                matrix.values[diagonal] = 1.0;
                continue;
            };
            let i = inside + k;
            for pair in 0..stencils.count(i) {
                let c: f64 = self.pair(i, pair).iter().zip(weights).map(|(c, weight)| c * weight).sum();
                matrix.values[diagonal] -= c;
                if let Some(j) = stencils.neighbour(i, pair).checked_sub(inside) {
                    let entry = matrix.entry(k, j as u32);
                    matrix.values[entry] += c;
                }
            }
        }
        Ok(Edge { rows, lu: Some(SparseLu::new(order, &matrix, self.medium.threads)?) })
    }

    /// The coefficients of a pair.
    #[inline(always)]
    pub(super) fn pair(&self, i: usize, k: usize) -> [f64; F] {
        let first = self.medium.fits.all.row(i, k) * F * WIDEST + i % WIDEST;
        std::array::from_fn(|a| self.table[first + a * WIDEST])
    }

    /// Where the fields of a neighbour begin.
    #[inline(always)]
    pub(super) fn begin(&self, i: usize, k: usize) -> usize {
        self.list[self.medium.fits.all.row(i, k) * WIDEST + i % WIDEST] as usize
    }

    /// Slopes, Laplacian and S of a field at a particle.
    pub(super) fn sums(&self, y: &[f64], i: usize, f: usize) -> [f64; F] {
        let own = y[field(F, i, f)];
        let mut sums = [0.0; F];
        for k in 0..self.medium.fits.all.count(i) {
            let difference = y[self.begin(i, k) + f * WIDEST] - own;
            let c = self.pair(i, k);
            (0..F).for_each(|a| sums[a] += c[a] * difference);
        }
        sums
    }

    /// The acceleration at a point that the pressure balances, component by component, given the sums of the velocities there.
    pub(super) fn unbalanced(&self, y: &[f64], i: usize, of: &[[f64; F]; D], acceleration: [f64; D]) -> [f64; D] {
        let (medium, own) = (&self.medium, |f: usize| y[field(F, i, f)]);
        std::array::from_fn(|e| {
            let carried: f64 = (0..D).map(|d| own(d) * of[e][d]).sum();
            let lift = medium.fluid.buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, own(D + 1)));
            medium.fluid.viscosity * of[e][D] + medium.fluid.force[e] + lift - carried - acceleration[e]
        })
    }

    /// The conditions at a time; `step`: over which velocities are compared.
    pub(super) fn walls(&self, boundary: &dyn InTime<D, F, C>, time: f64, step: f64) -> Walls<'a, D> {
        let conditions = boundary.at(time, self.medium.conditions);
        if !boundary.changes() {
            return Walls { conditions, acceleration: vec![[0.0; D]; self.points()] };
        }
        let (up, down) = (boundary.conditions(time + step), boundary.conditions(time - step));
        let of = |(up, down): (&Condition<D>, &Condition<D>)| match (up.motion, down.motion) {
            (Motion::Given(a), Motion::Given(b)) => std::array::from_fn(|e| (a[e] - b[e]) / (2.0 * step)),
            _ => [0.0; D],
        };
        Walls { conditions, acceleration: up.iter().zip(&down).map(of).collect() }
    }

    /// Those in the middle of a part of a step and at its end, where its stages are.
    pub(super) fn walls_of_part(&self, boundary: &dyn InTime<D, F, C>, (time, dt): (f64, f64)) -> [Walls<'a, D>; 2] {
        [0.5, 1.0].map(|at| self.walls(boundary, time + at * dt, 0.5 * dt))
    }

    /// The pressure where fluid leaves, by the velocities of the boundary.
    fn outlet(&self, y: &[f64], conditions: &[Condition<D>]) -> f64 {
        let inside = self.medium.inside;
        let more = |(k, share): (usize, &f64)| -> f64 {
            let condition = &conditions[k];
            let through = |u: [f64; D]| -share * (0..D).map(|e| condition.normal[e] * u[e]).sum::<f64>();
            match condition.motion {
                Motion::Given(given) => through(given),
                Motion::Outflow(_) => through(std::array::from_fn(|e| y[field(F, inside + k, e)])),
                Motion::Symmetry(_) => 0.0,
            }
        };
        self.medium.sound * self.shares.iter().enumerate().map(more).sum::<f64>()
    }

    /// Makes the mean of the pressure 0 where none is given; so does its transpose with cotangents.
    pub(super) fn centre(&self, y: &mut [f64]) {
        if self.floats {
            let inside = self.medium.inside;
            let mean = (0..inside).map(|i| y[field(F, i, D)]).sum::<f64>() / inside as f64;
            (0..inside).for_each(|i| y[field(F, i, D)] -= mean);
        }
    }

    /// Gives the points of the boundary their fields.
    pub(super) fn fill(&self, y: &mut [f64], walls: &Walls<'_, D>) {
        let (points, inside) = (self.points(), self.medium.inside);
        self.centre(y);
        // Velocity and temperature first: the pressure follows from them.
        let after = self.has_heat().then_some(D + 1).into_iter().chain([D]);
        for f in (0..D).chain(after) {
            let edge = &self.edges[f];
            let outlet = if f == D { self.outlet(y, &walls.conditions) } else { 0.0 };
            (0..points).for_each(|k| y[field(F, inside + k, f)] = 0.0);
            let right = |k: usize| {
                let (i, condition) = (inside + k, &walls.conditions[k]);
                let Some(weights) = edge.rows[k] else {
                    return match (condition.motion, condition.warmth) {
                        (Motion::Given(given), _) if f < D => given[f],
                        (_, Warmth::Given(given)) if f > D => given,
                        _ => outlet,
                    };
                };
                let sums = self.sums(y, i, f);
                let of_others: f64 = weights.iter().zip(&sums).map(|(weight, sum)| weight * sum).sum();
                let wanted = match (f, condition.warmth) {
                    (f, Warmth::Flux(flux)) if f > D => -flux / self.medium.fluid.diffusivity.unwrap_or(1.0),
                    (f, _) if f == D => {
                        let of: [[f64; F]; D] = std::array::from_fn(|e| self.sums(y, i, e));
                        let unbalanced = self.unbalanced(y, i, &of, walls.acceleration[k]);
                        (0..D).map(|e| condition.normal[e] * unbalanced[e]).sum()
                    }
                    _ => 0.0,
                };
                wanted - of_others
            };
            let found = edge.solve((0..points).map(right).collect(), false);
            found.into_iter().enumerate().for_each(|(k, value)| y[field(F, inside + k, f)] = value);
        }
    }

    /// A state as fields of blocks.
    pub(super) fn packed(&self, state: &State<F>) -> Vec<f64> {
        let n = self.medium.fits.all.particles;
        let mut y = vec![0.0; blocks(n) * F * WIDEST];
        for (f, values) in state.fields.iter().enumerate() {
            values.iter().enumerate().for_each(|(i, value)| y[field(F, i, f)] = *value);
        }
        y
    }

    /// The state of fields of blocks.
    pub(super) fn unpacked(&self, y: &[f64]) -> State<F> {
        let n = self.medium.fits.all.particles;
        let fields = std::array::from_fn(|f| (0..n).map(|i| y[field(F, i, f)]).collect());
        State { fields, lambda: 0.0, drive: 0.0 }
    }

    /// The largest step that is stable, if the fluid is not faster than `velocity`.
    pub fn largest_step(&self, velocity: f64) -> f64 {
        STABLE / (self.fastest + velocity / self.least)
    }

    /// How many of these a step of this size takes.
    pub(super) fn parts(&self, size: f64, velocity: f64) -> usize {
        (size / self.largest_step(velocity) * (1.0 - 1e-9)).ceil().max(1.0) as usize
    }

    /// Goes on from filled fields by one part of a step, from `time` on; `look` is shown the filled fields of each stage.
    pub(super) fn advance(
        &self,
        z: Vec<f64>,
        (time, dt): (f64, f64),
        boundary: &dyn InTime<D, F, C>,
        look: &mut dyn FnMut(&[f64]),
    ) -> Vec<f64> {
        let width = F * WIDEST;
        let count = blocks(self.medium.inside) * width;
        let (mut sum, mut now, mut next) = (vec![0.0; count], z.clone(), z.clone());
        let [middle, end] = self.walls_of_part(boundary, (time, dt));
        for (s, (at, weight)) in STAGES.into_iter().enumerate() {
            if s > 0 {
                std::mem::swap(&mut now, &mut next);
                self.fill(&mut now, if at < 1.0 { &middle } else { &end });
            }
            look(&now);
            let ahead = STAGES.get(s + 1).map(|(at, _)| at * dt);
            let kernel = Rates { flow: self, now: &now, start: &z, weight: weight * dt, ahead };
            run_parts(&kernel, sum.chunks_exact_mut(width).zip(next[..count].chunks_exact_mut(width)));
        }
        self.fill(&mut next, &end);
        next
    }

    /// Goes on from `first` at a time by steps of these sizes, each in as many parts as the sound needs; `watch` gets the time and
    /// state after each step, and may stop it. `velocity`: a typical one.
    ///
    /// # Errors
    /// A flow that is not finite, and those of `watch`.
    pub fn run<E: From<NoSteadyState>>(
        &self,
        (mut time, first): (f64, &State<F>),
        boundary: &dyn InTime<D, F, C>,
        velocity: f64,
        sizes: &[f64],
        watch: &mut dyn FnMut(f64, &State<F>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut y = self.packed(first);
        self.fill(&mut y, &self.walls(boundary, time, START * self.largest_step(velocity)));
        for &size in sizes {
            y = self.step(y, (time, size), velocity, boundary, &mut |_| {});
            time += size;
            let state = self.unpacked(&y);
            let fastest = state.fields[..D].iter().flatten().fold(0.0, |most: f64, u| most.max(u.abs()));
            if fastest > 1e3 * velocity || state.fields.iter().flatten().any(|x| !x.is_finite()) {
                return Err(NoSteadyState::Unbounded { time }.into());
            }
            watch(time, &state)?;
        }
        Ok(())
    }

    /// Goes on by a step of this size.
    pub(super) fn step(
        &self,
        mut y: Vec<f64>,
        (time, size): (f64, f64),
        velocity: f64,
        boundary: &dyn InTime<D, F, C>,
        look: &mut dyn FnMut(&[f64]),
    ) -> Vec<f64> {
        let parts = self.parts(size, velocity);
        let dt = size / parts as f64;
        for part in 0..parts {
            y = self.advance(y, (time + part as f64 * dt, dt), boundary, look);
        }
        y
    }
}

fn smallest(spacing: &[f64]) -> f64 {
    spacing.iter().fold(f64::MAX, |a, &b| a.min(b))
}

/// The sizes of all steps to the end: as long as the flow allows.
pub fn sizes(control: Control, spacing: &[f64]) -> Vec<f64> {
    let Control { velocity, fixed, end, .. } = control;
    let count = (end / fixed.unwrap_or(COURANT * smallest(spacing) / velocity) * (1.0 - 1e-9)).ceil().max(1.0);
    vec![end / count; count as usize]
}

/// A stage: the rates of the particles of a block are added to the sum, and the next stage begins with the start and some of them.
struct Rates<'a, const D: usize, const F: usize, const C: usize> {
    flow: &'a WithSound<'a, D, F, C>,
    now: &'a [f64],
    start: &'a [f64],
    weight: f64,
    /// How far ahead the next stage is; none behind the last one.
    ahead: Option<f64>,
}

impl<'a, const D: usize, const F: usize, const C: usize> PartKernel<f64> for Rates<'a, D, F, C> {
    /// The sum and the next stage, `[F, WIDEST]`.
    type Part = (&'a mut [f64], &'a mut [f64]);

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, (sum, next): &mut Self::Part) {
        let WithSound { medium, table, list, damping, .. } = self.flow;
        let stencils = &medium.fits.all;
        let fields = if medium.fluid.diffusivity.is_some() { F } else { F - 1 };
        let (first, count) = (stencils.row(block * WIDEST, 0), stencils.count(block * WIDEST));
        let square = L::splat(medium.sound * medium.sound);
        for l in (0..WIDEST).step_by(L::COUNT) {
            let mut own = [L::zero(); F];
            (0..F).for_each(|f| own[f] = L::load_part(&self.now[(block * F + f) * WIDEST + l..]));
            let (mut slope, mut second) = ([[L::zero(); D]; F], [L::zero(); F]);
            for k in first..first + count {
                let mut c = [L::zero(); F];
                (0..F).for_each(|a| c[a] = L::load_part(&table[(k * F + a) * WIDEST + l..]));
                for f in 0..fields {
                    // SAFETY: the list names where fields of particles begin, and each has F of them.
                    let other =
                        unsafe { L::gather(self.now.as_ptr().add(f * WIDEST), list.as_ptr().add(k * WIDEST + l)) };
                    let difference = other - own[f];
                    (0..D).for_each(|d| slope[f][d] = c[d].mul_add(difference, slope[f][d]));
                    second[f] = c[if f == D { D + 1 } else { D }].mul_add(difference, second[f]);
                }
            }
            let mut rate = [L::zero(); F];
            for f in (0..fields).filter(|f| *f != D) {
                let factor = if f < D { medium.fluid.viscosity } else { medium.fluid.diffusivity.unwrap_or(0.0) };
                rate[f] = L::splat(factor) * second[f];
                (0..D).for_each(|d| rate[f] = rate[f] - own[d] * slope[f][d]);
            }
            let mut divergence = L::zero();
            for e in 0..D {
                divergence += slope[e][e];
                rate[e] = rate[e] + L::splat(medium.fluid.force[e]) - slope[D][e];
                if let Some(buoyancy) = medium.fluid.buoyancy {
                    rate[e] += L::splat(buoyancy.by[e]) * (own[D + 1] - L::splat(buoyancy.at));
                }
            }
            rate[D] = L::load_part(&damping[block * WIDEST + l..]) * second[D] - square * divergence;
            for f in 0..F {
                let at = f * WIDEST + l;
                let total = L::splat(self.weight).mul_add(rate[f], L::load_part(&sum[at..]));
                let start = L::load_part(&self.start[block * F * WIDEST + at..]);
                let then = self.ahead.map_or(start + total, |ahead| L::splat(ahead).mul_add(rate[f], start));
                // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                unsafe {
                    total.store(sum[at..at + L::COUNT].as_mut_ptr());
                    then.store(next[at..at + L::COUNT].as_mut_ptr());
                }
            }
        }
    }
}
