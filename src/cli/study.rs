//! `hydrograd study`: trains over a grid of settings, with a table and plots.

use super::arguments::{at_least_one, threads};
use super::files::or_empty;
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
    /// Worker threads of a training, 0 for every core that the process may use; 1 is best on a busy machine.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads, allow_hyphen_values = true)]
    pub threads: usize,
    #[command(flatten)]
    pub shard: ShardArgument,
}

const KIND: &str = "study";

impl StudyArguments {
    /// The grid, its points, and their common settings.
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
    let mut known = points.iter().map(|point| study.finished(point)).collect::<Result<Vec<_>, _>>()?;
    // A study does not discard earlier trainings: different ones are an error.
    let own = RunFolder::for_work(share, &study.out, KIND, Earlier::Resumed)?;
    interrupt::listen("the same command again: what is trained is kept")?;
    let shard = share.unwrap_or(Shard::ALL);
    let mine: Vec<usize> = (0..points.len()).filter(|&k| shard.has(k)).collect();
    let kept = mine.iter().filter(|&&k| known[k].is_some()).count();
    let bar = Progress::new(mine.len() as u64, "study");
    let (mut outcomes, mut failed) = (Vec::new(), Vec::new());
    for k in mine {
        let point = &points[k];
        bar.message(point.name());
        let outcome = match known[k].take() {
            Some(outcome) => outcome,
            None => study.train(point)?,
        };
        if let PointOutcome::Failed(message) = &outcome {
            failed.push(format!("{}: {message}", point.name()));
            if share.is_some() {
                bar.log(&format!("{} failed: {message}", point.name()));
            }
        }
        outcomes.push((point.clone(), outcome));
        if share.is_none() {
            // The table is written after every point, in case the study is interrupted.
            write_csv(&study.out.join("study.csv"), &grid, &outcomes)?;
        }
        bar.done(1);
    }
    bar.finish();
    let (count, trained) = (outcomes.len(), outcomes.len() - kept - failed.len());
    let answer = |files: Value| {
        json!({
            "folder": machine::path(&study.out),
            "data": machine::path(&study.data),
            "steps": study.steps,
            "kept": kept,
            "trained": trained,
            "failed": failed.len(),
            "points": outcomes.iter().map(|(point, outcome)| row(&study, point, outcome)).collect::<Vec<_>>(),
            "files": files,
        })
    };
    if share.is_some() {
        machine::answer(&answer(json!([])));
        let (all, failed) = (points.len(), failed.len());
        println!("{count} of {all} points: {trained} trained, {kept} kept from before, {failed} failed");
        println!("next: the same command without --shard, once all shares are done    makes the table of all points");
        return Ok(());
    }
    let pictures = plot(&study.out, &grid, &outcomes)?;
    page::write(&study.out)?;
    let names = ["study.csv", PAGE].into_iter().chain(pictures.iter().map(String::as_str));
    machine::answer(&answer(machine::paths_in(&study.out, names)));
    println!("{}", table(&grid, &outcomes));
    println!("{count} points, {kept} of them trained before");
    println!(
        "files in {}: report.html, study.csv, {}, and a folder per point",
        study.out.display(),
        if pictures.is_empty() { "no plots".into() } else { pictures.join(", ") }
    );
    match failed.first() {
        None => own.finish(),
        Some(first) => {
            let problem = format!("{} of {count} points failed; the first: {first}", failed.len());
            Err(Error::run(problem, "the same command again: only what is missing is trained").into())
        }
    }
}

/// Names of the figures of a training after its metrics.
const BEST: [&str; 3] = ["best_mse_5", "best_step", "seconds"];

/// The last value of each metric, and the figures of [`BEST`]; none of a training that failed.
fn figures(outcome: &PointOutcome) -> Option<Vec<Option<f64>>> {
    let PointOutcome::Trained { seconds, validation } = outcome else { return None };
    let (error, step) = validation.best("mse_5").unzip();
    let last = METRICS.iter().map(|metric| validation.last(metric));
    Some(last.chain([error, step, Some(*seconds)]).collect())
}

/// A point in the answer to `--json`.
fn row(study: &Study, point: &GridPoint, outcome: &PointOutcome) -> Value {
    let settings: Map<String, Value> = point.0.iter().map(|(key, value)| (key.clone(), json!(value))).collect();
    let mut row = Map::new();
    row.insert("point".into(), Value::Object(settings));
    row.insert("folder".into(), machine::path(&study.folder(point)));
    let names = METRICS.iter().chain(&BEST).map(|name| name.to_string());
    row.extend(names.zip(figures(outcome).into_iter().flatten().map(|value| json!(value))));
    let error = match outcome {
        PointOutcome::Failed(message) => Some(message),
        PointOutcome::Trained { .. } => None,
    };
    row.insert("error".into(), json!(error));
    Value::Object(row)
}

fn table(grid: &[GridKey], outcomes: &[(GridPoint, PointOutcome)]) -> Table {
    let names = grid.iter().map(|key| key.key.as_str()).chain(METRICS).chain(["best mse_5", "at step", "seconds"]);
    let mut table = Table::new(names);
    let (step, seconds) = (METRICS.len() + 1, METRICS.len() + 2);
    let shown = |(k, value): (usize, Option<f64>)| match value {
        None => "-".to_string(),
        Some(value) if k == step => value.to_string(),
        Some(value) if k == seconds => format!("{value:.0}"),
        Some(value) => format!("{value:.3e}"),
    };
    for (point, outcome) in outcomes {
        let figures = match figures(outcome) {
            Some(figures) => figures.into_iter().enumerate().map(shown).collect(),
            None => vec!["failed".to_string()],
        };
        table.row(point.0.iter().map(|(_, value)| value.clone()).chain(figures));
    }
    table
}

fn write_csv(path: &Path, grid: &[GridKey], outcomes: &[(GridPoint, PointOutcome)]) -> anyhow::Result<()> {
    let header: Vec<&str> = grid.iter().map(|key| key.key.as_str()).chain(METRICS).chain(BEST).collect();
    let row = |(point, outcome): &(GridPoint, PointOutcome)| {
        let values = point.0.iter().map(|(_, value)| Cell::from(value.as_str()));
        let figures = figures(outcome).unwrap_or_else(|| vec![None; METRICS.len() + BEST.len()]);
        values.chain(figures.into_iter().map(or_empty)).collect()
    };
    Ok(write_table(path, &header, &outcomes.iter().map(row).collect::<Vec<_>>())?)
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
