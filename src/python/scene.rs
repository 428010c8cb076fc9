//! A scene, as Python has it.

use super::arrays::{shaped, vector};
use super::errors::to_python;
use super::parts::Parts;
use super::simulate::simulate;
use super::steady::{steady, unsteady, Wanted};
use super::watch::watched;
use crate::config::scene::{Config, Precision};
use crate::design::optimise::Epoch;
use crate::error::Error;
use crate::numerics::threads::use_threads;
use crate::scene::load::Loaded;
use crate::scene::require_design;
use numpy::{PyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// In the precision of the scene.
enum Built {
    Single(Parts<f32>),
    Double(Parts<f64>),
}

/// The same of both.
macro_rules! of {
    ($scene:expr, $parts:ident => $what:expr) => {
        match &$scene.built {
            Built::Single($parts) => $what,
            Built::Double($parts) => $what,
        }
    };
}

/// A scene: see ``hydrograd.Scene``.
#[pyclass(module = "hydrograd._native", frozen)]
pub struct Scene {
    built: Built,
}

/// `key=value` each.
fn load(scene: &str, preset: Option<&str>, settings: &[String]) -> Result<Loaded, Error> {
    let loaded = Config::load(Some(scene), preset, settings)?;
    use_threads(loaded.config.run.threads);
    Ok(loaded)
}

type ValueAndGradient<'py> = (f64, Bound<'py, PyArray1<f64>>);

#[pymethods]
impl Scene {
    #[new]
    fn new(scene: &str, preset: Option<&str>, settings: Vec<String>) -> PyResult<Self> {
        let loaded = load(scene, preset, &settings).map_err(|error| to_python(error.into()))?;
        let built = match loaded.config.run.precision {
            Precision::F32 => Built::Single(Parts::new(loaded)),
            Precision::F64 => Built::Double(Parts::new(loaded)),
        };
        Ok(Self { built })
    }

    /// The resolved configuration as TOML.
    #[getter]
    fn text(&self) -> &str {
        of!(self, parts => &parts.loaded.text)
    }

    /// Name of the scene's family.
    #[getter]
    fn name(&self) -> &'static str {
        of!(self, parts => parts.name())
    }

    /// 2 or 3.
    #[getter]
    fn dimension(&self) -> usize {
        of!(self, parts => parts.loaded.config.dimension())
    }

    /// Whether there is something to optimise.
    #[getter]
    fn has_design(&self) -> bool {
        of!(self, parts => parts.loaded.config.has_design())
    }

    /// An error if there is nothing to optimise.
    fn require_design(&self) -> PyResult<()> {
        let checked = of!(self, parts => require_design(&parts.loaded.config));
        checked.map_err(|bad| to_python(bad.into()))
    }

    fn design<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        of!(self, parts => parts.design(py))
    }

    fn nearest<'py>(&self, py: Python<'py>, design: Vec<f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let found = py.detach(|| of!(self, parts => parts.nearest(design)));
        Ok(PyArray1::from_vec(py, found.map_err(|error| to_python(error.into()))?))
    }

    fn wall<'py>(&self, py: Python<'py>, design: Vec<f64>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let found = py.detach(|| of!(self, parts => parts.wall(&design)));
        let (nodes, heights) = found.map_err(|error| to_python(error.into()))?;
        Ok((vector(py, nodes), vector(py, heights)))
    }

    fn simulate<'py>(
        &self,
        py: Python<'py>,
        design: Option<Vec<f64>>,
        frames: usize,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let design = design.as_deref();
        let found =
            watched(py, progress.as_ref(), |teller| of!(self, parts => simulate(parts, design, frames, teller)))?;
        found.into_python(py)
    }

    fn objective(&self, py: Python<'_>, design: Vec<f64>) -> PyResult<f64> {
        watched(py, None, |_| Ok(of!(self, parts => parts.objective(&design))?))
    }

    fn steady<'py>(
        &self,
        py: Python<'py>,
        numbers: Option<Vec<f64>>,
        gradient: bool,
        by_grid: Option<PyReadonlyArrayDyn<'py, f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (loaded, kept) = of!(self, parts => (&parts.loaded, &parts.kept));
        steady(py, loaded, kept, &Wanted::new(loaded, numbers, gradient, by_grid, None)?)
    }

    fn unsteady<'py>(
        &self,
        py: Python<'py>,
        numbers: Option<Vec<f64>>,
        gradient: bool,
        by_grid: Option<PyReadonlyArrayDyn<'py, f64>>,
        velocity: Option<PyReadonlyArrayDyn<'py, f64>>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (loaded, kept) = of!(self, parts => (&parts.loaded, &parts.kept));
        unsteady(py, loaded, kept, &Wanted::new(loaded, numbers, gradient, by_grid, velocity)?, progress.as_ref())
    }

    fn value_and_gradient<'py>(
        &self,
        py: Python<'py>,
        design: Vec<f64>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<ValueAndGradient<'py>> {
        let found = watched(py, progress.as_ref(), |teller| {
            Ok(of!(self, parts => parts.value_and_gradient(&design, teller))?)
        })?;
        Ok((found.0, PyArray1::from_vec(py, found.1)))
    }

    fn loss_and_gradient<'py>(
        &self,
        py: Python<'py>,
        design: Vec<f64>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<ValueAndGradient<'py>> {
        let found =
            watched(py, progress.as_ref(), |teller| Ok(of!(self, parts => parts.loss_and_gradient(&design, teller))?))?;
        Ok((found.0, PyArray1::from_vec(py, found.1)))
    }

    /// What `verification.json` has of a design, as JSON.
    fn verify(
        &self,
        py: Python<'_>,
        best: Vec<f64>,
        first: Option<Vec<f64>>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<String> {
        watched(py, progress.as_ref(), |teller| of!(self, parts => parts.verify(&best, first.as_deref(), teller)))
    }

    fn optimise<'py>(
        &self,
        py: Python<'py>,
        first: Option<Vec<f64>>,
        epochs: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let found = watched(
            py,
            progress.as_ref(),
            |teller| of!(self, parts => parts.optimise(first.as_deref(), epochs, teller)),
        )?;
        let (history, all) = (&found.history, PyDict::new(py));
        let (count, width) = (history.len(), history.first().map_or(0, |epoch| epoch.variables.len()));
        let designs: Vec<f64> = history.iter().flat_map(|epoch| epoch.variables.iter().copied()).collect();
        all.set_item("designs", shaped(py, designs, [count, width])?)?;
        all.set_item("q", vector(py, found.column(|epoch| epoch.figure)))?;
        let predicted = |epoch: &Epoch| epoch.predicted.unwrap_or(f64::NAN);
        all.set_item("q_predicted", vector(py, found.column(predicted)))?;
        let by_solver = |epoch: &Epoch| epoch.truth.map_or(f64::NAN, |truth| truth.figure);
        all.set_item("q_solver", vector(py, found.column(by_solver)))?;
        all.set_item("loss", vector(py, found.column(|epoch| epoch.loss)))?;
        all.set_item("gradient_norm", vector(py, found.column(|epoch| epoch.gradient_norm)))?;
        all.set_item("seconds", vector(py, found.column(|epoch| epoch.seconds)))?;
        all.set_item("best", found.best)?;
        all.set_item("is_done", found.optimiser.is_done())?;
        Ok(all)
    }
}
