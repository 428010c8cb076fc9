//! Flows of fixed particles around shapes, steady and in time, as Python has them.

use super::arrays::{columns, shaped_as, vector};
use super::errors::to_python;
use super::flow::{components, numbers as numbers_of};
use super::watch::{watched, Told};
use crate::config::scene::Config;
use crate::error::{BadInput, Error};
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::history::{Derivative, Moment, Of};
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::start_field;
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{json, Map, Value};
use std::sync::{Mutex, PoisonError};

/// A flow: what it is for these numbers of shapes (in time: at its end), and the objective with its gradient.
struct Found {
    numbers: Vec<f64>,
    objective: f64,
    derivative: Option<Derivative>,
    figures: String,
    fields: ParticleFields,
    /// Of a flow in time: its figures after each step, by name.
    history: Vec<(String, Vec<f64>)>,
    /// Velocity on `output.grid`, `[points, 2]`.
    on_grid: Option<Vec<f64>>,
}

/// What is wanted of a flow.
pub struct Wanted {
    pub numbers: Option<Vec<f64>>,
    pub gradient: bool,
    /// The cotangent of the velocity on `output.grid`, `[points, 2]`, whose derivative is wanted instead of the objective's.
    by_grid: Option<Vec<f64>>,
    /// The velocity at the start: points along each axis, and its components.
    start: Option<(Vec<usize>, Vec<Vec<f64>>)>,
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

type Array<'py> = Option<PyReadonlyArrayDyn<'py, f64>>;

impl Wanted {
    /// # Errors
    /// Arrays of another shape than the scene's.
    pub fn new(
        loaded: &Loaded,
        numbers: Option<Vec<f64>>,
        gradient: bool,
        by_grid: Array<'_>,
        start: Array<'_>,
    ) -> PyResult<Self> {
        let bad = |name: &str, shape: &[usize], allowed: String| {
            Err(to_python(BadInput::new(format!("{name} of shape {shape:?}")).allowed(allowed).into()))
        };
        let config = &loaded.config;
        let grid = &config.output.grid;
        if let Some(by) = &by_grid {
            if grid.is_empty() || by.shape() != [grid.as_slice(), &[2]].concat() {
                return bad("by_grid_velocity", by.shape(), format!("[N, N, 2] by output.grid, which is {grid:?}"));
            }
        }
        if let Some(start) = &start {
            if config.region.size.len() != 2 || start.shape().len() != 3 || start.shape()[2] != 2 {
                return bad("velocity", start.shape(), "[N, N, 2], in two dimensions".into());
            }
        }
        let start = start.map(|start| (start.shape()[..2].to_vec(), components(&numbers_of(&start), 2)));
        let by_grid = by_grid.map(|by| numbers_of(&by));
        Ok(Self { numbers, gradient, by_grid, start })
    }
}

/// The flow of the last call: its particles are placed once, and steady flows begin with the one before and its factors.
#[derive(Default)]
pub struct Kept {
    plane: Mutex<Option<AroundShapes>>,
    space: Mutex<Option<AroundBodies>>,
}

/// What `find` finds of the flow that is kept, or of a new one. Another thread may have it: then there are two for a while. One that
/// fails is not kept.
fn with_kept<A, T>(
    place: &Mutex<Option<A>>,
    config: &Config,
    new: fn(&Config) -> Result<A, Error>,
    find: impl FnOnce(&mut A) -> Result<T, Error>,
) -> Result<T, Error> {
    let lock = || place.lock().unwrap_or_else(PoisonError::into_inner);
    let kept = lock().take();
    let mut around = kept.map_or_else(|| new(config), Ok)?;
    let found = find(&mut around)?;
    *lock() = Some(around);
    Ok(found)
}

fn found(loaded: &Loaded, kept: &Kept, wanted: &Wanted) -> Result<Found, Error> {
    check(loaded)?;
    let config = &loaded.config;
    if config.is_around_bodies() {
        let by_grid = |_: &mut _, _: &_, _: &[f64]| Err(BadInput::at("output.grid", "a grid around bodies").into());
        return with_kept(&kept.space, config, AroundBodies::new, |around| {
            solved(around, wanted, AroundBodies::summary, by_grid)
        });
    }
    with_kept(&kept.plane, config, AroundShapes::new, |around| {
        solved(around, wanted, AroundShapes::summary, AroundShapes::grid_gradient)
    })
}

fn solved<A: Around>(
    around: &mut A,
    wanted: &Wanted,
    summary: impl Fn(&A, &A::Solution) -> Vec<(&'static str, Value)>,
    by_grid: impl Fn(&mut A, &A::Solution, &[f64]) -> Result<Derivative, Error>,
) -> Result<Found, Error> {
    let numbers = chosen(wanted.numbers.clone(), around.first())?;
    let solution = around.solve(&numbers)?;
    let (objective, terms) = around.objective(&solution);
    let derivative = match &wanted.by_grid {
        Some(by) => Some(by_grid(around, &solution, by)?),
        None if wanted.gradient => Some(around.gradient(&solution, &terms)?),
        None => None,
    };
    let (figures, fields) = (text(summary(around, &solution)), around.fields(&solution));
    let on_grid = around.velocity_on_grid(&solution);
    Ok(Found { numbers, objective, derivative, figures, fields, history: vec![], on_grid })
}

fn found_in_time(loaded: &Loaded, kept: &Kept, wanted: &Wanted, tell: &dyn Fn(f64)) -> Result<Found, Error> {
    let config = &loaded.config;
    if config.unsteady().is_none() {
        return Err(BadInput::at("method.flow", "unsteady() of a scene with a steady flow")
            .allowed("method.flow = \"unsteady\"")
            .advice("method.flow=unsteady")
            .into());
    }
    check(loaded)?;
    if config.is_around_bodies() {
        return with_kept(&kept.space, config, AroundBodies::new, |around| {
            around.by_viscosity = true;
            marched(around, wanted, tell)
        });
    }
    with_kept(&kept.plane, config, AroundShapes::new, |around| {
        around.by_viscosity = true;
        around.start = match &wanted.start {
            Some((shape, velocity)) => {
                let velocity = [velocity[0].clone(), velocity[1].clone()];
                Some(start_field::on_grid(config, "velocity", [shape[0], shape[1]], velocity)?)
            }
            None => start_field::of_config(config)?,
        };
        marched(around, wanted, tell)
    })
}

fn marched(around: &impl Around, wanted: &Wanted, tell: &dyn Fn(f64)) -> Result<Found, Error> {
    let end = around.config().time.end;
    let numbers = chosen(wanted.numbers.clone(), around.first())?;
    let (history, last) = around.march(&numbers, None, &mut |moment, _| {
        tell(moment.time / end);
        Ok(())
    })?;
    let window = around.window(&numbers, &history)?;
    let objective = history.objective(&window);
    let of = wanted.by_grid.as_ref().map_or(Of::Objective, |by| Of::Grid(by));
    let derivative = match wanted.gradient || wanted.by_grid.is_some() {
        true => Some(around.march_gradient(&numbers, &history, of)?),
        false => None,
    };
    let mean = |(k, (name, _)): (usize, &(String, _))| (name.clone(), json!(history.of(&window, k).mean));
    let figures: Map<String, Value> = history.figures.iter().enumerate().map(mean).collect();
    let of = |value: &dyn Fn(&Moment) -> f64| history.moments.iter().map(value).collect::<Vec<f64>>();
    let mut columns = vec![("time".to_string(), of(&|moment| moment.time))];
    columns.extend(history.figures.iter().enumerate().map(|(k, (name, _))| (name.clone(), of(&|m| m.values[k]))));
    let fields = ParticleFields { time: end, step: history.sizes.len(), ..around.fields(&last) };
    let figures = Value::Object(figures).to_string();
    let on_grid = around.velocity_on_grid(&last);
    Ok(Found { numbers, objective, derivative, figures, fields, history: columns, on_grid })
}

/// See ``hydrograd.Scene.steady``.
pub fn steady<'py>(py: Python<'py>, loaded: &Loaded, kept: &Kept, wanted: &Wanted) -> PyResult<Bound<'py, PyDict>> {
    let found = py.detach(|| found(loaded, kept, wanted)).map_err(|error| to_python(error.into()))?;
    found.into_python(py, loaded)
}

/// See ``hydrograd.Scene.unsteady``.
pub fn unsteady<'py>(
    py: Python<'py>,
    loaded: &Loaded,
    kept: &Kept,
    wanted: &Wanted,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let found = watched(py, progress, |teller| {
        Ok(found_in_time(loaded, kept, wanted, &|share| teller.often(Told::Share(share)))?)
    })?;
    let history = PyDict::new(py);
    for (name, values) in &found.history {
        history.set_item(name, vector(py, values.clone()))?;
    }
    let points = wanted.start.as_ref().map(|(shape, _)| [shape.as_slice(), &[2]].concat());
    let by_start = found
        .derivative
        .as_ref()
        .and_then(|found| found.by_start.clone())
        .zip(points)
        .map(|(by, shape)| shaped_as(py, by, &shape))
        .transpose()?;
    let all = found.into_python(py, loaded)?;
    all.set_item("history", history)?;
    all.set_item("velocity_gradient", by_start)?;
    Ok(all)
}

impl Found {
    fn into_python<'py>(self, py: Python<'py>, loaded: &Loaded) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        all.set_item("variables", loaded.config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>())?;
        all.set_item("numbers", vector(py, self.numbers))?;
        all.set_item("objective", self.objective)?;
        let by_viscosity = self.derivative.as_ref().and_then(|found| found.by_viscosity);
        all.set_item("viscosity_gradient", by_viscosity)?;
        all.set_item("gradient", self.derivative.map(|found| vector(py, found.by_variables)))?;
        all.set_item("figures", self.figures)?;
        let ParticleFields { dimension, position, velocity, pressure, temperature, tag, .. } = self.fields;
        all.set_item("position", columns(py, position, dimension)?)?;
        all.set_item("velocity", columns(py, velocity, dimension)?)?;
        all.set_item("pressure", vector(py, pressure))?;
        all.set_item("temperature", temperature.map(|temperature| vector(py, temperature)))?;
        all.set_item("tag", vector(py, tag))?;
        let shape = [loaded.config.output.grid.as_slice(), &[2]].concat();
        let on_grid = self.on_grid.map(|field| shaped_as(py, field, &shape)).transpose()?;
        all.set_item("grid_velocity", on_grid)?;
        Ok(all)
    }
}
