//! The section `[objective]`: how a design is evaluated.

use crate::config::range::{
    Range::{NotNegative, Within},
    MAX_STEPS,
};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "objective.": Objective {
        kind: ObjectiveKind = ObjectiveKind::HeatOutflow;
        target_x: f64 = 0.9, NotNegative;
        window: f64 = 0.5, NotNegative;
        samples: usize = 40, Within(1.0, MAX_STEPS);
        /// Which fields are interpolated, and from which particles, see [`crate::sph::interpolation`].
        interpolation: Interpolation = Interpolation::Flux;
        form: ObjectiveForm = ObjectiveForm::Flux;
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectiveKind {
    /// The heat that the fluid carries through the target column.
    HeatOutflow,
    /// The mixed temperature of the fluid at the targets: its flux of u T over its flux of u.
    OutletTemperature,
    /// The heat that the walls give to the fluid upstream of the targets.
    WallHeat,
    FlowRate,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectiveForm {
    Flux,
    Sum,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    Fluid,
    FluidAndWalls,
    Flux,
}
