//! The gradient of a run by its initial state, segment by segment.
//!
//! Forward without a graph, keeping the state at the start of each segment. Then, last segment to first: make the
//! kept state a variable, run the segment on the graph, multiply its end with the cotangent that the segment behind
//! it left, call candle's `backward`, and read the cotangent of the segment's start. Everything that a segment adds to
//! the derivative by a design travels in that cotangent: positions and masses of wall particles are rows of the state,
//! and each step adds its share to their cotangent. So the sums are the same, in the same order, whatever the
//! segments: bit for bit equal to one tape.

use super::schedule::Schedule;
use crate::lanes::Real;
use crate::scene::config::Kernels;
use crate::solver::{Snapshot, Solver, SolverError, TensorSolver};
use crate::sph::model::Model;
use candle_core::{Device, Tensor, Var};
use std::sync::Arc;

/// Something that advances a state, with and without a graph: the solver, a surrogate.
pub trait Dynamics {
    /// A state to come back to.
    type Snapshot;
    /// A run without a graph.
    type Plain;
    /// A run on the graph.
    type Graph;

    fn start(&self, snapshot: &Self::Snapshot) -> Result<Self::Plain, SolverError>;
    fn advance(&self, run: &mut Self::Plain) -> Result<(), SolverError>;
    fn snapshot(&self, run: &Self::Plain) -> Self::Snapshot;
    fn start_graph(&self, snapshot: &Self::Snapshot) -> Result<Self::Graph, SolverError>;
    /// The snapshot's state as a tensor of its own.
    fn tensor(&self, snapshot: &Self::Snapshot) -> Result<Tensor, SolverError>;
    fn advance_graph(&self, run: &mut Self::Graph, state: &Tensor) -> Result<Tensor, SolverError>;
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
    /// Seconds without and with graph.
    pub forward_seconds: f64,
    pub backward_seconds: f64,
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

fn run<D: Dynamics, O: Objective<D>>(
    dynamics: &D,
    start: &D::Snapshot,
    schedule: &Schedule,
    objective: &O,
    progress: Progress<'_>,
) -> Result<Gradient, SolverError> {
    let clock = std::time::Instant::now();
    let bounds = schedule.bounds();
    let mut kept = Vec::with_capacity(bounds.len());
    let mut plain = dynamics.start(start)?;
    let mut value = 0.0;
    // A step of the backward run costs about four forward steps.
    let total = (schedule.steps + 4 * (schedule.steps - schedule.first)).max(1) as f64;
    for step in 0..schedule.steps {
        if step >= schedule.first && (step - schedule.first).is_multiple_of(schedule.segment) {
            kept.push(dynamics.snapshot(&plain));
        }
        dynamics.advance(&mut plain)?;
        if let Some(weight) = objective.weight(step + 1) {
            value += weight * objective.value(&mut plain)?;
        }
        if step % 16 == 0 {
            progress(step as f64 / total);
        }
    }
    drop(plain);
    let forward_seconds = clock.elapsed().as_secs_f64();
    let mut cotangent: Option<Tensor> = None;
    while let Some(snapshot) = kept.pop() {
        let (from, to) = bounds[kept.len()];
        cotangent = Some(segment(dynamics, &snapshot, from, to, objective, cotangent)?);
        progress((schedule.steps + 4 * (schedule.steps - from)) as f64 / total);
    }
    let state = match cotangent {
        Some(c) => c,
        None => dynamics.tensor(start)?.zeros_like().map_err(|source| SolverError::Tensor { step: 0, source })?,
    };
    let backward_seconds = clock.elapsed().as_secs_f64() - forward_seconds;
    Ok(Gradient { value, state, forward_seconds, backward_seconds })
}

/// The cotangent of a segment's start from that of its end.
fn segment<D: Dynamics, O: Objective<D>>(
    dynamics: &D,
    snapshot: &D::Snapshot,
    from: usize,
    to: usize,
    objective: &O,
    cotangent: Option<Tensor>,
) -> Result<Tensor, SolverError> {
    let failed = |source| SolverError::Tensor { step: from, source };
    let variable = Var::from_tensor(&dynamics.tensor(snapshot)?).map_err(failed)?;
    let mut graph = dynamics.start_graph(snapshot)?;
    let mut state = variable.as_tensor().clone();
    let mut terms: Vec<Tensor> = Vec::new();
    for step in from..to {
        state = dynamics.advance_graph(&mut graph, &state)?;
        if let Some(weight) = objective.weight(step + 1) {
            terms.push(objective.tensor(&graph, &state)?.affine(weight, 0.0).map_err(failed)?);
        }
    }
    if let Some(cotangent) = cotangent {
        terms.push((state * cotangent).and_then(|t| t.sum_all()).map_err(failed)?);
    }
    let mut terms = terms.into_iter();
    let Some(mut loss) = terms.next() else {
        return variable.zeros_like().map_err(failed);
    };
    for term in terms {
        loss = (loss + term).map_err(failed)?;
    }
    let mut gradients = loss.backward().map_err(failed)?;
    gradients.remove(variable.as_tensor()).ok_or_else(|| SolverError::Tensor {
        step: from,
        source: candle_core::Error::Msg("no gradient reached the start of the segment".into()),
    })
}

/// The SPH solver as dynamics.
#[derive(Clone)]
pub struct Sph<R> {
    pub model: Arc<Model<R>>,
    pub kernels: Kernels,
}

impl<R: Real> Dynamics for Sph<R> {
    type Snapshot = Snapshot<R>;
    type Plain = Solver<R>;
    type Graph = TensorSolver<R>;

    fn start(&self, snapshot: &Snapshot<R>) -> Result<Solver<R>, SolverError> {
        Solver::restore(self.model.clone(), snapshot)
    }
    fn advance(&self, run: &mut Solver<R>) -> Result<(), SolverError> {
        if self.kernels == Kernels::Composed {
            // The composed operators exist on the graph only: run them there and drop the graph.
            let snapshot = run.snapshot();
            let mut graph = self.start_graph(&snapshot)?;
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
    fn snapshot(&self, run: &Solver<R>) -> Snapshot<R> {
        run.snapshot()
    }
    fn start_graph(&self, snapshot: &Snapshot<R>) -> Result<TensorSolver<R>, SolverError> {
        TensorSolver::restore(self.model.clone(), snapshot, self.kernels)
    }
    fn tensor(&self, snapshot: &Snapshot<R>) -> Result<Tensor, SolverError> {
        let rows = self.model.layout.state_rows();
        Tensor::from_slice(&snapshot.state, (rows, self.model.particles()), &Device::Cpu)
            .map_err(|source| SolverError::Tensor { step: snapshot.step, source })
    }
    fn advance_graph(&self, run: &mut TensorSolver<R>, state: &Tensor) -> Result<Tensor, SolverError> {
        run.advance(state)
    }
}

impl<R: Real> Sph<R> {
    /// What a kept state and a taped step take, in bytes: the state and the list's reference positions; the tensors of
    /// a step and the list (counted as if rebuilt in every step: the upper bound).
    pub fn costs(&self, list_bytes: usize) -> super::schedule::Costs {
        let (l, n) = (self.model.layout, self.model.particles());
        let number = std::mem::size_of::<R>();
        let rows = l.state_rows() + l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows();
        super::schedule::Costs {
            state: (l.state_rows() + l.dimension) * n * number,
            tape_step: rows * n * number + list_bytes + l.dimension * n * number,
        }
    }
}
