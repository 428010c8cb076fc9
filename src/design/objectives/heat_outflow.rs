//! The outflowing heat.
//!
//! Q = sum over the targets of rho u_x (T - T_in) (eq. 12 of the original report), times the spacing of the targets,
//! which makes it the flux integral over the outlet section in units of rho u T, comparable between resolutions. It is
//! taken at the last step, or averaged over evenly spaced steps of a window at the end of the run.

use super::{Outlet, Samples};
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of Q over the samples.
#[derive(Debug, Clone)]
pub struct HeatOutflow {
    pub outlet: Outlet,
    /// Factor on the sum over targets: their spacing for the flux form, 1 for the report's sum.
    pub scale: f64,
    pub samples: Samples,
}

impl Objective for HeatOutflow {
    fn name(&self) -> &str {
        "heat outflow"
    }

    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.weight(step)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        self.outlet.flows(fields)?.heat.affine(self.scale, 0.0)
    }
}
