//! Evaluates a model over windows of a data set: rollouts, and the means of their metrics.

use crate::dataset::extent::Extent;
use crate::dataset::{Metadata, Trajectory};
use crate::error::BadInput;
use crate::surrogate::evaluation::metrics::{self, Counted};
use crate::surrogate::evaluation::rollout::{check_length, rollout, windows, Broken, Rollout, HISTORY};
use crate::surrogate::evaluation::sinkhorn;
use crate::surrogate::predictor::{Frame, Predictor};
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Predicted frames per window.
    pub steps: usize,
    /// Largest number of windows, spread over all; none for all.
    pub windows: Option<usize>,
    pub counted: Counted,
    /// Sinkhorn divergence and E_kin are evaluated at steps 1, 1 + stride, ...; LagrangeBench uses 10.
    pub stride: usize,
    /// Whether to compute the Sinkhorn divergence, which takes longer than a small model.
    pub sinkhorn: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { steps: 20, windows: None, counted: Counted::Moving, stride: 10, sinkhorn: true }
    }
}

/// Means over windows. A broken rollout stands still from there on, so that its values are finite and bad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    pub model: String,
    pub windows: usize,
    pub steps: usize,
    /// Mean over the first n steps of the position's MSE; none with fewer steps.
    pub mse_1: Option<f64>,
    pub mse_5: Option<f64>,
    pub mse_10: Option<f64>,
    pub mse_20: Option<f64>,
    /// Means over all steps.
    pub mse: f64,
    pub mae: f64,
    /// Mean over the Sinkhorn divergences that converged; none if none did.
    pub sinkhorn: Option<f64>,
    /// Number of Sinkhorn divergences that did not converge (particles gathered in a few places).
    pub sinkhorn_failures: usize,
    /// Mean squared error of E_kin.
    pub e_kin: Option<f64>,
    /// Mean over all steps, for data with temperature.
    pub temperature_mse: Option<f64>,
    /// Mean over windows of |predicted - true| outflowing heat, each summed over the steps, over the mean true one.
    pub outflow_error: Option<f64>,
    /// Wall-clock time of the model, without the metrics.
    pub seconds_per_step: f64,
    pub broken: Vec<BrokenWindow>,
    pub curves: Curves,
}

/// Means over windows by step.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Curves {
    pub mse: Vec<f64>,
    pub mae: Vec<f64>,
    pub temperature_mse: Option<Vec<f64>>,
    pub e_kin_predicted: Vec<f64>,
    pub e_kin_true: Vec<f64>,
    pub outflow_predicted: Option<Vec<f64>>,
    pub outflow_true: Option<Vec<f64>>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BrokenWindow {
    pub trajectory: String,
    /// First true frame of the window.
    pub start: usize,
    /// Step (from 1) without a usable frame.
    pub step: usize,
    pub reason: String,
}

/// The windows of a data set as trajectory and first frame: all, or a number of them spread evenly.
///
/// # Errors
/// [`BadInput`] if no trajectory is long enough.
pub fn chosen_windows(trajectories: &[Trajectory], options: &Options) -> Result<Vec<(usize, usize)>, BadInput> {
    if options.steps == 0 || options.stride == 0 || options.windows == Some(0) {
        return Err(BadInput::new("steps, stride or windows is 0").allowed("at least 1"));
    }
    let all: Vec<(usize, usize)> = trajectories
        .iter()
        .enumerate()
        .flat_map(|(index, t)| windows(t.frames, options.steps).map(move |start| (index, start)))
        .collect();
    if all.is_empty() {
        let longest = trajectories
            .iter()
            .max_by_key(|t| t.frames)
            .ok_or_else(|| BadInput::new("the data set has no trajectory").allowed("at least one"))?;
        check_length(longest, 0, options.steps)?;
    }
    let count = options.windows.map_or(all.len(), |count| count.min(all.len()));
    Ok((0..count).map(|k| all[k * all.len() / count]).collect())
}

/// Rolls the model out over windows that do not overlap, and averages its metrics; calls `done` after every window.
///
/// # Errors
/// [`BadInput`] if trajectories are too short; a model that breaks in the first step of every window.
pub fn evaluate_windows(
    predictor: &dyn Predictor,
    metadata: &Metadata,
    trajectories: &[Trajectory],
    options: &Options,
    done: &mut dyn FnMut(),
) -> anyhow::Result<Scores> {
    let windows = chosen_windows(trajectories, options)?;
    let mut scored = Vec::new();
    let mut broken = Vec::new();
    let (mut seconds, mut steps) = (0.0, 0);
    for &(index, start) in &windows {
        let trajectory = &trajectories[index];
        let run = rollout(predictor, metadata, trajectory, start, options.steps)?;
        seconds += run.seconds;
        steps += run.frames.len() + usize::from(run.broken.is_some());
        if let Some(Broken { step, reason }) = run.broken.clone() {
            broken.push(BrokenWindow { trajectory: trajectory.name.clone(), start, step, reason });
        }
        scored.push(score(metadata, trajectory, start, run, options));
        done();
    }
    if broken.len() == windows.len() && broken.iter().all(|window| window.step == 1) {
        anyhow::bail!(
            "the model {} gives no usable frame in any of {} windows; the first: {}",
            predictor.name(),
            windows.len(),
            broken[0].reason
        );
    }
    Ok(averaged(predictor.name(), options, &scored, broken, seconds / steps as f64))
}

/// Metrics of one window, `[steps]` each.
#[derive(Debug, Default)]
struct WindowScores {
    curves: Curves,
    /// None where the divergence did not converge.
    sinkhorn: Vec<Option<f64>>,
    e_kin: Option<f64>,
}

fn score(metadata: &Metadata, trajectory: &Trajectory, start: usize, run: Rollout, options: &Options) -> WindowScores {
    let extent = Extent::of(metadata);
    let counted = options.counted.of(&trajectory.kind);
    let first = start + HISTORY;
    let last_seen = Frame::of(trajectory, first - 1);
    let mut predicted = run.frames;
    while predicted.len() < options.steps {
        predicted.push(predicted.last().unwrap_or(&last_seen).clone());
    }
    let truth: Vec<Frame> = (first..first + options.steps).map(|frame| Frame::of(trajectory, frame)).collect();
    let positions = |frames: &[Frame]| -> Vec<Vec<f64>> {
        frames.iter().map(|frame| metrics::select(&frame.position, metadata.dim, &counted)).collect()
    };
    let (p, t) = (positions(&predicted), positions(&truth));
    let mut curves = Curves::default();
    for (p, t) in p.iter().zip(&t) {
        curves.mse.push(metrics::mean_square(&extent, p, t));
        curves.mae.push(metrics::mean_absolute(&extent, p, t));
    }
    let temperatures = |frame: &Frame| frame.temperature.as_ref().map(|t| metrics::select(t, 1, &counted));
    let pairs = predicted.iter().zip(&truth);
    curves.temperature_mse =
        pairs.map(|(p, t)| Some(metrics::temperature_mean_square(&temperatures(p)?, &temperatures(t)?))).collect();

    let energies = |positions: &[Vec<f64>]| -> Vec<f64> {
        let before = metrics::select(&last_seen.position, metadata.dim, &counted);
        let all: Vec<&Vec<f64>> = std::iter::once(&before).chain(positions).collect();
        all.windows(2).map(|pair| metrics::kinetic_energy(metadata, pair[1], pair[0])).collect()
    };
    (curves.e_kin_predicted, curves.e_kin_true) = (energies(&p), energies(&t));
    // LagrangeBench's pairs of frames: 0 and 1, stride and stride + 1, ...
    let at: Vec<usize> = (1..options.steps).step_by(options.stride).collect();
    let squares = at.iter().map(|&k| (curves.e_kin_predicted[k] - curves.e_kin_true[k]).powi(2));
    let e_kin = (!at.is_empty()).then(|| metrics::mean(squares));
    let sinkhorn = match options.sinkhorn {
        false => vec![],
        true => (0..options.steps.max(2) - 1)
            .step_by(options.stride)
            .map(|k| sinkhorn::divergence(&extent, &p[k], &t[k], sinkhorn::THRESHOLD).ok())
            .collect(),
    };
    if let Some(heat) = &metadata.heat {
        let outflows = |frames: &[Frame]| -> Option<Vec<f64>> {
            let all: Vec<&Frame> = std::iter::once(&last_seen).chain(frames).collect();
            all.windows(2).map(|pair| metrics::outflow(metadata, heat, &counted, pair[1], pair[0])).collect()
        };
        (curves.outflow_predicted, curves.outflow_true) = (outflows(&predicted), outflows(&truth));
    }
    WindowScores { curves, sinkhorn, e_kin }
}

fn averaged(
    model: String,
    options: &Options,
    windows: &[WindowScores],
    broken: Vec<BrokenWindow>,
    seconds_per_step: f64,
) -> Scores {
    let curve = |of: &dyn Fn(&Curves) -> Vec<f64>| -> Vec<f64> {
        let each: Vec<Vec<f64>> = windows.iter().map(|window| of(&window.curves)).collect();
        (0..options.steps).map(|k| metrics::mean(each.iter().map(|curve| curve[k]))).collect()
    };
    let optional = |of: &dyn Fn(&Curves) -> &Option<Vec<f64>>| -> Option<Vec<f64>> {
        let all = windows.iter().all(|window| of(&window.curves).is_some());
        all.then(|| curve(&|curves| of(curves).clone().unwrap_or_default()))
    };
    let distances: Vec<Option<f64>> = windows.iter().flat_map(|window| window.sinkhorn.iter().copied()).collect();
    let converged: Vec<f64> = distances.iter().copied().flatten().collect();
    let e_kin: Option<Vec<f64>> = windows.iter().map(|window| window.e_kin).collect();
    let curves = Curves {
        mse: curve(&|c| c.mse.clone()),
        mae: curve(&|c| c.mae.clone()),
        temperature_mse: optional(&|c| &c.temperature_mse),
        e_kin_predicted: curve(&|c| c.e_kin_predicted.clone()),
        e_kin_true: curve(&|c| c.e_kin_true.clone()),
        outflow_predicted: optional(&|c| &c.outflow_predicted),
        outflow_true: optional(&|c| &c.outflow_true),
    };
    Scores {
        model,
        windows: windows.len(),
        steps: options.steps,
        mse_1: metrics::first(&curves.mse, 1),
        mse_5: metrics::first(&curves.mse, 5),
        mse_10: metrics::first(&curves.mse, 10),
        mse_20: metrics::first(&curves.mse, 20),
        mse: metrics::mean(curves.mse.iter().copied()),
        mae: metrics::mean(curves.mae.iter().copied()),
        sinkhorn: (!converged.is_empty()).then(|| metrics::mean(converged.iter().copied())),
        sinkhorn_failures: distances.len() - converged.len(),
        e_kin: e_kin.map(|errors| metrics::mean(errors.into_iter())),
        temperature_mse: curves.temperature_mse.as_ref().map(|mse| metrics::mean(mse.iter().copied())),
        outflow_error: outflow_error(windows),
        seconds_per_step,
        broken,
        curves,
    }
}

/// See [`Scores::outflow_error`]; none where no heat flows out.
fn outflow_error(windows: &[WindowScores]) -> Option<f64> {
    let mut sums = (0.0, 0.0);
    for WindowScores { curves, .. } in windows {
        let predicted: f64 = curves.outflow_predicted.as_ref()?.iter().sum();
        let truth: f64 = curves.outflow_true.as_ref()?.iter().sum();
        sums = (sums.0 + (predicted - truth).abs(), sums.1 + truth.abs());
    }
    (sums.1 > 0.0).then(|| sums.0 / sums.1)
}
