//! The scenes and presets that are compiled into the program; their text is in `data/scenes/`.

use crate::config::layers::Layer;
use crate::config::scene::{Config, Family};
use crate::config::schema::described;
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
    pub fn family(&self) -> Family {
        toml::from_str::<Config>(self.text).expect("a built-in scene is a configuration").scene
    }

    /// An error if the scene has no use for a key of a layer, or if the layer names another scene.
    pub fn accepts(&self, layer: &Layer) -> Result<(), BadInput> {
        let keys: Vec<String> = described::<Config>(self.text).into_iter().map(|(path, _)| path).collect();
        for (path, place) in layer.keys() {
            let name = layer.string(path).unwrap_or_default();
            if path == "scene" && name != self.name {
                return Err(BadInput::new(format!("the run is one of scene {} already", self.name))
                    .place(place)
                    .allowed("the scene as the command's argument, or in a file")
                    .advice(format!("hydrograd simulate {name}")));
            }
            if keys.iter().any(|key| key == path) {
                continue;
            }
            let section = |path: &str| path.split('.').next().unwrap_or_default().to_string();
            let own = section(path);
            let mut near: Vec<String> = keys.iter().filter(|key| section(key) == own).cloned().collect();
            if near.is_empty() {
                near = keys.iter().map(|key| section(key)).filter(|section| section != "scene").collect();
                near.dedup();
            }
            let what = match own.as_str() {
                "design" | "objective" | "optimise" | "surrogate" if !self.family().has_design() => {
                    ", which has no design"
                }
                _ => "",
            };
            let bad = BadInput::new(format!("`{path}` is not a key of scene {}{what}", self.name))
                .place(place)
                .allowed(near.join(", "));
            let has = |other: &BuiltIn| described::<Config>(other.text).iter().any(|(key, _)| key == path);
            let others = SCENES.iter().filter(|other| has(other));
            let others: Vec<&str> = others.map(|other| other.name).collect();
            return Err(bad.advice(format!("leave it out, or take a scene that has it: {}", others.join(", "))));
        }
        Ok(())
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
        name: "heated-channel-3d",
        description: "the same in 3D, periodic across, with a wall over x and z",
        text: include_str!("../../data/scenes/heated-channel-3d.toml"),
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
        name: "couette",
        description:
            "2D flow between plane walls whose upper one begins to move, against its exact solution (no design)",
        text: include_str!("../../data/scenes/couette.toml"),
    },
    BuiltIn {
        name: "reverse-poiseuille",
        description: "2D opposite streams in a periodic box, against their exact solution (no design)",
        text: include_str!("../../data/scenes/reverse-poiseuille.toml"),
    },
    BuiltIn {
        name: "reverse-poiseuille-3d",
        description: "the same in a box that is thin and periodic in z (no design)",
        text: include_str!("../../data/scenes/reverse-poiseuille-3d.toml"),
    },
    BuiltIn {
        name: "lid-driven-cavity",
        description: "2D vortex in a box whose upper wall moves, without a closed form (no design)",
        text: include_str!("../../data/scenes/lid-driven-cavity.toml"),
    },
    BuiltIn {
        name: "lid-driven-cavity-3d",
        description: "the same in a cube (no design)",
        text: include_str!("../../data/scenes/lid-driven-cavity-3d.toml"),
    },
    BuiltIn {
        name: "slab",
        description: "2D heat conduction in one or two materials at rest, against its exact solution (no design)",
        text: include_str!("../../data/scenes/slab.toml"),
    },
    BuiltIn {
        name: "isothermal-channel",
        description: "2D developed flow between warm walls, against the exact Nusselt number (no design)",
        text: include_str!("../../data/scenes/isothermal-channel.toml"),
    },
    BuiltIn {
        name: "dam-break",
        description: "2D column of water that collapses in a tank, with a free surface (no design)",
        text: include_str!("../../data/scenes/dam-break.toml"),
    },
    BuiltIn {
        name: "dam-break-3d",
        description: "the same in 3D, periodic across (no design)",
        text: include_str!("../../data/scenes/dam-break-3d.toml"),
    },
    BuiltIn {
        name: "falling-block",
        description: "2D block of water that falls into an empty tank (no design)",
        text: include_str!("../../data/scenes/falling-block.toml"),
    },
    BuiltIn {
        name: "hydrostatic-tank",
        description: "2D still water under gravity, against its exact pressure (no design)",
        text: include_str!("../../data/scenes/hydrostatic-tank.toml"),
    },
    BuiltIn {
        name: "custom",
        description: "a box, walls of any shape, forces and heat of your own, all from the file (no design)",
        text: include_str!("../../data/scenes/custom.toml"),
    },
];

/// Sets of keys laid over a scene with `--preset`.
pub const PRESETS: &[BuiltIn] = &[
    BuiltIn {
        name: "report",
        description:
            "the original report's experiment: height 0.26, 2000 small steps from rest, 10 epochs of a whole spacing",
        text: include_str!("../../data/scenes/presets/report.toml"),
    },
    BuiltIn {
        name: "report-jax-sph",
        description: "the same with the report's own equations, JAX-SPH's (950 particles)",
        text: include_str!("../../data/scenes/presets/report-jax-sph.toml"),
    },
];

/// The built-in scene of that name.
pub fn scene(name: &str) -> Option<&'static BuiltIn> {
    SCENES.iter().find(|scene| scene.name == name)
}

impl Family {
    /// The built-in scene of this family.
    pub fn built_in(self) -> &'static BuiltIn {
        scene(self.name()).expect("every family has a built-in scene of its name")
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
        .ok_or_else(|| unknown("preset", name, PRESETS).place(format!("preset {name}")))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_and_their_scenes_have_the_same_name() {
        for built_in in SCENES {
            let family = built_in.family();
            assert_eq!(family.name(), built_in.name);
            assert_eq!(family.built_in(), built_in);
            assert_eq!(family.defaults().scene, family);
            assert_eq!(
                toml::Value::try_from(family).unwrap().as_str(),
                Some(built_in.name),
                "as the key `scene` has it"
            );
        }
    }
}
