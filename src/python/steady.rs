//! Flows of fixed particles around shapes, steady and in time, as Python has them.

use super::arrays::{columns, vector};
use super::errors::to_python;
use super::watch::{watched, Told};
use crate::error::{BadInput, Error};
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::history::{Moment, Of};
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{json, Map, Value};

/// A flow: what it is for these numbers of shapes (in time: at its end), and the objective with its gradient.
struct Found {
    numbers: Vec<f64>,
    objective: f64,
    gradient: Option<Vec<f64>>,
    figures: String,
    fields: ParticleFields,
    /// Of a flow in time: its figures after each step, by name.
    history: Vec<(String, Vec<f64>)>,
}

/// The numbers that are asked for, or the scene's own.
fn chosen(numbers: Option<Vec<f64>>, own: Vec<f64>) -> Result<Vec<f64>, Error> {
    match numbers {
        Some(numbers) if numbers.len() != own.len() => {
            let allowed = format!("{} numbers, as the scene has variables", own.len());
            Err(BadInput::new(format!("{} numbers", numbers.len())).allowed(allowed).into())
        }
        numbers => Ok(numbers.unwrap_or(own)),
    }
}

/// Checks that particles are fixed around shapes.
fn check(loaded: &Loaded) -> Result<(), BadInput> {
    if !loaded.config.is_around_shapes() || loaded.config.is_periodic_box() {
        return Err(BadInput::new(
            "a scene whose particles move, that is no scene of one's own, or that has no shapes and no walls",
        )
        .allowed("scene = \"custom\" with method.name = \"fixed\""));
    }
    Ok(())
}

/// Figures by name as JSON.
fn text(figures: Vec<(&'static str, Value)>) -> String {
    let figures: Map<String, Value> = figures.into_iter().map(|(name, value)| (name.to_string(), value)).collect();
    Value::Object(figures).to_string()
}

fn found(loaded: &Loaded, numbers: Option<Vec<f64>>, gradient: bool) -> Result<Found, Error> {
    check(loaded)?;
    if loaded.config.is_around_bodies() {
        let mut around = AroundBodies::new(&loaded.config)?;
        let numbers = chosen(numbers, around.first())?;
        let solution = around.solve(&numbers)?;
        let (objective, terms) = around.objective(&solution);
        let gradient = if gradient { Some(around.gradient(&solution, &terms)?) } else { None };
        let (figures, fields) = (text(around.summary(&solution)), around.fields(&solution));
        return Ok(Found { numbers, objective, gradient, figures, fields, history: vec![] });
    }
    let mut around = AroundShapes::new(&loaded.config)?;
    let numbers = chosen(numbers, around.first())?;
    let solution = around.solve(&numbers)?;
    let (objective, terms) = around.objective(&solution);
    let gradient = if gradient { Some(around.gradient(&solution, &terms)?) } else { None };
    let (figures, fields) = (text(around.summary(&solution)), around.fields(&solution));
    Ok(Found { numbers, objective, gradient, figures, fields, history: vec![] })
}

fn found_in_time(
    loaded: &Loaded,
    numbers: Option<Vec<f64>>,
    gradient: bool,
    tell: &dyn Fn(f64),
) -> Result<Found, Error> {
    if loaded.config.unsteady().is_none() {
        return Err(BadInput::at("method.flow", "unsteady() of a scene with a steady flow")
            .allowed("method.flow = \"unsteady\"")
            .advice("method.flow=unsteady")
            .into());
    }
    check(loaded)?;
    match loaded.config.is_around_bodies() {
        true => marched(&AroundBodies::new(&loaded.config)?, numbers, gradient, tell),
        false => marched(&AroundShapes::new(&loaded.config)?, numbers, gradient, tell),
    }
}

fn marched(
    around: &impl Around,
    numbers: Option<Vec<f64>>,
    gradient: bool,
    tell: &dyn Fn(f64),
) -> Result<Found, Error> {
    let end = around.config().time.end;
    let numbers = chosen(numbers, around.first())?;
    let (history, last) = around.march(&numbers, None, &mut |moment, _| {
        tell(moment.time / end);
        Ok(())
    })?;
    let window = around.window(&numbers, &history)?;
    let objective = history.objective(&window);
    let gradient = if gradient { Some(around.march_gradient(&numbers, &history, Of::Objective)?) } else { None };
    let mean = |(k, (name, _)): (usize, &(String, _))| (name.clone(), json!(history.of(&window, k).mean));
    let figures: Map<String, Value> = history.figures.iter().enumerate().map(mean).collect();
    let of = |value: &dyn Fn(&Moment) -> f64| history.moments.iter().map(value).collect::<Vec<f64>>();
    let mut columns = vec![("time".to_string(), of(&|moment| moment.time))];
    columns.extend(history.figures.iter().enumerate().map(|(k, (name, _))| (name.clone(), of(&|m| m.values[k]))));
    let fields = ParticleFields { time: end, step: history.sizes.len(), ..around.fields(&last) };
    let figures = Value::Object(figures).to_string();
    Ok(Found { numbers, objective, gradient, figures, fields, history: columns })
}

/// See ``hydrograd.Scene.steady``.
pub fn steady<'py>(
    py: Python<'py>,
    loaded: &Loaded,
    numbers: Option<Vec<f64>>,
    gradient: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let found = py.detach(|| found(loaded, numbers, gradient)).map_err(|error| to_python(error.into()))?;
    found.into_python(py, loaded)
}

/// See ``hydrograd.Scene.unsteady``.
pub fn unsteady<'py>(
    py: Python<'py>,
    loaded: &Loaded,
    numbers: Option<Vec<f64>>,
    gradient: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let found = watched(py, progress, |teller| {
        Ok(found_in_time(loaded, numbers, gradient, &|share| teller.often(Told::Share(share)))?)
    })?;
    let history = PyDict::new(py);
    for (name, values) in &found.history {
        history.set_item(name, vector(py, values.clone()))?;
    }
    let all = found.into_python(py, loaded)?;
    all.set_item("history", history)?;
    Ok(all)
}

impl Found {
    fn into_python<'py>(self, py: Python<'py>, loaded: &Loaded) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        all.set_item("variables", loaded.config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>())?;
        all.set_item("numbers", vector(py, self.numbers))?;
        all.set_item("objective", self.objective)?;
        all.set_item("gradient", self.gradient.map(|gradient| vector(py, gradient)))?;
        all.set_item("figures", self.figures)?;
        let ParticleFields { dimension, position, velocity, pressure, temperature, tag, .. } = self.fields;
        all.set_item("position", columns(py, position, dimension)?)?;
        all.set_item("velocity", columns(py, velocity, dimension)?)?;
        all.set_item("pressure", vector(py, pressure))?;
        all.set_item("temperature", temperature.map(|temperature| vector(py, temperature)))?;
        all.set_item("tag", vector(py, tag))?;
        Ok(all)
    }
}
