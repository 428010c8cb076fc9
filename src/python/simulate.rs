//! One run forward, and what is kept of it.

use super::arrays::{columns, frames_of_columns, shaped, vector};
use super::parts::Parts;
use super::watch::{Teller, Told};
use crate::adjoint::run::{run, Observer};
use crate::cli::prepare::diverged;
use crate::design::diagnostics::Measurement;
use crate::scene::observers::{EvenSteps, LastGood};
use crate::scene::particle_fields::ParticleFields;
use crate::scene::record::Record;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

/// Rows of the history.
const HISTORY: usize = 400;

/// A run at its end.
pub struct Simulated {
    end: ParticleFields,
    /// As JSON.
    figures: String,
    columns: Vec<&'static str>,
    history: Vec<Vec<f64>>,
    times: Vec<f64>,
    /// `[T, D, N]`, `[T, D, N]` and `[T, N]`.
    position: Vec<f64>,
    velocity: Vec<f64>,
    temperature: Vec<f64>,
}

/// Runs a scene, with another design than its own if there is one; keeps about `frames` states of the way.
pub fn simulate<R: Sweeps>(
    parts: &Parts<R>,
    design: Option<&[f64]>,
    frames: usize,
    teller: &Teller,
) -> anyhow::Result<Simulated> {
    let (scene, config) = (parts.scene()?, &parts.loaded.config);
    let shaped = design.map(|_| parts.shaped()).transpose()?;
    if let (Some(problem), Some(design)) = (&shaped, design) {
        parts.check(problem, design)?;
    }
    let model = shaped.as_ref().map_or(&scene.model, |problem| &problem.model);
    let start = match (&shaped, design) {
        (Some(problem), Some(design)) => problem.start(design),
        _ => scene.start.clone(),
    };
    let (steps, clock) = (scene.steps, Instant::now());
    let mut measurement = shaped.as_deref().map_or_else(|| scene.measurement(), |design| Some(Measurement::of(design)));
    let mut good = LastGood::new(&start);
    let (mut times, mut position, mut velocity, mut temperature) = (vec![], vec![], vec![], vec![]);
    let (kept, rows) = (EvenSteps::new(steps, frames), EvenSteps::new(steps, HISTORY));
    let mut history = Vec::new();
    let mut keep = |dynamics: &Sph<R>, solver: &mut Solver<R>| -> anyhow::Result<()> {
        teller.often(Told::Steps(solver.step, steps));
        if rows.contains(solver.step) {
            history.push(scene.history_row(dynamics, solver)?);
        }
        if kept.contains(solver.step) {
            let fields = ParticleFields::of(solver)?;
            times.push(fields.time);
            position.extend(fields.position);
            velocity.extend(fields.velocity);
            temperature.extend(fields.temperature.unwrap_or_default());
        }
        Ok(())
    };
    let mut observers: Vec<&mut dyn Observer<Sph<R>>> = vec![&mut good];
    observers.extend(measurement.as_mut().map(|it| it as &mut dyn Observer<Sph<R>>));
    observers.push(&mut keep);
    let dynamics = Sph::new(model.clone(), config.run.compute()?);
    let found = run(&dynamics, &start, steps, &mut observers);
    let mut solver = found.map_err(diverged(model, good.state()))?;
    let seconds = clock.elapsed().as_secs_f64();
    teller.always(Told::Steps(steps, steps));
    let mut figures = match config.has_design() {
        true => Record::default(),
        false => Record::of(&scene.figures(&solver.state, steps as f64 * model.dt)),
    };
    if let Some(measured) = &measurement {
        figures.0.extend(Record::of_measured(config, &measured.diagnostics()).0);
    }
    figures.put("steps", steps);
    figures.put("time_step", config.time_step());
    figures.put("seconds", seconds);
    Ok(Simulated {
        end: ParticleFields::of(&mut solver)?,
        figures: serde_json::to_string(&figures)?,
        columns: scene.history_columns(),
        history,
        times,
        position,
        velocity,
        temperature,
    })
}

impl Simulated {
    /// As arrays; figures are JSON.
    pub fn into_python<'py>(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Self { end, figures, history, times, .. } = self;
        let (d, t) = (end.dimension, times.len());
        let all = PyDict::new(py);
        all.set_item("figures", figures)?;
        all.set_item("time", end.time)?;
        all.set_item("step", end.step)?;
        all.set_item("box", end.box_size)?;
        all.set_item("position", columns(py, end.position, d)?)?;
        all.set_item("velocity", columns(py, end.velocity, d)?)?;
        all.set_item("density", vector(py, end.density))?;
        all.set_item("pressure", vector(py, end.pressure))?;
        all.set_item("mass", vector(py, end.mass))?;
        all.set_item("tag", vector(py, end.tag))?;
        let has_heat = end.temperature.is_some();
        all.set_item("temperature", end.temperature.map(|temperature| vector(py, temperature)))?;
        let table = PyDict::new(py);
        for (column, name) in self.columns.iter().enumerate() {
            table.set_item(name, vector(py, history.iter().map(|row| row[column]).collect()))?;
        }
        all.set_item("history", table)?;
        if t > 0 {
            let frames = PyDict::new(py);
            frames.set_item("time", vector(py, times))?;
            frames.set_item("position", frames_of_columns(py, self.position, t, d)?)?;
            frames.set_item("velocity", frames_of_columns(py, self.velocity, t, d)?)?;
            let n = self.temperature.len() / t;
            let temperature = has_heat.then(|| shaped(py, self.temperature, [t, n])).transpose()?;
            frames.set_item("temperature", temperature)?;
            all.set_item("frames", frames)?;
        }
        Ok(all)
    }
}
