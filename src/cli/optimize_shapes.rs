//! What `hydrograd optimize` leaves of a scene of one's own: its shapes at their best.

use super::files;
use super::optimize::{self, Outcome};
use super::prepare::diverged;
use super::simulate_report::warn;
use crate::design::diagnostics::Diagnostics;
use crate::design::optimise::{Epoch, Optimisation};
use crate::design::Problem;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::verification::wall_settings;
use crate::sph::Sweeps;
use serde_json::{json, Value};
use std::path::Path;

/// Runs the first and the best shapes once more and writes everything that is made of them.
pub fn report<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    problem: &Problem<R>,
    optimisation: &Optimisation,
) -> anyhow::Result<Outcome> {
    let (config, history) = (&loaded.config, &optimisation.history);
    optimize::plot_history(folder, problem, optimisation)?;
    let sampled = |epoch: usize| problem.parametrisation.sampled(&history[epoch].variables);
    let (first, best) = (sampled(0), sampled(optimisation.best));
    let found = loaded.with(&wall_settings(&best, config))?;
    files::write_best(folder, &found)?;
    let starts = [0, optimisation.best].map(|epoch| problem.start(&history[epoch].variables));
    let run = |name: &str, epoch: usize| {
        optimize::simulate_with_frames(config, &folder.join(name), problem, &history[epoch].variables)
    };
    let before = run(optimize::BEFORE, 0).map_err(diverged(&problem.model, &starts[0]))?;
    let after = run(optimize::AFTER, optimisation.best).map_err(diverged(&problem.model, &starts[1]))?;
    let seconds = history.iter().map(|epoch| epoch.seconds).sum();
    let summary_of = |found: &Diagnostics, seconds: f64| {
        let mut all = files::summary(loaded, found, problem.steps, seconds);
        if config.initial.temperature.is_none() {
            HEAT.iter().for_each(|key| drop(all.shift_remove(*key)));
        }
        all
    };
    let (b, a) = (&before.diagnostics, &after.diagnostics);
    let mut summary = optimize::summary(problem, optimisation, summary_of(b, before.seconds), summary_of(a, seconds));
    let numbers = config.variables.iter().enumerate().map(|(k, variable)| {
        json!({
            "number": variable.number,
            "lower": variable.lower,
            "upper": variable.upper,
            "first": first.offsets[k],
            "best": best.offsets[k],
        })
    });
    summary.insert("variables".into(), numbers.collect::<Value>());
    let (mut solver_before, mut solver_after) = (before.solver, after.solver);
    let (fields_before, fields_after) = (ParticleFields::of(&mut solver_before), ParticleFields::of(&mut solver_after));
    fields_after.write(folder, loaded)?;
    let panels = [("before", &fields_before), ("after", &fields_after)];
    let dx = config.resolution.dx;
    let speeds = panels.map(|(_, fields)| files::speeds(fields));
    files::plot_scenes(folder, ("flow", "speed |u| (scene units)"), &panels, &speeds, dx)?;
    let warmth = panels.map(|(_, fields)| fields.temperature.clone().unwrap_or_default());
    let has_heat = config.initial.temperature.is_some();
    if has_heat {
        files::plot_scenes(folder, ("temperature", "temperature T (scene units)"), &panels, &warmth, dx)?;
    }
    files::write_summary(folder, summary.clone())?;
    warn(&optimize::warnings(problem, optimisation));
    let mut table = Table::new(["", "before", "after"]);
    let mut row = |name: &str, x: f64, y: f64| {
        table.row([name.to_string(), format!("{x:.6}"), format!("{y:.6}")]);
    };
    let figure = problem.figure;
    let [shown_first, shown_best] = [0, optimisation.best].map(|epoch| history[epoch].shown());
    row(&format!("{}, {} (window average)", figure.symbol, figure.quantity), shown_first, shown_best);
    row("flow rate", b.flow_rate, a.flow_rate);
    if has_heat {
        row("heat outflow", b.q, a.q);
        row("wall heat flux", b.wall_heat_flux, a.wall_heat_flux);
        row("mixed outlet temperature", b.mean_outlet_temperature, a.mean_outlet_temperature);
    }
    row("mean density", b.mean_density, a.mean_density);
    row("fastest particle along x", b.u_max, a.u_max);
    for (k, variable) in config.variables.iter().enumerate() {
        let name = format!("{} ({} ... {})", variable.number, variable.lower, variable.upper);
        row(&name, first.offsets[k], best.offsets[k]);
    }
    let text = table.to_text()
        + &optimize::found_text(figure, optimisation, seconds)
        + &optimize::end_text(optimisation)
        + &format!(
            "files in {}: summary.json, {}, history.png, flow.png{}, state.h5, {}, particles/particles.pvd (ParaView), report.html",
            folder.display(),
            files::BEST,
            if has_heat { ", temperature.png" } else { "" },
            optimize::CHECKPOINT
        );
    let values = optimisation.column(Epoch::shown);
    Ok(Outcome { text, summary, history: history.clone(), values, first, best })
}

/// What a summary has of heat.
const HEAT: [&str; 6] =
    ["q", "q_sum", "mean_outlet_temperature", "wall_heat_flux", "stored_heat_rate", "energy_imbalance"];
