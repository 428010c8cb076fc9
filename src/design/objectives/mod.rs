//! What a design is judged by: the larger the better. Objectives see fields, and know no solver.
//!
//! Another one is a file here that implements [`Objective`], and a line in [`of_config`] and in
//! [`Figure::of_config`].

pub mod flow_rate;
pub mod heat_outflow;
pub mod outlet;
pub mod outlet_temperature;
pub mod wall_heat;

pub use flow_rate::FlowRate;
pub use heat_outflow::HeatOutflow;
pub use outlet::Outlet;
pub use outlet_temperature::OutletTemperature;
pub use wall_heat::WallHeat;

use crate::adjoint::Objective;
use crate::config::scene::{Config, ObjectiveForm, ObjectiveKind};
use std::collections::BTreeMap;
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

/// How an objective's values are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    pub symbol: &'static str,
    pub quantity: &'static str,
    pub unit: &'static str,
    /// Reported figure over value.
    pub factor: f64,
}

impl Figure {
    /// That of a configuration's objective.
    pub fn of_config(config: &Config) -> Self {
        match config.objective.kind {
            ObjectiveKind::HeatOutflow => Self {
                symbol: "Q",
                quantity: "outflowing heat",
                unit: "rho u T length",
                // In flux form, whatever the loss counts.
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

/// Which states of a run an objective looks at: the weight of the state after each of these steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Samples(pub BTreeMap<usize, f64>);

impl Samples {
    /// `count` evenly spaced samples among the last `window` steps of `steps`, the last step among them, equally weighted.
    pub fn window(steps: usize, window: usize, count: usize) -> Self {
        let count = count.min(window.max(1)).max(1);
        let chosen: std::collections::BTreeSet<usize> =
            (0..count).map(|k| steps - k * window / count).filter(|&s| s > 0).collect();
        let weight = 1.0 / chosen.len().max(1) as f64;
        Self(chosen.into_iter().map(|s| (s, weight)).collect())
    }

    /// The weight of the state after `step` steps, if it is looked at.
    pub fn weight(&self, step: usize) -> Option<f64> {
        self.0.get(&step).copied()
    }
}
