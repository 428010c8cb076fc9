//! Plane Poiseuille flow between two walls, started from rest by a constant force (Morris, Fox and Zhu 1997).
//!
//! The steady centre-line velocity, density and height are 1, so the Reynolds number is 1/viscosity and the force 8/Re.
//! Coordinates as in the heated channel: y = 0 on the bottom wall's surface, periodic in x.

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::{Exact, Scene};
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The channel and its resolution. Defaults: JAX-SPH's case (height 30 spacings, length 12, Re = 0.0125).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Poiseuille {
    /// Fluid particles across the channel.
    pub rows: usize,
    /// Particles along the channel.
    pub columns: usize,
    /// Steady velocity of the centre line * height / kinematic viscosity.
    pub reynolds: f64,
    pub numerics: Numerics,
}

impl Default for Poiseuille {
    fn default() -> Self {
        Self { rows: 30, columns: 12, reynolds: 0.0125, numerics: Numerics::default() }
    }
}

impl Poiseuille {
    /// The largest time step, or the given one.
    pub fn time_step(&self) -> f64 {
        self.numerics.step(1.0 / self.rows as f64, 1.0, 1.0 / self.reynolds)
    }

    /// The channel of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        let (rows, reynolds, numerics) = (count(config, 1.0), config.flow.reynolds, Numerics::from_config(config));
        Self { rows, reynolds, numerics, ..Default::default() }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let kinematic_viscosity = 1.0 / self.reynolds;
        Parts {
            name: "poiseuille",
            lattice: Lattice::channel(self.columns, self.rows, self.numerics.wall_rows),
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: kinematic_viscosity,
            body_force: BodyForce::Uniform(8.0 * kinematic_viscosity),
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Poiseuille { velocity: 1.0, kinematic_viscosity, height: 1.0 },
        }
        .build(|_| [0.0; 3])
    }
}
