//! Taylor and Green's decaying vortices (Taylor and Green 1937), in a periodic box without walls.
//!
//! Reference velocity, density and (in two dimensions) box length are 1, so the Reynolds number is 1/viscosity. Two
//! dimensions: the unit box, an exact solution. Three: a box of 2 pi with u = sin x cos y cos z, v = -cos x sin y cos z
//! (Brachet et al. 1983); no closed form, but its energy starts to decay as exp(-6 nu t).

use super::flow::{Exact, Flow, Numerics, Parts};
use crate::lanes::Real;
use crate::sph::body_force::BodyForce;
use std::f64::consts::PI;

/// The vortices and how they are resolved. Defaults: LagrangeBench's 2D data set (2500 particles, Re = 100), and the
/// tenth of a spacing of disorder of JAX-SPH's case: a perfect lattice is stretched into strings of particles before it
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
    /// Acoustic limit of the time step: dt <= cfl dx / (c + U).
    pub cfl: f64,
    /// Diffusive limit: dt <= diffusion_number dx^2 / nu.
    pub diffusion_number: f64,
    /// The time step itself, instead of the limits.
    pub time_step: Option<f64>,
    /// Sound speed c over reference velocity U.
    pub sound_speed_factor: f64,
    /// Background pressure over density c^2.
    pub background_pressure_factor: f64,
    /// 0 (off) ... 1 (Adami, Hu and Adams 2013, at the strength that it has at CFL 0.25).
    pub transport_velocity: f64,
    /// Random displacement of the fluid particles at the start, standard deviation in spacings.
    pub jitter: f64,
    /// Extra reach of the neighbour list, in spacings.
    pub skin: f64,
    pub seed: u64,
}

impl Default for TaylorGreen {
    fn default() -> Self {
        Self {
            dimension: 2,
            per_side: 50,
            reynolds: 100.0,
            cfl: 0.25,
            diffusion_number: 0.25,
            time_step: None,
            sound_speed_factor: 10.0,
            background_pressure_factor: 0.0,
            transport_velocity: 1.0,
            jitter: 0.1,
            skin: 0.2,
            seed: 0,
        }
    }
}

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
        self.numerics().step(self.size() / self.per_side as f64, 1.0, 1.0 / self.reynolds)
    }

    fn numerics(&self) -> Numerics {
        Numerics {
            cfl: self.cfl,
            diffusion_number: self.diffusion_number,
            time_step: self.time_step,
            sound_speed_factor: self.sound_speed_factor,
            background_pressure_factor: self.background_pressure_factor,
            transport_velocity: self.transport_velocity,
            jitter: self.jitter,
            skin: self.skin,
            seed: self.seed,
        }
    }

    pub fn build<R: Real>(&self) -> Flow<R> {
        assert!((2..=3).contains(&self.dimension), "Taylor and Green's vortices have 2 or 3 dimensions");
        let (spacing, kinematic_viscosity) = (self.size() / self.per_side as f64, 1.0 / self.reynolds);
        let parts = Parts {
            name: if self.dimension == 2 { "taylor-green" } else { "taylor-green-3d" },
            dimension: self.dimension,
            cells: [self.per_side; 3],
            wall_rows: 0,
            spacing,
            velocity: 1.0,
            kinematic_viscosity,
            numerics: self.numerics(),
            body_force: BodyForce::None,
            exact: match self.dimension {
                2 => Exact::TaylorGreen { velocity: 1.0, kinematic_viscosity },
                _ => Exact::Unknown,
            },
        };
        let exact = parts.exact;
        parts.build(|[x, y, z]| {
            exact
                .velocity([x, y, z], 0.0)
                .unwrap_or_else(|| [x.sin() * y.cos() * z.cos(), -x.cos() * y.sin() * z.cos(), 0.0])
        })
    }
}
