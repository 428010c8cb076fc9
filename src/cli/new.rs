//! `hydrograd new`: writes a scene file after a few questions.

use super::arguments::{check_preset, set_option, with_options};
use super::machine;
use crate::config::builtin::{self, BuiltIn, SCENES};
use crate::config::layers::Setting;
use crate::config::scene::Config;
use crate::error::{BadInput, Error};
use crate::io::atomic::write_bytes_atomically;
use crate::report::text::shown;
use crate::scene::load::Loaded;
use clap::Args;
use dialoguer::console::{truncate_str, Term};
use dialoguer::{Input, Select};
use serde_json::json;
use std::io::IsTerminal;
use std::path::PathBuf;

/// Write a scene of your own, every key with its meaning, unit and range.
///
/// In a terminal it asks for a scene and a few numbers, unless they are given; an empty answer takes what is shown.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd new my.toml
      asks for the scene, its size, spacing, fluid and length
  hydrograd new my.toml heated-channel --set channel.height=0.26 --set resolution.dx=0.01
      asks for nothing
  hydrograd new mine.toml custom && hydrograd scenes check mine.toml
      a box and shapes of your own, and what they would build")]
pub struct NewArguments {
    /// The file.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// A built-in scene to begin with (`hydrograd scenes` lists them).
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Lay a preset over it.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// Set a key; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Write over the file if there is one.
    #[arg(long)]
    pub overwrite: bool,
}

/// The questions, for scenes that have the key.
const QUESTIONS: [(&str, &str); 12] = [
    ("channel.length", "Length of the channel"),
    ("channel.height", "Height of the channel"),
    ("tank.length", "Length of the tank"),
    ("tank.height", "Height of the tank"),
    ("resolution.dx", "Spacing of the particles (it divides the lengths)"),
    ("flow.reynolds", "Reynolds number"),
    ("fluid.viscosity", "Dynamic viscosity"),
    ("fluid.body_force", "Body force along the channel"),
    ("wall.hot_temperature", "Temperature of the hot wall (the inlet's is 1)"),
    ("fluid.conductivity", "Thermal conductivity"),
    ("time.end", "Time to run to"),
    ("run.precision", "Precision, f64 or f32 (f32 is faster)"),
];

pub fn run(arguments: &NewArguments) -> anyhow::Result<()> {
    let file = &arguments.file;
    if file.is_dir() {
        return Err(BadInput::new(format!("{} is a folder", file.display())).allowed("the name of a file").into());
    }
    if file.exists() && !arguments.overwrite {
        return Err(BadInput::new(format!("{} is there already", file.display()))
            .allowed("a new file")
            .advice("another name, or --overwrite")
            .into());
    }
    check_preset(arguments.preset.as_deref())?;
    // With options there are no questions.
    let is_told = arguments.scene.is_some() || arguments.preset.is_some() || !arguments.sets.is_empty();
    let asks = !is_told && std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
    let scene = match &arguments.scene {
        Some(name) => builtin::scene(name).ok_or_else(|| builtin::unknown("built-in scene", name, SCENES))?,
        None if asks => choose()?,
        None => &SCENES[0],
    };
    let mut settings: Vec<Setting> = arguments.sets.iter().map(|text| set_option(text)).collect();
    let load = |settings: &[Setting]| Config::load_settings(Some(scene.name), arguments.preset.as_deref(), settings);
    let mut loaded = load(&settings)?;
    if asks {
        for (key, question) in QUESTIONS {
            if let Some(now) = value(&loaded, key) {
                (settings, loaded) = ask(key, question, &now, settings, &load)?;
            }
        }
    }
    write_bytes_atomically(file, loaded.text.as_bytes())?;
    let (steps, time_step, has_design) = (loaded.config.steps(), loaded.config.time_step(), loaded.config.has_design());
    machine::answer(&json!({
        "file": machine::path(file),
        "scene": scene.name,
        "steps": steps,
        "time_step": time_step,
        "has_design": has_design,
    }));
    let file = file.display();
    println!("{file}: scene {}, {steps} steps of {time_step:.3e}", scene.name);
    println!("next: hydrograd scenes check {file}    what it would build and cost\n      hydrograd simulate {file}");
    if has_design {
        println!("      hydrograd optimize {file}");
    }
    Ok(())
}

/// Asks for one of the built-in scenes.
fn choose() -> anyhow::Result<&'static BuiltIn> {
    // A line that is wrapped would be drawn twice.
    let width = usize::from(Term::stderr().size().1).saturating_sub(4);
    let line = |scene: &BuiltIn| format!("{:<20} {}", scene.name, scene.description);
    let lines: Vec<String> = SCENES.iter().map(|scene| truncate_str(&line(scene), width, "...").into_owned()).collect();
    let chosen = Select::new().with_prompt("Scene").items(&lines).default(0).interact()?;
    Ok(&SCENES[chosen])
}

/// The value of a key in a configuration's text, as a user would type it.
fn value(loaded: &Loaded, key: &str) -> Option<String> {
    let table: toml::Table = loaded.text.parse().ok()?;
    let (section, name) = key.split_once('.')?;
    match table.get(section)?.get(name)? {
        toml::Value::String(text) => Some(text.clone()),
        other => Some(other.to_string()),
    }
}

/// Asks until the scene can be built with the answer.
fn ask(
    key: &str,
    question: &str,
    now: &str,
    settings: Vec<Setting>,
    load: &impl Fn(&[Setting]) -> Result<Loaded, Error>,
) -> anyhow::Result<(Vec<Setting>, Loaded)> {
    loop {
        let prompt = format!("{question} [{key}]");
        let answer: String = Input::new().with_prompt(prompt).default(now.to_string()).interact_text()?;
        let mut all = settings.clone();
        if answer != now {
            all.push(set_option(&format!("{key}={answer}")));
        }
        match load(&all) {
            Ok(loaded) => return Ok((all, loaded)),
            Err(error) => eprintln!("{}", shown(&with_options(&error.to_string()))),
        }
    }
}
