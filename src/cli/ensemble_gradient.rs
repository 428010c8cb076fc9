//! `hydrograd check-gradient` of a gradient that is averaged over an ensemble: each derivative with its error, by the members' own spread.

use super::files::{self, write_json};
use super::page;
use super::prepare::build;
use super::run_folder::{Earlier, RunFolder};
use crate::adjoint::schedule::Schedule;
use crate::config::scene::Precision;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::report::text::counted;
use crate::scene::load::Loaded;
use crate::sph::Sweeps;
use serde_json::json;
use std::path::Path;

/// Computes the gradient at the scene's own design over its own time, prints it and writes it into a folder.
pub fn show(loaded: &Loaded, folder: &Path, kind: &'static str) -> anyhow::Result<()> {
    match loaded.config.run.precision {
        Precision::F32 => of_precision::<f32>(loaded, folder, kind),
        Precision::F64 => of_precision::<f64>(loaded, folder, kind),
    }
}

/// Units of the progress bar.
const UNITS: f64 = 1000.0;

fn of_precision<R: Sweeps>(loaded: &Loaded, folder: &Path, kind: &'static str) -> anyhow::Result<()> {
    let config = &loaded.config;
    let (problem, _) = build::<R>(config)?;
    let own = RunFolder::take(folder, kind, Earlier::Replaced)?;
    let bar = Progress::new(UNITS as u64, kind);
    let mut progress = |share: f64| bar.set_position((UNITS * share) as u64);
    let found = problem.differentiate(&problem.first, &Schedule::taped(problem.steps), &mut progress)?;
    bar.finish();
    files::write_config(folder, loaded)?;
    let (factor, symbol, members) = (problem.figure.factor, problem.figure.symbol, config.optimise.members);
    let mut table = Table::new(["by", "derivative", "standard error"]);
    let (mut gradient, mut errors) = (vec![], vec![]);
    for (k, variable) in config.variables.iter().enumerate() {
        // A variable of the search is the share of the way between the limits of a number.
        let by_number = factor / (variable.upper - variable.lower);
        gradient.push(found.by_variables[k] * by_number);
        errors.push(found.errors[k] * by_number.abs());
        table.row([variable.number.clone(), format!("{:+.4e}", gradient[k]), format!("{:.1e}", errors[k])]);
    }
    let value = found.value * factor;
    let report = json!({
        (symbol.to_lowercase()): value,
        "gradient": gradient,
        "gradient_error": errors,
        "variables": config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>(),
        "members": members,
        "difference": config.optimise.difference,
        "steps": problem.steps,
        "precision": config.run.precision,
    });
    write_json(&folder.join("gradient_check.json"), &report)?;
    page::write(folder)?;
    let differences = counted(2 * gradient.len() + 1, "run");
    println!("{} steps, {symbol} = {value:.6}: the mean over {members} starts, each of {differences}", problem.steps);
    println!("{}", table.to_text());
    println!("the error falls with the root of optimise.members and of objective.window, and with optimise.difference");
    println!("files in {}: gradient_check.json, report.html", folder.display());
    own.finish()
}
