//! The exact derivative of figures of a flow in time, see [`super::unsteady`], by positions and by what walls do.
//!
//! A step solves A z+ = b(z, z-), so with the cotangent z_bar+ of its result
//!
//! ```text
//!   A^T y = z_bar+,   u_bar += a1 y,   u_bar- -= a2 y,   N_bar -= (1 + r) y,   N_bar- += r y,   x_bar -= y^T (dA/dx) z+,
//! ```
//!
//! and N(f) = u . grad f gives its cotangent to u, f and the positions. In the plane, what positions get is summed over all steps as
//! cotangents of the fits' coefficients ([`super::fit_adjoint`]).
//!
//! States are kept in [`MEMORY`]: those of all steps if they have room there, else those at the beginnings of segments, within each of
//! which they are made again, but for the last one.

use super::deferred_correction::Defect;
use super::equations::{Bar, Condition, State};
use super::steady::NoSteadyState;
use super::unsteady::{InTime, Level, Reached, Scheme, Step};

/// Bytes that the states of a run may take.
pub const MEMORY: usize = 500_000_000;

/// The segments of `steps` steps, the first one with what is left over: as long as room for `most` states allows, where one takes `begin` of
/// them from its beginning on, and each step of the one that is gone through takes `step`.
pub(super) fn segments(steps: usize, most: usize, begin: usize, step: usize) -> Vec<(usize, usize)> {
    let (most, begin, step) = (most as f64, (begin * steps) as f64, step as f64);
    // The larger of the two lengths for which step length + begin / length is `most`; the least memory has sqrt(begin / step).
    let longest = 0.5 * (most + (most * most - 4.0 * begin * step).max(0.0).sqrt()) / step;
    let length = (longest.max((begin / step).sqrt()) as usize).clamp(1, steps.max(1));
    let first = (steps + length - 1) % length + 1;
    let later = (first..steps).step_by(length).map(|from| (from, from + length));
    (steps > 0).then_some((0, first)).into_iter().chain(later).collect()
}

/// A flow whose steps have been taken.
pub struct Taken<'a, const D: usize, const F: usize, const C: usize> {
    /// `[D][N]`.
    pub position: &'a [Vec<f64>; D],
    pub boundary: &'a dyn InTime<D, F, C>,
    pub flow_rate: Option<f64>,
    pub first: &'a State<F>,
    pub sizes: &'a [f64],
    /// Bytes for states.
    pub memory: usize,
    /// Whether the cotangent of the viscosity is wanted, for which derivatives inside are taken, too.
    pub by_viscosity: bool,
    /// Adds the cotangents of the flow rate times a number to a bar, for one that is held.
    pub flow_rate_back: &'a dyn Fn(&State<F>, f64, &mut Bar<D, F, C>),
}

/// Cotangents of all that a flow depends on.
pub struct Cotangents<const D: usize, const F: usize, const C: usize> {
    /// Of the viscosity, if it is wanted; of the boundary's numbers only if these do not change with time.
    pub bar: Bar<D, F, C>,
    pub position: [Vec<f64>; D],
    pub parameters: Vec<f64>,
    /// Of the first state's fields, `[F][N]`.
    pub start: [Vec<f64>; F],
}

impl<const D: usize, const F: usize, const C: usize> Cotangents<D, F, C> {
    /// Adds those of another part of a flow, but for the first state's.
    pub fn add(&mut self, other: Self) {
        self.bar.add_walls(&other.bar);
        self.bar.add_of_whole_flow(&other.bar);
        for (to, from) in self.position.iter_mut().zip(other.position) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        self.parameters.iter_mut().zip(other.parameters).for_each(|(to, from)| *to += from);
    }
}

/// Cotangents of a state's fields, of its advection, `[carried][inside]`, and of what its slopes lack.
#[derive(Clone)]
struct Back<const F: usize> {
    fields: [Vec<f64>; F],
    advection: Vec<Vec<f64>>,
    defect: Option<Defect>,
}

impl<const D: usize, const F: usize, const C: usize> Taken<'_, D, F, C> {
    fn step(&self, k: usize) -> Step {
        Step::after(&self.sizes[..k], self.sizes[k])
    }

    /// The levels after steps `from` ... `to`, given those before them.
    fn levels(
        &self,
        march: &mut impl Scheme<D, F, C>,
        (from, to): (usize, usize),
        times: &[f64],
        usual: &[Condition<D>],
        start: [Level<F>; 2],
    ) -> Result<Vec<Level<F>>, NoSteadyState> {
        let [before, now] = start;
        let mut all = vec![before, now];
        for k in from..to {
            let conditions = self.boundary.at(times[k], usual);
            let [before, now] = [&all[all.len() - 2], &all[all.len() - 1]];
            let state = march.step(self.step(k), now, before, &conditions, self.flow_rate)?;
            all.push(march.level(state));
        }
        Ok(all)
    }

    /// Cotangents of a sum of figures: `figures` adds those of the moment after step k to a bar.
    ///
    /// # Errors
    /// A matrix without factors, or iterations that do not converge.
    pub fn pull_back(
        &self,
        march: &mut impl Scheme<D, F, C>,
        figures: &mut dyn FnMut(usize, Reached<'_, F>, &mut Bar<D, F, C>),
        parameters: usize,
    ) -> Result<Cotangents<D, F, C>, NoSteadyState> {
        let (n, inside, count) = (march.particles(), march.inside(), march.boundary());
        let (steps, size, has_heat) = (self.sizes.len(), D + 1, march.has_heat());
        let mut times = vec![];
        self.sizes.iter().fold(0.0, |time, dt| {
            times.push(time + dt);
            time + dt
        });
        let usual = self.boundary.conditions(0.0);
        let first = march.level(self.first.clone());
        let lacking = if first.defect.is_some() { (D + 2) * n } else { 0 };
        let bytes = size_of::<f64>() * (F * (n + inside) + lacking);
        let parts = segments(steps, self.memory / bytes.max(1), 2, 1);
        // The states that segments begin with and those before them, and all levels of the last one.
        let mut starts = vec![[Level::none(), first]];
        let mut levels = vec![];
        for (k, &part) in parts.iter().enumerate() {
            levels.clear();
            levels = self.levels(march, part, &times, &usual, starts[k].clone())?;
            let end = levels.len() - 2;
            starts.push([levels[end].clone(), levels[end + 1].clone()]);
        }
        let carried = march.carried();
        let zero = Back {
            fields: std::array::from_fn(|_| vec![0.0; n]),
            advection: vec![vec![0.0; inside]; carried.len()],
            defect: None,
        };
        let mut found = Cotangents {
            bar: Bar::new(n, count),
            position: std::array::from_fn(|_| vec![0.0; n]),
            parameters: vec![0.0; parameters],
            start: std::array::from_fn(|_| vec![]),
        };
        let (mut sums, mut bar) = (march.sums(), Bar::new(n, count));
        // Of the state that is looked at, and of the one before it.
        let (mut now, mut before) = (zero.clone(), zero.clone());
        for (&(from, to), start) in parts.iter().zip(starts).rev() {
            if levels.is_empty() {
                levels = self.levels(march, (from, to), &times, &usual, start)?;
            }
            for k in (from..to).rev() {
                let level = &levels[k - from + 2];
                let state = &level.state;
                bar.clear();
                figures(k, level.reached(), &mut bar);
                let mut right = Self::of_state(march, state, &now, &mut sums, &mut bar);
                let step = self.step(k);
                let (r, [a0, a1, a2]) = step.weights();
                let y = march.solve_flow(a0, &self.of_flow(march, &right, bar.drive), None)?;
                let mut earlier = zero.clone();
                let mut heat = vec![];
                let by = march.buoyancy().map_or([0.0; 3], |buoyancy| buoyancy.by);
                if has_heat {
                    let mut right_t = std::mem::take(&mut right[D + 1]);
                    for i in 0..inside {
                        right_t[i] += (0..D).map(|e| by[e] * y[size * i + e]).sum::<f64>();
                    }
                    heat = march.solve_heat(a0, &right_t, None)?;
                }
                for (c, &field) in carried.iter().enumerate() {
                    for i in 0..inside {
                        let y = if field < D { y[size * i + field] } else { heat[i] };
                        before.fields[field][i] += a1 * y;
                        before.advection[c][i] -= (1.0 + r) * y;
                        earlier.fields[field][i] -= a2 * y;
                        earlier.advection[c][i] += r * y;
                    }
                }
                // What the matrices know of positions and walls.
                let against: Vec<f64> = y[..size * n].iter().map(|y| -y).collect();
                let against_heat: Vec<f64> = heat.iter().map(|y| -y).collect();
                let d = march.derivatives(state, self.by_viscosity);
                if step.is_corrected {
                    before.defect = Some(Defect { flow: against.clone(), heat: against_heat.clone() });
                }
                let heat = has_heat.then_some(against_heat.as_slice());
                march.pull_back_linear(a0, &d, &against, heat, &mut bar);
                if let (Some(_), Some(multiplier)) = (self.flow_rate, y.last()) {
                    // The held flow rate depends on positions too.
                    (self.flow_rate_back)(state, -multiplier, &mut bar);
                }
                march.add_to(&mut sums, self.position, state, &bar);
                self.gather(times[k], &bar, &mut found);
                now = std::mem::replace(&mut before, earlier);
            }
            levels.clear();
        }
        // The state at the start: what it is inside is given; on walls it is what these are.
        bar.clear();
        let total = Self::of_state(march, self.first, &now, &mut sums, &mut bar);
        self.boundary.of_start(&total, &mut bar, &mut found.position);
        found.start = total;
        march.add_to(&mut sums, self.position, self.first, &bar);
        self.gather(0.0, &bar, &mut found);
        for (to, from) in found.position.iter_mut().zip(march.by_sums(self.position, sums)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        if !self.boundary.changes() {
            let Cotangents { bar, position, parameters, .. } = &mut found;
            self.boundary.pull_back(0.0, bar, position, parameters);
        }
        Ok(found)
    }

    /// A right-hand side of the transposed flow, given the cotangents of the fields and of the drive.
    fn of_flow(&self, march: &impl Scheme<D, F, C>, fields: &[Vec<f64>; F], drive: f64) -> Vec<f64> {
        let n = march.particles();
        let mut right: Vec<f64> = (0..n).flat_map(|i| (0..=D).map(move |f| fields[f][i])).collect();
        let [pins, drives] = march.extra();
        right.extend(pins.then_some(0.0));
        right.extend(drives.then_some(drive));
        right
    }

    /// The cotangents of a state's fields, given those of its figures in `bar` and what later steps have of it. Adds to
    /// the bar's derivatives and to `sums` what the advection and what slopes lack have of them.
    fn of_state<M: Scheme<D, F, C>>(
        march: &M,
        state: &State<F>,
        back: &Back<F>,
        sums: &mut M::Sums,
        bar: &mut Bar<D, F, C>,
    ) -> [Vec<f64>; F] {
        let mut fields = march.by_fields(bar);
        for (to, own) in fields.iter_mut().zip(&back.fields) {
            to.iter_mut().zip(own).for_each(|(to, own)| *to += own);
        }
        let mut defect = back.defect.clone();
        if !(bar.defect.is_empty() && bar.heat_defect.is_empty()) {
            let n = march.particles();
            let Defect { flow, heat } =
                defect.get_or_insert_with(|| Defect { flow: vec![0.0; (D + 1) * n], heat: vec![0.0; n] });
            for (to, by) in flow.chunks_mut(D + 1).zip(&bar.defect) {
                (0..D).for_each(|e| to[e] += by[e]);
            }
            heat.iter_mut().zip(&bar.heat_defect).for_each(|(to, by)| *to += by);
        }
        if let Some(defect) = defect {
            march.pull_back_defect(sums, state, &defect, &mut fields, bar);
        }
        let carried = march.carried();
        let mut by_slopes = vec![];
        for ((slopes, weights), &field) in march.carried_slopes(state).iter().zip(&back.advection).zip(&carried) {
            let derivatives = &mut bar.derivatives.0[field];
            let mut by = vec![[0.0; D]; weights.len()];
            for (i, (slope, weight)) in slopes.iter().zip(weights).enumerate() {
                for e in 0..D {
                    fields[e][i] += weight * slope[e];
                    by[i][e] = weight * state.fields[e][i];
                    derivatives[i][e] += by[i][e];
                }
            }
            by_slopes.push(by);
        }
        let (stencils, coefficients) = march.carriers();
        let found = coefficients.slopes_back(stencils, &by_slopes);
        for (field, found) in carried.into_iter().zip(found) {
            fields[field].iter_mut().zip(found).for_each(|(to, from)| *to += from);
        }
        fields
    }

    /// Adds what a moment's bar says of walls.
    fn gather(&self, time: f64, bar: &Bar<D, F, C>, found: &mut Cotangents<D, F, C>) {
        if self.boundary.changes() {
            self.boundary.pull_back(time, bar, &mut found.position, &mut found.parameters);
        }
        found.bar.add_walls(bar);
        found.bar.add_of_whole_flow(bar);
    }
}
