//! `hydrograd recover`: finds the initial state of a flow from later positions of its particles.

use super::arguments::{at_least_one, name_of, CommonArguments};
use super::files;
use super::guard;
use super::page;
use super::prepare::{require_cpu, use_threads};
use super::run_folder::{Earlier, RunFolder};
use crate::config::layers::Setting;
use crate::config::scene::{Config, Family, Kernels, Precision};
use crate::error::{BadInput, Error};
use crate::inverse::initial_state::{InitialState, Target, Unknown};
use crate::inverse::search::{search, Epoch};
use crate::io::csv::write_rows;
use crate::io::state_file::read_state;
use crate::report::plots::{colored_particles, compare, TemperaturePanel};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::record::Record;
use crate::sph::rows::Quantity;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::Sweeps;
use crate::surrogate::initial_velocity::{known_scene, LearnedVelocities};
use crate::surrogate::models::learned::Learned;
use crate::surrogate::{load_learned, TAYLOR_GREEN};
use candle_core::DType;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Find what a flow began with from where its particles end: places or velocities (an inverse problem).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
A part of the start is unknown and begins with a guess; the rest of it is the scene's. Each epoch runs the flow, compares where its
fluid ends with where it should, and follows the exact gradient by all unknowns.

Examples:
  hydrograd recover taylor-green
      the vortices' velocities, at rest at first, from the places of 2500 particles 100 steps later
  hydrograd recover falling-block
      where the particles of a falling block were, from a guess at the tank's wall
  hydrograd recover falling-block --unknown offset --set water.y=0.3 --guess water.x=0.05 --guess water.y=0.5
      the same of the block as a whole, which hits the floor at the end
  hydrograd recover falling-block --guess run.seed=1 --guess water.x=0.1
      from a guess whose particles are in another disorder
  hydrograd recover taylor-green --dynamics surrogate
      velocities through a learned model (models/taylor-green), judged in the solver and beside its own find
  hydrograd recover taylor-green --set time.end=0.3 --epochs 40
      over a longer time, where the flow has mixed more
  hydrograd recover taylor-green --target runs/simulate-taylor-green/state.h5 --set time.end=0.2
      from a state that `simulate` wrote at that time, with the same particles (dx, jitter, seed)")]
pub struct RecoverArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    /// What is to be found [default: places with falling-block, else velocities].
    #[arg(long, value_enum)]
    pub unknown: Option<Unknown>,
    /// How the start differs that is assumed at first, e.g. `--guess water.x=0.1`; may be repeated [default: velocities: at rest;
    /// places: falling-block's block at a wall, else another seed].
    #[arg(long = "guess", value_name = "KEY=VALUE")]
    pub guesses: Vec<String>,
    /// A state.h5 with the places to end at [default: where the scene's own run ends].
    #[arg(long, value_name = "FILE")]
    pub target: Option<PathBuf>,
    /// What searches. The surrogate's find is judged in the solver, and beside what the solver finds itself.
    #[arg(long, value_enum, default_value = "solver")]
    pub dynamics: SearchedBy,
    /// A surrogate of `hydrograd train`, of a flow without walls and heat [default: the built-in one, see models/taylor-green].
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Frames of the surrogate behind the start at whose end places are compared [default: 8].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub frames: Option<usize>,
    /// Runs, each with its gradient.
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = at_least_one)]
    pub epochs: usize,
}

/// What the flow is run with in a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SearchedBy {
    /// The solver.
    Solver,
    /// A learned model, for velocities.
    Surrogate,
}

/// Default number of frames of a surrogate: a fifth of the rotation period of a vortex in the built-in model's data.
const USUAL_FRAMES: usize = 8;

/// Default length of a run. A block that falls from the middle of its tank reaches the floor at 0.6.
const USUAL: &str = "time.steps=100";
const USUAL_OF_A_BLOCK: &str = "time.end=0.5";

impl RecoverArguments {
    pub fn load(&self) -> anyhow::Result<Loaded> {
        let mut common = self.common.clone();
        common.scene.get_or_insert_with(|| "taylor-green".into());
        if self.dynamics == SearchedBy::Surrogate {
            return self.load_known(&common);
        }
        if self.model.is_some() || self.frames.is_some() {
            return Err(BadInput::new("the solver searches, not a surrogate")
                .place(if self.model.is_some() { "--model" } else { "--frames" })
                .allowed("--dynamics surrogate")
                .into());
        }
        let says = |key: &str| common.sets.iter().any(|set| set.trim_start().starts_with(key));
        let own = !says("time.end") && !says("time.steps");
        let family = Config::load_settings(common.scene.as_deref(), None, &[])?.config.scene;
        let usual = if family == Family::FallingBlock { USUAL_OF_A_BLOCK } else { USUAL };
        Ok(common.load(None, if own { vec![Setting::set(usual)] } else { vec![] }, vec![])?)
    }

    /// The scene of a surrogate's data with the user's settings.
    fn load_known(&self, common: &CommonArguments) -> anyhow::Result<Loaded> {
        let refused = |what: &str, place: &str, allowed: &str| -> anyhow::Result<Loaded> {
            Err(BadInput::new(what).place(place).allowed(allowed).into())
        };
        if self.target.is_some() {
            return refused("a target of a file", "--target", "the end of the scene's own run with a surrogate");
        }
        if !self.guesses.is_empty() {
            return refused("a start that is assumed", "--guess", "the start at rest with a surrogate");
        }
        if matches!(self.unknown, Some(Unknown::Places | Unknown::Offset)) {
            return refused("places at the start", "--unknown", "velocities with a surrogate");
        }
        let is_length = |set: &&String| ["time.end", "time.steps"].iter().any(|key| set.trim().starts_with(key));
        if let Some(set) = common.sets.iter().find(is_length) {
            return refused("the length of the run", &format!("--set {set}"), "--frames with a surrogate");
        }
        let (known, settings) = known_scene(&self.surrogate()?)?;
        let scene = Config::load_settings(common.scene.as_deref(), None, &[])?.config.scene.name();
        if scene != known {
            return refused(&format!("the model knows scene {known}"), scene, &format!("hydrograd recover {known}"));
        }
        Ok(common.load(None, settings, vec![])?)
    }

    fn surrogate(&self) -> anyhow::Result<Learned> {
        match &self.model {
            Some(path) => load_learned(path, Kernels::Fused, DType::F32),
            None => TAYLOR_GREEN.load(Kernels::Fused, DType::F32),
        }
    }

    fn unknown(&self, config: &Config) -> Unknown {
        let usual = if config.scene == Family::FallingBlock { Unknown::Places } else { Unknown::Velocities };
        self.unknown.unwrap_or(usual)
    }

    /// The scene with the assumed start; none if it is at rest.
    fn assumed(&self, loaded: &Loaded) -> Result<Option<Loaded>, Error> {
        let config = &loaded.config;
        let given = |text: &String| Setting { label: format!("--guess {text}"), ..Setting::set(text) };
        let mut settings: Vec<Setting> = self.guesses.iter().map(given).collect();
        if settings.is_empty() {
            settings.push(match (self.unknown(config), config.scene) {
                (Unknown::Velocities, _) => return Ok(None),
                (_, Family::FallingBlock) => {
                    // Two spacings away from the more distant wall: with one more it would hardly feel the wall, with
                    // one less the wall would push it out of its lattice.
                    let (away, water) = (2.0 * config.resolution.dx, &config.water);
                    let right = config.tank.length - water.length - away;
                    let x = if water.x - away > right - water.x { away } else { right };
                    Setting::option("the guess", "water.x", format!("{x:?}"))
                }
                _ => Setting::option("the guess", "run.seed", (config.run.seed + 1) % (1 << 62)),
            });
        }
        Ok(Some(loaded.with(&settings)?))
    }
}

const KIND: &str = "recover";

pub fn run(loaded: Loaded, arguments: RecoverArguments) -> anyhow::Result<()> {
    require_cpu(&loaded, "recover")?;
    let folder = arguments.common.folder(None, KIND, &loaded)?;
    RunFolder::check(&folder, KIND, Earlier::Replaced)?;
    use_threads(loaded.config.run.threads);
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(&loaded, &arguments, &folder),
        Precision::F64 => go::<f64>(&loaded, &arguments, &folder),
    }
}

/// The name of an unknown's error in tables and in files.
fn names(unknown: Unknown) -> (&'static str, &'static str) {
    match unknown {
        Unknown::Velocities => ("error of the velocities, relative", "velocity_error"),
        Unknown::Places | Unknown::Offset => ("error of the places at the start", "place_error"),
    }
}

fn go<R: Sweeps>(loaded: &Loaded, arguments: &RecoverArguments, folder: &Path) -> anyhow::Result<()> {
    if arguments.dynamics == SearchedBy::Surrogate {
        return go_with_surrogate::<R>(loaded, arguments, folder);
    }
    let read = |path: &PathBuf| match read_state(path, &[]) {
        Ok(state) => Ok(Target { position: state.position, tags: state.tag }),
        Err(error) => Err(BadInput::new(error.to_string())
            .place(format!("--target {}", path.display()))
            .allowed("a state.h5 of `hydrograd simulate`")),
    };
    let target = arguments.target.as_ref().map(read).transpose()?;
    let is_twin = target.is_none();
    let (unknown, assumed) = (arguments.unknown(&loaded.config), arguments.assumed(loaded)?);
    let assumed_config = assumed.as_ref().map(|assumed| &assumed.config);
    let problem = InitialState::<R>::new(&loaded.config, unknown, assumed_config, target);
    let problem = problem.map_err(located(assumed.as_ref().unwrap_or(loaded)))?;
    check_worth(loaded, &problem, is_twin)?;
    let _own = RunFolder::take(folder, KIND, Earlier::Replaced)?;
    files::write_config(folder, loaded)?;
    let mut evaluate = |x: &[f64], progress: Share<'_>| problem.evaluate(x, progress);
    let found = recover(&problem, "", arguments.epochs, is_twin, &mut evaluate)?;
    let (error_name, error_key) = names(unknown);
    write_history(folder, error_name, error_key, &[("", "", &found)], is_twin)?;
    pictures(&problem, folder, &[("found", &found.at)], is_twin)?;
    let (first, seconds) = (&found.rows[0], found.seconds());
    let mut summary = summary_of(&problem, &found);
    summary.put("distance_before", first[1]);
    summary.put("distance", problem.distance(found.loss));
    summary.put(&format!("{error_key}_before"), is_twin.then_some(first[2]));
    summary.put(error_key, is_twin.then(|| problem.error(&found.at)));
    files::write_summary(folder, &summary)?;
    page::write(folder)?;
    let mut table = Table::new(["", "before", "found"]);
    table.row(cells(END, &[first[1], problem.distance(found.loss)]));
    if is_twin {
        table.row(cells(error_name, &[first[2], problem.error(&found.at)]));
    }
    println!("{}", table.to_text());
    let (unknowns, steps, epochs) = (found.at.len(), problem.scene.steps, found.rows.len());
    println!("{unknowns} unknowns, {steps} steps, {epochs} epochs in {seconds:.1} s");
    println!("files in {}: {FILES}", folder.display());
    // Where the pressure is a part of the state, its start is given, and velocities may differ by those that only make sound.
    if unknown == Unknown::Velocities && problem.scene.model.rows.row(Quantity::Pressure).is_some() {
        guard::warn(
            "with this method velocities that only make sound leave no trace in the target: those that were found may be wrong by a third where \
             the particles end where they should",
            "method.name=standard",
        );
    }
    Ok(())
}

const END: &str = "distance at the end (root mean square of a coordinate)";
const FILES: &str = "summary.json, history.csv, history.png, end.png, start.png, report.html";

fn cells(name: &str, numbers: &[f64]) -> Vec<String> {
    [name.to_string()].into_iter().chain(numbers.iter().map(|x| format!("{x:.6}"))).collect()
}

/// Writes `history.csv` and plots it: distance, error and seconds of one or more searches, each with what its curves have
/// behind their names, and its columns before them.
fn write_history(
    folder: &Path,
    error_name: &str,
    error_key: &str,
    searches: &[(&str, &str, &Recovered)],
    is_twin: bool,
) -> anyhow::Result<()> {
    let mut header = vec!["epoch".to_string()];
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    for (name, prefix, found) in searches {
        header.extend(["distance", error_key, "seconds"].map(|key| format!("{prefix}{key}")));
        rows.resize(found.rows.len().max(rows.len()), vec![]);
        curves.push((format!("distance at the end{name}"), found.column(1)));
        if is_twin {
            curves.push((format!("{error_name}{name}"), found.column(2)));
        }
    }
    for (k, row) in rows.iter_mut().enumerate() {
        row.push(k as f64);
        for (_, _, found) in searches {
            row.extend_from_slice(found.rows.get(k).map_or(&[f64::NAN; 3], |row| &row[1..]));
        }
    }
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    write_rows(&folder.join("history.csv"), &header, &rows)?;
    compare(&folder.join("history"), "Recovery of the start", "epoch", "", &curves, false, true)?;
    Ok(())
}

/// Adds to errors about input where the user wrote it.
fn located(loaded: &Loaded) -> impl Fn(anyhow::Error) -> anyhow::Error + '_ {
    |error| match error.downcast::<BadInput>() {
        Ok(bad) => loaded.located(bad).into(),
        Err(error) => error.downcast::<Error>().map_or_else(|other| other, |error| loaded.located_error(error).into()),
    }
}

/// The common figures of all searches.
fn summary_of<R: Sweeps>(problem: &InitialState<R>, found: &Recovered) -> Record {
    let mut record = Record::default();
    record.put("unknown", name_of(problem.unknown));
    record.put("particles", problem.scene.model.particles());
    record.put("unknowns", found.at.len());
    record.put("steps", problem.scene.steps);
    record.put("epochs", found.rows.len());
    record.put("seconds", found.seconds());
    record
}

/// Finds velocities by a surrogate, checks them by the solver, and compares them with those found by the solver.
fn go_with_surrogate<R: Sweeps>(loaded: &Loaded, arguments: &RecoverArguments, folder: &Path) -> anyhow::Result<()> {
    let frames = arguments.frames.unwrap_or(USUAL_FRAMES);
    let learned = LearnedVelocities::<R>::new(loaded, arguments.surrogate()?, frames).map_err(located(loaded))?;
    let problem = &learned.problem;
    check_worth(loaded, problem, true)?;
    let _own = RunFolder::take(folder, KIND, Earlier::Replaced)?;
    files::write_config(folder, loaded)?;
    let mut by_model = |x: &[f64], progress: Share<'_>| learned.evaluate(x, progress);
    let model = recover(problem, "surrogate  ", arguments.epochs, true, &mut by_model)?;
    let mut by_solver = |x: &[f64], progress: Share<'_>| problem.evaluate(x, progress);
    let solver = recover(problem, "solver     ", arguments.epochs, true, &mut by_solver)?;
    let judged = problem.distance_of(&problem.end(&model.at)?);
    let true_start = problem.distance(learned.loss(&problem.truth())?);
    let searches = [(", surrogate", "", &model), (", solver", "solver_", &solver)];
    write_history(folder, "error of the velocities", "velocity_error", &searches, true)?;
    pictures(problem, folder, &[("found by the surrogate", &model.at), ("found by the solver", &solver.at)], true)?;
    let (before, own) = (&solver.rows[0], problem.distance(solver.loss));
    let (error, own_error) = (problem.error(&model.at), problem.error(&solver.at));
    let mut summary = summary_of(problem, &model);
    summary.put("frames", frames);
    summary.put("distance_before", before[1]);
    summary.put("distance", judged);
    summary.put("distance_in_the_surrogate_before", model.rows[0][1]);
    summary.put("distance_in_the_surrogate", problem.distance(model.loss));
    summary.put("distance_in_the_surrogate_from_the_true_start", true_start);
    summary.put("velocity_error", error);
    let mut beside = summary_of(problem, &solver);
    beside.put("distance", own);
    beside.put("velocity_error", own_error);
    summary.put("solver", beside);
    files::write_summary(folder, &summary)?;
    page::write(folder)?;
    let mut table = Table::new(["", "before", "found by the surrogate", "found by the solver"]);
    table.row(cells(&format!("{END}, in the solver"), &[before[1], judged, own]));
    table.row(cells("error of the velocities, relative", &[before[2], error, own_error]));
    let seconds = [&model, &solver].map(|found| format!("{:.1}", found.seconds()));
    table.row(["seconds".into(), String::new()].into_iter().chain(seconds));
    println!("{}", table.to_text());
    println!(
        "in the surrogate the end of what it found is {:.6} away, and that of the true start {true_start:.6}",
        problem.distance(model.loss)
    );
    let (unknowns, steps, epochs) = (model.at.len(), problem.scene.steps, arguments.epochs);
    println!(
        "{unknowns} unknowns, {frames} frames of the surrogate, {steps} steps of the solver, {epochs} epochs each"
    );
    println!("files in {}: {FILES}", folder.display());
    Ok(())
}

/// Returns an error if there is nothing to find.
fn check_worth<R: Sweeps>(loaded: &Loaded, problem: &InitialState<R>, is_twin: bool) -> Result<(), BadInput> {
    let (problem, allowed, advice) = match problem.unknown {
        _ if !is_twin => return Ok(()),
        Unknown::Velocities if problem.truth().iter().all(|v| *v == 0.0) => (
            "the scene begins at rest: there are no velocities to find",
            "a scene that begins in motion",
            "taylor-green",
        ),
        _ if problem.error(&problem.first()) == 0.0 => (
            "the guess is the scene's own start: there is nothing to find",
            "a guess that differs in a key of the start",
            "falling-block --guess water.x=0.05",
        ),
        _ => return Ok(()),
    };
    Err(BadInput::new(problem)
        .place(loaded.config.scene.name())
        .allowed(format!("{allowed}, or --target with the places that another start led to"))
        .advice(format!("hydrograd recover {advice}")))
}

/// Called with the completed fraction of an epoch.
type Share<'a> = &'a mut dyn FnMut(f64);
/// Computes loss and gradient for values of the unknowns.
type Evaluate<'a> = &'a mut dyn FnMut(&[f64], Share<'_>) -> Result<(f64, Vec<f64>), Error>;

/// The result of a search, and its epochs: number, distance at the end, error of the unknowns, seconds.
struct Recovered {
    at: Vec<f64>,
    loss: f64,
    rows: Vec<Vec<f64>>,
}

impl Recovered {
    fn column(&self, k: usize) -> Vec<(f64, f64)> {
        // In plots epochs are counted from one.
        self.rows.iter().map(|row| (row[0] + 1.0, row[k])).collect()
    }

    fn seconds(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row[3])
    }
}

/// Searches; `label` is the prefix of the lines.
fn recover<R: Sweeps>(
    problem: &InitialState<R>,
    label: &str,
    epochs: usize,
    is_twin: bool,
    evaluate: Evaluate<'_>,
) -> anyhow::Result<Recovered> {
    let clock = Instant::now();
    let mut optimiser = problem.optimiser()?;
    let bar = Progress::new(epochs as u64 * 100, "recover");
    let mut rows = Vec::new();
    let mut told =
        |epoch: usize, x: &[f64]| evaluate(x, &mut |share| bar.set_position((100.0 * (epoch as f64 + share)) as u64));
    let mut see = |epoch: Epoch<'_>| {
        let distance = problem.distance(epoch.loss);
        // The true start of another flow is unknown.
        let error = if is_twin { problem.error(epoch.at) } else { f64::NAN };
        let (name, _) = names(problem.unknown);
        let known = if is_twin { format!("  {name} {error:.6}") } else { String::new() };
        bar.line(&format!("{label}epoch {:3}  distance {distance:.6}{known}", epoch.number));
        rows.push(vec![epoch.number as f64, distance, error, clock.elapsed().as_secs_f64()]);
    };
    let found = search(&mut *optimiser, &problem.limits(), epochs, &mut told, &mut see)?;
    bar.finish();
    Ok(Recovered { at: found.at, loss: found.loss, rows })
}

/// Positions `[2, N]` and speeds `[N]`.
type Shown = (Vec<f64>, Vec<f64>);

/// Plots initial and final positions, assumed, true and found, coloured by speed.
fn pictures<R: Sweeps>(
    problem: &InitialState<R>,
    folder: &Path,
    found: &[(&str, &Vec<f64>)],
    is_twin: bool,
) -> anyhow::Result<()> {
    let (scene, model) = (&problem.scene, &problem.scene.model);
    let n = model.particles();
    let shown = |solver: &mut Solver<R>| -> anyhow::Result<_> {
        let fields = ParticleFields::of(solver)?;
        Ok((fields.position[..2 * n].to_vec(), files::speeds(&fields)))
    };
    let begin = |start: &Snapshot<R>| -> anyhow::Result<_> { shown(&mut Solver::restore(model.clone(), start)?) };
    let draw = |name: &str, panels: &[(String, Shown)]| {
        let fluid = |speeds: &[f64]| (0..n).filter(|&i| model.is_fluid(i)).map(|i| speeds[i]).fold(0.0, f64::max);
        let most = panels.iter().map(|(_, (_, speeds))| fluid(speeds)).fold(0.0, f64::max);
        let mut drawn = Vec::new();
        for (title, (position, speeds)) in panels {
            let diameter = scene.spacing;
            drawn.push(TemperaturePanel {
                title,
                position,
                temperature: speeds,
                tag: &model.tags,
                diameter,
                diameters: None,
            });
        }
        let range = |k: usize| (scene.corner[k], scene.corner[k] + model.domain.size[k]);
        colored_particles(&folder.join(name), "speed |u|", &drawn, (0.0, most.max(1e-6)), range(0), range(1))
    };
    let first = problem.first();
    // The speeds of particles in a file are not used.
    let wanted = match is_twin {
        true => shown(&mut problem.end_of(&scene.start)?)?.1,
        false => vec![0.0; n],
    };
    let mut ends = vec![
        ("end, from what was assumed".to_string(), shown(&mut problem.end(&first)?)?),
        ("end, as it should be".to_string(), (problem.target()[..2 * n].to_vec(), wanted)),
    ];
    let mut starts = vec![("start, as assumed".to_string(), begin(&problem.start(&first))?)];
    if is_twin {
        starts.push(("start, as it was".to_string(), begin(&scene.start)?));
    }
    for (name, x) in found {
        ends.push((format!("end, from what was {name}"), shown(&mut problem.end(x)?)?));
        starts.push((format!("start, as {name}"), begin(&problem.start(x))?));
    }
    draw("end", &ends)?;
    draw("start", &starts)?;
    Ok(())
}
