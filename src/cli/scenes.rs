//! `hydrograd scenes`: lists the built-in scenes, or prints one as TOML.

use super::arguments::check_preset;
use crate::config::builtin;
use crate::config::builtin::{BuiltIn, PRESETS, SCENES};
use crate::config::scene::Config;
use crate::error::Error;
use clap::Args;
use std::io::Write;

/// List the built-in scenes and presets, or print a scene as TOML.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd scenes
      what there is
  hydrograd scenes heated-channel > my.toml
      every key with its meaning, unit and range, to change and run
  hydrograd scenes heated-channel --preset report
      the same with a preset's values")]
pub struct ScenesArguments {
    /// Scene to print.
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Lay a preset over it.
    #[arg(long, value_name = "NAME", requires = "scene")]
    pub preset: Option<String>,
}

pub fn run(arguments: ScenesArguments) -> anyhow::Result<()> {
    let text = match &arguments.scene {
        None => list(),
        Some(name) => {
            if builtin::scene(name).is_none() {
                return Err(Error::from(builtin::unknown("built-in scene", name, SCENES)).into());
            }
            check_preset(arguments.preset.as_deref())?;
            Config::load(Some(name), arguments.preset.as_deref(), &[])?.text
        }
    };
    match std::io::stdout().write_all(text.as_bytes()) {
        // The reader has seen enough: `hydrograd scenes heated-channel | head`.
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        result => Ok(result?),
    }
}

fn list() -> String {
    let lines = |items: &[BuiltIn]| -> String {
        let line = |item: &BuiltIn| format!("  {:<18} {}\n", item.name, item.description);
        items.iter().map(line).collect()
    };
    format!(
        "Scenes:\n{}\nPresets (--preset NAME):\n{}\n\
         `hydrograd scenes NAME` prints a scene as TOML, to save and change.\n",
        lines(SCENES),
        lines(PRESETS)
    )
}
