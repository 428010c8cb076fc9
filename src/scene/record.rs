//! The figures of a run in `summary.json`, written by commands and Python, and read by commands, pages and comparisons.

use super::figures::FlowFigures;
use super::load::Loaded;
use super::warnings::{self, Warning};
use super::Scene;
use crate::config::scene::{Config, Family};
use crate::design::diagnostics::Diagnostics;
use crate::design::objectives::Figure;
use crate::design::optimise::Epoch;
use crate::design::{Optimisation, Parametrisation, Problem};
use crate::numerics::lanes::Real;
use crate::numerics::threads;
use crate::report::memory::peak_memory_bytes;
use crate::report::VERSION;
use crate::sph::division::Divided;
use serde::{Deserialize, Serialize};
use serde_json::{json, Map, Value};

/// Figures of a summary and their names, the most important first.
pub const FIGURES: [(&str, &str); 11] = [
    ("q", "outflowing heat Q"),
    ("wall_heat_flux", "wall heat flux"),
    ("stored_heat_rate", "heat stored per time"),
    ("energy_imbalance", "energy imbalance / wall heat flux"),
    ("flow_rate", "flow rate"),
    ("body_force", "body force"),
    ("pumping_power", "pumping power"),
    ("mean_outlet_temperature", "mixed outlet temperature"),
    ("mean_temperature", "mean temperature"),
    ("mean_density", "mean density"),
    ("u_max", "fastest particle along x"),
];

/// Figures that exist only with heat.
const HEAT: [&str; 9] = [
    "q",
    "q_sum",
    "q_drift",
    "q_sampling",
    "mean_outlet_temperature",
    "mean_temperature",
    "wall_heat_flux",
    "stored_heat_rate",
    "energy_imbalance",
];
/// Figures that exist only where fluid passes a section.
const PASSING: [&str; 8] = [
    "q",
    "q_sum",
    "q_drift",
    "q_sampling",
    "flow_rate",
    "flow_rate_drift",
    "flow_rate_sampling",
    "mean_outlet_temperature",
];

/// The figures of a run by name, in insertion order. Files of every version can be read: unknown figures are missing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Record(pub Map<String, Value>);

impl Record {
    /// The measurements of a flow that have a meaning in its scene.
    pub fn of_measured(config: &Config, found: &Diagnostics) -> Self {
        let mut record = Self::of(found);
        let mut leave_out = |keys: &[&str]| keys.iter().for_each(|key| drop(record.0.shift_remove(*key)));
        if !config.has_heat() {
            leave_out(&HEAT);
        }
        if !config.flows_through() {
            leave_out(&PASSING);
        }
        if !config.heat_passes() {
            leave_out(&["energy_imbalance"]);
        }
        if !config.settles() {
            leave_out(&["unsettled"]);
        }
        let figures: Vec<String> = record.0.keys().cloned().collect();
        if let Some(Value::Object(unsettled)) = record.0.get_mut("unsettled") {
            unsettled.retain(|name, _| figures.contains(name));
        }
        record
    }

    /// The fields of a struct of figures, such as [`Diagnostics`].
    pub fn of(figures: &impl Serialize) -> Self {
        match json!(figures) {
            Value::Object(map) => Self(map),
            _ => Self::default(),
        }
    }

    pub fn of_design(loaded: &Loaded, found: &Diagnostics, steps: usize, seconds: f64) -> Self {
        let mut record = Self::of_measured(&loaded.config, found);
        record.put("dimensionless", loaded.config.dimensionless(found.u_max));
        record.put_run(loaded, steps, seconds);
        if loaded.config.dimension() == 2 && record.0.contains_key("q") {
            record.put("q_sum", found.q / loaded.config.resolution.dx);
        }
        record
    }

    /// The record of a run of a verification flow or a custom scene.
    pub fn of_flow<R: Real>(
        loaded: &Loaded,
        scene: &Scene<R>,
        found: &FlowFigures,
        measured: Option<&Diagnostics>,
        divided: Divided,
        seconds: f64,
    ) -> Self {
        let mut record = Self::default();
        record.put("scene", loaded.config.scene);
        record.put("particles", scene.model.particles());
        record.put("steps", scene.steps);
        record.put("time_step", loaded.config.time_step());
        record.put("divided_steps", divided.steps);
        record.put("most_parts", divided.most.max(1));
        record.0.extend(Self::of(found).0);
        if let Some(measured) = measured {
            record.0.extend(Self::of_measured(&loaded.config, measured).0);
            if loaded.config.flows_through() {
                record.put("objective_kind", loaded.config.objective.recorded_kind());
                record.put("objective", measured.objective(&loaded.config));
            }
        }
        record.put("dimensionless", loaded.config.dimensionless(found.largest_velocity));
        record.put_run(loaded, scene.steps, seconds);
        record
    }

    /// The record of a steady flow of fixed particles, without its figures.
    pub fn of_steady(loaded: &Loaded, fastest: f64, seconds: f64) -> Self {
        let mut record = Self::default();
        record.put("dimensionless", loaded.config.dimensionless(fastest));
        record.put_common(loaded, seconds);
        record
    }

    /// Adds the figures that every run with steps has.
    fn put_run(&mut self, loaded: &Loaded, steps: usize, seconds: f64) {
        let config = &loaded.config;
        self.put("steps", steps);
        self.put("time_step", config.time_step());
        self.put_common(loaded, seconds);
    }

    /// Adds the figures that every run has.
    fn put_common(&mut self, loaded: &Loaded, seconds: f64) {
        let config = &loaded.config;
        self.put("wall_seconds", seconds);
        self.put("threads", threads::count());
        self.put("peak_memory_bytes", peak_memory_bytes());
        self.put("version", VERSION);
        self.put("seed", config.run.seed);
        self.put("precision", config.run.precision);
        self.put("scene", config.scene);
        // A continued run has its own file, whose name has no meaning.
        let file = loaded.source.name();
        if config.scene == Family::Custom && file != "config" {
            self.put("scene_file", file);
        }
    }

    /// The record of a search, from the records of the runs of its first and its best design.
    pub fn of_search<R>(problem: &Problem<R>, optimisation: &Optimisation, [mut before, mut after]: [Self; 2]) -> Self {
        let (history, best) = (&optimisation.history, optimisation.best);
        let name = problem.figure.symbol.to_lowercase();
        // Uses the objective's samples, so that the best value is one of those per epoch.
        for (record, epoch) in [(&mut before, 0), (&mut after, best)] {
            record.put(&name, history[epoch].shown());
            if record.0.contains_key("q_sum") {
                record.put("q_sum", record.number("q").map(|q| q / problem.outlet.spacing));
            }
        }
        after.put(&format!("{name}_first"), history[0].shown());
        after.put("solver_steps", optimisation.solver_steps());
        after.put("best_epoch", best);
        after.put("rejected_epochs", optimisation.rejected());
        after.put(&format!("{name}_per_epoch"), optimisation.column(|epoch| epoch.figure));
        if history.iter().any(|epoch| epoch.predicted.is_some()) {
            let column = |of: fn(&Epoch) -> Option<f64>| history.iter().map(of).collect::<Vec<_>>();
            after.put(&format!("{name}_predicted_per_epoch"), column(|epoch| epoch.predicted));
            after.put(&format!("{name}_solver_per_epoch"), column(|epoch| epoch.truth.map(|truth| truth.figure)));
            after.put("solver_from", optimisation.solver_from);
        }
        after.put("loss_per_epoch", optimisation.column(|epoch| epoch.loss));
        after.put("gradient_norm_per_epoch", optimisation.column(|epoch| epoch.gradient_norm));
        if history.iter().any(|epoch| epoch.gradient_error > 0.0) {
            after.put("gradient_error_per_epoch", optimisation.column(|epoch| epoch.gradient_error));
        }
        after.put("seconds_per_epoch", optimisation.column(|epoch| epoch.seconds));
        after.put("before", before);
        let limits = problem.parametrisation.limits();
        let width = limits.upper.iter().zip(&limits.lower).map(|(upper, lower)| upper - lower).fold(0.0, f64::max);
        after.put("warnings", warnings::of_search(optimisation, width));
        after
    }

    /// Adds the variables of a search's walls.
    pub fn put_walls(&mut self, parametrisation: &dyn Parametrisation, optimisation: &Optimisation) {
        let history = &optimisation.history;
        self.put("nodes", parametrisation.positions());
        if let Some(across) = parametrisation.across() {
            self.put("nodes_z", across);
        }
        self.put("offsets_first", &history[0].variables);
        self.put("offsets_best", &history[optimisation.best].variables);
        self.put("offsets_last", history.last().map(|epoch| &epoch.variables));
    }

    pub fn put(&mut self, key: &str, value: impl Serialize) {
        self.0.insert(key.into(), json!(value));
    }

    /// Adds warnings, with that of their advice which the scene allows.
    pub fn put_warnings(&mut self, loaded: &Loaded, mut warnings: Vec<Warning>) {
        warnings.iter_mut().for_each(|warning| warning.advice = loaded.possible(&warning.advice));
        self.put("warnings", warnings);
    }

    pub fn number(&self, key: &str) -> Option<f64> {
        self.0.get(key).and_then(Value::as_f64)
    }

    pub fn text(&self, key: &str) -> Option<&str> {
        self.0.get(key).and_then(Value::as_str)
    }

    /// The rows of a figure, if it exists.
    pub fn rows(&self, key: &str) -> Option<&Vec<Value>> {
        self.0.get(key).and_then(Value::as_array)
    }

    /// A figure per epoch; none where it was not finite.
    pub fn per_epoch(&self, key: &str) -> Option<Vec<Option<f64>>> {
        Some(self.rows(key)?.iter().map(Value::as_f64).collect())
    }

    /// The record of the run of a search's first design.
    pub fn before(&self) -> Self {
        self.0.get("before").map(Self::of).unwrap_or_default()
    }

    pub fn warnings(&self) -> Vec<Warning> {
        let all = self.rows("warnings").into_iter().flatten();
        all.filter_map(|one| Warning::deserialize(one).ok()).collect()
    }

    /// The result of a search for an objective; none for other runs.
    pub fn search(&self, figure: Figure) -> Option<Search> {
        let name = figure.symbol.to_lowercase();
        Some(Search {
            figure,
            first: self.number(&format!("{name}_first"))?,
            best: self.number(&name)?,
            best_epoch: self.number("best_epoch")? as usize,
            values: self.per_epoch(&format!("{name}_per_epoch"))?,
            survives: self.number("gain_survives"),
        })
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    pub figure: Figure,
    /// The objective of the first and of the best design.
    pub first: f64,
    pub best: f64,
    /// Index of the best epoch, from zero.
    pub best_epoch: usize,
    /// The objective of each epoch; none where its run failed.
    pub values: Vec<Option<f64>>,
    /// The smallest gain under all checks.
    pub survives: Option<f64>,
}

impl Search {
    /// The relative change from the first to the best design.
    pub fn gain(&self) -> f64 {
        relative_change(self.first, self.best)
    }
}

/// By how much a figure has grown, relative to its size: one that was negative and is nearer to zero has grown too.
pub fn relative_change(from: f64, to: f64) -> f64 {
    (to - from) / from.abs()
}

/// A divergence from which a run recovered.
#[derive(Debug, Clone, Serialize)]
pub struct Recovery {
    /// The step in which it was found.
    pub step: usize,
    /// The step to which the run went back.
    pub from_step: usize,
    /// Number of parts of every step from there.
    pub parts: usize,
    pub cause: String,
}
