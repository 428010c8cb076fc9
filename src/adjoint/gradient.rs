//! The gradient of a run with respect to its initial state, by the actions of a [`Schedule`].
//!
//! The run goes forward without a graph, and states are kept. Then, from the last step to the first, a kept state
//! becomes a variable, a segment (one step or more) is run on the graph, its end is multiplied with the cotangent from
//! the segment after it, and candle's `backward` gives the cotangent of its start. (A segment of one step without a
//! term of the objective may be differentiated without a graph, see [`Dynamics::pull_back`].) This cotangent also has
//! the derivative by a design: positions and masses of wall particles are rows of the state, and each step adds its
//! part to their cotangent. So the sums are the same, in the same order, for every schedule: bit for bit equal to one
//! tape.

use super::dynamics::{Dynamics, Fields, Held, Objective, RunError};
use super::run::CHECK_EVERY;
use super::schedule::{Action, Schedule};
use crate::numerics::interrupt::{is_asked_here, Stop};
use candle_core::{CpuStorage, CustomOp1, DType, Layout, Shape, Tensor};
use std::collections::BTreeMap;

pub struct Gradient {
    pub value: f64,
    /// Derivative of the objective by the state at the schedule's first step, `[F, N]`.
    pub state: Tensor,
    /// Norm of the derivative by the state at some steps, from the end to the start.
    pub growth: Vec<(usize, f64)>,
    /// Number of these steps at which it was limited ([`Schedule::clip`]).
    pub clipped: usize,
    /// Seconds of the first forward run without a graph.
    pub forward_seconds: f64,
    /// Largest number of bytes kept and taped at the same time, which [`Schedule::storage`] predicts.
    pub storage: usize,
    /// Number of steps that were run without and with a graph.
    pub plain_steps: usize,
    pub differentiated_steps: usize,
}

/// Value of an objective for a state, as a number.
pub fn value<O: Objective + ?Sized>(objective: &O, fields: &Fields) -> candle_core::Result<f64> {
    objective.value(fields)?.to_dtype(DType::F64)?.to_scalar()
}

fn norm<D: Dynamics>(dynamics: &D, tensor: &Tensor) -> candle_core::Result<f64> {
    let square = tensor.to_dtype(DType::F64)?.sqr()?.sum_all()?.to_scalar::<f64>()?;
    Ok(dynamics.over_all(square).sqrt())
}

/// Called after each segment (or each forward step) with the completed fraction of the work.
pub type Progress<'a> = &'a mut dyn FnMut(f64);

/// Value of an objective over a run without a graph. `progress` is called with the completed fraction.
pub fn value_of_run<D: Dynamics, O: Objective + ?Sized>(
    dynamics: &D,
    start: &D::Start,
    steps: usize,
    objective: &O,
    progress: Progress<'_>,
) -> anyhow::Result<f64> {
    let mut sum = 0.0;
    let mut measure = |dynamics: &D, run: &mut D::Run| -> anyhow::Result<()> {
        let step = dynamics.step(run);
        if let Some(weight) = objective.weight(step) {
            sum += weight * value(objective, &dynamics.look(run)?).map_err(RunError::tensor(step))?;
        }
        progress(step as f64 / steps as f64);
        Ok(())
    };
    super::run::run(dynamics, start, steps, &mut [&mut measure])?;
    Ok(sum)
}

/// Runs `schedule` from `start` and differentiates.
///
/// Long segments recurse deeply in candle's `backward` and `Drop` (about 250 bytes of stack per chained operator);
/// this runs on a thread with a stack of 1 GiB of virtual memory, enough for a million operators.
pub fn gradient<D: Dynamics, O: Objective + ?Sized>(
    dynamics: &D,
    start: &D::Start,
    schedule: &Schedule,
    objective: &O,
    progress: Progress<'_>,
) -> Result<Gradient, RunError> {
    let stop = Stop::of_this_thread();
    let (teller, shares) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        let worker = std::thread::Builder::new()
            .name("gradient".into())
            .stack_size(1 << 30)
            .spawn_scoped(scope, move || {
                // Whoever listens does so until this thread ends.
                let mut tell = |share| teller.send(share).unwrap_or_default();
                Stop::ends(stop, || run(dynamics, start, schedule, objective, &mut tell))
            })
            .map_err(|source| RunError::Tensor { step: 0, source: candle_core::Error::Io(source) })?;
        shares.iter().for_each(progress);
        match worker.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// Limits the derivative by the state, which may grow without bound.
struct Clip {
    /// Limit as a multiple of the longest norm while terms of the objective were added.
    limit: f64,
    longest: f64,
    /// The first step after which there is a term, and whether all terms have been added.
    first_term: usize,
    is_complete: bool,
    /// The part that is limited, see [`Dynamics::moving`].
    moving: Option<Tensor>,
    /// Number of times that it was limited.
    count: usize,
}

impl Clip {
    /// None if the schedule has no limit.
    fn new<D: Dynamics, O: Objective + ?Sized>(
        dynamics: &D,
        schedule: &Schedule,
        objective: &O,
    ) -> candle_core::Result<Option<Self>> {
        if schedule.clip == 0.0 {
            return Ok(None);
        }
        let first_term = (1..=schedule.steps).find(|step| objective.weight(*step).is_some()).unwrap_or(schedule.steps);
        let moving = dynamics.moving()?;
        Ok(Some(Self { limit: schedule.clip, longest: 0.0, first_term, is_complete: false, moving, count: 0 }))
    }

    /// The limited derivative by a state, of a segment that ends at step `to`.
    fn apply<D: Dynamics>(&mut self, dynamics: &D, found: Tensor, to: usize) -> candle_core::Result<Tensor> {
        let own = match &self.moving {
            Some(moving) => found.broadcast_mul(moving)?,
            None => found.clone(),
        };
        let length = norm(dynamics, &own)?;
        if !self.is_complete {
            self.longest = self.longest.max(length);
            self.is_complete = to < self.first_term;
            return Ok(found);
        }
        let most = self.limit * self.longest;
        if length <= most {
            return Ok(found);
        }
        self.count += 1;
        // Subtracts the excess of the moving part from the whole.
        found - own.affine(1.0 - most / length, 0.0)?
    }
}

/// Executes the actions of a schedule.
struct Executor<'a, D: Dynamics, O: ?Sized> {
    dynamics: &'a D,
    objective: &'a O,
    plain: D::Run,
    tape: Option<D::Tape>,
    kept: BTreeMap<usize, D::Kept>,
    held: Held,
    /// Number of steps of the plain run for which the objective has its values.
    seen: usize,
    value: f64,
    plain_steps: usize,
    /// The step at which the last segment began, and the state there, at which the segment before it ends.
    began: Option<(usize, Tensor)>,
    /// Whether every kept state is exact, not rounded.
    exact: bool,
}

fn run<D: Dynamics, O: Objective + ?Sized>(
    dynamics: &D,
    start: &D::Start,
    schedule: &Schedule,
    objective: &O,
    progress: Progress<'_>,
) -> Result<Gradient, RunError> {
    let clock = std::time::Instant::now();
    let counts = schedule.counts();
    log::info!("gradient of {} steps: {schedule}", schedule.steps - schedule.first);
    // A taped step costs about as much as three steps without a graph.
    let total = (counts.plain_steps + 3 * counts.differentiated_steps).max(1) as f64;
    let mut executor = Executor {
        dynamics,
        objective,
        plain: dynamics.start(start)?,
        tape: None,
        kept: BTreeMap::new(),
        held: Held::default(),
        seen: 0,
        value: 0.0,
        plain_steps: 0,
        began: None,
        exact: true,
    };
    let mut cotangent: Option<Tensor> = None;
    let mut growth: Vec<(usize, f64)> = Vec::new();
    let mut clip = Clip::new(dynamics, schedule, objective).map_err(RunError::tensor(schedule.steps))?;
    let mut forward_seconds = None;
    let mut differentiated_steps = 0;
    // The kept state that is the present one; none if it is that of the plain run.
    let mut present = None;
    for action in schedule.actions() {
        match action {
            Action::Advance { from, to } => {
                if let Some(step) = present.take() {
                    executor.resume(step)?;
                }
                for step in from..to {
                    executor.advance(step)?;
                    if executor.plain_steps.is_multiple_of(16) {
                        progress((executor.plain_steps + 3 * differentiated_steps) as f64 / total);
                    }
                }
            }
            Action::Store { step } => executor.store(step, schedule.is_rounded())?,
            Action::Restore { step } => present = Some(step),
            Action::Discard { step } => executor.discard(step),
            Action::Tape { from, to } => {
                log::trace!("goes back over the steps {from} ... {}", to - 1);
                forward_seconds.get_or_insert_with(|| clock.elapsed().as_secs_f64());
                let transient = match present.take() {
                    Some(_) => None,
                    None => Some(dynamics.keep(&executor.plain, false)?),
                };
                let mut found = executor.tape(from, to, transient, cotangent)?;
                // Not at every step, because it reads the whole state.
                if from / CHECK_EVERY != to / CHECK_EVERY || from == schedule.first {
                    let norm = norm(dynamics, &found).map_err(RunError::tensor(from))?;
                    if !norm.is_finite() {
                        let until = growth.last().map_or(schedule.steps, |(step, _)| *step);
                        return Err(RunError::Gradient { step: from, until, norm });
                    }
                    growth.push((from, norm));
                    if let Some(clip) = &mut clip {
                        found = clip.apply(dynamics, found, to).map_err(RunError::tensor(from))?;
                    }
                }
                cotangent = Some(found);
                differentiated_steps += to - from;
                progress((executor.plain_steps + 3 * differentiated_steps) as f64 / total);
            }
        }
    }
    let state = match cotangent {
        Some(c) => c,
        None => dynamics.tensor(start)?.zeros_like().map_err(RunError::tensor(0))?,
    };
    Ok(Gradient {
        value: executor.value,
        state,
        growth,
        clipped: clip.map_or(0, |clip| clip.count),
        forward_seconds: forward_seconds.unwrap_or_else(|| clock.elapsed().as_secs_f64()),
        storage: executor.held.peak,
        plain_steps: executor.plain_steps,
        differentiated_steps,
    })
}

impl<D: Dynamics, O: Objective + ?Sized> Executor<'_, D, O> {
    /// Makes one step of the plain run.
    fn advance(&mut self, step: usize) -> Result<(), RunError> {
        if is_asked_here() {
            return Err(RunError::Stopped);
        }
        self.dynamics.advance(&mut self.plain)?;
        self.plain_steps += 1;
        if let Some(kept) = self.kept.get_mut(&step) {
            self.held.remove(self.dynamics.kept_bytes(kept));
            self.dynamics.settle(kept, &self.plain);
            self.held.add(self.dynamics.kept_bytes(kept));
        }
        if step == self.seen {
            self.seen += 1;
            let weight = self.objective.weight(self.seen);
            if weight.is_some() || self.seen.is_multiple_of(CHECK_EVERY) {
                self.dynamics.check(&self.plain)?;
            }
            if let Some(weight) = weight {
                let fields = self.dynamics.look(&mut self.plain)?;
                self.value += weight * value(self.objective, &fields).map_err(RunError::tensor(step))?;
            }
        }
        Ok(())
    }

    fn store(&mut self, step: usize, rounded: bool) -> Result<(), RunError> {
        let kept = self.dynamics.keep(&self.plain, rounded)?;
        self.held.add(self.dynamics.kept_bytes(&kept));
        self.kept.insert(step, kept);
        self.exact &= !rounded;
        Ok(())
    }

    fn discard(&mut self, step: usize) {
        if let Some(kept) = self.kept.remove(&step) {
            self.held.remove(self.dynamics.kept_bytes(&kept));
        }
    }

    /// Sets the plain run back to a kept state.
    fn resume(&mut self, step: usize) -> Result<(), RunError> {
        let kept = self.kept.get(&step).ok_or_else(|| not_kept(step))?;
        self.dynamics.resume(&mut self.plain, kept)
    }

    /// Maps the cotangent of the state before step `to` to that of the state before step `from`. The segment begins at
    /// `transient`, or else at the kept state of `from`.
    fn tape(
        &mut self,
        from: usize,
        to: usize,
        transient: Option<D::Kept>,
        cotangent: Option<Tensor>,
    ) -> Result<Tensor, RunError> {
        let failed = RunError::tensor(from);
        if is_asked_here() {
            return Err(RunError::Stopped);
        }
        // For steps that are taped before the plain run reached them, the plain run now finds the objective's values.
        for step in self.seen.max(from)..to {
            self.advance(step)?;
        }
        let last = self.tape.take();
        let begin = match &transient {
            Some(kept) => kept,
            None => self.kept.get(&from).ok_or_else(|| not_kept(from))?,
        };
        let (mut tape, variable) = self.dynamics.tape(begin, last, &self.plain)?;
        drop(transient);
        let end =
            self.began.replace((from, variable.as_detached_tensor())).filter(|(step, _)| *step == to && self.exact);
        let end = end.map(|(_, state)| state);
        // A single step without a term of the objective needs no graph.
        if let Some(cotangent) = cotangent.as_ref().filter(|_| to == from + 1 && self.objective.weight(to).is_none()) {
            if let Some(found) = self.dynamics.pull_back(&mut tape, &variable, end.as_ref(), cotangent)? {
                let bytes = self.dynamics.taped_bytes(&tape);
                self.held.add(bytes);
                self.held.remove(bytes);
                self.tape = Some(tape);
                return Ok(found);
            }
        }
        let mut state = variable.as_tensor().clone();
        let mut terms: Vec<Tensor> = Vec::new();
        let mut taped = Vec::with_capacity(to - from);
        for step in from..to {
            let after = if step + 1 == to { end.as_ref() } else { None };
            state = self.dynamics.advance_taped(&mut tape, &state, after)?;
            let bytes = self.dynamics.taped_bytes(&tape);
            self.held.add(bytes);
            taped.push(bytes);
            if let Some(weight) = self.objective.weight(step + 1) {
                let fields = self.dynamics.fields(&mut tape, &state)?;
                let value = self.objective.value(&fields).and_then(|value| value.affine(weight, 0.0));
                terms.push(value.map_err(&failed)?);
            }
        }
        self.tape = Some(tape);
        if let Some(cotangent) = cotangent {
            terms.push(state.apply_op1(Seed(cotangent)).map_err(&failed)?);
        }
        let mut terms = terms.into_iter();
        let found = match terms.next() {
            None => variable.zeros_like().map_err(&failed)?,
            Some(mut loss) => {
                for term in terms {
                    loss = (loss + term).map_err(&failed)?;
                }
                let mut gradients = loss.backward().map_err(&failed)?;
                gradients.remove(variable.as_tensor()).ok_or_else(|| {
                    failed(candle_core::Error::Msg("no gradient reached the start of the segment".into()))
                })?
            }
        };
        taped.into_iter().for_each(|bytes| self.held.remove(bytes));
        Ok(found)
    }
}

fn not_kept(step: usize) -> RunError {
    RunError::tensor(step)(candle_core::Error::Msg("the schedule goes back to a state that it has not kept".into()))
}

/// A scalar whose derivative by its argument is a given cotangent: the end of a segment, where candle's `backward`
/// begins. (The scalar product of state and cotangent would do too, with several more passes over the state. The value
/// is not used, so it is zero.)
struct Seed(Tensor);

impl CustomOp1 for Seed {
    fn name(&self) -> &'static str {
        "seed"
    }
    fn cpu_fwd(&self, storage: &CpuStorage, _: &Layout) -> candle_core::Result<(CpuStorage, Shape)> {
        let zero = match storage {
            CpuStorage::F32(_) => CpuStorage::F32(vec![0.0]),
            CpuStorage::F64(_) => CpuStorage::F64(vec![0.0]),
            _ => candle_core::bail!("a state is in f32 or f64"),
        };
        Ok((zero, Shape::from(())))
    }
    fn bwd(&self, _: &Tensor, _: &Tensor, _: &Tensor) -> candle_core::Result<Option<Tensor>> {
        // The loss is a sum with this as a term, so the incoming derivative is 1.
        Ok(Some(self.0.clone()))
    }
}
