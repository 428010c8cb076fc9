//! Data sets, and what learned models make of them.

use super::arrays::{shaped, vector};
use super::watch::watched;
use crate::config::scene::Kernels;
use crate::dataset::{read_split, Metadata, Split, Trajectory};
use crate::error::BadInput;
use crate::io::FileError;
use crate::surrogate::evaluation::rollout::{rollout as roll_out, HISTORY};
use crate::surrogate::predictor::{Frame, Predictor};
use crate::surrogate::{load_predictor, HEATED_CHANNEL, TAYLOR_GREEN};
use candle_core::DType;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::Path;

/// A data set's trajectory, the first if it has no name.
fn read(data: &Path, split: &str, name: Option<&str>) -> anyhow::Result<(Metadata, Trajectory)> {
    let split = Split::ALL.into_iter().find(|one| one.name() == split).ok_or_else(|| {
        BadInput::new(format!("split {split:?} is not one of a data set")).allowed("train, valid, test")
    })?;
    let unreadable = |error: FileError| {
        BadInput::new(error.to_string())
            .place(data.display().to_string())
            .allowed("the folder of a data set: metadata.json, train.h5, valid.h5, test.h5")
            .advice("hydrograd generate makes one")
    };
    let metadata = Metadata::read(data).map_err(unreadable)?;
    let mut all = read_split(data, &metadata, split).map_err(unreadable)?;
    let names: Vec<String> = all.iter().map(|one| one.name.clone()).collect();
    let place = match name {
        None if all.is_empty() => return Err(BadInput::new("the split has no trajectory").into()),
        None => 0,
        Some(name) => names
            .iter()
            .position(|one| one == name)
            .ok_or_else(|| BadInput::new(format!("there is no trajectory {name:?}")).allowed(names.join(", ")))?,
    };
    Ok((metadata, all.swap_remove(place)))
}

/// A model by name or file.
fn model(name: &str, metadata: &Metadata) -> anyhow::Result<Box<dyn Predictor>> {
    for own in [HEATED_CHANNEL, TAYLOR_GREEN] {
        if own.name == name {
            return Ok(Box::new(own.load(Kernels::Fused, DType::F32)?));
        }
    }
    load_predictor(Path::new(name), metadata, Kernels::Fused)
}

/// Frames as numbers: `[T, N, D]` and `[T, N]`.
fn flat(all: Vec<Frame>) -> (Vec<f64>, Option<Vec<f64>>) {
    let has_heat = all.first().is_some_and(|frame| frame.temperature.is_some());
    let (mut position, mut temperature) = (Vec::new(), Vec::new());
    for frame in all {
        position.extend(frame.position);
        temperature.extend(frame.temperature.unwrap_or_default());
    }
    (position, has_heat.then_some(temperature))
}

/// What a model predicts of a trajectory.
#[pyfunction]
pub fn rollout<'py>(
    py: Python<'py>,
    model_name: String,
    data: std::path::PathBuf,
    split: String,
    trajectory: Option<String>,
    start: usize,
    steps: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let (trajectory, predicted, truth, shape, run, unlike) = watched(py, None, |_| {
        if steps == 0 {
            return Err(BadInput::new("frames = 0").allowed("at least 1").into());
        }
        let (metadata, trajectory) = read(&data, &split, trajectory.as_deref())?;
        let model = model(&model_name, &metadata)?;
        let mut run = roll_out(&*model, &metadata, &trajectory, start, steps)?;
        let (count, first) = (run.frames.len(), start + HISTORY);
        let truth = (first..first + count).map(|frame| Frame::of(&trajectory, frame)).collect();
        let (predicted, shape) = (flat(std::mem::take(&mut run.frames)), [count, trajectory.particles, metadata.dim]);
        Ok((trajectory, predicted, flat(truth), shape, run, model.unlike(&metadata)))
    })?;
    let all = PyDict::new(py);
    let [t, n, _] = shape;
    for (name, (position, temperature)) in [("predicted", predicted), ("truth", truth)] {
        let one = PyDict::new(py);
        one.set_item("position", shaped(py, position, shape)?)?;
        one.set_item("temperature", temperature.map(|values| shaped(py, values, [t, n])).transpose()?)?;
        all.set_item(name, one)?;
    }
    all.set_item("kind", vector(py, trajectory.kind))?;
    all.set_item("broken", run.broken.map(|broken| format!("step {}: {}", broken.step, broken.reason)))?;
    all.set_item("seconds", run.seconds)?;
    all.set_item("unlike", unlike)?;
    Ok(all)
}

/// A trajectory of a data set.
#[pyfunction]
pub fn read_trajectory<'py>(
    py: Python<'py>,
    data: std::path::PathBuf,
    split: String,
    trajectory: Option<String>,
) -> PyResult<Bound<'py, PyDict>> {
    let (metadata, found) = watched(py, None, |_| read(&data, &split, trajectory.as_deref()))?;
    let (t, n) = (found.frames, found.particles);
    let all = PyDict::new(py);
    all.set_item("name", found.name)?;
    all.set_item("position", shaped(py, found.position, [t, n, metadata.dim])?)?;
    all.set_item("kind", vector(py, found.kind))?;
    all.set_item("temperature", found.temperature.map(|values| shaped(py, values, [t, n])).transpose()?)?;
    all.set_item("wall_x", vector(py, found.wall_x))?;
    all.set_item("wall_offset", vector(py, found.wall_offset))?;
    all.set_item("frame_time", metadata.dt * metadata.write_every as f64)?;
    all.set_item("spacing", metadata.dx)?;
    Ok(all)
}
