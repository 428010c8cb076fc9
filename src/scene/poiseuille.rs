//! Plane Poiseuille flow: between two walls at rest, started from rest by a constant force (Morris, Fox and Zhu 1997).
//!
//! Reference velocity (the steady centre line), density and height are 1, so the Reynolds number is 1/viscosity and
//! the force 8/Re. Coordinates as in the heated channel: y = 0 on the bottom wall's surface, periodic in x.

use super::flow::{Exact, Flow, Numerics, Parts};
use crate::lanes::Real;
use crate::sph::body_force::BodyForce;

/// Rows of dummy particles in each wall: the kernel reaches three spacings.
const WALL_ROWS: usize = 3;

/// The channel and how it is resolved. Defaults: JAX-SPH's case (height 30 spacings, length 12, Re = 0.0125).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Poiseuille {
    /// Fluid particles across the channel.
    pub rows: usize,
    /// Particles along the channel.
    pub columns: usize,
    /// Steady velocity of the centre line * height / kinematic viscosity.
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

impl Default for Poiseuille {
    fn default() -> Self {
        Self {
            rows: 30,
            columns: 12,
            reynolds: 0.0125,
            cfl: 0.25,
            diffusion_number: 0.25,
            time_step: None,
            sound_speed_factor: 10.0,
            background_pressure_factor: 0.0,
            transport_velocity: 1.0,
            jitter: 0.0,
            skin: 0.2,
            seed: 0,
        }
    }
}

impl Poiseuille {
    /// The largest time step, or the given one.
    pub fn time_step(&self) -> f64 {
        self.numerics().step(1.0 / self.rows as f64, 1.0, 1.0 / self.reynolds)
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
        let kinematic_viscosity = 1.0 / self.reynolds;
        Parts {
            name: "poiseuille",
            dimension: 2,
            cells: [self.columns, self.rows + 2 * WALL_ROWS, 1],
            wall_rows: WALL_ROWS,
            spacing: 1.0 / self.rows as f64,
            velocity: 1.0,
            kinematic_viscosity,
            numerics: self.numerics(),
            body_force: BodyForce::Uniform(8.0 * kinematic_viscosity),
            exact: Exact::Poiseuille { velocity: 1.0, kinematic_viscosity, height: 1.0 },
        }
        .build(|_| [0.0; 3])
    }
}
