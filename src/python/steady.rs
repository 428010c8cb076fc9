//! The steady flow of fixed particles around shapes, as Python has it.

use super::arrays::{columns, vector};
use super::errors::to_python;
use crate::error::{BadInput, Error};
use crate::scene::around_shapes::AroundShapes;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};

/// A steady flow: what it is for these numbers of shapes, and the objective with its gradient.
struct Found {
    numbers: Vec<f64>,
    objective: f64,
    gradient: Option<Vec<f64>>,
    figures: String,
    fields: ParticleFields,
}

fn found(loaded: &Loaded, numbers: Option<Vec<f64>>, gradient: bool) -> Result<Found, Error> {
    if !loaded.config.is_around_shapes() {
        return Err(BadInput::new("steady() of a scene whose particles move, or that is no scene of one's own")
            .allowed("scene = \"custom\" with method.name = \"fixed\"")
            .into());
    }
    let mut around = AroundShapes::new(&loaded.config)?;
    let numbers = numbers.unwrap_or_else(|| around.first());
    if numbers.len() != around.wanted.len() {
        let allowed = format!("{} numbers, as the scene has variables", around.wanted.len());
        return Err(BadInput::new(format!("{} numbers", numbers.len())).allowed(allowed).into());
    }
    let solution = around.solve(&numbers)?;
    let (objective, terms) = around.objective(&solution);
    let gradient = if gradient { Some(around.gradient(&solution, &terms)?) } else { None };
    let figures: Map<String, Value> =
        around.summary(&solution).into_iter().map(|(name, value)| (name.to_string(), value)).collect();
    let fields = around.fields(&solution);
    Ok(Found { numbers, objective, gradient, figures: Value::Object(figures).to_string(), fields })
}

/// See ``hydrograd.Scene.steady``.
pub fn steady<'py>(
    py: Python<'py>,
    loaded: &Loaded,
    numbers: Option<Vec<f64>>,
    gradient: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let found = py.detach(|| found(loaded, numbers, gradient)).map_err(|error| to_python(error.into()))?;
    let all = PyDict::new(py);
    all.set_item("variables", loaded.config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>())?;
    all.set_item("numbers", vector(py, found.numbers))?;
    all.set_item("objective", found.objective)?;
    all.set_item("gradient", found.gradient.map(|gradient| vector(py, gradient)))?;
    all.set_item("figures", found.figures)?;
    let ParticleFields { position, velocity, pressure, temperature, tag, .. } = found.fields;
    all.set_item("position", columns(py, position, 2)?)?;
    all.set_item("velocity", columns(py, velocity, 2)?)?;
    all.set_item("pressure", vector(py, pressure))?;
    all.set_item("temperature", temperature.map(|temperature| vector(py, temperature)))?;
    all.set_item("tag", vector(py, tag))?;
    Ok(all)
}
