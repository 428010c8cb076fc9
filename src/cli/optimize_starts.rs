//! `hydrograd optimize --start all`: searches from several initial shapes, at once or in shares, and their comparison.

use super::arguments::name_of;
use super::optimize_report::Outcome;
use super::optimize_search::{one, Begin, FREE};
use super::prepare::{difference, share_out, threads_of, workers};
use super::run_folder::{Earlier, RunFolder};
use super::shard::Shard;
use super::{files, machine, verify};
use crate::config::layers::Setting;
use crate::config::scene::Config;
use crate::design::objectives::Figure;
use crate::design::optimise::Epoch;
use crate::design::shape::Shape;
use crate::error::{BadInput, Error};
use crate::numerics::ranks::Ranks;
use crate::report::plots::compare;
use crate::report::progress::Tasks;
use crate::report::table::Table;
use crate::scene::load::{check_shape, Loaded};
use crate::scene::record::Record;
use crate::scene::verification::Verification;
use clap::ValueEnum;
use serde_json::json;
use std::path::Path;

/// The kind of the folder of all starts.
pub const STARTS: &str = "optimize --start all";

/// Start shapes of `optimize`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StartName {
    Flat,
    Random,
    Linear,
    Sine,
    /// Each of the others in turn.
    All,
}

impl StartName {
    /// The shapes that `--start all` compares.
    pub const EACH: [Self; 4] = [Self::Flat, Self::Random, Self::Linear, Self::Sine];

    /// The setting that selects this shape; none for `all`.
    pub fn setting(self) -> Option<Setting> {
        (self != Self::All).then(|| Setting::option("--start", "design.shape", name_of(self)))
    }
}

/// All starts by name. Errors in one are found before the first search.
fn starts(loaded: &Loaded) -> anyhow::Result<Vec<(String, Loaded)>> {
    let of = |start: StartName| {
        let loaded = loaded.with(start.setting().as_slice())?;
        check_shape(&loaded.config)?;
        Ok((format!("{start:?}").to_lowercase(), loaded))
    };
    StartName::EACH.into_iter().map(of).collect()
}

/// Returns an error if the shares in a folder have other settings.
pub fn check_begun(folder: &Path, loaded: &Loaded) -> Result<(), Error> {
    if !folder.join("config.toml").is_file() {
        return Ok(());
    }
    match difference(&files::read_config(folder)?.config, &loaded.config, &FREE) {
        None => Ok(()),
        Some(what) => Err(BadInput::new(format!("the folder was begun with {what}"))
            .place(format!("--out {}", folder.display()))
            .allowed("the same scene and settings for all shares")
            .advice("another --out, or remove the folder")
            .into()),
    }
}

/// Runs the starts of a share in the common folder.
fn search_share(
    loaded: &Loaded,
    folder: &Path,
    shard: Shard,
    threads: usize,
) -> anyhow::Result<Vec<(String, Outcome)>> {
    let runs = starts(loaded)?;
    let _own = RunFolder::share(folder, STARTS)?;
    files::write_config(folder, loaded)?;
    let mine: Vec<&(String, Loaded)> = shard.of(&runs).collect();
    let tasks = Tasks::default();
    let outcomes = share_out(workers(threads, mine.len()), &mine, |(name, loaded)| {
        let folder = folder.join(name);
        one(loaded, Begin::part(&folder, Earlier::Resumed, name, &tasks))
    })?;
    Ok(mine.iter().zip(outcomes).map(|((name, _), (_, outcome))| (name.clone(), outcome)).collect())
}

/// Runs the starts of this one of several ranks, when all of them do so. The first one then compares all starts.
pub fn starts_of_rank(loaded: &Loaded, folder: &Path, ranks: &Ranks) -> anyhow::Result<()> {
    ranks.wait();
    let threads = threads_of(ranks, loaded.config.run.threads);
    let shard = Shard { index: ranks.rank(), count: ranks.size() };
    let searched = search_share(loaded, folder, shard, threads);
    // Also where this one was stopped: the others wait here.
    ranks.wait();
    searched.map(drop)
}

/// Runs the starts of a share in the common folder. A run without a share compares them.
pub fn share_of_starts(loaded: &Loaded, folder: &Path, shard: Shard) -> anyhow::Result<()> {
    let found = search_share(loaded, folder, shard, loaded.config.run.threads)?;
    // The same answer as for all starts without a share.
    machine::answer(&found.iter().map(|(name, outcome)| (name.clone(), json!(outcome.record))).collect());
    for (_, outcome) in &found {
        println!("{}", outcome.text);
    }
    println!("{} of {} starts", found.len(), StartName::EACH.len());
    println!("next: hydrograd {STARTS} --resume {}    once all shares are done, compares all starts", folder.display());
    Ok(())
}

/// Runs every start in its own folder and compares them, then checks the best one if `verifies` is set.
pub fn every_start(loaded: &Loaded, folder: &Path, earlier: Earlier, verifies: bool) -> anyhow::Result<Vec<RunFolder>> {
    files::write_config(folder, loaded)?;
    let figure = Figure::of_config(&loaded.config);
    let (before, after) = (format!("{} before", figure.symbol), format!("{} best", figure.symbol));
    let mut table = Table::new(["start", &before, &after, "gain", "epoch", "seconds"]);
    let (mut curves, mut walls) = (vec![], vec![]);
    let mut all = Record::default();
    let mut best_of_all: Option<(f64, String, Loaded, Shape)> = None;
    let mut least = (f64::INFINITY, String::new());
    let runs = starts(loaded)?;
    let (tasks, threads) = (Tasks::default(), loaded.config.run.threads);
    // They run at once; the results of each do not depend on the others.
    let outcomes = share_out(workers(threads, runs.len()), &runs, |(name, loaded)| {
        let folder = folder.join(name);
        one(loaded, Begin::part(&folder, earlier, name, &tasks))
    })?;
    let mut owned = Vec::new();
    for ((name, loaded), (own, outcome)) in runs.into_iter().zip(outcomes) {
        owned.push(own);
        let seconds = outcome.record.number("wall_seconds").unwrap_or(0.0);
        let best = outcome.record.number("best_epoch").unwrap_or(0.0) as usize;
        let values: Vec<f64> = outcome.history.iter().map(Epoch::shown).collect();
        if outcome.history[best].loss < least.0 {
            least = (outcome.history[best].loss, name.clone());
        }
        walls.push((format!("from {name}"), outcome.best.clone()));
        if best_of_all.as_ref().is_none_or(|(value, ..)| values[best] > *value) {
            best_of_all = Some((values[best], name.clone(), loaded, outcome.best));
        }
        table.row([
            name.clone(),
            format!("{:.6}", values[0]),
            format!("{:.6}", values[best]),
            format!("{:+.2} %", 100.0 * (values[best] / values[0] - 1.0)),
            (best + 1).to_string(),
            format!("{seconds:.1}"),
        ]);
        curves.push((name.clone(), values.iter().enumerate().map(|(k, &q)| ((k + 1) as f64, q)).collect()));
        all.put(&name, outcome.record);
    }
    let title = capitalised(&format!("{} by start shape", figure.quantity));
    let label = format!("{} ({})", figure.symbol, figure.unit);
    compare(&folder.join("starts"), &title, "epoch", &label, &curves, false, false)?;
    let chosen = curves.iter().position(|(name, _)| best_of_all.as_ref().is_some_and(|(_, best, ..)| best == name));
    plot_walls(folder, &loaded.config, &walls, chosen)?;
    files::write_summary(folder, &all)?;
    println!("{}", table.to_text());
    if let Some((value, name, ..)) = &best_of_all {
        let (loss, other) = &least;
        println!("best {}: {value:.6}, began {name}; least loss: {loss:+.6}, began {other}", figure.symbol);
    }
    println!("files in {}: report.html, starts.png, walls.png, summary.json, and a folder per start", folder.display());
    if let Some((_, name, loaded, best)) = best_of_all.filter(|_| verifies) {
        all.put("verified_start", name);
        verify::of_search(folder, all, &Verification::of_search(&loaded, None, best)?)?;
    }
    Ok(owned)
}

/// Plots `walls.png`, and `walls-top.png` for shaped top walls: walls of several runs, with the chosen one highlighted.
fn plot_walls(folder: &Path, config: &Config, walls: &[(String, Shape)], chosen: Option<usize>) -> anyhow::Result<()> {
    if walls.iter().all(|(_, wall)| wall.across.is_some()) {
        let walls: Vec<(&str, &Shape)> = walls.iter().map(|(name, wall)| (name.as_str(), wall)).collect();
        return files::plot_relief(folder, "walls", config, &walls);
    }
    let nodes = &walls[0].1.nodes;
    // Uses the same colours as the plot of the searches.
    let plot = |name: &str, offsets: fn(&Shape) -> Option<&Vec<f64>>| -> anyhow::Result<()> {
        let walls = walls.iter().filter_map(|(name, wall)| Some((name, offsets(wall)?)));
        let series = walls.enumerate().map(|(k, (from, offsets))| {
            let best = if chosen == Some(k) { " (the best)" } else { "" };
            (format!("{from}{best}"), nodes.iter().copied().zip(offsets.iter().copied()).collect())
        });
        let series: Vec<(String, Vec<(f64, f64)>)> = series.collect();
        if !series.is_empty() {
            let (x, y) = ("x (scene units)", "wall offset (scene units)");
            compare(&folder.join(name), "Best walls", x, y, &series, false, false)?;
        }
        Ok(())
    };
    plot("walls", |wall| Some(&wall.offsets))?;
    plot("walls-top", |wall| wall.top.as_ref())
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
