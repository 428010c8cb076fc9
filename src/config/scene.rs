//! The configuration of a scene.
//!
//! Units are those of the scene (the built-in channel is dimensionless: length 1, reference velocity 1, density 1).
//! Every section has defaults, so a file needs only what differs; unknown keys are errors. `data/scenes/*.toml` has the
//! built-in scenes with a comment on every key.

pub use crate::config::custom::{Fields, Region, ShapeEntry, VariableEntry};
pub use crate::config::design::{Design, DesignWalls, ParametrisationName, ShapeName};
pub use crate::config::device::Kernels;
pub use crate::config::discretisation::{KernelName, Resolution, Start, Time};
pub use crate::config::fluid::{BodyForceRegion, DriveName, Flow, Fluid, Heat, UpperWall};
pub use crate::config::geometry::{Channel, HotIsotherm, MassConvention, Slip, Tank, Wall, Water};
pub use crate::config::method::consistent::{Consistent, IntegratorName, ShiftName};
pub use crate::config::method::fixed::Fixed;
pub use crate::config::method::standard::{DensityEquation, DensityGradient, FluxName, Standard, ViscousPairs};
pub use crate::config::method::Method;
pub use crate::config::optimise::{Asked, Goal, LimitEntry, Term};
pub use crate::config::optimise::{DynamicsName, GradientMode, Interpolation, Objective, ObjectiveForm, ObjectiveKind};
pub use crate::config::optimise::{Optimise, OptimiserName, Search};
pub use crate::config::run::{Output, Precision, Run};
pub use crate::config::surrogate::{FirstFrames, Surrogate, Trust};
use serde::{Deserialize, Serialize};

/// A complete, resolved configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub scene: Family,
    /// Custom scenes: the box, the shapes in it, and the initial fields.
    pub region: Region,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shapes: Vec<ShapeEntry>,
    /// Numbers of shapes that an optimiser may change.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub variables: Vec<VariableEntry>,
    /// Figures that are held within limits by an optimiser.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<LimitEntry>,
    pub initial: Fields,
    /// The exact solution of a scene of one's own.
    pub exact: Fields,
    pub resolution: Resolution,
    pub channel: Channel,
    pub flow: Flow,
    pub heat: Heat,
    pub tank: Tank,
    pub water: Water,
    pub fluid: Fluid,
    #[serde(deserialize_with = "crate::config::method::section")]
    pub method: Method,
    pub wall: Wall,
    pub time: Time,
    pub objective: Objective,
    pub design: Design,
    pub optimise: Optimise,
    pub surrogate: Surrogate,
    pub run: Run,
    pub output: Output,
}

/// The scene family, in the order of [`SCENES`](crate::config::builtin::SCENES).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    #[default]
    HeatedChannel,
    #[serde(rename = "heated-channel-3d")]
    HeatedChannel3d,
    TaylorGreen,
    #[serde(rename = "taylor-green-3d")]
    TaylorGreen3d,
    Poiseuille,
    Couette,
    ReversePoiseuille,
    #[serde(rename = "reverse-poiseuille-3d")]
    ReversePoiseuille3d,
    LidDrivenCavity,
    #[serde(rename = "lid-driven-cavity-3d")]
    LidDrivenCavity3d,
    Slab,
    IsothermalChannel,
    DamBreak,
    #[serde(rename = "dam-break-3d")]
    DamBreak3d,
    FallingBlock,
    HydrostaticTank,
    /// A custom scene: a box and shapes, from the configuration alone.
    Custom,
}

impl Family {
    /// Whether the scene is water in a tank with a free surface.
    pub fn has_surface(self) -> bool {
        matches!(self, Self::DamBreak | Self::DamBreak3d | Self::FallingBlock | Self::HydrostaticTank)
    }

    pub fn has_design(self) -> bool {
        matches!(self, Self::HeatedChannel | Self::HeatedChannel3d)
    }
}
