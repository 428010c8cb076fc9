//! Reverse Poiseuille flow (Backer et al. 2005): opposite forces in the two halves of a periodic box.
//!
//! Length, height of a half, density and reference velocity are 1. The fluid is at rest at y = 0, 1, 2, and each half
//! is plane Poiseuille flow with a steady centre line of force Re / 8. In three dimensions the box is half as deep as
//! long, and periodic in z too (LagrangeBench's data set), with the same exact solution.

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::{Exact, Scene};
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The flow and its resolution. Defaults: LagrangeBench's 2D data set (3200 particles, viscosity 0.1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReversePoiseuille {
    /// 2 or 3.
    pub dimension: usize,
    /// Particles across a half, and along the box.
    pub per_height: usize,
    /// Reference velocity * length 1 / kinematic viscosity.
    pub reynolds: f64,
    /// Acceleration along x in the lower half, and along -x in the upper one.
    pub force: f64,
    pub numerics: Numerics,
}

impl Default for ReversePoiseuille {
    fn default() -> Self {
        let numerics =
            Numerics { background_pressure_factor: 0.05, transport_velocity: 0.0, jitter: 0.1, ..Default::default() };
        Self { dimension: 2, per_height: 40, reynolds: 10.0, force: 1.0, numerics }
    }
}

impl ReversePoiseuille {
    /// The flow of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        Self {
            dimension: config.dimension(),
            per_height: count(config, 1.0),
            reynolds: config.flow.reynolds,
            force: config.fluid.body_force,
            numerics: Numerics::from_config(config),
        }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let kinematic_viscosity = 1.0 / self.reynolds;
        let velocity = self.force * self.reynolds / 8.0;
        let cells = [self.per_height, 2 * self.per_height, self.per_height / 2];
        Parts {
            name: if self.dimension == 2 { "reverse-poiseuille" } else { "reverse-poiseuille-3d" },
            lattice: Lattice::new(self.dimension, 1.0 / self.per_height as f64, cells),
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: kinematic_viscosity,
            body_force: BodyForce::Reversing { strength: self.force, turn: 1.0 },
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::ReversePoiseuille { velocity, kinematic_viscosity, height: 1.0 },
        }
        .build(|_| [0.0; 3])
    }
}
