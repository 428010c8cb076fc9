//! The heat that the walls give to the fluid per time, as [`crate::sph::solver::Solver::wall_heat_flux`] has it: what
//! conduction brings to the particles upstream of the targets.
//!
//! In a steady flow it is the outflowing heat, [`super::HeatOutflow`], to the formulation's heat balance; in one that is not,
//! it counts what is stored as well. (A fit of the temperature's slope at the wall itself is no objective: it misses 5 to 8 %
//! at the ends of the hot section, and an optimiser finds walls that are good for the fit.)

use super::Samples;
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of the walls' heat of the states that are looked at, in units of density * temperature * area per time.
#[derive(Debug, Clone)]
pub struct WallHeat {
    pub samples: Samples,
    /// Of what is simulated: heat is per depth.
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
