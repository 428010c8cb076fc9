//! `hydrograd recover`: the velocities that a flow began with, from where its particles are later.

use super::arguments::{at_least_one, CommonArguments};
use super::files;
use super::prepare::use_threads;
use crate::config::layers::Setting;
use crate::config::scene::Precision;
use crate::design::limits::Limits;
use crate::design::optimisers::{BarzilaiBorwein, Optimiser};
use crate::error::{BadInput, Error};
use crate::inverse::initial_velocity::InitialVelocity;
use crate::io::atomic::prepare_output_folder;
use crate::io::csv::write_rows;
use crate::io::state_file::read_state;
use crate::report::plots::{colored_particles, compare, TemperaturePanel};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::sph::Sweeps;
use clap::Args;
use serde_json::{json, Map, Value};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Find the velocities that a flow began with from where its particles end (an inverse problem).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
The places at the start are the scene's; the velocities there are unknown and begin at zero. Each epoch runs the flow, compares
where its fluid ends with where it should, and follows the exact gradient by all initial velocities.

Examples:
  hydrograd recover taylor-green
      the vortices' velocities from the places of 2500 particles 100 steps later
  hydrograd recover taylor-green --set time.end=0.3 --epochs 40
      over a longer time, where the flow has mixed more
  hydrograd recover taylor-green --target runs/simulate-taylor-green/state.h5 --set time.end=0.2
      from a state that `simulate` wrote at that time, with the same particles (dx, jitter, seed)")]
pub struct RecoverArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    /// A state.h5 with the places to end at [default: where the scene's own run ends].
    #[arg(long, value_name = "FILE")]
    pub target: Option<PathBuf>,
    /// Runs, each with its gradient.
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = at_least_one)]
    pub epochs: usize,
}

/// Steps of a run unless the user says how long it is.
const STEPS: usize = 100;

impl RecoverArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        let mut common = self.common.clone();
        common.scene.get_or_insert_with(|| "taylor-green".into());
        let says = |key: &str| common.sets.iter().any(|set| set.trim_start().starts_with(key));
        let own = !says("time.end") && !says("time.steps");
        let defaults = if own { vec![Setting::set(&format!("time.steps={STEPS}"))] } else { vec![] };
        common.load(None, defaults, vec![])
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
    let problem = InitialVelocity::<R>::new(&loaded.config, target)?;
    prepare_output_folder(folder)?;
    files::write_config(folder, loaded)?;
    let truth = problem.truth();
    if is_twin && truth.iter().all(|v| *v == 0.0) {
        return Err(BadInput::new("the scene begins at rest: there are no velocities to find")
            .place(loaded.config.scene.name())
            .allowed("a scene that begins in motion, or --target with the places that another start led to")
            .advice("hydrograd recover taylor-green")
            .into());
    }
    let limits = Limits::within(vec![f64::NEG_INFINITY; truth.len()], vec![f64::INFINITY; truth.len()]);
    let mut optimiser = BarzilaiBorwein::new(0.5 * problem.scene.reference_velocity, &vec![0.0; truth.len()]);
    let bar = Progress::new(arguments.epochs as u64 * 100, "recover");
    let clock = Instant::now();
    let (mut rows, mut best) = (Vec::new(), (f64::INFINITY, optimiser.ask().to_vec()));
    for epoch in 0..arguments.epochs {
        let velocity = optimiser.ask().to_vec();
        let mut progress = |share: f64| bar.set_position((100.0 * (epoch as f64 + share)) as u64);
        let (loss, gradient) = match problem.evaluate(&velocity, &mut progress) {
            Err(Error::Diverged { .. }) if epoch > 0 => (f64::INFINITY, vec![0.0; velocity.len()]),
            found => found?,
        };
        let distance = problem.distance(loss);
        // Of another flow's start nothing is known.
        let error = if is_twin { error_of(&velocity, &truth) } else { f64::NAN };
        let known = if is_twin { format!("  velocity error {error:.4}") } else { String::new() };
        bar.line(&format!("epoch {epoch:3}  distance {distance:.6}{known}"));
        let flat = gradient.iter().all(|g| *g == 0.0) && loss.is_finite();
        rows.push(vec![epoch as f64, distance, error, clock.elapsed().as_secs_f64()]);
        if loss < best.0 {
            best = (loss, velocity);
        }
        if flat {
            break;
        }
        optimiser.tell(&limits, loss, &gradient);
    }
    bar.finish();
    write_rows(&folder.join("history.csv"), &["epoch", "distance", "velocity_error", "seconds"], &rows)?;
    let column = |k: usize| rows.iter().map(|row| (row[0], row[k])).collect::<Vec<_>>();
    let mut curves = vec![("distance at the end".to_string(), column(1))];
    if is_twin {
        curves.push(("error of the velocities, relative".to_string(), column(2)));
    }
    compare(&folder.join("history"), "Recovery of the initial velocities", "epoch", "", &curves, false, true)?;
    pictures(&problem, folder, &best.1, is_twin.then_some(truth.as_slice()))?;
    let distance = problem.distance(best.0);
    let mut summary = Map::new();
    let mut put = |key: &str, value: Value| summary.insert(key.into(), value);
    put("distance_before", json!(rows[0][1]));
    put("distance", json!(distance));
    put("velocity_error", json!(is_twin.then(|| error_of(&best.1, &truth))));
    put("particles", json!(problem.scene.model.particles()));
    put("unknowns", json!(truth.len()));
    put("steps", json!(problem.scene.steps));
    put("epochs", json!(arguments.epochs));
    put("seconds", json!(clock.elapsed().as_secs_f64()));
    files::write_summary(folder, summary)?;
    let mut table = Table::new(["", "before", "found"]);
    table.row([
        "distance at the end (root mean square of a coordinate)".into(),
        format!("{:.6}", rows[0][1]),
        format!("{distance:.6}"),
    ]);
    if is_twin {
        table.row([
            "error of the velocities, relative".into(),
            format!("{:.4}", rows[0][2]),
            format!("{:.4}", error_of(&best.1, &truth)),
        ]);
    }
    println!("{}", table.to_text());
    println!(
        "{} unknowns, {} steps, {} epochs in {:.1} s",
        truth.len(),
        problem.scene.steps,
        arguments.epochs,
        clock.elapsed().as_secs_f64()
    );
    println!("files in {}: summary.json, history.csv, history.png, end.png, start.png", folder.display());
    Ok(())
}

/// |v - v*| / |v*|.
fn error_of(velocity: &[f64], truth: &[f64]) -> f64 {
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
    let apart = square(&mut velocity.iter().zip(truth).map(|(v, t)| v - t));
    (apart / square(&mut truth.iter().copied())).sqrt()
}

/// Where particles end (from nothing, as they should, as found), and how fast they begin (found, and truly).
fn pictures<R: Sweeps>(
    problem: &InitialVelocity<R>,
    folder: &Path,
    found: &[f64],
    truth: Option<&[f64]>,
) -> anyhow::Result<()> {
    let model = &problem.scene.model;
    let (n, d) = (model.particles(), model.layout.dimension);
    let speed = |fields: &ParticleFields| -> Vec<f64> {
        (0..n).map(|i| (0..d).map(|k| fields.velocity[k * n + i].powi(2)).sum::<f64>().sqrt()).collect()
    };
    let nothing = ParticleFields::of(&mut problem.end(&vec![0.0; found.len()])?);
    let end = ParticleFields::of(&mut problem.end(found)?);
    let begin = |velocity: &[f64]| -> anyhow::Result<ParticleFields> {
        Ok(ParticleFields::of(&mut crate::sph::solver::Solver::restore(model.clone(), &problem.start(velocity))?))
    };
    let size = &model.domain.size;
    let panel = |title: &'static str, position, values| TemperaturePanel {
        title,
        position,
        temperature: values,
        tag: &model.tags,
        diameter: problem.scene.spacing,
    };
    let draw = |name: &str, panels: &[TemperaturePanel], most: f64| {
        let range = (0.0, most.max(1e-6));
        colored_particles(&folder.join(name), "speed |u|", panels, range, (0.0, size[0]), (0.0, size[1]))
    };
    let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let (at_rest, fast) = (speed(&nothing), speed(&end));
    // How fast particles of a file are is not looked at.
    let wanted = match truth {
        Some(truth) => speed(&ParticleFields::of(&mut problem.end(truth)?)),
        None => vec![0.0; n],
    };
    let target = &problem.target()[..2 * n];
    let panels = [
        panel("end, from rest", &nothing.position[..2 * n], &at_rest),
        panel("end, as it should be", target, &wanted),
        panel("end, from the velocities that were found", &end.position[..2 * n], &fast),
    ];
    draw("end", &panels, most(&fast))?;
    let found = begin(found)?;
    let truth = truth.map(begin).transpose()?;
    let (own, true_speed) = (speed(&found), truth.as_ref().map(speed));
    let mut panels = vec![panel("start, as found", &found.position[..2 * n], &own)];
    if let (Some(truth), Some(speed)) = (&truth, &true_speed) {
        panels.push(panel("start, as it was", &truth.position[..2 * n], speed));
    }
    draw("start", &panels, most(&own))?;
    Ok(())
}
