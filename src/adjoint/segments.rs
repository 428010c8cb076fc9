//! The gradient of a run by its initial state, by the actions of a [`Schedule`].
//!
//! Forward without a graph, keeping states. Then, last step to first: make a kept state a variable, run a segment (one
//! step or more) on the graph, multiply its end with the cotangent that the segment behind it left, call candle's
//! `backward`, and read the cotangent of the segment's start. Everything that a segment adds to the derivative by a
//! design travels in that cotangent: positions and masses of wall particles are rows of the state, and each step adds
//! its share to their cotangent. So the sums are the same, in the same order, whatever the schedule: bit for bit equal
//! to one tape.

use super::schedule::{Action, Costs, Schedule};
use crate::config::scene::Kernels;
use crate::numerics::blocks::Block;
use crate::numerics::lanes::Real;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::NeighbourList;
use crate::sph::model::Model;
use crate::sph::operators::pairs::stride;
use crate::sph::operators::rates::record_fields;
use crate::sph::solver::{Snapshot, Solver, SolverError, TensorSolver};
use crate::sph::step::Neighbourhood;
use candle_core::{CpuStorage, CustomOp1, Device, Layout, Shape, Tensor, Var};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Something that advances a state, with and without a graph: the solver, a surrogate.
pub trait Dynamics {
    /// A state to come back to.
    type Snapshot;
    /// The same as a schedule keeps it, perhaps rounded.
    type Kept;
    /// A run without a graph.
    type Plain;
    /// A run on the graph.
    type Graph;

    fn start(&self, snapshot: &Self::Snapshot) -> Result<Self::Plain, SolverError>;
    fn advance(&self, run: &mut Self::Plain) -> Result<(), SolverError>;
    /// The snapshot's state as a tensor of its own.
    fn tensor(&self, snapshot: &Self::Snapshot) -> Result<Tensor, SolverError>;
    /// One step on the graph; `after` is the state that it leads to, if that is known to the bit.
    fn advance_graph(
        &self,
        run: &mut Self::Graph,
        state: &Tensor,
        after: Option<&Tensor>,
    ) -> Result<Tensor, SolverError>;

    /// Keeps the present state, `rounded` to single precision or exactly.
    fn keep(&self, run: &Self::Plain, rounded: bool) -> Result<Self::Kept, SolverError>;
    /// `run` has made the step behind the kept state: what was found in it need not be found again.
    fn settle(&self, kept: &mut Self::Kept, run: &Self::Plain);
    /// Takes `run` back to a kept state.
    fn resume(&self, run: &mut Self::Plain, kept: &Self::Kept) -> Result<(), SolverError>;
    /// Starts on the graph at a kept state: the run, and the state as a tensor of its own. `last` is the run before
    /// this one and `plain` the run without a graph, to take over what they share with the new one.
    fn start_graph(
        &self,
        kept: &Self::Kept,
        last: Option<Self::Graph>,
        plain: &Self::Plain,
    ) -> Result<(Self::Graph, Tensor), SolverError>;

    /// Bytes of a kept state.
    fn kept_bytes(&self, kept: &Self::Kept) -> Bytes;
    /// Bytes that the last step of `run` put on the tape.
    fn taped_bytes(&self, run: &Self::Graph) -> Bytes;
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
pub trait Objective<D: Dynamics> {
    /// The weight of the state after `step` steps; `None` if the objective does not look at it.
    fn weight(&self, step: usize) -> Option<f64>;
    fn value(&self, run: &mut D::Plain) -> Result<f64, SolverError>;
    /// The same on the graph, a scalar in f64 or f32.
    fn tensor(&self, run: &D::Graph, state: &Tensor) -> Result<Tensor, SolverError>;
}

/// What a gradient run found.
pub struct Gradient {
    /// The objective.
    pub value: f64,
    /// Its derivative by the state at the schedule's first step, `[F, N]`.
    pub state: Tensor,
    /// Seconds of the first run through, without a graph, and of everything behind it.
    pub forward_seconds: f64,
    pub backward_seconds: f64,
    /// Most bytes that were kept and on the tape at the same time: what [`Schedule::storage`] predicts.
    pub storage: usize,
    /// Steps that were run without and with graph.
    pub plain_steps: usize,
    pub differentiated_steps: usize,
}

/// Called after each segment (or each forward step) with the share of the work that is done.
pub type Progress<'a> = &'a mut dyn FnMut(f64);

/// Runs `schedule` from `start` and differentiates.
///
/// Long segments recurse deeply in candle's `backward` and `Drop` (about 250 bytes of stack per chained operator);
/// this runs on a thread with a stack of 1 GiB of virtual memory, enough for a million operators.
pub fn gradient<D, O>(
    dynamics: &D,
    start: &D::Snapshot,
    schedule: &Schedule,
    objective: &O,
    progress: Progress<'_>,
) -> Result<Gradient, SolverError>
where
    D: Dynamics + Sync,
    D::Snapshot: Sync + Send,
    O: Objective<D> + Sync,
{
    // The closure is only borrowed by one thread at a time.
    let progress = std::sync::Mutex::new(SendPointer(progress));
    std::thread::scope(|scope| {
        let worker = std::thread::Builder::new()
            .name("gradient".into())
            .stack_size(1 << 30)
            .spawn_scoped(scope, || {
                let mut guard = progress.lock().unwrap_or_else(|e| e.into_inner());
                run(dynamics, start, schedule, objective, guard.0)
            })
            .map_err(|source| SolverError::Tensor { step: 0, source: candle_core::Error::Io(source) })?;
        match worker.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

struct SendPointer<'a>(Progress<'a>);
// SAFETY: the calling thread waits in `scope` while the worker uses the closure, so only one thread ever does.
unsafe impl Send for SendPointer<'_> {}

/// Bytes held now and at most. Shared parts count once.
#[derive(Debug, Default)]
struct Held {
    now: usize,
    peak: usize,
    sharing: HashMap<usize, usize>,
}

impl Held {
    fn add(&mut self, bytes: Bytes) {
        let sharing = self.sharing.entry(bytes.identity).or_insert(0);
        self.now += bytes.own + if *sharing == 0 { bytes.shared } else { 0 };
        *sharing += 1;
        self.peak = self.peak.max(self.now);
    }

    fn remove(&mut self, bytes: Bytes) {
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

/// A schedule at work.
struct Executor<'a, D: Dynamics, O> {
    dynamics: &'a D,
    objective: &'a O,
    plain: D::Plain,
    graph: Option<D::Graph>,
    kept: BTreeMap<usize, D::Kept>,
    held: Held,
    /// Steps that the plain run has been through: the objective has their values.
    seen: usize,
    value: f64,
    plain_steps: usize,
    /// Where the last segment began, and the state there: where the one before it ends.
    began: Option<(usize, Tensor)>,
    /// Whether every kept state is a state of the run, not a rounded one.
    exact: bool,
}

fn run<D: Dynamics, O: Objective<D>>(
    dynamics: &D,
    start: &D::Snapshot,
    schedule: &Schedule,
    objective: &O,
    progress: Progress<'_>,
) -> Result<Gradient, SolverError> {
    let clock = std::time::Instant::now();
    let counts = schedule.counts();
    // A taped step costs about as much as three without a graph.
    let total = (counts.plain_steps + 3 * counts.differentiated_steps).max(1) as f64;
    let mut executor = Executor {
        dynamics,
        objective,
        plain: dynamics.start(start)?,
        graph: None,
        kept: BTreeMap::new(),
        held: Held::default(),
        seen: 0,
        value: 0.0,
        plain_steps: 0,
        began: None,
        exact: true,
    };
    let mut cotangent: Option<Tensor> = None;
    let mut forward_seconds = None;
    let mut differentiated_steps = 0;
    // The present state is this kept one; none: that of the plain run.
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
                forward_seconds.get_or_insert_with(|| clock.elapsed().as_secs_f64());
                let transient = match present.take() {
                    Some(_) => None,
                    None => Some(dynamics.keep(&executor.plain, false)?),
                };
                cotangent = Some(executor.tape(from, to, transient, cotangent)?);
                differentiated_steps += to - from;
                progress((executor.plain_steps + 3 * differentiated_steps) as f64 / total);
            }
        }
    }
    let state = match cotangent {
        Some(c) => c,
        None => dynamics.tensor(start)?.zeros_like().map_err(|source| SolverError::Tensor { step: 0, source })?,
    };
    let seconds = clock.elapsed().as_secs_f64();
    let forward_seconds = forward_seconds.unwrap_or(seconds);
    Ok(Gradient {
        value: executor.value,
        state,
        forward_seconds,
        backward_seconds: seconds - forward_seconds,
        storage: executor.held.peak,
        plain_steps: executor.plain_steps,
        differentiated_steps,
    })
}

impl<D: Dynamics, O: Objective<D>> Executor<'_, D, O> {
    /// One step of the plain run.
    fn advance(&mut self, step: usize) -> Result<(), SolverError> {
        self.dynamics.advance(&mut self.plain)?;
        self.plain_steps += 1;
        if let Some(kept) = self.kept.get_mut(&step) {
            self.held.remove(self.dynamics.kept_bytes(kept));
            self.dynamics.settle(kept, &self.plain);
            self.held.add(self.dynamics.kept_bytes(kept));
        }
        if step == self.seen {
            self.seen += 1;
            if let Some(weight) = self.objective.weight(self.seen) {
                self.value += weight * self.objective.value(&mut self.plain)?;
            }
        }
        Ok(())
    }

    fn kept(&self, step: usize) -> Result<&D::Kept, SolverError> {
        self.kept.get(&step).ok_or_else(|| SolverError::Tensor {
            step,
            source: candle_core::Error::Msg("the schedule goes back to a state that it has not kept".into()),
        })
    }

    fn store(&mut self, step: usize, rounded: bool) -> Result<(), SolverError> {
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

    /// Takes the plain run back to a kept state.
    fn resume(&mut self, step: usize) -> Result<(), SolverError> {
        let kept = self.kept.get(&step);
        match kept {
            Some(kept) => self.dynamics.resume(&mut self.plain, kept),
            None => self.kept(step).map(|_| ()),
        }
    }

    /// The cotangent of the state before step `from` from that of the state before step `to`. Begins at `transient`,
    /// or else at the kept state of `from`.
    fn tape(
        &mut self,
        from: usize,
        to: usize,
        transient: Option<D::Kept>,
        cotangent: Option<Tensor>,
    ) -> Result<Tensor, SolverError> {
        let failed = |source| SolverError::Tensor { step: from, source };
        // Steps that are taped as soon as they are reached: the objective's values come from the plain run.
        for step in self.seen.max(from)..to {
            self.advance(step)?;
        }
        let last = self.graph.take();
        let begin = match &transient {
            Some(kept) => kept,
            None => self.kept(from)?,
        };
        let (mut graph, tensor) = self.dynamics.start_graph(begin, last, &self.plain)?;
        let variable = Var::from_tensor(&tensor).map_err(failed)?;
        drop(transient);
        let end = self.began.replace((from, tensor)).filter(|(step, _)| *step == to && self.exact);
        let end = end.map(|(_, state)| state);
        let mut state = variable.as_tensor().clone();
        let mut terms: Vec<Tensor> = Vec::new();
        let mut taped = Vec::with_capacity(to - from);
        for step in from..to {
            let after = if step + 1 == to { end.as_ref() } else { None };
            state = self.dynamics.advance_graph(&mut graph, &state, after)?;
            let bytes = self.dynamics.taped_bytes(&graph);
            self.held.add(bytes);
            taped.push(bytes);
            if let Some(weight) = self.objective.weight(step + 1) {
                terms.push(self.objective.tensor(&graph, &state)?.affine(weight, 0.0).map_err(failed)?);
            }
        }
        self.graph = Some(graph);
        if let Some(cotangent) = cotangent {
            terms.push(state.apply_op1(Seed(cotangent)).map_err(failed)?);
        }
        let mut terms = terms.into_iter();
        let found = match terms.next() {
            None => variable.zeros_like().map_err(failed)?,
            Some(mut loss) => {
                for term in terms {
                    loss = (loss + term).map_err(failed)?;
                }
                let mut gradients = loss.backward().map_err(failed)?;
                gradients.remove(variable.as_tensor()).ok_or_else(|| SolverError::Tensor {
                    step: from,
                    source: candle_core::Error::Msg("no gradient reached the start of the segment".into()),
                })?
            }
        };
        taped.into_iter().for_each(|bytes| self.held.remove(bytes));
        Ok(found)
    }
}

/// A scalar whose derivative by its argument is a given cotangent: the end of a segment, where candle's `backward`
/// begins. (The scalar product of state and cotangent would do, with several more passes over the state; its value is of
/// no use, so this one's is zero.)
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

/// The SPH solver as dynamics.
#[derive(Clone)]
pub struct Sph<R> {
    pub model: Arc<Model<R>>,
    pub kernels: Kernels,
}

/// A state that a schedule keeps.
#[derive(Debug)]
pub struct Kept<R> {
    step: usize,
    /// In R, or in f32.
    numbers: Block,
    rounded: bool,
    /// Positions that the neighbour list of the step behind this state is built from; shared between states of the
    /// same list. Never rounded: the list must be the same one.
    reference: Arc<Vec<R>>,
}

impl<R: Real> Dynamics for Sph<R> {
    type Snapshot = Snapshot<R>;
    type Kept = Kept<R>;
    type Plain = Solver<R>;
    type Graph = TensorSolver<R>;

    fn start(&self, snapshot: &Snapshot<R>) -> Result<Solver<R>, SolverError> {
        Solver::restore(self.model.clone(), snapshot)
    }
    fn advance(&self, run: &mut Solver<R>) -> Result<(), SolverError> {
        if self.kernels == Kernels::Composed {
            // The composed operators exist on the graph only: run them there and drop the graph.
            let snapshot = run.snapshot();
            let mut graph = TensorSolver::restore(self.model.clone(), &snapshot, self.kernels)?;
            let state = graph.advance(&self.tensor(&snapshot)?)?;
            crate::sph::step::read(
                &state.contiguous().map_err(|source| SolverError::Tensor { step: run.step, source })?,
                |s: &[R]| {
                    run.state.copy_from_slice(s);
                    Ok(())
                },
            )
            .map_err(|source| SolverError::Tensor { step: run.step, source })?;
            run.neighbourhood = graph.neighbourhood;
            run.step += 1;
            return Ok(());
        }
        run.advance()
    }
    fn tensor(&self, snapshot: &Snapshot<R>) -> Result<Tensor, SolverError> {
        self.state_tensor(snapshot.step, &snapshot.state)
    }
    fn advance_graph(
        &self,
        run: &mut TensorSolver<R>,
        state: &Tensor,
        after: Option<&Tensor>,
    ) -> Result<Tensor, SolverError> {
        run.advance_to(state, after)
    }

    fn keep(&self, run: &Solver<R>, rounded: bool) -> Result<Kept<R>, SolverError> {
        let (scratch, state) = (&self.model.scratch, &run.state);
        let numbers = if rounded {
            let round = |(to, from): (&mut f32, &R)| *to = from.f64() as f32;
            scratch.rounded_states.keep(state.len(), |kept: &mut [f32]| kept.iter_mut().zip(state).for_each(round))
        } else {
            scratch.states.keep(state.len(), |kept: &mut [R]| kept.copy_from_slice(state))
        };
        let numbers = numbers.map_err(|e| SolverError::Tensor { step: run.step, source: candle_core::Error::Io(e) })?;
        Ok(Kept { step: run.step, numbers, rounded, reference: run.neighbourhood.reference.clone() })
    }
    fn settle(&self, kept: &mut Kept<R>, run: &Solver<R>) {
        // If the step built a new list, a replay would build the old one first and then find that it is outdated.
        kept.reference = run.neighbourhood.reference.clone();
    }
    fn resume(&self, run: &mut Solver<R>, kept: &Kept<R>) -> Result<(), SolverError> {
        if kept.rounded {
            let widen = |(to, from): (&mut R, &f32)| *to = R::of(*from as f64);
            kept.numbers.read(|state: &[f32]| run.state.iter_mut().zip(state).for_each(widen));
        } else {
            kept.numbers.read(|state: &[R]| run.state.copy_from_slice(state));
        }
        run.step = kept.step;
        if !Arc::ptr_eq(&run.neighbourhood.reference, &kept.reference) {
            run.neighbourhood
                .rebuild_at(&self.model, &kept.reference)
                .map_err(|source| SolverError::Neighbours { step: kept.step, source })?;
        }
        Ok(())
    }
    fn start_graph(
        &self,
        kept: &Kept<R>,
        last: Option<TensorSolver<R>>,
        plain: &Solver<R>,
    ) -> Result<(TensorSolver<R>, Tensor), SolverError> {
        let neighbourhood = self.neighbourhood(kept, last, plain)?;
        let run = TensorSolver { model: self.model.clone(), neighbourhood, step: kept.step, kernels: self.kernels };
        let tensor = if kept.rounded {
            let state: Vec<R> = kept.numbers.read(|state: &[f32]| state.iter().map(|&x| R::of(x as f64)).collect());
            self.state_tensor(kept.step, &state)?
        } else {
            kept.numbers.read(|state: &[R]| self.state_tensor(kept.step, state))?
        };
        Ok((run, tensor))
    }

    fn kept_bytes(&self, kept: &Kept<R>) -> Bytes {
        let own = kept.numbers.bytes();
        let shared = std::mem::size_of_val(kept.reference.as_slice());
        Bytes { own, shared, identity: Arc::as_ptr(&kept.reference) as usize }
    }
    fn taped_bytes(&self, run: &TensorSolver<R>) -> Bytes {
        let list = &run.neighbourhood.list;
        Bytes { own: self.tape_bytes(list.index.len()), shared: list.bytes(), identity: Arc::as_ptr(list) as usize }
    }
}

impl<R: Real> Sph<R> {
    fn state_tensor(&self, step: usize, state: &[R]) -> Result<Tensor, SolverError> {
        let rows = self.model.layout.state_rows();
        Tensor::from_slice(state, (rows, self.model.particles()), &Device::Cpu)
            .map_err(|source| SolverError::Tensor { step, source })
    }

    /// The list of a kept state: one of the known ones if it is theirs, else built anew, in the last run's memory.
    fn neighbourhood(
        &self,
        kept: &Kept<R>,
        last: Option<TensorSolver<R>>,
        plain: &Solver<R>,
    ) -> Result<Neighbourhood<R>, SolverError> {
        let is_its = |one: &Neighbourhood<R>| Arc::ptr_eq(&one.reference, &kept.reference);
        let mut last = last.map_or_else(Neighbourhood::empty, |run| run.neighbourhood);
        if is_its(&last) {
            return Ok(last);
        }
        if is_its(&plain.neighbourhood) {
            return Ok(plain.neighbourhood.clone());
        }
        last.rebuild_at(&self.model, &kept.reference)
            .map_err(|source| SolverError::Neighbours { step: kept.step, source })?;
        Ok(last)
    }

    /// Bytes of a number in every row of a field with `rows` rows.
    fn field(&self, rows: usize) -> usize {
        rows * self.model.particles() * std::mem::size_of::<R>()
    }

    /// What the operators of a step keep for each other, see [`crate::sph::operators::pairs::Kept`]: positions and records, and a
    /// number or two (to differentiate) for each place of the neighbour list.
    fn operators_bytes(&self, places: usize, differentiate: bool) -> usize {
        let l = self.model.layout;
        let records = stride(record_fields(l.dimension, l.transport, l.heat));
        self.field(4 + records) + places * (1 + differentiate as usize) * std::mem::size_of::<R>()
    }

    /// What a fused step leaves on the tape: the tensors moved state, density, primitives, rates and state, and what its
    /// operators keep.
    fn tape_bytes(&self, places: usize) -> usize {
        let l = self.model.layout;
        let rows = l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows() + l.state_rows();
        self.field(rows) + self.operators_bytes(places, true)
    }

    /// What a kept state and a taped step take, in bytes, in a run that begins with `state`: its list, and its speed
    /// if that is above a tenth of the sound speed (which is chosen as ten times the fastest flow).
    pub fn costs_from(&self, state: &[R]) -> Result<Costs, NeighbourError> {
        let (l, n) = (self.model.layout, self.model.particles());
        let list = Neighbourhood::build(&self.model, state, 0)?.list;
        let component = |i: usize, d: usize| state[(l.velocity() + d) * n + i].f64();
        let speed = |i: usize| (0..l.dimension).map(|d| component(i, d).powi(2)).sum::<f64>().sqrt();
        let fastest = (0..n).map(speed).fold(0.0, f64::max);
        Ok(self.costs_at(&list, fastest))
    }

    fn costs_at(&self, list: &NeighbourList, fastest: f64) -> Costs {
        // A list serves until a particle has moved half the skin.
        let speed = fastest.max(0.1 * crate::sph::plan::sound_speed(&self.model.equation_of_state));
        let steps_per_list = ((0.5 * self.model.skin / (speed * self.model.dt)).ceil() as usize).max(1);
        let (l, n, places) = (self.model.layout, self.model.particles(), list.index.len());
        let reference = self.field(l.dimension);
        // The plain run's fields and list, and a list in the making.
        let fields = l.state_rows() + l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows();
        let run = self.field(fields) + self.operators_bytes(places, false) + reference + 2 * list.bytes();
        // The variable, the cotangents of a state and of its parts, and the records of those of rates and primitives that
        // pair passes read.
        let records = stride(l.rate_rows()) + stride(l.primitive_rows() + 1);
        let parts = 2 * l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows();
        let cotangents = self.field(3 * l.state_rows() + parts + records);
        // What the objective tapes of a step.
        let objective = self.field(l.moved_rows() + 1 + l.primitive_rows()) + self.operators_bytes(places, true);
        Costs {
            state: self.field(l.state_rows()),
            rounded_state: l.state_rows() * n * std::mem::size_of::<f32>(),
            shared: reference,
            shared_steps: steps_per_list,
            tape_step: self.tape_bytes(places),
            tape_shared: list.bytes(),
            working: run + cotangents + objective,
        }
    }
}
