//! The words of the bench: groups, what is run and how, a case, and what the process that measured it answers.

use crate::cli::arguments::{check_preset, name_of, set_option};
use crate::config::device::DeviceName;
use crate::config::layers::Setting;
use crate::config::memory_size::MemorySize;
use crate::config::scene::{Config, Kernels, Precision};
use crate::error::{BadInput, Error};
use crate::scene::load::Loaded;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Modes of the rows of `plan`.
pub const PLAN: &str = "plan";
pub const EVERYTHING_ON: &str = "everything on";
/// Modes of the rows of `kernels`.
pub const FUSED: &str = "fused";
pub const COMPOSED: &str = "composed";

/// Particles along each side of the wall-free box.
const WALL_FREE: Size = Size { per_side: 50, dimension: 2 };

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// A forward step of the heated channel.
    Step,
    /// Its gradient, with every way of keeping states.
    Gradient,
    /// Taylor-Green vortices in two and three dimensions, up to a million particles.
    Scaling,
    /// What is saved by skipping what a scene does not need.
    Plan,
    /// What fused operators save against the same formulas composed of candle's own.
    Kernels,
    /// A training step and a prediction of graph network simulators, beside the machine's sgemm.
    Surrogate,
    /// Run time against error.
    Accuracy,
}

impl Group {
    /// Those that run if none is named: what the solver does; `kernels` and `accuracy` take long.
    pub const DEFAULT: [Self; 4] = [Self::Step, Self::Gradient, Self::Scaling, Self::Plan];

    pub fn name(self) -> String {
        name_of(self)
    }
}

/// Particles along each side of a Taylor-Green box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    pub per_side: usize,
    pub dimension: usize,
}

impl Size {
    /// Fewer do not fit: a box must be longer than twice the reach of a particle, about 6.4 spacings.
    const LEAST: usize = 8;
    /// Particle numbers are 32-bit in the neighbour list.
    const MOST_PARTICLES: usize = 100_000_000;

    pub fn particles(self) -> usize {
        self.per_side.pow(self.dimension as u32)
    }

    pub fn scene(self) -> &'static str {
        match self.dimension {
            2 => "taylor-green",
            _ => "taylor-green-3d",
        }
    }

    pub fn parse(text: &str) -> Result<Self, String> {
        let size = text.split_once('^').and_then(|(side, dimension)| {
            let size = Self { per_side: side.parse().ok()?, dimension: dimension.parse().ok()? };
            let particles = size.per_side.checked_pow(size.dimension as u32)?;
            let fits = size.per_side >= Self::LEAST && particles <= Self::MOST_PARTICLES;
            ((2..=3).contains(&size.dimension) && fits).then_some(size)
        });
        size.ok_or_else(|| {
            format!(
                "allowed: N^2 or N^3 with N >= {} and at most {} particles, e.g. 100^2",
                Self::LEAST,
                Self::MOST_PARTICLES
            )
        })
    }
}

/// A scene to measure: what [`Config::load_settings`] wants, to be passed on to another process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    pub scene: Option<String>,
    pub preset: Option<String>,
    pub sets: Vec<String>,
}

impl Scene {
    pub fn load(&self) -> Result<Loaded, Error> {
        let settings: Vec<Setting> = self.sets.iter().map(|text| set_option(text)).collect();
        check_preset(self.preset.as_deref())?;
        let loaded = Config::load_settings(self.scene.as_deref(), self.preset.as_deref(), &settings)?;
        let config = &loaded.config;
        if !config.scene.has_design() && !config.method.facts().moves {
            return Err(BadInput::at("method.name", "fixed particles of this scene have no step that is measured")
                .allowed("particles that move, or the heated channel")
                .advice(
                    "--set method.name=consistent; `hydrograd simulate` prints what a step of fixed particles takes",
                )
                .into());
        }
        Ok(loaded)
    }

    /// The same with settings below those that it has.
    pub fn with_defaults(&self, sets: &[&str]) -> Self {
        let sets = sets.iter().map(|s| s.to_string()).chain(self.sets.iter().cloned()).collect();
        Self { sets, ..self.clone() }
    }
}

/// Particles along the networks' box and across it: as many as the report's channel has.
pub const COLUMNS: usize = 38;
pub const ROWS: usize = 25;

/// A graph network simulator on the periodic box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Network {
    pub rounds: usize,
    pub latent: usize,
    /// Connectivity radius in spacings.
    pub radius: f64,
}

impl Network {
    pub const ALL: [Self; 3] = [
        Self { rounds: 10, latent: 128, radius: 3.0 },
        Self { rounds: 10, latent: 128, radius: 1.45 },
        Self { rounds: 5, latent: 64, radius: 1.45 },
    ];
    pub const PARTICLES: usize = COLUMNS * ROWS;

    pub fn name(&self) -> String {
        format!("gns-{}-{}-{}dx", self.rounds, self.latent, self.radius)
    }
}

/// What a scene does without.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lacking {
    /// The channel without heat.
    Heat,
    /// Taylor-Green vortices: neither walls nor heat nor a mass of each particle's own.
    Walls,
    /// The channel without viscosity.
    Viscosity,
    /// The channel without transport velocity.
    TransportVelocity,
    /// The channel with one mass for all particles.
    Masses,
}

impl Lacking {
    pub const ALL: [Self; 5] = [Self::Heat, Self::Walls, Self::Viscosity, Self::TransportVelocity, Self::Masses];

    pub fn name(self) -> &'static str {
        match self {
            Self::Heat => "isothermal",
            Self::Walls => "wall-free",
            Self::Viscosity => "inviscid",
            Self::TransportVelocity => "no-transport-velocity",
            Self::Masses => "constant-mass",
        }
    }

    /// The wall-free box; `None` for the channels.
    pub fn size(self) -> Option<Size> {
        (self == Self::Walls).then_some(WALL_FREE)
    }

    /// # Errors
    /// A scene that cannot be built.
    pub fn particles(self, config: &Config) -> Result<usize, Error> {
        self.size().map_or_else(|| particles(config), |size| Ok(size.particles()))
    }
}

/// Forward, gradient, or an update of a network's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    Forward,
    Gradient,
    Training,
}

impl Kind {
    pub fn name(self) -> String {
        name_of(self)
    }
}

/// What is run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    Scene(Scene),
    TaylorGreen(Size),
    /// A scene that lacks something: with its own plan, or with every field forced on.
    Plan {
        scene: Scene,
        lacking: Lacking,
        forced: bool,
    },
    Network(Network),
}

/// How the states of a gradient's run are kept.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Keeping {
    /// The state before each step.
    EveryState,
    /// The same, rounded to f32.
    Rounded,
    /// Segments of the length that needs the least.
    LeastMemory,
    /// The fastest schedule that keeps and tapes at most this share of what every state takes.
    Share(f64),
    /// The fastest schedule within so many bytes.
    Within(MemorySize),
    /// Revolve with so many states.
    Binomial(usize),
    /// Segments of 200, as the original report's accumulation.
    Segments(usize),
    /// Only the last `optimise.horizon` steps are differentiated.
    Truncated(usize),
    Taped,
}

impl Keeping {
    pub fn name(self) -> String {
        match self {
            Self::EveryState => "every state".into(),
            Self::Rounded => "every state in f32".into(),
            Self::LeastMemory => "best segments".into(),
            Self::Within(size) => format!("within {size}"),
            Self::Binomial(states) => format!("binomial, {states} states"),
            Self::Share(share) => format!("{:.0} % of every state", 100.0 * share),
            Self::Segments(length) => format!("segments of {length}"),
            Self::Truncated(horizon) => format!("truncated to {horizon}"),
            Self::Taped => "taped".into(),
        }
    }
}

/// How many steps are timed as one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Length {
    Steps(usize),
    /// As many as fit into so many seconds, but at least so many steps (each repeat should rebuild the neighbour list).
    Seconds {
        seconds: f64,
        least: usize,
    },
}

/// One row of the result before it is measured; travels to its process as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    pub group: Group,
    pub scene: String,
    pub particles: usize,
    pub precision: Precision,
    pub threads: usize,
    pub kind: Kind,
    /// Distinguishes rows that agree in all else: how states are kept, plan or everything.
    pub mode: Option<String>,
    pub source: Source,
    pub kernels: Kernels,
    pub device: DeviceName,
    pub keeping: Keeping,
    /// Steps that are run first and not timed; what is timed begins at the state behind them.
    pub warm_up: usize,
    pub length: Length,
    /// Timed runs in one process.
    pub blocks: usize,
    /// Leave the gradient out if it is predicted to take more bytes.
    pub memory_limit: usize,
}

impl Case {
    /// group/scene/particles/precision/threads/kind[/mode]: what `--filter` looks into and `--compare` matches.
    pub fn label(&self) -> String {
        let Self { group, scene, particles, precision, threads, kind, mode, .. } = self;
        label(*group, scene, *particles, precision.name(), *threads, *kind, mode)
    }
}

pub fn label(
    group: Group,
    scene: &str,
    particles: usize,
    precision: &str,
    threads: usize,
    kind: Kind,
    mode: &Option<String>,
) -> String {
    let mode = mode.as_ref().map_or(String::new(), |mode| format!("/{mode}"));
    format!("{}/{scene}/{particles}/{precision}/{threads}/{}{mode}", group.name(), kind.name())
}

/// What the bench asks of a process of its own.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    Row(Box<Case>),
    /// The operations of a step, for which one thread must run with the instruction set `portable`.
    Count(Box<Case>),
    /// All points of run time against error.
    Accuracy {
        quick: bool,
        threads: usize,
    },
}

/// What one process measured.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Measured {
    pub dimension: usize,
    pub pairs: usize,
    /// Steps of each timed run.
    pub steps: usize,
    /// Of each timed run.
    pub seconds: Vec<f64>,
    /// The forward part of each gradient.
    pub forward_seconds: Vec<f64>,
    pub peak_memory_bytes: u64,
    /// What the schedule of a gradient was predicted to take.
    pub predicted_bytes: Option<usize>,
    pub instruction_set: String,
    pub time_step: f64,
    /// Largest relative difference between the scene's plan and everything on.
    pub difference: Option<f64>,
    /// Of a network: work of a step, and what the machine's sgemm does per second at its shapes.
    pub gflop: Option<f64>,
    pub sgemm_gflops: Option<f64>,
    /// Of a flow: bytes of the arrays of a step, each once, and what the machine can do, see [`crate::numerics::roofline::Roofline`].
    pub bytes_per_step: Option<usize>,
    pub peak_gflops: Option<f64>,
    pub gigabytes_per_second: Option<f64>,
}

impl Case {
    /// Whether a row says how far it is from what the machine can do: fused steps of flows on the CPU, and gradients that run no step twice.
    pub fn has_roofline(&self) -> bool {
        let is_flow = matches!(self.source, Source::Scene(_) | Source::TaylorGreen(_));
        let has_groups = [Group::Step, Group::Gradient, Group::Scaling].contains(&self.group);
        let is_whole = self.kind == Kind::Forward || self.keeping == Keeping::EveryState;
        let is_fused = self.device == DeviceName::Cpu && self.kernels == Kernels::Fused;
        is_flow && has_groups && is_whole && is_fused
    }
}

/// Or why it was left out: a gradient that does not fit into the memory that it is allowed.
pub type Outcome = Result<Measured, String>;

/// Particles of a scene, those of walls included.
///
/// # Errors
/// A scene that cannot be built.
pub fn particles(config: &Config) -> Result<usize, Error> {
    Ok(crate::scene::Scene::<f64>::from_config(config)?.model.particles())
}
