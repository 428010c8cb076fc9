//! The interfaces of a gradient: to a simulation that advances in steps, and to an objective.
//!
//! The solver and a surrogate are both [`Dynamics`]: their state is one tensor, which they advance with or without a
//! graph and convert to [`Fields`]. An [`Objective`] uses fields only, an [`super::run::Observer`] a run.

use crate::error::Error;
use crate::particles::neighbour_list::NeighbourError;
use candle_core::{Tensor, Var};
use std::collections::HashMap;
use std::sync::Arc;

/// The error of a run that cannot continue.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error("step {step}: {source}")]
    Neighbours { step: usize, source: NeighbourError },
    #[error("step {step}: {source}")]
    Tensor { step: usize, source: candle_core::Error },
    #[error("step {step}: {field} of particle {particle} is {value}: the run has diverged")]
    NotFinite { step: usize, field: &'static str, particle: usize, value: f64 },
    #[error("step {step}: {field} of particle {particle} is {value:.3e}, beyond {limit:.3e}: the run has diverged")]
    Impossible { step: usize, field: &'static str, particle: usize, value: f64, limit: f64 },
    #[error("the gradient that came back from step {until} is {norm} at step {step}: between them it stopped being a number")]
    Gradient { step: usize, until: usize, norm: f64 },
    /// See [`crate::numerics::interrupt::Stop`].
    #[error("stopped by a signal")]
    Stopped,
}

/// The first particle with a bad value that a check found.
#[derive(Debug, Clone, PartialEq)]
pub struct Offender {
    pub particle: usize,
    pub quantity: String,
    pub value: f64,
}

impl RunError {
    /// Whether the run has diverged. With another initial state or smaller steps it may succeed.
    pub fn is_divergence(&self) -> bool {
        matches!(self, Self::Gradient { .. }) || self.offender().is_some()
    }

    /// The step and the particle with a bad value; none if the run has not diverged.
    pub fn offender(&self) -> Option<(usize, Offender)> {
        let of = |particle: usize, quantity: &str, value: f64| Offender { particle, quantity: quantity.into(), value };
        Some(match self {
            Self::NotFinite { step, field, particle, value }
            | Self::Impossible { step, field, particle, value, .. } => (*step, of(*particle, field, *value)),
            Self::Neighbours { step, source } => match source {
                NeighbourError::LostParticle { particle, component, value } => {
                    (*step, of(*particle, ["x", "y", "z"][*component], *value))
                }
                NeighbourError::Clumped { particle, count } => (*step, of(*particle, "neighbours", *count as f64)),
                NeighbourError::TooFast { particle, distance, .. } => {
                    (*step, of(*particle, "distance moved in one step", *distance))
                }
                NeighbourError::UsedUp | NeighbourError::BoxTooSmall { .. } => return None,
            },
            Self::Tensor { .. } | Self::Gradient { .. } | Self::Stopped => return None,
        })
    }

    /// The error for the user; for a divergence with advice.
    pub fn advised(self, advice: &str) -> Error {
        match self.is_divergence() {
            true => Error::diverged(self.to_string(), advice),
            false if matches!(self, Self::Stopped) => Error::Stopped,
            false => Error::run(self.to_string(), advice),
        }
    }

    /// Converts the error of a tensor operation in a step.
    pub fn tensor(step: usize) -> impl Fn(candle_core::Error) -> Self {
        move |source| Self::Tensor { step, source }
    }
}

/// The particles at one time, including wall particles, in physical units. They are on the graph if the state is.
#[derive(Debug, Clone)]
pub struct Fields {
    /// Number of steps before the state.
    pub step: usize,
    pub time: f64,
    /// Position, `[D, N]`.
    pub position: Tensor,
    /// Velocity, `[D, N]`.
    pub velocity: Tensor,
    /// Density, `[1, N]`.
    pub density: Tensor,
    /// Mass, `[1, N]`.
    pub mass: Tensor,
    /// Temperature relative to the reference (in a channel: the inlet's), `[1, N]`; none without heat.
    pub temperature: Option<Tensor>,
    /// Heat flux from the walls to the fluid, in units of density * temperature * volume / time, `[]`; for some
    /// objectives.
    pub wall_heat: Option<Tensor>,
    /// Heat that the method's own fluxes carry through the section of the objective, in the same unit, `[]`; of methods
    /// whose heat that flows out is not the sum of rho u T over particles.
    pub carried_heat: Option<Tensor>,
    /// Kind of each particle, `[N]`, see [`crate::particles::tag`].
    pub tags: Arc<Vec<u8>>,
    /// Whether a particle takes part in the flow, `[N]`: fluid particles, and wall particles with fluid in reach.
    pub active: Arc<Vec<bool>>,
}

/// A simulation that advances a state with or without a graph: the solver or a surrogate.
pub trait Dynamics: Sync {
    /// A state from which a run can start or continue.
    type Start: Sync;
    /// A state as a schedule keeps it, possibly rounded.
    type Kept;
    /// A run without a graph.
    type Run;
    /// A run on the graph.
    type Tape;

    fn start(&self, from: &Self::Start) -> Result<Self::Run, RunError>;
    /// Makes one step.
    fn advance(&self, run: &mut Self::Run) -> Result<(), RunError>;
    /// Number of steps that a run has made, including those before its start.
    fn step(&self, run: &Self::Run) -> usize;
    /// Returns an error if a value of the state is not finite or impossibly large.
    fn check(&self, run: &Self::Run) -> Result<(), RunError>;
    fn look(&self, run: &mut Self::Run) -> Result<Fields, RunError>;

    /// The sum of a number over all processes that have a part of the state each.
    fn over_all(&self, own: f64) -> f64 {
        own
    }
    /// A mask that broadcasts to the state, 1 where the flow moves a value and 0 elsewhere; none means all.
    /// [`super::schedule::Schedule::clip`] applies only where it is 1; elsewhere derivatives by a design accumulate.
    fn moving(&self) -> candle_core::Result<Option<Tensor>> {
        Ok(None)
    }
    /// The state of a start as a new tensor.
    fn tensor(&self, from: &Self::Start) -> Result<Tensor, RunError>;
    /// Makes one step on the graph; `after` is the resulting state, if it is already known to the bit.
    fn advance_taped(&self, tape: &mut Self::Tape, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, RunError>;
    /// Maps the cotangent of the state after a step to that of the state before it, without a graph; `after` as for
    /// [`Self::advance_taped`]. Returns none, and does nothing, if a graph is needed.
    fn pull_back(
        &self,
        _tape: &mut Self::Tape,
        _state: &Tensor,
        _after: Option<&Tensor>,
        _cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        Ok(None)
    }
    /// The fields of a state of the tape, on the graph.
    fn fields(&self, tape: &mut Self::Tape, state: &Tensor) -> Result<Fields, RunError>;

    /// Keeps the present state, exactly or `rounded` to single precision.
    fn keep(&self, run: &Self::Run, rounded: bool) -> Result<Self::Kept, RunError>;
    /// Stores results of the step after the kept state, which `run` has just made, so that they need not be recomputed.
    fn settle(&self, kept: &mut Self::Kept, run: &Self::Run);
    /// Sets `run` back to a kept state.
    fn resume(&self, run: &mut Self::Run, kept: &Self::Kept) -> Result<(), RunError>;
    /// Starts on the graph at a kept state: returns the tape, and the state as a variable. The previous tape `last` and
    /// the run `run` without a graph provide data that they share with the new tape.
    fn tape(&self, kept: &Self::Kept, last: Option<Self::Tape>, run: &Self::Run)
        -> Result<(Self::Tape, Var), RunError>;

    /// Memory of a kept state, in bytes.
    fn kept_bytes(&self, kept: &Self::Kept) -> Bytes;
    /// Memory that the last step put on `tape`, in bytes.
    fn taped_bytes(&self, tape: &Self::Tape) -> Bytes;
}

/// Memory in bytes, of which a part may be shared with other objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bytes {
    pub own: usize,
    pub shared: usize,
    /// Identifies the shared part by its address.
    pub identity: usize,
}

/// Bytes held now, and the largest number so far. Shared parts count once.
#[derive(Debug, Default)]
pub(super) struct Held {
    pub now: usize,
    pub peak: usize,
    sharing: HashMap<usize, usize>,
}

impl Held {
    pub fn add(&mut self, bytes: Bytes) {
        let sharing = self.sharing.entry(bytes.identity).or_insert(0);
        self.now += bytes.own + if *sharing == 0 { bytes.shared } else { 0 };
        *sharing += 1;
        self.peak = self.peak.max(self.now);
    }

    pub fn remove(&mut self, bytes: Bytes) {
        self.now -= bytes.own;
        if let Some(sharing) = self.sharing.get_mut(&bytes.identity) {
            *sharing -= 1;
            if *sharing == 0 {
                self.sharing.remove(&bytes.identity);
                self.now -= bytes.shared;
            }
        }
    }
}

/// A scalar function of a run: a weighted sum over some of its states.
pub trait Objective: Sync {
    /// The weight of the state after `step` steps; `None` if the objective does not use it.
    fn weight(&self, step: usize) -> Option<f64>;
    /// The value for a state: a scalar, on the graph if the fields are.
    fn value(&self, fields: &Fields) -> candle_core::Result<Tensor>;
}
