//! Lid-driven cavity: a square box of fluid whose upper wall moves along x (Ghia, Ghia and Shin 1982).
//!
//! Side, density and velocity of the lid are 1. The box has its corner at 0, 0 and three rows of dummy particles all
//! around; it is periodic in x, so that the lid's particles come in again (no fluid sees across: six rows are between).

use super::flow::{Exact, Flow, Numerics, Parts};
use super::poiseuille::WALL_ROWS;
use crate::numerics::lanes::Real;
use crate::sph::laws::body_force::BodyForce;

/// The cavity and how it is resolved. Defaults: LagrangeBench's 2D data set (50 x 50 fluid particles, Re = 100).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidDrivenCavity {
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
        Self { per_side: 50, reynolds: 100.0, numerics }
    }
}

impl LidDrivenCavity {
    pub fn build<R: Real>(&self) -> Flow<R> {
        let cells = self.per_side + 2 * WALL_ROWS;
        Parts {
            name: "lid-driven-cavity",
            dimension: 2,
            cells: [cells, cells, 1],
            wall_rows: [WALL_ROWS, WALL_ROWS, 0],
            periodic: [true, false, false],
            corner: [0.0; 3],
            lid: 1.0,
            spacing: 1.0 / self.per_side as f64,
            velocity: 1.0,
            kinematic_viscosity: 1.0 / self.reynolds,
            numerics: self.numerics,
            body_force: BodyForce::None,
            exact: Exact::Unknown,
        }
        .build(|_| [0.0; 3])
    }
}
