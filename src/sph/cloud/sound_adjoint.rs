//! The exact derivative of figures of a flow with sound, see [`super::sound`], by positions and by what walls do.
//!
//! A stage's rates are products of fields and sums over pairs, so with the cotangents of rates those of fields and coefficients are the
//! same sums transposed. What the boundary's points are follows from A x = b(y) with the cotangent x_bar of x by
//!
//! ```text
//!   A^T mu = x_bar,   b_bar = mu,   A_bar = -mu x^T.
//! ```
//!
//! The states of all stages are kept where they have room in the memory given; else those at the beginnings of segments of steps, within
//! each of which stages are made again, but for the last one. Where not even that has room, states of steps are made again within segments,
//! and stages within each step.

use super::equations::{Bar, BoundaryBar, Motion, State, Warmth};
use super::fit_adjoint::PairCotangents;
use super::sound::{Record, Vectors, Walls, WithSound, FOUR, MOST, STAGES};
use super::unsteady::{InTime, Reached};
use super::unsteady_adjoint::{segments, Cotangents};
use crate::numerics::lanes::{array, Lanes};
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::quadratic;
use std::ops::Range;

/// A flow whose steps have been taken.
pub struct Heard<'a, const D: usize, const F: usize, const C: usize> {
    pub boundary: &'a dyn InTime<D, F, C>,
    /// When it begins, and with what.
    pub first: (f64, &'a State<F>),
    pub sizes: &'a [f64],
    /// Bytes for states.
    pub memory: usize,
    /// The velocity that parts of steps were chosen for.
    pub velocity: f64,
    /// Whether positions move with the numbers that are wanted.
    pub by_positions: bool,
}

/// Times are one if they are no further apart, in parts of steps: they differ by rounding.
const NEAR: f64 = 1e-6;

/// What is known while steps are gone through backwards.
struct Found<const D: usize, const F: usize, const C: usize> {
    /// Of the coefficients of pairs, in the order of the flow's table; empty if positions do not matter.
    pairs: Vec<f64>,
    all: Cotangents<D, F, C>,
    /// Of a moment.
    bar: Bar<D, F, C>,
    /// Those of the part of a step that was gone through last: the part before it looks at some of them, too.
    moments: Vec<Moment<D>>,
}

/// A time, and the cotangents of what holds on the boundary then.
type Moment<const D: usize> = (f64, Vec<BoundaryBar<D>>);

/// Cotangents of the sums of each field at a particle: `[sum][field]`.
type Weights<const F: usize> = [Record; F];

impl<const D: usize, const F: usize, const C: usize> WithSound<'_, D, F, C> {
    /// Adds what sums at particle i make of fields and of coefficients, given their cotangents.
    fn spread(&self, y: &[f64], i: usize, weights: &Weights<F>, y_bar: &mut [f64], pairs: &mut [f64]) {
        // Most often the sums of one field alone have any.
        for f in (0..self.fields()).filter(|&f| weights.iter().any(|of| of[f] != 0.0)) {
            let (own, mut own_bar) = (Self::at(i, f), 0.0);
            for pair in self.pairs(i) {
                let other = Self::at(self.list[pair] as usize, f);
                let along: f64 = weights.iter().zip(self.pair(pair)).map(|(weight, c)| weight[f] * c).sum();
                y_bar[other] += along;
                own_bar += along;
                if !pairs.is_empty() {
                    let difference = y[other] - y[own];
                    (0..F).for_each(|a| pairs[pair * F + a] += weights[a][f] * difference);
                }
            }
            y_bar[own] -= own_bar;
        }
    }

    /// Adds what the rates of particles inside make of a stage's fields, given their cotangents `rate_bar`, in the fields' order.
    fn rates_back(&self, y: &[f64], rate_bar: &[f64], y_bar: &mut [f64], found: &mut Found<D, F, C>) {
        let count = self.medium.inside;
        let share = count.div_ceil(PARTS);
        let mut rest = found.pairs.as_mut_slice();
        let (mut parts, mut tables) = (vec![], vec![]);
        for number in 0..PARTS {
            let (from, to) = ((number * share).min(count), ((number + 1) * share).min(count));
            let size = if rest.is_empty() { 0 } else { (self.first[to] - self.first[from]) * F };
            let (pairs, others) = rest.split_at_mut(size);
            rest = others;
            tables.push(pairs);
            parts.push(Part { particles: from..to, y_bar: vec![0.0; y_bar.len()], viscosity: 0.0 });
        }
        run_parts(&RatesBack { flow: self, y, rate_bar }, parts.iter_mut().zip(tables));
        for part in parts {
            y_bar.iter_mut().zip(part.y_bar).for_each(|(to, from)| *to += from);
            found.all.bar.viscosity += part.viscosity;
        }
    }

    /// Turns the cotangents of filled fields into those of the fields inside, and adds those of what walls do before, at and after that
    /// time. `apart`: by what velocities of walls before and after are divided in their acceleration; none if they do not change.
    fn fill_back(
        &self,
        y: &[f64],
        walls: &Walls<'_, D>,
        ([before, now, after], apart): ([&mut Vec<BoundaryBar<D>>; 3], Option<f64>),
        y_bar: &mut [f64],
        found: &mut Found<D, F, C>,
    ) {
        let (medium, inside) = (&self.medium, self.medium.inside);
        let points = medium.conditions.len();
        let others = self.has_heat().then_some(D + 1).into_iter().chain(0..D);
        for f in [D].into_iter().chain(others) {
            let edge = &self.edges[f];
            let own = (0..points).map(|k| y_bar[Self::at(inside + k, f)]).collect();
            let mu = edge.solve(own, true);
            let sums = if f == D { self.sums_of_points(y) } else { vec![] };
            let mut outlet = 0.0;
            for (k, mu) in mu.into_iter().enumerate() {
                let (i, condition) = (inside + k, &walls.conditions[k]);
                let Some(row) = edge.rows[k] else {
                    match (condition.motion, condition.warmth) {
                        (Motion::Given(_), _) if f < D => now[k].velocity[f] += mu,
                        (_, Warmth::Given(_)) if f > D => now[k].temperature += mu,
                        _ => outlet += mu,
                    }
                    continue;
                };
                let mut weights: Weights<F> = [[0.0; MOST]; F];
                (0..F).for_each(|a| weights[a][f] -= mu * row[a]);
                if f >= D {
                    let own = self.sums_at_point(&sums, y, k, f);
                    (0..D).for_each(|d| now[k].normal[d] -= mu * own[d]);
                }
                match condition.warmth {
                    Warmth::Flux(_) if f > D => {
                        now[k].temperature -= mu / medium.fluid.diffusivity.unwrap_or(1.0);
                    }
                    _ => {}
                }
                if f == D {
                    let of = &sums[k];
                    let unbalanced = self.unbalanced(y, i, of, walls.acceleration[k]);
                    for e in 0..D {
                        let rho = mu * condition.normal[e];
                        now[k].normal[e] += mu * unbalanced[e];
                        found.all.bar.viscosity += of[D][e] * rho;
                        weights[D][e] += medium.fluid.viscosity * rho;
                        if let Some(apart) = apart {
                            before[k].velocity[e] += rho / apart;
                            after[k].velocity[e] -= rho / apart;
                        }
                        for d in 0..D {
                            weights[d][e] -= y[Self::at(i, d)] * rho;
                            y_bar[Self::at(i, d)] -= of[d][e] * rho;
                        }
                        if let Some(buoyancy) = medium.fluid.buoyancy {
                            y_bar[Self::at(i, D + 1)] += buoyancy.by[e] * rho;
                        }
                    }
                }
                self.spread(y, i, &weights, y_bar, &mut found.pairs);
            }
            // What the points of the boundary are of each other is in the solution.
            (0..points).for_each(|k| y_bar[Self::at(inside + k, f)] = 0.0);
            for (k, share) in self.shares.iter().enumerate().filter(|_| f == D) {
                let (condition, rho) = (&walls.conditions[k], -medium.sound * share * outlet);
                let bar = &mut now[k];
                for e in 0..D {
                    match condition.motion {
                        Motion::Given(given) => {
                            bar.velocity[e] += rho * condition.normal[e];
                            bar.normal[e] += rho * given[e];
                        }
                        Motion::Outflow(_) => y_bar[Self::at(inside + k, e)] += rho * condition.normal[e],
                        Motion::Symmetry(_) => {}
                    }
                }
            }
        }
        self.centre(y_bar);
    }

    /// The moments at times a part of a step `dt` apart: what the part behind it made of them, or no cotangents. What is at no such time is
    /// complete, and is gathered.
    fn moments_at<const N: usize>(
        &self,
        boundary: &dyn InTime<D, F, C>,
        (times, dt): ([f64; N], f64),
        found: &mut Found<D, F, C>,
    ) -> [Moment<D>; N] {
        let none = || vec![BoundaryBar::default(); self.medium.conditions.len()];
        let moments = times.map(|time| {
            let is_it = |(at, _): &Moment<D>| (at - time).abs() < NEAR * dt;
            let known = found.moments.iter().position(is_it);
            known.map_or_else(|| (time, none()), |k| found.moments.swap_remove(k))
        });
        self.gather_all(boundary, found);
        moments
    }

    /// Adds what all moments say of walls.
    fn gather_all(&self, boundary: &dyn InTime<D, F, C>, found: &mut Found<D, F, C>) {
        for (time, bar) in std::mem::take(&mut found.moments) {
            found.bar.boundary = bar;
            self.gather(boundary, time, found);
        }
    }

    /// Adds what a moment's bar says of walls, and forgets it.
    fn gather(&self, boundary: &dyn InTime<D, F, C>, time: f64, found: &mut Found<D, F, C>) {
        if boundary.changes() {
            let Found { all: Cotangents { position, parameters, .. }, bar, .. } = found;
            boundary.pull_back(time, bar, position, parameters);
        }
        found.all.bar.add_walls(&found.bar);
        found.bar.boundary.fill(Default::default());
    }

    /// The cotangents of the filled fields before a part of a step, given those after it, and the filled fields of its stages and its
    /// end.
    fn advance_back(
        &self,
        states: &[Vec<f64>],
        (time, dt): (f64, f64),
        boundary: &dyn InTime<D, F, C>,
        mut after: Vec<f64>,
        found: &mut Found<D, F, C>,
    ) -> Vec<f64> {
        let times = Self::moments((time, dt));
        let walls = self.walls(boundary, times, 0.5 * dt);
        let apart = boundary.changes().then_some(dt);
        // What holds at a time is gathered once, for all stages of this part and of those beside it.
        let mut moments = self.moments_at(boundary, (times, dt), found);
        let [a, b, c, d] = moments.each_mut().map(|(_, bar)| bar);
        self.fill_back(&states[STAGES.len()], &walls[1], ([b, c, d], apart), &mut after, found);
        let count = self.medium.inside * Self::WIDTH;
        // z+ = z + sum of weighted rates; behind the last stage no other begins with its rates.
        let mut before = after.clone();
        let mut of_next: Option<(f64, Vec<f64>)> = None;
        for (s, (at, weight)) in STAGES.into_iter().enumerate().rev() {
            let mut rate_bar: Vec<f64> = after[..count].iter().map(|bar| weight * dt * bar).collect();
            if let Some((ahead, next)) = &of_next {
                rate_bar.iter_mut().zip(next).for_each(|(to, from)| *to += ahead * from);
            }
            let mut own = vec![0.0; after.len()];
            self.rates_back(&states[s], &rate_bar, &mut own, found);
            if s > 0 {
                let (walls, bars) = if at < 1.0 {
                    (&walls[0], [&mut *a, &mut *b, &mut *c])
                } else {
                    (&walls[1], [&mut *b, &mut *c, &mut *d])
                };
                self.fill_back(&states[s], walls, (bars, apart), &mut own, found);
            }
            before.iter_mut().zip(&own).for_each(|(to, from)| *to += from);
            of_next = Some((at * dt, own));
        }
        found.moments = moments.into();
        before
    }
}

impl<const D: usize, const F: usize, const C: usize> Heard<'_, D, F, C> {
    /// Cotangents of a sum of figures: `figures` adds those of the moment after step k to a bar. Those of the first state are of particles
    /// inside.
    pub fn pull_back(
        &self,
        flow: &WithSound<'_, D, F, C>,
        figures: &mut dyn FnMut(usize, Reached<'_, F>, &mut Bar<D, F, C>),
        parameters: usize,
    ) -> Cotangents<D, F, C> {
        let medium = &flow.medium;
        let stencils = &medium.fits.all;
        let (n, points, steps) = (stencils.particles, medium.conditions.len(), self.sizes.len());
        let mut times = vec![self.first.0];
        self.sizes.iter().for_each(|size| times.push(times[times.len() - 1] + size));
        let mut found = Found {
            pairs: if self.by_positions { vec![0.0; flow.table.len()] } else { vec![] },
            all: Cotangents {
                bar: Bar::new(n, points),
                position: std::array::from_fn(|_| vec![0.0; n]),
                parameters: vec![0.0; parameters],
                start: std::array::from_fn(|_| vec![]),
            },
            bar: Bar::new(n, points),
            moments: vec![],
        };
        let mut of_figures = PairCotangents::zeros(stencils);
        // Keeps the filled fields of all stages, if it is asked to.
        let go = |mut y: Vec<f64>, (from, to): (usize, usize), stages: &mut Vec<Vec<f64>>, keep: bool| {
            for k in from..to {
                let mut look = |y: &[f64]| {
                    if keep {
                        stages.push(y.to_vec());
                    }
                };
                y = flow.step(y, (times[k], self.sizes[k]), self.velocity, self.boundary, &mut look);
            }
            y
        };
        let (at_start, apart) = flow.at_start(times[0], self.velocity);
        let mut y = flow.packed(self.first.1);
        let walls = &flow.walls(self.boundary, at_start, apart)[0];
        flow.fill(&mut y, walls);
        let filled_first = y.clone();
        let parts: Vec<usize> = self.sizes.iter().map(|&size| flow.parts(size, self.velocity)).collect();
        let most_parts = parts.iter().copied().max().unwrap_or(1);
        let (most, of_step) = (self.memory / size_of_val(y.as_slice()), STAGES.len() * most_parts);
        // Whether stages of whole segments have room.
        let at_once = (most * most) as f64 >= 4.0 * (steps * of_step) as f64;
        let segments = segments(steps, most, 1, if at_once { of_step } else { 1 });
        // The states that segments begin with, and those of all stages of the last one.
        let (mut starts, mut stages) = (vec![], vec![]);
        for (k, &segment) in segments.iter().enumerate() {
            starts.push(y.clone());
            y = go(y, segment, &mut stages, at_once && k + 1 == segments.len());
        }
        stages.extend(at_once.then_some(y));
        let mut y_bar = vec![0.0; filled_first.len()];
        for (&(from, to), start) in segments.iter().zip(starts).rev() {
            // Steps whose stages are kept together, and the states that these begin with.
            let spans = if at_once { vec![(from, to)] } else { (from..to).map(|k| (k, k + 1)).collect() };
            let mut begins = vec![start];
            for &span in &spans[1..] {
                let begin = begins[begins.len() - 1].clone();
                begins.push(go(begin, (span.0 - 1, span.0), &mut stages, false));
            }
            for ((from, to), begin) in spans.into_iter().zip(begins).rev() {
                if stages.is_empty() {
                    let end = go(begin, (from, to), &mut stages, true);
                    stages.push(end);
                }
                for k in (from..to).rev() {
                    let end = stages.len() - 1;
                    self.add_figures(flow, (k, &stages[end]), figures, &mut y_bar, &mut of_figures, &mut found);
                    let dt = self.sizes[k] / parts[k] as f64;
                    for part in (0..parts[k]).rev() {
                        let time = times[k] + part as f64 * dt;
                        let first = stages.len() - 1 - STAGES.len();
                        y_bar = flow.advance_back(&stages[first..], (time, dt), self.boundary, y_bar, &mut found);
                        stages.truncate(first + 1);
                    }
                }
                stages.clear();
            }
        }
        let mut moments = flow.moments_at(self.boundary, (at_start, apart), &mut found);
        let apart = self.boundary.changes().then_some(2.0 * apart);
        let around = moments.each_mut().map(|(_, bar)| bar);
        flow.fill_back(&filled_first, walls, (around, apart), &mut y_bar, &mut found);
        found.moments = moments.into();
        flow.gather_all(self.boundary, &mut found);
        let Found { pairs, mut all, .. } = found;
        all.start = flow.unpacked(&y_bar).fields;
        // The Laplacian is a sum of second derivatives.
        let second = (0..D).map(|a| (quadratic(D, a, a), D));
        let of_sums: Vec<(usize, usize)> = (0..D).map(|d| (d, d)).chain(second).chain([(C - 1, D + 1)]).collect();
        let particles = if self.by_positions { n } else { 0 };
        for i in 0..particles {
            for (k, pair) in flow.pairs(i).enumerate() {
                for &(c, from) in &of_sums {
                    *of_figures.of_pair(stencils, (i, k), c) += pairs[pair * F + from];
                }
            }
        }
        (medium.by_pairs)(&medium.fits, medium.position, of_figures, &mut all.position);
        if !self.boundary.changes() {
            let Cotangents { bar, position, parameters, .. } = &mut all;
            self.boundary.pull_back(0.0, bar, position, parameters);
        }
        all
    }

    /// Adds the cotangents of the figures of a moment.
    fn add_figures(
        &self,
        flow: &WithSound<'_, D, F, C>,
        (k, y): (usize, &[f64]),
        figures: &mut dyn FnMut(usize, Reached<'_, F>, &mut Bar<D, F, C>),
        y_bar: &mut [f64],
        pairs: &mut PairCotangents<C>,
        found: &mut Found<D, F, C>,
    ) {
        let (medium, state) = (&flow.medium, flow.unpacked(y));
        found.bar.clear();
        figures(k, (&state).into(), &mut found.bar);
        let fields = flow.fields();
        for f in 0..fields {
            let mut own = found.bar.fields[f].clone();
            medium.operators.pull_back(&medium.fits.all, &found.bar.derivatives.0[f], &mut own);
            own.iter().enumerate().for_each(|(i, bar)| y_bar[WithSound::<D, F, C>::at(i, f)] += bar);
        }
        let all: Vec<&[f64]> = state.fields[..fields].iter().map(Vec::as_slice).collect();
        pairs.add(&medium.fits.all, &all, &found.bar.derivatives.0[..fields]);
        for (to, from) in found.all.position.iter_mut().zip(&found.bar.position) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        found.all.bar.add_of_whole_flow(&found.bar);
        let time = self.first.0 + self.sizes[..=k].iter().sum::<f64>();
        flow.gather(self.boundary, time, found);
    }
}

/// Parts of the particles whose sums are apart from each other, for any number of threads.
const PARTS: usize = 4;

/// What some particles make of all.
struct Part {
    particles: Range<usize>,
    y_bar: Vec<f64>,
    viscosity: f64,
}

/// The transposed rates of particles.
struct RatesBack<'a, const D: usize, const F: usize, const C: usize> {
    flow: &'a WithSound<'a, D, F, C>,
    y: &'a [f64],
    rate_bar: &'a [f64],
}

impl<const D: usize, const F: usize, const C: usize> RatesBack<'_, D, F, C> {
    /// A particle's fields, and the cotangents of its rates.
    #[inline(always)]
    fn own(&self, i: usize) -> (&[f64], &[f64]) {
        let at = WithSound::<D, F, C>::at(i, 0);
        (&self.y[at..][..F], &self.rate_bar[at..][..F])
    }

    /// The cotangents of the sums of a particle.
    #[inline(always)]
    fn weights(&self, i: usize) -> Weights<F> {
        let (flow, (own, rho)) = (self.flow, self.own(i));
        let diffusion = flow.diffusion();
        let mut weights: Weights<F> = [[0.0; MOST]; F];
        for f in 0..F {
            if f == D {
                continue;
            }
            weights[D][f] = diffusion[f] * rho[f];
            for d in 0..D {
                weights[d][f] = -own[d] * rho[f];
            }
        }
        for e in 0..D {
            weights[e][D] = -rho[e];
            weights[e][e] -= flow.medium.sound * flow.medium.sound * rho[D];
        }
        weights[D + 1][D] = flow.damping[i] * rho[D];
        weights
    }

    /// The cotangents of a particle's own fields, and what its rates make of that of the viscosity, given its sums.
    #[inline(always)]
    fn own_bar(&self, i: usize, sums: &[Record; F]) -> (Record, f64) {
        let (_, rho) = self.own(i);
        let (mut own_bar, mut viscosity) = ([0.0; MOST], 0.0);
        for d in 0..D {
            for f in 0..F {
                if f != D {
                    own_bar[d] -= sums[d][f] * rho[f];
                }
            }
        }
        for e in 0..D {
            viscosity += sums[D][e] * rho[e];
            if let Some(buoyancy) = self.flow.medium.fluid.buoyancy {
                own_bar[D + 1] += buoyancy.by[e] * rho[e];
            }
        }
        (own_bar, viscosity)
    }

    /// `SUMS`: F, rounded up to whole vectors.
    #[inline(always)]
    fn of<L: Lanes<Real = f64>, const FIELDS: usize, const SUMS: usize>(&self, part: &mut Part, pairs: &mut [f64]) {
        let (flow, at) = (self.flow, WithSound::<D, F, C>::at);
        let start = flow.first[part.particles.start];
        for i in part.particles.clone() {
            let weights = self.weights(i);
            let by_sum: [Vectors<L, FIELDS>; F] = array(|a| Vectors::load(&weights[a], 0));
            // What the cotangents of a pair's coefficients get of each field's difference.
            let by_field: [Vectors<L, SUMS>; F] =
                array(|f| Vectors::load(&array::<f64, SUMS>(|a| if a < F { weights[a][f] } else { 0.0 }), 0));
            let own = Vectors::<L, FIELDS>::load(self.y, at(i, 0));
            let mut sums = [Vectors::<L, FIELDS>::zero(); F];
            let mut total = Vectors::<L, FIELDS>::zero();
            for pair in flow.pairs(i) {
                let (other, c) = (at(flow.list[pair] as usize, 0), flow.pair(pair));
                let difference = Vectors::load(self.y, other).minus(&own);
                let mut along = Vectors::<L, FIELDS>::zero();
                for a in 0..F {
                    sums[a].add(c[a], &difference);
                    along.add(c[a], &by_sum[a]);
                }
                along.add_to(&mut part.y_bar, other);
                total = total.minus(&along);
                if !pairs.is_empty() {
                    let mut c_bar = Vectors::<L, SUMS>::zero();
                    for f in 0..F.min(FIELDS) {
                        c_bar.add(self.y[other + f] - self.y[at(i, f)], &by_field[f]);
                    }
                    let (to, more) = (&mut pairs[(pair - start) * F..][..F], c_bar.numbers());
                    for a in 0..F {
                        to[a] += more[a];
                    }
                }
            }
            let (own_bar, viscosity) = self.own_bar(i, &array(|a| sums[a].numbers()));
            part.viscosity += viscosity;
            total.plus(&Vectors::load(&own_bar, 0)).add_to(&mut part.y_bar, at(i, 0));
        }
    }
}

impl<'a, const D: usize, const F: usize, const C: usize> PartKernel<f64> for RatesBack<'a, D, F, C> {
    /// And the cotangents of the particles' own pairs, or nothing.
    type Part = (&'a mut Part, &'a mut [f64]);
    const MOST_LANES: usize = FOUR;

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, _: usize, (part, pairs): &mut Self::Part) {
        match self.flow.has_few() {
            true if F <= FOUR => self.of::<L, FOUR, FOUR>(part, pairs),
            true => self.of::<L, FOUR, MOST>(part, pairs),
            false => self.of::<L, MOST, MOST>(part, pairs),
        }
    }
}
