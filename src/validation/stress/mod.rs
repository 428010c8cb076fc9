//! Where the solver holds: what `hydrograd stress` runs.
//!
//! A [`Map`] varies two things of a scene; each of its runs is a [`Job`], and what came of it a [`Record`]: stable, degraded
//! (it got to its end, but one of the criteria of watch.rs was not met), or diverged.

pub mod maps;
mod watch;

pub use maps::{Axis, Map, Panel};
pub use watch::Fault;

use crate::adjoint::run::{go_on, Observer};
use crate::adjoint::{Dynamics, RunError};
use crate::config::layers::Setting;
use crate::config::scene::{Config, Kernels, Precision};
use crate::design::diagnostics::Measurement;
use crate::scene::load::Loaded;
use crate::scene::observers::LastGood;
use crate::scene::Scene;
use crate::sph::divergence::{Divergence, Numbers};
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use watch::Watch;

/// How a run went, from good to bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    Stable,
    Degraded,
    Diverged,
}

impl Verdict {
    /// In tables and pictures.
    pub fn mark(self) -> char {
        match self {
            Self::Stable => 'S',
            Self::Degraded => 'D',
            Self::Diverged => 'X',
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Stable => "stable",
            Self::Degraded => "degraded",
            Self::Diverged => "diverged",
        }
    }
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub settings: Vec<String>,
    pub verdict: Verdict,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
    pub particles: usize,
    pub steps: usize,
    pub time_step: f64,
    /// Of the first state: dt (c + u) / dx, dt max(nu, alpha) / dx^2, u dx / nu.
    pub courant_number: f64,
    pub diffusion_number: f64,
    pub cell_reynolds_number: f64,
    pub seconds: f64,
}

impl Record {
    /// Why it is not stable, in a few words.
    pub fn why(&self) -> String {
        let Some(Fault { step, time, quantity, value, limit, particle, cause, .. }) = &self.fault else {
            return String::new();
        };
        match (particle, cause, limit) {
            (Some(particle), Some(cause), _) => {
                format!("diverged in step {step}, {quantity} of particle {particle} = {value:.3e}: {cause}")
            }
            (_, _, limit) => {
                format!("degraded from t = {time:.3}: {quantity} {value:.3}, above {:.3}", limit.unwrap_or(0.0))
            }
        }
    }
}

/// A run of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    pub scene: &'static str,
    pub panel: Panel,
    /// Places in the axes.
    pub x: usize,
    pub y: usize,
    /// What it sets, `section.key=value`.
    pub settings: Vec<String>,
    /// A file's name.
    pub name: String,
}

impl Job {
    /// Those of a map, with what the user sets in all of them below what is varied.
    pub fn of(map: &Map, quick: bool, sets: &[String]) -> Vec<Self> {
        let mut jobs = Vec::new();
        for panel in map.panels() {
            for (y, at_y) in map.y.values.iter().enumerate().filter(|(_, value)| value.is_quick || !quick) {
                for (x, at_x) in map.x.values.iter().enumerate().filter(|(_, value)| value.is_quick || !quick) {
                    let more = if quick { map.quick_settings } else { &[] };
                    let precision = panel.precision.name();
                    let mut settings: Vec<String> =
                        map.settings.iter().chain(more).map(|setting| setting.to_string()).collect();
                    // A scene with one formulation does not hear which.
                    if map.formulations.len() > 1 {
                        settings.push(format!("method.name={}", panel.formulation));
                    }
                    settings.push(format!("run.precision={precision}"));
                    settings.extend(sets.iter().chain(&at_x.settings).chain(&at_y.settings).cloned());
                    let name = format!("{}-{}-{precision}-{x}-{y}", map.id(), panel.formulation);
                    jobs.push(Self { scene: map.scene, panel, x, y, settings, name });
                }
            }
        }
        jobs
    }

    /// Its configuration.
    ///
    /// # Errors
    /// Settings that are not allowed.
    pub fn load(&self) -> Result<Loaded, crate::error::Error> {
        // What the user sets for one method concerns its panels only.
        let settings: Vec<Setting> = self.settings.iter().map(|text| Setting::set(text)).collect();
        Ok(Config::load(Some(self.scene), None, &[])?.with(&settings)?)
    }

    /// Runs it. Not an error: a run that diverges.
    ///
    /// # Errors
    /// Settings that are not allowed; other failures.
    pub fn run(&self) -> anyhow::Result<Record> {
        let loaded = self.load()?;
        match self.panel.precision {
            Precision::F64 => self.judge::<f64>(&loaded.config),
            Precision::F32 => self.judge::<f32>(&loaded.config),
        }
    }

    fn judge<R: Sweeps>(&self, config: &Config) -> anyhow::Result<Record> {
        let clock = Instant::now();
        let scene = Scene::<R>::from_config(config)?;
        let (model, start, dt) = (&scene.model, &scene.start, scene.model.dt);
        let dynamics = Sph::new(model.clone(), Kernels::Fused);
        // Every step is checked: the first particle that goes wrong is the one to name.
        let mut check = |dynamics: &Sph<R>, solver: &mut Solver<R>| Ok(dynamics.check(solver)?);
        let mut watch = Watch::new(config, &scene);
        let mut good = LastGood::new(start);
        let mut measurement = scene.design.as_ref().map(Measurement::of);
        let mut observers: Vec<&mut dyn Observer<Sph<R>>> = vec![&mut check, &mut good, &mut watch];
        observers.extend(measurement.as_mut().map(|it| it as &mut dyn Observer<Sph<R>>));
        let ended = dynamics
            .start(start)
            .map_err(anyhow::Error::from)
            .and_then(|mut run| go_on(&dynamics, &mut run, scene.steps, &mut observers));
        let fault = match ended {
            Ok(()) => {
                let balance = measurement.map(|measured| measured.diagnostics());
                watch.fault.or_else(|| balance.and_then(|found| watch::heat_balance(config, scene.steps, &found)))
            }
            Err(error) => {
                let error = error.downcast::<RunError>()?;
                let Some(found) = Divergence::of(&error, model, good.state()) else { return Err(error.into()) };
                Some(Fault {
                    step: found.step,
                    time: found.step as f64 * dt,
                    quantity: found.quantity,
                    value: found.value,
                    particle: Some(found.particle),
                    tag: Some(found.tag.into()),
                    position: Some(found.position),
                    cause: Some(found.cause.why),
                    ..Fault::default()
                })
            }
        };
        let verdict = match &fault {
            None => Verdict::Stable,
            Some(Fault { particle: None, .. }) => Verdict::Degraded,
            Some(_) => Verdict::Diverged,
        };
        let numbers = Numbers::of(model, start);
        Ok(Record {
            settings: self.settings.clone(),
            verdict,
            fault,
            particles: model.particles(),
            steps: scene.steps,
            time_step: dt,
            courant_number: numbers.courant_number,
            diffusion_number: numbers.diffusion_number,
            cell_reynolds_number: numbers.cell_reynolds_number,
            seconds: clock.elapsed().as_secs_f64(),
        })
    }
}

/// A map's records, as far as they are there, by panel, row and column.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    pub map: Map,
    pub panels: Vec<(Panel, Vec<Vec<Option<Record>>>)>,
}

impl Found {
    /// Of jobs and their records.
    pub fn new(map: &Map, found: &[(Job, Option<Record>)]) -> Self {
        let cell = |panel: Panel, x: usize, y: usize| {
            let job = found.iter().find(|(job, _)| job.panel == panel && (job.x, job.y) == (x, y));
            job.and_then(|(_, record)| record.clone())
        };
        let row = |panel: Panel, y: usize| (0..map.x.values.len()).map(|x| cell(panel, x, y)).collect();
        let rows = |panel: Panel| (0..map.y.values.len()).map(|y| row(panel, y)).collect();
        Self { map: map.clone(), panels: map.panels().into_iter().map(|panel| (panel, rows(panel))).collect() }
    }

    /// Why it ends to hold: at the usual row of the first panel that has an edge, or at its first such row.
    pub fn edge(&self) -> String {
        let Map { x, y, .. } = &self.map;
        for (panel, rows) in &self.panels {
            let usual_first = [y.usual].into_iter().chain((0..rows.len()).filter(|&row| row != y.usual));
            for row in usual_first {
                let mut last = None;
                for (place, record) in rows[row].iter().enumerate().filter_map(|(k, cell)| Some((k, cell.as_ref()?))) {
                    if record.verdict != Verdict::Stable {
                        let (at, from) = (&x.values[place].label, last.map_or("", |k: usize| &x.values[k].label));
                        let range = if last.is_none() { at.clone() } else { format!("{from} -> {at}") };
                        let (at_y, precision, why) = (&y.values[row].label, panel.precision.name(), record.why());
                        let place = format!("{} {at_y}, {}, {precision}", y.name, panel.formulation);
                        return format!("{} {range} ({place}): {why}", x.name);
                    }
                    last = Some(place);
                }
            }
        }
        "none within this map: every run is stable".into()
    }

    /// The largest value of x up to which every run of a panel is no worse than `worst`: in the usual row, and in all rows.
    pub fn largest(&self, rows: &[Vec<Option<Record>>], worst: Verdict) -> [Option<&str>; 2] {
        let holds = |row: &Vec<Option<Record>>| {
            let seen = row.iter().enumerate().filter_map(|(k, cell)| Some((k, cell.as_ref()?)));
            seen.take_while(|(_, record)| record.verdict <= worst).last().map(|(k, _)| k)
        };
        let has_any = |row: &&Vec<Option<Record>>| row.iter().any(Option::is_some);
        let everywhere: Option<Vec<usize>> = rows.iter().filter(has_any).map(holds).collect();
        let least = everywhere.and_then(|all| all.into_iter().min());
        [holds(&rows[self.map.y.usual]), least].map(|place| place.map(|k| self.map.x.values[k].label.as_str()))
    }
}
