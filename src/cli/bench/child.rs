//! Measures a case in its own process, with a fixed number of threads and its own peak memory.

use super::case::{Case, Keeping, Kind, Length, Measured, Outcome, Request, Size, Source};
use super::{needs, surrogate};
use crate::adjoint::gradient::gradient;
use crate::adjoint::schedule::{Costs, Schedule, TooSmall};
use crate::adjoint::{Dynamics, Fields, Objective, RunError};
use crate::cli::prepare::{build, compute};
use crate::config::scene::{Family, Precision};
use crate::error::{BadInput, Error};
use crate::numerics::candle::read;
use crate::numerics::lanes::{counted_operations, InstructionSet};
use crate::numerics::roofline::Roofline;
use crate::numerics::thread_pool::ThreadPool;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::neighbourhood::Neighbourhood;
use crate::particles::tag;
use crate::report::memory::{peak_memory_bytes, reset_peak_memory};
use crate::report::text::bytes;
use crate::scene::accuracy::points;
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Snapshot;
use crate::sph::standard::Standard;
use crate::sph::Model;
use crate::sph::Sweeps;
use candle_core::Tensor;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Instant;

/// Number of steps after which a scene with every field is compared with its plan.
const COMPARED_STEPS: usize = 50;

/// Executes a request and prints the answer as one line of JSON.
pub fn run(request: &str) -> anyhow::Result<()> {
    let request: Request =
        serde_json::from_str(request).map_err(|error| BadInput::new(error.to_string()).place("--case"))?;
    let wanted = match &request {
        Request::Row(case) => case.threads,
        Request::Count(_) => 1,
        Request::Accuracy { threads, .. } => *threads,
    };
    let threads = ThreadPool::global().threads();
    if threads != wanted {
        let problem = format!("candle has {threads} threads instead of {wanted}");
        return Err(Error::run(problem, "CANDLE_NUM_THREADS sets their number").into());
    }
    let answer = match &request {
        Request::Row(case) => serde_json::to_string(&match (&case.source, case.precision) {
            (Source::Network(network), _) => surrogate::measure(case, *network).map(Ok),
            (_, Precision::F32) => measure::<f32>(case),
            (_, Precision::F64) => measure::<f64>(case),
        }?)?,
        Request::Count(case) => serde_json::to_string(&operations(case)?)?,
        Request::Accuracy { quick, .. } => serde_json::to_string(&points(*quick, &mut |_| ())?)?,
    };
    println!("{answer}");
    Ok(())
}

/// A scene that is ready to be measured.
struct Ready<R> {
    dynamics: Sph<R>,
    start: Snapshot<R>,
    /// The objective of a scene with a design, which depends on the scene's number of steps.
    outflow: Option<Arc<dyn Objective + Send>>,
}

impl<R: Sweeps> Ready<R> {
    fn new(case: &Case, source: &Source) -> Result<Self, Error> {
        let (model, start, outflow) = match source {
            Source::Scene(scene) => {
                let config = scene.load()?.config;
                if config.has_design() {
                    let (design, _) = build::<R>(&config)?;
                    (design.model.clone(), design.start(&design.first), Some(design.objective))
                } else {
                    let flow = Scene::<R>::from_config(&config)?;
                    (flow.model, flow.start, None)
                }
            }
            Source::TaylorGreen(size) => {
                let (model, state) = taylor_green(*size);
                (Model::new(model), at_rest(state), None)
            }
            Source::Plan { scene, lacking, forced } => {
                let (model, mut state) = match lacking.size() {
                    Some(size) => taylor_green(size),
                    None => {
                        let (channel, _) = build::<R>(&scene.load()?.config)?;
                        (needs::standard(&channel.model).clone(), channel.start(&channel.first).state)
                    }
                };
                (Model::new(lacking.apply(model, &mut state, *forced)), at_rest(state), None)
            }
            Source::Network(_) => unreachable!("networks are measured by `surrogate`"),
        };
        let rows = model.dimension() * model.particles();
        let start = Snapshot { reference: Arc::new(start.state[..rows].to_vec()), ..start };
        Ok(Self { dynamics: Sph::new(model, compute(case.kernels, case.device)?), start, outflow })
    }

    /// The state after some steps as a new start.
    fn after(&self, steps: usize) -> Result<Snapshot<R>, RunError> {
        let mut solver = self.dynamics.start(&self.start)?;
        for _ in 0..steps {
            self.dynamics.advance(&mut solver)?;
        }
        solver.check()?;
        Ok(Snapshot { step: 0, ..solver.snapshot() })
    }

    /// The differentiated objective: the channel's own, or the squared velocity after `steps` steps.
    fn goal(&self, steps: usize) -> Arc<dyn Objective + Send> {
        match &self.outflow {
            Some(outflow) => outflow.clone(),
            None => Arc::new(SquaredVelocity { steps }),
        }
    }

    fn forward(&self, case: &Case, begin: &Snapshot<R>, measured: &mut Measured) -> Result<(), RunError> {
        let dynamics = &self.dynamics;
        let mut solver = dynamics.start(begin)?;
        let timed = |solver: &mut _, steps: usize| -> Result<f64, RunError> {
            let clock = Instant::now();
            for _ in 0..steps {
                dynamics.advance(solver)?;
            }
            Ok(clock.elapsed().as_secs_f64())
        };
        // Warms up pages, caches and threads.
        let least = match case.length {
            Length::Steps(steps) => steps.min(50),
            Length::Seconds { least, .. } => least,
        };
        let first = timed(&mut solver, least)?;
        measured.steps = match case.length {
            Length::Steps(steps) => steps,
            Length::Seconds { seconds, least } => least.max((seconds * least as f64 / first) as usize),
        };
        for _ in 0..case.blocks {
            if let Length::Steps(_) = case.length {
                solver = dynamics.start(begin)?;
            }
            measured.seconds.push(timed(&mut solver, measured.steps)?);
        }
        solver.check()
    }

    fn backward(
        &self,
        case: &Case,
        begin: &Snapshot<R>,
        costs: Costs,
        measured: &mut Measured,
    ) -> Result<(), RunError> {
        let timed = |steps: usize, schedule: &Schedule| -> Result<(f64, f64), RunError> {
            let clock = Instant::now();
            let found = gradient(&self.dynamics, begin, schedule, &*self.goal(steps), &mut |_| ())?;
            let seconds = clock.elapsed().as_secs_f64();
            Ok((seconds, found.forward_seconds))
        };
        let steps = match case.length {
            Length::Steps(steps) => steps,
            Length::Seconds { seconds, least } => {
                let (first, _) = timed(least, &Schedule::every_state(least, 0, false))?;
                // The start of a gradient (its first list, new memory of the process) takes as long as some steps, so it
                // runs several times the needed number, if memory suffices.
                let mut steps = (6 * least).max((seconds * least as f64 / first) as usize);
                let fits =
                    |steps| case.keeping.schedule(steps, costs).is_ok_and(|s| s.memory(costs) <= case.memory_limit);
                while steps > least && !fits(steps) {
                    steps = (steps / 2).max(least);
                }
                steps
            }
        };
        // `measure` has checked that there is a schedule; more steps never need less memory.
        let schedule = case.keeping.schedule(steps, costs).unwrap_or(Schedule::every_state(steps, 0, false));
        measured.steps = steps;
        measured.predicted_bytes = Some(schedule.memory(costs));
        // Warms up pages, caches and threads.
        let few = steps.min(24);
        timed(few, &Schedule::every_state(few, 0, false))?;
        for _ in 0..case.blocks {
            let (seconds, forward) = timed(steps, &schedule)?;
            measured.seconds.push(seconds);
            measured.forward_seconds.push(forward);
        }
        Ok(())
    }
}

/// The plane or spatial vortices of so many particles, disordered.
pub fn taylor_green<R: Sweeps>(size: Size) -> (Standard<R>, Vec<R>) {
    let Size { dimension, per_side } = size;
    // A disorder of a tenth of a spacing, because an exact lattice would persist for a while.
    let (family, size) = if dimension == 2 { (Family::TaylorGreen, 1.0) } else { (Family::TaylorGreen3d, TAU) };
    let mut config = family.defaults_with("standard");
    (config.resolution.dx, config.resolution.smoothing_length) = (size / per_side as f64, 1.0);
    (config.flow.reynolds, config.time.cfl, config.time.jitter) = (100.0, 0.25, 0.1);
    // Steps of the largest size.
    config.time.steps = Some(1);
    let flow = Scene::<R>::from_config(&config).expect("vortices have no shape to be wrong");
    (needs::standard(&flow.model).clone(), flow.start.state)
}

/// The objective of gradients in scenes without heat: the sum of u^2 over the fluid at the last step.
struct SquaredVelocity {
    steps: usize,
}

impl Objective for SquaredVelocity {
    fn weight(&self, step: usize) -> Option<f64> {
        (step == self.steps).then_some(1.0)
    }

    fn value(&self, fields: &Fields) -> candle_core::Result<Tensor> {
        let fluid: Vec<f64> = fields.tags.iter().map(|&t| f64::from(u8::from(t == tag::FLUID))).collect();
        let fluid = Tensor::new(fluid, fields.velocity.device())?.to_dtype(fields.velocity.dtype())?;
        fields.velocity.sqr()?.sum(0)?.mul(&fluid)?.sum_all()
    }
}

/// A state at step 0, whose list's reference is filled in by [`Ready::new`].
fn at_rest<R>(state: Vec<R>) -> Snapshot<R> {
    Snapshot { step: 0, parts: 1, least_parts: 1, state, reference: Arc::new(Vec::new()) }
}

impl Keeping {
    /// The schedule of a run; an error if none is small enough.
    fn schedule(self, steps: usize, costs: Costs) -> Result<Schedule, TooSmall> {
        let every = Schedule::every_state(steps, 0, false);
        Ok(match self {
            Self::EveryState => every,
            Self::Rounded => Schedule::every_state(steps, 0, true),
            Self::LeastMemory => Schedule::segments(steps, Schedule::least_memory(steps, costs)),
            Self::Segments(length) => Schedule::segments(steps, length),
            Self::Binomial(states) => Schedule::binomial(steps, 0, states),
            Self::Truncated(horizon) => Schedule::every_state(steps, steps - horizon.min(steps), false),
            Self::Taped => Schedule::taped(steps),
            Self::Within(size) => Schedule::within(steps, 0, costs, size.bytes())?,
            Self::Share(share) => {
                let budget = costs.working + (share * every.storage(costs) as f64) as usize;
                Schedule::within(steps, 0, costs, budget)?
            }
        })
    }
}

fn measure<R: Sweeps>(case: &Case) -> anyhow::Result<Outcome> {
    let failed = |e: RunError| e.advised("a smaller time.cfl").of(case.label());
    let ready = Ready::<R>::new(case, &case.source)?;
    reset_peak_memory();
    let begin = ready.after(case.warm_up).map_err(failed)?;
    let lost = |step| move |source| failed(RunError::Neighbours { step, source });
    let pairs = count_pairs(&ready.dynamics.model, &begin.state).map_err(lost(case.warm_up))?;
    let instruction_set = InstructionSet::best().name().into();
    let (dimension, time_step) = (ready.dynamics.model.dimension(), ready.dynamics.model.dt);
    let mut measured = Measured { dimension, pairs, instruction_set, time_step, ..Default::default() };
    match case.kind {
        Kind::Forward => ready.forward(case, &begin, &mut measured).map_err(failed)?,
        Kind::Gradient | Kind::Training => {
            // Memory of states and taped steps, by the first neighbour list.
            let costs = ready.dynamics.costs_from(&ready.start.state).map_err(lost(0))?;
            let least = match case.length {
                Length::Steps(steps) => steps,
                Length::Seconds { least, .. } => least,
            };
            match case.keeping.schedule(least, costs).map(|schedule| schedule.memory(costs)) {
                Ok(needed) if needed <= case.memory_limit => {}
                Ok(needed) => return Ok(Err(format!("predicted to take {}, above --memory-limit", bytes(needed)))),
                Err(TooSmall { least }) => return Ok(Err(format!("no schedule takes less than {}", bytes(least)))),
            }
            ready.backward(case, &begin, costs, &mut measured).map_err(failed)?;
        }
    }
    measured.peak_memory_bytes = peak_memory_bytes();
    if case.has_roofline() {
        let bytes = bytes_per_step(case.kind, &ready.dynamics.model, &begin.state).map_err(lost(case.warm_up))?;
        let roofline = Roofline::measure::<R>(bytes);
        measured.bytes_per_step = Some(bytes);
        measured.peak_gflops = Some(1e-9 * roofline.operations);
        measured.gigabytes_per_second = Some(1e-9 * roofline.bytes);
    }
    if let Source::Plan { scene, lacking, forced: true } = &case.source {
        let own = Source::Plan { scene: scene.clone(), lacking: *lacking, forced: false };
        let own = Ready::<R>::new(case, &own)?;
        let difference = difference(case.kind, &own, &ready).map_err(failed)?;
        // JSON has no NaN, which would be read as "not compared".
        if !difference.is_finite() {
            let problem = format!("{}: the difference from the plan is {difference}", case.label());
            return Err(Error::run(problem, "a smaller time.cfl").into());
        }
        measured.difference = Some(difference);
    }
    Ok(Ok(measured))
}

/// Steps whose operations are counted, and those before: what a run does once is not in the difference.
const COUNTED: [usize; 2] = [2, 6];

/// The operations of a step of a case, in f64. Boxes of vortices are counted at a size at which one lane is quick enough: those of a particle
/// do not depend on it.
fn operations(case: &Case) -> anyhow::Result<f64> {
    let failed = |e: RunError| e.advised("a smaller time.cfl").of(case.label());
    let (source, times) = match &case.source {
        Source::TaylorGreen(size) => {
            let small = Size { per_side: size.per_side.min(if size.dimension == 2 { 64 } else { 16 }), ..*size };
            (Source::TaylorGreen(small), size.particles() as f64 / small.particles() as f64)
        }
        source => (source.clone(), 1.0),
    };
    let ready = Ready::<f64>::new(case, &source)?;
    let begin = ready.after(case.warm_up.min(10)).map_err(failed)?;
    let run = |steps: usize| -> Result<u64, RunError> {
        let before = counted_operations();
        match case.kind {
            Kind::Forward => {
                let mut solver = ready.dynamics.start(&begin)?;
                (0..steps).try_for_each(|_| ready.dynamics.advance(&mut solver))?;
            }
            Kind::Gradient | Kind::Training => {
                let goal = SquaredVelocity { steps };
                gradient(&ready.dynamics, &begin, &Schedule::every_state(steps, 0, false), &goal, &mut |_| ())?;
            }
        }
        Ok(counted_operations() - before)
    };
    let [few, more] = [run(COUNTED[0]).map_err(failed)?, run(COUNTED[1]).map_err(failed)?];
    Ok(times * (more as f64 - few as f64) / (COUNTED[1] - COUNTED[0]) as f64)
}

/// Bytes of all arrays that a step reads or writes, each once: the state, the neighbour list and what is derived from it, fields and pairs
/// that a sweep leaves for the next one. In a gradient those of a step without a graph (which keeps its state), of one on the tape, and
/// cotangents.
fn bytes_per_step<R: Sweeps>(kind: Kind, model: &Model<R>, state: &[R]) -> Result<usize, NeighbourError> {
    let list = Neighbourhood::build(&model.reach(), state)?.list;
    let memory = model.memory(&list);
    let (lists, kept) = (list.bytes() + memory.tables, size_of_val(state));
    Ok(match kind {
        Kind::Forward => memory.run + lists,
        Kind::Gradient | Kind::Training => memory.run + 2 * lists + 2 * kept + memory.tape + memory.cotangents,
    })
}

/// Number of directed pairs (i, j) within the cut-off, i fluid and j any, over which the force on the fluid sums.
pub fn count_pairs<R: Sweeps>(model: &Model<R>, position: &[R]) -> Result<usize, NeighbourError> {
    let list = Neighbourhood::build(&model.reach(), position)?.list;
    let (n, domain, cutoff) = (model.particles(), &model.domain, model.reach().cutoff);
    let square = |i: usize, j: usize| -> f64 {
        let along = |d: usize| domain.nearest(d, position[d * n + i].f64() - position[d * n + j].f64());
        (0..domain.dimension).map(|d| along(d).powi(2)).sum()
    };
    let of = |i: &u32| {
        let i = *i as usize;
        let row = &list.index[i * list.capacity..][..list.count[i] as usize];
        row.iter().filter(|&&j| square(i, j as usize) < cutoff * cutoff).count()
    };
    Ok(list.fluid_rows.iter().map(of).sum())
}

/// The difference of a scene with every field from its plan, in states after some steps or in gradients.
fn difference<R: Sweeps>(kind: Kind, own: &Ready<R>, forced: &Ready<R>) -> Result<f64, RunError> {
    let (a, b) = (needs::standard(&own.dynamics.model).layout, needs::standard(&forced.dynamics.model).layout);
    let n = own.dynamics.model.particles();
    let result = |ready: &Ready<R>| -> Result<Vec<R>, RunError> {
        if kind == Kind::Forward {
            return Ok(ready.after(COMPARED_STEPS)?.state);
        }
        let (schedule, goal) = (Schedule::segments(COMPARED_STEPS, 10), ready.goal(COMPARED_STEPS));
        let found = gradient(&ready.dynamics, &ready.start, &schedule, &*goal, &mut |_| ())?;
        let contiguous = found.state.contiguous().map_err(|source| RunError::Tensor { step: 0, source })?;
        read(&contiguous, |values: &[R]| Ok(values.to_vec())).map_err(|source| RunError::Tensor { step: 0, source })
    };
    Ok(needs::difference(n, (&result(own)?, a), (&result(forced)?, b)))
}
