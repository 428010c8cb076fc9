//! `hydrograd recover`: what a flow began with, from where its particles are later.

use super::arguments::{at_least_one, name_of, CommonArguments};
use super::files;
use super::prepare::use_threads;
use crate::config::layers::Setting;
use crate::config::scene::{Config, Family, Precision};
use crate::design::optimisers::BarzilaiBorwein;
use crate::error::{BadInput, Error};
use crate::inverse::initial_state::{InitialState, Unknown};
use crate::inverse::search::{search, Epoch};
use crate::io::atomic::prepare_output_folder;
use crate::io::csv::write_rows;
use crate::io::state_file::read_state;
use crate::report::plots::{colored_particles, compare, TemperaturePanel};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::Sweeps;
use clap::Args;
use serde_json::{json, Map, Value};
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
    /// Runs, each with its gradient.
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = at_least_one)]
    pub epochs: usize,
}

/// How long a run is unless the user says so. A block that falls from the middle of its tank comes to the floor at 0.6.
const USUAL: &str = "time.steps=100";
const USUAL_OF_A_BLOCK: &str = "time.end=0.5";

impl RecoverArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        let mut common = self.common.clone();
        common.scene.get_or_insert_with(|| "taylor-green".into());
        let says = |key: &str| common.sets.iter().any(|set| set.trim_start().starts_with(key));
        let own = !says("time.end") && !says("time.steps");
        let family = Config::load_settings(common.scene.as_deref(), None, &[])?.config.scene;
        let usual = if family == Family::FallingBlock { USUAL_OF_A_BLOCK } else { USUAL };
        common.load(None, if own { vec![Setting::set(usual)] } else { vec![] }, vec![])
    }

    fn unknown(&self, config: &Config) -> Unknown {
        let usual = if config.scene == Family::FallingBlock { Unknown::Places } else { Unknown::Velocities };
        self.unknown.unwrap_or(usual)
    }

    /// The scene with the start that is assumed at first; none: at rest.
    fn assumed(&self, loaded: &Loaded) -> Result<Option<Loaded>, Error> {
        let config = &loaded.config;
        let given = |text: &String| Setting { label: format!("--guess {text}"), ..Setting::set(text) };
        let mut settings: Vec<Setting> = self.guesses.iter().map(given).collect();
        if settings.is_empty() {
            settings.push(match (self.unknown(config), config.scene) {
                (Unknown::Velocities, _) => return Ok(None),
                (_, Family::FallingBlock) => {
                    // A spacing away from the wall that is farther off.
                    let (dx, water) = (config.resolution.dx, &config.water);
                    let right = config.tank.length - water.length - dx;
                    let x = if water.x - dx > right - water.x { dx } else { right };
                    Setting::option("the guess", "water.x", format!("{x:?}"))
                }
                _ => Setting::option("the guess", "run.seed", (config.run.seed + 1) % (1 << 62)),
            });
        }
        Ok(Some(loaded.with(&settings)?))
    }
}

pub fn run(loaded: Loaded, arguments: RecoverArguments) -> anyhow::Result<()> {
    let folder = arguments.common.folder(None, "recover", &loaded)?;
    use_threads(loaded.config.run.threads);
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(&loaded, &arguments, &folder),
        Precision::F64 => go::<f64>(&loaded, &arguments, &folder),
    }
}

/// What is known of an unknown: its name in tables, and in files.
fn names(unknown: Unknown) -> (&'static str, &'static str) {
    match unknown {
        Unknown::Velocities => ("error of the velocities, relative", "velocity_error"),
        Unknown::Places | Unknown::Offset => ("error of the places at the start", "place_error"),
    }
}

fn go<R: Sweeps>(loaded: &Loaded, arguments: &RecoverArguments, folder: &Path) -> anyhow::Result<()> {
    let target = match &arguments.target {
        None => None,
        Some(path) => {
            let state = read_state(path, &[]).map_err(|error| {
                BadInput::new(error.to_string())
                    .place(format!("--target {}", path.display()))
                    .allowed("a state.h5 of `hydrograd simulate`")
            })?;
            Some(state.position)
        }
    };
    let is_twin = target.is_none();
    let (unknown, assumed) = (arguments.unknown(&loaded.config), arguments.assumed(loaded)?);
    let assumed_config = assumed.as_ref().map(|assumed| &assumed.config);
    let place = |key: &str| assumed.as_ref().unwrap_or(loaded).place(key).map(str::to_owned);
    let problem = InitialState::<R>::new(&loaded.config, unknown, assumed_config, target);
    let problem = problem.map_err(|error| match error.downcast::<Error>() {
        Ok(Error::Input(bad)) => Error::from(bad.located(place)).into(),
        Ok(other) => other.into(),
        Err(other) => other,
    })?;
    check_worth(loaded, &problem, is_twin)?;
    prepare_output_folder(folder)?;
    files::write_config(folder, loaded)?;
    let found = recover(&problem, arguments.epochs, is_twin)?;
    let (error_name, error_key) = names(unknown);
    write_rows(&folder.join("history.csv"), &["epoch", "distance", error_key, "seconds"], &found.rows)?;
    let column = |k: usize| found.rows.iter().map(|row| (row[0], row[k])).collect::<Vec<_>>();
    let mut curves = vec![("distance at the end".to_string(), column(1))];
    if is_twin {
        curves.push((error_name.to_string(), column(2)));
    }
    compare(&folder.join("history"), "Recovery of the start", "epoch", "", &curves, false, true)?;
    pictures(&problem, folder, &found.at, is_twin)?;
    let (first, seconds) = (&found.rows[0], found.rows.last().map_or(0.0, |row| row[3]));
    let (distance, error) = (problem.distance(found.loss), problem.error(&found.at));
    let mut summary = Map::new();
    let mut put = |key: &str, value: Value| summary.insert(key.into(), value);
    put("unknown", json!(name_of(unknown)));
    put("distance_before", json!(first[1]));
    put("distance", json!(distance));
    put(&format!("{error_key}_before"), json!(is_twin.then_some(first[2])));
    put(error_key, json!(is_twin.then_some(error)));
    put("particles", json!(problem.scene.model.particles()));
    put("unknowns", json!(found.at.len()));
    put("steps", json!(problem.scene.steps));
    put("epochs", json!(found.rows.len()));
    put("seconds", json!(seconds));
    files::write_summary(folder, summary)?;
    let mut table = Table::new(["", "before", "found"]);
    let mut row = |name: &str, before: f64, now: f64| {
        table.row([name.into(), format!("{before:.6}"), format!("{now:.6}")]);
    };
    row("distance at the end (root mean square of a coordinate)", first[1], distance);
    if is_twin {
        row(error_name, first[2], error);
    }
    println!("{}", table.to_text());
    let (unknowns, steps, epochs) = (found.at.len(), problem.scene.steps, found.rows.len());
    println!("{unknowns} unknowns, {steps} steps, {epochs} epochs in {seconds:.1} s");
    println!("files in {}: summary.json, history.csv, history.png, end.png, start.png", folder.display());
    Ok(())
}

/// An error if there is nothing to find.
fn check_worth<R: Sweeps>(loaded: &Loaded, problem: &InitialState<R>, is_twin: bool) -> Result<(), Error> {
    let bad = |what: &str| BadInput::new(what).place(loaded.config.scene.name());
    if is_twin && problem.unknown == Unknown::Velocities && problem.truth().iter().all(|v| *v == 0.0) {
        return Err(bad("the scene begins at rest: there are no velocities to find")
            .allowed("a scene that begins in motion, or --target with the places that another start led to")
            .advice("hydrograd recover taylor-green")
            .into());
    }
    if is_twin && problem.error(&problem.first()) == 0.0 {
        return Err(bad("the guess is the scene's own start: there is nothing to find")
            .allowed("a guess that differs in a key of the start, or --target with the places that another start led to")
            .advice("hydrograd recover falling-block --guess water.x=0.05")
            .into());
    }
    Ok(())
}

/// What a search has found, and its epochs: number, distance at the end, error of the unknowns, seconds.
struct Recovered {
    at: Vec<f64>,
    loss: f64,
    rows: Vec<Vec<f64>>,
}

fn recover<R: Sweeps>(problem: &InitialState<R>, epochs: usize, is_twin: bool) -> anyhow::Result<Recovered> {
    let clock = Instant::now();
    let mut optimiser = BarzilaiBorwein::new(problem.first_step()?, &problem.first());
    let bar = Progress::new(epochs as u64 * 100, "recover");
    let mut rows = Vec::new();
    let mut evaluate = |epoch: usize, x: &[f64]| {
        problem.evaluate(x, &mut |share| bar.set_position((100.0 * (epoch as f64 + share)) as u64))
    };
    let mut see = |epoch: Epoch<'_>| {
        let distance = problem.distance(epoch.loss);
        // Of another flow's start nothing is known.
        let error = if is_twin { problem.error(epoch.at) } else { f64::NAN };
        let (name, _) = names(problem.unknown);
        let known = if is_twin { format!("  {name} {error:.6}") } else { String::new() };
        bar.line(&format!("epoch {:3}  distance {distance:.6}{known}", epoch.number));
        rows.push(vec![epoch.number as f64, distance, error, clock.elapsed().as_secs_f64()]);
    };
    let found = search(&mut optimiser, &problem.limits(), epochs, &mut evaluate, &mut see)?;
    bar.finish();
    Ok(Recovered { at: found.at, loss: found.loss, rows })
}

/// Where particles end and begin: with what was assumed, as they should, and as found; coloured by their speeds.
fn pictures<R: Sweeps>(
    problem: &InitialState<R>,
    folder: &Path,
    found: &[f64],
    is_twin: bool,
) -> anyhow::Result<()> {
    let (scene, model) = (&problem.scene, &problem.scene.model);
    let (n, d) = (model.particles(), model.layout.dimension);
    let speed = |fields: &ParticleFields| -> Vec<f64> {
        (0..n).map(|i| (0..d).map(|k| fields.velocity[k * n + i].powi(2)).sum::<f64>().sqrt()).collect()
    };
    let shown = |solver: &mut Solver<R>| {
        let fields = ParticleFields::of(solver);
        (fields.position[..2 * n].to_vec(), speed(&fields))
    };
    let begin = |start: &Snapshot<R>| -> anyhow::Result<_> { Ok(shown(&mut Solver::restore(model.clone(), start)?)) };
    let draw = |name: &str, panels: &[(&str, (Vec<f64>, Vec<f64>))]| {
        let fluid = |speeds: &[f64]| (0..n).filter(|&i| model.is_fluid(i)).map(|i| speeds[i]).fold(0.0, f64::max);
        let most = panels.iter().map(|(_, (_, speeds))| fluid(speeds)).fold(0.0, f64::max);
        let mut drawn = Vec::new();
        for (title, (position, speeds)) in panels {
            let diameter = scene.spacing;
            drawn.push(TemperaturePanel { title, position, temperature: speeds, tag: &model.tags, diameter });
        }
        let range = |k: usize| (scene.corner[k], scene.corner[k] + model.domain.size[k]);
        colored_particles(&folder.join(name), "speed |u|", &drawn, (0.0, most.max(1e-6)), range(0), range(1))
    };
    let first = problem.first();
    // How fast particles of a file are is not looked at.
    let wanted = match is_twin {
        true => shown(&mut problem.end_of(&scene.start)?).1,
        false => vec![0.0; n],
    };
    draw(
        "end",
        &[
            ("end, from what was assumed", shown(&mut problem.end(&first)?)),
            ("end, as it should be", (problem.target()[..2 * n].to_vec(), wanted)),
            ("end, from what was found", shown(&mut problem.end(found)?)),
        ],
    )?;
    let mut starts = vec![("start, as assumed", begin(&problem.start(&first))?)];
    if is_twin {
        starts.push(("start, as it was", begin(&scene.start)?));
    }
    starts.push(("start, as found", begin(&problem.start(found))?));
    draw("start", &starts)?;
    Ok(())
}
