//! The scenes and presets that are compiled into the program; their text is in `data/scenes/`.

use crate::error::BadInput;
use crate::scene::suggest;

/// A TOML text with a name.
#[derive(Debug, PartialEq, Eq)]
pub struct BuiltIn {
    pub name: &'static str,
    /// One line for `hydrograd scenes`.
    pub description: &'static str,
    pub text: &'static str,
}

/// Complete scenes; the first is the default.
pub const SCENES: &[BuiltIn] = &[BuiltIn {
    name: "heated-channel",
    description: "2D channel with a hot section in the bottom wall whose shape is optimised for heat transfer",
    text: include_str!("../../data/scenes/heated-channel.toml"),
}];

/// Sets of keys laid over a scene with `--preset`.
pub const PRESETS: &[BuiltIn] = &[BuiltIn {
    name: "report",
    description: "the original report's settings: height 0.26 (950 particles), 2000 small steps from rest, 10 epochs",
    text: include_str!("../../data/scenes/presets/report.toml"),
}];

/// The built-in scene of that name.
pub fn scene(name: &str) -> Option<&'static BuiltIn> {
    SCENES.iter().find(|scene| scene.name == name)
}

/// The preset of that name, or an error that lists them.
pub fn preset(name: &str) -> Result<&'static BuiltIn, BadInput> {
    PRESETS
        .iter()
        .find(|preset| preset.name == name)
        .ok_or_else(|| unknown("preset", name, PRESETS).place(format!("--preset {name}")))
}

/// "No such scene", with the names there are and the nearest one.
pub fn unknown(kind: &str, name: &str, known: &[BuiltIn]) -> BadInput {
    let names: Vec<&str> = known.iter().map(|known| known.name).collect();
    let bad = BadInput::new(format!("there is no {kind} `{name}`")).allowed(names.join(", "));
    match suggest::nearest(name, &names) {
        Some(near) => bad.advice(format!("`{near}`")),
        None => bad.advice("`hydrograd scenes` describes them"),
    }
}
