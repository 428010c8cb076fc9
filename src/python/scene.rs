//! A scene: its configuration, and what is built of it when it is asked for.

use super::arrays::vector;
use super::errors::to_python;
use super::simulate::simulate;
use super::watch::{watched, Teller, Told};
use crate::adjoint::schedule::Schedule;
use crate::config::scene::{Config, DynamicsName, Precision};
use crate::design::optimisers::of_config;
use crate::design::{Optimisation, Problem};
use crate::error::{BadInput, Error};
use crate::numerics::lanes::Real;
use crate::numerics::threads::use_threads;
use crate::scene::load::Loaded;
use crate::scene::{build_design, require_design};
use crate::sph::Sweeps;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, OnceLock};

/// How far beyond its limits a design may be, over their width: where somebody computed in single precision.
const SLACK: f64 = 1e-6;

/// What is built of a configuration, once.
pub struct Parts<R> {
    pub loaded: Loaded,
    scene: OnceLock<Arc<crate::scene::Scene<R>>>,
    shaped: OnceLock<Arc<Problem<R>>>,
    search: OnceLock<Arc<Search<R>>>,
}

/// What an optimiser searches with, as in `hydrograd optimize`.
struct Search<R> {
    problem: Problem<R>,
    schedule: Schedule,
}

/// Makes something if it is not there.
fn once<T>(place: &OnceLock<Arc<T>>, make: impl FnOnce() -> Result<T, Error>) -> Result<Arc<T>, Error> {
    if let Some(made) = place.get() {
        return Ok(made.clone());
    }
    let made = Arc::new(make()?);
    // Another thread may have been faster: its is as good.
    Ok(place.get_or_init(|| made).clone())
}

impl<R: Real> Parts<R> {
    fn new(loaded: Loaded) -> Self {
        Self { loaded, scene: OnceLock::new(), shaped: OnceLock::new(), search: OnceLock::new() }
    }

    /// As it is simulated.
    pub fn scene(&self) -> Result<Arc<crate::scene::Scene<R>>, Error> {
        once(&self.scene, || crate::scene::Scene::from_config(&self.loaded.config))
    }

    /// The same with its design.
    pub fn shaped(&self) -> Result<Arc<Problem<R>>, Error> {
        once(&self.shaped, || Ok(self.located(build_design(&self.loaded.config))?.0))
    }

    /// An error with the place of the key that it is about.
    fn located<T>(&self, found: Result<T, Error>) -> Result<T, Error> {
        found.map_err(|error| match error {
            Error::Input(bad) => bad.located(|key| self.loaded.place(key).map(str::to_owned)).into(),
            other => other,
        })
    }

    /// An error for a design that can not be one.
    pub fn check(&self, problem: &Problem<R>, design: &[f64]) -> Result<(), Error> {
        let count = problem.parametrisation.variables();
        if design.len() != count {
            let what = format!("a design of {} numbers, where scene {} has {count}", design.len(), self.name());
            return Err(BadInput::new(what).allowed("an array like scene.design").into());
        }
        let limits = problem.parametrisation.limits();
        let mut nearest = design.to_vec();
        if design.iter().all(|x| x.is_finite()) {
            limits.nearest(&mut nearest);
            let width = |k: usize| SLACK * (limits.upper[k] - limits.lower[k]);
            if (0..count).all(|k| (nearest[k] - design[k]).abs() <= width(k)) {
                return Ok(());
            }
        }
        let checked = problem.parametrisation.check(design);
        Ok(checked.map_err(|bad| bad.advice("scene.nearest(design), the nearest design that is allowed"))?)
    }

    fn name(&self) -> &'static str {
        self.loaded.config.scene.name()
    }
}

impl<R: Sweeps> Parts<R> {
    fn search(&self) -> Result<Arc<Search<R>>, Error> {
        once(&self.search, || {
            let search = self.loaded.for_search()?;
            let problem = self.located(build_design::<R>(&search.config))?.0;
            let config = &self.loaded.config;
            let schedule = self.located(problem.schedule(&config.optimise, config.run.precision))?;
            Ok(Search { problem, schedule })
        })
    }

    /// The figure of a design.
    fn objective(&self, design: &[f64]) -> Result<f64, Error> {
        let search = self.search()?;
        self.check(&search.problem, design)?;
        Ok(search.problem.truth(design)?.0.figure)
    }

    /// The figure of a design, and its derivative.
    fn value_and_gradient(&self, design: &[f64], teller: &Teller) -> Result<(f64, Vec<f64>), Error> {
        let search = self.search()?;
        let problem = &search.problem;
        self.check(problem, design)?;
        let mut progress = |share| teller.often(Told::Share(share));
        let found = problem.differentiate(design, &search.schedule, &mut progress)?;
        let factor = problem.figure.factor;
        Ok((found.value * factor, found.by_variables.into_iter().map(|x| x * factor).collect()))
    }

    /// What the optimiser makes small.
    fn loss_and_gradient(&self, design: &[f64], teller: &Teller) -> Result<(f64, Vec<f64>), Error> {
        let search = self.search()?;
        self.check(&search.problem, design)?;
        let mut progress = |share| teller.often(Told::Share(share));
        let found = search.problem.gradient(design, &search.schedule, &mut progress)?;
        Ok((found.loss, found.gradient))
    }

    fn optimise(&self, first: Option<&[f64]>, epochs: Option<usize>, teller: &Teller) -> anyhow::Result<Optimisation> {
        let search = self.search()?;
        let (problem, config) = (&search.problem, &self.loaded.config);
        if config.optimise.dynamics != DynamicsName::Solver {
            return Err(BadInput::new("an optimisation by a learned model")
                .key("optimise.dynamics")
                .allowed("optimise.dynamics = solver")
                .advice("the command line, hydrograd optimize, which does that")
                .into());
        }
        let first = first.unwrap_or(&problem.first);
        self.check(problem, first)?;
        let epochs = epochs.unwrap_or(config.optimise.epochs);
        let mut optimisation = Optimisation::new(of_config(&config.optimise, first));
        let judge = |_: usize, design: &[f64]| problem.gradient(design, &search.schedule, &mut |_| ());
        optimisation.run(epochs, problem.parametrisation.limits(), judge, |record| {
            if let Some(last) = record.history.last() {
                teller.always(Told::Epoch(record.history.len(), epochs, last.figure));
            }
            Ok(())
        })?;
        Ok(optimisation)
    }

    /// What there is to know of the design before anything runs.
    fn design<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let search = py.detach(|| self.search()).map_err(|error| to_python(error.into()))?;
        let problem = &search.problem;
        let (parametrisation, config) = (&problem.parametrisation, &self.loaded.config);
        let limits = parametrisation.limits();
        let all = PyDict::new(py);
        all.set_item("first", vector(py, problem.first.clone()))?;
        all.set_item("lower", vector(py, limits.lower.clone()))?;
        all.set_item("upper", vector(py, limits.upper.clone()))?;
        all.set_item("nodes", vector(py, parametrisation.positions().to_vec()))?;
        all.set_item("across", parametrisation.across().map(|z| vector(py, z.to_vec())))?;
        let names: Vec<&str> = config.variables.iter().map(|variable| variable.number.as_str()).collect();
        all.set_item("names", names)?;
        all.set_item("symbol", problem.figure.symbol)?;
        all.set_item("quantity", problem.figure.quantity)?;
        Ok(all)
    }

    /// The height of the wall at points (x, z), or the numbers of shapes.
    fn wall(&self, design: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let search = self.search()?;
        self.check(&search.problem, design)?;
        let shape = search.problem.parametrisation.sampled(design);
        Ok((shape.nodes, shape.offsets))
    }

    fn nearest(&self, mut design: Vec<f64>) -> Result<Vec<f64>, Error> {
        let search = self.search()?;
        let limits = search.problem.parametrisation.limits();
        if design.len() != limits.lower.len() || design.iter().any(|x| !x.is_finite()) {
            self.check(&search.problem, &design)?;
        }
        limits.nearest(&mut design);
        Ok(design)
    }
}

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

    #[pyo3(signature = (design, frames, progress))]
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

    #[pyo3(signature = (design, progress))]
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

    #[pyo3(signature = (design, progress))]
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

    #[pyo3(signature = (first, epochs, progress))]
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
        all.set_item("designs", super::arrays::table(py, designs, [count, width])?)?;
        all.set_item("q", vector(py, found.column(|epoch| epoch.figure)))?;
        all.set_item("loss", vector(py, found.column(|epoch| epoch.loss)))?;
        all.set_item("gradient_norm", vector(py, found.column(|epoch| epoch.gradient_norm)))?;
        all.set_item("seconds", vector(py, found.column(|epoch| epoch.seconds)))?;
        all.set_item("best", found.best)?;
        all.set_item("is_done", found.optimiser.is_done())?;
        Ok(all)
    }
}
