//! The sections `[objective]` and `[optimise]`: how a design is evaluated, and the search for one.

use crate::config::formula::Formula;
use crate::config::memory_size::MemorySize;
use crate::config::range::{
    Range::{NotNegative, Positive, Within},
    MAX_STEPS,
};
use crate::config::run::Precision;
use crate::config::section::section;
use crate::error::BadInput;
use serde::{Deserialize, Serialize};
use serde_json::{json, Value};

section! {
    "objective.": Objective {
        kind: ObjectiveKind = ObjectiveKind::HeatOutflow;
        target_x: f64 = 0.9, NotNegative;
        window: f64 = 0.5, NotNegative;
        /// The mean over whole periods of a flow in time, instead of over `window`.
        #[serde(skip_serializing_if = "Option::is_none")]
        periods: Option<usize> = None, Within(1.0, 1e6);
        /// Their length, which may have the parameters of a shape; that of the objective's own course if not given.
        #[serde(skip_serializing_if = "Option::is_none")]
        period: Option<Formula> = None;
        samples: usize = 40, Within(1.0, MAX_STEPS);
        /// Which fields are interpolated, and from which particles, see [`crate::sph::interpolation`].
        interpolation: Interpolation = Interpolation::Flux;
        form: ObjectiveForm = ObjectiveForm::Flux;
        /// Which shapes a figure of shapes is about; empty: all that have it.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        shapes: Vec<usize> = vec![];
        #[serde(skip_serializing_if = "Goal::is_larger")]
        goal: Goal = Goal::Larger;
        /// Where a probe is: pressure, temperature or velocity at a point.
        #[serde(skip_serializing_if = "Option::is_none")]
        at: Option<Vec<f64>> = None;
        /// A weighted sum instead of `kind`.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        terms: Vec<Term> = vec![];
    }
}

/// What an objective, a term of it or a limit asks for: a kind of figure, of which shapes, or at which point.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    pub kind: ObjectiveKind,
    pub shapes: Vec<usize>,
    pub at: Option<Vec<f64>>,
}

impl Objective {
    /// The figure of an objective without terms.
    pub fn asked(&self) -> Asked {
        Asked { kind: self.kind, shapes: self.shapes.clone(), at: self.at.clone() }
    }

    /// `objective_kind` in records: the kind, or `terms` where it is their sum.
    pub fn recorded_kind(&self) -> Value {
        match self.terms.is_empty() {
            true => json!(self.kind),
            false => json!("terms"),
        }
    }
}

/// Whether an objective is to become larger or smaller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Goal {
    Larger,
    Smaller,
}

impl Goal {
    /// 1 for an objective that is to become larger, -1 for one that is to become smaller.
    pub fn sign(self) -> f64 {
        match self {
            Self::Larger => 1.0,
            Self::Smaller => -1.0,
        }
    }
}

impl Goal {
    fn is_larger(&self) -> bool {
        *self == Self::Larger
    }
}

/// A term of an objective that is a sum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Term {
    pub kind: ObjectiveKind,
    pub shapes: Vec<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<Vec<f64>>,
    pub weight: f64,
}

impl Default for Term {
    fn default() -> Self {
        Self { kind: ObjectiveKind::FlowRate, shapes: vec![], at: None, weight: 1.0 }
    }
}

impl Term {
    pub fn asked(&self) -> Asked {
        Asked { kind: self.kind, shapes: self.shapes.clone(), at: self.at.clone() }
    }
}

/// A figure, or a property of shapes, that is held within limits while the objective is improved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LimitEntry {
    pub kind: ObjectiveKind,
    pub shapes: Vec<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
}

impl Default for LimitEntry {
    fn default() -> Self {
        Self { kind: ObjectiveKind::Area, shapes: vec![], at: None, at_least: None, at_most: None }
    }
}

impl LimitEntry {
    pub fn asked(&self) -> Asked {
        Asked { kind: self.kind, shapes: self.shapes.clone(), at: self.at.clone() }
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
    /// Force of the fluid on shapes along x, and along y.
    Drag,
    Lift,
    LiftOverDrag,
    /// Torque of the fluid on shapes about their centres (centroids of those that have no `centre`), around z.
    Torque,
    /// Heat that leaves shapes.
    ShapeHeat,
    PressureDrop,
    Dissipation,
    /// Probes: pressure, temperature and velocity at a point. Where no side has an outflow the pressure is that less its mean over the
    /// section that is farthest from shapes.
    Pressure,
    Temperature,
    VelocityX,
    VelocityY,
    VelocityZ,
    /// Area of shapes, and the smallest distance between them or to walls; for limits.
    Area,
    Distance,
    /// Volume of shapes in three dimensions; for limits.
    Volume,
}

impl ObjectiveKind {
    /// Whether only fixed particles around shapes have this figure.
    pub fn is_of_shapes(self) -> bool {
        !matches!(self, Self::HeatOutflow | Self::OutletTemperature | Self::WallHeat | Self::FlowRate)
    }

    /// Whether it is a property of shapes that needs no flow.
    pub fn is_of_outlines(self) -> bool {
        matches!(self, Self::Area | Self::Distance)
    }

    /// Whether it is a field at a point.
    pub fn is_probe(self) -> bool {
        matches!(self, Self::Pressure | Self::Temperature | Self::VelocityX | Self::VelocityY | Self::VelocityZ)
    }
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

section! {
    "optimise.": Optimise {
        method: OptimiserName = OptimiserName::LBfgsB;
        search: Search = Search::Fixed;
        epochs: usize = 25, Within(1.0, 1e6);
        learning_rate: f64 = 3e-3, Positive;
        smoothing: f64 = 0.05, NotNegative;
        gradient: GradientMode = GradientMode::Segments;
        /// Memory budget of the gradient, from which its schedule follows (see [`crate::adjoint::schedule`]).
        memory: MemorySize = MemorySize(300_000_000);
        store: Precision = Precision::F64;
        segment: usize = 0, Within(0.0, MAX_STEPS);
        horizon: usize = 200, Within(1.0, MAX_STEPS);
        /// Limit of the derivative by the state relative to the objective's own terms, see
        /// [`crate::adjoint::schedule::Schedule::clip`]; 0: no limit.
        clip: f64 = 0.0, NotNegative;
        difference: f64 = 0.05, Within(1e-6, 0.5);
        /// Starts over which `ensemble` averages.
        members: usize = 8, Within(2.0, 1000.0);
        dynamics: DynamicsName = DynamicsName::Solver;
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptimiserName {
    /// Kingma and Ba (2015).
    Adam,
    /// Limited-memory quasi-Newton steps within the bounds (Byrd, Lu, Nocedal and Zhu 1995).
    LBfgsB,
}

/// The method that evaluates designs during the search. The result is shown with the scene's own method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Search {
    /// The method with the same equations on fixed particles, with the gradient of the steady state; the scene's own
    /// method if it has no such counterpart.
    Fixed,
    Scene,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum GradientMode {
    Segments,
    Taped,
    Truncated,
    /// Of the steady state, for fixed particles: one state, no run.
    Steady,
    /// Of runs with numbers a little larger and smaller, for the few numbers of shapes.
    Differences,
    /// The mean of these over several starts, whose particles are disordered in different ways, with its standard error.
    Ensemble,
}

impl GradientMode {
    /// Whether gradients are found from runs alone, without adjoints.
    pub fn is_of_runs(self) -> bool {
        matches!(self, Self::Differences | Self::Ensemble)
    }
}

/// What judges walls while the optimiser searches. What it finds is judged by the solver in any case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DynamicsName {
    Solver,
    /// A learned model, from frames that the solver makes.
    Surrogate,
    /// First the surrogate, then, from the best wall that it found, the solver.
    Both,
}

impl Optimise {
    /// Checks that the gradient is limited only if it goes back through a run, and that states are rounded only if the
    /// schedule keeps every state of a run in double precision.
    pub fn check(&self, precision: Precision) -> Result<(), BadInput> {
        let has_none = self.gradient == GradientMode::Steady || self.gradient.is_of_runs();
        if has_none && self.clip > 0.0 {
            return Err(BadInput::at(
                "optimise.clip",
                "optimise.clip with a gradient that does not go back through a run",
            )
            .allowed("0 with optimise.gradient = steady, differences or ensemble")
            .advice("optimise.gradient=segments, or optimise.clip=0"));
        }
        let every_state = self.gradient != GradientMode::Taped && self.segment <= 1;
        if self.store == Precision::F32 && precision == Precision::F64 && !every_state {
            return Err(BadInput::at(
                "optimise.store",
                "optimise.store = f32 with states that steps are run again from",
            )
            .allowed("f32 only where every state is kept: a run from a rounded state is another run")
            .advice("optimise.segment=0 (chosen by memory) and a gradient that is not taped, or optimise.store=f64"));
        }
        Ok(())
    }
}
