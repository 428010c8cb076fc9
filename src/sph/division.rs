//! The adaptive time step: a step is divided into parts where the flow requires it.
//!
//! The time step dt of a scene follows from what is known before the run: sound, the reference velocity, diffusion of
//! momentum and heat, and a given body force. Where the flow is faster than the reference velocity or accelerated more
//! than expected, a step is made in k equal parts, with the smallest k such that
//!
//! ```text
//!   dt / k <= 5/4 C dx / (c + |u|)        sound and convection; C: the scene's CFL number
//!   dt / k <= 1/4 dx / |u|                no particle passes a quarter of a spacing
//!   dt / k <= 1/4 sqrt(dx / |a|)          acceleration, where the state has that of the last step
//! ```
//!
//! over all fluid particles (Monaghan 1992, sec. 11; Morris, Fox and Zhu 1997, eq. 19 and 20). k depends only on the
//! state at the beginning of the step, so a replay divides the step in the same way, and the times of steps, the window
//! of an objective and the schedule of a gradient do not change. The adjoint treats k as constant, which it is except
//! at jumps. Steps are never made longer than dt: while u is small against c, 1/(c + |u|) varies only by a tenth.

/// The criteria that divide a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Division {
    /// Particle spacing dx.
    pub spacing: f64,
    /// Speed of sound c.
    pub sound_speed: f64,
    /// CFL number C of the scene.
    pub courant_number: f64,
}

/// A step is divided only if it is longer than C allows by this factor: the limits of stability are further away.
const TOLERANCE: f64 = 1.25;
/// Fraction of a spacing that a particle may move in a step.
const CONVECTION: f64 = 0.25;
/// Limit of a step as a fraction of sqrt(dx / |a|).
const FORCE: f64 = 0.25;
/// The largest number of parts. A flow that would need more has diverged.
pub const MOST: usize = 64;

impl Division {
    /// The longest step for a largest speed and acceleration.
    pub fn longest(&self, speed: f64, acceleration: f64) -> f64 {
        let dx = self.spacing;
        let sound = TOLERANCE * self.courant_number * dx / (self.sound_speed + speed);
        sound.min(CONVECTION * dx / speed).min(FORCE * (dx / acceleration).sqrt())
    }

    /// The number of parts of a step of length `dt`.
    pub fn parts(&self, dt: f64, speed: f64, acceleration: f64) -> usize {
        // Values that are not finite are found by the run's check, not here.
        let parts = (dt / self.longest(speed, acceleration) - 1e-9).ceil();
        (parts as usize).clamp(1, MOST)
    }
}

/// Number of steps that were made in parts, and the largest number of parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Divided {
    pub steps: usize,
    pub most: usize,
}

impl Divided {
    /// Counts a step that was made in `parts`.
    pub fn count(&mut self, parts: usize) {
        if parts > 1 {
            self.steps += 1;
            self.most = self.most.max(parts);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_divided_where_the_flow_asks_for_it() {
        let division = Division { spacing: 0.01, sound_speed: 10.0, courant_number: 1.0 };
        let dt = 0.01 / 11.0;
        // Not divided at rest, at the reference velocity and well above it.
        for speed in [0.0, 1.0, 2.5] {
            assert_eq!(division.parts(dt, speed, 0.0), 1, "{speed}");
        }
        // At a speed of 2.75 a particle moves by a quarter of a spacing in a step.
        assert_eq!((division.parts(dt, 2.76, 0.0), division.parts(dt, 5.6, 0.0)), (2, 3));
        // At a = dx / (4 dt)^2, 1/4 sqrt(dx / a) = dt.
        let a = 0.01 / (4.0 * dt).powi(2);
        assert_eq!((division.parts(dt, 0.0, a), division.parts(dt, 0.0, 1.01 * a)), (1, 2));
        assert_eq!(division.parts(dt, 0.0, 9.01 * a), 4);
        // With a slow speed of sound c + u decides.
        let slow = Division { sound_speed: 1.0, courant_number: 0.1, ..division };
        assert_eq!((slow.parts(5e-4, 1.4, 0.0), slow.parts(5e-4, 1.6, 0.0)), (1, 2));
        for nonsense in [f64::NAN, f64::INFINITY] {
            assert!((1..=MOST).contains(&division.parts(dt, nonsense, nonsense)));
        }
    }
}
