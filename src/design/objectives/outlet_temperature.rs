//! The mixed temperature of the outflow relative to the inlet:
//!
//! T_mix - T_in = sum over the targets of rho u_x (T - T_in) / sum over the targets of rho u_x,
//!
//! which is the outflowing heat per mass (times the heat capacity: enthalpy). A wall that lets less fluid through, but
//! heats it more, is good by this objective and bad by [`super::HeatOutflow`].

use super::{Outlet, Samples};
use crate::adjoint::{Fields, Objective};
use candle_core::{Result, Tensor};

/// Mean of the mixed temperature over the samples, in units of temperature.
#[derive(Debug, Clone)]
pub struct OutletTemperature {
    pub outlet: Outlet,
    pub samples: Samples,
}

impl Objective for OutletTemperature {
    fn name(&self) -> &str {
        "outlet temperature"
    }

    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.weight(step)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        let flows = self.outlet.flows(fields)?;
        flows.heat.div(&flows.mass)
    }
}
