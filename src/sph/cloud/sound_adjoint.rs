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

use super::equations::{Bar, Motion, State, Warmth};
use super::fit::{blocks, field};
use super::fit_adjoint::PairCotangents;
use super::sound::{Walls, WithSound, STAGES, START};
use super::unsteady::InTime;
use super::unsteady_adjoint::{segments, Cotangents};
use crate::numerics::lanes::{Lanes, WIDEST};
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

/// What is known while steps are gone through backwards.
struct Found<const D: usize, const F: usize, const C: usize> {
    /// Of the coefficients of pairs, in the order of the flow's table; empty if positions do not matter.
    pairs: Vec<f64>,
    all: Cotangents<D, F, C>,
    /// Of a moment.
    bar: Bar<D, F, C>,
}

/// Cotangents of the sums of each field at a particle: `[field][sum]`.
type Weights<const F: usize> = [[f64; F]; F];

impl<const D: usize, const F: usize, const C: usize> WithSound<'_, D, F, C> {
    /// Adds what sums at particle i make of fields and of coefficients, given their cotangents.
    fn spread(&self, y: &[f64], i: usize, weights: &Weights<F>, y_bar: &mut [f64], pairs: &mut [f64]) {
        let stencils = &self.medium.fits.all;
        let fields = if self.has_heat() { F } else { F - 1 };
        let mut own_bar = [0.0; F];
        for k in 0..stencils.count(i) {
            let (begin, c) = (self.begin(i, k), self.pair(i, k));
            let mut c_bar = [0.0; F];
            for f in 0..fields {
                let along: f64 = weights[f].iter().zip(&c).map(|(weight, c)| weight * c).sum();
                y_bar[begin + f * WIDEST] += along;
                own_bar[f] += along;
                if !pairs.is_empty() {
                    let difference = y[begin + f * WIDEST] - y[field(F, i, f)];
                    (0..F).for_each(|a| c_bar[a] += weights[f][a] * difference);
                }
            }
            if !pairs.is_empty() {
                let first = stencils.row(i, k) * F * WIDEST + i % WIDEST;
                (0..F).for_each(|a| pairs[first + a * WIDEST] += c_bar[a]);
            }
        }
        (0..fields).for_each(|f| y_bar[field(F, i, f)] -= own_bar[f]);
    }

    /// Adds what the rates of particles inside make of a stage's fields, given their cotangents `rate_bar`, in the fields' order.
    fn rates_back(&self, y: &[f64], rate_bar: &[f64], y_bar: &mut [f64], found: &mut Found<D, F, C>) {
        let stencils = &self.medium.fits.all;
        let count = blocks(self.medium.inside);
        let share = count.div_ceil(PARTS);
        let mut rest = found.pairs.as_mut_slice();
        let (mut parts, mut tables) = (vec![], vec![]);
        for number in 0..PARTS {
            let (from, to) = ((number * share).min(count), ((number + 1) * share).min(count));
            let rows = if to > from {
                stencils.row(to * WIDEST - 1, 0) + stencils.count(to * WIDEST - 1) - stencils.row(from * WIDEST, 0)
            } else {
                0
            };
            let size = if rest.is_empty() { 0 } else { rows * F * WIDEST };
            let (pairs, others) = rest.split_at_mut(size);
            rest = others;
            tables.push(pairs);
            parts.push(Part { blocks: from..to, y_bar: vec![0.0; y_bar.len()], viscosity: 0.0 });
        }
        run_parts(&RatesBack { flow: self, y, rate_bar }, parts.iter_mut().zip(tables));
        for part in parts {
            y_bar.iter_mut().zip(part.y_bar).for_each(|(to, from)| *to += from);
            found.all.bar.viscosity += part.viscosity;
        }
    }

    /// Turns the cotangents of filled fields into those of the fields inside.
    fn fill_back(
        &self,
        y: &[f64],
        (time, step): (f64, f64),
        (boundary, walls): (&dyn InTime<D, F, C>, &Walls<'_, D>),
        y_bar: &mut [f64],
        found: &mut Found<D, F, C>,
    ) {
        let (medium, inside) = (&self.medium, self.medium.inside);
        let points = medium.conditions.len();
        let mut acceleration_bar = vec![[0.0; D]; points];
        let before = self.has_heat().then_some(D + 1).into_iter().chain(0..D);
        for f in [D].into_iter().chain(before) {
            let edge = &self.edges[f];
            let own = (0..points).map(|k| y_bar[field(F, inside + k, f)]).collect();
            let mu = edge.solve(own, true);
            let mut outlet = 0.0;
            for (k, mu) in mu.into_iter().enumerate() {
                let (i, condition) = (inside + k, &walls.conditions[k]);
                let Some(row) = edge.rows[k] else {
                    match (condition.motion, condition.warmth) {
                        (Motion::Given(_), _) if f < D => found.bar.boundary[k].velocity[f] += mu,
                        (_, Warmth::Given(_)) if f > D => found.bar.boundary[k].temperature += mu,
                        _ => outlet += mu,
                    }
                    continue;
                };
                let mut weights: Weights<F> = [[0.0; F]; F];
                (0..F).for_each(|a| weights[f][a] -= mu * row[a]);
                if f >= D {
                    let sums = self.sums(y, i, f);
                    (0..D).for_each(|d| found.bar.boundary[k].normal[d] -= mu * sums[d]);
                }
                match condition.warmth {
                    Warmth::Flux(_) if f > D => {
                        found.bar.boundary[k].temperature -= mu / medium.fluid.diffusivity.unwrap_or(1.0);
                    }
                    _ => {}
                }
                if f == D {
                    let of: [[f64; F]; D] = std::array::from_fn(|e| self.sums(y, i, e));
                    let unbalanced = self.unbalanced(y, i, &of, walls.acceleration[k]);
                    for e in 0..D {
                        let rho = mu * condition.normal[e];
                        found.bar.boundary[k].normal[e] += mu * unbalanced[e];
                        found.all.bar.viscosity += of[e][D] * rho;
                        weights[e][D] += medium.fluid.viscosity * rho;
                        acceleration_bar[k][e] -= rho;
                        for d in 0..D {
                            weights[e][d] -= y[field(F, i, d)] * rho;
                            y_bar[field(F, i, d)] -= of[e][d] * rho;
                        }
                        if let Some(buoyancy) = medium.fluid.buoyancy {
                            y_bar[field(F, i, D + 1)] += buoyancy.by[e] * rho;
                        }
                    }
                }
                self.spread(y, i, &weights, y_bar, &mut found.pairs);
            }
            // What the points of the boundary are of each other is in the solution.
            (0..points).for_each(|k| y_bar[field(F, inside + k, f)] = 0.0);
            for (k, share) in self.shares.iter().enumerate().filter(|_| f == D) {
                let (condition, rho) = (&walls.conditions[k], -medium.sound * share * outlet);
                let bar = &mut found.bar.boundary[k];
                for e in 0..D {
                    match condition.motion {
                        Motion::Given(given) => {
                            bar.velocity[e] += rho * condition.normal[e];
                            bar.normal[e] += rho * given[e];
                        }
                        Motion::Outflow(_) => y_bar[field(F, inside + k, e)] += rho * condition.normal[e],
                        Motion::Symmetry(_) => {}
                    }
                }
            }
        }
        self.centre(y_bar);
        self.gather(boundary, time, found);
        if boundary.changes() {
            for sign in [1.0, -1.0] {
                for (to, from) in found.bar.boundary.iter_mut().zip(&acceleration_bar) {
                    (0..D).for_each(|e| to.velocity[e] = sign * from[e] / (2.0 * step));
                }
                self.gather_changing(boundary, time + sign * step, found);
                found.bar.boundary.fill(Default::default());
            }
        }
    }

    fn gather_changing(&self, boundary: &dyn InTime<D, F, C>, time: f64, found: &mut Found<D, F, C>) {
        let Found { all: Cotangents { position, parameters, .. }, bar, .. } = found;
        boundary.pull_back(time, bar, position, parameters);
    }

    /// Adds what a moment's bar says of walls, and forgets it.
    fn gather(&self, boundary: &dyn InTime<D, F, C>, time: f64, found: &mut Found<D, F, C>) {
        if boundary.changes() {
            self.gather_changing(boundary, time, found);
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
        let step = 0.5 * dt;
        let [middle, end] = self.walls_of_part(boundary, (time, dt));
        self.fill_back(&states[STAGES.len()], (time + dt, step), (boundary, &end), &mut after, found);
        let count = blocks(self.medium.inside) * F * WIDEST;
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
                let walls = if at < 1.0 { &middle } else { &end };
                self.fill_back(&states[s], (time + at * dt, step), (boundary, walls), &mut own, found);
            }
            before.iter_mut().zip(&own).for_each(|(to, from)| *to += from);
            of_next = Some((at * dt, own));
        }
        before
    }
}

impl<const D: usize, const F: usize, const C: usize> Heard<'_, D, F, C> {
    /// Cotangents of a sum of figures: `figures` adds those of the moment after step k to a bar. Those of the first state are of particles
    /// inside.
    pub fn pull_back(
        &self,
        flow: &WithSound<'_, D, F, C>,
        figures: &mut dyn FnMut(usize, &State<F>, &mut Bar<D, F, C>),
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
        let at_start = (times[0], START * flow.largest_step(self.velocity));
        let mut y = flow.packed(self.first.1);
        let walls = flow.walls(self.boundary, at_start.0, at_start.1);
        flow.fill(&mut y, &walls);
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
        flow.fill_back(&filled_first, at_start, (self.boundary, &walls), &mut y_bar, &mut found);
        let Found { pairs, mut all, .. } = found;
        all.start = flow.unpacked(&y_bar).fields;
        // The Laplacian is a sum of second derivatives.
        for (row, of) in pairs.chunks_exact(F * WIDEST).enumerate() {
            let second = (0..D).map(|a| (quadratic(D, a, a), D));
            for (c, from) in (0..D).map(|d| (d, d)).chain(second).chain([(C - 1, D + 1)]) {
                of_figures.add_row(row, c, &of[from * WIDEST..][..WIDEST]);
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
        figures: &mut dyn FnMut(usize, &State<F>, &mut Bar<D, F, C>),
        y_bar: &mut [f64],
        pairs: &mut PairCotangents<C>,
        found: &mut Found<D, F, C>,
    ) {
        let (medium, state) = (&flow.medium, flow.unpacked(y));
        found.bar.clear();
        figures(k, &state, &mut found.bar);
        let fields = if flow.has_heat() { F } else { F - 1 };
        for f in 0..fields {
            let mut own = found.bar.fields[f].clone();
            medium.operators.pull_back(&medium.fits.all, &found.bar.derivatives.0[f], &mut own);
            own.iter().enumerate().for_each(|(i, bar)| y_bar[field(F, i, f)] += bar);
        }
        let all: Vec<&[f64]> = state.fields[..fields].iter().map(Vec::as_slice).collect();
        pairs.add(&medium.fits.all, &all, &found.bar.derivatives.0[..fields]);
        for (to, from) in found.all.position.iter_mut().zip(&found.bar.position) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        found.all.bar.volume += found.bar.volume;
        found.all.bar.viscosity += found.bar.viscosity;
        found.all.bar.numbers.extend(&found.bar.numbers);
        let time = self.first.0 + self.sizes[..=k].iter().sum::<f64>();
        flow.gather(self.boundary, time, found);
    }
}

/// Parts of the particles whose sums are apart from each other, for any number of threads.
const PARTS: usize = 4;

/// What some blocks of particles make of all.
struct Part {
    blocks: Range<usize>,
    y_bar: Vec<f64>,
    viscosity: f64,
}

/// The transposed rates of blocks.
struct RatesBack<'a, const D: usize, const F: usize, const C: usize> {
    flow: &'a WithSound<'a, D, F, C>,
    y: &'a [f64],
    rate_bar: &'a [f64],
}

impl<'a, const D: usize, const F: usize, const C: usize> PartKernel<f64> for RatesBack<'a, D, F, C> {
    /// And the cotangents of the blocks' own pairs, or nothing.
    type Part = (&'a mut Part, &'a mut [f64]);

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, _: usize, (part, pairs): &mut Self::Part) {
        let WithSound { medium, table, list, damping, .. } = self.flow;
        let (stencils, y) = (&medium.fits.all, self.y);
        let fields = if medium.fluid.diffusivity.is_some() { F } else { F - 1 };
        let start = stencils.row(part.blocks.start * WIDEST, 0);
        for block in part.blocks.clone() {
            let (first, count) = (stencils.row(block * WIDEST, 0), stencils.count(block * WIDEST));
            for l in (0..WIDEST).step_by(L::COUNT) {
                let at = |f: usize| (block * F + f) * WIDEST + l;
                let (mut own, mut rho) = ([L::zero(); F], [L::zero(); F]);
                for f in 0..F {
                    own[f] = L::load_part(&y[at(f)..]);
                    rho[f] = L::load_part(&self.rate_bar[at(f)..]);
                }
                let difference = |k: usize, f: usize| {
                    // SAFETY: the list names where fields of particles begin, and each has F of them.
                    unsafe { L::gather(y.as_ptr().add(f * WIDEST), list.as_ptr().add(k * WIDEST + l)) - own[f] }
                };
                let coefficient = |k: usize, a: usize| L::load_part(&table[(k * F + a) * WIDEST + l..]);
                let mut sums = [[L::zero(); F]; F];
                for k in first..first + count {
                    for f in (0..fields).filter(|f| *f != D) {
                        let of = difference(k, f);
                        (0..=D).for_each(|a| sums[f][a] = coefficient(k, a).mul_add(of, sums[f][a]));
                    }
                }
                // Of the sums of each field, and of the particle's own fields.
                let (mut weights, mut own_bar) = ([[L::zero(); F]; F], [L::zero(); F]);
                let mut viscosity = L::zero();
                for f in (0..fields).filter(|f| *f != D) {
                    let factor = if f < D { medium.fluid.viscosity } else { medium.fluid.diffusivity.unwrap_or(0.0) };
                    weights[f][D] = L::splat(factor) * rho[f];
                    for d in 0..D {
                        weights[f][d] = -(own[d] * rho[f]);
                        own_bar[d] = own_bar[d] - sums[f][d] * rho[f];
                    }
                }
                for e in 0..D {
                    viscosity += sums[e][D] * rho[e];
                    weights[D][e] = -rho[e];
                    weights[e][e] = weights[e][e] - L::splat(medium.sound * medium.sound) * rho[D];
                    if let Some(buoyancy) = medium.fluid.buoyancy {
                        own_bar[D + 1] += L::splat(buoyancy.by[e]) * rho[e];
                    }
                }
                weights[D][D + 1] = L::load_part(&damping[block * WIDEST + l..]) * rho[D];
                part.viscosity += viscosity.sum();
                for k in first..first + count {
                    let mut c = [L::zero(); F];
                    (0..F).for_each(|a| c[a] = coefficient(k, a));
                    let mut c_bar = [L::zero(); F];
                    let others = &list[k * WIDEST + l..][..L::COUNT];
                    for f in 0..fields {
                        let mut along = L::zero();
                        (0..F).for_each(|a| along = weights[f][a].mul_add(c[a], along));
                        own_bar[f] = own_bar[f] - along;
                        for (&begin, along) in others.iter().zip(along.numbers()) {
                            part.y_bar[begin as usize + f * WIDEST] += along;
                        }
                        if !pairs.is_empty() {
                            let of = difference(k, f);
                            (0..F).for_each(|a| c_bar[a] = weights[f][a].mul_add(of, c_bar[a]));
                        }
                    }
                    if !pairs.is_empty() {
                        for (a, more) in c_bar.into_iter().enumerate() {
                            let to = &mut pairs[((k - start) * F + a) * WIDEST + l..][..L::COUNT];
                            let sum = L::load_part(to) + more;
                            // SAFETY: the slice has COUNT numbers.
                            unsafe { sum.store(to.as_mut_ptr()) };
                        }
                    }
                }
                for (f, bar) in own_bar.into_iter().enumerate() {
                    for (to, more) in part.y_bar[at(f)..][..L::COUNT].iter_mut().zip(bar.numbers()) {
                        *to += more;
                    }
                }
            }
        }
    }
}
