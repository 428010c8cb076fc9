//! `optimize` with fixed particles around shapes: exact gradients of the steady flow, limits, particles placed anew.

use super::around_bodies;
use super::around_in_time::{self, Run};
use super::around_shapes::{self, goal, print_figures};
use super::files::{self, AFTER, BEFORE};
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::warn;
use super::{page, verify};
use crate::design::objectives::Figure;
use crate::design::shape::Shape;
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::write_rows;
use crate::io::vtk::VtkSeries;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::field_map::FieldMap;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::record::{relative_change, Record};
use crate::scene::shape_search::{Epoch, Found, Search, HELD};
use crate::scene::verification::{wall_settings, Verification};
use crate::scene::warnings::Warning;
use serde_json::{json, Value};
use std::cell::Cell;
use std::path::Path;

/// A jump of the objective where particles are placed anew that is worth a warning.
const JUMP: f64 = 0.02;
/// A gradient times the width of the limits is rounding where it is less of the objective.
const UNMOVED: f64 = 1e-12;

/// Searches in a folder. A search that was interrupted is made again: it takes seconds and ends at the same shapes, to the bit.
pub fn run(loaded: &Loaded, folder: &Path, earlier: Earlier, verifies: bool) -> anyhow::Result<()> {
    let config = &loaded.config;
    let mut search = Search::new(config)?;
    let own = RunFolder::take(folder, "optimize", earlier)?;
    files::write_config(folder, loaded)?;
    let name = Figure::key_of(config);
    // Flows in time take so long that the share of a run is shown, too.
    const TICKS: u64 = 100;
    let (bar, done) = (Progress::new(TICKS * config.optimise.epochs as u64, "optimize"), Cell::new(0));
    let mut round = 0;
    let mut watch = |epoch: &Epoch, k: usize| {
        done.set((k + 1) as u64);
        bar.set_position(TICKS * done.get());
        if epoch.round > round {
            round = epoch.round;
            bar.log("particles placed anew around the shapes as they are now");
        }
        let Epoch { objective, gradient_norm, seconds, .. } = epoch;
        bar.message(format!("{name} {objective:.6}"));
        match &epoch.failure {
            Some(why) => bar.log(&format!("epoch {:3}  rejected, the next step is shorter: {why}", k + 1)),
            None => {
                let excess = if epoch.excess > HELD {
                    format!("  limits exceeded by {:.2e}", epoch.excess)
                } else {
                    String::new()
                };
                bar.log(&format!(
                    "epoch {:3}  {name} {objective:.6}  |gradient| {gradient_norm:.3e}{excess}  {seconds:.2} s",
                    k + 1
                ));
            }
        }
    };
    // The gradient takes about as long as two runs.
    let mut progress = |share: f64| bar.set_position(TICKS * done.get() + (share * TICKS as f64 / 3.0) as u64);
    let found = search.run(config.optimise.epochs, &mut watch, &mut progress)?;
    bar.finish();
    let Found { history, best, .. } = &found;
    let shapes = [0, *best].map(|epoch| Shape::of_numbers(history[epoch].variables.clone()));
    let with_best = loaded.with(&wall_settings(&shapes[1], config))?;
    write_bytes_atomically(&folder.join(files::BEST), with_best.text.as_bytes())?;
    write_history(folder, &name, history)?;
    let seconds: f64 = history.iter().map(|epoch| epoch.seconds).sum();
    // Both again, with particles placed around them.
    let mut maps: Vec<FieldMap> = vec![];
    let mut fields: Vec<ParticleFields> = vec![];
    let mut records: Vec<Record> = vec![];
    for (at, frames) in [(loaded, BEFORE), (&with_best, AFTER)] {
        let end = if config.is_around_bodies() && config.unsteady().is_some() {
            let around = AroundBodies::new(&at.config)?;
            let run = Run::take(&around, &mut |_, _| ())?;
            records.push(around_in_time::record(at, &around, &run, seconds));
            if frames == AFTER {
                run.print(config, true);
            }
            run.fields(&around)
        } else if config.is_around_bodies() {
            let mut around = AroundBodies::new(&at.config)?;
            let solution = around.solve(&around.first())?;
            let figures = around.summary(&solution);
            records.push(around_bodies::record(at, &around, &solution, &figures, seconds));
            if frames == AFTER {
                print_figures(config, &figures);
            }
            around.fields(&solution)
        } else if config.unsteady().is_some() {
            let around = AroundShapes::new(&at.config)?;
            let run = Run::take(&around, &mut |_, _| ())?;
            records.push(around_in_time::record(at, &around, &run, seconds));
            if frames == AFTER {
                run.print(config, true);
            }
            maps.push(around.map(&run.last));
            run.fields(&around)
        } else {
            let mut around = AroundShapes::new(&at.config)?;
            let solution = around.solve(&around.first())?;
            let figures = around.summary(&solution);
            records.push(around_shapes::record(at, &around, &solution, &figures, seconds));
            if frames == AFTER {
                print_figures(config, &figures);
            }
            maps.push(around.map(&solution));
            around.fields(&solution)
        };
        let mut series = VtkSeries::new(&folder.join(frames), "particles")?;
        end.with_frame(|frame| series.write(frame))?;
        if frames == AFTER {
            end.write(folder, &at.config, &at.text)?;
        }
        fields.push(end);
    }
    let heat = match maps.as_slice() {
        [before, after] => {
            files::plot_maps(folder, &[("before", before), ("after", after)], config.unsteady().is_some())?
        }
        _ => {
            let panels = [("before", &fields[0]), ("after", &fields[1])];
            files::plot_flow_and_heat(folder, &panels, config.resolution.dx)?
        }
    };
    let (before, mut record) = (records.remove(0), records.remove(0));
    let (first, last) =
        (before.number("objective").unwrap_or(f64::NAN), record.number("objective").unwrap_or(f64::NAN));
    put_search(&mut record, loaded, &found, &name, before);
    files::write_summary(folder, &record)?;
    let mut table = Table::new(["", "before", "after"]);
    table.row([format!("{name} (particles placed around each)"), format!("{first:.6}"), format!("{last:.6}")]);
    for (k, variable) in config.variables.iter().enumerate() {
        let of = |epoch: usize| format!("{:.6}", history[epoch].variables[k]);
        table.row([format!("{} ({} ... {})", variable.number, variable.lower, variable.upper), of(0), of(*best)]);
    }
    println!("{}", table.to_text());
    println!(
        "{name} is to become {}: {:+.2} % in {} epochs and {seconds:.1} s; {}",
        goal(config),
        100.0 * relative_change(first, last),
        history.len(),
        if found.converged { "nothing better is near" } else { "there may be better (--epochs)" }
    );
    println!(
        "files in {}: report.html, summary.json, best.toml, history.png, flow.png{}, state.h5, particles/particles.pvd (ParaView)",
        folder.display(),
        if heat { ", temperature.png" } else { "" }
    );
    println!("next: hydrograd simulate {}    the best shapes with all figures", folder.join(files::BEST).display());
    warn(&record.warnings());
    if verifies && config.unsteady().is_some() {
        println!(
            "next: hydrograd verify {}    the gain at half the spacing and over twice the time: some ten epochs' time",
            folder.display()
        );
    } else if verifies {
        let [first, best] = shapes;
        verify::of_search(
            folder,
            record,
            &Verification { quick: true, ..Verification::of_search(loaded, Some(first), best)? },
        )?;
    }
    page::write(folder)?;
    own.finish()
}

/// Adds what a search has beside the figures of its best design.
fn put_search(record: &mut Record, loaded: &Loaded, found: &Found, name: &str, before: Record) {
    let (config, Found { history, best, jump, converged, .. }) = (&loaded.config, found);
    let column = |of: fn(&Epoch) -> f64| history.iter().map(of).collect::<Vec<f64>>();
    record.put(&format!("{name}_first"), before.number("objective"));
    let value = record.number("objective");
    record.put(name, value);
    record.put(&format!("{name}_per_epoch"), column(|epoch| epoch.objective));
    record.put("gradient_norm_per_epoch", column(|epoch| epoch.gradient_norm));
    record.put("seconds_per_epoch", column(|epoch| epoch.seconds));
    record.put("excess_per_epoch", column(|epoch| epoch.excess));
    record.put("best_epoch", best);
    record.put("rounds", history.last().map_or(0, |epoch| epoch.round + 1));
    record.put("jump", jump);
    record.put("converged", converged);
    let numbers = config.variables.iter().enumerate().map(|(k, variable)| {
        json!({
            "number": variable.number,
            "lower": variable.lower,
            "upper": variable.upper,
            "first": history[0].variables[k],
            "best": history[*best].variables[k],
        })
    });
    record.put("variables", numbers.collect::<Value>());
    let mut warnings = record.warnings();
    let width = config.variables.iter().map(|variable| variable.upper - variable.lower).fold(0.0, f64::max);
    if history[0].gradient_norm * width <= UNMOVED * history[0].objective.abs() {
        warnings.push(Warning::new(
            "no-gradient",
            [history[0].gradient_norm, 0.0],
            "no variable changes the objective: its gradient is 0".into(),
            "an objective that is not held, in a flow that moves, and variables that act on it",
        ));
    } else if *best == 0 && history.len() > 1 {
        warnings.push(Warning::new(
            "no-improvement",
            [0.0, 0.0],
            format!("in {} epochs nothing was found that is better than the first design", history.len()),
            "another start",
        ));
    }
    if let Some(why) = &found.stopped {
        warnings.push(Warning::new(
            "stopped",
            [f64::NAN, f64::NAN],
            format!("the search ended where particles cannot be placed: {}", why.lines().next().unwrap_or_default()),
            "[[limits]] with kind = \"distance\", or narrower limits of the variables",
        ));
    }
    if *jump > JUMP {
        warnings.push(Warning::new(
            "jump",
            [*jump, JUMP],
            format!(
                "where particles were placed anew the objective jumped by {:.1} %: it is not resolved",
                100.0 * jump
            ),
            format!("resolution.dx={}", config.finer_spacing()),
        ));
    }
    record.put("before", before);
    record.put_warnings(loaded, warnings);
}

fn write_history(folder: &Path, name: &str, history: &[Epoch]) -> anyhow::Result<()> {
    let row =
        |(k, e): (usize, &Epoch)| vec![k as f64, e.objective, e.gradient_norm, e.excess, e.seconds, e.round as f64];
    let rows: Vec<Vec<f64>> = history.iter().enumerate().map(row).collect();
    write_rows(&folder.join("history.csv"), &["epoch", name, "gradient_norm", "excess", "seconds", "round"], &rows)?;
    let curve = history.iter().enumerate().filter(|(_, epoch)| epoch.objective.is_finite());
    let curve = curve.map(|(k, epoch)| (k as f64, epoch.objective)).collect();
    compare(&folder.join("history"), "Objective by epoch", "epoch", name, &[(name.to_string(), curve)], false, false)?;
    Ok(())
}
