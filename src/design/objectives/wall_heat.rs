//! The heat that the walls give to the fluid per time, as [`crate::sph::solver::Solver::wall_heat_flux`] has it: of moving
//! particles what conduction brings to them upstream of the targets, of fixed ones the flux through the hot wall.
//!
//! In a steady flow it is the outflowing heat, [`super::HeatOutflow`]; in one that is not, it counts what is stored as well.

use super::Samples;
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of the walls' heat of the states that are looked at, in units of density * temperature * volume per time.
#[derive(Debug, Clone)]
pub struct WallHeat {
    pub samples: Samples,
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
            Some(heat) => Ok(heat.clone()),
            None => candle_core::bail!("fields without the walls' heat"),
        }
    }
}
