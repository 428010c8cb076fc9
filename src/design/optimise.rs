//! The optimisation loop: gradient, record, step, checkpoint.

use super::adam::{project, Adam};
use super::diagnostics::start;
use crate::adjoint::schedule::Schedule;
use crate::adjoint::segments::{gradient, Sph};
use crate::error::Error;
use crate::lanes::Real;
use crate::scene::config::{Config, GradientMode};
use crate::scene::heated_channel::HeatedChannel;
use crate::scene::shape::MAX_SLOPE;

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

/// The schedule that a configuration asks for.
///
/// Errors: a taped gradient that would not fit into `optimise.memory_mb`.
pub fn schedule<R: Real>(config: &Config, channel: &HeatedChannel<R>) -> Result<Schedule, Error> {
    let dynamics = Sph { model: channel.model.clone(), kernels: config.run.kernels };
    let costs = dynamics.costs(channel.list_bytes());
    let budget = config.optimise.memory_mb * 1e6;
    let wanted = &config.optimise;
    let length = |steps: usize| match wanted.segment {
        0 => Schedule::least_memory(steps, costs),
        segment => segment,
    };
    let schedule = match wanted.gradient {
        GradientMode::Taped => Schedule::taped(channel.steps),
        GradientMode::Segments => Schedule::segments(channel.steps, length(channel.steps)),
        GradientMode::Truncated => {
            let horizon = wanted.horizon.min(channel.steps);
            Schedule::truncated(channel.steps, horizon, length(horizon))
        }
    };
    let needed = schedule.memory(costs) as f64;
    if needed > budget {
        let best = Schedule::least_memory(channel.steps - schedule.first, costs);
        return Err(Error::run(
            format!(
                "the gradient of {} steps would take about {:.0} MB, more than optimise.memory_mb = {:.0}: {} states of {} kB and {} taped steps of {} kB",
                schedule.steps - schedule.first,
                needed / 1e6,
                wanted.memory_mb,
                schedule.stored_states(),
                costs.state / 1000,
                schedule.taped_steps(),
                costs.tape_step / 1000,
            ),
            format!("--gradient segments --segment {best} (the least memory), or a larger optimise.memory_mb"),
        ));
    }
    Ok(schedule)
}

/// Evaluates a design and differentiates it.
pub fn evaluate<R: Real>(
    config: &Config,
    channel: &HeatedChannel<R>,
    schedule: &Schedule,
    offsets: &[f64],
    progress: &mut dyn FnMut(f64),
) -> Result<Evaluation, Error> {
    let dynamics = Sph { model: channel.model.clone(), kernels: config.run.kernels };
    let result =
        gradient(&dynamics, &start(channel, offsets), schedule, &channel.objective, progress).map_err(|e| {
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
pub fn epoch<R: Real>(
    config: &Config,
    channel: &HeatedChannel<R>,
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
