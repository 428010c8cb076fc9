//! `hydrograd simulate`: one run forward, with figures, plots and frames.

use super::arguments::{CommonArguments, ExplainArgument, ResumeArgument};
use super::explain::explain;
use super::files::{self, Fields};
use super::prepare::{build, difference, set_threads};
use super::simulate_flow;
use crate::adjoint::Dynamics;
use crate::config::scene::{Config, Precision};
use crate::design::diagnostics::simulate;
use crate::error::{BadInput, Error};
use crate::io::atomic::prepare_output_folder;
use crate::io::tensor_file::{write_tensors, Data, TensorFile, Tensors};
use crate::io::vtk::VtkSeries;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::scene::load::Loaded;
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::Sweeps;
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Simulate a scene with its start shape; writes figures, plots and ParaView frames.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd simulate
      the heated channel with a flat wall
  hydrograd simulate --set design.shape=sine --set design.amplitude=0.02 --out runs/sine
      with a sine-shaped wall
  hydrograd simulate --set design.file=runs/optimize-heated-channel/shape.csv --set resolution.dx=0.01
      the optimum of a run again, at half the spacing
  hydrograd simulate --explain
      what a step would do, and nothing is run
  hydrograd simulate taylor-green --set resolution.dx=0.01
      a flow with an exact solution (`hydrograd scenes` lists more), and how far from it the particles end
  hydrograd simulate my.toml --precision f32 --threads 2
      a scene of your own: `hydrograd scenes heated-channel > my.toml` to begin with")]
pub struct SimulateArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
}

impl SimulateArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.load(self.resume.resume.as_deref(), vec![], vec![])
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "simulate", loaded)
    }
}

/// Checkpoints per run, besides the one at the end.
pub const CHECKPOINTS: usize = 10;
/// Rows of history.csv.
pub const HISTORY: usize = 400;

pub fn run(loaded: Loaded, arguments: SimulateArguments) -> anyhow::Result<()> {
    let folder = arguments.folder(&loaded)?;
    set_threads(&loaded.config);
    if arguments.explain.explain {
        return explain(&loaded, false);
    }
    let resume = arguments.resume.resume.as_deref();
    match (loaded.config.run.precision, loaded.config.scene.has_design()) {
        (Precision::F32, true) => go::<f32>(&loaded, &folder, resume),
        (Precision::F64, true) => go::<f64>(&loaded, &folder, resume),
        (Precision::F32, false) => simulate_flow::run::<f32>(&loaded, &folder, resume),
        (Precision::F64, false) => simulate_flow::run::<f64>(&loaded, &folder, resume),
    }
}

fn go<R: Sweeps>(loaded: &Loaded, folder: &Path, resume: Option<&Path>) -> anyhow::Result<()> {
    let config = &loaded.config;
    let (channel, shape) = build::<R>(config)?;
    let first = match resume {
        Some(from) => read_checkpoint::<R>(&from.join("checkpoint.safetensors"), config, &channel.model)?,
        None => channel.start(&shape.offsets),
    };
    check_unfinished(first.step, channel.steps)?;
    prepare_output_folder(folder)?;
    files::write_config(folder, loaded)?;
    files::write_shape(folder, &shape.nodes, &[("offset", &shape.offsets)])?;
    let bar = Progress::new(channel.steps as u64, "simulate");
    // A resumed run leaves the frames and the history of its first part alone and adds to them.
    let part = if first.step > 0 { format!("particles-from-{}", first.step) } else { "particles".to_string() };
    let mut series = match config.output.frames {
        0 => None,
        _ => Some(VtkSeries::new(&folder.join(&part), "particles")?),
    };
    let frame_every = if config.output.frames == 0 { usize::MAX } else { channel.steps.div_ceil(config.output.frames) };
    let history_every = channel.steps.div_ceil(HISTORY);
    let checkpoint_every = channel.steps.div_ceil(CHECKPOINTS);
    let mut history = match resume {
        Some(from) => earlier_history(from, &HISTORY_COLUMNS, first.step as f64 * channel.model.dt),
        None => Vec::new(),
    };
    let mut before: Option<Fields> = None;
    let resumed = first.step;
    let dynamics = Sph::new(channel.model.clone(), config.run.kernels);
    let mut look = |_: &Sph<R>, solver: &mut Solver<R>| {
        let step = solver.step;
        if step == resumed {
            before = Some(Fields::of(solver));
        }
        if let Some(series) = &mut series {
            if step % frame_every == 0 || step == channel.steps {
                Fields::of(solver).with_frame(|frame| series.write(frame))?;
            }
        }
        if step % history_every == 0 || step == channel.steps {
            write_history(folder, &history)?;
            let flows = channel.outlet.numbers(&dynamics.look(solver)?)?;
            let (q, flow) = (channel.outlet.spacing * flows.heat, channel.outlet.spacing * flows.volume);
            history.push(vec![step as f64 * channel.model.dt, q, flow]);
            bar.set_position(step as u64);
            bar.message(format!("Q {q:.5}"));
        }
        // Not inside the window: its averages are not part of a checkpoint.
        let in_window = step > channel.steps - channel.window && step < channel.steps;
        if step > resumed && (step % checkpoint_every == 0 || step == channel.steps) && !in_window {
            write_checkpoint(&folder.join("checkpoint.safetensors"), solver, loaded)?;
        }
        Ok(())
    };
    let finished = simulate(&channel, config.run.kernels, &first, &mut [&mut look]).map_err(diverged)?;
    bar.finish();
    let mut solver = finished.solver;
    let fields = Fields::of(&mut solver);
    fields.write(folder, loaded)?;
    write_history(folder, &history)?;
    let curve = |column: usize| history.iter().map(|row| (row[0], row[column])).collect::<Vec<_>>();
    compare(
        &folder.join("history"),
        "Outflowing heat and flow rate",
        "time",
        "Q (rho u T length), flow rate / 10",
        &[
            ("Q".to_string(), curve(1)),
            ("flow rate / 10".to_string(), curve(2).into_iter().map(|(t, f)| (t, 0.1 * f)).collect()),
        ],
        false,
        false,
    )?;
    let start_fields = before.ok_or_else(|| Error::run("the run has no first state", "report this"))?;
    files::plot_temperature(folder, config, &[("start", &start_fields), ("end", &fields)])?;
    let d = &finished.diagnostics;
    let mut map = files::summary(loaded, d, channel.steps, finished.seconds);
    map.insert("nodes".into(), shape.nodes.clone().into());
    map.insert("offsets".into(), shape.offsets.clone().into());
    files::write_summary(folder, map)?;
    let n = channel.model.particles();
    println!(
        "{} particles, {} steps of {:.3e} in {:.2} s ({:.0} ns per particle and step)",
        n,
        channel.steps - resumed,
        channel.model.dt,
        finished.seconds,
        1e9 * finished.seconds / ((channel.steps - resumed).max(1) * n) as f64
    );
    println!("Q                   {:.6}   outflowing heat, rho u (T - T_in) integrated over the outlet", d.q);
    println!(
        "wall heat flux      {:.6}   stored {:+.6}, imbalance {:+.2} %",
        d.wall_heat_flux,
        d.stored_heat_rate,
        100.0 * d.energy_imbalance
    );
    println!("flow rate           {:.6}   fastest particle {:.4}", d.flow_rate, d.u_max);
    println!("outlet temperature  {:.6}   mixed", d.mean_outlet_temperature);
    println!("mean density        {:.6}", d.mean_density);
    println!(
        "files in {}: summary.json, temperature.png, history.csv, state.h5{}",
        folder.display(),
        if config.output.frames > 0 { format!(", {part}/particles.pvd (ParaView)") } else { String::new() }
    );
    println!("next: hydrograd optimize    shapes the wall so that Q grows");
    Ok(())
}

const HISTORY_COLUMNS: [&str; 3] = ["time", "q", "flow_rate"];

fn write_history(folder: &Path, history: &[Vec<f64>]) -> anyhow::Result<()> {
    files::write_numbers(&folder.join("history.csv"), &HISTORY_COLUMNS, history)
}

/// The rows before `time` of an interrupted run's history; none if it left no readable one.
pub fn earlier_history(folder: &Path, header: &[&str], time: f64) -> Vec<Vec<f64>> {
    let columns = crate::io::csv::read_columns(&folder.join("history.csv"), header).unwrap_or_default();
    let rows = columns.first().map_or(0, Vec::len);
    (0..rows).map(|k| columns.iter().map(|c| c[k]).collect::<Vec<f64>>()).filter(|row| row[0] < time).collect()
}

/// A run that failed, with advice.
pub fn diverged(error: anyhow::Error) -> anyhow::Error {
    if error.downcast_ref::<crate::adjoint::RunError>().is_some() {
        let advice = "a smaller time step (--set time.cfl=0.5), or a gentler wall (--set design.amplitude=...)";
        return Error::run(error.to_string(), advice).into();
    }
    error
}

/// An error if a resumed run has nothing left to do.
pub fn check_unfinished(step: usize, steps: usize) -> Result<(), BadInput> {
    if step < steps {
        return Ok(());
    }
    Err(BadInput::new(format!("the run has its {step} steps already"))
        .place("--resume")
        .allowed("a run that was interrupted")
        .advice("a new run with a longer time.end"))
}

/// Keys that may change between a simulation and its continuation.
const FREE: [&str; 3] = ["output", "run.threads", "optimise"];

pub fn write_checkpoint<R: Sweeps>(path: &Path, solver: &Solver<R>, loaded: &Loaded) -> anyhow::Result<()> {
    let n = solver.model.particles();
    let data = |values: &[R]| Data::F64(values.iter().map(|x| x.f64()).collect());
    let mut tensors: Tensors = BTreeMap::new();
    tensors.insert("state".into(), (vec![solver.model.layout.state_rows(), n], data(&solver.state)));
    let reference = &solver.neighbourhood.reference;
    tensors.insert("list_positions".into(), (vec![solver.model.layout.dimension, n], data(reference)));
    let metadata = BTreeMap::from([
        ("kind".to_string(), "hydrograd simulation".to_string()),
        ("step".to_string(), solver.step.to_string()),
        ("config".to_string(), loaded.text.clone()),
        ("version".to_string(), files::VERSION.to_string()),
    ]);
    Ok(write_tensors(path, &tensors, &metadata)?)
}

pub fn read_checkpoint<R: Sweeps>(
    path: &Path,
    config: &Config,
    model: &crate::sph::model::Model<R>,
) -> anyhow::Result<Snapshot<R>> {
    let file = read_tensors(path, "hydrograd simulation")?;
    let theirs = stored_config(path, &file)?;
    if let Some(what) = difference(&theirs, config, &FREE) {
        return Err(foreign(path, &what).into());
    }
    let (rows, n) = (model.layout.state_rows(), model.particles());
    let bad = |e: crate::io::FileError| BadInput::new(e.to_string());
    let cast = |values: &[f64]| values.iter().map(|&x| R::of(x)).collect::<Vec<R>>();
    let state = cast(file.f64("state", &[rows, n]).map_err(bad)?);
    let reference = cast(file.f64("list_positions", &[model.layout.dimension, n]).map_err(bad)?);
    let step = number(path, &file, "step")?;
    Ok(Snapshot { step, state, reference: Arc::new(reference) })
}

/// Reads a checkpoint of a kind.
pub fn read_tensors(path: &Path, kind: &str) -> Result<TensorFile, BadInput> {
    let file = TensorFile::read(path).map_err(|e| BadInput::new(e.to_string()))?;
    let found = file.metadata.get("kind").map_or("nothing of ours", String::as_str);
    if found != kind {
        return Err(BadInput::new(format!("{} holds {found}, not a {kind}", path.display()))
            .allowed("the folder of an earlier run of the same subcommand")
            .advice("the subcommand that wrote it"));
    }
    Ok(file)
}

/// The configuration in a checkpoint.
pub fn stored_config(path: &Path, file: &TensorFile) -> Result<Config, BadInput> {
    let text = file.text("config").map_err(|e| BadInput::new(e.to_string()))?;
    toml::from_str(text).map_err(|e| {
        BadInput::new(format!("{}: its configuration does not load: {}", path.display(), e.message()))
            .allowed("a checkpoint written by this version")
    })
}

/// A whole number in a checkpoint's metadata.
pub fn number(path: &Path, file: &TensorFile, key: &str) -> Result<usize, BadInput> {
    let text = file.text(key).map_err(|e| BadInput::new(e.to_string()))?;
    text.parse().map_err(|_| {
        BadInput::new(format!("{}: {key} = `{text}` in its metadata", path.display())).allowed("a whole number")
    })
}

/// The error for a checkpoint of another scene.
pub fn foreign(path: &Path, what: &str) -> BadInput {
    BadInput::new(format!("{} is a checkpoint of another scene: it has {what}", path.display()))
        .allowed("the same physics, geometry, time step, design and precision")
        .advice("a new run with another --out")
}
