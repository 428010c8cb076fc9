//! What a state of a scene is like, in numbers beside those of the exact solution.

use super::Scene;
use crate::numerics::lanes::Real;

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
    /// Root mean square over the fluid particles of |u - u_exact| at their places, over [`super::Exact::amplitude`].
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
