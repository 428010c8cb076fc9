//! `hydrograd validate`: runs every scene with a known solution and compares it.

use super::arguments::threads;
use super::files::{write_json, VERSION};
use super::machine;
use super::page;
use super::prepare::{share_out, use_threads, workers};
use super::run_folder::{Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use crate::error::{BadInput, Error};
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use crate::io::csv::{write_table, Cell};
use crate::numerics::interrupt;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::validation::cases::{self, Case, Level};
use crate::validation::{Curve, Row, Validated};
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Run every scene with a known answer and compare: error, order, tolerance, pass or fail.
///
/// Each case is run at its resolutions in double and in single precision, against an exact solution or an independent
/// reference that comes with the program (data/reference).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd validate --quick
      coarse resolutions only: under two minutes
  hydrograd validate --filter taylor-green --out runs/taylor-green
      all cases whose name has `taylor-green` in it, at every resolution
  hydrograd validate --resume
      go on with runs/validate after a kill
  hydrograd validate --out runs/validate --shard 0/4
      the first of four shares, perhaps on another machine with the same disk; `hydrograd validate --resume` then
      judges all (`hydrograd slurm validate` writes a job array of it)
  hydrograd validate --list
      what there is")]
pub struct ValidateArguments {
    /// Only resolutions that take little time.
    #[arg(long)]
    pub quick: bool,
    /// Only cases with this in their name.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    pub filter: String,
    /// Print the cases and what they are compared with, and run none.
    #[arg(long)]
    pub list: bool,
    /// Keep the cases that are in the folder already.
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub shard: ShardArgument,
    /// Folder for validation.csv, validation.json, the pictures, and cases/ with a file per case.
    #[arg(long, value_name = "DIR", default_value = "runs/validate")]
    pub out: PathBuf,
    /// Cases at a time, each on one thread; 0 for every core that the process may use.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads, allow_hyphen_values = true)]
    pub threads: usize,
}

/// Parts of a case in the progress bar.
const PARTS: f64 = 100.0;
const KIND: &str = "validate";

impl ValidateArguments {
    pub(super) fn cases(&self) -> Result<Vec<Case>, BadInput> {
        let mut chosen = cases::all();
        let names: Vec<&str> = chosen.iter().map(|case| case.name).collect();
        chosen.retain(|case| case.name.contains(&self.filter));
        if self.quick {
            chosen.retain(|case| case.levels.iter().any(|level| level.is_quick));
        }
        match chosen.is_empty() {
            false => Ok(chosen),
            true => Err(BadInput::new("no case has a name with this in it")
                .place(format!("--filter {}", self.filter))
                .allowed(names.join(", "))),
        }
    }
}

/// The stored result of a case, for `--resume` and for merging shares.
#[derive(Serialize, Deserialize)]
struct Kept {
    version: String,
    /// Settings of all of its runs.
    settings: Vec<String>,
    rows: Vec<Row>,
    curves: Vec<Curve>,
}

impl Kept {
    fn path(folder: &Path, case: &Case) -> PathBuf {
        folder.join(format!("{}.json", case.name))
    }

    fn settings(case: &Case, quick: bool) -> Vec<String> {
        let of_level = |level: &Level| {
            let tolerance = format!("tolerance={:?}", level.tolerance);
            level.settings.iter().map(|set| set.to_string()).chain([tolerance]).collect::<Vec<_>>()
        };
        let of_all = case.settings.iter().map(|set| set.to_string());
        of_all.chain(case.levels_of(quick).flat_map(of_level)).collect()
    }

    /// The stored result of a case, if it is of the same runs.
    fn read(folder: &Path, case: &Case, quick: bool) -> Option<Validated> {
        let text = std::fs::read_to_string(Self::path(folder, case)).ok()?;
        let kept: Self = serde_json::from_str(&text).ok()?;
        let is_same = kept.version == VERSION && kept.settings == Self::settings(case, quick);
        is_same.then(|| Validated { case: case.clone(), rows: kept.rows, curves: kept.curves })
    }

    fn write(folder: &Path, found: &Validated, quick: bool) -> anyhow::Result<()> {
        let Validated { case, rows, curves } = found.clone();
        let kept = Self { version: VERSION.into(), settings: Self::settings(&case, quick), rows, curves };
        let text = serde_json::to_string(&kept)? + "\n";
        Ok(write_bytes_atomically(&Self::path(folder, &case), text.as_bytes())?)
    }
}

pub fn run(arguments: ValidateArguments) -> anyhow::Result<()> {
    let chosen = arguments.cases()?;
    if arguments.list {
        let list = list(&chosen);
        machine::answer(&list.to_json());
        println!("{}", list.to_text());
        return Ok(());
    }
    let share = arguments.shard.share()?;
    let (shard, quick, out) = (share.unwrap_or(Shard::ALL), arguments.quick, &arguments.out);
    let earlier = if arguments.resume { Earlier::Resumed } else { Earlier::Replaced };
    let _own = RunFolder::for_work(share, out, KIND, earlier)?;
    let how = if share.is_some() { "again" } else { "with --resume" };
    interrupt::listen(format!("the same command {how}: finished cases are kept"))?;
    let folder = out.join("cases");
    prepare_output_folder(&folder)?;
    let keeps = share.is_some() || arguments.resume;
    let mut found: Vec<Option<Validated>> =
        chosen.iter().map(|case| Kept::read(&folder, case, quick).filter(|_| keeps)).collect();
    let todo: Vec<usize> = (0..chosen.len()).filter(|&k| shard.has(k) && found[k].is_none()).collect();
    if !keeps {
        // Removes results of an earlier run, so that they do not remain if this one is stopped.
        chosen.iter().for_each(|case| drop(std::fs::remove_file(Kept::path(&folder, case))));
    }
    use_threads(1);
    let bar = Progress::new(todo.len() as u64 * PARTS as u64, "validate");
    let made = share_out(workers(arguments.threads, todo.len()), &todo, |&k| {
        let mut seen = 0;
        let made = chosen[k].run(quick, &mut |part| {
            let now = (part * PARTS) as u64;
            if now > seen {
                bar.done(now - seen);
                seen = now;
            }
        })?;
        bar.done(PARTS as u64 - seen);
        Kept::write(&folder, &made, quick)?;
        Ok((k, made))
    })?;
    bar.finish();
    let kept = found.iter().flatten().count();
    for (k, made) in made {
        found[k] = Some(made);
    }
    let found: Vec<Validated> = found.into_iter().flatten().collect();
    let rows: Vec<&Row> = found.iter().flat_map(|found| &found.rows).collect();
    if keeps {
        println!("{} of {} cases, {kept} kept from before", found.len(), chosen.len());
    }
    if share.is_some() {
        machine::answer(&json!({ "version": VERSION, "rows": rows }));
        // The command that merges the shares reports failures.
        println!("{}", table(&rows).to_text());
        println!(
            "next: the same command with --resume instead of --shard, once all shares are done    judges all cases"
        );
        return Ok(());
    }
    write(out, &rows)?;
    let pictures = draw(out, &found)?;
    page::write(out)?;
    println!("{}", table(&rows).to_text());
    for row in rows.iter().filter(|row| row.failure.is_some()) {
        println!("{}, dx {}: {}", row.case, row.dx, row.failure.as_deref().unwrap_or_default());
    }
    println!("files in {}: validation.csv, validation.json, {}, report.html", out.display(), pictures.join(", "));
    let (all, failed) = (rows.len(), rows.iter().filter(|row| !row.passed).count());
    if let Some(Row { case, dx, .. }) = rows.iter().find(|row| !row.passed) {
        let problem = format!("{failed} of {all} rows FAILED, the first: {case} at dx {dx}");
        let advice = format!("the pictures in {}, and --filter {case} for this case alone", out.display());
        return Err(Error::run(problem, advice).into());
    }
    let all = if all == 1 { "the row".into() } else { format!("all {all} rows") };
    println!("PASSED: {all}, in double and single precision");
    Ok(())
}

fn list(cases: &[Case]) -> Table {
    let mut table = Table::new(["case", "scene", "quantity", "reference", "resolutions (quick)"]);
    for case in cases {
        let quick = case.levels.iter().filter(|level| level.is_quick).count();
        let levels = format!("{} ({quick})", case.levels.len());
        table.row([case.name, case.scene, case.quantity, case.reference, &levels]);
    }
    table
}

fn table(rows: &[&Row]) -> Table {
    let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2e}"));
    let mut table = Table::new(["case", "quantity", "dx", "N", "error", "in f32", "order", "tolerance", "seconds", ""]);
    for row in rows {
        table.row([
            row.case.clone(),
            row.quantity.clone(),
            format!("{:.4}", row.dx),
            row.particles.to_string(),
            number(row.error),
            number(row.error_f32),
            row.order.map_or(String::new(), |order| format!("{order:.1}")),
            format!("{:.1e}", row.tolerance),
            format!("{:.1}", row.seconds),
            if row.passed { "pass" } else { "FAIL" }.into(),
        ]);
    }
    table
}

/// The name of a column, and its cell of a row.
type Column = (&'static str, fn(&Row) -> Cell);

/// The columns of `validation.csv`; NaN without a value.
const COLUMNS: [Column; 13] = [
    ("case", |row| row.case.as_str().into()),
    ("quantity", |row| row.quantity.as_str().into()),
    ("reference", |row| row.reference.as_str().into()),
    ("dx", |row| row.dx.into()),
    ("particles", |row| row.particles.into()),
    ("steps", |row| row.steps.into()),
    ("error", |row| row.error.unwrap_or(f64::NAN).into()),
    ("error_f32", |row| row.error_f32.unwrap_or(f64::NAN).into()),
    ("order", |row| row.order.unwrap_or(f64::NAN).into()),
    ("tolerance", |row| row.tolerance.into()),
    ("seconds", |row| row.seconds.into()),
    ("seconds_f32", |row| row.seconds_f32.into()),
    ("passed", |row| row.passed.to_string().as_str().into()),
];

fn write(folder: &Path, rows: &[&Row]) -> anyhow::Result<()> {
    let cells: Vec<Vec<Cell>> = rows.iter().map(|row| COLUMNS.iter().map(|(_, cell)| cell(row)).collect()).collect();
    write_table(&folder.join("validation.csv"), &COLUMNS.map(|(name, _)| name), &cells)?;
    write_json(&folder.join("validation.json"), &json!({ "version": VERSION, "rows": rows }))
}

/// Plots the curves of each case, and error over spacing; returns the names of the plots.
fn draw(folder: &Path, found: &[Validated]) -> anyhow::Result<Vec<String>> {
    let mut names = Vec::new();
    for one in found.iter().filter(|one| !one.curves.is_empty()) {
        let series: Vec<_> = one.curves.iter().map(|curve| (curve.name.clone(), curve.points.clone())).collect();
        let (x, y) = one.case.measure.axes();
        compare(&folder.join(one.case.name), one.case.name, x, y, &series, false, false)?;
        names.push(format!("{}.png", one.case.name));
    }
    let errors = |one: &Validated| -> Vec<(f64, f64)> {
        one.rows.iter().filter_map(|row| Some((row.dx, row.error.filter(|error| *error > 0.0)?))).collect()
    };
    let series: Vec<_> = found.iter().map(|one| (one.case.name.to_string(), errors(one))).collect();
    if series.iter().any(|(_, points)| !points.is_empty()) {
        compare(&folder.join("errors"), "Errors", "particle spacing (scene units)", "error", &series, true, true)?;
        names.push("errors.png".into());
    }
    Ok(names)
}
