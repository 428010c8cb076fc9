//! The exact derivative of figures of a flow in time, see [`super::unsteady`], by positions and by what walls do.
//!
//! A step solves A z+ = b(z, z-), so with the cotangent z_bar+ of its result
//!
//! ```text
//!   A^T y = z_bar+,   u_bar += a1 y,   u_bar- -= a2 y,   N_bar -= (1 + r) y,   N_bar- += r y,   x_bar -= y^T (dA/dx) z+,
//! ```
//!
//! and N(f) = u . grad f gives its cotangent to u, f and the positions. States are kept at the ends of segments and made again
//! within each, about as many segments as steps in one.

use super::equations::{Bar, Condition, State};
use super::steady::NoSteadyState;
use super::unsteady::{InTime, Level, Scheme, Step};

/// A flow whose steps have been taken.
pub struct Taken<'a, const D: usize, const F: usize, const C: usize> {
    /// `[D][N]`.
    pub position: &'a [Vec<f64>; D],
    pub boundary: &'a dyn InTime<D, F, C>,
    pub flow_rate: Option<f64>,
    pub first: &'a State<F>,
    pub sizes: &'a [f64],
    /// Adds the cotangents of the flow rate times a number to a bar, for one that is held.
    pub flow_rate_back: &'a dyn Fn(&State<F>, f64, &mut Bar<D, F, C>),
}

/// Cotangents of all that a flow depends on.
pub struct Cotangents<const D: usize, const F: usize, const C: usize> {
    /// Of the positions; of the boundary's numbers only if these do not change with time.
    pub bar: Bar<D, F, C>,
    pub position: [Vec<f64>; D],
    pub parameters: Vec<f64>,
}

/// Cotangents of a state's fields and of its advection.
#[derive(Clone)]
struct Back<const F: usize> {
    fields: [Vec<f64>; F],
    advection: Vec<[f64; F]>,
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
        figures: &mut dyn FnMut(usize, &State<F>, &mut Bar<D, F, C>),
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
        let length = ((steps as f64).sqrt().ceil() as usize).max(1);
        // The states at the beginnings of segments, and those before them.
        let mut kept: Vec<[Level<F>; 2]> = vec![[Level::none(), march.level(self.first.clone())]];
        for from in (0..steps).step_by(length) {
            let to = (from + length).min(steps);
            let start = kept[kept.len() - 1].clone();
            let levels = self.levels(march, (from, to), &times, &usual, start)?;
            kept.push([levels[levels.len() - 2].clone(), levels[levels.len() - 1].clone()]);
        }
        kept.pop();
        let zero = Back { fields: std::array::from_fn(|_| vec![0.0; n]), advection: vec![[0.0; F]; inside] };
        let mut found = Cotangents {
            bar: Bar::new(n, count),
            position: std::array::from_fn(|_| vec![0.0; n]),
            parameters: vec![0.0; parameters],
        };
        // Of the state that is looked at, and of the one before it.
        let (mut now, mut before) = (zero.clone(), zero.clone());
        for (segment, start) in kept.into_iter().enumerate().rev() {
            let (from, to) = (segment * length, ((segment + 1) * length).min(steps));
            let levels = self.levels(march, (from, to), &times, &usual, start)?;
            for k in (from..to).rev() {
                let state = &levels[k - from + 2].state;
                let mut bar = Bar::new(n, count);
                figures(k, state, &mut bar);
                self.of_level(march, state, &now, &mut bar);
                let mut right = march.by_fields(&bar);
                right.iter_mut().zip(&now.fields).for_each(|(all, own)| {
                    all.iter_mut().zip(own).for_each(|(all, own)| *all += own);
                });
                let (r, [a0, a1, a2]) = self.step(k).weights();
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
                for field in march.carried() {
                    for i in 0..inside {
                        let y = if field < D { y[size * i + field] } else { heat[i] };
                        before.fields[field][i] += a1 * y;
                        before.advection[i][field] -= (1.0 + r) * y;
                        earlier.fields[field][i] -= a2 * y;
                        earlier.advection[i][field] += r * y;
                    }
                }
                // What the matrices know of positions and walls.
                let against: Vec<f64> = y[..size * n].iter().map(|y| -y).collect();
                let against_heat: Vec<f64> = heat.iter().map(|y| -y).collect();
                let d = march.boundary_derivatives(state);
                let heat = has_heat.then_some(against_heat.as_slice());
                march.pull_back_linear(a0, &d, &against, heat, &mut bar);
                if let (Some(_), Some(multiplier)) = (self.flow_rate, y.last()) {
                    // The held flow rate depends on positions too.
                    (self.flow_rate_back)(state, -multiplier, &mut bar);
                }
                self.gather(march, times[k], state, bar, &mut found);
                now = std::mem::replace(&mut before, earlier);
            }
        }
        // The state at the start: what it is inside is given; on walls it is what these are.
        let mut bar = Bar::new(n, count);
        self.of_level(march, self.first, &now, &mut bar);
        let fields = march.by_fields(&bar);
        let total: [Vec<f64>; F] =
            std::array::from_fn(|f| fields[f].iter().zip(&now.fields[f]).map(|(a, b)| a + b).collect());
        self.boundary.of_start(&total, &mut bar, &mut found.position);
        self.gather(march, 0.0, self.first, bar, &mut found);
        if !self.boundary.changes() {
            let Cotangents { bar, position, parameters } = &mut found;
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

    /// The cotangent of a level's advection, in those of its derivatives and fields.
    fn of_level(&self, march: &impl Scheme<D, F, C>, state: &State<F>, back: &Back<F>, bar: &mut Bar<D, F, C>) {
        let slopes = march.carried_slopes(state);
        for (slopes, field) in slopes.iter().zip(march.carried()) {
            for (i, advection) in back.advection.iter().enumerate() {
                let weight = advection[field];
                for e in 0..D {
                    bar.fields[e][i] += weight * slopes[i][e];
                    bar.derivatives.0[field][i][e] += weight * state.fields[e][i];
                }
            }
        }
    }

    /// Adds what a moment's bar says of positions and walls.
    fn gather(
        &self,
        march: &impl Scheme<D, F, C>,
        time: f64,
        state: &State<F>,
        bar: Bar<D, F, C>,
        found: &mut Cotangents<D, F, C>,
    ) {
        let positions = march.by_positions(self.position, state, &bar);
        for (to, from) in found.position.iter_mut().zip(&positions) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        if self.boundary.changes() {
            self.boundary.pull_back(time, &bar, &mut found.position, &mut found.parameters);
        }
        for (to, from) in found.bar.boundary.iter_mut().zip(&bar.boundary) {
            for e in 0..D {
                to.normal[e] += from.normal[e];
                to.area[e] += from.area[e];
                to.velocity[e] += from.velocity[e];
            }
            to.temperature += from.temperature;
        }
        found.bar.volume += bar.volume;
        found.bar.numbers.extend(&bar.numbers);
    }
}
