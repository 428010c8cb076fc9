//! `hydrograd rollout`: plots a model's prediction beside the truth.

use super::arguments::at_least_one;
use super::machine;
use super::model_data::{ModelData, ModelDataArguments};
use super::page;
use super::run_folder::{Earlier, RunFolder};
use crate::dataset::extent::Extent;
use crate::dataset::{Metadata, Trajectory};
use crate::error::{BadInput, Error};
use crate::io::vtk::{ParticleFrame, VtkSeries};
use crate::report::page::PAGE;
use crate::report::plots::{side_by_side, SideBySide, TemperaturePanel};
use crate::report::table::Table;
use crate::report::text;
use crate::surrogate::evaluation::metrics::{mean_square, select, temperature_mean_square, Counted};
use crate::surrogate::evaluation::rollout::{check_length, rollout, HISTORY};
use crate::surrogate::predictor::Frame;
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Largest number of rows in the plot.
const PICTURES: usize = 4;

/// Predict a trajectory and write it beside the true one: ParaView series and pictures.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd rollout --model runs/train/best.safetensors --data data/channel
      20 frames of the first trajectory of the validation split
  hydrograd rollout --model runs/train/best.safetensors --data data/channel --split test --trajectory 00003 --start 40
      another trajectory, from its 40th frame on
  hydrograd rollout --model linear --data data/channel --steps 5 --out runs/linear
      what constant velocity makes of it")]
pub struct RolloutArguments {
    #[command(flatten)]
    pub source: ModelDataArguments,
    /// Name of the trajectory [default: the first].
    #[arg(long, value_name = "NAME")]
    pub trajectory: Option<String>,
    /// First of the six true frames that the model sees.
    #[arg(long, value_name = "FRAME", default_value_t = 0)]
    pub start: usize,
    /// Frames to predict.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = at_least_one)]
    pub steps: usize,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "runs/rollout")]
    pub out: PathBuf,
}

const KIND: &str = "rollout";

pub fn run(arguments: RolloutArguments) -> anyhow::Result<()> {
    let ModelData { model, metadata, trajectories } = arguments.source.read()?;
    let trajectory = find(&trajectories, arguments.trajectory.as_deref())?;
    check_length(trajectory, arguments.start, arguments.steps)?;
    RunFolder::check(&arguments.out, KIND, Earlier::Replaced)?;
    let run = rollout(&*model, &metadata, trajectory, arguments.start, arguments.steps)?;
    if let (true, Some(broken)) = (run.frames.is_empty(), &run.broken) {
        let problem = format!("{} gives no usable frame: {}", model.name(), broken.reason);
        return Err(Error::run(problem, "a model that was trained on such data, or another --start").into());
    }
    let first = arguments.start + HISTORY;
    let last_seen = Frame::of(trajectory, first - 1);
    let truth: Vec<Frame> = (first..first + run.frames.len()).map(|frame| Frame::of(trajectory, frame)).collect();

    let folder = &arguments.out;
    let _own = RunFolder::take(folder, KIND, Earlier::Replaced)?;
    let scene = Scene { metadata: &metadata, trajectory, tag: trajectory.tags() };
    let predicted = scene.fields(&last_seen, &run.frames);
    let truth_fields = scene.fields(&last_seen, &truth);
    scene.write_series(folder, "predicted", &predicted)?;
    scene.write_series(folder, "true", &truth_fields)?;
    scene.picture(&folder.join("rollout"), &predicted, &truth_fields)?;
    page::write(folder)?;

    let errors = errors(&scene, &run.frames, &truth);
    println!("{}", table(&errors, &shown(run.frames.len())));
    if let Some(broken) = &run.broken {
        let (name, reason) = (model.name(), text::shown(&broken.reason));
        println!("{name} broke at step {} of {}: {reason}", broken.step, arguments.steps);
    }
    let seconds = run.seconds / run.frames.len() as f64;
    let (name, last) = (text::shown(&trajectory.name), first + run.frames.len() - 1);
    println!("trajectory {name}, frames {first} to {last}, {seconds:.1e} s per step");
    let of_step = |error: &StepError| json!({ "step": error.step, "position_mse": error.position, "temperature_mse": error.temperature });
    let broken = run.broken.as_ref().map(|broken| json!({ "step": broken.step, "reason": broken.reason }));
    machine::answer(&json!({
        "folder": machine::path(folder),
        "model": machine::path(&arguments.source.model),
        "data": machine::path(&arguments.source.data),
        "split": arguments.source.split,
        "trajectory": trajectory.name,
        "particles": trajectory.particles,
        "first_frame": first,
        "steps": run.frames.len(),
        "steps_wanted": arguments.steps,
        "broken": broken,
        "errors": errors.iter().map(of_step).collect::<Vec<_>>(),
        "seconds_per_step": seconds,
        "files": machine::paths_in(folder, ["rollout.png", "rollout.svg", "predicted/predicted.pvd", "true/true.pvd", PAGE]),
    }));
    println!(
        "files in {}: rollout.png, predicted/predicted.pvd and true/true.pvd (ParaView), report.html",
        folder.display()
    );
    Ok(())
}

/// The trajectory with a name; the first one without a name.
pub(super) fn find<'a>(trajectories: &'a [Trajectory], name: Option<&str>) -> Result<&'a Trajectory, BadInput> {
    let first = trajectories.first().ok_or_else(|| BadInput::new("the data set has no trajectory"))?;
    let Some(name) = name else { return Ok(first) };
    trajectories.iter().find(|t| t.name == name).ok_or_else(|| {
        BadInput::new(format!("there is no trajectory `{name}`"))
            .place(format!("--trajectory {name}"))
            .allowed(format!("{} to {}", first.name, trajectories[trajectories.len() - 1].name))
    })
}

/// The steps (from 1) in the plot, spread over all and including the last.
fn shown(steps: usize) -> Vec<usize> {
    let rows = PICTURES.min(steps);
    (1..=rows).map(|row| (row * steps).div_ceil(rows)).collect()
}

/// Mean squared errors of a step over the particles that the model moves.
struct StepError {
    /// Number of the step, from 1.
    step: usize,
    position: f64,
    temperature: Option<f64>,
}

fn errors(scene: &Scene, predicted: &[Frame], truth: &[Frame]) -> Vec<StepError> {
    let extent = Extent::of(scene.metadata);
    let counted = Counted::Moving.of(&scene.trajectory.kind);
    let of = |(k, (p, t)): (usize, (&Frame, &Frame))| {
        let position = |frame: &Frame| select(&frame.position, extent.dimension(), &counted);
        let temperature = |frame: &Frame| frame.temperature.as_ref().map(|t| select(t, 1, &counted));
        let hot = temperature(p).zip(temperature(t)).map(|(p, t)| temperature_mean_square(&p, &t));
        StepError { step: k + 1, position: mean_square(&extent, &position(p), &position(t)), temperature: hot }
    };
    predicted.iter().zip(truth).enumerate().map(of).collect()
}

/// A table of the errors of some steps.
fn table(errors: &[StepError], shown: &[usize]) -> Table {
    let mut table = Table::new(["step", "position MSE", "temperature MSE"]);
    for error in errors.iter().filter(|error| shown.contains(&error.step)) {
        table.row([
            error.step.to_string(),
            format!("{:.3e}", error.position),
            error.temperature.map_or("-".into(), |mse| format!("{mse:.3e}")),
        ]);
    }
    table
}

struct Scene<'a> {
    metadata: &'a Metadata,
    trajectory: &'a Trajectory,
    tag: Vec<u8>,
}

/// The fields of one frame, by component, as the writers need them.
struct Fields {
    position: Vec<f64>,
    velocity: Vec<f64>,
    temperature: Option<Vec<f64>>,
}

impl Scene<'_> {
    /// The fields of frames; their velocities are the steps from the frame before, over the time between them.
    fn fields(&self, before: &Frame, frames: &[Frame]) -> Vec<Fields> {
        let extent = Extent::of(self.metadata);
        let (d, n) = (extent.dimension(), self.trajectory.particles);
        let time = self.metadata.dt * self.metadata.write_every as f64;
        let by_component = |rows: &[f64]| (0..d * n).map(|k| rows[k % n * d + k / n]).collect::<Vec<f64>>();
        let all: Vec<&Frame> = std::iter::once(before).chain(frames).collect();
        let fields = |pair: &[&Frame]| {
            let step = extent.displacement(&pair[1].position, &pair[0].position);
            Fields {
                position: by_component(&pair[1].position),
                velocity: by_component(&step).iter().map(|step| step / time).collect(),
                temperature: pair[1].temperature.clone(),
            }
        };
        all.windows(2).map(fields).collect()
    }

    fn write_series(&self, folder: &Path, name: &str, frames: &[Fields]) -> anyhow::Result<()> {
        let mut series = VtkSeries::new(&folder.join(name), name)?;
        for (step, frame) in frames.iter().enumerate() {
            let scalars: Vec<(&str, &[f64])> =
                frame.temperature.as_deref().map(|temperature| ("temperature", temperature)).into_iter().collect();
            series.write(&ParticleFrame {
                dimension: self.metadata.dim,
                time: (step + 1) as f64 * self.metadata.dt * self.metadata.write_every as f64,
                position: &frame.position,
                velocity: &frame.velocity,
                scalars: &scalars,
                tag: &self.tag,
                number: &[],
            })?;
        }
        Ok(())
    }

    /// Plots prediction, truth and difference, coloured by temperature, or by speed without heat. 3D is viewed along z.
    fn picture(&self, stem: &Path, predicted: &[Fields], truth: &[Fields]) -> anyhow::Result<()> {
        let n = self.trajectory.particles;
        let speed = |velocity: &[f64]| -> Vec<f64> {
            (0..n).map(|i| (i..velocity.len()).step_by(n).map(|k| velocity[k].powi(2)).sum::<f64>().sqrt()).collect()
        };
        let minus = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let with_heat = predicted.iter().chain(truth).all(|frame| frame.temperature.is_some());
        let value = |frame: &Fields| match (&frame.temperature, with_heat) {
            (Some(temperature), true) => temperature.clone(),
            _ => speed(&frame.velocity),
        };
        let difference = |p: &Fields, t: &Fields| match with_heat {
            true => minus(&value(p), &value(t)).into_iter().map(f64::abs).collect(),
            false => speed(&minus(&p.velocity, &t.velocity)),
        };
        let row = |step: usize| {
            let (p, t) = (&predicted[step - 1], &truth[step - 1]);
            let titles = ["predicted", "true", "difference"].map(|name| format!("step {step}: {name}"));
            (titles, [p, t, t], [value(p), value(t), difference(p, t)])
        };
        let rows: Vec<_> = shown(predicted.len()).into_iter().map(row).collect();
        let panels: Vec<[TemperaturePanel; 3]> = rows
            .iter()
            .map(|(titles, frames, values)| {
                std::array::from_fn(|k| TemperaturePanel {
                    title: &titles[k],
                    position: &frames[k].position[..2 * n],
                    temperature: &values[k],
                    tag: &self.tag,
                    diameter: self.metadata.dx,
                    diameters: None,
                })
            })
            .collect();
        let range = |columns: &[usize]| {
            let fluid = |values: &Vec<f64>| (0..n).filter(|&i| self.tag[i] == 0).map(|i| values[i]).collect::<Vec<_>>();
            let mut values: Vec<f64> =
                rows.iter().flat_map(|row| columns.iter().flat_map(|&k| fluid(&row.2[k]))).collect();
            values.sort_by(f64::total_cmp);
            // Excludes particles that only one of both reset at the inlet, which would dominate the range of colours.
            let cut = if columns == [2] { values.len() / 20 } else { 0 };
            match values.len() {
                0 => (0.0, 1e-12),
                count if values[count - 1 - cut] > values[0] => (values[0], values[count - 1 - cut]),
                // Equal values need a range of colours.
                _ => (values[0].min(0.0), values[0].max(0.0) + 1e-12),
            }
        };
        let (label, difference_label) = match with_heat {
            true => ("temperature T", "|T - T true|, the largest 5 % alike"),
            false => ("speed |v|", "|v - v true|, the largest 5 % alike"),
        };
        // Walls may be outside of the box.
        let bounds = |d: usize| {
            let (low, high) = (self.metadata.bounds[d][0], self.metadata.bounds[d][1]);
            let half = 0.5 * self.metadata.dx;
            let places = truth.iter().flat_map(|frame| &frame.position[d * n..(d + 1) * n]);
            places.fold((low, high), |(low, high), &x| match self.metadata.periodic()[d] {
                true => (low, high),
                false => (low.min(x - half), high.max(x + half)),
            })
        };
        side_by_side(
            stem,
            &panels,
            &SideBySide {
                label,
                difference_label,
                range: range(&[0, 1]),
                difference_range: (0.0, range(&[2]).1),
                x_range: bounds(0),
                y_range: bounds(1),
            },
        )?;
        Ok(())
    }
}
