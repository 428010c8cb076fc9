//! The scenes and presets that are compiled into the program. Their texts are in `data/scenes/`.

use crate::config::layers::{Layer, Merged, Methods};
use crate::config::method::kind::Facts;
use crate::config::method::METHODS;
use crate::config::scene::{Config, Family};
use crate::config::schema::described;
use crate::config::suggest;
use crate::error::BadInput;
use std::collections::BTreeMap;
use std::sync::LazyLock;
use toml_edit::{DocumentMut, Item, Table};

/// A TOML text with a name.
#[derive(Debug, PartialEq, Eq)]
pub struct BuiltIn {
    pub name: &'static str,
    pub description: &'static str,
    /// The text in `data/scenes`. That of a scene has a section `[methods.NAME]` for each method that can solve it.
    written: &'static str,
}

/// Data derived from a scene's text: the complete text with the section `[method]`, its document, and its keys.
struct Complete {
    document: DocumentMut,
    text: String,
    methods: Methods,
    keys: Vec<String>,
}

static COMPLETE: LazyLock<BTreeMap<&str, Complete>> =
    LazyLock::new(|| SCENES.iter().map(|scene| (scene.name, Complete::of(scene.written))).collect());

impl Complete {
    fn of(written: &str) -> Self {
        let mut document: DocumentMut = format!("{written}\n{RUN}").parse().expect("a built-in scene is TOML");
        let values = document.remove("methods").and_then(|item| item.into_table().ok()).unwrap_or_default();
        let values: Vec<(&Facts, &Table)> = values
            .iter()
            .filter_map(|(name, item)| {
                let facts = METHODS.iter().find(|facts| facts.name == name)?;
                Some((*facts, item.as_table()?))
            })
            .collect();
        let table = |chosen: &(&'static Facts, &Table)| (chosen.0.name, method_table(chosen, &values));
        let methods: Methods = values.iter().map(table).collect();
        document.insert("method", Item::Table(methods[0].1.clone()));
        let text = document.to_string();
        let keys = described::<Config>(&text).into_iter().map(|(path, _)| path).collect();
        Self { document, text, methods, keys }
    }
}

/// The section `[method]` with the keys of one method, and those of the other methods as comments at its end.
fn method_table((chosen, own): &(&'static Facts, &Table), all: &[(&Facts, &Table)]) -> Table {
    let about = |facts: &Facts| format!("#   {} ({})\n", facts.name, facts.about);
    let about = all.iter().map(|(facts, _)| about(facts)).collect::<String>();
    let mut table: Table =
        format!("# How the scene is solved. One of:\n{about}name = \"{}\"\n{}", chosen.name, chosen.text)
            .parse::<DocumentMut>()
            .expect("a method's text is TOML")
            .as_table()
            .clone();
    keep_values(&mut table, own);
    table.set_position(own.position());
    table.decor_mut().set_prefix("\n");
    let mut others = String::new();
    for (facts, values) in all.iter().filter(|(facts, _)| facts.name != chosen.name) {
        let mut keys = facts.text.parse::<DocumentMut>().expect("a method's text is TOML");
        keep_values(&mut keys, values);
        others += &format!("\n#\n# Instead, with these keys:\n# name = \"{}\"", facts.name);
        for line in keys.to_string().lines() {
            others += &format!("\n# {}", line.trim_start_matches("# "));
        }
    }
    let last = table.iter_mut().last().and_then(|(_, item)| item.as_value_mut().map(toml_edit::Value::decor_mut));
    last.expect("a method has a name").set_suffix(others);
    table
}

/// Gives keys the values of a scene, and removes keys for which it has none.
fn keep_values(table: &mut Table, values: &Table) {
    table.retain(|key, item| match (item.as_value_mut(), values.get(key).and_then(Item::as_value)) {
        (Some(value), Some(given)) => {
            let decor = value.decor().clone();
            *value = given.clone();
            *value.decor_mut() = decor;
            true
        }
        _ => key == "name",
    });
}

impl BuiltIn {
    /// The complete text of a scene with its default method, or the text of a preset.
    pub fn text(&self) -> &'static str {
        COMPLETE.get(self.name).map_or(self.written, |complete| &complete.text)
    }

    /// The scene as the base of further layers.
    pub fn merged(&self) -> Merged {
        let complete = &COMPLETE[self.name];
        Merged::with_methods(complete.document.clone(), complete.methods.clone())
    }

    pub fn family(&self) -> Family {
        toml::from_str::<Config>(self.text()).expect("a built-in scene is a configuration").scene
    }

    /// The keys of a scene, including those of all methods.
    fn keys(&self) -> &'static [String] {
        &COMPLETE[self.name].keys
    }

    /// The names of the methods that can solve a scene; the first is the default.
    pub fn methods(&self) -> Vec<&'static str> {
        COMPLETE[self.name].methods.iter().map(|(name, _)| *name).collect()
    }

    /// Checks that the scene uses all keys of a layer, and that the layer does not name another scene.
    pub fn accepts(&self, layer: &Layer) -> Result<(), BadInput> {
        let keys = self.keys();
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
            let others = SCENES.iter().filter(|other| other.keys().iter().any(|key| key == path));
            let others: Vec<&str> = others.map(|other| other.name).collect();
            return Err(bad.advice(format!(
                "leave it out (`hydrograd scenes {}` prints every key), or take a scene that has it: {}",
                self.name,
                others.join(", ")
            )));
        }
        Ok(())
    }
}

/// A text of `data/scenes` or of a folder in it.
macro_rules! built_in {
    ($name:literal, $description:literal $(, $folder:literal)?) => {
        BuiltIn {
            name: $name,
            description: $description,
            written: include_str!(concat!("../../data/scenes/", $($folder,)? $name, ".toml")),
        }
    };
}

/// The section `[run]`, which is the same in every scene.
const RUN: &str = include_str!("../../data/run.toml");

/// Complete scenes, one per [`Family`] in its order, with every key of the family (unset keys are commented out). The first is the
/// default.
pub const SCENES: &[BuiltIn] = &[
    built_in!(
        "heated-channel",
        "2D channel with a hot section in the bottom wall whose shape is optimised for heat transfer"
    ),
    built_in!("heated-channel-3d", "the same in 3D, periodic across, with a wall over x and z"),
    built_in!("taylor-green", "2D decaying vortices in a periodic box, against their exact solution (no design)"),
    built_in!("taylor-green-3d", "the same in 3D, without a closed form (no design)"),
    built_in!("poiseuille", "2D flow between plane walls from rest, against its exact solution (no design)"),
    built_in!(
        "couette",
        "2D flow between plane walls whose upper one begins to move, against its exact solution (no design)"
    ),
    built_in!("reverse-poiseuille", "2D opposite streams in a periodic box, against their exact solution (no design)"),
    built_in!("reverse-poiseuille-3d", "the same in a box that is thin and periodic in z (no design)"),
    built_in!("lid-driven-cavity", "2D vortex in a box whose upper wall moves, without a closed form (no design)"),
    built_in!("lid-driven-cavity-3d", "the same in a cube (no design)"),
    built_in!("slab", "2D heat conduction in one or two materials at rest, against its exact solution (no design)"),
    built_in!(
        "isothermal-channel",
        "2D developed flow between warm walls, against the exact Nusselt number (no design)"
    ),
    built_in!("dam-break", "2D column of water that collapses in a tank, with a free surface (no design)"),
    built_in!("dam-break-3d", "the same in 3D, periodic across (no design)"),
    built_in!("falling-block", "2D block of water that falls into an empty tank (no design)"),
    built_in!("hydrostatic-tank", "2D still water under gravity, against its exact pressure (no design)"),
    built_in!(
        "custom",
        "a box, walls of any shape, forces and heat of your own, all from the file; its shapes may be a design"
    ),
];

/// Scenes of scene `custom` with an answer of their own: files over it, which have names too.
pub const EXAMPLES: &[BuiltIn] = &[
    built_in!(
        "heated-cavity",
        "2D flow in a square cavity between a hot and a cold wall, by buoyancy (Nusselt number known)"
    ),
    built_in!(
        "shaped-floor",
        "the same above a warm floor, whose shape `optimize` changes: most heat at a fixed cross-section"
    ),
    built_in!(
        "rotating-cylinder",
        "2D vortices behind a cylinder that turns back and forth; its amplitude and frequency may be optimised for drag"
    ),
    built_in!("schaefer-turek-1", "2D steady flow past a cylinder in a channel, Re = 20 (drag and lift known)"),
    built_in!("schaefer-turek-2", "the same at Re = 100, with vortices (drag, lift and frequency known)"),
    built_in!("schaefer-turek-3", "the same with an inflow that comes and goes (drag, lift and pressure known)"),
    built_in!("sphere-array", "3D slow flow through a cubic array of spheres (drag known)"),
    built_in!(
        "vortex-street",
        "2D vortices behind a cylinder in an open stream, Re = 100 (frequency, drag and lift known)"
    ),
];

/// Presets: sets of keys that `--preset` merges into a scene.
pub const PRESETS: &[BuiltIn] = &[
    built_in!(
        "report",
        "the original report's experiment: height 0.26, 2000 small steps from rest, 10 epochs of a whole spacing",
        "presets/"
    ),
    built_in!("report-jax-sph", "the same with the report's own equations, JAX-SPH's (950 particles)", "presets/"),
];

fn named(all: &'static [BuiltIn], name: &str) -> Option<&'static BuiltIn> {
    all.iter().find(|one| one.name == name)
}

pub fn example(name: &str) -> Option<&'static BuiltIn> {
    named(EXAMPLES, name)
}

pub fn scene(name: &str) -> Option<&'static BuiltIn> {
    named(SCENES, name)
}

pub fn scene_or_example(name: &str) -> Option<&'static BuiltIn> {
    scene(name).or_else(|| example(name))
}

impl Family {
    pub fn built_in(self) -> &'static BuiltIn {
        &SCENES[self as usize]
    }

    pub fn name(self) -> &'static str {
        self.built_in().name
    }

    /// The configuration of the built-in scene.
    pub fn defaults(self) -> Config {
        toml::from_str(self.built_in().text()).expect("a built-in scene is a configuration")
    }

    /// The configuration of the built-in scene with another method; the default if that cannot solve it.
    pub fn defaults_with(self, method: &str) -> Config {
        let mut merged = self.built_in().merged();
        if self.built_in().methods().contains(&method) {
            merged.choose(method, "");
        }
        merged.read()
    }
}

/// The preset with a name, or an error that lists the names.
pub fn preset(name: &str) -> Result<&'static BuiltIn, BadInput> {
    named(PRESETS, name).ok_or_else(|| unknown("preset", name, PRESETS).place(format!("preset {name}")))
}

/// The error for an unknown name, with the known names and the nearest one.
pub fn unknown(kind: &str, name: &str, known: &[BuiltIn]) -> BadInput {
    let names: Vec<&str> = known.iter().map(|known| known.name).collect();
    let bad = BadInput::new(format!("there is no {kind} `{name}`")).allowed(names.join(", "));
    match suggest::nearest(name, &names) {
        Some(near) => bad.advice(format!("`{near}`")),
        None => bad.advice("`hydrograd scenes` describes them"),
    }
}
