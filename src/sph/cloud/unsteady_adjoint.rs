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

use super::equations::{Bar, Condition, State, CARRIED};
use super::fit::Coefficients;
use super::steady::NoSteadyState;
use super::unsteady::{InTime, Level, March, Step};

/// A flow whose steps have been taken.
pub struct Taken<'a> {
    pub operators: &'a Coefficients,
    /// `[2][N]`.
    pub position: &'a [Vec<f64>; 2],
    pub boundary: &'a dyn InTime,
    pub flow_rate: Option<f64>,
    pub first: &'a State,
    pub sizes: &'a [f64],
    /// Adds the cotangents of the flow rate times a number to a bar, for one that is held.
    pub flow_rate_back: &'a dyn Fn(&State, f64, &mut Bar),
}

/// Cotangents of all that a flow depends on.
pub struct Cotangents {
    /// Of the positions; of the boundary's numbers only if these do not change with time.
    pub bar: Bar,
    pub position: [Vec<f64>; 2],
    pub parameters: Vec<f64>,
}

/// Cotangents of a state's fields u, v, p, T and of its advection.
#[derive(Clone)]
struct Back {
    fields: [Vec<f64>; 4],
    advection: Vec<[f64; 3]>,
}

impl Taken<'_> {
    fn step(&self, k: usize) -> Step {
        Step::after(&self.sizes[..k], self.sizes[k])
    }

    /// The levels after steps `from` ... `to`, given those before them.
    fn levels(
        &self,
        march: &mut March,
        (from, to): (usize, usize),
        times: &[f64],
        usual: &[Condition],
        start: [Level; 2],
    ) -> Result<Vec<Level>, NoSteadyState> {
        let [before, now] = start;
        let mut all = vec![before, now];
        for k in from..to {
            let conditions = self.boundary.at(times[k], usual);
            let [before, now] = [&all[all.len() - 2], &all[all.len() - 1]];
            let state = march.step(self.step(k), now, before, &conditions, self.flow_rate, self.operators)?;
            all.push(march.level(self.operators, state));
        }
        Ok(all)
    }

    /// Cotangents of a sum of figures: `figures` adds those of the moment after step k to a bar.
    ///
    /// # Errors
    /// A matrix without factors.
    pub fn pull_back(
        &self,
        march: &mut March,
        figures: &mut dyn FnMut(usize, &State, &mut Bar),
        parameters: usize,
    ) -> Result<Cotangents, NoSteadyState> {
        let (n, inside) = (march.equations().particles(), march.equations().inside);
        let (count, steps) = (march.equations().conditions.len(), self.sizes.len());
        let has_heat = march.equations().diffusivity.is_some();
        let mut times = vec![];
        self.sizes.iter().fold(0.0, |time, dt| {
            times.push(time + dt);
            time + dt
        });
        let usual = self.boundary.conditions(0.0);
        let length = ((steps as f64).sqrt().ceil() as usize).max(1);
        // The states at the beginnings of segments, and those before them.
        let mut kept: Vec<[Level; 2]> = vec![[Level::default(), march.level(self.operators, self.first.clone())]];
        for from in (0..steps).step_by(length) {
            let to = (from + length).min(steps);
            let start = kept[kept.len() - 1].clone();
            let levels = self.levels(march, (from, to), &times, &usual, start)?;
            kept.push([levels[levels.len() - 2].clone(), levels[levels.len() - 1].clone()]);
        }
        kept.pop();
        let zero = Back { fields: std::array::from_fn(|_| vec![0.0; n]), advection: vec![[0.0; 3]; inside] };
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
                let mut right: Vec<Vec<f64>> = march.equations().by_fields(self.operators, &bar).to_vec();
                right.iter_mut().zip(&now.fields).for_each(|(all, own)| {
                    all.iter_mut().zip(own).for_each(|(all, own)| *all += own);
                });
                let (r, [a0, a1, a2]) = self.step(k).weights();
                let drive = bar.drive;
                let y = march.transposed(a0, self.operators, &right, drive)?;
                let mut earlier = zero.clone();
                let mut heat = vec![];
                let by = march.equations().buoyancy.map_or([0.0; 3], |buoyancy| buoyancy.by);
                if has_heat {
                    let mut right_t = std::mem::take(&mut right[3]);
                    for i in 0..inside {
                        right_t[i] += by[0] * y[3 * i] + by[1] * y[3 * i + 1];
                    }
                    heat = march.transposed_heat(a0, self.operators, &right_t)?;
                }
                for i in 0..inside {
                    for f in 0..3 {
                        let y = match f {
                            2 if has_heat => heat[i],
                            2 => continue,
                            _ => y[3 * i + f],
                        };
                        let field = CARRIED[f];
                        before.fields[field][i] += a1 * y;
                        before.advection[i][f] -= (1.0 + r) * y;
                        earlier.fields[field][i] -= a2 * y;
                        earlier.advection[i][f] += r * y;
                    }
                }
                // What the matrices know of positions and walls.
                let against: Vec<f64> = y[..3 * n].iter().map(|y| -y).collect();
                let against_heat: Vec<f64> = heat.iter().map(|y| -y).collect();
                let d = march.equations().derivatives_at(self.operators, state, &[]);
                let heat = has_heat.then_some(against_heat.as_slice());
                march.equations().pull_back_linear(&d, &against, heat, &mut bar);
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
        let fields = march.equations().by_fields(self.operators, &bar);
        let total: [Vec<f64>; 4] =
            std::array::from_fn(|f| fields[f].iter().zip(&now.fields[f]).map(|(a, b)| a + b).collect());
        self.boundary.of_start(&total, &mut bar, &mut found.position);
        self.gather(march, 0.0, self.first, bar, &mut found);
        if !self.boundary.changes() {
            let Cotangents { bar, position, parameters } = &mut found;
            self.boundary.pull_back(0.0, bar, position, parameters);
        }
        Ok(found)
    }

    /// The cotangent of a level's advection, in those of its derivatives and fields.
    fn of_level(&self, march: &March, state: &State, back: &Back, bar: &mut Bar) {
        let [u, v, ..] = &state.fields;
        let slopes = march.equations().carried_slopes(self.operators, state);
        for (i, advection) in back.advection.iter().enumerate() {
            for (f, slopes) in slopes.iter().enumerate() {
                let weight = advection[f];
                let field = CARRIED[f];
                bar.fields[0][i] += weight * slopes[i][0];
                bar.fields[1][i] += weight * slopes[i][1];
                bar.derivatives.0[field][i][0] += weight * u[i];
                bar.derivatives.0[field][i][1] += weight * v[i];
            }
        }
    }

    /// Adds what a moment's bar says of positions and walls.
    fn gather(&self, march: &March, time: f64, state: &State, bar: Bar, found: &mut Cotangents) {
        let positions = march.equations().by_positions(self.position, state, &bar);
        for (to, from) in found.position.iter_mut().zip(&positions) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        if self.boundary.changes() {
            self.boundary.pull_back(time, &bar, &mut found.position, &mut found.parameters);
        }
        for (to, from) in found.bar.boundary.iter_mut().zip(&bar.boundary) {
            for e in 0..2 {
                to.normal[e] += from.normal[e];
                to.area[e] += from.area[e];
                to.velocity[e] += from.velocity[e];
            }
            to.temperature += from.temperature;
        }
        found.bar.numbers.extend(&bar.numbers);
    }
}
