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
