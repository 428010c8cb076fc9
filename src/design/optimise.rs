//! The optimisation loop: gradient, record, step, checkpoint.

use super::adam::{project, Adam};
use crate::adjoint::gradient::gradient;
use crate::adjoint::schedule::{Costs, Schedule};
use crate::config::scene::{Config, GradientMode, Precision};
use crate::design::shape::MAX_SLOPE;
use crate::design::space::DesignSpace;
use crate::error::{BadInput, Error};
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;

/// Everything that the next epoch depends on, and the record of those before.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// The design that the next epoch evaluates.
    pub offsets: Vec<f64>,
    pub adam: Adam,
    pub history: Vec<Epoch>,
    /// Epoch of the lowest loss.
    pub best: usize,
}

/// One evaluated design.
#[derive(Debug, Clone, PartialEq)]
pub struct Epoch {
    pub offsets: Vec<f64>,
    /// Q in flux form.
    pub q: f64,
    pub loss: f64,
    /// Norm of the loss's gradient by the offsets.
    pub gradient_norm: f64,
    pub seconds: f64,
}

impl Progress {
    pub fn new(config: &Config, offsets: Vec<f64>) -> Self {
        let adam = Adam::new(config.optimise.learning_rate, offsets.len());
        Self { offsets, adam, history: Vec::new(), best: 0 }
    }
}

/// Loss and gradient of a design.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    pub q: f64,
    pub loss: f64,
    pub gradient: Vec<f64>,
    pub forward_seconds: f64,
    pub backward_seconds: f64,
}

/// w sum (offset_{i+1} - offset_i)^2 and its gradient.
pub fn smoothing(weight: f64, offsets: &[f64]) -> (f64, Vec<f64>) {
    let mut gradient = vec![0.0; offsets.len()];
    let mut value = 0.0;
    for k in 1..offsets.len() {
        let difference = offsets[k] - offsets[k - 1];
        value += weight * difference * difference;
        gradient[k] += 2.0 * weight * difference;
        gradient[k - 1] -= 2.0 * weight * difference;
    }
    (value, gradient)
}

/// What keeping a state and taping a step cost in this scene, from its first neighbour list.
pub fn costs<R: Sweeps>(config: &Config, channel: &DesignSpace<R>) -> Result<Costs, Error> {
    let flat = vec![0.0; channel.deformation.variables];
    let state = channel.deformation.state::<R>(&flat);
    let dynamics = Sph::new(channel.model.clone(), config.run.kernels);
    dynamics.costs_from(&state).map_err(|e| Error::run(e.to_string(), "another resolution.dx or time.skin"))
}

/// The schedule that a configuration asks for: what fits into `optimise.memory`, or segments of a given
/// length.
///
/// Errors: a schedule that would not fit, and a budget that is too small for any.
pub fn schedule<R: Sweeps>(config: &Config, channel: &DesignSpace<R>) -> Result<Schedule, Error> {
    let (costs, steps) = (costs(config, channel)?, channel.steps);
    let wanted = &config.optimise;
    let budget = wanted.memory;
    let first = match wanted.gradient {
        GradientMode::Truncated => steps - wanted.horizon.min(steps),
        _ => 0,
    };
    // In f32 a rounded state is the state.
    let rounded = wanted.store == Precision::F32 && config.run.precision == Precision::F64;
    let schedule = match (wanted.gradient, wanted.segment) {
        (GradientMode::Taped, _) => Schedule::taped(steps),
        _ if rounded => Schedule::every_state(steps, first, true),
        (_, 0) => Schedule::within(steps, first, costs, budget.bytes()).map_err(|too_small| {
            let segments = Schedule::least_memory(steps - first, costs);
            BadInput::new(format!(
                "optimise.memory = {budget} is too small for the gradient of {} steps",
                steps - first
            ))
            .allowed(format!("at least {} (one state kept, and very slow)", rounded_up(too_small.least)))
            .advice(format!(
                "--memory {} (no step is run twice)",
                rounded_up(Schedule::segments(steps - first, segments).memory(costs))
            ))
        })?,
        (_, segment) => Schedule::truncated(steps, steps - first, segment),
    };
    let needed = schedule.memory(costs);
    if needed > budget.bytes() {
        let counts = schedule.counts();
        return Err(BadInput::new(format!(
            "the gradient of {} steps ({schedule}) would take about {:.1} MB: {} states of {} kB and {} taped steps of {} kB",
            steps - first,
            needed as f64 / 1e6,
            counts.stored_states,
            if rounded { costs.rounded_state } else { costs.state } / 1000,
            counts.taped_steps,
            costs.tape_step / 1000,
        ))
        .allowed(format!("optimise.memory = {budget}"))
        .advice(format!(
            "--memory {}, or --gradient segments --segment 0 --store f64 (what fits is chosen)",
            rounded_up(needed)
        ))
        .into());
    }
    Ok(schedule)
}

/// A number of bytes as an option, up to the next tenth of a megabyte.
fn rounded_up(bytes: usize) -> String {
    format!("{:.1}MB", (bytes as f64 / 1e5).ceil() / 10.0)
}

/// Evaluates a design and differentiates it.
pub fn evaluate<R: Sweeps>(
    config: &Config,
    channel: &DesignSpace<R>,
    schedule: &Schedule,
    offsets: &[f64],
    progress: &mut dyn FnMut(f64),
) -> Result<Evaluation, Error> {
    let dynamics = Sph::new(channel.model.clone(), config.run.kernels);
    let result = gradient(&dynamics, &channel.start(offsets), schedule, &channel.objective, progress).map_err(|e| {
        Error::run(e.to_string(), "--set time.cfl=0.5 (a smaller time step), or a smaller design.bound")
    })?;
    let mut state_bar: Vec<R> = result
        .state
        .flatten_all()
        .and_then(|s| s.to_vec1::<R>())
        .map_err(|e| Error::run(e.to_string(), "report this: the gradient has the wrong type"))?;
    if schedule.first > 0 {
        channel.deformation.keep_static(&mut state_bar, |i| channel.model.is_fluid(i));
    }
    // Q enters the loss with a minus: more heat is better.
    let by_offsets = channel.deformation.adjoint(&state_bar);
    check_gradient(&by_offsets)?;
    let (penalty, penalty_gradient) = smoothing(config.optimise.smoothing, offsets);
    let loss_gradient = by_offsets.iter().zip(penalty_gradient).map(|(q, p)| p - q).collect();
    Ok(Evaluation {
        q: result.value / channel.objective.scale * channel.spacing,
        loss: penalty - result.value,
        gradient: loss_gradient,
        forward_seconds: result.forward_seconds,
        backward_seconds: result.backward_seconds,
    })
}

/// Every design variable must have received a finite gradient.
fn check_gradient(gradient: &[f64]) -> Result<(), Error> {
    if let Some(k) = gradient.iter().position(|g| !g.is_finite()) {
        return Err(Error::run(
            format!("the gradient by design variable {k} is {}", gradient[k]),
            "--set time.cfl=0.5, a shorter time.end, or --gradient truncated --horizon 100",
        ));
    }
    if let Some(k) = gradient.iter().position(|g| *g == 0.0) {
        return Err(Error::run(
            format!("design variable {k} received no gradient: nothing that the objective sees depends on it"),
            "a longer time.end, or a later part of the run in objective.window",
        ));
    }
    Ok(())
}

/// One epoch: evaluates the present design, records it, and moves on to the next.
pub fn epoch<R: Sweeps>(
    config: &Config,
    channel: &DesignSpace<R>,
    schedule: &Schedule,
    nodes: &[f64],
    state: &mut Progress,
    progress: &mut dyn FnMut(f64),
) -> Result<(), Error> {
    let clock = std::time::Instant::now();
    let found = evaluate(config, channel, schedule, &state.offsets, progress)?;
    let gradient_norm = found.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    state.history.push(Epoch {
        offsets: state.offsets.clone(),
        q: found.q,
        loss: found.loss,
        gradient_norm,
        seconds: clock.elapsed().as_secs_f64(),
    });
    if found.loss < state.history[state.best].loss {
        state.best = state.history.len() - 1;
    }
    state.adam.step(&mut state.offsets, &found.gradient);
    project(&mut state.offsets, nodes, config.design.bound, MAX_SLOPE);
    Ok(())
}
