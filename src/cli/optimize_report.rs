//! The report of a search of `hydrograd optimize`: its first and best design, in files and as text.

use super::files::{self, AFTER, BEFORE, CHECKPOINT};
use super::prepare::{change, diverged};
use super::simulate_report::warn;
use crate::adjoint::run::Observer;
use crate::adjoint::RunError;
use crate::config::scene::{Config, Family};
use crate::design::diagnostics::{simulate, Diagnostics, Finished};
use crate::design::objectives::Figure;
use crate::design::optimise::Epoch;
use crate::design::problem::ADJOINT;
use crate::design::shape::{Shape, TOP};
use crate::design::{Optimisation, Parametrisation, Problem};
use crate::io::atomic::write_bytes_atomically;
use crate::numerics::threads::{self, in_words};
use crate::report::plots::{history, wall_shapes, HistoryPoint};
use crate::report::table::Table;
use crate::report::text::shown;
use crate::scene::load::Loaded;
use crate::scene::observers::Frames;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::plausible::Findings;
use crate::scene::record::{Record, FIGURES};
use crate::scene::verification::wall_settings;
use crate::scene::{warnings, Scene};
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use serde_json::{json, Value};
use std::path::Path;

/// The result of a search, which is printed, compared with others and verified.
pub struct Outcome {
    pub text: String,
    pub record: Record,
    pub history: Vec<Epoch>,
    pub first: Shape,
    pub best: Shape,
}

/// Runs the first and the best design again with figures, and writes all results. They run as the scene does: as the
/// `own` problem, if that is not the one that was optimised.
pub fn report<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    (problem, own): (&Problem<R>, Option<&Problem<R>>),
    optimisation: &Optimisation,
) -> anyhow::Result<Outcome> {
    let (config, history, parametrisation) = (&loaded.config, &optimisation.history, &*problem.parametrisation);
    let has_walls = config.scene != Family::Custom;
    let [first, best] = [&history[0], &history[optimisation.best]].map(|epoch| &epoch.variables);
    let designs = [first, best].map(|variables| parametrisation.sampled(variables));
    if has_walls {
        write_walls(folder, config, parametrisation, optimisation)?;
    }
    let with_best = loaded.with(&wall_settings(&designs[1], config))?;
    write_bytes_atomically(&folder.join(files::BEST), with_best.text.as_bytes())?;
    plot_history(folder, problem, optimisation)?;
    let mut running = first;
    let mut both = |problem: &Problem<R>| -> anyhow::Result<[Finished<R>; 2]> {
        running = first;
        let before = simulate_with_frames(config, &folder.join(BEFORE), problem, first)?;
        running = best;
        Ok([before, simulate_with_frames(config, &folder.join(AFTER), problem, best)?])
    };
    let motion = config.method.facts().particles();
    let (found, note) = match own.map(&mut both) {
        None => (both(problem), String::new()),
        Some(Err(error)) if error.is::<RunError>() => {
            let why = shown(&error.to_string());
            (both(problem), format!("\nWARNING: with {motion} particles a run failed ({why}); this is of the others"))
        }
        Some(found) => (found, String::new()),
    };
    let [before, after] = found.map_err(diverged(&problem.model, &problem.start(running)))?;
    let (b, a) = (&before.diagnostics, &after.diagnostics);
    // The time of all sessions of a resumed run.
    let seconds = history.iter().map(|e| e.seconds).sum();
    let has_heat = config.has_heat();
    let records =
        [(b, before.seconds), (a, seconds)].map(|(found, s)| Record::of_design(loaded, found, problem.steps, s));
    // The search's Q differs from that of these particles.
    let has_own = own.is_some() && note.is_empty();
    let mut table = Table::new(["", "before", "after"]);
    let mut row = |name: &str, x: f64, y: f64| {
        table.row([name.to_string(), format!("{x:.6}"), format!("{y:.6}")]);
    };
    let Figure { symbol, quantity, .. } = problem.figure;
    let [first_shown, best_shown] = [0, optimisation.best].map(|epoch| history[epoch].shown());
    row(&format!("{symbol}, {quantity} (window average)"), first_shown, best_shown);
    if has_own {
        row(&format!("the same flow with {motion} particles: Q"), b.q, a.q);
    }
    for (key, name) in &FIGURES {
        if records[1].0.contains_key(*key) && problem.figure.measured_as != Some(key) {
            let [x, y] = records.each_ref().map(|record| record.number(key).unwrap_or(f64::NAN));
            row(name, x, y);
        }
    }
    // Scenes with walls have no variables.
    for (k, variable) in config.variables.iter().enumerate() {
        let name = format!("{} ({} ... {})", variable.number, variable.lower, variable.upper);
        row(&name, designs[0].offsets[k], designs[1].offsets[k]);
    }
    let mut text = table.to_text();
    let mut record = Record::of_search(problem, optimisation, records);
    let mut warnings = record.warnings();
    warnings.extend(warnings::of_measured(config, a));
    let scene = Scene::<R>::from_config(&with_best.config)?;
    warnings.extend(Findings::of(&with_best.config, &scene)?.warnings);
    record.put_warnings(loaded, warnings);
    if has_walls {
        record.put_walls(parametrisation, optimisation);
        record.put("search", config.optimise.search);
    } else {
        let numbers = config.variables.iter().enumerate().map(|(k, variable)| {
            json!({
                "number": variable.number,
                "lower": variable.lower,
                "upper": variable.upper,
                "first": designs[0].offsets[k],
                "best": designs[1].offsets[k],
            })
        });
        record.put("variables", numbers.collect::<Value>());
    }
    if has_own {
        record.put("q_scene_before", b.q);
        record.put("q_scene", a.q);
    }
    text.push_str(&found_text(problem.figure, optimisation, seconds));
    if has_walls {
        text.push_str(&balance_text(a));
    }
    let (pictures, page) = match (has_walls, has_heat) {
        (true, _) => ("history.png, shapes.png, temperature.png, flow.png, shape.csv", " (all of it in a browser)"),
        (false, true) => ("best.toml, history.png, flow.png, temperature.png", ""),
        (false, false) => ("best.toml, history.png, flow.png", ""),
    };
    let surface = if has_walls && parametrisation.across().is_some() { ", wall.vtp" } else { "" };
    text.push_str(&format!(
        "files in {}: summary.json, {pictures}, state.h5, {CHECKPOINT}, particles/particles.pvd (ParaView), \
         report.html{page}{surface}{note}",
        folder.display()
    ));
    let (mut before, mut after) = (before.solver, after.solver);
    let (before, after) = (ParticleFields::of(&mut before)?, ParticleFields::of(&mut after)?);
    after.write(folder, &loaded.config, &loaded.text)?;
    let panels = [("before", &before), ("after", &after)];
    if has_walls {
        files::plot_temperature(folder, config, &panels)?;
        files::plot_flow(folder, config, &panels)?;
    } else {
        files::plot_flow_and_heat(folder, &panels, config.resolution.dx)?;
    }
    files::write_summary(folder, &record)?;
    warn(&record.warnings());
    let [first, best] = designs;
    Ok(Outcome { text, record, history: history.clone(), first, best })
}

/// Runs a design and writes its ParaView frames to a folder.
fn simulate_with_frames<R: Sweeps>(
    config: &Config,
    folder: &Path,
    problem: &Problem<R>,
    variables: &[f64],
) -> anyhow::Result<Finished<R>> {
    let mut frames = Frames::new(folder, problem.steps, config.output.frames)?;
    let mut observers: Vec<&mut dyn Observer<Sph<R>>> = Vec::new();
    observers.extend(frames.as_mut().map(|it| it as &mut dyn Observer<Sph<R>>));
    simulate(problem, config.run.compute()?, &problem.start(variables), &mut observers)
}

/// Writes `shape.csv` with the best, the first and the last wall, and plots all walls.
fn write_walls(
    folder: &Path,
    config: &Config,
    parametrisation: &dyn Parametrisation,
    optimisation: &Optimisation,
) -> anyhow::Result<()> {
    let walls: Vec<Shape> = optimisation.history.iter().map(|e| parametrisation.sampled(&e.variables)).collect();
    let last = walls.len() - 1;
    let column = |k: usize| walls[k].offsets.as_slice();
    let mut columns =
        vec![(walls[0].column(), column(optimisation.best)), ("first", column(0)), ("last", column(last))];
    let tops: Vec<Vec<f64>> = walls.iter().filter_map(|wall| wall.top.clone()).collect();
    if tops.len() == walls.len() {
        let names = [(TOP, optimisation.best), ("top_first", 0), ("top_last", last)];
        columns.extend(names.map(|(name, k)| (name, tops[k].as_slice())));
    }
    files::write_shape(folder, &walls[0], &columns)?;
    if walls[0].across.is_some() {
        let best = format!("best: epoch {}", optimisation.best + 1);
        files::write_wall(folder, config, parametrisation, &optimisation.history[optimisation.best].variables)?;
        let both = [("first", &walls[0]), (best.as_str(), &walls[optimisation.best])];
        return files::plot_relief(folder, "shapes", config, &both);
    }
    let picture = |name: &str, offsets: &mut dyn Iterator<Item = &Vec<f64>>| {
        let shapes: Vec<(String, Vec<f64>)> =
            offsets.enumerate().map(|(k, offsets)| (format!("epoch {}", k + 1), offsets.clone())).collect();
        wall_shapes(&folder.join(name), &walls[0].nodes, &shapes, Some(optimisation.best), config.design.bound)
    };
    picture("shapes", &mut walls.iter().map(|wall| &wall.offsets))?;
    if !tops.is_empty() {
        picture("shapes-top", &mut tops.iter())?;
    }
    Ok(())
}

fn plot_history<R>(folder: &Path, problem: &Problem<R>, optimisation: &Optimisation) -> anyhow::Result<()> {
    let predicts = optimisation.history.iter().any(|e| e.predicted.is_some());
    let point = |(epoch, e): (usize, &Epoch)| {
        // Values of the surrogate and of the solver are two curves.
        let (q, truth) = match predicts {
            true => (e.predicted.unwrap_or(f64::NAN), e.truth.map_or(f64::NAN, |truth| truth.figure)),
            false => (e.figure, f64::NAN),
        };
        HistoryPoint { epoch: epoch + 1, q, loss: e.loss, gradient_norm: e.gradient_norm, truth }
    };
    let points: Vec<HistoryPoint> = optimisation.history.iter().enumerate().map(point).collect();
    let first = Some(("first design", optimisation.history[0].shown()));
    let symbol = problem.figure.symbol;
    let label = format!("{} {symbol} (scene units)", problem.figure.name);
    history(&folder.join("history"), &points, (symbol, &label), first)?;
    Ok(())
}

/// The gain, its epoch and time, the surrogate's prediction, rejected designs, and whether the optimiser has stopped.
fn found_text(figure: Figure, optimisation: &Optimisation, seconds: f64) -> String {
    let (history, best) = (&optimisation.history, optimisation.best);
    let gain = change(history[0].shown(), history[best].shown());
    let (symbol, epoch, epochs) = (figure.symbol, best + 1, history.len());
    let of = if figure.measured_as.is_some() { String::new() } else { format!(", {},", figure.quantity) };
    let mut text = format!("\n{symbol} {gain}{of} in epoch {epoch} of {epochs}, {seconds:.1} s\n");
    text.push_str(&format!("searched on {}\n", in_words(threads::count())));
    text.push_str(&surrogate_text(figure, optimisation));
    match optimisation.rejected() {
        0 => {}
        1 => text.push_str("1 design was rejected: its run diverged\n"),
        count => text.push_str(&format!("{count} designs were rejected: their runs diverged\n")),
    }
    if optimisation.optimiser.is_done() {
        text.push_str(&format!("{} stopped: no design near by is better\n", optimisation.optimiser.name()));
    }
    text
}

/// Whether the heat from the walls equals the heat that flows out and is stored.
fn balance_text(after: &Diagnostics) -> String {
    let unsteady = after.stored_heat_rate.abs() > 0.005 * after.wall_heat_flux.abs();
    let closes = match after.energy_imbalance.abs() < 0.02 {
        true => "closes",
        false if unsteady => "does not close: the flow is not steady yet, try a longer time.end",
        false => "does not close, though the flow is steady: conduction at the ends of the hot section is not resolved",
    };
    format!("the heat balance {closes} ({:+.2} %)\n", 100.0 * after.energy_imbalance)
}

/// The surrogate's prediction and its confirmation; empty without a surrogate.
fn surrogate_text(figure: Figure, optimisation: &Optimisation) -> String {
    let (history, promised) = (&optimisation.history, optimisation.predicted_best());
    let (first, symbol, epoch) = (history[0].shown(), figure.symbol, promised + 1);
    let Some(after) = history[promised].predicted else { return String::new() };
    let predicted = change(history[0].predicted.unwrap_or(first), after);
    let mut text = format!("the surrogate's best is epoch {epoch}: it predicted {symbol} {predicted}");
    if let Some(truth) = history[promised].truth {
        text.push_str(&format!("; in the solver {}", change(first, truth.figure)));
    }
    if optimisation.best == 0 {
        text.push_str("\nWARNING: no wall that the surrogate proposed is better in the solver than the first");
    }
    let steps = optimisation.solver_steps();
    text + &format!("\n{steps} steps of the solver (a step of an adjoint counts as {ADJOINT})\n")
}
