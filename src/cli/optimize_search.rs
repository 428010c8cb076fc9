//! A search of `hydrograd optimize` in its own folder: started or resumed, stored after every epoch, and reported.

use super::files::{self, CHECKPOINT};
use super::optimize_report::{report, Outcome};
use super::prepare::build;
use super::run_folder::{is_unfinished, Earlier, RunFolder};
use crate::config::scene::{DynamicsName, Precision};
use crate::design::objectives::Figure;
use crate::design::optimise::Epoch;
use crate::design::search::Watch;
use crate::design::{checkpoint, Judge, Optimisation, Search};
use crate::error::BadInput;
use crate::io::csv::write_rows;
use crate::numerics::ranks::Ranks;
use crate::report::progress::{Progress, Tasks};
use crate::scene::checkpoint::open;
use crate::scene::load::Loaded;
use crate::sph::Sweeps;
use crate::surrogate::design::{model_of, SurrogateProblem};
use crate::surrogate::models::load::identity;
use std::path::Path;
use std::time::{Duration, Instant};

/// The kind of the folder of a single run.
pub const KIND: &str = "optimize";
/// Units of the progress bar per epoch.
const UNITS: u64 = 1000;
/// Time between two lines about an epoch where there is no bar.
const BETWEEN: Duration = Duration::from_secs(30);
/// The key of the model's checksum in a checkpoint.
const MODEL: &str = "model";

/// How a run starts.
#[derive(Clone, Copy)]
pub struct Begin<'a> {
    pub folder: &'a Path,
    /// The folder of the run to resume.
    pub resume: Option<&'a Path>,
    pub earlier: Earlier,
    /// Its name among several runs, which may be finished while others are not; empty for a single run.
    pub name: &'a str,
    pub tasks: &'a Tasks,
    /// Those who share the flow; none where there is one process.
    pub ranks: Option<&'a Ranks>,
}

impl<'a> Begin<'a> {
    /// One of several runs in its own folder. If the whole is resumed, the run is resumed if it had started.
    pub fn part(folder: &'a Path, earlier: Earlier, name: &'a str, tasks: &'a Tasks) -> Self {
        let is_begun = folder.join(CHECKPOINT).exists() || is_unfinished(folder, KIND);
        let resume = Some(folder).filter(|_| earlier == Earlier::Resumed && is_begun);
        Self { folder, resume, earlier, name, tasks, ranks: None }
    }
}

/// Searches in a folder, shows the progress and writes all results. The caller marks the folder as finished.
pub fn one(loaded: &Loaded, how: Begin<'_>) -> anyhow::Result<(RunFolder, Outcome)> {
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(loaded, how),
        Precision::F64 => go::<f64>(loaded, how),
    }
}

fn go<R: Sweeps>(loaded: &Loaded, how: Begin<'_>) -> anyhow::Result<(RunFolder, Outcome)> {
    let (config, folder) = (&loaded.config, how.folder);
    let mut solver = loaded.scheduled::<R>()?;
    if let Some(ranks) = how.ranks {
        solver.problem = solver.problem.shared(ranks)?;
    }
    // The scene for plots and reports, if it differs from that of the search.
    let differs = loaded.for_search()?.config != *config;
    let scene = differs.then(|| build::<R>(config)).transpose()?.map(|(scene, _)| scene);
    let surrogate = SurrogateProblem::<R>::of_config(loaded)?;
    let search = Search { config, solver: &solver, surrogate: surrogate.as_ref().map(|it| it as &dyn Judge) };
    let mut optimisation = begin(&search, &solver.problem.first, how)?;
    let mut notes = notes(loaded).to_vec();
    if surrogate.is_some() {
        notes.push((MODEL, identity(model_of(config))?));
    }
    let own = RunFolder::take(folder, KIND, how.earlier)?;
    files::write_config(folder, loaded)?;
    let done = optimisation.history.len();
    // Several searches may run at once.
    let name = if how.name.is_empty() { String::new() } else { format!("{}: ", how.name) };
    let label = format!("optimize {}", how.name);
    let bar = Progress::among(how.tasks, config.optimise.epochs.saturating_sub(done) as u64 * UNITS, label.trim_end());
    let told = Instant::now();
    let mut kept =
        Kept { folder, notes, figure: solver.problem.figure, predicts: surrogate.is_some(), done, name, told, bar };
    let searched = search.run(&mut optimisation, config.optimise.epochs, &mut kept);
    solver.problem.dismiss();
    searched?;
    kept.bar.finish();
    Ok((own, report(loaded, folder, (&solver.problem, scene.as_ref()), &optimisation)?))
}

/// Another rank's part of a search: its share of the flow.
pub fn follow(loaded: &Loaded, ranks: &Ranks) -> anyhow::Result<()> {
    match loaded.config.run.precision {
        Precision::F32 => loaded.scheduled::<f32>()?.problem.shared(ranks)?.follow(),
        Precision::F64 => loaded.scheduled::<f64>()?.problem.shared(ranks)?.follow(),
    }
    Ok(())
}

/// Stores a search in its folder and shows its progress.
struct Kept<'a> {
    folder: &'a Path,
    notes: Vec<(&'static str, String)>,
    figure: Figure,
    /// Whether a surrogate is used.
    predicts: bool,
    /// Number of epochs of earlier sessions.
    done: usize,
    /// Prefix of the lines.
    name: String,
    /// When the last line was printed.
    told: Instant,
    bar: Progress,
}

impl Watch for Kept<'_> {
    fn share(&mut self, now: &Optimisation, share: f64) {
        // A log of hours shows that a long epoch goes on.
        if self.bar.is_hidden() && self.told.elapsed() >= BETWEEN {
            self.told = Instant::now();
            let percent = (100.0 * share) as u64;
            self.bar.log(&format!("{}epoch {:3}  {percent} % done", self.name, now.history.len() + 1));
        }
        let base = (now.history.len() - self.done) as u64 * UNITS;
        self.bar.set_position(base + (share * UNITS as f64) as u64);
    }

    fn epoch(&mut self, now: &Optimisation) -> anyhow::Result<()> {
        self.confirmed(now)?;
        self.told = Instant::now();
        let Some(last) = now.history.last() else { return Ok(()) };
        let Epoch { figure, loss, gradient_norm, gradient_error, seconds, failure, .. } = last;
        let (epoch, symbol) = (format!("{}epoch {:3}", self.name, now.history.len()), self.figure.symbol);
        if let Some(failure) = failure {
            self.bar.log(&format!("{epoch}  rejected, the next step is shorter: {failure}  {seconds:.1} s"));
            return Ok(());
        }
        self.bar.message(format!("{symbol} {figure:.6} |gradient| {gradient_norm:.2e}"));
        let both = both_sides(last);
        let error = if *gradient_error > 0.0 { format!(" +- {gradient_error:.1e}") } else { String::new() };
        self.bar.log(&format!(
            "{epoch}  {symbol} {figure:.6}  loss {loss:+.6}  |gradient| {gradient_norm:.3e}{error}{both}  {seconds:.1} s"
        ));
        if last.is_within_error() {
            self.bar.log(
                "the gradient is within its error: more members (optimise.members), not more epochs, would tell more",
            );
        }
        Ok(())
    }

    fn confirmed(&mut self, now: &Optimisation) -> anyhow::Result<()> {
        checkpoint::write(&self.folder.join(CHECKPOINT), now, &self.notes)?;
        write_history(self.folder, self.figure, self.predicts, now)
    }
}

/// The results of surrogate and solver for an epoch, for its line.
fn both_sides(epoch: &Epoch) -> String {
    match (epoch.predicted, epoch.truth) {
        (Some(predicted), Some(truth)) => format!("  (predicted {predicted:.6}, solver {:.6})", truth.figure),
        (Some(_), None) => "  (predicted)".into(),
        _ => String::new(),
    }
}

/// A new or a resumed optimisation.
fn begin(search: &Search<'_>, first: &[f64], how: Begin<'_>) -> anyhow::Result<Optimisation> {
    let (config, new) = (search.config, |x: &[f64]| search.optimiser(x));
    let Some(from) = how.resume else {
        return Ok(Optimisation::new(new(first)));
    };
    let path = from.join(CHECKPOINT);
    if !path.exists() && is_unfinished(from, KIND) {
        // The run was interrupted during its first epoch.
        return Ok(Optimisation::new(new(first)));
    }
    let file = open(&path, checkpoint::KIND, config, &FREE)?;
    let optimisation = checkpoint::restore(&file, search.solver.parametrisation(), new)?;
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
        // Plots, figures or checks are missing.
        true if !how.name.is_empty() || is_unfinished(from, KIND) => return Ok(optimisation),
        true if optimisation.is_done() => BadInput::new("the optimiser has found the best wall that it can")
            .allowed("a run whose optimiser has not stopped by itself")
            .advice("a new run from another start shape"),
        true => has_its_epochs(epochs),
    };
    Err(finished.place("--resume").into())
}

pub fn has_its_epochs(epochs: usize) -> BadInput {
    BadInput::new(format!("the run has its {epochs} epochs already"))
        .allowed("more epochs than it has")
        .advice(format!("--epochs {}", 2 * epochs))
}

/// The metadata of a checkpoint besides the numbers.
fn notes(loaded: &Loaded) -> [(&'static str, String); 4] {
    [
        // Random numbers are drawn only while the scene is built, from named streams of the seed.
        ("rng.seed", loaded.config.run.seed.to_string()),
        ("rng.position", "0".to_string()),
        ("config", loaded.text.clone()),
        ("version", files::VERSION.to_string()),
    ]
}

fn write_history(folder: &Path, figure: Figure, predicts: bool, optimisation: &Optimisation) -> anyhow::Result<()> {
    let row = |(k, e): (usize, &Epoch)| {
        let mut row = vec![k as f64, e.figure, e.loss, e.gradient_norm, e.seconds];
        if predicts {
            let truth = e.truth.map_or(f64::NAN, |truth| truth.figure);
            row.extend([e.predicted.unwrap_or(f64::NAN), truth, e.solver_steps as f64]);
        }
        row
    };
    let rows: Vec<Vec<f64>> = optimisation.history.iter().enumerate().map(row).collect();
    let name = figure.symbol.to_lowercase();
    let mut header = vec!["epoch", &name, "loss", "gradient_norm", "seconds"];
    if predicts {
        header.extend(["predicted", "solver", "solver_steps"]);
    }
    Ok(write_rows(&folder.join("history.csv"), &header, &rows)?)
}

/// Keys that may change when a run is resumed: its length and the way of computing it.
pub const FREE: [&str; 10] = [
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
