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
use super::fit::Coefficients;
use super::fit_adjoint::PairCotangents;
use super::fits::Fits;
use super::particles::Fluid;
use super::steady::NoSteadyState;
use super::unsteady::{Control, InTime, Reached};
use crate::numerics::lanes::{array, Lanes};
use crate::numerics::sparse_lu::{BlockMatrix, Order, SparseLu};
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::laplacian;
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

/// tau in h / c.
const DAMPING: f64 = 0.3;
/// Over which part of a step velocities of walls are compared at the start.
const START: f64 = 0.5;
/// Steps times the fastest rate of sound and viscosity. (The method of fourth order is stable up to 2.6 in all directions that decay.)
const STABLE: f64 = 2.0;
/// Iterations that find it.
const ITERATIONS: usize = 60;
/// Weight of S beside slopes across the boundary, in scales of the fit. (In space with 1 rates are ten times as fast as sound, and the flow around a
/// ball is not finite; with 3 and 6 they are not, and its drag is the same.)
const SMOOTHING: f64 = 3.0;
/// Numbers of a vector.
pub(super) const FOUR: usize = 4;
/// The most numbers of a particle.
pub(super) const MOST: usize = 2 * FOUR;
/// Particles that a thread computes together.
const TOGETHER: usize = 32;
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
    /// What weight S has beside slopes across the boundary at least, in scales of the fit; none in the plane.
    pub smoothing: &'a [f64],
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

/// A flow with sound in D dimensions, with F = D + 2 fields: velocity, pressure, temperature. What a step reads most lies one particle after
/// another, because a neighbour's fields are then one piece of memory: fields of particles are `[N, WIDTH]`, coefficients of pairs, those
/// of slopes, Laplacian and S, `[pairs, F]`.
pub struct WithSound<'a, const D: usize, const F: usize, const C: usize> {
    pub(super) medium: Medium<'a, D, C>,
    /// Where the pairs of each particle begin, `[N + 1]`.
    pub(super) first: Vec<usize>,
    pub(super) table: Vec<f64>,
    /// The neighbour of each pair.
    pub(super) list: Vec<u32>,
    /// c^2 tau, `[N]`.
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
        let (mut first, mut list, mut table) = (vec![0], vec![], vec![]);
        list.reserve_exact(stencils.list.len());
        table.reserve_exact(stencils.list.len() * F);
        for i in 0..n {
            // Those that fill up a block come last, and have no weight.
            for k in (0..stencils.count(i)).take_while(|&k| stencils.pair(i, k).1 > 0.0) {
                let c = medium.operators.of(i, k);
                list.push(stencils.neighbour(i, k) as u32);
                table.extend_from_slice(&c[..D]);
                table.extend([laplacian::<f64, D>(|a| c[a]), c[C - 1]]);
            }
            first.push(list.len());
        }
        let damping = medium.spacing.iter().map(|h| DAMPING * h * medium.sound).collect();
        let gives_pressure = medium.conditions.iter().any(|c| matches!(c.motion, Motion::Outflow(_)));
        let edges = std::array::from_fn(|_| Edge { rows: vec![], lu: None });
        let least = smallest(medium.spacing);
        let own = |k: usize| medium.spacing[medium.inside + k].powi(D as i32 - 1);
        let leaves = |k: &usize| matches!(medium.conditions[*k].motion, Motion::Outflow(_));
        let points = 0..medium.conditions.len();
        let total: f64 = points.clone().filter(leaves).map(own).sum();
        let shares = if gives_pressure { points.map(|k| own(k) / total).collect() } else { vec![] };
        let mut found =
            Self { medium, first, table, list, damping, edges, floats: !gives_pressure, fastest: 0.0, least, shares };
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
        let (inside, sound) = (self.medium.inside, self.medium.sound);
        let count = inside * Self::WIDTH;
        // Every disturbance is in it, so small that it does not carry itself. Pressures are as large as those of sound.
        let mut y = vec![0.0; self.medium.fits.all.particles * Self::WIDTH];
        let scale = |f: usize| if f == D { sound } else { 1.0 };
        let each = || (0..inside).flat_map(|i| (0..F).map(move |f| (Self::at(i, f), f)));
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
            Rates { flow: self, now: &y, start: &y, weight: 1.0, ahead: None }.run(&mut sum, &mut next[..count]);
            y[..count].copy_from_slice(&sum);
        }
        (self.medium.fluid.force, self.medium.fluid.buoyancy) = (force, buoyancy);
        rate.powf(1.0 / (ITERATIONS - 1 - ITERATIONS / 2) as f64)
    }

    fn points(&self) -> usize {
        self.medium.conditions.len()
    }

    /// Numbers from a particle's fields to those of the next one: whole vectors of four.
    pub(super) const WIDTH: usize = F.next_multiple_of(FOUR);

    /// The place of a particle's field.
    #[inline(always)]
    pub(super) fn at(i: usize, f: usize) -> usize {
        i * Self::WIDTH + f
    }

    pub(super) fn has_heat(&self) -> bool {
        self.medium.fluid.diffusivity.is_some()
    }

    /// How many fields the flow has: without heat the temperature, which is the last one, is not computed.
    #[inline(always)]
    pub(super) fn fields(&self) -> usize {
        F - usize::from(!self.has_heat())
    }

    /// Whether the first four fields are all.
    #[inline(always)]
    pub(super) fn has_few(&self) -> bool {
        F <= FOUR || self.fields() <= FOUR
    }

    /// What the Laplacian of each field is multiplied with in its rate: that of the pressure, with none.
    #[inline(always)]
    pub(super) fn diffusion(&self) -> [f64; F] {
        array(|f| match f {
            f if f < D => self.medium.fluid.viscosity,
            f if f == D => 0.0,
            _ => self.medium.fluid.diffusivity.unwrap_or(0.0),
        })
    }

    /// The pairs of a particle.
    #[inline(always)]
    pub(super) fn pairs(&self, i: usize) -> Range<usize> {
        self.first[i]..self.first[i + 1]
    }

    /// Which neighbours of a point are on the boundary, as points.
    fn neighbours(&self, point: usize) -> Vec<u32> {
        let inside = self.medium.inside;
        let all = self.list[self.pairs(inside + point)].iter().filter_map(|&j| j.checked_sub(inside as u32));
        all.filter(|&j| j as usize != point).collect()
    }

    fn order(&self) -> Arc<Order> {
        let (matrix, inside) = (BlockMatrix::of_lists(self.points(), 1, |k| self.neighbours(k)), self.medium.inside);
        let place = |k: usize| std::array::from_fn::<f64, D, _>(|d| self.medium.position[d][inside + k]);
        Arc::new(Order::new(&matrix, place))
    }

    /// The equations of a field on the boundary.
    fn edge(&self, f: usize, order: &Arc<Order>) -> Result<Edge<F>, NoSteadyState> {
        let across = |k: usize| -> Option<[f64; F]> {
            let (normal, scale) =
                (self.medium.conditions[k].normal, self.medium.fits.all.scale(self.medium.inside + k));
            let smoothing = self.medium.smoothing.get(k).map_or(SMOOTHING, |weight| weight.max(SMOOTHING));
            Some(std::array::from_fn(|a| match a {
                a if a < D => normal[a],
                a if a == D + 1 => scale * smoothing,
                _ => 0.0,
            }))
        };
        let row = |k: usize| match (self.medium.conditions[k], f) {
            (Condition { motion: Motion::Outflow(_), .. }, f) if f == D => None,
            (_, f) if f == D => across(k),
            (Condition { warmth: Warmth::Given(_), .. }, f) if f > D => None,
            (_, f) if f > D => across(k),
            (Condition { motion: Motion::Symmetry(d), .. }, e) if d != e => across(k),
            (Condition { motion: Motion::Outflow(_), .. }, _) => across(k),
            _ => None,
        };
        let rows: Vec<_> = (0..self.points()).map(row).collect();
        if rows.iter().all(Option::is_none) || (f > D && !self.has_heat()) {
            return Ok(Edge { rows, lu: None });
        }
        let inside = self.medium.inside;
        let mut matrix = BlockMatrix::of_lists(self.points(), 1, |k| self.neighbours(k));
        for (k, row) in rows.iter().enumerate() {
            let diagonal = matrix.entry(k, k as u32);
            let Some(weights) = row else {
                matrix.values[diagonal] = 1.0;
                continue;
            };
            for pair in self.pairs(inside + k) {
                let c: f64 = self.pair(pair).iter().zip(weights).map(|(c, weight)| c * weight).sum();
                matrix.values[diagonal] -= c;
                if let Some(j) = self.list[pair].checked_sub(inside as u32) {
                    let entry = matrix.entry(k, j);
                    matrix.values[entry] += c;
                }
            }
        }
        Ok(Edge { rows, lu: Some(SparseLu::new(order, &matrix, self.medium.threads)?) })
    }

    /// The coefficients of a pair.
    #[inline(always)]
    pub(super) fn pair(&self, pair: usize) -> &[f64] {
        &self.table[pair * F..][..F]
    }

    /// Slopes, Laplacian and S of a field at a particle.
    pub(super) fn sums(&self, y: &[f64], i: usize, f: usize) -> [f64; F] {
        let own = y[Self::at(i, f)];
        let mut sums = [0.0; F];
        for pair in self.pairs(i) {
            let difference = y[Self::at(self.list[pair] as usize, f)] - own;
            sums.iter_mut().zip(self.pair(pair)).for_each(|(sum, c)| *sum += c * difference);
        }
        sums
    }

    /// The same of all fields, `[sum][field]`.
    #[inline(always)]
    pub(super) fn all_sums<L: Lanes<Real = f64>>(&self, y: &[f64], i: usize) -> [Record; F] {
        match self.has_few() {
            true => self.first_sums::<L, FOUR>(y, i),
            false => self.first_sums::<L, MOST>(y, i),
        }
    }

    #[inline(always)]
    fn first_sums<L: Lanes<Real = f64>, const FIELDS: usize>(&self, y: &[f64], i: usize) -> [Record; F] {
        let own = Vectors::<L, FIELDS>::load(y, Self::at(i, 0));
        let mut sums = [Vectors::<L, FIELDS>::zero(); F];
        for pair in self.pairs(i) {
            let difference = Vectors::load(y, Self::at(self.list[pair] as usize, 0)).minus(&own);
            let c = self.pair(pair);
            for a in 0..F {
                sums[a].add(c[a], &difference);
            }
        }
        array(|a| sums[a].numbers())
    }

    /// Those of all fields at the points of the boundary.
    pub(super) fn sums_of_points(&self, y: &[f64]) -> Vec<[Record; F]> {
        let mut sums = vec![[[0.0; MOST]; F]; self.points()];
        run_parts(&SumsOfPoints { flow: self, y }, sums.chunks_mut(TOGETHER));
        sums
    }

    /// Those of a field at a point of the boundary, given those of all fields at all points, or nothing.
    pub(super) fn sums_at_point(&self, known: &[[Record; F]], y: &[f64], point: usize, f: usize) -> [f64; F] {
        match known.get(point) {
            Some(of) => array(|a| of[a][f]),
            None => self.sums(y, self.medium.inside + point, f),
        }
    }

    /// The acceleration at a point that the pressure balances, component by component, given the sums of the velocities there.
    pub(super) fn unbalanced(&self, y: &[f64], i: usize, of: &[Record; F], acceleration: [f64; D]) -> [f64; D] {
        let (medium, own) = (&self.medium, |f: usize| y[Self::at(i, f)]);
        std::array::from_fn(|e| {
            let carried: f64 = (0..D).map(|d| own(d) * of[d][e]).sum();
            let lift = medium.fluid.buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, own(D + 1)));
            medium.fluid.viscosity * of[D][e] + medium.fluid.force[e] + lift - carried - acceleration[e]
        })
    }

    /// Conditions and accelerations at all of N times but the first and the last one; `step`: from each to the next.
    pub(super) fn walls<const N: usize>(
        &self,
        boundary: &dyn InTime<D, F, C>,
        times: [f64; N],
        step: f64,
    ) -> Vec<Walls<'a, D>> {
        if !boundary.changes() {
            let acceleration = vec![[0.0; D]; self.points()];
            let given = || Walls { conditions: self.medium.conditions.into(), acceleration: acceleration.clone() };
            return (2..N).map(|_| given()).collect();
        }
        let all = times.map(|time| boundary.conditions(time));
        let of = |(up, down): (&Condition<D>, &Condition<D>)| match (up.motion, down.motion) {
            (Motion::Given(a), Motion::Given(b)) => std::array::from_fn(|e| (a[e] - b[e]) / (2.0 * step)),
            _ => [0.0; D],
        };
        let at = |three: &[Vec<Condition<D>>]| Walls {
            acceleration: three[2].iter().zip(&three[0]).map(of).collect(),
            conditions: Cow::Owned(three[1].clone()),
        };
        all.windows(3).map(at).collect()
    }

    /// When velocities of walls are looked at in a part of a step, half a part apart: its stages are at the second and third of these times.
    pub(super) fn moments((time, dt): (f64, f64)) -> [f64; 4] {
        [0.0, 0.5, 1.0, 1.5].map(|share| time + share * dt)
    }

    /// The times around the start.
    pub(super) fn at_start(&self, time: f64, velocity: f64) -> ([f64; 3], f64) {
        let step = START * self.largest_step(velocity);
        ([time - step, time, time + step], step)
    }

    /// The pressure where fluid leaves, by the velocities of the boundary.
    fn outlet(&self, y: &[f64], conditions: &[Condition<D>]) -> f64 {
        let inside = self.medium.inside;
        let more = |(k, share): (usize, &f64)| -> f64 {
            let condition = &conditions[k];
            let through = |u: [f64; D]| -share * (0..D).map(|e| condition.normal[e] * u[e]).sum::<f64>();
            match condition.motion {
                Motion::Given(given) => through(given),
                Motion::Outflow(_) => through(std::array::from_fn(|e| y[Self::at(inside + k, e)])),
                Motion::Symmetry(_) => 0.0,
            }
        };
        self.medium.sound * self.shares.iter().enumerate().map(more).sum::<f64>()
    }

    /// Makes the mean of the pressure 0 where none is given; so does its transpose with cotangents.
    pub(super) fn centre(&self, y: &mut [f64]) {
        if self.floats {
            let inside = self.medium.inside;
            let mean = (0..inside).map(|i| y[Self::at(i, D)]).sum::<f64>() / inside as f64;
            (0..inside).for_each(|i| y[Self::at(i, D)] -= mean);
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
            (0..points).for_each(|k| y[Self::at(inside + k, f)] = 0.0);
            // The pressure's need those of the velocities as well.
            let sums = if f == D { self.sums_of_points(y) } else { vec![] };
            let right = |k: usize| {
                let (i, condition) = (inside + k, &walls.conditions[k]);
                let Some(weights) = edge.rows[k] else {
                    return match (condition.motion, condition.warmth) {
                        (Motion::Given(given), _) if f < D => given[f],
                        (_, Warmth::Given(given)) if f > D => given,
                        _ => outlet,
                    };
                };
                let own = self.sums_at_point(&sums, y, k, f);
                let of_others: f64 = weights.iter().zip(&own).map(|(weight, sum)| weight * sum).sum();
                let wanted = match (f, condition.warmth) {
                    (f, Warmth::Flux(flux)) if f > D => -flux / self.medium.fluid.diffusivity.unwrap_or(1.0),
                    (f, _) if f == D => {
                        let unbalanced = self.unbalanced(y, i, &sums[k], walls.acceleration[k]);
                        (0..D).map(|e| condition.normal[e] * unbalanced[e]).sum()
                    }
                    _ => 0.0,
                };
                wanted - of_others
            };
            let found = edge.solve((0..points).map(right).collect(), false);
            found.into_iter().enumerate().for_each(|(k, value)| y[Self::at(inside + k, f)] = value);
        }
    }

    /// A state's fields, one particle after another.
    pub(super) fn packed(&self, state: &State<F>) -> Vec<f64> {
        let mut y = vec![0.0; self.medium.fits.all.particles * Self::WIDTH];
        for (f, values) in state.fields.iter().enumerate() {
            values.iter().enumerate().for_each(|(i, value)| y[Self::at(i, f)] = *value);
        }
        y
    }

    /// The state of such fields.
    pub(super) fn unpacked(&self, y: &[f64]) -> State<F> {
        let fields = std::array::from_fn(|f| y.chunks_exact(Self::WIDTH).map(|own| own[f]).collect());
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
        let count = self.medium.inside * Self::WIDTH;
        let (mut sum, mut now, mut next) = (vec![0.0; count], z.clone(), z.clone());
        let walls = self.walls(boundary, Self::moments((time, dt)), 0.5 * dt);
        for (s, (at, weight)) in STAGES.into_iter().enumerate() {
            if s > 0 {
                std::mem::swap(&mut now, &mut next);
                self.fill(&mut now, &walls[usize::from(at == 1.0)]);
            }
            look(&now);
            let ahead = STAGES.get(s + 1).map(|(at, _)| at * dt);
            let rates = Rates { flow: self, now: &now, start: &z, weight: weight * dt, ahead };
            rates.run(&mut sum, &mut next[..count]);
        }
        self.fill(&mut next, &walls[1]);
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
        watch: &mut dyn FnMut(f64, Reached<'_, F>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut y = self.packed(first);
        let (times, apart) = self.at_start(time, velocity);
        self.fill(&mut y, &self.walls(boundary, times, apart)[0]);
        for &size in sizes {
            y = self.step(y, (time, size), velocity, boundary, &mut |_| {});
            time += size;
            let state = self.unpacked(&y);
            let fastest = state.fields[..D].iter().flatten().fold(0.0, |most: f64, u| most.max(u.abs()));
            if fastest > 1e3 * velocity || state.fields.iter().flatten().any(|x| !x.is_finite()) {
                return Err(NoSteadyState::Unbounded { time }.into());
            }
            watch(time, (&state).into())?;
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

/// Numbers of a particle's fields, zeros behind them.
pub(super) type Record = [f64; MOST];

/// The first `FIELDS` fields of a particle, four or eight, in vectors of L. (Loops are loops here: closures would stay calls.)
#[derive(Clone, Copy)]
pub(super) struct Vectors<L, const FIELDS: usize>([L; MOST]);

impl<L: Lanes<Real = f64>, const FIELDS: usize> Vectors<L, FIELDS> {
    /// As many are used as there are fields.
    const COUNT: usize = FIELDS / L::COUNT;

    #[inline(always)]
    pub fn zero() -> Self {
        Self([L::zero(); MOST])
    }

    #[inline(always)]
    pub fn load(from: &[f64], place: usize) -> Self {
        let from = &from[place..][..FIELDS];
        // SAFETY: FIELDS numbers are there.
        Self(array(|q| if q < Self::COUNT { unsafe { L::load(from.as_ptr().add(q * L::COUNT)) } } else { L::zero() }))
    }

    #[inline(always)]
    pub fn minus(&self, other: &Self) -> Self {
        Self(array(|q| if q < Self::COUNT { self.0[q] - other.0[q] } else { L::zero() }))
    }

    #[inline(always)]
    pub fn plus(&self, other: &Self) -> Self {
        Self(array(|q| if q < Self::COUNT { self.0[q] + other.0[q] } else { L::zero() }))
    }

    /// Adds a multiple of others.
    #[inline(always)]
    pub fn add(&mut self, factor: f64, other: &Self) {
        for q in 0..Self::COUNT {
            self.0[q] = other.0[q].mul_add(L::splat(factor), self.0[q]);
        }
    }

    /// Adds itself to numbers.
    #[inline(always)]
    pub fn add_to(&self, to: &mut [f64], place: usize) {
        let own = Self::load(to, place);
        let to = &mut to[place..][..FIELDS];
        for q in 0..Self::COUNT {
            // SAFETY: FIELDS numbers are there.
            unsafe { (own.0[q] + self.0[q]).store(to.as_mut_ptr().add(q * L::COUNT)) };
        }
    }

    #[inline(always)]
    pub fn numbers(&self) -> Record {
        let mut numbers = [0.0; MOST];
        for q in 0..Self::COUNT {
            // SAFETY: there are at most MOST.
            unsafe { self.0[q].store(numbers.as_mut_ptr().add(q * L::COUNT)) };
        }
        numbers
    }
}

/// A stage: the rates of particles are added to the sum, and the next stage begins with the start and some of them.
struct Rates<'a, const D: usize, const F: usize, const C: usize> {
    flow: &'a WithSound<'a, D, F, C>,
    now: &'a [f64],
    start: &'a [f64],
    weight: f64,
    /// How far ahead the next stage is; none behind the last one.
    ahead: Option<f64>,
}

impl<const D: usize, const F: usize, const C: usize> Rates<'_, D, F, C> {
    fn run(&self, sum: &mut [f64], next: &mut [f64]) {
        let size = TOGETHER * WithSound::<D, F, C>::WIDTH;
        run_parts(self, sum.chunks_mut(size).zip(next.chunks_mut(size)));
    }

    /// The rates of a particle.
    #[inline(always)]
    fn of<L: Lanes<Real = f64>>(&self, i: usize) -> Record {
        let (flow, fluid) = (self.flow, &self.flow.medium.fluid);
        let own = &self.now[WithSound::<D, F, C>::at(i, 0)..][..F];
        let sums = flow.all_sums::<L>(self.now, i);
        let (diffusion, mut rate) = (flow.diffusion(), [0.0; MOST]);
        for f in 0..F {
            rate[f] = diffusion[f] * sums[D][f];
            for d in 0..D {
                rate[f] -= own[d] * sums[d][f];
            }
        }
        let mut divergence = 0.0;
        for e in 0..D {
            divergence += sums[e][e];
            rate[e] += fluid.force[e] - sums[e][D];
            if let Some(buoyancy) = fluid.buoyancy {
                rate[e] += buoyancy.by[e] * (own[D + 1] - buoyancy.at);
            }
        }
        rate[D] = flow.damping[i] * sums[D + 1][D] - flow.medium.sound * flow.medium.sound * divergence;
        rate
    }
}

impl<'a, const D: usize, const F: usize, const C: usize> PartKernel<f64> for Rates<'a, D, F, C> {
    /// The sum and the next stage, `[particles, WIDTH]`.
    type Part = (&'a mut [f64], &'a mut [f64]);
    const MOST_LANES: usize = FOUR;

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, number: usize, (sum, next): &mut Self::Part) {
        let width = WithSound::<D, F, C>::WIDTH;
        let all = sum.chunks_exact_mut(width).zip(next.chunks_exact_mut(width)).enumerate();
        for (k, (sum, next)) in all {
            let i = number * TOGETHER + k;
            let rate = self.of::<L>(i);
            let start = &self.start[i * width..][..width];
            for f in 0..width {
                sum[f] += self.weight * rate[f];
                next[f] = start[f] + self.ahead.map_or(sum[f], |ahead| ahead * rate[f]);
            }
        }
    }
}

/// The sums of points of the boundary.
struct SumsOfPoints<'a, const D: usize, const F: usize, const C: usize> {
    flow: &'a WithSound<'a, D, F, C>,
    y: &'a [f64],
}

impl<'a, const D: usize, const F: usize, const C: usize> PartKernel<f64> for SumsOfPoints<'a, D, F, C> {
    type Part = &'a mut [[Record; F]];
    const MOST_LANES: usize = FOUR;

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, number: usize, part: &mut Self::Part) {
        for (k, sums) in part.iter_mut().enumerate() {
            *sums = self.flow.all_sums::<L>(self.y, self.flow.medium.inside + number * TOGETHER + k);
        }
    }
}
