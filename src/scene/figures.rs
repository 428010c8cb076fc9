//! Figures of a state, compared with the exact solution.

use super::developed::Developed;
use super::{Exact, Scene};
use crate::adjoint::Dynamics;
use crate::numerics::lanes::Real;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FlowFigures {
    pub time: f64,
    /// sum m u^2 / 2 over the fluid particles.
    pub kinetic_energy: f64,
    /// The same sum with the exact velocity at the particles' positions.
    pub exact_kinetic_energy: Option<f64>,
    /// Speed of the fastest fluid particle.
    pub largest_velocity: f64,
    /// Root mean square of |u - u_exact| at the fluid particles, over [`Exact::amplitude`].
    pub velocity_error: Option<f64>,
    /// Root mean square of T - T_exact at the particles' places: over the walls' difference in the slab, else in units of
    /// temperature.
    pub temperature_error: Option<f64>,
    /// Slab: heat flux through the lower and the upper wall, and the exact ones.
    pub wall_flux: Option<[f64; 2]>,
    pub exact_wall_flux: Option<[f64; 2]>,
    /// Isothermal channel: Nusselt number of the section with a developed profile, and the exact one.
    pub nusselt: Option<f64>,
    pub exact_nusselt: Option<f64>,
}

/// Slab: range of the distance from a wall, in spacings, in which particles determine the flux through it. (The nearest
/// ones contain the error of the wall condition.)
const NEAR: [f64; 2] = [1.0, 10.0];

/// The first of three unknowns of a linear system, by Cramer's rule.
fn first_unknown(m: [[f64; 3]; 3], right: [f64; 3]) -> f64 {
    let determinant = |c: [f64; 3]| {
        c[0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (c[1] * m[2][2] - m[1][2] * c[2])
            + m[0][2] * (c[1] * m[2][1] - m[1][1] * c[2])
    };
    determinant(right) / determinant([m[0][0], m[1][0], m[2][0]])
}

impl<R: Real> Scene<R> {
    pub fn figures(&self, state: &[R], time: f64) -> FlowFigures {
        let (model, n) = (&self.model, self.model.particles());
        let vector = |row: usize, i: usize| -> [f64; 3] {
            std::array::from_fn(|d| if d < model.dimension() { state[(row + d) * n + i].f64() } else { 0.0 })
        };
        let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        let (mut fluid, mut energy, mut exact_energy, mut error, mut largest) = (0, 0.0, 0.0, 0.0, 0.0_f64);
        let mut known = true;
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let u = vector(model.rows.velocity(), i);
            let r = vector(0, i);
            fluid += 1;
            energy += 0.5 * model.mass * square(u);
            // `max` would ignore a NaN.
            largest = if square(u).sqrt() <= largest { largest } else { square(u).sqrt() };
            match self.exact.velocity(r, time) {
                Some(exact) => {
                    exact_energy += 0.5 * model.mass * square(exact);
                    error += square(std::array::from_fn(|d| u[d] - exact[d]));
                }
                None => known = false,
            }
        }
        let amplitude = self.exact.amplitude(time).filter(|_| known);
        let (wall_flux, exact_wall_flux) = match &self.exact {
            Exact::Slab(series) => (Some(self.wall_flux(state, series.conductivity())), Some(series.wall_flux(time))),
            _ => (None, None),
        };
        let (nusselt, exact_nusselt) = match &self.exact {
            Exact::IsothermalChannel(developed) => (self.nusselt(state, developed), Some(developed.nusselt)),
            _ => (None, None),
        };
        FlowFigures {
            time,
            kinetic_energy: energy,
            exact_kinetic_energy: known.then_some(exact_energy),
            largest_velocity: largest,
            velocity_error: amplitude.map(|amplitude| (error / fluid as f64).sqrt() / amplitude),
            temperature_error: self.temperature_error(state, time),
            wall_flux,
            exact_wall_flux,
            nusselt,
            exact_nusselt,
        }
    }

    /// Index, position and temperature of every fluid particle, for a scene with heat.
    fn temperatures<'a>(&'a self, state: &'a [R]) -> impl Iterator<Item = (usize, [f64; 3], f64)> + 'a {
        let (model, n) = (&self.model, self.model.particles());
        let place = move |i: usize| -> [f64; 3] {
            std::array::from_fn(|d| if d < model.dimension() { state[d * n + i].f64() } else { 0.0 })
        };
        let row = model.rows.temperature();
        let fluid = (0..n).filter(move |&i| row.is_some() && model.is_fluid(i));
        fluid.map(move |i| (i, place(i), state[row.unwrap_or(0) * n + i].f64()))
    }

    fn temperature_error(&self, state: &[R], time: f64) -> Option<f64> {
        let (mut count, mut sum) = (0, 0.0);
        for (_, place, temperature) in self.temperatures(state) {
            sum += (temperature - self.exact.temperature(place, time)?).powi(2);
            count += 1;
        }
        (count > 0).then(|| (sum / count as f64).sqrt())
    }

    /// The heat flux along y through the walls of a slab, by the least-squares cubic through the wall's temperature (1
    /// below, 0 above) and the particles [`NEAR`] it.
    fn wall_flux(&self, state: &[R], conductivity: [f64; 2]) -> [f64; 2] {
        let near = NEAR.map(|spacings| (spacings * self.spacing).min(0.5));
        [0, 1].map(|wall| {
            let (given, sign) = if wall == 0 { (1.0, -1.0) } else { (0.0, 1.0) };
            // Least squares of T - given = b z + c z^2 + d z^3, z = s / reach.
            let (mut matrix, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
            for (_, [_, y, _], temperature) in self.temperatures(state) {
                let s = if wall == 0 { y } else { 1.0 - y };
                let z = s / near[1];
                let powers = [z, z * z, z * z * z];
                if s > near[0] && s < near[1] {
                    for a in 0..3 {
                        right[a] += powers[a] * (temperature - given);
                        (0..3).for_each(|b| matrix[a][b] += powers[a] * powers[b]);
                    }
                }
            }
            sign * conductivity[wall] * first_unknown(matrix, right) / near[1]
        })
    }

    fn nusselt(&self, state: &[R], developed: &Developed) -> Option<f64> {
        let (model, n) = (&self.model, self.model.particles());
        let volume = model.mass / model.equation_of_state.reference_density;
        let along = |i: usize| state[model.rows.velocity() * n + i].f64();
        let of =
            |(i, [x, _, _], temperature): (usize, [f64; 3], f64)| [x, volume * along(i), volume, 1.0 - temperature];
        developed.measured(self.temperatures(state).map(of))
    }
}

impl<R: Sweeps> Scene<R> {
    /// Names of the columns of [`Self::history_row`].
    pub fn history_columns(&self) -> Vec<&'static str> {
        let (knows_velocity, knows_temperature) = match (&self.design, &self.exact) {
            (Some(_), _) => return vec!["time", "q", "flow_rate"],
            (None, Exact::Slab(_)) => {
                return vec!["time", "lower_wall_flux", "upper_wall_flux", "temperature_error"];
            }
            (None, Exact::Unknown) => (false, false),
            (None, Exact::Stated(stated)) => (!stated.velocity.is_empty(), stated.temperature.is_some()),
            (None, _) => (true, false),
        };
        let mut columns = vec!["time", "kinetic_energy", "largest_velocity"];
        columns.extend(knows_velocity.then_some(["exact_kinetic_energy", "velocity_error"]).into_iter().flatten());
        columns.extend(knows_temperature.then_some("temperature_error"));
        columns
    }

    /// Figures of the present state of a run: for a design the heat and the volume that flow out (sums of rho u (T -
    /// T_in) and u over the targets, times their spacing), otherwise [`FlowFigures`].
    pub fn history_row(&self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<Vec<f64>> {
        let time = solver.step as f64 * self.model.dt;
        if let Some(design) = &self.design {
            let (spacing, flows) = (design.outlet.spacing, design.outlet.numbers(&dynamics.look(solver)?)?);
            return Ok(vec![time, spacing * flows.heat, spacing * flows.volume]);
        }
        let found = self.figures(&solver.state, time);
        if let Some(flux) = found.wall_flux {
            return Ok([time].into_iter().chain(flux).chain(found.temperature_error).collect());
        }
        let known = [found.exact_kinetic_energy, found.velocity_error, found.temperature_error].into_iter().flatten();
        Ok([time, found.kinetic_energy, found.largest_velocity].into_iter().chain(known).collect())
    }
}
