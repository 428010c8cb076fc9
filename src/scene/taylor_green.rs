//! Taylor and Green's decaying vortices (Taylor and Green 1937), in a periodic box without walls.
//!
//! Reference velocity, density and (in two dimensions) box length are 1, so the Reynolds number is 1/viscosity. In two
//! dimensions the unit box has an exact solution. In three dimensions, a box of 2 pi with u = sin x cos y cos z, v =
//! -cos x sin y cos z (Brachet et al. 1983) has none, but its energy starts to decay as exp(-6 nu t).

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::{Exact, Scene};
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;
use std::f64::consts::PI;

/// The vortices and their resolution. Defaults: LagrangeBench's 2D data set (2500 particles, Re = 100) with the
/// disorder of JAX-SPH's case, a tenth of a spacing. A perfect lattice is stretched into strings of particles before it
/// breaks up, which costs half of the energy (50 x 50 particles at t = 0.9: 0.32 of the exact energy is left, with
/// disorder 0.90).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaylorGreen {
    /// 2 or 3.
    pub dimension: usize,
    /// Particles along each side of the box.
    pub per_side: usize,
    /// Reference velocity * length 1 / kinematic viscosity.
    pub reynolds: f64,
    pub numerics: Numerics,
}

impl Default for TaylorGreen {
    fn default() -> Self {
        Self { dimension: 2, per_side: 50, reynolds: 100.0, numerics: Numerics { jitter: 0.1, ..Default::default() } }
    }
}

/// Smallest initial displacement in the consistent method. In an exact lattice that is stretched, each particle is
/// drawn equally from both sides, so no shift acts, and the particles stay in strings until the fit fails.
const LEAST_JITTER: f64 = 0.02;

impl TaylorGreen {
    /// Length of the box.
    pub fn size(&self) -> f64 {
        if self.dimension == 2 {
            1.0
        } else {
            2.0 * PI
        }
    }

    /// The largest time step, or the given one.
    pub fn time_step(&self) -> f64 {
        self.numerics.step(self.size() / self.per_side as f64, 1.0, 1.0 / self.reynolds)
    }

    /// The vortices of a checked configuration, in 2 or 3 dimensions.
    pub fn from_config(config: &Config) -> Self {
        let (dimension, reynolds) = (config.dimension(), config.flow.reynolds);
        let scene = Self { dimension, reynolds, numerics: Numerics::from_config(config), ..Default::default() };
        Self { per_side: count(config, scene.size()), ..scene }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        assert!((2..=3).contains(&self.dimension), "Taylor and Green's vortices have 2 or 3 dimensions");
        let kinematic_viscosity = 1.0 / self.reynolds;
        let spacing = self.size() / self.per_side as f64;
        let mut numerics = self.numerics;
        if numerics.consistent.is_some() {
            numerics.jitter = numerics.jitter.max(LEAST_JITTER);
        }
        Parts {
            name: if self.dimension == 2 { "taylor-green" } else { "taylor-green-3d" },
            lattice: Lattice::new(self.dimension, spacing, [self.per_side; 3]),
            numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: kinematic_viscosity,
            body_force: BodyForce::None,
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: match self.dimension {
                2 => Exact::TaylorGreen { velocity: 1.0, kinematic_viscosity },
                _ => Exact::Unknown,
            },
        }
        .build_with_pressure(|place| self.start(place), |place| self.start_pressure(place))
    }

    /// The initial pressure, which is that of the incompressible flow.
    pub fn start_pressure(&self, [x, y, z]: [f64; 3]) -> f64 {
        match self.dimension {
            2 => -0.25 * ((4.0 * PI * x).cos() + (4.0 * PI * y).cos()),
            _ => ((2.0 * x).cos() + (2.0 * y).cos()) * ((2.0 * z).cos() + 2.0) / 16.0,
        }
    }

    /// The initial velocity.
    pub fn start(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self.dimension {
            2 => {
                let ((sin_x, cos_x), (sin_y, cos_y)) = ((2.0 * PI * x).sin_cos(), (2.0 * PI * y).sin_cos());
                [-cos_x * sin_y, sin_x * cos_y, 0.0]
            }
            _ => [x.sin() * y.cos() * z.cos(), -x.cos() * y.sin() * z.cos(), 0.0],
        }
    }
}
