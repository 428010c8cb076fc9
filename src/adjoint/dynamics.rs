//! What a gradient needs to know of something that advances in steps, and of what is asked of it.
//!
//! The solver and a surrogate are both [`Dynamics`]: their state is one tensor, they advance it with and without a graph,
//! and show it as [`Fields`]. An [`Objective`] sees fields only, an [`super::run::Observer`] a run.

use crate::error::Error;
use crate::particles::neighbour_list::NeighbourError;
use candle_core::{Tensor, Var};
use std::sync::Arc;

/// A run that could not go on.
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

/// A particle whose numbers left all bounds first, as far as a check saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct Offender {
    pub particle: usize,
    pub quantity: String,
    pub value: f64,
}

impl RunError {
    /// Whether the run's numbers are to blame: of another start, or with smaller steps, it may succeed.
    pub fn is_divergence(&self) -> bool {
        matches!(self, Self::Gradient { .. }) || self.offender().is_some()
    }

    /// The step, and the particle that has gone wrong; none if the run's numbers are not to blame.
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
                NeighbourError::BoxTooSmall { .. } => return None,
            },
            Self::Tensor { .. } | Self::Gradient { .. } | Self::Stopped => return None,
        })
    }

    /// What a user is told of it: a divergence as one, with what to try.
    pub fn advised(self, advice: &str) -> Error {
        match self.is_divergence() {
            true => Error::diverged(self.to_string(), advice),
            false if matches!(self, Self::Stopped) => Error::Stopped,
            false => Error::run(self.to_string(), advice),
        }
    }

    /// A failed tensor operation in a step.
    pub fn tensor(step: usize) -> impl Fn(candle_core::Error) -> Self {
        move |source| Self::Tensor { step, source }
    }
}

/// The particles at one time, walls included, in physical units. On the graph, if they came from one.
#[derive(Debug, Clone)]
pub struct Fields {
    /// Steps behind the state.
    pub step: usize,
    /// Its time.
    pub time: f64,
    /// `[D, N]`.
    pub position: Tensor,
    /// `[D, N]`.
    pub velocity: Tensor,
    /// `[1, N]`.
    pub density: Tensor,
    /// `[1, N]`.
    pub mass: Tensor,
    /// Above the reference (in a channel: the inlet's), `[1, N]`; none without heat.
    pub temperature: Option<Tensor>,
    /// What the walls heat the fluid with, in units of density * temperature * volume per time, `[]`; where an objective asks.
    pub wall_heat: Option<Tensor>,
    /// See [`crate::particles::tag`], `[N]`.
    pub tags: Arc<Vec<u8>>,
    /// Whether a particle takes part in the flow: fluid, and walls with fluid in reach, `[N]`.
    pub active: Arc<Vec<bool>>,
}

/// Something that advances a state, with and without a graph: the solver, a surrogate.
pub trait Dynamics: Sync {
    /// A state to start from, or to come back to.
    type Start: Sync;
    /// The same as a schedule keeps it, perhaps rounded.
    type Kept;
    /// A run without a graph.
    type Run;
    /// A run on the graph.
    type Tape;

    fn start(&self, from: &Self::Start) -> Result<Self::Run, RunError>;
    /// One step.
    fn advance(&self, run: &mut Self::Run) -> Result<(), RunError>;
    /// Steps that a run has made, those before its start included.
    fn step(&self, run: &Self::Run) -> usize;
    /// An error if a number of the state is not finite, or larger than it can be.
    fn check(&self, run: &Self::Run) -> Result<(), RunError>;
    /// The present state as fields.
    fn look(&self, run: &mut Self::Run) -> Result<Fields, RunError>;

    /// What of a state the flow moves, 1 there and 0 elsewhere, in a shape that multiplies a state: [`super::schedule::Schedule::clip`]
    /// leaves the rest alone, where a derivative by a design gathers. None: all of it.
    fn moving(&self) -> candle_core::Result<Option<Tensor>> {
        Ok(None)
    }
    /// A start's state as a tensor of its own.
    fn tensor(&self, from: &Self::Start) -> Result<Tensor, RunError>;
    /// One step on the graph; `after` is the state that it leads to, if that is known to the bit.
    fn advance_taped(&self, tape: &mut Self::Tape, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, RunError>;
    /// The cotangent of a state from that of the one that a step from it leads to, without a graph; `after` as for
    /// [`Self::advance_taped`]. None, and nothing done: only a graph knows.
    fn pull_back(
        &self,
        _tape: &mut Self::Tape,
        _state: &Tensor,
        _after: Option<&Tensor>,
        _cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        Ok(None)
    }
    /// A state of the tape as fields, on the graph.
    fn fields(&self, tape: &mut Self::Tape, state: &Tensor) -> Result<Fields, RunError>;

    /// Keeps the present state, `rounded` to single precision or exactly.
    fn keep(&self, run: &Self::Run, rounded: bool) -> Result<Self::Kept, RunError>;
    /// `run` has made the step behind the kept state: what was found in it need not be found again.
    fn settle(&self, kept: &mut Self::Kept, run: &Self::Run);
    /// Takes `run` back to a kept state.
    fn resume(&self, run: &mut Self::Run, kept: &Self::Kept) -> Result<(), RunError>;
    /// Starts on the graph at a kept state: the tape, and the state as a variable. `last` is the tape before
    /// this one and `run` the run without a graph, to take over what they share with the new one.
    fn tape(&self, kept: &Self::Kept, last: Option<Self::Tape>, run: &Self::Run)
        -> Result<(Self::Tape, Var), RunError>;

    /// Bytes of a kept state.
    fn kept_bytes(&self, kept: &Self::Kept) -> Bytes;
    /// Bytes that the last step of `tape` put on it.
    fn taped_bytes(&self, tape: &Self::Tape) -> Bytes;
}

/// Memory of something that shares a part with others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bytes {
    pub own: usize,
    pub shared: usize,
    /// Tells one shared part from another: its address.
    pub identity: usize,
}

/// A scalar function of a run: a weighted sum over some of its states.
pub trait Objective: Sync {
    /// What it is called in tables.
    fn name(&self) -> &str;
    /// The weight of the state after `step` steps; `None` if the objective does not look at it.
    fn weight(&self, step: usize) -> Option<f64>;
    /// Its value of a state: a scalar, on the graph if the fields are.
    fn value(&self, fields: &Fields) -> candle_core::Result<Tensor>;
}
