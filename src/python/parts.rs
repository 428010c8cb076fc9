//! What is built of a scene's configuration when it is asked for, and what is computed with it.

use super::arrays::vector;
use super::errors::to_python;
use super::steady::Kept;
use super::watch::{Teller, Told};
use crate::design::{Judge, Optimisation, Problem, Scheduled, Search};
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::scene::build_design;
use crate::scene::load::Loaded;
use crate::scene::verification::Verification;
use crate::sph::Sweeps;
use crate::surrogate::design::SurrogateProblem;
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
    solver: OnceLock<Arc<Scheduled<R>>>,
    /// For flows around shapes.
    pub kept: Kept,
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

impl<R: Sweeps> Parts<R> {
    pub fn new(loaded: Loaded) -> Self {
        Self { loaded, scene: OnceLock::new(), shaped: OnceLock::new(), solver: OnceLock::new(), kept: Kept::default() }
    }

    /// As it is simulated.
    pub fn scene(&self) -> Result<Arc<crate::scene::Scene<R>>, Error> {
        once(&self.scene, || crate::scene::Scene::from_config(&self.loaded.config))
    }

    /// The same with its design.
    pub fn shaped(&self) -> Result<Arc<Problem<R>>, Error> {
        let located = |error| self.loaded.located_error(error);
        once(&self.shaped, || Ok(build_design(&self.loaded.config).map_err(located)?.0))
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

    pub fn name(&self) -> &'static str {
        self.loaded.config.scene.name()
    }

    /// Who judges designs in `hydrograd optimize`.
    fn solver(&self) -> Result<Arc<Scheduled<R>>, Error> {
        once(&self.solver, || self.loaded.scheduled())
    }

    /// The figure of a design.
    pub fn objective(&self, design: &[f64]) -> Result<f64, Error> {
        let solver = self.solver()?;
        self.check(&solver.problem, design)?;
        Ok(solver.value(design)?.figure)
    }

    /// The figure of a design, and its derivative.
    pub fn value_and_gradient(&self, design: &[f64], teller: &Teller) -> Result<(f64, Vec<f64>), Error> {
        let solver = self.solver()?;
        self.check(&solver.problem, design)?;
        let found = solver.differentiate(design, &mut |share| teller.often(Told::Share(share)))?;
        let factor = solver.problem.figure.factor;
        Ok((found.value * factor, found.by_variables.into_iter().map(|x| x * factor).collect()))
    }

    /// What the optimiser makes small.
    pub fn loss_and_gradient(&self, design: &[f64], teller: &Teller) -> Result<(f64, Vec<f64>), Error> {
        let solver = self.solver()?;
        self.check(&solver.problem, design)?;
        let found = solver.gradient(design, &mut |share| teller.often(Told::Share(share)))?;
        Ok((found.loss, found.gradient))
    }

    /// The search of `hydrograd optimize`, to the bit.
    pub fn optimise(
        &self,
        first: Option<&[f64]>,
        epochs: Option<usize>,
        teller: &Teller,
    ) -> anyhow::Result<Optimisation> {
        let (solver, config) = (self.solver()?, &self.loaded.config);
        let first = first.unwrap_or(&solver.problem.first);
        self.check(&solver.problem, first)?;
        let surrogate = SurrogateProblem::<R>::of_config(&self.loaded)?;
        let search = Search { config, solver: &*solver, surrogate: surrogate.as_ref().map(|it| it as &dyn Judge) };
        let epochs = epochs.unwrap_or(config.optimise.epochs);
        let mut optimisation = Optimisation::new(search.optimiser(first));
        search.run(&mut optimisation, epochs, &mut |now: &Optimisation| {
            if let Some(last) = now.history.last() {
                teller.always(Told::Epoch(now.history.len(), epochs, last.figure));
            }
            Ok(())
        })?;
        Ok(optimisation)
    }

    /// The checks of `hydrograd verify`, as JSON: of a design against another one, or the scene's own.
    pub fn verify(&self, best: &[f64], first: Option<&[f64]>, teller: &Teller) -> anyhow::Result<String> {
        let solver = self.solver()?;
        let problem = &solver.problem;
        let sampled = |design: &[f64]| {
            self.check(problem, design)?;
            Ok::<_, Error>(problem.parametrisation.sampled(design))
        };
        let (first, best) = (sampled(first.unwrap_or(&problem.first))?, sampled(best)?);
        let verification = Verification::of_search(&self.loaded, Some(first), best)?;
        let found = verification.run(&mut |share| teller.often(Told::Share(share)))?;
        // Else a check has failed for this, and not of itself.
        interrupt::check()?;
        Ok(serde_json::to_string(&found.record())?)
    }

    /// What there is to know of the design before anything runs.
    pub fn design<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let solver = py.detach(|| self.solver()).map_err(|error| to_python(error.into()))?;
        let problem = &solver.problem;
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
    pub fn wall(&self, design: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let solver = self.solver()?;
        self.check(&solver.problem, design)?;
        let shape = solver.problem.parametrisation.sampled(design);
        Ok((shape.nodes, shape.offsets))
    }

    pub fn nearest(&self, mut design: Vec<f64>) -> Result<Vec<f64>, Error> {
        let solver = self.solver()?;
        let limits = solver.problem.parametrisation.limits();
        if design.len() != limits.lower.len() || design.iter().any(|x| !x.is_finite()) {
            self.check(&solver.problem, &design)?;
        }
        limits.nearest(&mut design);
        Ok(design)
    }
}
