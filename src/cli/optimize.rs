//! `hydrograd optimize`: the main job.

use super::arguments::{name_of, CommonArguments, ExplainArgument, GradientArguments, ResumeArgument};
use super::explain::explain;
use super::files::{self, Fields};
use super::prepare::{build, change, difference, set_threads};
use super::simulate::{diverged, foreign, number, read_tensors, stored_config};
use crate::config::layers::Setting;
use crate::config::scene::{Config, Precision};
use crate::design::adam::Adam;
use crate::design::diagnostics::{simulate, start, Finished};
use crate::design::optimise::{self, Epoch, Progress as State};
use crate::design::shape::Shape;
use crate::error::{BadInput, Error};
use crate::io::atomic::prepare_output_folder;
use crate::io::tensor_file::{write_tensors, Data, Tensors};
use crate::io::vtk::VtkSeries;
use crate::report::plots::{compare, history, wall_shapes, HistoryPoint};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::heated_channel::HeatedChannel;
use crate::scene::load::Loaded;
use crate::sph::Sweeps;
use clap::{Args, ValueEnum};
use serde_json::{json, Map, Value};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Shape the hot wall so that the fluid carries out more heat (the main job).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd optimize
      the heated channel from a flat wall, in less than a minute on two cores
  hydrograd optimize --start all --out runs/starts
      from four start shapes, compared in one plot
  hydrograd optimize --preset report --start random --seed 7
      the original report's settings, from a random wall
  hydrograd optimize --memory 20MB --explain
      the schedule that fits into 20 MB, with its storage and the steps run again
  hydrograd optimize --resume runs/optimize-heated-channel --epochs 80
      go on with a run, up to 80 epochs in all")]
pub struct OptimizeArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Start shape (design.shape); `all` runs flat, random, linear and sine and compares them.
    #[arg(long, value_enum)]
    pub start: Option<StartName>,
    /// Optimiser steps (optimise.epochs).
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
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
        options.extend(self.epochs.map(|value| Setting::option("--epochs", "optimise.epochs", value)));
        options.extend(self.start.and_then(StartName::setting));
        self.common.load(self.resume.resume.as_deref(), vec![], options)
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "optimize", loaded)
    }
}

const CHECKPOINT: &str = "checkpoint.safetensors";
const KIND: &str = "hydrograd optimisation";
/// Work units of the progress bar per epoch.
const UNITS: u64 = 1000;

pub fn run(loaded: Loaded, arguments: OptimizeArguments) -> anyhow::Result<()> {
    let folder = arguments.folder(&loaded)?;
    set_threads(&loaded.config);
    if arguments.explain.explain {
        return explain(&loaded, true);
    }
    if arguments.start == Some(StartName::All) {
        return every_start(&loaded, &folder, &arguments);
    }
    let resume = arguments.resume.resume.as_deref();
    one(&loaded, &folder, resume, "").map(|outcome| {
        println!("{}", outcome.text);
        println!(
            "next: hydrograd simulate {} --set design.file={} --set resolution.dx={} --out runs/finer    runs the best wall at half the spacing",
            folder.join("config.toml").display(),
            std::path::absolute(folder.join("shape.csv")).unwrap_or(folder.join("shape.csv")).display(),
            loaded.config.resolution.dx / 2.0
        );
    })
}

/// What `--start all` compares.
struct Outcome {
    text: String,
    summary: Map<String, Value>,
    q: Vec<f64>,
}

fn one(loaded: &Loaded, folder: &Path, resume: Option<&Path>, label: &str) -> anyhow::Result<Outcome> {
    match loaded.config.run.precision {
        Precision::F32 => go::<f32>(loaded, folder, resume, label),
        Precision::F64 => go::<f64>(loaded, folder, resume, label),
    }
}

fn every_start(loaded: &Loaded, folder: &Path, arguments: &OptimizeArguments) -> anyhow::Result<()> {
    if arguments.resume.resume.is_some() {
        return Err(BadInput::new("--resume together with --start all")
            .allowed("one of them")
            .advice(format!("--resume {}/flat (or random, linear, sine)", folder.display()))
            .into());
    }
    let mut table = Table::new(["start", "Q before", "Q best", "gain", "epoch", "seconds"]);
    let mut curves = Vec::new();
    let mut all = Map::new();
    let mut runs = Vec::new();
    // Every start is built before the first runs: a bad one must not be found out after an hour.
    for start in StartName::EACH {
        let setting = start.setting().ok_or_else(|| Error::run("a start without a shape", "report this"))?;
        let loaded = loaded.with(&[setting])?;
        Shape::from_config(&loaded.config)?;
        runs.push((format!("{start:?}").to_lowercase(), loaded));
    }
    for (name, loaded) in runs {
        let outcome = one(&loaded, &folder.join(&name), None, &name)?;
        let seconds = outcome.summary.get("wall_seconds").and_then(Value::as_f64).unwrap_or(0.0);
        let best = outcome.summary.get("best_epoch").and_then(Value::as_u64).unwrap_or(0) as usize;
        table.row([
            name.clone(),
            format!("{:.6}", outcome.q[0]),
            format!("{:.6}", outcome.q[best]),
            format!("{:+.2} %", 100.0 * (outcome.q[best] / outcome.q[0] - 1.0)),
            best.to_string(),
            format!("{seconds:.1}"),
        ]);
        curves.push((name.clone(), outcome.q.iter().enumerate().map(|(k, &q)| (k as f64, q)).collect()));
        all.insert(name, Value::Object(outcome.summary));
    }
    compare(
        &folder.join("starts"),
        "Outflowing heat by start shape",
        "epoch",
        "Q (rho u T length)",
        &curves,
        false,
        false,
    )?;
    files::write_summary(folder, all)?;
    println!("{}", table.to_text());
    println!("files in {}: starts.png, summary.json, and a folder per start", folder.display());
    Ok(())
}

fn go<R: Sweeps>(loaded: &Loaded, folder: &Path, resume: Option<&Path>, label: &str) -> anyhow::Result<Outcome> {
    let config = &loaded.config;
    let (channel, shape) = build::<R>(config)?;
    let schedule = optimise::schedule(config, &channel)?;
    let mut state = match resume {
        Some(from) => read_checkpoint(&from.join(CHECKPOINT), config, &shape.nodes)?,
        None => State::new(config, shape.offsets.clone()),
    };
    if state.history.len() >= config.optimise.epochs && resume.is_some() {
        return Err(BadInput::new(format!("the run has its {} epochs already", state.history.len()))
            .place("--resume")
            .allowed("more epochs than it has")
            .advice(format!("--epochs {}", 2 * state.history.len()))
            .into());
    }
    prepare_output_folder(folder)?;
    files::write_config(folder, loaded)?;
    let done = state.history.len();
    let label = if label.is_empty() { "optimize".to_string() } else { format!("optimize {label}") };
    let bar = Progress::new((config.optimise.epochs - done) as u64 * UNITS, &label);
    while state.history.len() < config.optimise.epochs {
        let base = (state.history.len() - done) as u64 * UNITS;
        optimise::epoch(config, &channel, &schedule, &shape.nodes, &mut state, &mut |share| {
            bar.set_position(base + (share * UNITS as f64) as u64)
        })?;
        write_checkpoint(&folder.join(CHECKPOINT), &state, loaded)?;
        write_history(folder, &state)?;
        if let Some(last) = state.history.last() {
            let epoch = state.history.len() - 1;
            bar.message(format!("Q {:.6} |gradient| {:.2e}", last.q, last.gradient_norm));
            bar.line(&format!(
                "epoch {epoch:3}  Q {:.6}  loss {:+.6}  |gradient| {:.3e}  {:.1} s",
                last.q, last.loss, last.gradient_norm, last.seconds
            ));
        }
    }
    bar.finish();
    // Of all sessions: a resumed run has taken what its parts took.
    let seconds = state.history.iter().map(|e| e.seconds).sum();
    let outcome = report(loaded, folder, &channel, &shape, &state, seconds)?;
    Ok(outcome)
}

/// Runs the first and the best design once more, with figures, and writes everything that is made of them.
fn report<R: Sweeps>(
    loaded: &Loaded,
    folder: &Path,
    channel: &HeatedChannel<R>,
    shape: &Shape,
    state: &State,
    seconds: f64,
) -> anyhow::Result<Outcome> {
    let config = &loaded.config;
    let offsets = |k: usize| state.history[k].offsets.as_slice();
    let last = state.history.len() - 1;
    let (first, best) = (offsets(0), offsets(state.best));
    let plain =
        |offsets: &[f64]| simulate(channel, config.run.kernels, start(channel, offsets), |_| Ok(())).map_err(diverged);
    let before: Finished<R> = plain(first)?;
    let mut series = match config.output.frames {
        0 => None,
        _ => Some(VtkSeries::new(&folder.join("particles"), "particles")?),
    };
    let every = if config.output.frames == 0 { usize::MAX } else { channel.steps.div_ceil(config.output.frames) };
    let after = simulate(channel, config.run.kernels, start(channel, best), |solver| {
        if let Some(series) = &mut series {
            if solver.step % every == 0 || solver.step == channel.steps {
                Fields::of(solver).with_frame(|frame| series.write(frame))?;
            }
        }
        Ok(())
    })
    .map_err(diverged)?;
    let (mut solver_before, mut solver_after) = (before.solver, after.solver);
    let (fields_before, fields_after) = (Fields::of(&mut solver_before), Fields::of(&mut solver_after));
    fields_after.write(folder, loaded)?;
    files::write_shape(folder, &shape.nodes, &[("offset", best), ("first", first), ("last", offsets(last))])?;
    files::plot_temperature(folder, config, &[("before", &fields_before), ("after", &fields_after)])?;
    let points: Vec<HistoryPoint> = state
        .history
        .iter()
        .enumerate()
        .map(|(epoch, e)| HistoryPoint { epoch, q: e.q, loss: e.loss, gradient_norm: e.gradient_norm })
        .collect();
    history(&folder.join("history"), &points, Some(("first design", state.history[0].q)))?;
    let shapes: Vec<(String, Vec<f64>)> =
        state.history.iter().enumerate().map(|(k, e)| (format!("epoch {k}"), e.offsets.clone())).collect();
    wall_shapes(&folder.join("shapes"), &shape.nodes, &shapes, Some(state.best), config.design.bound)?;

    let (b, a) = (&before.diagnostics, &after.diagnostics);
    let mut map = files::summary(loaded, a, channel.steps, seconds);
    let column = |f: &dyn Fn(&Epoch) -> f64| state.history.iter().map(f).collect::<Vec<f64>>();
    // Of the best design by the objective's own samples, so that it is one of q_per_epoch.
    let (q_first, q_best) = (state.history[0].q, state.history[state.best].q);
    map.insert("q".into(), json!(q_best));
    map.insert("q_sum".into(), json!(q_best / channel.spacing));
    map.insert("q_first".into(), json!(state.history[0].q));
    map.insert("best_epoch".into(), json!(state.best));
    map.insert("q_per_epoch".into(), json!(column(&|e| e.q)));
    map.insert("loss_per_epoch".into(), json!(column(&|e| e.loss)));
    map.insert("gradient_norm_per_epoch".into(), json!(column(&|e| e.gradient_norm)));
    map.insert("seconds_per_epoch".into(), json!(column(&|e| e.seconds)));
    map.insert("nodes".into(), json!(shape.nodes));
    map.insert("offsets_first".into(), json!(first));
    map.insert("offsets_best".into(), json!(best));
    map.insert("offsets_last".into(), json!(offsets(last)));
    let mut first_design = files::summary(loaded, b, channel.steps, before.seconds);
    first_design.insert("q".into(), json!(q_first));
    first_design.insert("q_sum".into(), json!(q_first / channel.spacing));
    map.insert("before".into(), Value::Object(first_design));
    files::write_summary(folder, map.clone())?;

    let mut table = Table::new(["", "before", "after"]);
    let mut row = |name: &str, x: f64, y: f64| {
        table.row([name.to_string(), format!("{x:.6}"), format!("{y:.6}")]);
    };
    row("Q, outflowing heat (window average)", q_first, q_best);
    row("wall heat flux", b.wall_heat_flux, a.wall_heat_flux);
    row("heat stored per time", b.stored_heat_rate, a.stored_heat_rate);
    row("energy imbalance / wall heat flux", b.energy_imbalance, a.energy_imbalance);
    row("flow rate", b.flow_rate, a.flow_rate);
    row("mixed outlet temperature", b.mean_outlet_temperature, a.mean_outlet_temperature);
    row("mean density", b.mean_density, a.mean_density);
    row("fastest particle", b.u_max, a.u_max);
    let mut text = table.to_text();
    text.push_str(&format!(
        "\nQ {} in epoch {} of {}, {seconds:.1} s\n",
        change(state.history[0].q, state.history[state.best].q),
        state.best,
        last
    ));
    let balanced = a.energy_imbalance.abs() < 0.02;
    text.push_str(&format!(
        "the heat balance {} ({:+.2} %)\n",
        if balanced { "closes" } else { "does not close: the flow is not steady yet, try a longer time.end" },
        100.0 * a.energy_imbalance
    ));
    text.push_str(&format!(
        "files in {}: summary.json, history.png, shapes.png, temperature.png, shape.csv, state.h5, {CHECKPOINT}, particles/particles.pvd (ParaView)",
        folder.display()
    ));
    Ok(Outcome { text, summary: map, q: column(&|e| e.q) })
}

fn write_history(folder: &Path, state: &State) -> anyhow::Result<()> {
    let rows: Vec<Vec<f64>> = state
        .history
        .iter()
        .enumerate()
        .map(|(k, e)| vec![k as f64, e.q, e.loss, e.gradient_norm, e.seconds])
        .collect();
    files::write_numbers(&folder.join("history.csv"), &["epoch", "q", "loss", "gradient_norm", "seconds"], &rows)
}

/// Keys that may change when a run is resumed: how far and how it is computed, not what.
const FREE: [&str; 9] = [
    "output",
    "run.threads",
    "run.kernels",
    "optimise.epochs",
    "optimise.gradient",
    "optimise.segment",
    "optimise.memory",
    "optimise.store",
    "optimise.horizon",
];

fn write_checkpoint(path: &Path, state: &State, loaded: &Loaded) -> anyhow::Result<()> {
    let (k, epochs) = (state.offsets.len(), state.history.len());
    let mut tensors: Tensors = BTreeMap::new();
    let mut put = |name: &str, shape: Vec<usize>, values: Vec<f64>| {
        tensors.insert(name.into(), (shape, Data::F64(values)));
    };
    put("offsets", vec![k], state.offsets.clone());
    put("offsets_best", vec![k], state.history[state.best].offsets.clone());
    put("adam.first_moment", vec![k], state.adam.first.clone());
    put("adam.second_moment", vec![k], state.adam.second.clone());
    put("history.offsets", vec![epochs, k], state.history.iter().flat_map(|e| e.offsets.clone()).collect());
    type Column = fn(&Epoch) -> f64;
    let columns: [(&str, Column); 4] = [
        ("history.q", |e| e.q),
        ("history.loss", |e| e.loss),
        ("history.gradient_norm", |e| e.gradient_norm),
        ("history.seconds", |e| e.seconds),
    ];
    for (name, column) in columns {
        put(name, vec![epochs], state.history.iter().map(column).collect());
    }
    let metadata = BTreeMap::from(
        [
            ("kind", KIND.to_string()),
            ("epochs", epochs.to_string()),
            ("best_epoch", state.best.to_string()),
            ("adam.steps", state.adam.steps.to_string()),
            // Random numbers are drawn while the scene is built, from named streams of the seed; none later.
            ("rng.seed", loaded.config.run.seed.to_string()),
            ("rng.position", "0".to_string()),
            ("config", loaded.text.clone()),
            ("version", files::VERSION.to_string()),
        ]
        .map(|(k, v)| (k.to_string(), v)),
    );
    Ok(write_tensors(path, &tensors, &metadata)?)
}

/// A checkpoint's numbers must be ones that a run could have written.
fn check_state(path: &Path, config: &Config, nodes: &[f64], state: &State) -> Result<(), BadInput> {
    let channel = &config.channel;
    let shape = Shape::new(nodes.to_vec(), state.offsets.clone(), channel.hot_from, channel.hot_to);
    shape
        .and_then(|shape| shape.check_bound(config.design.bound))
        .map_err(|bad| bad.place(path.display().to_string()))?;
    let moments = [("adam.first_moment", &state.adam.first), ("adam.second_moment", &state.adam.second)];
    for (name, values) in moments {
        if let Some(k) = values.iter().position(|x| !x.is_finite()) {
            return Err(
                BadInput::new(format!("{}: {name}[{k}] = {}", path.display(), values[k])).allowed("finite numbers")
            );
        }
    }
    Ok(())
}

fn read_checkpoint(path: &Path, config: &Config, nodes: &[f64]) -> anyhow::Result<State> {
    let variables = nodes.len();
    let file = read_tensors(path, KIND)?;
    let theirs = stored_config(path, &file)?;
    if let Some(what) = difference(&theirs, config, &FREE) {
        return Err(foreign(path, &what).into());
    }
    let epochs = number(path, &file, "epochs")?;
    let best = number(path, &file, "best_epoch")?;
    let bad = |e: crate::io::FileError| BadInput::new(e.to_string());
    let vector = |name: &str, shape: &[usize]| -> Result<Vec<f64>, BadInput> {
        Ok(file.f64(name, shape).map_err(bad)?.to_vec())
    };
    let offsets = vector("history.offsets", &[epochs, variables])?;
    let (q, loss) = (vector("history.q", &[epochs])?, vector("history.loss", &[epochs])?);
    let (norm, seconds) = (vector("history.gradient_norm", &[epochs])?, vector("history.seconds", &[epochs])?);
    if best >= epochs.max(1) {
        return Err(BadInput::new(format!("{}: best_epoch = {best} of {epochs} epochs", path.display()))
            .allowed("a checkpoint written by this version")
            .into());
    }
    let history = (0..epochs)
        .map(|k| Epoch {
            offsets: offsets[k * variables..(k + 1) * variables].to_vec(),
            q: q[k],
            loss: loss[k],
            gradient_norm: norm[k],
            seconds: seconds[k],
        })
        .collect();
    let adam = Adam {
        learning_rate: config.optimise.learning_rate,
        first: vector("adam.first_moment", &[variables])?,
        second: vector("adam.second_moment", &[variables])?,
        steps: number(path, &file, "adam.steps")? as u64,
    };
    let state = State { offsets: vector("offsets", &[variables])?, adam, history, best };
    check_state(path, config, nodes, &state)?;
    Ok(state)
}
