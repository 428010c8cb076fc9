//! `hydrograd study`: trains over a grid of settings, with a table and plots.

use super::arguments::{at_least_one, threads};
use super::grid::{points, GridKey, GridPoint, PointOutcome, Study, Validation};
use super::machine;
use super::page;
use super::program;
use super::run_folder::{Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use crate::dataset::Metadata;
use crate::error::{BadInput, Error};
use crate::io::csv::{write_table, Cell};
use crate::numerics::interrupt;
use crate::report::page::PAGE;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::surrogate::training::train::METRICS;
use clap::Args;
use serde_json::{json, Map, Value};
use std::path::{Path, PathBuf};

/// Train models over a grid of settings and compare them; finished points are kept.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd study --data data/channel --grid noise=3e-5,3e-4,3e-3 --steps 2000 --out runs/noise
      how much noise is best
  hydrograd study --data data/channel --grid noise=3e-5,3e-4 --grid model.latent=32,64,128 --steps 2000 --out runs/grid
      six models; run it again after a kill, or with more values, and only what is missing is trained
  hydrograd study --data data/channel --grid seed=1,2,3 --set model.rounds=5 --steps 500 --out runs/seeds
      the same training three times, with a setting of all
  hydrograd study --data data/channel --grid seed=1,2,3 --steps 500 --out runs/seeds --shard 0/3
      the first of three shares, perhaps on another machine with the same disk; without --shard the same command then
      makes the table of all (`hydrograd slurm study ...` writes a job array of it)")]
pub struct StudyArguments {
    /// Folder of the data set.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// A key of the training configuration and its values; repeated, every value with every other.
    #[arg(long, value_name = "KEY=VALUE,...", required = true)]
    pub grid: Vec<String>,
    /// A setting of all points, as in `hydrograd train`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Training steps of each point.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub steps: usize,
    /// Folder for the results, one below it for each point.
    #[arg(long, value_name = "DIR", default_value = "runs/study")]
    pub out: PathBuf,
    /// Worker threads of a training, 0 for every core; 1 is best on a busy machine.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads, allow_hyphen_values = true)]
    pub threads: usize,
    #[command(flatten)]
    pub shard: ShardArgument,
}

/// The kind of its folders.
const KIND: &str = "study";

impl StudyArguments {
    /// The grid, its points, and their common settings.
    ///
    /// # Errors
    /// A grid, settings or data that are not allowed.
    pub(super) fn study(&self) -> anyhow::Result<(Vec<GridKey>, Vec<GridPoint>, Study)> {
        let grid = self.grid.iter().map(|text| GridKey::parse(text)).collect::<Result<Vec<_>, _>>()?;
        let points = points(&grid)?;
        if let Err(error) = Metadata::read(&self.data) {
            let place = format!("--data {}", self.data.display());
            return Err(BadInput::new(error.to_string()).place(place).allowed("the folder of a data set").into());
        }
        RunFolder::check(&self.out, KIND, Earlier::Resumed)?;
        let program = program::words()?;
        let Self { data, sets, steps, out, threads, .. } = self.clone();
        let study = Study { program, data, steps, sets, out, threads };
        study.check(&points)?;
        Ok((grid, points, study))
    }
}

pub fn run(arguments: StudyArguments) -> anyhow::Result<()> {
    let (grid, points, study) = arguments.study()?;
    let share = arguments.shard.share()?;
    // Errors are found before hours of training.
    let known = points.iter().map(|point| study.finished(point)).collect::<Result<Vec<_>, _>>()?;
    let kept = known.iter().flatten().count();
    if let Some(shard) = share {
        return train_share(&study, shard, &points, &known);
    }
    // A study does not discard earlier trainings: different ones are an error.
    let own = RunFolder::take(&study.out, KIND, Earlier::Resumed)?;

    interrupt::listen("the same command again: what is trained is kept")?;
    let bar = Progress::new(points.len() as u64, "study");
    let mut outcomes = Vec::new();
    for (point, known) in points.iter().zip(known) {
        bar.message(point.name());
        let outcome = match known {
            Some(outcome) => outcome,
            None => study.train(point)?,
        };
        outcomes.push((point.clone(), outcome));
        // Writes the table after every point, in case the study is interrupted.
        write_csv(&study.out.join("study.csv"), &grid, &outcomes)?;
        bar.done(1);
    }
    bar.finish();
    let pictures = plot(&study.out, &grid, &outcomes)?;
    page::write(&study.out)?;
    let names = ["study.csv", PAGE].into_iter().chain(pictures.iter().map(String::as_str));
    let files = machine::paths_in(&study.out, names);
    machine::answer(&summary(&study, &outcomes, kept, files));
    println!("{}", table(&grid, &outcomes));
    println!("{} points, {kept} of them trained before", outcomes.len());
    println!(
        "files in {}: report.html, study.csv, {}, and a folder per point",
        study.out.display(),
        if pictures.is_empty() { "no plots".into() } else { pictures.join(", ") }
    );
    let failed: Vec<String> = outcomes
        .iter()
        .filter_map(|(point, outcome)| match outcome {
            PointOutcome::Failed(message) => Some(format!("{}: {message}", point.name())),
            PointOutcome::Trained { .. } => None,
        })
        .collect();
    match failed.first() {
        None => own.finish(),
        Some(first) => {
            let problem = format!("{} of {} points failed; the first: {first}", failed.len(), outcomes.len());
            Err(Error::run(problem, "the same command again: only what is missing is trained").into())
        }
    }
}

/// Trains the points of a share. A run without a share makes the table of all.
fn train_share(
    study: &Study,
    shard: Shard,
    points: &[GridPoint],
    known: &[Option<PointOutcome>],
) -> anyhow::Result<()> {
    let _own = RunFolder::share(&study.out, KIND)?;
    interrupt::listen("the same command again: what is trained is kept")?;
    let mine: Vec<usize> = (0..points.len()).filter(|&k| shard.has(k)).collect();
    let bar = Progress::new(mine.len() as u64, "study");
    let mut failed = 0;
    let mut outcomes = Vec::new();
    for &k in &mine {
        let outcome = match &known[k] {
            Some(outcome) => outcome.clone(),
            None => {
                bar.message(points[k].name());
                study.train(&points[k])?
            }
        };
        // The table reports the error, too.
        if let PointOutcome::Failed(message) = &outcome {
            failed += 1;
            bar.log(&format!("{} failed: {message}", points[k].name()));
        }
        outcomes.push((points[k].clone(), outcome));
        bar.done(1);
    }
    bar.finish();
    let kept = mine.iter().filter(|&&k| known[k].is_some()).count();
    let trained = mine.len() - kept - failed;
    machine::answer(&summary(study, &outcomes, kept, json!([])));
    println!("{} of {} points: {trained} trained, {kept} kept from before, {failed} failed", mine.len(), points.len());
    println!("next: the same command without --shard, once all shares are done    makes the table of all points");
    Ok(())
}

/// The answer to `--json` for the points of a study or of a share.
fn summary(study: &Study, outcomes: &[(GridPoint, PointOutcome)], kept: usize, files: Value) -> Value {
    let row = |(point, outcome): &(GridPoint, PointOutcome)| {
        let settings: Map<String, Value> = point.0.iter().map(|(key, value)| (key.clone(), json!(value))).collect();
        let mut row = Map::new();
        row.insert("point".into(), Value::Object(settings));
        row.insert("folder".into(), machine::path(&study.folder(point)));
        match outcome {
            PointOutcome::Trained { seconds, validation } => {
                let best = validation.best("mse_5");
                row.extend(METRICS.map(|metric| (metric.to_string(), json!(validation.last(metric)))));
                row.insert("best_mse_5".into(), json!(best.map(|best| best.0)));
                row.insert("best_step".into(), json!(best.map(|best| best.1)));
                row.insert("seconds".into(), json!(seconds));
                row.insert("error".into(), Value::Null);
            }
            PointOutcome::Failed(message) => drop(row.insert("error".into(), json!(message))),
        }
        Value::Object(row)
    };
    let failed = outcomes.iter().filter(|(_, outcome)| matches!(outcome, PointOutcome::Failed(_))).count();
    json!({
        "folder": machine::path(&study.out),
        "data": machine::path(&study.data),
        "steps": study.steps,
        "kept": kept,
        "trained": outcomes.len() - kept - failed,
        "failed": failed,
        "points": outcomes.iter().map(row).collect::<Vec<_>>(),
        "files": files,
    })
}

fn table(grid: &[GridKey], outcomes: &[(GridPoint, PointOutcome)]) -> Table {
    let names = grid.iter().map(|key| key.key.as_str()).chain(METRICS).chain(["best mse_5", "at step", "seconds"]);
    let mut table = Table::new(names);
    let number = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.3e}"));
    for (point, outcome) in outcomes {
        let mut row: Vec<String> = point.0.iter().map(|(_, value)| value.clone()).collect();
        if let PointOutcome::Trained { seconds, validation } = outcome {
            row.extend(METRICS.map(|metric| number(validation.last(metric))));
            let best = validation.best("mse_5");
            row.push(number(best.map(|best| best.0)));
            row.push(best.map_or("-".into(), |best| best.1.to_string()));
            row.push(format!("{seconds:.0}"));
        } else {
            row.push("failed".into());
        }
        table.row(row);
    }
    table
}

fn write_csv(path: &Path, grid: &[GridKey], outcomes: &[(GridPoint, PointOutcome)]) -> anyhow::Result<()> {
    let header: Vec<&str> =
        grid.iter().map(|key| key.key.as_str()).chain(METRICS).chain(["best_mse_5", "best_step", "seconds"]).collect();
    // An empty cell without a value.
    let cell = |value: Option<f64>| value.map_or(Cell::Text(String::new()), Cell::Number);
    let rows: Vec<Vec<Cell>> = outcomes
        .iter()
        .map(|(point, outcome)| {
            let (validation, seconds) = match outcome {
                PointOutcome::Trained { seconds, validation } => (validation.clone(), Some(*seconds)),
                PointOutcome::Failed(_) => (Validation::default(), None),
            };
            let best = validation.best("mse_5");
            let mut row: Vec<Cell> = point.0.iter().map(|(_, value)| Cell::Text(value.clone())).collect();
            row.extend(METRICS.map(|metric| cell(validation.last(metric))));
            row.extend([cell(best.map(|best| best.0)), cell(best.map(|best| best.1)), cell(seconds)]);
            row
        })
        .collect();
    Ok(write_table(path, &header, &rows)?)
}

/// Two plots for each key: the final error against its values, and the error by step for each value (with the best of
/// the other keys). Returns the names of the plots.
fn plot(folder: &Path, grid: &[GridKey], outcomes: &[(GridPoint, PointOutcome)]) -> anyhow::Result<Vec<String>> {
    let trained: Vec<(&GridPoint, &Validation)> = outcomes
        .iter()
        .filter_map(|(point, outcome)| match outcome {
            PointOutcome::Trained { validation, .. } => Some((point, validation)),
            PointOutcome::Failed(_) => None,
        })
        .collect();
    // The longest horizon that every run has.
    let all_have = |metric: &&str| trained.iter().all(|(_, validation)| validation.last(metric).is_some());
    let Some(metric) = ["mse_20", "mse_10", "mse_5", "mse_1"].into_iter().find(all_have) else { return Ok(vec![]) };
    if trained.is_empty() {
        return Ok(vec![]);
    }
    let mut names = Vec::new();
    for GridKey { key, values } in grid {
        let numbers: Option<Vec<f64>> = values.iter().map(|value| value.parse().ok()).collect();
        if let Some(numbers) = numbers.filter(|numbers| numbers.len() > 1) {
            let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
            let high = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let mut series: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
            for (point, validation) in &trained {
                let others = GridPoint(point.0.iter().filter(|(other, _)| other != key).cloned().collect()).name();
                let others = if others.is_empty() { metric.to_string() } else { others };
                let value = point.value(key).and_then(|value| value.parse().ok());
                let Some(place) = value.zip(validation.last(metric)) else { continue };
                match series.iter_mut().find(|(name, _)| *name == others) {
                    Some((_, points)) => points.push(place),
                    None => series.push((others, vec![place])),
                }
            }
            series.iter_mut().for_each(|(_, points)| points.sort_by(|a, b| a.0.total_cmp(&b.0)));
            let title = format!("Validation {metric} at the end of training");
            let log = low > 0.0 && high >= 5.0 * low;
            compare(&folder.join(format!("final-{key}")), &title, key, metric, &series, log, true)?;
            names.push(format!("final-{key}.png"));
        }
        let best_of = |value: &str| {
            let with = trained.iter().filter(|(point, _)| point.value(key) == Some(value));
            with.filter_map(|(_, validation)| Some((validation.last(metric)?, *validation)))
                .min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let series: Vec<(String, Vec<(f64, f64)>)> = values
            .iter()
            .filter_map(|value| {
                let (_, validation) = best_of(value)?;
                let curve = validation.step.iter().copied().zip(validation.curve(metric).iter().copied());
                Some((format!("{key} = {value}"), curve.collect()))
            })
            .collect();
        let others = if grid.len() > 1 { ", with the best of the other keys" } else { "" };
        let title = format!("Validation {metric} by {key}{others}");
        compare(&folder.join(format!("curves-{key}")), &title, "training step", metric, &series, false, true)?;
        names.push(format!("curves-{key}.png"));
    }
    Ok(names)
}
