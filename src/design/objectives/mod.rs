//! Objectives of designs, which are maximised. They use fields and do not depend on the solver.
//!
//! A new objective is a [`Quantity`], with a line in [`of_config`] and in [`Figure::of_config`].

pub mod mean;
pub mod outlet;

pub use mean::{Mean, Quantity, Samples};
pub use outlet::Outlet;

use crate::adjoint::Objective;
use crate::config::scene::{Config, ObjectiveForm, ObjectiveKind};
use std::sync::Arc;

/// The objective of a configuration.
pub fn of_config(config: &Config, outlet: Outlet, samples: Samples) -> Arc<dyn Objective + Send> {
    let of = match config.objective.kind {
        ObjectiveKind::HeatOutflow => {
            let scale = match config.objective.form {
                ObjectiveForm::Flux => outlet.spacing,
                ObjectiveForm::Sum => 1.0,
            };
            Quantity::HeatOutflow { outlet, scale }
        }
        ObjectiveKind::OutletTemperature => Quantity::OutletTemperature { outlet },
        ObjectiveKind::WallHeat => Quantity::WallHeat { depth: config.depth() },
        ObjectiveKind::FlowRate => Quantity::FlowRate { outlet },
    };
    Arc::new(Mean { of, samples })
}

/// How the values of an objective are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The name in tables.
    pub name: &'static str,
    pub symbol: &'static str,
    pub quantity: &'static str,
    pub unit: &'static str,
    /// The reported figure over the value.
    pub factor: f64,
}

impl Figure {
    /// The figure of a configuration's objective.
    pub fn of_config(config: &Config) -> Self {
        let (name, symbol, quantity, unit) = match config.objective.kind {
            ObjectiveKind::HeatOutflow => ("heat outflow", "Q", "outflowing heat", "rho u T length"),
            ObjectiveKind::WallHeat => ("wall heat", "W", "heat from the walls", "rho u T length"),
            ObjectiveKind::FlowRate => ("flow rate", "V", "flow rate", "u length"),
            ObjectiveKind::OutletTemperature => {
                ("outlet temperature", "T", "mixed outlet temperature above the inlet's", "scene units")
            }
        };
        // The figure is in flux form, whatever the loss uses.
        let is_sum = config.objective.form == ObjectiveForm::Sum;
        let factor = match config.objective.kind == ObjectiveKind::HeatOutflow && is_sum {
            true => config.resolution.dx,
            false => 1.0,
        };
        Self { name, symbol, quantity, unit, factor }
    }
}
