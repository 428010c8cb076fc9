//! Plane Couette flow between two walls, started from rest by the moving upper wall (Morris, Fox and Zhu 1997).
//!
//! Velocity of the upper wall, density and height are 1, so the Reynolds number is 1/viscosity. Coordinates as in
//! [`super::poiseuille`].

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::{Exact, Scene};
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The channel and its resolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Couette {
    /// Fluid particles across the channel.
    pub rows: usize,
    /// Particles along the channel.
    pub columns: usize,
    /// Velocity of the upper wall * height / kinematic viscosity.
    pub reynolds: f64,
    pub numerics: Numerics,
}

impl Couette {
    /// The channel of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        let (rows, reynolds, numerics) = (count(config, 1.0), config.flow.reynolds, Numerics::from_config(config));
        Self { rows, columns: 12, reynolds, numerics }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let kinematic_viscosity = 1.0 / self.reynolds;
        Parts {
            name: "couette",
            lattice: Lattice::channel(self.columns, self.rows, self.numerics.wall_rows),
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: kinematic_viscosity,
            body_force: BodyForce::None,
            drive: None,
            lid: 1.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Couette { velocity: 1.0, kinematic_viscosity, height: 1.0 },
        }
        .build(|_| [0.0; 3])
    }
}
