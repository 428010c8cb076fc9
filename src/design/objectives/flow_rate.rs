//! The volume that flows through the targets per time (and depth). In a driven flow it is larger if the walls resist
//! less.

use super::{Outlet, Samples};
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of the flow rate over the samples.
#[derive(Debug, Clone)]
pub struct FlowRate {
    pub outlet: Outlet,
    pub samples: Samples,
}

impl Objective for FlowRate {
    fn name(&self) -> &str {
        "flow rate"
    }

    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.weight(step)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        self.outlet.flows(fields)?.volume.affine(self.outlet.spacing, 0.0)
    }
}
