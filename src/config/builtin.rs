//! The scenes and presets that are compiled into the program; their text is in `data/scenes/`.

use crate::config::scene::{Config, Scene};
use crate::config::suggest;
use crate::error::BadInput;

/// A TOML text with a name.
#[derive(Debug, PartialEq, Eq)]
pub struct BuiltIn {
    pub name: &'static str,
    /// One line for `hydrograd scenes`.
    pub description: &'static str,
    pub text: &'static str,
}

impl BuiltIn {
    /// The scene's family.
    pub fn scene(&self) -> Scene {
        toml::from_str::<Config>(self.text).expect("a built-in scene is a configuration").scene
    }
}

/// Complete scenes, one per family and with every key that the family has (one that is not set is commented out); the
/// first is the default.
pub const SCENES: &[BuiltIn] = &[
    BuiltIn {
        name: "heated-channel",
        description: "2D channel with a hot section in the bottom wall whose shape is optimised for heat transfer",
        text: include_str!("../../data/scenes/heated-channel.toml"),
    },
    BuiltIn {
        name: "taylor-green",
        description: "2D decaying vortices in a periodic box, against their exact solution (no design)",
        text: include_str!("../../data/scenes/taylor-green.toml"),
    },
    BuiltIn {
        name: "taylor-green-3d",
        description: "the same in 3D, without a closed form (no design)",
        text: include_str!("../../data/scenes/taylor-green-3d.toml"),
    },
    BuiltIn {
        name: "poiseuille",
        description: "2D flow between plane walls from rest, against its exact solution (no design)",
        text: include_str!("../../data/scenes/poiseuille.toml"),
    },
    BuiltIn {
        name: "reverse-poiseuille",
        description: "2D opposite streams in a periodic box, against their exact solution (no design)",
        text: include_str!("../../data/scenes/reverse-poiseuille.toml"),
    },
    BuiltIn {
        name: "lid-driven-cavity",
        description: "2D vortex in a box whose upper wall moves, without a closed form (no design)",
        text: include_str!("../../data/scenes/lid-driven-cavity.toml"),
    },
];

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

impl Scene {
    /// The built-in scene of this family.
    pub fn built_in(self) -> &'static BuiltIn {
        &SCENES[self as usize]
    }

    /// Its configuration.
    pub fn defaults(self) -> Config {
        toml::from_str(self.built_in().text).expect("a built-in scene is a configuration")
    }
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
