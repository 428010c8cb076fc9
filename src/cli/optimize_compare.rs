//! `hydrograd optimize --compare`: solver, surrogate, both, a trust region, and a search without gradients, side by side.

use super::files;
use super::optimize_report::Outcome;
use super::optimize_search::{one, Begin};
use super::prepare::build;
use super::run_folder::{Earlier, RunFolder};
use crate::config::layers::Setting;
use crate::config::scene::Precision;
use crate::design::cma_es;
use crate::design::optimise::Epoch;
use crate::design::problem::{Derivative, ADJOINT};
use crate::design::Judge;
use crate::error::Error;
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::write_rows;
use crate::report::memory::{peak_memory_bytes, reset_peak_memory};
use crate::report::plots::compare;
use crate::report::progress::{Progress, Tasks};
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::record::{relative_change, Record};
use crate::sph::Sweeps;
use crate::surrogate::design::SurrogateProblem;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Epochs of the trust region, each of which has its own proposal.
const REGION_EPOCHS: usize = 8;
/// Evaluations of the search without gradients per epoch of the others.
const EVALUATIONS: usize = 12;
/// Number of designs on the surrogate's path at which both gradients are compared.
const PLACES: usize = 6;
/// Numbers of predicted frames in the comparison of gradients over horizons.
const HORIZONS: [usize; 5] = [5, 10, 20, 40, 80];

/// The result of one method of search.
struct Way {
    name: &'static str,
    /// The solver's objective of the first design.
    first: f64,
    /// Number of solver steps so far, and the best objective that the solver has confirmed.
    course: Vec<(f64, f64)>,
    seconds: f64,
    bytes: u64,
}

impl Way {
    fn best(&self) -> f64 {
        self.course.last().map_or(f64::NAN, |point| point.1)
    }
    fn gain(&self) -> f64 {
        relative_change(self.first, self.best())
    }
    fn steps(&self) -> f64 {
        self.course.last().map_or(0.0, |point| point.0)
    }
    /// Number of solver steps until this gain is confirmed.
    fn steps_to(&self, gain: f64) -> Option<f64> {
        self.course.iter().find(|(_, q)| relative_change(self.first, *q) >= gain).map(|(steps, _)| *steps)
    }
}

/// Runs every method in its own folder, and compares them.
///
/// A resumed comparison repeats the search without gradients and the evaluation of all. Unfinished methods are resumed,
/// and their memory is that of the resumed part.
pub fn run(loaded: &Loaded, folder: &Path, earlier: Earlier) -> anyhow::Result<Vec<RunFolder>> {
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(loaded, folder, earlier),
        Precision::F64 => go::<f64>(loaded, folder, earlier),
    }
}

/// The configuration with other values of some keys.
fn with(loaded: &Loaded, pairs: &[(&str, &str)]) -> Result<Loaded, Error> {
    Ok(loaded.with(&pairs.iter().map(|(key, value)| Setting::option("--compare", key, value)).collect::<Vec<_>>())?)
}

fn go<R: Sweeps>(loaded: &Loaded, folder: &Path, earlier: Earlier) -> anyhow::Result<Vec<RunFolder>> {
    let set = |pairs: &[(&str, &str)]| with(loaded, pairs);
    let dynamics = |name: &'static str| ("optimise.dynamics", name);
    let trust = |name: &'static str| ("surrogate.trust", name);
    let epochs = REGION_EPOCHS.min(loaded.config.optimise.epochs).to_string();
    // Every method is built before the first one runs.
    let ways = [
        ("solver", set(&[trust("none"), dynamics("solver")])?),
        ("surrogate", set(&[dynamics("surrogate"), trust("none")])?),
        ("surrogate, checked", set(&[dynamics("surrogate"), trust("check")])?),
        ("trust region", set(&[dynamics("surrogate"), trust("region"), ("optimise.epochs", &epochs)])?),
        ("both", set(&[dynamics("both"), trust("none")])?),
    ];
    for (_, loaded) in &ways {
        SurrogateProblem::<R>::of_config(loaded)?;
    }
    // Defaults differ between methods, so only given values are shared.
    write_bytes_atomically(&folder.join("config.toml"), loaded.given_text().as_bytes())?;
    let splines = set(&[trust("none"), dynamics("solver"), ("design.parametrisation", "b-spline")])?;
    let (mut found, mut path, mut all, mut owned) = (Vec::new(), Vec::new(), Record::default(), Vec::new());
    for (name, loaded) in &ways {
        reset_peak_memory();
        let clock = Instant::now();
        let label = name.replace(", ", "-").replace(' ', "-");
        let place = folder.join(&label);
        let tasks = Tasks::default();
        let begin = Begin::part(&place, earlier, name, &tasks);
        let (own, outcome) = one(loaded, begin)?;
        owned.push(own);
        let seconds = match begin.resume.is_some() {
            // The time of earlier sessions is known only by epoch.
            true => outcome.history.iter().map(|epoch| epoch.seconds).sum(),
            false => clock.elapsed().as_secs_f64(),
        };
        let first = outcome.history[0].shown();
        found.push(Way { name, first, course: course(&outcome.history), seconds, bytes: peak_memory_bytes() });
        if *name == "surrogate" {
            path = designs(&outcome);
        }
        all.put(&label, outcome.record);
    }
    found.push(without_gradient::<R>(&splines)?);
    let cosines = cosines::<R>(&ways[1].1, &path)?;
    let horizons = horizons::<R>(&ways[1].1)?;
    report(loaded, folder, &found, (&cosines, &horizons), all)?;
    Ok(owned)
}

/// Number of solver steps and the best confirmed objective, by epoch.
fn course(history: &[Epoch]) -> Vec<(f64, f64)> {
    let (mut steps, mut best) = (0.0, f64::NEG_INFINITY);
    let mut course = Vec::new();
    for epoch in history {
        steps += (epoch.solver_steps - epoch.judged_late.unwrap_or(0)) as f64;
        if let Some(truth) = epoch.truth.filter(|truth| truth.figure.is_finite() && epoch.judged_late.is_none()) {
            best = f64::max(best, truth.figure);
        }
        if best.is_finite() {
            course.push((steps, best));
        }
    }
    // The solver's evaluations after all epochs come last.
    for epoch in history {
        let (Some(more), Some(truth)) = (epoch.judged_late, epoch.truth) else { continue };
        steps += more as f64;
        if truth.figure.is_finite() {
            best = f64::max(best, truth.figure);
            course.push((steps, best));
        }
    }
    course
}

/// Some designs spread over a path.
fn designs(outcome: &Outcome) -> Vec<(usize, Vec<f64>)> {
    let good: Vec<usize> = (0..outcome.history.len()).filter(|&e| !outcome.history[e].is_rejected()).collect();
    let count = PLACES.min(good.len());
    let chosen = (0..count).map(|k| good[k * (good.len() - 1) / (count - 1).max(1)]);
    chosen.map(|epoch| (epoch, outcome.history[epoch].variables.clone())).collect()
}

/// CMA-ES on the control points of a B-spline, evaluated by the solver.
fn without_gradient<R: Sweeps>(loaded: &Loaded) -> anyhow::Result<Way> {
    let solver = loaded.scheduled::<R>()?;
    reset_peak_memory();
    let evaluations = EVALUATIONS * loaded.config.optimise.epochs;
    let (clock, bar) = (Instant::now(), Progress::new(evaluations as u64, "optimize cma-es"));
    let (mut steps, mut course, mut best) = (0, Vec::new(), f64::NEG_INFINITY);
    let mut loss = |variables: &[f64]| match solver.value(variables) {
        Ok(found) => {
            steps += found.solver_steps;
            best = f64::max(best, found.figure);
            course.push((steps as f64, best));
            bar.done(1);
            Ok(found.loss)
        }
        Err(Error::Diverged { .. }) => {
            bar.done(1);
            Ok(f64::INFINITY)
        }
        Err(error) => Err(error),
    };
    let step = 0.25 * loaded.config.design.bound;
    let limits = solver.parametrisation().limits();
    cma_es::search(&solver.problem.first, step, evaluations, loaded.config.run.seed, limits, &mut loss)?;
    bar.finish();
    let seconds = clock.elapsed().as_secs_f64();
    let first = course.first().map_or(f64::NAN, |point| point.1);
    Ok(Way { name: "CMA-ES, B-spline", first, course, seconds, bytes: peak_memory_bytes() })
}

/// The cosine between the surrogate's and the solver's gradient of the objective, by epoch.
fn cosines<R: Sweeps>(loaded: &Loaded, path: &[(usize, Vec<f64>)]) -> anyhow::Result<Vec<(usize, f64)>> {
    let Some(surrogate) = SurrogateProblem::<R>::of_config(loaded)? else { return Ok(Vec::new()) };
    let solver = loaded.scheduled::<R>()?;
    // A wall that only the surrogate has evaluated may fail in the solver.
    let cosine = |variables: &[f64]| {
        let by_solver = solver.differentiate(variables, &mut |_| ()).ok()?.by_variables;
        let own = surrogate.differentiate(variables, &mut |_| ()).ok()?.by_variables;
        Some(own.iter().zip(&by_solver).map(|(a, b)| a * b).sum::<f64>() / (norm(&own) * norm(&by_solver)))
    };
    Ok(path.iter().map(|(epoch, variables)| (*epoch, cosine(variables).unwrap_or(f64::NAN))).collect())
}

fn norm(of: &[f64]) -> f64 {
    of.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Time of a horizon, and the norms of both gradients of the objective at its end.
struct Horizon {
    time: f64,
    surrogate: f64,
    solver: f64,
}

/// Growth of gradients with the length of the horizon, for the first design, with moving particles in both.
fn horizons<R: Sweeps>(loaded: &Loaded) -> anyhow::Result<Vec<Horizon>> {
    let mut found = Vec::new();
    for steps in HORIZONS {
        let frames =
            [("surrogate.steps", &*steps.to_string()), ("surrogate.settle", "300"), ("surrogate.window", "0.0")];
        let Some(own) = SurrogateProblem::<R>::of_config(&with(loaded, &frames)?)? else { return Ok(found) };
        let settings = [
            ("time.end", &*format!("{:?}", own.end())),
            ("objective.window", "0.0"),
            ("objective.samples", "1"),
            ("optimise.dynamics", "solver"),
            // The same design variables in both.
            ("design.parametrisation", &*json!(loaded.config.design.parametrisation).to_string()),
        ];
        let with = with(loaded, &settings)?;
        let (problem, _) = build::<R>(&with.config)?;
        let schedule = problem.schedule(&with.config.optimise, with.config.run.precision)?;
        // A failed run has no gradient; the others do.
        let size = |found: Result<Derivative, Error>| found.map_or(f64::NAN, |found| norm(&found.by_variables));
        found.push(Horizon {
            time: own.end(),
            surrogate: size(own.differentiate(&own.problem.first, &mut |_| ())),
            solver: size(problem.differentiate(&problem.first, &schedule, &mut |_| ())),
        });
    }
    Ok(found)
}

fn report(
    loaded: &Loaded,
    folder: &Path,
    ways: &[Way],
    (cosines, horizons): (&[(usize, f64)], &[Horizon]),
    mut all: Record,
) -> anyhow::Result<()> {
    let symbol = crate::design::objectives::Figure::of_config(&loaded.config).symbol;
    let solver_gain = ways[0].gain();
    let headers =
        ["search", symbol, "gain in the solver", "of the solver's", "solver steps", "to 90 %", "seconds", "peak MB"];
    let mut table = Table::new(headers);
    for way in ways {
        let Way { name, seconds, bytes, .. } = way;
        let (gain, steps, steps_to) = (way.gain(), way.steps(), way.steps_to(0.9 * solver_gain));
        table.row([
            name.to_string(),
            format!("{:.6}", way.best()),
            format!("{:+.2} %", 100.0 * gain),
            format!("{:.0} %", 100.0 * gain / solver_gain),
            format!("{steps:.0}"),
            steps_to.map_or("-".into(), |steps| format!("{steps:.0}")),
            format!("{seconds:.1}"),
            format!("{:.0}", *bytes as f64 / 1e6),
        ]);
        let row = json!({ "gain": gain, "solver_steps": steps, "solver_steps_to_90_percent": steps_to,
            "seconds": seconds, "peak_bytes": bytes });
        all.put(&format!("compared: {name}"), row);
    }
    let curve =
        |way: &Way| way.course.iter().map(|(steps, q)| (*steps, 100.0 * relative_change(way.first, *q))).collect();
    let curves: Vec<(String, Vec<(f64, f64)>)> = ways.iter().map(|way| (way.name.to_string(), curve(way))).collect();
    let title = "Gain by the work of the solver";
    let label = format!("gain of {symbol} that the solver confirms (%)");
    compare(&folder.join("compare"), title, "steps of the solver", &label, &curves, true, false)?;
    let of = |size: fn(&Horizon) -> f64| horizons.iter().map(|h| (h.time, size(h))).collect::<Vec<_>>();
    let curves = [("surrogate".to_string(), of(|h| h.surrogate)), ("solver".to_string(), of(|h| h.solver))];
    let label = format!("|gradient of {symbol} at the end|");
    compare(&folder.join("horizons"), "Gradient by horizon", "time (scene units)", &label, &curves, false, true)?;
    let rows: Vec<Vec<f64>> = horizons.iter().map(|h| vec![h.time, h.surrogate, h.solver]).collect();
    write_rows(&folder.join("horizons.csv"), &["time", "surrogate", "solver"], &rows)?;
    let shown: Vec<String> = cosines.iter().map(|(epoch, cosine)| format!("{cosine:.3} (epoch {epoch})")).collect();
    all.put("cosine_by_epoch", cosines);
    all.put("gradient_norm_by_horizon", rows);
    files::write_summary(folder, &all)?;
    println!("{}", table.to_text());
    println!("a step of an adjoint counts as {ADJOINT} of the solver");
    println!("cosine of the surrogate's gradient with the solver's along its path: {}", shown.join(", "));
    let growth: Vec<String> =
        horizons.iter().map(|h| format!("{:.2e} / {:.2e} at {:.2}", h.surrogate, h.solver, h.time)).collect();
    println!("|gradient| of surrogate / solver by the time they look back from: {}", growth.join(", "));
    println!(
        "files in {}: report.html, compare.png, horizons.png, horizons.csv, summary.json, and a folder per search",
        folder.display()
    );
    Ok(())
}
