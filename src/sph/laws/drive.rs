//! A drive that replaces a given body force: a uniform acceleration that holds the flow rate or the power.
//!
//! A step first adds all other forces, which gives velocities u*. With the fluid's momentum along x, S = sum m u*, and
//! its
//! mass M = sum m, the acceleration of a step is kick / dt,
//!
//! ```text
//!   flow rate    kick = (density L rate - S) / M                 so that  sum m (u* + kick) / (density L) = rate;
//!   power        M kick^2 + S kick = dt power, the upper root    so that  kick/dt sum m (u* + kick) = power.
//! ```
//!
//! L is the length of the domain, the rate a volume per time and depth, the power a work per time and depth. Both
//! equations hold at the end of every step to rounding, so a steady flow has exactly the given rate or power. The kick
//! is a function of the state through S and M, so its derivative is exact. Turbulent channel flows are held at constant
//! flow rate in this way too (Quadrio, Frohnapfel and Hasegawa 2016, section 2). The power equation is implicit, so a
//! flow starts from rest.

use candle_core::{Result, Tensor};

/// The quantity that is held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Momentum along x: density * length * flow rate.
    Momentum(f64),
    /// Power of the acceleration per depth.
    Power(f64),
}

/// The velocity increment of every fluid particle, and its derivatives.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Kick {
    pub kick: f64,
    /// d kick / dS.
    pub by_momentum: f64,
    /// d kick / dM.
    pub by_mass: f64,
}

impl Drive {
    /// The kick of a step dt, given the fluid's momentum along x and its mass.
    pub fn kick(self, dt: f64, momentum: f64, mass: f64) -> Kick {
        match self {
            Self::Momentum(wanted) => {
                let kick = (wanted - momentum) / mass;
                Kick { kick, by_momentum: -1.0 / mass, by_mass: -kick / mass }
            }
            Self::Power(power) => {
                let root = (momentum * momentum + 4.0 * mass * dt * power).sqrt();
                // For a flow along x this form avoids the difference of two large numbers.
                let kick =
                    if momentum > 0.0 { 2.0 * dt * power / (momentum + root) } else { 0.5 * (root - momentum) / mass };
                Kick { kick, by_momentum: -kick / root, by_mass: -kick * kick / root }
            }
        }
    }

    /// [`Self::kick`] for tensors `[1, 1]`.
    pub fn composed(self, dt: f64, momentum: &Tensor, mass: &Tensor) -> Result<Tensor> {
        match self {
            Self::Momentum(wanted) => momentum.affine(-1.0, wanted)?.div(mass),
            Self::Power(power) => {
                let root = (momentum.sqr()? + mass.affine(4.0 * dt * power, 0.0)?)?.sqrt()?;
                (root - momentum)?.div(&mass.affine(2.0, 0.0)?)
            }
        }
    }
}
