//! What a state of a scene is like, in numbers beside those of the exact solution.

use super::{Exact, Scene};
use crate::adjoint::Dynamics;
use crate::numerics::lanes::Real;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;

/// What the flow is like after a number of steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowFigures {
    pub time: f64,
    /// Of all fluid particles, sum m u^2 / 2.
    pub kinetic_energy: f64,
    /// The same sum with the exact velocity at the particles' places.
    pub exact_kinetic_energy: Option<f64>,
    /// Of the fastest fluid particle.
    pub largest_velocity: f64,
    /// Root mean square over the fluid particles of |u - u_exact| at their places, over [`Exact::amplitude`].
    pub velocity_error: Option<f64>,
}

impl<R: Real> Scene<R> {
    /// Figures of a state of this flow at a time.
    pub fn figures(&self, state: &[R], time: f64) -> FlowFigures {
        let (model, n) = (&self.model, self.model.particles());
        let vector = |row: usize, i: usize| -> [f64; 3] {
            std::array::from_fn(|d| if d < model.layout.dimension { state[(row + d) * n + i].f64() } else { 0.0 })
        };
        let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        let (mut fluid, mut energy, mut exact_energy, mut error, mut largest) = (0, 0.0, 0.0, 0.0, 0.0_f64);
        let mut known = true;
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let u = vector(model.layout.velocity(), i);
            let r = vector(0, i);
            fluid += 1;
            energy += 0.5 * model.mass * square(u);
            // Not `max`: it would hide what is not a number.
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
        FlowFigures {
            time,
            kinetic_energy: energy,
            exact_kinetic_energy: known.then_some(exact_energy),
            largest_velocity: largest,
            velocity_error: amplitude.map(|amplitude| (error / fluid as f64).sqrt() / amplitude),
        }
    }
}

impl<R: Sweeps> Scene<R> {
    /// What [`Self::history_row`] has.
    pub fn history_columns(&self) -> &'static [&'static str] {
        match (&self.design, &self.exact) {
            (Some(_), _) => &["time", "q", "flow_rate"],
            (None, Exact::Unknown) => &["time", "kinetic_energy", "largest_velocity"],
            (None, _) => &["time", "kinetic_energy", "largest_velocity", "exact_kinetic_energy", "velocity_error"],
        }
    }

    /// Figures of a run's present state: heat and volume that flow out (sums of rho u (T - T_in) and u over the targets,
    /// times their spacing) where there is a design, else [`FlowFigures`].
    ///
    /// # Errors
    /// Tensor errors.
    pub fn history_row(&self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<Vec<f64>> {
        let time = solver.step as f64 * self.model.dt;
        if let Some(design) = &self.design {
            let (spacing, flows) = (design.outlet.spacing, design.outlet.numbers(&dynamics.look(solver)?)?);
            return Ok(vec![time, spacing * flows.heat, spacing * flows.volume]);
        }
        let found = self.figures(&solver.state, time);
        let known = [found.exact_kinetic_energy, found.velocity_error].into_iter().flatten();
        Ok([time, found.kinetic_energy, found.largest_velocity].into_iter().chain(known).collect())
    }
}
