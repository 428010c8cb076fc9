//! The section `[objective]`: how a design is evaluated.

use crate::config::range::{
    Range::{NotNegative, Within},
    MAX_STEPS,
};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "objective.": Objective {
        /// The quantity that is maximised.
        kind: ObjectiveKind = ObjectiveKind::HeatOutflow;
        /// Column of target points where the outflowing heat is measured.
        target_x: f64 = 0.9, NotNegative;
        /// Average Q over this last part of the run, in time units; 0 takes the last step.
        window: f64 = 0.5, NotNegative;
        /// Samples of Q in the window (evenly spaced steps).
        samples: usize = 40, Within(1.0, MAX_STEPS);
        /// Which fields are interpolated, and from which particles, see [`crate::sph::interpolation`].
        interpolation: Interpolation = Interpolation::Flux;
        /// What the loss uses: the flux integral, or the plain sum over the targets as in the report.
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
    /// The volume that flows through the target column.
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
