//! What a run is: every number of a scene, as read from TOML.
//!
//! Units are those of the scene (the built-in channel is dimensionless: length 1, reference velocity 1,
//! density 1). Every section has defaults, so a user's file needs only what differs; unknown keys are
//! errors. `data/scenes/*.toml` holds the built-in scenes with a comment on every key.

use crate::config::custom::{Initial, Region, ShapeEntry, VariableEntry};
use crate::config::device::DeviceName;
use crate::config::memory_size::MemorySize;
use serde::{Deserialize, Serialize};

/// A complete, resolved configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub scene: Family,
    /// Scenes of one's own: the box, the shapes in it, and what the fluid begins with.
    pub region: Region,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shapes: Vec<ShapeEntry>,
    /// Numbers of shapes that an optimiser may change.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub variables: Vec<VariableEntry>,
    pub initial: Initial,
    pub resolution: Resolution,
    pub channel: Channel,
    pub flow: Flow,
    pub heat: Heat,
    pub tank: Tank,
    pub water: Water,
    pub fluid: Fluid,
    pub wall: Wall,
    pub time: Time,
    pub objective: Objective,
    pub design: Design,
    pub optimise: Optimise,
    pub surrogate: Surrogate,
    pub run: Run,
    pub output: Output,
}

/// The scene family; one file per family in `src/scene/`.
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
    /// A box and shapes, from the configuration alone.
    Custom,
}

impl Family {
    /// What configurations call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::HeatedChannel => "heated-channel",
            Self::HeatedChannel3d => "heated-channel-3d",
            Self::TaylorGreen => "taylor-green",
            Self::TaylorGreen3d => "taylor-green-3d",
            Self::Poiseuille => "poiseuille",
            Self::Couette => "couette",
            Self::ReversePoiseuille => "reverse-poiseuille",
            Self::ReversePoiseuille3d => "reverse-poiseuille-3d",
            Self::LidDrivenCavity => "lid-driven-cavity",
            Self::LidDrivenCavity3d => "lid-driven-cavity-3d",
            Self::Slab => "slab",
            Self::IsothermalChannel => "isothermal-channel",
            Self::DamBreak => "dam-break",
            Self::DamBreak3d => "dam-break-3d",
            Self::FallingBlock => "falling-block",
            Self::HydrostaticTank => "hydrostatic-tank",
            Self::Custom => "custom",
        }
    }

    /// Whether it is water in a tank, with a free surface.
    pub fn has_surface(self) -> bool {
        matches!(self, Self::DamBreak | Self::DamBreak3d | Self::FallingBlock | Self::HydrostaticTank)
    }

    /// Whether there is something to optimise.
    pub fn has_design(self) -> bool {
        matches!(self, Self::HeatedChannel | Self::HeatedChannel3d)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Resolution {
    /// Particle spacing.
    pub dx: f64,
    pub kernel: KernelName,
    /// Smoothing length h, in spacings.
    pub smoothing_length: f64,
}

/// The smoothing kernel W(r, h).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum KernelName {
    /// Quintic spline (Morris, Fox and Zhu 1997): reaches 3 h.
    #[default]
    QuinticSpline,
    /// Cubic spline (Monaghan and Lattanzio 1985): reaches 2 h.
    CubicSpline,
    /// Wendland's C2 function (Wendland 1995; Dehnen and Aly 2012): reaches 2 h.
    WendlandC2,
    /// Wendland's C4 function: reaches 2 h.
    WendlandC4,
    /// Wendland's C6 function: reaches 2 h.
    WendlandC6,
    /// Gaussian (Gingold and Monaghan 1977), cut off at 3 h.
    Gaussian,
    /// Super-Gaussian (Monaghan 1992), negative in its outer part, cut off at 3 h.
    SuperGaussian,
}

impl KernelName {
    /// Radius beyond which the kernel is zero, in smoothing lengths.
    pub fn support(self) -> f64 {
        match self {
            Self::QuinticSpline | Self::Gaussian | Self::SuperGaussian => 3.0,
            Self::CubicSpline | Self::WendlandC2 | Self::WendlandC4 | Self::WendlandC6 => 2.0,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Channel {
    /// Length of the periodic direction x.
    pub length: f64,
    /// Height of the fluid between the undeformed walls.
    pub height: f64,
    /// In three dimensions: width of the periodic direction z, across the flow.
    pub span: f64,
    /// Rows of dummy particles per wall: at least the kernel's support.
    pub wall_rows: usize,
    /// The hot section of the bottom wall: hot_from < x < hot_to.
    pub hot_from: f64,
    pub hot_to: f64,
    /// Fluid at x < inlet_length is reset to the inlet temperature.
    pub inlet_length: f64,
    /// Fluid at x > length - outlet_length does not conduct.
    pub outlet_length: f64,
}

/// The verification flows: reference velocity, density and length are 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Flow {
    /// Reference velocity * length / kinematic viscosity.
    pub reynolds: f64,
}

/// Heat of the verification flows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Heat {
    /// Slab: conductivity of the upper half over that of the lower one, and heat capacity.
    pub conductivity_ratio: f64,
    pub capacity_ratio: f64,
    /// Isothermal channel: kinematic viscosity over thermal diffusivity.
    pub prandtl: f64,
    /// Isothermal channel: what the upper wall is to heat.
    pub upper_wall: UpperWall,
}

/// The upper wall of the isothermal channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum UpperWall {
    /// Warm, as the lower one.
    #[default]
    Isothermal,
    Adiabatic,
}

/// A box with walls all around.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tank {
    /// Inside, along x.
    pub length: f64,
    /// Inside, along y.
    pub height: f64,
    /// Along z, which is periodic.
    pub depth: f64,
}

/// The water in the tank at the start: a block.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Water {
    pub length: f64,
    pub height: f64,
    /// Its lower corner, from that of the tank.
    pub x: f64,
    pub y: f64,
    /// Downwards.
    pub speed: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fluid {
    pub density: f64,
    /// Dynamic viscosity.
    pub viscosity: f64,
    /// Acceleration along x; reverse Poiseuille flow: its size.
    pub body_force: f64,
    /// Acceleration of water in a tank: x, y, z.
    pub gravity: [f64; 3],
    /// Where it acts: everywhere in the fluid, or only above the undeformed wall (as JAX-SPH).
    pub body_force_region: BodyForceRegion,
    /// What is the same for every wall: the body force, the flow rate, or the power that drives the flow.
    pub drive: DriveName,
    /// The flow rate that is held; default: the plane channel's under the body force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_rate: Option<f64>,
    /// The power that is held; default: the plane channel's under the body force.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pumping_power: Option<f64>,
    pub conductivity: f64,
    pub heat_capacity: f64,
    pub inlet_temperature: f64,
    /// Sound speed = sound_speed_factor * reference_velocity.
    pub reference_velocity: f64,
    pub sound_speed_factor: f64,
    /// Background pressure = factor * density * sound speed^2.
    pub background_pressure_factor: f64,
    /// Strength of the transport velocity: 0 switches it off, 1 is Adami, Hu and Adams (2013).
    pub transport_velocity: f64,
    /// alpha of the artificial viscosity (Monaghan 1992, eq. 4.1 and 4.2, beta = 0); 0 switches it off.
    pub artificial_viscosity: f64,
    /// Which pairs it acts on.
    pub artificial_viscosity_pairs: ViscousPairs,
    /// Tait's exponent: p = rho0 c^2/exponent ((rho/rho0)^exponent - 1).
    pub equation_of_state_exponent: f64,
    /// Standard formulation: where the density comes from.
    pub density_equation: DensityEquation,
    /// Whether an evolved density is renormalised in each step.
    pub density_renormalisation: bool,
    /// Standard formulation: what flows between two particles.
    pub flux: FluxName,
    /// delta of delta-SPH.
    pub density_diffusion: f64,
    /// Whose gradients it has.
    pub density_gradient: DensityGradientName,
    /// alpha of delta-SPH.
    pub velocity_diffusion: f64,
    /// eta of the Riemann solver's dissipation limiter.
    pub riemann_limiter: f64,
    /// Which equations are solved.
    pub formulation: Formulation,
    /// Consistent formulation: whether particles move with the flow.
    pub motion: Motion,
    /// Consistent formulation: how particles are kept evenly spread.
    pub shift: ShiftName,
    /// Consistent formulation: strength of the shift.
    pub shift_strength: f64,
    /// Consistent formulation: strength of the pressure's diffusion.
    pub pressure_diffusion: f64,
}

/// The equations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Formulation {
    #[default]
    /// Second-order operators and an evolved pressure: see [`crate::sph::consistent`].
    Consistent,
    /// Density summation and pair forces with a background pressure, as JAX-SPH.
    Standard,
}

/// Pairs that an artificial viscosity acts on: see [`crate::sph::laws::artificial_viscosity`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ViscousPairs {
    /// Those that approach each other (Monaghan 1992).
    #[default]
    Approaching,
    /// All pairs of fluid, as JAX-SPH.
    All,
}

/// Where the density comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum DensityEquation {
    /// A sum over the neighbours.
    #[default]
    Summation,
    /// Continuity: needs no neighbours beyond a free surface. See [`crate::sph::operators::evolution`].
    Evolution,
}

/// What flows between two particles: see [`crate::sph::laws::Flux`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum FluxName {
    /// Mean pressure and shear stress.
    #[default]
    Pair,
    /// With diffusion of density and velocity.
    Delta,
    /// From the Riemann problem between them.
    Riemann,
}

/// Gradients in the diffusion of density: see [`crate::sph::laws::density_diffusion`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum DensityGradientName {
    #[default]
    Renormalised,
    JaxSph,
}

/// What walls do to a flow along them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum SlipName {
    #[default]
    NoSlip,
    FreeSlip,
}

/// What becomes of the particles as the fluid flows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Motion {
    /// They go with it.
    #[default]
    Moving,
    /// They stay on a lattice that is mapped between the walls: see [`crate::sph::fixed`].
    Fixed,
}

impl Motion {
    /// What configurations call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Moving => "moving",
            Self::Fixed => "fixed",
        }
    }

    /// The one that this is not.
    pub fn other(self) -> Self {
        match self {
            Self::Moving => Self::Fixed,
            Self::Fixed => Self::Moving,
        }
    }
}

/// How the consistent formulation keeps particles evenly spread: see [`crate::sph::consistent::shift`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ShiftName {
    /// Along rows that stay rows: channels.
    #[default]
    Chain,
    /// Along rows that stay where they are, while the flow passes through them: channels.
    Rows,
    /// Away from crowds, anywhere.
    Isotropic,
    None,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum BodyForceRegion {
    #[default]
    Fluid,
    OriginalChannel,
}

/// What drives the flow, whatever the wall: see [`crate::sph::laws::drive`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum DriveName {
    /// A given acceleration.
    #[default]
    BodyForce,
    /// The acceleration that a given flow rate needs.
    FlowRate,
    /// The acceleration that a given power allows.
    PumpingPower,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Wall {
    pub hot_temperature: f64,
    /// Where the hot temperature holds: on the wall's surface, or in its dummy particles (as JAX-SPH).
    pub hot_isotherm: HotIsotherm,
    /// Particle mass in a deformed column: scaled with the column's area, or constant (as JAX-SPH).
    pub mass: MassConvention,
    /// Standard formulation: whether the flow has the wall's velocity beside it.
    pub slip: SlipName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum HotIsotherm {
    #[default]
    Surface,
    Dummy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum MassConvention {
    #[default]
    ColumnArea,
    Constant,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Time {
    /// Physical time to simulate.
    pub end: f64,
    /// If given, this many steps instead of `end`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    /// If given, the size of a step instead of the largest that is allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
    /// Acoustic time step: dt <= cfl * dx / (sound speed + reference velocity).
    #[serde(deserialize_with = "crate::config::stability::cfl")]
    pub cfl: f64,
    /// Diffusive time step: dt <= diffusion_number * dx^2 / max(viscosity / density, thermal diffusivity).
    pub diffusion_number: f64,
    /// How the consistent formulation's particles are advanced over a step.
    pub integrator: IntegratorName,
    /// Whether a step is divided where the flow is faster, or is pushed harder, than expected.
    pub adaptive: bool,
    /// Initial flow: at rest, or the developed parabolic profile (steady in half the time).
    pub start: Start,
    /// Random displacement of the fluid particles at the start, standard deviation in spacings.
    pub jitter: f64,
    /// Extra reach of the neighbour list, in spacings.
    pub skin: f64,
}

/// The step of the consistent formulation's moving particles: see [`crate::sph::consistent::advance`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorName {
    /// First order in time; of velocity and pressure each knows the other's newest.
    #[default]
    SymplecticEuler,
    /// Velocity Verlet: second order, one evaluation a step as well.
    Verlet,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    Rest,
    #[default]
    Developed,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Objective {
    /// What is made large.
    pub kind: ObjectiveKind,
    /// Column of target points where the outflowing heat is measured.
    pub target_x: f64,
    /// Average Q over this last part of the run, in time units; 0 takes the last step.
    pub window: f64,
    /// Samples of Q in the window (evenly spaced steps).
    pub samples: usize,
    /// What is interpolated at the targets, and from which particles: see [`crate::sph::operators::interpolation`].
    pub interpolation: Interpolation,
    /// What the loss counts: the flux integral, or the plain sum over the targets as in the report.
    pub form: ObjectiveForm,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectiveKind {
    /// The heat that the fluid carries through the target column.
    #[default]
    HeatOutflow,
    /// The mixed temperature of the fluid there: its flux of u T over its flux of u.
    OutletTemperature,
    /// What the walls heat the fluid with upstream of it.
    WallHeat,
    /// The volume that flows through the target column.
    FlowRate,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectiveForm {
    #[default]
    Flux,
    Sum,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    Fluid,
    FluidAndWalls,
    #[default]
    Flux,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Design {
    /// Which walls are shaped.
    pub walls: DesignWalls,
    /// What the optimiser moves.
    pub parametrisation: ParametrisationName,
    /// Control points of the B-spline, along the channel.
    pub control_points: usize,
    /// In three dimensions: those across it.
    pub control_points_across: usize,
    /// Named start shape; `offsets` (or `file`) wins over it.
    pub shape: ShapeName,
    /// Amplitude of the named shape.
    pub amplitude: f64,
    /// Periods of sine and cosine over the hot section.
    pub periods: f64,
    /// In three dimensions: periods over the span of the cosine that the named shape is multiplied with.
    pub periods_across: usize,
    /// Positions of the nodes; default: one per spacing, hot_from + dx/2, hot_from + 3 dx/2, ...
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Vec<f64>>,
    /// Height of the wall above y = 0 at each node; positive narrows the channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub offsets: Option<Vec<f64>>,
    /// Of the top wall, downwards, at the same nodes; default: flat.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub top_offsets: Option<Vec<f64>>,
    /// CSV file with columns x, offset, and top for both walls (a run's shape.csv).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// |offset| <= bound.
    pub bound: f64,
}

/// The walls that the optimiser moves, between channel.hot_from and channel.hot_to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum DesignWalls {
    /// The one with the hot section.
    #[default]
    Bottom,
    /// That and the cold one above it, each on its own.
    Both,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ParametrisationName {
    /// The offset of every node.
    #[default]
    Nodes,
    /// The control points of a cubic B-spline over the hot section.
    BSpline,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum ShapeName {
    #[default]
    Flat,
    /// Every offset equal to the amplitude.
    Uniform,
    Sine,
    Cosine,
    /// From -amplitude to +amplitude.
    Linear,
    /// Each node uniform in +-amplitude, from the run's seed.
    Random,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Optimise {
    pub method: OptimiserName,
    /// The particles' motion while the optimiser searches.
    pub search: Search,
    pub epochs: usize,
    /// Adam's step, or the most that L-BFGS-B's first step moves an offset, in offset units: 2e-2 is one spacing at dx = 0.02.
    pub learning_rate: f64,
    /// Weight w of w * sum (offset_{i+1} - offset_i)^2.
    pub smoothing: f64,
    pub gradient: GradientMode,
    /// Memory the gradient may use: the schedule follows from it (see [`crate::adjoint::schedule`]).
    pub memory: MemorySize,
    /// Precision of kept states; single is for schedules that keep every state only.
    pub store: Precision,
    /// Steps per segment instead of a schedule chosen by memory; 0 chooses.
    pub segment: usize,
    /// Steps that `truncated` looks back.
    pub horizon: usize,
    /// The derivative by the state becomes no longer than so many times what the objective made it, see
    /// [`crate::adjoint::schedule::Schedule::clip`]; 0: it is left alone.
    pub clip: f64,
    /// How far `differences` go to both sides: a share of the way between a number's limits.
    pub difference: f64,
    /// Who says how good a wall is while the optimiser searches.
    pub dynamics: DynamicsName,
}

/// What judges walls while the optimiser searches. What it finds is judged by the solver in any case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DynamicsName {
    #[default]
    Solver,
    /// A learned model, from frames that the solver makes.
    Surrogate,
    /// First the surrogate, then, from the best wall that it found, the solver.
    Both,
}

/// The surrogate that judges walls, and how far it is trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Surrogate {
    /// A model by `hydrograd train`; default: the built-in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Reference steps that the solver makes before the first frame.
    pub settle: usize,
    /// Frames that the model predicts behind those that the solver makes.
    pub steps: usize,
    /// Average the objective over this last part of the predicted time, in time units.
    pub window: f64,
    pub first_frames: FirstFrames,
    /// Of the network; single precision is what it was trained in.
    pub precision: Precision,
    pub trust: Trust,
    /// With `trust = check`: epochs between two evaluations by the solver.
    pub check_every: usize,
    /// With `trust = region`: the most that a node moves in the first epoch.
    pub radius: f64,
    /// With `trust = region`: steps of the optimiser within the region, per epoch.
    pub inner_epochs: usize,
    /// With `dynamics = both`: epochs that the surrogate has.
    pub epochs: usize,
}

/// What the gradient knows of the first frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum FirstFrames {
    /// That the solver made them over this wall.
    #[default]
    Differentiable,
    /// That they are there: the fluid in them is what it is.
    Detached,
}

/// How a surrogate is kept honest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Trust {
    /// It is believed; only the first and the best wall are run in the solver, at the end.
    #[default]
    None,
    /// The solver evaluates every `check_every`th wall, and the best of those wins.
    Check,
    /// A trust region: each epoch the solver evaluates a wall that the corrected surrogate proposes near the best one, and the
    /// region shrinks where prediction and truth part.
    Region,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum OptimiserName {
    /// Kingma and Ba (2015).
    #[default]
    Adam,
    /// Limited-memory quasi-Newton steps within the bounds (Byrd, Lu, Nocedal and Zhu 1995).
    LBfgsB,
}

/// The motion that designs are evaluated with while the optimiser searches; what it finds is shown with the scene's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Search {
    /// Fixed particles, by the gradient of their steady state. The standard formulation has none, and takes its own.
    #[default]
    Fixed,
    /// The scene's `fluid.motion`.
    Scene,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum GradientMode {
    #[default]
    Segments,
    Taped,
    Truncated,
    /// Of the steady state, for fixed particles: one state, no run.
    Steady,
    /// Of runs with numbers a little larger and smaller, for the few numbers of shapes.
    Differences,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Run {
    pub precision: Precision,
    /// Worker threads; 0 takes every core.
    pub threads: usize,
    pub seed: u64,
    pub kernels: Kernels,
    /// Where the operators run.
    pub device: DeviceName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    F32,
    #[default]
    F64,
}

impl Precision {
    /// What configurations call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Kernels {
    /// One SIMD kernel and hand-written adjoint per operator.
    #[default]
    Fused,
    /// The same operators from ordinary candle ops: slow, the oracle.
    Composed,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Output {
    /// ParaView frames of a `simulate` run (and of the best design of `optimize`); 0 writes none.
    pub frames: usize,
}

impl Default for Resolution {
    fn default() -> Self {
        Self { dx: 0.02, kernel: KernelName::QuinticSpline, smoothing_length: 0.8 }
    }
}

impl Default for Channel {
    fn default() -> Self {
        Self {
            length: 1.0,
            height: 0.2,
            span: 0.2,
            wall_rows: 2,
            hot_from: 0.25,
            hot_to: 0.75,
            inlet_length: 0.06,
            outlet_length: 0.06,
        }
    }
}

impl Default for Flow {
    fn default() -> Self {
        Self { reynolds: 100.0 }
    }
}

impl Default for Heat {
    fn default() -> Self {
        Self { conductivity_ratio: 1.0, capacity_ratio: 1.0, prandtl: 1.0, upper_wall: UpperWall::Isothermal }
    }
}

impl Default for Tank {
    fn default() -> Self {
        Self { length: 5.36, height: 2.0, depth: 0.4 }
    }
}

impl Default for Water {
    fn default() -> Self {
        Self { length: 2.0, height: 1.0, x: 0.0, y: 0.0, speed: 0.0 }
    }
}

impl Default for Fluid {
    fn default() -> Self {
        Self {
            density: 1.0,
            viscosity: 0.01,
            body_force: 2.3,
            gravity: [0.0, -1.0, 0.0],
            body_force_region: BodyForceRegion::Fluid,
            drive: DriveName::BodyForce,
            flow_rate: None,
            pumping_power: None,
            conductivity: 7.313,
            heat_capacity: 305.27,
            inlet_temperature: 1.0,
            reference_velocity: 1.0,
            sound_speed_factor: 10.0,
            background_pressure_factor: 0.05,
            transport_velocity: 0.0,
            artificial_viscosity: 0.0,
            artificial_viscosity_pairs: ViscousPairs::Approaching,
            equation_of_state_exponent: 1.0,
            density_equation: DensityEquation::Summation,
            density_renormalisation: false,
            flux: FluxName::Pair,
            density_diffusion: 0.1,
            density_gradient: DensityGradientName::Renormalised,
            velocity_diffusion: 0.01,
            riemann_limiter: 3.0,
            formulation: Formulation::Consistent,
            motion: Motion::Moving,
            shift: ShiftName::Chain,
            shift_strength: 2.0,
            pressure_diffusion: 0.1,
        }
    }
}

impl Default for Wall {
    fn default() -> Self {
        Self {
            hot_temperature: 1.23,
            hot_isotherm: HotIsotherm::Surface,
            mass: MassConvention::ColumnArea,
            slip: SlipName::NoSlip,
        }
    }
}

impl Default for Time {
    fn default() -> Self {
        Self {
            end: 2.5,
            steps: None,
            step: None,
            cfl: 1.5,
            diffusion_number: 0.25,
            integrator: IntegratorName::SymplecticEuler,
            adaptive: false,
            start: Start::Developed,
            jitter: 0.05,
            skin: 0.2,
        }
    }
}

impl Default for Objective {
    fn default() -> Self {
        Self {
            kind: ObjectiveKind::HeatOutflow,
            target_x: 0.9,
            window: 0.5,
            samples: 40,
            interpolation: Interpolation::Flux,
            form: ObjectiveForm::Flux,
        }
    }
}

impl Default for Design {
    fn default() -> Self {
        Self {
            walls: DesignWalls::Bottom,
            parametrisation: ParametrisationName::Nodes,
            control_points: 8,
            control_points_across: 4,
            shape: ShapeName::Flat,
            amplitude: 0.01,
            periods: 1.0,
            periods_across: 0,
            nodes: None,
            offsets: None,
            top_offsets: None,
            file: None,
            bound: 0.02,
        }
    }
}

impl Default for Optimise {
    fn default() -> Self {
        Self {
            method: OptimiserName::LBfgsB,
            search: Search::Fixed,
            epochs: 25,
            learning_rate: 3e-3,
            smoothing: 0.05,
            gradient: GradientMode::Segments,
            memory: MemorySize(300_000_000),
            store: Precision::F64,
            segment: 0,
            horizon: 200,
            clip: 0.0,
            difference: 0.05,
            dynamics: DynamicsName::Solver,
        }
    }
}

impl Default for Surrogate {
    fn default() -> Self {
        Self {
            model: None,
            settle: 2500,
            steps: 20,
            window: 0.9,
            first_frames: FirstFrames::Differentiable,
            precision: Precision::F32,
            trust: Trust::None,
            check_every: 5,
            radius: 5e-3,
            inner_epochs: 10,
            epochs: 10,
        }
    }
}

impl Default for Run {
    fn default() -> Self {
        Self { precision: Precision::F64, threads: 0, seed: 0, kernels: Kernels::Fused, device: DeviceName::Cpu }
    }
}

impl Default for Output {
    fn default() -> Self {
        Self { frames: 40 }
    }
}
