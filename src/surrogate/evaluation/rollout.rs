//! A rollout of a model: predicted frames are the input of the next ones.
//!
//! After every step kinematic particles get their true positions, positions are wrapped into a periodic box, and fluid
//! that passed the inlet ([`crate::dataset::Heat::resets`]) gets its temperature. A rollout always ends: where the
//! model fails, it is marked as broken (LagrangeBench's never ends once particles have clustered).

use crate::dataset::extent::Extent;
use crate::dataset::{kind, Metadata, Trajectory};
use crate::error::BadInput;
use crate::numerics::interrupt;
use crate::surrogate::predictor::{Frame, Predictor, Scenery};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Number of true frames before the first predicted one, the same for every model.
pub const HISTORY: usize = crate::config::training::MOST_FRAMES;

/// A particle has left an open box if it is this many box lengths outside.
const FAR: f64 = 0.5;

/// Where and why a rollout failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Broken {
    /// The step (from 1) without a usable frame.
    pub step: usize,
    pub reason: String,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// The predicted frames, fewer than requested if the rollout broke.
    pub frames: Vec<Frame>,
    pub broken: Option<Broken>,
    /// Wall-clock time spent in the model.
    pub seconds: f64,
}

/// The first frames of windows of `HISTORY + steps` frames that do not overlap.
pub fn windows(frames: usize, steps: usize) -> impl Iterator<Item = usize> {
    let length = HISTORY + steps;
    (0..frames / length).map(move |k| k * length)
}

/// Predicts `steps` frames from the `HISTORY` frames that begin at frame `start`.
///
/// # Errors
/// [`BadInput`] if the trajectory is too short or the model needs more frames. A model that fails during the rollout is
/// not an error, see [`Rollout::broken`].
pub fn rollout(
    predictor: &dyn Predictor,
    metadata: &Metadata,
    trajectory: &Trajectory,
    start: usize,
    steps: usize,
) -> anyhow::Result<Rollout> {
    let seen = predictor.window();
    if seen > HISTORY {
        return Err(BadInput::new(format!("the model {} wants to see {seen} frames", predictor.name()))
            .allowed(format!("at most {HISTORY}"))
            .into());
    }
    check_length(trajectory, start, steps)?;
    let scenery = Scenery::of(metadata, trajectory);
    let first = start + HISTORY;
    let mut frames: Vec<Frame> = (first - seen..first).map(|frame| Frame::of(trajectory, frame)).collect();
    let mut broken = None;
    let mut seconds = 0.0;
    for step in 0..steps {
        interrupt::check()?;
        let clock = Instant::now();
        let predicted = predictor.next(&scenery, &frames[frames.len() - seen..]);
        seconds += clock.elapsed().as_secs_f64();
        let truth = Frame::of(trajectory, first + step);
        match predicted.and_then(|frame| settle(&scenery, frame, &frames[frames.len() - 1], &truth)) {
            Ok(frame) => frames.push(frame),
            Err(error) => {
                broken = Some(Broken { step: step + 1, reason: format!("{error:#}") });
                break;
            }
        }
    }
    Ok(Rollout { frames: frames.split_off(seen), broken, seconds })
}

/// Applies the conditions that do not depend on the model. It returns an error if the frame is not usable.
fn settle(scenery: &Scenery, mut frame: Frame, before: &Frame, truth: &Frame) -> anyhow::Result<Frame> {
    let extent = Extent::of(scenery.metadata);
    let dimension = extent.dimension();
    if frame.position.len() != truth.position.len() {
        anyhow::bail!("{} coordinates instead of {}", frame.position.len(), truth.position.len());
    }
    if let Some(temperature) = frame.temperature.as_ref().filter(|t| t.len() != scenery.kind.len()) {
        anyhow::bail!("{} temperatures instead of {}", temperature.len(), scenery.kind.len());
    }
    for (i, &k) in scenery.kind.iter().enumerate() {
        let place = i * dimension..(i + 1) * dimension;
        if kind::is_kinematic(k) {
            frame.position[place.clone()].copy_from_slice(&truth.position[place]);
            continue;
        }
        for (d, coordinate) in frame.position[place].iter_mut().enumerate() {
            if !coordinate.is_finite() {
                anyhow::bail!("particle {i} has a position that is not finite");
            }
            *coordinate = extent.wrapped(d, *coordinate);
            let outside = (extent.low[d] - *coordinate).max(*coordinate - extent.low[d] - extent.domain.size[d]);
            if outside > FAR * extent.domain.size[d] {
                anyhow::bail!("particle {i} left the box: {} = {coordinate:.4}", ["x", "y", "z"][d]);
            }
        }
    }
    if let Some(temperature) = &mut frame.temperature {
        let truth = truth.temperature.as_deref();
        settle_temperature(scenery, &before.position, &frame.position, truth, temperature);
        let moved = |i: &usize| !kind::is_kinematic(scenery.kind[*i]);
        if let Some(i) = (0..temperature.len()).filter(moved).find(|&i| !temperature[i].is_finite()) {
            anyhow::bail!("particle {i} has a temperature that is not finite");
        }
    }
    Ok(frame)
}

/// Gives kinematic particles their true temperature, if there is one, and particles that passed the inlet that of the
/// inlet. `before` and `now` are positions `[N, D]` around the step.
pub fn settle_temperature(
    scenery: &Scenery,
    before: &[f64],
    now: &[f64],
    truth: Option<&[f64]>,
    temperature: &mut [f64],
) {
    let (d, bounds) = (scenery.metadata.dim, scenery.metadata.bounds[0]);
    for (i, &k) in scenery.kind.iter().enumerate() {
        if kind::is_kinematic(k) {
            temperature[i] = truth.map_or(temperature[i], |truth| truth[i]);
        } else if let Some(heat) =
            scenery.metadata.heat.as_ref().filter(|h| h.resets(before[i * d], now[i * d], bounds))
        {
            temperature[i] = heat.inlet_temperature;
        }
    }
}

/// Checks that a trajectory has `HISTORY + steps` frames from `start` on.
pub fn check_length(trajectory: &Trajectory, start: usize, steps: usize) -> Result<(), BadInput> {
    let needed = HISTORY + steps;
    if start + needed <= trajectory.frames {
        return Ok(());
    }
    Err(BadInput::new(format!(
        "trajectory {} has {} frames: too few for {HISTORY} true and {steps} predicted ones from frame {start} on",
        trajectory.name, trajectory.frames
    ))
    .allowed(format!("start + {HISTORY} + steps <= {}", trajectory.frames))
    .advice(match (trajectory.frames.saturating_sub(start + HISTORY), start) {
        (0, 0) => "a data set with longer trajectories".to_string(),
        (0, _) => "an earlier start".to_string(),
        (most, 0) => format!("steps={most}"),
        (most, _) => format!("steps={most}, or an earlier start"),
    }))
}
