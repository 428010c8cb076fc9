//! `hydrograd stress`: maps of the solver's stability.

use super::arguments::set_option;
use super::files::{or_empty, write_json, VERSION};
use super::machine;
use super::page;
use super::prepare::{share_out, use_threads, workers};
use super::run_folder::{Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use crate::error::{BadInput, Error};
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use crate::io::csv::{write_table, Cell};
use crate::numerics::interrupt;
use crate::report::plots::{stability, StabilityAxes, StabilityPanel};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::validation::stress::{maps, Fault, Found, Job, Map, Panel, Record, Verdict};
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Map where the solver holds: stable, degraded or diverged over step, noise, walls, resolution, viscosity and heat.
///
/// Each map varies two things of a scene, in every formulation that it has, in double and in single precision. A run is
/// stable; degraded, if it gets to its end but its density, speed, energy or heat balance is off; or diverged.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Every finished run is kept in DIR/runs, so that a map that was stopped goes on with --resume.

Examples:
  hydrograd stress --quick
      a few runs of every map: a minute on two cores
  hydrograd stress taylor-green --filter step --out runs/stress-step
      the largest stable CFL number of the vortices, over the noise of their start
  hydrograd stress heated-channel --set method.integrator=verlet --out runs/stress-verlet
      the same maps with something changed in every run
  hydrograd stress --resume
      go on with runs/stress after a kill
  hydrograd stress --out runs/stress --shard 0/4
      the first of four shares, perhaps on another machine with the same disk; in a Slurm job array
      (sbatch --array=0-3) --shard follows from the array; `hydrograd stress --resume` then draws all
  hydrograd stress --list
      what there is")]
pub struct StressArguments {
    /// Scenes [default: heated-channel, taylor-green, lid-driven-cavity, dam-break, taylor-green-3d, heated-channel-3d].
    #[arg(value_name = "SCENE")]
    pub scenes: Vec<String>,
    /// Only maps with this in their name.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    pub filter: String,
    /// Few values, coarse and short runs.
    #[arg(long)]
    pub quick: bool,
    /// Override a key in every run; what a map varies wins over it; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Print the maps and run none.
    #[arg(long)]
    pub list: bool,
    /// Keep the runs that are in the folder already.
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub shard: ShardArgument,
    /// Folder for stress.json, stress.csv, the maps, and runs/ with a file per run.
    #[arg(long, value_name = "DIR", default_value = "runs/stress")]
    pub out: PathBuf,
    /// Runs at a time, each on one thread; 0 for every core that the process may use.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
}

impl StressArguments {
    /// All runs with the numbers of their maps. An error in one is found before the first one runs.
    pub(super) fn jobs(&self, maps: &[Map]) -> Result<Vec<(usize, Job)>, Error> {
        let of = |(k, map)| Job::of(map, self.quick, &self.sets).into_iter().map(move |job| (k, job));
        let jobs: Vec<(usize, Job)> = maps.iter().enumerate().flat_map(of).collect();
        for (_, job) in &jobs {
            job.load().map_err(|error| match error {
                Error::Input(bad) => bad.located(|_| self.sets.first().map(|set| set_option(set).label)).into(),
                other => other.of(&job.name),
            })?;
        }
        Ok(jobs)
    }

    pub(super) fn maps(&self) -> Result<Vec<Map>, BadInput> {
        let mut maps = maps::all();
        let mut scenes: Vec<&str> = maps.iter().map(|map| map.scene).collect();
        scenes.dedup();
        if let Some(unknown) = self.scenes.iter().find(|scene| !scenes.contains(&scene.as_str())) {
            return Err(BadInput::new(format!("there are no maps of `{unknown}`")).allowed(scenes.join(", ")));
        }
        let names: Vec<String> = maps.iter().map(Map::id).collect();
        maps.retain(|map| self.scenes.is_empty() || self.scenes.iter().any(|scene| scene == map.scene));
        maps.retain(|map| map.id().contains(&self.filter));
        match maps.is_empty() {
            false => Ok(maps),
            true => Err(BadInput::new("no map has a name with this in it")
                .place(format!("--filter {}", self.filter))
                .allowed(names.join(", "))),
        }
    }
}

const KIND: &str = "stress";

pub fn run(arguments: StressArguments) -> anyhow::Result<()> {
    let maps = arguments.maps()?;
    if arguments.list {
        let list = list(&maps, arguments.quick);
        machine::answer(&list.to_json());
        println!("{}", list.to_text());
        return Ok(());
    }
    let (share, out) = (arguments.shard.share()?, &arguments.out);
    RunFolder::check(out, KIND, Earlier::Resumed)?;
    let runs = out.join("runs");
    if runs.exists() && !arguments.resume && share.is_none() {
        return Err(BadInput::new(format!("{} holds runs already", out.display()))
            .place(format!("--out {}", out.display()))
            .allowed("a new folder, or --resume, which keeps them")
            .advice("--resume, or another --out")
            .into());
    }
    let jobs = arguments.jobs(&maps)?;
    use_threads(1);
    let own = RunFolder::for_work(share, out, KIND, Earlier::Resumed)?;
    let how = if share.is_some() { "again" } else { "with --resume" };
    interrupt::listen(format!("the same command {how}: finished runs are kept"))?;
    prepare_output_folder(&runs)?;
    let mut records: Vec<Option<Record>> = jobs.iter().map(|(_, job)| kept(&runs, job)).collect();
    let shard = share.unwrap_or(Shard::ALL);
    let todo: Vec<usize> = (0..jobs.len()).filter(|&k| shard.has(k) && records[k].is_none()).collect();
    let bar = Progress::new(todo.len() as u64, "stress");
    let made = share_out(workers(arguments.threads, todo.len()), &todo, |&k| {
        let job = &jobs[k].1;
        let record = job.run()?;
        write_bytes_atomically(&file(&runs, job), (serde_json::to_string_pretty(&record)? + "\n").as_bytes())?;
        bar.message(format!("{} {}", job.name, record.verdict.name()));
        bar.done(1);
        Ok((k, record))
    })?;
    bar.finish();
    for (k, record) in made {
        records[k] = Some(record);
    }
    let of = |k: usize| {
        let runs = jobs.iter().zip(&records).filter(|((map, _), _)| *map == k);
        runs.map(|((_, job), record)| (job.clone(), record.clone())).collect::<Vec<_>>()
    };
    let all: Vec<Found> = maps.iter().enumerate().map(|(k, map)| Found::new(map, &of(k))).collect();
    write(out, &all)?;
    for found in &all {
        draw(out, found)?;
        println!("{}", text_of(found));
    }
    page::write(out)?;
    println!("{}", largest(&all).to_text());
    let (count, done) = (jobs.len(), records.iter().flatten().count());
    let [stable, degraded, diverged] = [Verdict::Stable, Verdict::Degraded, Verdict::Diverged]
        .map(|verdict| records.iter().flatten().filter(|record| record.verdict == verdict).count());
    let kept = done - todo.len();
    println!(
        "{done} of {count} runs: {stable} stable, {degraded} degraded, {diverged} diverged; {kept} kept from before"
    );
    println!("files in {}: stress.json, stress.csv, a picture per map, runs/, report.html", out.display());
    if done < count {
        println!("next: hydrograd stress --resume --out {}    runs what is missing, and draws all", out.display());
        return Ok(());
    }
    println!("next: hydrograd simulate SCENE --set time.cfl=...    with a number that is stable above");
    own.finish()
}

fn file(runs: &Path, job: &Job) -> PathBuf {
    runs.join(format!("{}.json", job.name))
}

/// The stored result of a run with the same settings.
fn kept(runs: &Path, job: &Job) -> Option<Record> {
    let text = std::fs::read_to_string(file(runs, job)).ok()?;
    serde_json::from_str::<Record>(&text).ok().filter(|record| record.settings == job.settings)
}

fn list(maps: &[Map], quick: bool) -> Table {
    let mut table = Table::new(["map", "scene", "across", "up", "formulations", "runs"]);
    for map in maps {
        let runs = Job::of(map, quick, &[]).len().to_string();
        table.row([&map.id(), map.scene, map.x.name, map.y.name, &map.formulations.join(", "), &runs]);
    }
    table
}

/// Indices of the columns of a map; a quick map lacks some.
fn columns_seen(found: &Found) -> Vec<usize> {
    let seen = |x: &usize| found.panels.iter().any(|(_, rows)| rows.iter().any(|row| row[*x].is_some()));
    (0..found.map.x.values.len()).filter(seen).collect()
}

fn rows_seen(found: &Found) -> Vec<usize> {
    let seen = |y: &usize| found.panels.iter().any(|(_, rows)| rows[*y].iter().any(Option::is_some));
    (0..found.map.y.values.len()).filter(seen).collect()
}

fn mark(record: Option<&Record>) -> char {
    record.map_or('.', |record| record.verdict.mark())
}

/// A map as text: a row for each value of y and panel, with the reason for its end.
fn text_of(found: &Found) -> String {
    let map = &found.map;
    let columns = columns_seen(found);
    let values = columns.iter().map(|&x| map.x.values[x].label.clone());
    let mut table =
        Table::new([format!("{} \\ {}", map.y.name, map.x.name), "formulation".into()].into_iter().chain(values));
    for (panel, rows) in &found.panels {
        for y in rows_seen(found) {
            let letters = columns.iter().map(|&x| mark(rows[y][x].as_ref()).to_string());
            let name = format!("{}, {}", panel.formulation, panel.precision.name());
            table.row([map.y.values[y].label.clone(), name].into_iter().chain(letters));
        }
    }
    format!("{}\n{}edge: {}\n", map.id(), table.to_text(), found.edge())
}

/// The largest stable CFL number of each scene.
fn largest(all: &[Found]) -> Table {
    let columns = ["largest stable CFL", "with any jitter", "without divergence", "with any jitter"];
    let mut table = Table::new(["scene", "formulation", "precision"].into_iter().chain(columns));
    for found in all.iter().filter(|found| found.map.name == "step") {
        for (panel, rows) in &found.panels {
            let numbers = [Verdict::Stable, Verdict::Degraded].map(|worst| found.largest(rows, worst));
            let numbers = numbers.into_iter().flatten().map(|number| number.unwrap_or("-"));
            table.row([found.map.scene, panel.formulation, panel.precision.name()].into_iter().chain(numbers));
        }
    }
    table
}

/// A run and its place in a map.
struct Place<'a> {
    map: &'a Map,
    panel: &'a Panel,
    x: &'a str,
    y: &'a str,
    record: &'a Record,
}

impl Place<'_> {
    /// A cell about the fault of a run; empty without one.
    fn fault<'f, T: Into<Cell>>(&'f self, of: impl Fn(&'f Fault) -> Option<T>) -> Cell {
        or_empty(self.record.fault.as_ref().and_then(of))
    }
}

/// The name of a column, and its cell of a run.
type Column = (&'static str, fn(&Place) -> Cell);

/// The columns of `stress.csv`.
const COLUMNS: [Column; 21] = [
    ("scene", |run| run.map.scene.into()),
    ("map", |run| run.map.name.into()),
    ("formulation", |run| run.panel.formulation.into()),
    ("precision", |run| run.panel.precision.name().into()),
    ("x", |run| run.map.x.name.into()),
    ("x_value", |run| run.x.into()),
    ("y", |run| run.map.y.name.into()),
    ("y_value", |run| run.y.into()),
    ("verdict", |run| run.record.verdict.name().into()),
    ("quantity", |run| run.fault(|fault| Some(fault.quantity.as_str()))),
    ("value", |run| run.fault(|fault| Some(fault.value))),
    ("limit", |run| run.fault(|fault| fault.limit)),
    ("step", |run| run.fault(|fault| Some(fault.step))),
    ("time", |run| run.fault(|fault| Some(fault.time))),
    ("particle", |run| run.fault(|fault| fault.particle)),
    ("cause", |run| run.fault(|fault| fault.cause.as_deref())),
    ("courant_number", |run| run.record.courant_number.into()),
    ("diffusion_number", |run| run.record.diffusion_number.into()),
    ("cell_reynolds_number", |run| run.record.cell_reynolds_number.into()),
    ("time_step", |run| run.record.time_step.into()),
    ("seconds", |run| run.record.seconds.into()),
];

/// Writes `stress.json` and `stress.csv`.
fn write(folder: &Path, all: &[Found]) -> anyhow::Result<()> {
    let (mut maps, mut rows) = (Vec::new(), Vec::new());
    for found in all {
        let map = &found.map;
        let mut runs = Vec::new();
        for (panel, cells) in &found.panels {
            for (y, row) in cells.iter().enumerate() {
                for (x, record) in row.iter().enumerate().filter_map(|(x, cell)| Some((x, cell.as_ref()?))) {
                    let (x, y) = (&map.x.values[x].label, &map.y.values[y].label);
                    runs.push(json!({ "formulation": panel.formulation, "precision": panel.precision.name(),
                        "x": x, "y": y, "record": record }));
                    let place = Place { map, panel, x, y, record };
                    rows.push(COLUMNS.iter().map(|(_, cell)| cell(&place)).collect::<Vec<_>>());
                }
            }
        }
        let largest = found.panels.iter().map(|(panel, rows)| {
            let ([stable, stable_anywhere], [ran, ran_anywhere]) =
                (found.largest(rows, Verdict::Stable), found.largest(rows, Verdict::Degraded));
            json!({ "formulation": panel.formulation, "precision": panel.precision.name(), "stable": stable,
                "stable_anywhere": stable_anywhere, "not_diverged": ran, "not_diverged_anywhere": ran_anywhere })
        });
        maps.push(json!({ "scene": map.scene, "map": map.name, "x": map.x.name, "y": map.y.name,
            "edge": found.edge(), "largest": largest.collect::<Vec<_>>(), "runs": runs }));
    }
    write_table(&folder.join("stress.csv"), &COLUMNS.map(|(name, _)| name), &rows)?;
    write_json(&folder.join("stress.json"), &json!({ "version": VERSION, "maps": maps }))
}

fn draw(folder: &Path, found: &Found) -> anyhow::Result<()> {
    let map = &found.map;
    let (columns, rows) = (columns_seen(found), rows_seen(found));
    if columns.is_empty() {
        return Ok(());
    }
    let panel = |(panel, cells): &(Panel, Vec<Vec<Option<Record>>>)| StabilityPanel {
        title: format!("{}, {}", panel.formulation, panel.precision.name()),
        cells: rows.iter().map(|&y| columns.iter().map(|&x| mark(cells[y][x].as_ref())).collect()).collect(),
    };
    let panels: Vec<StabilityPanel> = found.panels.iter().map(panel).collect();
    let x: Vec<String> = columns.iter().map(|&x| map.x.values[x].label.clone()).collect();
    let y: Vec<String> = rows.iter().map(|&y| map.y.values[y].label.clone()).collect();
    let title = format!("{}: {} and {}", map.scene, map.x.name, map.y.name);
    stability(&folder.join(map.id()), &title, &panels, 2, &StabilityAxes { x: (map.x.name, &x), y: (map.y.name, &y) })?;
    Ok(())
}
