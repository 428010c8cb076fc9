//! The heat per time that the walls give to the fluid, see [`crate::sph::solver::Solver::wall_heat_flux`]: the heat
//! that conduction brings to the particles upstream of the targets.
//!
//! In a steady flow it equals the outflowing heat, [`super::HeatOutflow`], up to the error of the heat balance;
//! otherwise it includes stored heat. (A fit of the temperature's slope at the wall itself is no suitable objective: it
//! misses 5 to 8 % at the ends of the hot section, and an optimiser finds walls that exploit the fit.)

use super::Samples;
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of the walls' heat over the samples, in units of density * temperature * area per time.
#[derive(Debug, Clone)]
pub struct WallHeat {
    pub samples: Samples,
    /// Depth of the simulated domain, because heat is per depth.
    pub depth: f64,
}

impl Objective for WallHeat {
    fn name(&self) -> &str {
        "wall heat"
    }

    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.weight(step)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        match &fields.wall_heat {
            Some(heat) => heat.affine(1.0 / self.depth, 0.0),
            None => candle_core::bail!("fields without the walls' heat"),
        }
    }
}
