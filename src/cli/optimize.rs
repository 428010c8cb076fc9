//! `hydrograd optimize`: the main job.

use super::arguments::{
    name_of, option, CommonArguments, ExplainArgument, GradientArguments, OverwriteArgument, ResumeArgument,
};
use super::explain::explain;
use super::prepare::{build, change, difference, diverged, open_device, share_out, use_threads, workers};
use super::run_folder::{earlier, is_finished, is_unfinished, Earlier, RunFolder};
use super::shard::{Shard, ShardArgument};
use super::simulate_report::warn;
use super::verify;
use super::{files, machine, optimize_compare, optimize_shapes, page};
use crate::adjoint::gradient::Progress as Share;
use crate::adjoint::run::Observer;
use crate::adjoint::schedule::Schedule;
use crate::adjoint::RunError;
use crate::config::layers::Setting;
use crate::config::scene::{Config, DynamicsName, Family, Kernels, Precision, Trust};
use crate::design::diagnostics::{simulate, Diagnostics, Finished};
use crate::design::objectives::Figure;
use crate::design::optimise::Epoch;
use crate::design::optimisers::{Optimiser, TrustRegion};
use crate::design::problem::{Evaluation, ADJOINT};
use crate::design::shape::{Shape, TOP};
use crate::design::{checkpoint, optimisers, Optimisation, Parametrisation, Problem};
use crate::error::{BadInput, Error};
use crate::io::csv::write_rows;
use crate::numerics::interrupt;
use crate::report::plots::{compare, history, wall_shapes, HistoryPoint};
use crate::report::progress::{Progress, Tasks};
use crate::report::table::Table;
use crate::report::text::shown;
use crate::scene::checkpoint::open;
use crate::scene::load::{check_shape, Loaded};
use crate::scene::observers::Frames;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::verification::{wall_settings, Verification};
use crate::scene::warnings::{self, Warning};
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use crate::surrogate::design::SurrogateProblem;
use crate::surrogate::models::load::identity;
use crate::surrogate::{load_learned, HEATED_CHANNEL};
use candle_core::DType;
use clap::{Args, ValueEnum};
use serde_json::{json, Map, Value};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};

/// Shape the hot wall so that the fluid carries out more heat (the main job).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd optimize
      the heated channel from a flat wall, in less than a minute on two cores
  hydrograd optimize --start all --out runs/starts
      from four start shapes, compared in one plot
  hydrograd optimize --start all --out runs/starts --shard 0/4
      the first start alone, perhaps on another machine with the same disk; `hydrograd optimize --start all --resume
      runs/starts` then compares all (`hydrograd slurm optimize --start all` writes a job array of it)
  hydrograd optimize --preset report --start random --seed 7
      the original report's settings, from a random wall
  hydrograd optimize --no-verify
      without the checks of the gain that follow (`hydrograd verify` makes them later)
  hydrograd optimize --memory 20MB --explain
      the schedule that fits into 20 MB, with its storage and the steps run again
  hydrograd optimize --dynamics surrogate --trust check=4
      a learned model judges the walls (B-splines then, unless told otherwise), the solver every fourth of them
  hydrograd optimize --dynamics surrogate --trust region --epochs 8
      the solver judges what the corrected model proposes near the best wall so far
  hydrograd optimize --compare --out runs/compared
      solver, surrogate, both, a trust region and CMA-ES: gain, steps of the solver, time, memory, gradients
  hydrograd optimize data/scenes/examples/cylinder.toml
      a scene of your own: the numbers of its shapes that its `variables` name
  hydrograd optimize --resume runs/optimize-heated-channel --epochs 80
      go on with a run, up to 80 epochs in all")]
pub struct OptimizeArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub overwrite: OverwriteArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Start shape (design.shape); `all` runs flat, random, linear and sine, as many at once as there are threads, and compares
    /// them.
    #[arg(long, value_enum)]
    pub start: Option<StartName>,
    /// Optimiser steps (optimise.epochs).
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
    /// Who judges walls while the optimiser searches (optimise.dynamics). What is found is judged by the solver in any case.
    #[arg(long, value_enum)]
    pub dynamics: Option<DynamicsName>,
    /// A surrogate of `hydrograd train` [default: the built-in one, see models/heated-channel] (surrogate.model).
    #[arg(long, value_name = "FILE")]
    pub model: Option<String>,
    /// How the surrogate is kept honest: none; check=N, the solver judges every N-th wall (default 5); region, a trust region, in
    /// which the solver judges what the corrected surrogate proposes in each epoch (surrogate.trust).
    #[arg(long, value_name = "none|check[=N]|region", value_parser = parse_trust)]
    pub trust: Option<(Trust, Option<usize>)>,
    /// Run every way to search (solver, surrogate, checked surrogate, trust region, both, CMA-ES without gradients) and compare them.
    #[arg(long, conflicts_with_all = ["dynamics", "trust", "start"])]
    pub compare: bool,
    /// Do not check the gain at another spacing, with other particles, over a longer time and from another seed.
    #[arg(long)]
    pub no_verify: bool,
    #[command(flatten)]
    pub shard: ShardArgument,
}

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

impl OptimizeArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.require_design()?;
        let mut options = self.gradient.settings();
        options.extend(self.epochs.map(|value| option("optimise.epochs", value)));
        options.extend(self.start.and_then(StartName::setting));
        options.extend(self.dynamics.map(|value| option("optimise.dynamics", name_of(value))));
        options.extend(self.model.as_ref().map(|file| option("surrogate.model", format!("{file:?}"))));
        if let Some((trust, every)) = self.trust {
            options.push(option("surrogate.trust", name_of(trust)));
            options.extend(every.map(|every| Setting::option("--trust", "surrogate.check_every", every)));
        }
        let loaded = self.common.load(self.resume.resume.as_deref(), vec![], options)?;
        if loaded.config.scene == Family::Custom && (self.compare || self.start == Some(StartName::All)) {
            let option = if self.compare { "--compare" } else { "--start all" };
            return Err(BadInput::new(format!("{option} of a scene of one's own, whose shapes begin as they are"))
                .place(option)
                .allowed("a scene with a hot wall: heated-channel")
                .into());
        }
        Ok(loaded)
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "optimize", loaded)
    }

    /// The share of the starts that was asked for; a single search has none, in a job array or not.
    fn share(&self) -> Result<Option<Shard>, BadInput> {
        let bad = |problem: &str, allowed: &str| Err(BadInput::new(problem).place("--shard").allowed(allowed));
        match (self.kind(), self.shard.shard) {
            (STARTS, _) if self.overwrite.overwrite && self.shard.share()?.is_some() => bad(
                "--overwrite of one share would lose those of the others",
                "a new folder, or one that the shares began",
            ),
            (STARTS, _) => self.shard.share(),
            (_, Some(_)) => bad("a single search has no shares", "--start all, whose starts are shared out"),
            (_, None) => Ok(None),
        }
    }

    /// A finished run in the folder that nobody has named stays as it is, and the new one goes to a folder with the next number.
    pub(super) fn free(&self, folder: PathBuf) -> PathBuf {
        if self.common.out.is_some() || self.resume.resume.is_some() || self.overwrite.overwrite {
            return folder;
        }
        let numbered = |k: usize| PathBuf::from(format!("{}-{k}", folder.display()));
        std::iter::once(folder.clone()).chain((2..).map(numbered)).find(|free| !is_finished(free)).unwrap_or(folder)
    }

    /// What its folder is marked with.
    pub(super) fn kind(&self) -> &'static str {
        match self.start {
            _ if self.compare => "optimize --compare",
            Some(StartName::All) => STARTS,
            _ => KIND,
        }
    }
}

/// `none`, `check`, `check=N` or `region`.
fn parse_trust(text: &str) -> Result<(Trust, Option<usize>), String> {
    let (name, every) = match text.split_once('=') {
        Some((name, every)) => (name, Some(every)),
        None => (text, None),
    };
    let every = every.map(|every| every.parse().ok().filter(|every| *every > 0));
    match (name, every) {
        ("none", None) => Ok((Trust::None, None)),
        ("region", None) => Ok((Trust::Region, None)),
        ("check", None) => Ok((Trust::Check, None)),
        ("check", Some(Some(every))) => Ok((Trust::Check, Some(every))),
        _ => Err("allowed: none, check, check=N with a whole number N >= 1, region".into()),
    }
}

/// What the folder of a single run is marked with.
const KIND: &str = "optimize";
/// What that of all starts is marked with.
pub const STARTS: &str = "optimize --start all";
pub const CHECKPOINT: &str = "checkpoint.safetensors";
/// Work units of the progress bar per epoch.
const UNITS: u64 = 1000;

pub fn run(loaded: Loaded, arguments: OptimizeArguments) -> anyhow::Result<()> {
    let share = arguments.share()?;
    let folder = match share {
        // All shares go to the same one.
        Some(_) => arguments.folder(&loaded)?,
        None => arguments.free(arguments.folder(&loaded)?),
    };
    use_threads(loaded.config.run.threads);
    open_device(&loaded)?;
    if arguments.explain.explain {
        return explain(&loaded.for_search()?, true);
    }
    let resume = arguments.resume.resume.as_deref();
    // A share goes on, too, with what it or others began.
    let otherwise = Earlier::of_options(share.is_some(), arguments.overwrite.overwrite);
    let (kind, earlier) = (arguments.kind(), earlier(&folder, resume, otherwise));
    RunFolder::check(&folder, kind, earlier)?;
    let of_share = share.map_or(String::new(), |shard| format!(" --shard {}/{}", shard.index, shard.count));
    interrupt::listen(format!("hydrograd {kind} --resume {}{of_share}", folder.display()))?;
    if kind != KIND {
        if share.is_some() {
            check_begun(&folder, &loaded)?;
        }
        // What all parts have in common is complete, and stays so.
        if earlier == Earlier::Resumed && is_finished(&folder) {
            let epochs = files::read_config(&folder)?.config.optimise.epochs;
            if loaded.config.optimise.epochs <= epochs {
                let option = if share.is_some() { "--shard" } else { "--resume" };
                return Err(has_its_epochs(epochs).place(option).into());
            }
        }
        if let Some(shard) = share {
            return share_of_starts(&loaded, &folder, shard);
        }
        let own = RunFolder::take(&folder, kind, earlier)?;
        // Its parts only when all of it is there: what they have in common is made of each.
        let parts = match arguments.compare {
            true => optimize_compare::run(&loaded, &folder, earlier)?,
            false => every_start(&loaded, &folder, earlier, &arguments)?,
        };
        parts.iter().try_for_each(|part| page::write(part.folder()))?;
        page::write(&folder)?;
        own.finish()?;
        return parts.iter().try_for_each(RunFolder::finish);
    }
    let (own, outcome) = one(&loaded, &folder, Begin { resume, earlier, is_part: false }, "", &Tasks::default())?;
    println!("{}", outcome.text);
    println!(
        "next: hydrograd simulate {} --set resolution.dx={} --out runs/finer    runs the best design at a finer spacing",
        folder.join(files::BEST).display(),
        loaded.config.finer_spacing()
    );
    if !arguments.no_verify {
        let Outcome { first: reference, best, summary, .. } = outcome;
        let verification =
            Verification { loaded: loaded.for_search()?, reference, best, reference_name: verify::FIRST };
        verified(&folder, summary, &verification)?;
    }
    page::write(&folder)?;
    own.finish()
}

/// How a run begins.
#[derive(Clone, Copy)]
pub struct Begin<'a> {
    /// The folder of the run that it goes on with.
    pub resume: Option<&'a Path>,
    pub earlier: Earlier,
    /// One of several, which may have nothing left to do while others have.
    pub is_part: bool,
}

impl<'a> Begin<'a> {
    /// One of several runs, in a folder of its own; where the whole goes on, it goes on if it had begun.
    pub fn part(folder: &'a Path, earlier: Earlier) -> Self {
        let is_begun = folder.join(CHECKPOINT).exists() || is_unfinished(folder, KIND);
        let resume = Some(folder).filter(|_| earlier == Earlier::Resumed && is_begun);
        Self { resume, earlier, is_part: true }
    }
}

/// Checks a gain, says what is left of it, and adds it to `summary.json`.
fn verified(folder: &Path, mut summary: Map<String, Value>, verification: &Verification) -> anyhow::Result<()> {
    let found = verify::verify(verification, "verify")?;
    // Then a check failed for this, and not of itself.
    interrupt::check()?;
    summary.extend(verify::data(&found));
    files::write_summary(folder, summary)?;
    println!("\nverification: both walls again, with one thing changed\n{}", verify::text_of(&found));
    Ok(())
}

/// What `--start all` compares, and what is verified.
pub struct Outcome {
    pub text: String,
    pub summary: Map<String, Value>,
    pub history: Vec<Epoch>,
    /// The objective per epoch, as it is reported.
    pub values: Vec<f64>,
    pub first: Shape,
    pub best: Shape,
}

pub fn one(
    loaded: &Loaded,
    folder: &Path,
    how: Begin<'_>,
    label: &str,
    tasks: &Tasks,
) -> anyhow::Result<(RunFolder, Outcome)> {
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(loaded, folder, how, label, tasks),
        Precision::F64 => go::<f64>(loaded, folder, how, label, tasks),
    }
}

/// Every start, by name. A bad one must not be found out after an hour.
fn starts(loaded: &Loaded) -> anyhow::Result<Vec<(String, Loaded)>> {
    let of = |start: StartName| {
        let setting = start.setting().ok_or_else(|| Error::run("a start without a shape", "report this"))?;
        let loaded = loaded.with(&[setting])?;
        check_shape(&loaded.config)?;
        Ok((format!("{start:?}").to_lowercase(), loaded))
    };
    StartName::EACH.into_iter().map(of).collect()
}

/// An error if the shares of a folder have other settings.
fn check_begun(folder: &Path, loaded: &Loaded) -> Result<(), Error> {
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

/// The starts of a share, in the folder of all: whoever has no share compares them.
fn share_of_starts(loaded: &Loaded, folder: &Path, shard: Shard) -> anyhow::Result<()> {
    let runs = starts(loaded)?;
    let _own = RunFolder::share(folder, STARTS)?;
    files::write_config(folder, loaded)?;
    let mine: Vec<&(String, Loaded)> = shard.of(&runs).collect();
    let tasks = Tasks::default();
    let outcomes = share_out(workers(loaded.config.run.threads, mine.len()), &mine, |(name, loaded)| {
        let folder = folder.join(name);
        one(loaded, &folder, Begin::part(&folder, Earlier::Resumed), name, &tasks)
    })?;
    // Without a share the answer is the same of every start.
    let found = mine.iter().zip(&outcomes).map(|((name, _), (_, outcome))| (name.clone(), json!(outcome.summary)));
    machine::answer(&found.collect());
    for (_, outcome) in &outcomes {
        println!("{}", outcome.text);
    }
    println!("{} of {} starts", mine.len(), runs.len());
    println!("next: hydrograd {STARTS} --resume {}    once all shares are done, compares all starts", folder.display());
    Ok(())
}

fn every_start(
    loaded: &Loaded,
    folder: &Path,
    earlier: Earlier,
    arguments: &OptimizeArguments,
) -> anyhow::Result<Vec<RunFolder>> {
    files::write_config(folder, loaded)?;
    let figure = Figure::of_config(&loaded.config);
    let (before, after) = (format!("{} before", figure.symbol), format!("{} best", figure.symbol));
    let mut table = Table::new(["start", &before, &after, "gain", "epoch", "seconds"]);
    let (mut curves, mut walls) = (vec![], vec![]);
    let mut all = Map::new();
    let mut best_of_all: Option<(f64, String, Loaded, Shape)> = None;
    let mut least = (f64::INFINITY, String::new());
    let runs = starts(loaded)?;
    let (tasks, threads) = (Tasks::default(), loaded.config.run.threads);
    // At once: each run's numbers are those that it has alone.
    let outcomes = share_out(workers(threads, runs.len()), &runs, |(name, loaded)| {
        let folder = folder.join(name);
        one(loaded, &folder, Begin::part(&folder, earlier), name, &tasks)
    })?;
    let mut owned = Vec::new();
    for ((name, loaded), (own, outcome)) in runs.into_iter().zip(outcomes) {
        owned.push(own);
        let seconds = outcome.summary.get("wall_seconds").and_then(Value::as_f64).unwrap_or(0.0);
        let best = outcome.summary.get("best_epoch").and_then(Value::as_u64).unwrap_or(0) as usize;
        let values = outcome.values;
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
        all.insert(name, Value::Object(outcome.summary));
    }
    compare(
        &folder.join("starts"),
        &capitalised(&format!("{} by start shape", figure.quantity)),
        "epoch",
        &format!("{} ({})", figure.symbol, figure.unit),
        &curves,
        false,
        false,
    )?;
    let chosen = curves.iter().position(|(name, _)| best_of_all.as_ref().is_some_and(|(_, best, ..)| best == name));
    plot_walls(folder, &loaded.config, &walls, chosen)?;
    files::write_summary(folder, all.clone())?;
    println!("{}", table.to_text());
    if let Some((value, name, ..)) = &best_of_all {
        let (loss, other) = &least;
        println!("best {}: {value:.6}, began {name}; least loss: {loss:+.6}, began {other}", figure.symbol);
    }
    println!("files in {}: report.html, starts.png, walls.png, summary.json, and a folder per start", folder.display());
    if let Some((_, name, loaded, best)) = best_of_all.filter(|_| !arguments.no_verify) {
        all.insert("verified_start".into(), json!(name));
        let reference = best.flat();
        let verification = Verification { loaded: loaded.for_search()?, reference, best, reference_name: verify::FLAT };
        verified(folder, all, &verification)?;
    }
    Ok(owned)
}

/// `walls.png`, and `walls-top.png` where the top wall is shaped too: walls of several runs, the chosen one highlighted.
fn plot_walls(folder: &Path, config: &Config, walls: &[(String, Shape)], chosen: Option<usize>) -> anyhow::Result<()> {
    if walls.iter().all(|(_, wall)| wall.across.is_some()) {
        let walls: Vec<(&str, &Shape)> = walls.iter().map(|(name, wall)| (name.as_str(), wall)).collect();
        return files::plot_relief(folder, "walls", config, &walls);
    }
    let nodes = &walls[0].1.nodes;
    // In the colours of the searches in the picture beside it.
    let plot = |name: &str, walls: &[(String, Vec<f64>)]| {
        let series: Vec<(String, Vec<(f64, f64)>)> = walls
            .iter()
            .enumerate()
            .map(|(k, (from, offsets))| {
                let best = if chosen == Some(k) { " (the best)" } else { "" };
                (format!("{from}{best}"), nodes.iter().copied().zip(offsets.iter().copied()).collect())
            })
            .collect();
        let stem = folder.join(name);
        compare(&stem, "Best walls", "x (scene units)", "wall offset (scene units)", &series, false, false)
    };
    let heights: Vec<(String, Vec<f64>)> =
        walls.iter().map(|(name, wall)| (name.clone(), wall.offsets.clone())).collect();
    plot("walls", &heights)?;
    let tops = walls.iter().filter_map(|(name, wall)| Some((name.clone(), wall.top.clone()?)));
    let tops: Vec<(String, Vec<f64>)> = tops.collect();
    if !tops.is_empty() {
        plot("walls-top", &tops)?;
    }
    Ok(())
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

fn go<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    how: Begin<'_>,
    label: &str,
    tasks: &Tasks,
) -> anyhow::Result<(RunFolder, Outcome)> {
    let config = &loaded.config;
    let search = loaded.for_search()?;
    let (problem, _) = build::<R>(&search.config)?;
    // What pictures and reports show, if that is not what the optimiser sees.
    let scene = match search.config == *config {
        true => None,
        false => Some(build::<R>(config)?.0),
    };
    let schedule = problem.schedule(&config.optimise, config.run.precision)?;
    let judges = Judges { config, problem: &problem, schedule: &schedule, surrogate: surrogate::<R>(loaded)? };
    let mut optimisation = begin(config, &problem, how)?;
    let mut notes = notes(loaded).to_vec();
    if judges.surrogate.is_some() {
        notes.push((MODEL, identity(model_of(config))?));
    }
    let own = RunFolder::take(folder, KIND, how.earlier)?;
    files::write_config(folder, loaded)?;
    let done = optimisation.history.len();
    // Several may go on at once.
    let name = if label.is_empty() { String::new() } else { format!("{label}: ") };
    let label = if label.is_empty() { "optimize".to_string() } else { format!("optimize {label}") };
    let bar = Progress::among(tasks, config.optimise.epochs.saturating_sub(done) as u64 * UNITS, &label);
    let reason = RefCell::new(String::new());
    // Steps of the solver that proposals took, which belong to the epoch behind them.
    let proposals = Cell::new(0);
    let prepare = |optimisation: &mut Optimisation| {
        proposals.set(proposals.get() + judges.prepare(optimisation)?);
        Ok(())
    };
    let evaluate = |optimisation: &Optimisation, variables: &[f64]| {
        let base = (optimisation.history.len() - done) as u64 * UNITS;
        let mut progress = |share: f64| bar.set_position(base + (share * UNITS as f64) as u64);
        let mut found = judges.judge(optimisation, variables, &mut progress);
        if let Ok(found) = &mut found {
            found.solver_steps += proposals.take();
        }
        if let Err(Error::Diverged { problem, .. }) = &found {
            reason.replace(problem.clone());
        }
        found
    };
    let keep = |optimisation: &Optimisation| -> anyhow::Result<()> {
        checkpoint::write(&folder.join(CHECKPOINT), optimisation, &notes)?;
        write_history(folder, problem.figure, judges.surrogate.is_some(), optimisation)
    };
    let limits = problem.parametrisation.limits();
    optimisation.run_prepared(config.optimise.epochs, limits, prepare, evaluate, |optimisation| {
        keep(optimisation)?;
        if let Some(last) = optimisation.history.last() {
            let (epoch, symbol) = (format!("{name}epoch {:3}", optimisation.history.len()), problem.figure.symbol);
            if last.is_rejected() {
                let seconds = last.seconds;
                bar.log(&format!("{epoch}  rejected, the next step is shorter: {}  {seconds:.1} s", reason.borrow()));
                return Ok(());
            }
            bar.message(format!("{symbol} {:.6} |gradient| {:.2e}", last.figure, last.gradient_norm));
            bar.log(&format!(
                "{epoch}  {symbol} {:.6}  loss {:+.6}  |gradient| {:.3e}{}  {:.1} s",
                last.figure,
                last.loss,
                last.gradient_norm,
                both_sides(last),
                last.seconds
            ));
        }
        Ok(())
    })?;
    if judges.surrogate.is_some() {
        if let Some(last) = optimisation.history.last_mut() {
            last.solver_steps += proposals.take();
        }
        // What is believed of the first and of the best wall is not enough.
        optimisation.judge(&[0, optimisation.predicted_best()], |variables| problem.truth(variables))?;
        keep(&optimisation)?;
    }
    bar.finish();
    Ok((own, report(loaded, folder, (&problem, scene.as_ref()), &optimisation)?))
}

/// What surrogate and solver say of an epoch, for its line.
fn both_sides(epoch: &Epoch) -> String {
    match (epoch.predicted, epoch.truth) {
        (Some(predicted), Some(truth)) => format!("  (predicted {predicted:.6}, solver {:.6})", truth.figure),
        (Some(_), None) => "  (predicted)".into(),
        _ => String::new(),
    }
}

/// What a checkpoint calls the checksum of the model.
const MODEL: &str = "model";

/// The file of a configuration's surrogate; none: the built-in one.
fn model_of(config: &Config) -> Option<&Path> {
    config.surrogate.model.as_deref().map(Path::new)
}

/// The surrogate that a configuration asks for.
pub fn surrogate<R: Sweeps>(loaded: &Loaded) -> anyhow::Result<Option<SurrogateProblem<R>>> {
    let wanted = &loaded.config.surrogate;
    if loaded.config.optimise.dynamics == DynamicsName::Solver {
        return Ok(None);
    }
    let dtype = match wanted.precision {
        Precision::F32 => DType::F32,
        Precision::F64 => DType::F64,
    };
    let model = match model_of(&loaded.config) {
        Some(path) => load_learned(path, Kernels::Fused, dtype)?,
        None => HEATED_CHANNEL.load(Kernels::Fused, dtype)?,
    };
    let problem = SurrogateProblem::new(loaded, model).map_err(|error| match error {
        Error::Input(bad) => bad.located(|key| loaded.place(key).map(str::to_owned)).into(),
        other => other,
    })?;
    Ok(Some(problem))
}

/// Who judges walls: the solver, a surrogate, or both.
struct Judges<'a, R> {
    config: &'a Config,
    problem: &'a Problem<R>,
    schedule: &'a Schedule,
    surrogate: Option<SurrogateProblem<R>>,
}

impl<R: Sweeps> Judges<'_, R> {
    /// What comes before an epoch: a proposal, or the solver's turn. Steps of the solver that it took.
    fn prepare(&self, optimisation: &mut Optimisation) -> anyhow::Result<usize> {
        let Some(surrogate) = &self.surrogate else { return Ok(0) };
        let wanted = &self.config.surrogate;
        let done = optimisation.history.len();
        if self.config.optimise.dynamics == DynamicsName::Both {
            let over = done >= wanted.epochs || optimisation.optimiser.is_done();
            if optimisation.solver_from.is_none() && over && done > 0 {
                let best = &optimisation.history[optimisation.predicted_best()].variables;
                optimisation.optimiser = optimisers::of_config(&self.config.optimise, best);
                optimisation.solver_from = Some(done);
            }
            return Ok(0);
        }
        let mut steps = 0;
        if let Some(region) = optimisation.optimiser.trust_region() {
            region.propose(self.problem.parametrisation.limits(), |variables| {
                let found = surrogate.gradient(variables, &mut |_| ());
                steps += found.as_ref().map_or(0, |found| found.solver_steps);
                found
            })?;
        }
        Ok(steps)
    }

    /// The loss of a design and its gradient, for the optimiser.
    fn judge(&self, optimisation: &Optimisation, variables: &[f64], progress: Share<'_>) -> Result<Evaluation, Error> {
        let (wanted, done) = (&self.config.surrogate, optimisation.history.len());
        let in_region = wanted.trust == Trust::Region;
        let surrogate = self.surrogate.as_ref().filter(|_| !in_region && optimisation.solver_from.is_none());
        let Some(surrogate) = surrogate else {
            let found = self.problem.gradient(variables, self.schedule, progress)?;
            let predicted = optimisation.optimiser.expectation().map(|loss| {
                let (penalty, _) = self.problem.parametrisation.penalty(self.problem.smoothing, variables);
                (penalty - loss) * self.problem.figure.factor
            });
            return Ok(Evaluation { predicted, ..found });
        };
        let mut found = surrogate.gradient(variables, progress)?;
        if wanted.trust == Trust::Check && done.is_multiple_of(wanted.check_every) {
            let (truth, steps) = self.problem.truth(variables)?;
            found.truth = Some(truth);
            found.solver_steps += steps;
        }
        Ok(found)
    }
}

/// A new optimisation, or one that goes on.
fn begin<R: Sweeps>(config: &Config, problem: &Problem<R>, how: Begin<'_>) -> anyhow::Result<Optimisation> {
    let in_region = config.optimise.dynamics == DynamicsName::Surrogate && config.surrogate.trust == Trust::Region;
    let new = |x: &[f64]| -> Box<dyn Optimiser> {
        match in_region {
            true => Box::new(TrustRegion::new(config.surrogate.radius, config.surrogate.inner_epochs, x)),
            false => optimisers::of_config(&config.optimise, x),
        }
    };
    let Some(from) = how.resume else {
        return Ok(Optimisation::new(new(&problem.first)));
    };
    let path = from.join(CHECKPOINT);
    if !path.exists() && is_unfinished(from, KIND) {
        // It was ended before its first epoch was.
        return Ok(Optimisation::new(new(&problem.first)));
    }
    let file = open(&path, checkpoint::KIND, config, &FREE)?;
    let optimisation = checkpoint::restore(&file, &*problem.parametrisation, new)?;
    if let Some(before) = file.metadata.get(MODEL).filter(|_| config.optimise.dynamics != DynamicsName::Solver) {
        if *before != identity(model_of(config))? {
            return Err(BadInput::new("the run was begun with another surrogate")
                .place("--resume")
                .allowed("the model file as it was")
                .advice("a new run")
                .into());
        }
    }
    let epochs = optimisation.history.len();
    let finished = match optimisation.is_finished(config.optimise.epochs) {
        false => return Ok(optimisation),
        // Pictures, figures or checks are missing.
        true if how.is_part || is_unfinished(from, KIND) => return Ok(optimisation),
        true if optimisation.optimiser.is_done() => BadInput::new("the optimiser has found the best wall that it can")
            .allowed("a run whose optimiser has not stopped by itself")
            .advice("a new run from another start shape"),
        true => has_its_epochs(epochs),
    };
    Err(finished.place("--resume").into())
}

fn has_its_epochs(epochs: usize) -> BadInput {
    BadInput::new(format!("the run has its {epochs} epochs already"))
        .allowed("more epochs than it has")
        .advice(format!("--epochs {}", 2 * epochs))
}

/// What a checkpoint's metadata say besides the numbers.
fn notes(loaded: &Loaded) -> [(&'static str, String); 4] {
    [
        // Random numbers are drawn while the scene is built, from named streams of the seed; none later.
        ("rng.seed", loaded.config.run.seed.to_string()),
        ("rng.position", "0".to_string()),
        ("config", loaded.text.clone()),
        ("version", files::VERSION.to_string()),
    ]
}

/// Runs the first and the best design once more, with figures, and writes everything that is made of them. They run as the
/// scene does: as the `own` problem, if that is not the one that was optimised.
fn report<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    (problem, own): (&Problem<R>, Option<&Problem<R>>),
    optimisation: &Optimisation,
) -> anyhow::Result<Outcome> {
    let config = &loaded.config;
    if config.scene == Family::Custom {
        return optimize_shapes::report(loaded, folder, problem, optimisation);
    }
    let history = &optimisation.history;
    write_walls(folder, config, &*problem.parametrisation, optimisation)?;
    let best = problem.parametrisation.sampled(&history[optimisation.best].variables);
    files::write_best(folder, &loaded.with(&wall_settings(&best, config))?)?;
    plot_history(folder, problem, optimisation)?;
    let [first, best] = [&history[0], &history[optimisation.best]].map(|epoch| &epoch.variables);
    let both = |problem: &Problem<R>| -> anyhow::Result<[Finished<R>; 2]> {
        let before = simulate_with_frames(config, &folder.join(BEFORE), problem, first)?;
        Ok([before, simulate_with_frames(config, &folder.join(AFTER), problem, best)?])
    };
    let (shown, note) = match own.map(both) {
        None => (both(problem), String::new()),
        Some(Err(error)) if error.is::<RunError>() => {
            let motion = config.fluid.motion.name();
            (
                both(problem),
                format!(
                    "\nWARNING: with {motion} particles a run failed ({}); this is of the others",
                    shown(&error.to_string())
                ),
            )
        }
        Some(shown) => (shown, String::new()),
    };
    let [before, after] = shown.map_err(diverged(&problem.model, &problem.start(best)))?;
    let (b, a) = (&before.diagnostics, &after.diagnostics);
    // Of all sessions: a resumed run has taken what its parts took.
    let seconds = history.iter().map(|e| e.seconds).sum();
    let (summary_before, summary_after) =
        (files::summary(loaded, b, problem.steps, before.seconds), files::summary(loaded, a, problem.steps, seconds));
    let mut summary = summary(problem, optimisation, summary_before, summary_after);
    wall_summary(&*problem.parametrisation, optimisation, &mut summary);
    summary.insert("search".into(), json!(config.optimise.search));
    // The loop's Q is not that of what is shown.
    let motion = (own.is_some() && note.is_empty()).then(|| config.fluid.motion.name());
    if motion.is_some() {
        summary.insert("q_scene_before".into(), json!(b.q));
        summary.insert("q_scene".into(), json!(a.q));
    }
    let wall = if problem.parametrisation.across().is_some() { ", wall.vtp" } else { "" };
    let text = text(folder, problem.figure, optimisation, seconds, (b, a), motion) + wall + &note;
    let (mut solver_before, mut solver_after) = (before.solver, after.solver);
    let (fields_before, fields_after) = (ParticleFields::of(&mut solver_before), ParticleFields::of(&mut solver_after));
    fields_after.write(folder, loaded)?;
    let panels = [("before", &fields_before), ("after", &fields_after)];
    files::plot_temperature(folder, config, &panels)?;
    files::plot_flow(folder, config, &panels)?;
    files::write_summary(folder, summary.clone())?;
    warn(&warnings(problem, optimisation));
    let values = optimisation.column(Epoch::shown);
    let [first, best] = [first, best].map(|variables| problem.parametrisation.sampled(variables));
    Ok(Outcome { text, summary, history: history.clone(), values, first, best })
}

/// Frames of the first design, and of the best.
pub const BEFORE: &str = "particles-before";
pub const AFTER: &str = "particles";

/// Runs a design and writes ParaView frames of it into a folder.
pub fn simulate_with_frames<R: Sweeps>(
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

/// `shape.csv` with the best, the first and the last wall, and the plot of all of them.
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
        return files::plot_relief(
            folder,
            "shapes",
            config,
            &[("first", &walls[0]), (&best, &walls[optimisation.best])],
        );
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

pub fn plot_history<R>(folder: &Path, problem: &Problem<R>, optimisation: &Optimisation) -> anyhow::Result<()> {
    let predicts = optimisation.history.iter().any(|e| e.predicted.is_some());
    let points: Vec<HistoryPoint> = optimisation
        .history
        .iter()
        .enumerate()
        .map(|(epoch, e)| {
            // A surrogate's and the solver's are two curves.
            let (q, truth) = match predicts {
                true => (e.predicted.unwrap_or(f64::NAN), e.truth.map_or(f64::NAN, |truth| truth.figure)),
                false => (e.figure, f64::NAN),
            };
            HistoryPoint { epoch: epoch + 1, q, loss: e.loss, gradient_norm: e.gradient_norm, truth }
        })
        .collect();
    let first = Some(("first design", optimisation.history[0].shown()));
    let symbol = problem.figure.symbol;
    let label = format!("{} {symbol} (scene units)", problem.objective.name());
    history(&folder.join("history"), &points, (symbol, &label), first)?;
    Ok(())
}

/// `summary.json`, from those of the first and the best design's runs.
pub fn summary<R>(
    problem: &Problem<R>,
    optimisation: &Optimisation,
    mut before: Map<String, Value>,
    mut after: Map<String, Value>,
) -> Map<String, Value> {
    let (history, best) = (&optimisation.history, optimisation.best);
    let name = problem.figure.symbol.to_lowercase();
    // By the objective's own samples, so that the best is one of those per epoch.
    for (map, epoch) in [(&mut before, 0), (&mut after, best)] {
        map.insert(name.clone(), json!(history[epoch].shown()));
        let q = map.get("q").and_then(Value::as_f64);
        if map.contains_key("q_sum") {
            map.insert("q_sum".into(), json!(q.map(|q| q / problem.outlet.spacing)));
        }
    }
    let mut put = |key: &str, value: Value| after.insert(key.into(), value);
    put(&format!("{name}_first"), json!(history[0].shown()));
    put("solver_steps", json!(optimisation.solver_steps()));
    put("best_epoch", json!(best));
    put("rejected_epochs", json!(optimisation.rejected()));
    put(&format!("{name}_per_epoch"), json!(optimisation.column(|e| e.figure)));
    if history.iter().any(|e| e.predicted.is_some()) {
        let predicted = |e: &Epoch| json!(e.predicted);
        let truth = |e: &Epoch| json!(e.truth.map(|truth| truth.figure));
        put(&format!("{name}_predicted_per_epoch"), history.iter().map(predicted).collect());
        put(&format!("{name}_solver_per_epoch"), history.iter().map(truth).collect());
        put("solver_from", json!(optimisation.solver_from));
    }
    put("loss_per_epoch", json!(optimisation.column(|e| e.loss)));
    put("gradient_norm_per_epoch", json!(optimisation.column(|e| e.gradient_norm)));
    put("seconds_per_epoch", json!(optimisation.column(|e| e.seconds)));
    put("before", Value::Object(before));
    put("warnings", json!(warnings(problem, optimisation)));
    after
}

/// What makes a search doubtful.
pub fn warnings<R>(problem: &Problem<R>, optimisation: &Optimisation) -> Vec<Warning> {
    let limits = problem.parametrisation.limits();
    let width = limits.upper.iter().zip(&limits.lower).map(|(upper, lower)| upper - lower).fold(0.0, f64::max);
    warnings::of_search(optimisation, width)
}

/// The variables of walls in `summary.json`.
fn wall_summary(parametrisation: &dyn Parametrisation, optimisation: &Optimisation, summary: &mut Map<String, Value>) {
    let history = &optimisation.history;
    let mut put = |key: &str, value: Value| summary.insert(key.into(), value);
    put("nodes", json!(parametrisation.positions()));
    if let Some(across) = parametrisation.across() {
        put("nodes_z", json!(across));
    }
    put("offsets_first", json!(history[0].variables));
    put("offsets_best", json!(history[optimisation.best].variables));
    put("offsets_last", json!(history.last().map(|epoch| &epoch.variables)));
}

/// What is printed at the end; with the `motion` of the particles that are shown, if the optimiser saw others.
fn text(
    folder: &Path,
    figure: Figure,
    optimisation: &Optimisation,
    seconds: f64,
    (b, a): (&Diagnostics, &Diagnostics),
    motion: Option<&str>,
) -> String {
    let (first, best) = (optimisation.history[0].shown(), optimisation.history[optimisation.best].shown());
    let mut table = Table::new(["", "before", "after"]);
    let mut row = |name: &str, x: f64, y: f64| {
        table.row([name.to_string(), format!("{x:.6}"), format!("{y:.6}")]);
    };
    row(&format!("{}, {} (window average)", figure.symbol, figure.quantity), first, best);
    if let Some(motion) = motion {
        row(&format!("the same flow with {motion} particles: Q"), b.q, a.q);
    }
    row("wall heat flux", b.wall_heat_flux, a.wall_heat_flux);
    row("heat stored per time", b.stored_heat_rate, a.stored_heat_rate);
    row("energy imbalance / wall heat flux", b.energy_imbalance, a.energy_imbalance);
    row("flow rate", b.flow_rate, a.flow_rate);
    row("body force", b.body_force, a.body_force);
    row("pumping power", b.pumping_power, a.pumping_power);
    row("mixed outlet temperature", b.mean_outlet_temperature, a.mean_outlet_temperature);
    row("mean density", b.mean_density, a.mean_density);
    row("fastest particle", b.u_max, a.u_max);
    let mut text = table.to_text();
    text.push_str(&found_text(figure, optimisation, seconds));
    text.push_str(&surrogate_text(figure, optimisation));
    text.push_str(&end_text(optimisation));
    let balanced = a.energy_imbalance.abs() < 0.02;
    let unsteady = a.stored_heat_rate.abs() > 0.005 * a.wall_heat_flux.abs();
    text.push_str(&format!(
        "the heat balance {} ({:+.2} %)\n",
        match balanced {
            true => "closes",
            false if unsteady => "does not close: the flow is not steady yet, try a longer time.end",
            false =>
                "does not close, though the flow is steady: conduction at the ends of the hot section is not resolved",
        },
        100.0 * a.energy_imbalance
    ));
    text.push_str(&format!(
        "files in {}: summary.json, history.png, shapes.png, temperature.png, flow.png, shape.csv, state.h5, {CHECKPOINT}, particles/particles.pvd (ParaView), report.html (all of it in a browser)",
        folder.display()
    ));
    text
}

/// What was gained, where and when.
pub fn found_text(figure: Figure, optimisation: &Optimisation, seconds: f64) -> String {
    let (history, best) = (&optimisation.history, optimisation.best);
    format!(
        "\n{} {} in epoch {} of {}, {seconds:.1} s\n",
        figure.symbol,
        change(history[0].shown(), history[best].shown()),
        best + 1,
        history.len()
    )
}

/// What was rejected, and whether the optimiser stopped by itself.
pub fn end_text(optimisation: &Optimisation) -> String {
    let mut text = match optimisation.rejected() {
        0 => String::new(),
        1 => "1 design was rejected: its run diverged\n".into(),
        count => format!("{count} designs were rejected: their runs diverged\n"),
    };
    if optimisation.optimiser.is_done() {
        text.push_str(&format!("{} stopped: no design near by is better\n", optimisation.optimiser.name()));
    }
    text
}

/// What a surrogate promised, and what came of it; nothing where none was asked.
fn surrogate_text(figure: Figure, optimisation: &Optimisation) -> String {
    let (history, promised) = (&optimisation.history, optimisation.predicted_best());
    let (Some(before), Some(after)) = (history[0].predicted.or(Some(history[0].shown())), history[promised].predicted)
    else {
        return String::new();
    };
    let mut text = format!(
        "the surrogate's best is epoch {}: it predicted {} {}",
        promised + 1,
        figure.symbol,
        change(before, after)
    );
    if let Some(truth) = history[promised].truth {
        text.push_str(&format!("; in the solver {}", change(history[0].shown(), truth.figure)));
    }
    if optimisation.best == 0 {
        text.push_str("\nWARNING: no wall that the surrogate proposed is better in the solver than the first");
    }
    text.push_str(&format!(
        "\n{} steps of the solver (a step of an adjoint counts as {ADJOINT})\n",
        optimisation.solver_steps()
    ));
    text
}

fn write_history(folder: &Path, figure: Figure, predicts: bool, optimisation: &Optimisation) -> anyhow::Result<()> {
    let rows: Vec<Vec<f64>> = optimisation
        .history
        .iter()
        .enumerate()
        .map(|(k, e)| {
            let mut row = vec![k as f64, e.figure, e.loss, e.gradient_norm, e.seconds];
            if predicts {
                let truth = e.truth.map_or(f64::NAN, |truth| truth.figure);
                row.extend([e.predicted.unwrap_or(f64::NAN), truth, e.solver_steps as f64]);
            }
            row
        })
        .collect();
    let name = figure.symbol.to_lowercase();
    let mut header = vec!["epoch", &name, "loss", "gradient_norm", "seconds"];
    if predicts {
        header.extend(["predicted", "solver", "solver_steps"]);
    }
    Ok(write_rows(&folder.join("history.csv"), &header, &rows)?)
}

/// Keys that may change when a run is resumed: how far and how it is computed, not what.
const FREE: [&str; 10] = [
    "output",
    "run.threads",
    "run.kernels",
    "run.device",
    "optimise.epochs",
    "optimise.gradient",
    "optimise.segment",
    "optimise.memory",
    "optimise.store",
    "optimise.horizon",
];
