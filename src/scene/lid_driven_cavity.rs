//! Lid-driven cavity: a square (Ghia, Ghia and Shin 1982) or cubic box of fluid whose upper wall moves along x.
//!
//! Side, density and velocity of the lid are 1. The box has its corner at 0, 0 and three rows of dummy particles on all
//! sides (more for a wider kernel). It is periodic in x for the lid's particles; walls separate the fluid from its
//! images.

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::{Exact, Scene};
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The cavity and its resolution. Defaults: LagrangeBench's 2D data set (50 x 50 fluid particles, Re = 100).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidDrivenCavity {
    /// 2, or 3: a cube with walls in front and behind.
    pub dimension: usize,
    /// Fluid particles along each side.
    pub per_side: usize,
    /// Velocity of the lid * side / kinematic viscosity.
    pub reynolds: f64,
    pub numerics: Numerics,
}

impl Default for LidDrivenCavity {
    fn default() -> Self {
        let numerics =
            Numerics { background_pressure_factor: 0.01, transport_velocity: 0.0, jitter: 0.1, ..Default::default() };
        Self { dimension: 2, per_side: 50, reynolds: 100.0, numerics }
    }
}

impl LidDrivenCavity {
    /// The cavity of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        let (reynolds, numerics) = (config.flow.reynolds, Numerics::from_config(config));
        Self { dimension: config.dimension(), per_side: count(config, 1.0), reynolds, numerics }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let walls = self.numerics.wall_rows;
        let cells = self.per_side + 2 * walls;
        Parts {
            name: if self.dimension == 2 { "lid-driven-cavity" } else { "lid-driven-cavity-3d" },
            lattice: Lattice {
                wall_rows: [walls, walls, if self.dimension == 2 { 0 } else { walls }],
                periodic: [true, false, false],
                ..Lattice::new(self.dimension, 1.0 / self.per_side as f64, [cells; 3])
            },
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: 1.0 / self.reynolds,
            body_force: BodyForce::None,
            drive: None,
            lid: 1.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Unknown,
        }
        .build(|_| [0.0; 3])
    }
}
