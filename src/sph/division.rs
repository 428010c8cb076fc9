//! The adaptive time step: a step is divided where the flow asks for it.
//!
//! The step dt of a scene follows from what is known before the run: sound, the reference velocity, diffusion of momentum
//! and heat, a given body force. Where the flow turns out faster than the reference velocity, or is pushed harder than
//! expected, a step is made in k equal parts, the smallest k with
//!
//! ```text
//!   dt / k <= 5/4 C dx / (c + |u|)        sound and convection; C: the scene's CFL number
//!   dt / k <= 1/4 dx / |u|                no particle passes a quarter of a spacing
//!   dt / k <= 1/4 sqrt(dx / |a|)          acceleration, where the state has that of the last step
//! ```
//!
//! over all fluid particles (Monaghan 1992, sec. 11; Morris, Fox and Zhu 1997, eq. 19 and 20). k is a function of the state at
//! the step's beginning, so a replay divides as the run did, to the bit, and a step's time, an objective's window and a
//! gradient's schedule stay what they are; the adjoint is that of the parts, k being constant (it is, but at jumps). The other
//! way around there is nothing to gain: while u is small against c, 1/(c + |u|) varies by a tenth.

use super::model::{Layout, Model};
use crate::numerics::lanes::Real;

/// What a step may be, by the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Division {
    /// Particle spacing dx.
    pub spacing: f64,
    /// c.
    pub sound_speed: f64,
    /// C.
    pub courant_number: f64,
}

/// Longer than C asks for: halving costs a step, and the limits of stability are further off than that.
const TOLERANCE: f64 = 1.25;
/// Share of a spacing that a particle may pass in a step.
const CONVECTION: f64 = 0.25;
/// Share of sqrt(dx / |a|).
const FORCE: f64 = 0.25;
/// More parts than this help nothing: a flow that is so fast has diverged.
pub const MOST: usize = 64;

impl Division {
    /// The longest step for a largest speed and acceleration.
    pub fn longest(&self, speed: f64, acceleration: f64) -> f64 {
        let dx = self.spacing;
        let sound = TOLERANCE * self.courant_number * dx / (self.sound_speed + speed);
        sound.min(CONVECTION * dx / speed).min(FORCE * (dx / acceleration).sqrt())
    }

    /// In how many parts a step of `dt` is made.
    pub fn parts(&self, dt: f64, speed: f64, acceleration: f64) -> usize {
        // Numbers that are none are not judged here: the run's check finds them.
        let parts = (dt / self.longest(speed, acceleration) - 1e-9).ceil();
        (parts as usize).clamp(1, MOST)
    }
}

/// Steps that were made in parts, and the most parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Divided {
    pub steps: usize,
    pub most: usize,
}

impl Divided {
    /// A step of some parts.
    pub fn count(&mut self, parts: usize) {
        if parts > 1 {
            self.steps += 1;
            self.most = self.most.max(parts);
        }
    }
}

/// The largest length of a vector field's values at the fluid's particles; its first row stands at `row` of the state.
fn largest<R: Real>(model: &Model<R>, state: &[R], row: usize) -> f64 {
    let (n, dimension) = (model.particles(), model.layout.dimension);
    let fluid = (0..n).filter(|&i| model.is_fluid(i));
    let square = |i: usize| (0..dimension).map(|d| state[(row + d) * n + i].f64().powi(2)).sum::<f64>();
    fluid.map(square).fold(0.0, f64::max).sqrt()
}

/// Where a state has the accelerations of the last step.
fn accelerations(layout: Layout) -> Option<usize> {
    match layout.consistent {
        true => layout.rates.then(|| layout.last_rates()),
        false => Some(layout.acceleration()),
    }
}

/// In how many parts the step from a state `[F, N]` is made: 1, where the scene does not divide steps.
pub fn parts<R: Real>(model: &Model<R>, state: &[R]) -> usize {
    let Some(division) = &model.division else { return 1 };
    let speed = largest(model, state, model.layout.velocity());
    let acceleration = accelerations(model.layout).map_or(0.0, |row| largest(model, state, row));
    division.parts(model.dt, speed, acceleration)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_divided_where_the_flow_asks_for_it() {
        let division = Division { spacing: 0.01, sound_speed: 10.0, courant_number: 1.0 };
        let dt = 0.01 / 11.0;
        // At rest, at the reference velocity and a good deal above it: whole.
        for speed in [0.0, 1.0, 2.5] {
            assert_eq!(division.parts(dt, speed, 0.0), 1, "{speed}");
        }
        // A quarter of a spacing in a step is 2.75.
        assert_eq!((division.parts(dt, 2.76, 0.0), division.parts(dt, 5.6, 0.0)), (2, 3));
        // 1/4 sqrt(dx / a) = dt at a = dx / (4 dt)^2.
        let a = 0.01 / (4.0 * dt).powi(2);
        assert_eq!((division.parts(dt, 0.0, a), division.parts(dt, 0.0, 1.01 * a)), (1, 2));
        assert_eq!(division.parts(dt, 0.0, 9.01 * a), 4);
        // A slow fluid's sound: c + u decides.
        let slow = Division { sound_speed: 1.0, courant_number: 0.1, ..division };
        assert_eq!((slow.parts(5e-4, 1.4, 0.0), slow.parts(5e-4, 1.6, 0.0)), (1, 2));
        for nonsense in [f64::NAN, f64::INFINITY] {
            assert!((1..=MOST).contains(&division.parts(dt, nonsense, nonsense)));
        }
    }
}
