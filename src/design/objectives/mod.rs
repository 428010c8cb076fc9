//! Objectives of designs, which are maximised. They use fields and do not depend on the solver.
//!
//! A new objective needs a file here that implements [`Objective`], and lines in [`of_config`] and
//! [`Figure::of_config`].

pub mod flow_rate;
pub mod heat_outflow;
pub mod outlet;
pub mod outlet_temperature;
pub mod samples;
pub mod wall_heat;

pub use flow_rate::FlowRate;
pub use heat_outflow::HeatOutflow;
pub use outlet::Outlet;
pub use outlet_temperature::OutletTemperature;
pub use samples::Samples;
pub use wall_heat::WallHeat;

use crate::adjoint::Objective;
use crate::config::scene::{Config, ObjectiveForm, ObjectiveKind};
use std::sync::Arc;

/// The objective of a configuration.
pub fn of_config(config: &Config, outlet: Outlet, samples: Samples) -> Arc<dyn Objective + Send> {
    match config.objective.kind {
        ObjectiveKind::HeatOutflow => {
            let scale = match config.objective.form {
                ObjectiveForm::Flux => outlet.spacing,
                ObjectiveForm::Sum => 1.0,
            };
            Arc::new(HeatOutflow { outlet, scale, samples })
        }
        ObjectiveKind::OutletTemperature => Arc::new(OutletTemperature { outlet, samples }),
        ObjectiveKind::WallHeat => Arc::new(WallHeat { samples, depth: config.depth() }),
        ObjectiveKind::FlowRate => Arc::new(FlowRate { outlet, samples }),
    }
}

/// How the values of an objective are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    pub symbol: &'static str,
    pub quantity: &'static str,
    pub unit: &'static str,
    /// The reported figure over the value.
    pub factor: f64,
}

impl Figure {
    /// The figure of a configuration's objective.
    pub fn of_config(config: &Config) -> Self {
        match config.objective.kind {
            ObjectiveKind::HeatOutflow => Self {
                symbol: "Q",
                quantity: "outflowing heat",
                unit: "rho u T length",
                // The figure is in flux form, whatever the loss uses.
                factor: match config.objective.form {
                    ObjectiveForm::Flux => 1.0,
                    ObjectiveForm::Sum => config.resolution.dx,
                },
            },
            ObjectiveKind::WallHeat => {
                Self { symbol: "W", quantity: "heat from the walls", unit: "rho u T length", factor: 1.0 }
            }
            ObjectiveKind::FlowRate => Self { symbol: "V", quantity: "flow rate", unit: "u length", factor: 1.0 },
            ObjectiveKind::OutletTemperature => Self {
                symbol: "T",
                quantity: "mixed outlet temperature above the inlet's",
                unit: "scene units",
                factor: 1.0,
            },
        }
    }
}
