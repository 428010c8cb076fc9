//! `hydrograd scenes`: lists the built-in scenes, prints one as TOML, or checks what a file would build.

use super::arguments::{check_preset, CommonArguments};
use super::files;
use super::machine;
use super::periodic_box;
use super::prepare::{open_device, use_threads};
use super::run_folder::{Earlier, RunFolder};
use super::{around_bodies, around_shapes};
use crate::adjoint::Dynamics;
use crate::config::builtin::{self, BuiltIn, EXAMPLES, PRESETS, SCENES};
use crate::config::scene::{Config, Precision};
use crate::report::memory::peak_memory_bytes;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::plausible::{Criterion, Findings};
use crate::scene::warnings::Warning;
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use clap::{Args, Subcommand};
use serde_json::{json, Map, Value};
use std::path::Path;
use std::time::Instant;

/// List the built-in scenes and presets, print a scene as TOML, or check a file of your own.
#[derive(Debug, Clone, Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_long_help = "\
Examples:
  hydrograd scenes
      what there is
  hydrograd scenes heated-channel > my.toml
      every key with its meaning, unit and range, to change and run
  hydrograd scenes heated-channel --preset report
      the same with a preset's values
  hydrograd scenes custom > mine.toml
      a box and shapes of your own
  hydrograd scenes check mine.toml
      what it would build and cost, and what looks implausible")]
pub struct ScenesArguments {
    #[command(subcommand)]
    pub command: Option<ScenesCommand>,
    /// Scene to print.
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Lay a preset over it.
    #[arg(long, value_name = "NAME", requires = "scene")]
    pub preset: Option<String>,
}

#[derive(Debug, Clone, Subcommand)]
pub enum ScenesCommand {
    Check(CheckArguments),
}

/// Say what a scene would build (particles, time step, memory, run time), draw it, and warn of implausible numbers.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd scenes check mine.toml
      particles, time step by each criterion, memory, run time, warnings, and a picture
  hydrograd scenes check mine.toml --set resolution.dx=0.01 --out runs/finer
      the same at another spacing")]
pub struct CheckArguments {
    #[command(flatten)]
    pub common: CommonArguments,
}

pub fn run(arguments: ScenesArguments) -> anyhow::Result<()> {
    if let Some(ScenesCommand::Check(arguments)) = &arguments.command {
        return check(&arguments.common);
    }
    let text = match &arguments.scene {
        None => {
            machine::answer(&json!({ "scenes": named(SCENES), "presets": named(PRESETS) }));
            list()
        }
        Some(name) => {
            builtin::scene_or_example(name).ok_or_else(|| builtin::unknown("built-in scene", name, SCENES))?;
            check_preset(arguments.preset.as_deref())?;
            let loaded = Config::load(Some(name), arguments.preset.as_deref(), &[])?;
            machine::answer(&serde_json::to_value(&loaded.config as &dyn erased_serde::Serialize)?);
            loaded.text
        }
    };
    Ok(files::print(text.as_bytes())?)
}

const KIND: &str = "scenes check";

fn check(common: &CommonArguments) -> anyhow::Result<()> {
    let loaded = common.load(None, vec![], vec![])?;
    let folder = common.folder(None, "check", &loaded)?;
    RunFolder::check(&folder, KIND, Earlier::Replaced)?;
    use_threads(loaded.config.run.threads);
    open_device(&loaded)?;
    if loaded.config.is_around_bodies() {
        return around_bodies::check(&loaded, &folder);
    }
    if loaded.config.is_periodic_box() {
        return periodic_box::check(&loaded, &folder);
    }
    if loaded.config.is_around_shapes() {
        return around_shapes::check(&loaded, &folder);
    }
    match loaded.config.run.precision {
        Precision::F32 => report::<f32>(&loaded, &folder),
        Precision::F64 => report::<f64>(&loaded, &folder),
    }
}

/// Smallest number of steps and seconds of the timing, unless the run is shorter.
const BURST: (usize, f64) = (5, 0.5);

fn report<R: Sweeps>(loaded: &Loaded, folder: &Path) -> anyhow::Result<()> {
    let config = &loaded.config;
    let scene = Scene::<R>::from_config(config)?;
    let findings = Findings::of(config, &scene)?;
    let (steps, dt) = (config.steps(), config.time_step());
    let (name, dimensions, dx) = (config.scene.name(), config.dimension(), scene.spacing);
    println!("{}: scene {name}, {dimensions} dimensions, dx {dx}", loaded.source);
    let kinds: Vec<String> = findings.particles.iter().map(|(name, count)| format!("{count} {name}")).collect();
    println!("particles           {} in all: {}", scene.model.particles(), kinds.join(", "));
    let across = [("narrowest passage", findings.narrowest), ("thinnest wall between fluid", findings.thinnest)];
    for (what, count) in across {
        if let Some(count) = count {
            println!("{what:<27} {count} particles");
        }
    }
    let (speed, reference, sound) = (findings.speed, config.fluid.reference_velocity, scene.sound_speed());
    println!("fastest flow        {speed:.4} expected, {reference} as reference, sound {sound:.4}");
    println!("\ntime step {dt:.4e}, {steps} steps to t = {:.4}; {} rules", config.duration(), findings.rules());
    let mut table = Table::new(["criterion", "allows", "by"]);
    for criterion in &findings.criteria {
        table.row([criterion.name.to_string(), format!("{:.4e}", criterion.dt), criterion.formula.to_string()]);
    }
    print!("{table}");
    let dynamics = Sph::new(scene.model.clone(), config.run.compute()?);
    let mut run = dynamics.start(&scene.start)?;
    let _own = RunFolder::take(folder, KIND, Earlier::Replaced)?;
    let start = ParticleFields::of(&mut run)?;
    let (label, values) = match &start.temperature {
        Some(temperature) => (files::TEMPERATURE, temperature.clone()),
        None => (files::SPEED, files::speeds(&start)),
    };
    files::plot_scene(folder, ("particles", label), &[("start", &start)], &[values], scene.spacing)?;
    let clock = Instant::now();
    let (least, seconds) = BURST;
    let mut done = 0;
    let mut failed = None;
    while failed.is_none() && done < steps && (done < least || clock.elapsed().as_secs_f64() < seconds) {
        failed = dynamics.advance(&mut run).and_then(|()| dynamics.check(&run)).err();
        done += 1;
    }
    let each = clock.elapsed().as_secs_f64() / done as f64;
    println!("\nmemory              {:.0} MB at the peak", peak_memory_bytes() as f64 / 1e6);
    println!("run time            about {}, from {done} steps of {:.3} ms", duration(each * steps as f64), 1e3 * each);
    println!("picture             {}", folder.join("particles.png").display());
    let mut warnings = findings.warnings.clone();
    warnings.extend(failed.map(|error| {
        let problem = format!("the first {done} steps fail already: {error}");
        Warning::new("divergence", [done as f64, steps as f64], problem, "what is said above, or a smaller time.cfl")
    }));
    warnings.iter_mut().for_each(|warning| warning.advice = loaded.possible(&warning.advice));
    let of_criterion = |one: &Criterion| json!({ "name": one.name, "allows": one.dt, "by": one.formula });
    let kinds: Map<String, Value> =
        findings.particles.iter().map(|(name, count)| (name.to_string(), json!(count))).collect();
    machine::answer(&json!({
        "scene": config.scene,
        "dimensions": dimensions,
        "dx": dx,
        "particles": { "all": scene.model.particles(), "kinds": kinds },
        "narrowest_passage": findings.narrowest,
        "thinnest_wall": findings.thinnest,
        "expected_speed": speed,
        "sound_speed": sound,
        "time_step": dt,
        "steps": steps,
        "end": config.duration(),
        "criteria": findings.criteria.iter().map(of_criterion).collect::<Vec<_>>(),
        "peak_memory_bytes": peak_memory_bytes(),
        "seconds_per_step": each,
        "expected_seconds": each * steps as f64,
        "warnings": warnings,
        "files": machine::paths_in(folder, ["particles.png", "particles.svg"]),
    }));
    match warnings.len() {
        0 => println!("\nnothing looks implausible"),
        count => println!("\n{count} to look at:"),
    }
    let line = |one: &Warning| format!("  - {}; try {}", one.problem, one.advice);
    warnings.iter().for_each(|one| println!("{}", line(one).trim_end_matches("; try ")));
    Ok(())
}

/// A duration in the form `12 s`, `3.4 min`, `5.6 h`.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.1} s"),
        s if s < 6000.0 => format!("{:.1} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

fn named(items: &[BuiltIn]) -> Vec<Value> {
    items.iter().map(|item| json!({ "name": item.name, "description": item.description })).collect()
}

fn list() -> String {
    let lines = |items: &[BuiltIn]| -> String {
        let line = |item: &BuiltIn| format!("  {:<18} {}\n", item.name, item.description);
        items.iter().map(line).collect()
    };
    format!(
        "Scenes:\n{}\nScenes of the family custom whose answers are known:\n{}\nPresets (--preset NAME):\n{}\n\
         `hydrograd scenes NAME` prints a scene as TOML, to save and change.\n",
        lines(SCENES),
        lines(EXAMPLES),
        lines(PRESETS)
    )
}
