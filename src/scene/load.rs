//! Loads a checked configuration from a scene's name or file, a preset and settings.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use toml_edit::{Array, Value};

use super::build_design;
use super::plausible::Findings;
use crate::config::before;
use crate::config::builtin;
use crate::config::builtin::{BuiltIn, SCENES};
use crate::config::custom::SideKind;
use crate::config::difference::differences;
use crate::config::layers::{Layer, Merged, Setting};
use crate::config::method::kind::Given;
use crate::config::method::Method;
use crate::config::range::WHOLE;
use crate::config::scene::{Config, DesignWalls, DynamicsName, Family, GradientMode, Search, Start, Trust};
use crate::config::schema::{values, Schema};
use crate::config::stability::AUTO;
use crate::config::suggest::{alternatives, assignments, changed};
use crate::design::parametrisations::SplineSurface;
use crate::design::shape::{self, Shape, ROUGH_SMOOTHING_LENGTH};
use crate::design::{start_shape, Scheduled};
use crate::error::{BadInput, Error};
use crate::io::csv::read_columns;
use crate::io::stl;
use crate::sph::Sweeps;

/// The origin of a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    BuiltIn(&'static str),
    File(PathBuf),
}

impl Source {
    /// A short name for folders: that of the scene, or that of the file without folder and extension.
    pub fn name(&self) -> String {
        match self {
            Self::BuiltIn(name) => name.to_string(),
            Self::File(path) => path.file_stem().unwrap_or_default().to_string_lossy().into(),
        }
    }

    /// The scene as an argument of a command.
    pub fn argument(&self) -> String {
        match self {
            Self::BuiltIn(name) => name.to_string(),
            Self::File(path) => path.display().to_string(),
        }
    }
}

impl std::fmt::Display for Source {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::BuiltIn(name) => write!(out, "built-in scene {name}"),
            Self::File(path) => write!(out, "{}", path.display()),
        }
    }
}

/// A checked configuration with the text that reproduces it.
#[derive(Debug, Clone)]
pub struct Loaded {
    pub config: Config,
    /// The resolved TOML: every key, with the built-in scene's comments. It reads back to `config` even when the files
    /// that it came from are gone (a `design.file` is copied into `nodes` and `offsets`).
    pub text: String,
    pub source: Source,
    places: BTreeMap<String, String>,
    /// The given values, before defaults were adapted to them.
    given: Merged,
}

impl Config {
    /// Loads and checks a configuration.
    ///
    /// Later layers take precedence: the built-in scene, the preset, the user's file, each of `sets`
    /// (`section.key=value`). Within `{time.end, time.steps}` and `{design.shape, design.offsets, design.file}`
    /// the last layer that gives one of them replaces the others.
    ///
    /// * `scene_or_file`: name of a built-in scene or path of a TOML file; default `heated-channel`.
    /// * `preset`: name of a built-in preset.
    ///
    /// Errors: anything a user can get wrong, as [`Error::Input`].
    pub fn load(scene_or_file: Option<&str>, preset: Option<&str>, sets: &[String]) -> Result<Loaded, Error> {
        let settings: Vec<Setting> = sets.iter().map(|text| Setting::set(text)).collect();
        Self::load_settings(scene_or_file, preset, &settings)
    }

    /// [`Config::load`] for settings that carry the names of command-line options for error messages.
    ///
    /// The alternatives in the advice of an error are tried: those that lead to the same error are left out, see `completed`.
    pub fn load_settings(
        scene_or_file: Option<&str>,
        preset: Option<&str>,
        settings: &[Setting],
    ) -> Result<Loaded, Error> {
        Self::load_once(scene_or_file, preset, settings).map_err(|bad| {
            let load = |more: &[Setting]| Self::load_once(scene_or_file, preset, &[settings, more].concat());
            bad.clone().readvised(|advice| changed(advice, |one, sets| completed(one, sets, &bad, &load))).into()
        })
    }

    fn load_once(scene_or_file: Option<&str>, preset: Option<&str>, settings: &[Setting]) -> Result<Loaded, BadInput> {
        let (base, file, source) = open(scene_or_file.unwrap_or(SCENES[0].name))?;
        let mut merged = base.merged();
        if let Some(name) = preset {
            let preset = builtin::preset(name)?;
            let layer = Layer::from_text::<Config>(&format!("preset {name}"), preset.text())?;
            base.accepts(&layer)?;
            merged.apply::<Config>(&layer);
        }
        if let Some(layer) = file {
            base.accepts(&layer)?;
            if base.name == SCENES[0].name && is_from_before(&layer) {
                for (key, value) in before::FIRST {
                    merged.apply::<Config>(&Layer::from_setting::<Config>(&Setting::option(
                        "a file of before,",
                        key,
                        value,
                    ))?);
                }
            }
            merged.apply::<Config>(&layer);
        }
        for setting in settings {
            let layer = merged.layer::<Config>(setting).map_err(|bad| with_help(bad, base))?;
            base.accepts(&layer)?;
            merged.apply::<Config>(&layer);
        }
        finish(merged, source)
    }

    /// The settings that make this configuration from its built-in scene, except for the keys and sections in `free`.
    pub fn over_its_scene(&self, label: &str, free: &[&str]) -> Vec<Setting> {
        let usual = self.scene.defaults_with(self.method.name());
        let found = differences(&usual, self, &[free, &["scene"]].concat());
        let method = Setting::option(label, "method.name", self.method.name());
        std::iter::once(method).chain(found.into_iter().map(|d| Setting::option(label, &d.key, d.now))).collect()
    }
}

impl Loaded {
    /// Where a key was set; none if it has its default.
    pub fn place(&self, key: &str) -> Option<&str> {
        self.places.get(key).map(String::as_str)
    }

    /// Adds the place where the key of an error was set.
    pub fn located(&self, bad: BadInput) -> BadInput {
        bad.located(|key| self.place(key).map(str::to_owned))
    }

    /// [`Self::located`] for any error; only those about input change.
    pub fn located_error(&self, error: Error) -> Error {
        match error {
            Error::Input(bad) => self.located(*bad).into(),
            other => other,
        }
    }

    /// Advice without what this scene refuses, what is in force already, and what does not make steps shorter where it
    /// should; empty if nothing is left.
    pub fn possible(&self, advice: &str) -> String {
        changed(advice, |one, assignments| {
            let settings: Vec<Setting> = assignments.iter().copied().map(Setting::set).collect();
            let is_of_step =
                |one: &&str| ["time.cfl=", "time.diffusion_number="].iter().any(|key| one.starts_with(key));
            let (shorter, now) = (assignments.iter().any(is_of_step), &self.config);
            let helps = self.with(&settings).is_ok_and(|other| {
                other.config != *now && (!shorter || other.config.time_step() < now.time_step() * (1.0 - WHOLE))
            });
            helps.then(|| one.to_string())
        })
    }

    /// An error of a run of this scene with the advice that is [`Self::possible`]. That of a divergence begins with
    /// something to set: if all else is in force, steps of half the length.
    pub fn advised(&self, error: Error) -> Error {
        match error {
            Error::Input(bad) => bad.readvised(|advice| self.possible(advice)).into(),
            Error::Run { problem, advice } => Error::Run { problem, advice: self.possible(&advice) },
            Error::Diverged { problem, advice, offence } => {
                let (bad, load) = (BadInput::new(problem.as_str()), |settings: &[Setting]| self.with(settings));
                let mut advice = changed(&self.possible(&advice), |one, sets| completed(one, sets, &bad, &load));
                if assignments(&advice).is_empty() && !self.config.is_around_shapes() {
                    let half = format!("time.step={:.2e}", 0.5 * self.config.time_step());
                    advice = if advice.is_empty() { half } else { format!("{half}, or {advice}") };
                }
                Error::Diverged { problem, advice, offence }
            }
            Error::Stopped => Error::Stopped,
        }
    }

    /// The same configuration with further settings, such as those of each start of `--start all`. Defaults are derived
    /// anew. If the settings choose another method, keys that it lacks are dropped.
    pub fn with(&self, settings: &[Setting]) -> Result<Self, BadInput> {
        let mut merged = self.given.clone();
        for setting in settings {
            let layer = merged.layer::<Config>(setting)?;
            self.config.scene.built_in().accepts(&layer)?;
            merged.apply::<Config>(&layer);
        }
        merged.free_method();
        finish(merged, self.source.clone())
    }

    /// The given values as TOML, without defaults, which later settings may change.
    pub fn given_text(&self) -> String {
        let mut given = self.given.clone();
        let all: toml::Table = given.text().parse().expect("a configuration's text is TOML");
        for (section, keys) in &all {
            for key in keys.as_table().into_iter().flat_map(toml::Table::keys) {
                let path = format!("{section}.{key}");
                if !given.places().contains_key(&path) {
                    given.remove(&path);
                }
            }
        }
        given.text()
    }

    /// The setting that keeps the end time when the time step changes, for a run with a given number of steps.
    pub fn same_time(&self) -> Option<Setting> {
        let config = &self.config;
        config.time.steps.map(|_| Setting::set(&format!("time.end={}", config.duration())))
    }

    /// The configuration with which an optimiser searches, see [`Search`].
    pub fn for_search(&self) -> Result<Self, Error> {
        let (facts, methods) = (self.config.method.facts(), self.config.scene.built_in().methods());
        let fixed = facts.counterpart.filter(|other| facts.moves && methods.contains(other));
        match (self.config.optimise.search, fixed) {
            // In three dimensions fixed particles are those that are asked for.
            (Search::Fixed, Some(_)) if self.config.dimension() == 3 => Ok(self.clone()),
            (Search::Fixed, Some(fixed)) if self.config.scene == Family::Custom => {
                // Only steady scenes, without formulas for shapes, have fixed particles.
                Ok(self.with(&[Setting::set(&format!("method.name={fixed}"))]).unwrap_or_else(|_| self.clone()))
            }
            (Search::Fixed, Some(fixed)) => {
                let mut settings = vec![Setting::set(&format!("method.name={fixed}"))];
                settings.extend(self.same_time());
                // The steady state does not need a schedule, so a chosen schedule decides for segments. (Chosen is what
                // differs from the default, because the configuration of a run gives every key.)
                let (optimise, usual) = (&self.config.optimise, Config::default().optimise);
                let chosen =
                    optimise.segment != usual.segment || optimise.store != usual.store || optimise.clip != usual.clip;
                // A run that ends before its flow is steady is optimised for its end.
                let (flow, time) = (&self.config.fluid.reference_velocity, &self.config.time);
                let passages = self.config.duration() * flow / self.config.channel.length;
                let settles = passages >= if time.start == Start::Rest { 4.0 } else { 2.0 };
                if optimise.gradient == GradientMode::Segments && !chosen && settles {
                    settings.push(Setting::set("optimise.gradient=steady"));
                }
                // Keeps window and samples, as far as the other time step allows, instead of their defaults for it.
                let (objective, step) = (&self.config.objective, self.with(&settings)?.config.time_step());
                let steps = (objective.window / step).round().max(1.0) as usize;
                settings.push(Setting::set(&format!("objective.window={}", objective.window)));
                settings.push(Setting::set(&format!("objective.samples={}", objective.samples.min(steps))));
                Ok(self.with(&settings)?)
            }
            _ => Ok(self.clone()),
        }
    }

    /// The design problem that `optimise.search` chooses, with the schedule of its gradient.
    pub fn scheduled<R: Sweeps>(&self) -> Result<Scheduled<R>, Error> {
        let located = |error| self.located_error(error);
        let (problem, _) = build_design::<R>(&self.for_search()?.config).map_err(located)?;
        let schedule = problem.schedule(&self.config.optimise, self.config.run.precision).map_err(located)?;
        Ok(Scheduled { problem, schedule })
    }
}

type Load<'a> = dyn Fn(&[Setting]) -> Result<Loaded, BadInput> + 'a;

/// A suggestion against the error `bad` with all that the scene needs besides, as far as can be told before it runs; none
/// if it does not help.
fn completed(one: &str, first: &[&str], bad: &BadInput, load: &Load<'_>) -> Option<String> {
    let key = |set: &str| set.split_once('=').map(|(key, _)| key.to_string());
    let (mut all, mut good): (Vec<String>, _) = (first.iter().map(|set| set.to_string()).collect(), None);
    // More than five things at once are no suggestion any more.
    for round in 0..5 {
        let next = match load(&all.iter().map(|set| Setting::set(set)).collect::<Vec<_>>()) {
            Ok(loaded) => {
                good = Some(all.clone());
                Findings::expected_flaw(&loaded.config).ok()?.map_or(String::new(), |flaw| flaw.advice)
            }
            Err(other) if other.key == bad.key || all.iter().any(|set| key(set) == other.key) => {
                return (round > 0).then(|| one.to_string())
            }
            Err(other) => other.advice.unwrap_or_default(),
        };
        for set in alternatives(&next).into_iter().map(assignments).find(|sets| !sets.is_empty()).unwrap_or_default() {
            match all.iter_mut().find(|old| key(old) == key(set)) {
                Some(old) => *old = set.to_string(),
                None => all.push(set.to_string()),
            }
        }
        if good.as_ref() == Some(&all) {
            break;
        }
    }
    let Some(good) = good else { return Some(one.to_string()) };
    let same = first.iter().zip(&good).fold(one.to_string(), |text, (old, new)| text.replace(old, new));
    let more = good[first.len()..].join(" ");
    Some(if more.is_empty() { same } else { format!("{same} and {more} (else it may fail next)") })
}

/// Number of keys of the shortest complete configuration of the heated channel.
const COMPLETE: usize = 40;

/// Whether a file is the complete configuration of an old run, from before methods could be chosen.
fn is_from_before(layer: &Layer) -> bool {
    layer.keys().count() >= COMPLETE && !layer.keys().any(|(key, _)| key == "method.name")
}

/// The built-in scene of a name or file, and the user's file as a layer.
fn open(name: &str) -> Result<(&'static BuiltIn, Option<Layer>, Source), BadInput> {
    if let Some(scene) = builtin::scene(name) {
        return Ok((scene, None, Source::BuiltIn(scene.name)));
    }
    if let Some(example) = builtin::example(name) {
        let layer = Layer::from_text::<Config>(name, example.text())?;
        return Ok((Family::Custom.built_in(), Some(layer), Source::BuiltIn(example.name)));
    }
    let path = Path::new(name);
    let text = std::fs::read_to_string(path).map_err(|error| unreadable(name, path, &error))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let of_scene = |line: &str| Some(line.trim().strip_prefix("scene")?.trim().strip_prefix('=')?.trim().to_string());
    let said = text.lines().find_map(of_scene).unwrap_or_default();
    let base = builtin::scene(said.trim_matches(['"', '\''])).unwrap_or(&SCENES[0]);
    let layer = Layer::from_text::<Config>(name, &text).map_err(|bad| with_help(bad, base))?;
    if layer.is_empty() {
        return Err(BadInput::new(format!("{name} is a file without a key"))
            .allowed("a scene: the key `scene`, and those keys that differ from the built-in scene of that name")
            .advice(format!("hydrograd scenes {} > my.toml", base.name)));
    }
    let mut layer = layer
        .change("design.file", |file| folder.join(file).to_string_lossy().into())
        .change("initial.file", |file| folder.join(file).to_string_lossy().into())
        .change("surrogate.model", |file| folder.join(file).to_string_lossy().into());
    layer.change_value("shapes", |shapes| read_shapes(shapes, folder))?;
    let family = layer.string("scene").unwrap_or(SCENES[0].name);
    // The file was read as a Config, so its family exists.
    let scene = builtin::scene(family).expect("every scene family has a built-in scene");
    Ok((scene, Some(layer), Source::File(path.to_path_buf())))
}

/// The files of shapes.
const OF_FILES: &str = "a CSV file with columns x and y; an STL file (.stl) with a closed surface";

/// Replaces shapes of kind "file" by the polygons in their files, and says where the triangles in theirs are.
fn read_shapes(shapes: &mut Value, folder: &Path) -> Result<(), BadInput> {
    let all = shapes.as_array_mut().into_iter().flat_map(Array::iter_mut);
    for (k, shape) in all.enumerate() {
        let Some(shape) = shape.as_inline_table_mut() else { continue };
        if shape.get("kind").and_then(Value::as_str) != Some("file") {
            continue;
        }
        let key = format!("shapes[{k}].file");
        let Some(file) = shape.get("file").and_then(Value::as_str).map(|file| folder.join(file)) else {
            return Err(BadInput::at(&key, format!("{key} is missing")).allowed(OF_FILES));
        };
        if file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("stl")) {
            let triangles =
                stl::read(&file).map_err(|error| BadInput::at(&key, error.to_string()).allowed(OF_FILES))?;
            let (_, centre) = triangles.volume();
            // The configuration of a run is later read from another folder.
            let file = std::path::absolute(&file).unwrap_or(file);
            shape.insert("file", file.to_string_lossy().into_owned().into());
            // What is not given is as in the file, so that variables can change it.
            for (name, value) in [
                ("centre", Value::Array(Array::from_iter(centre))),
                ("scale", Value::from(1.0)),
                ("angle", Value::from(0.0)),
            ] {
                if !shape.contains_key(name) {
                    shape.insert(name, value);
                }
            }
            continue;
        }
        let columns = read_columns(&file, &["x", "y"])
            .map_err(|error| BadInput::at(&key, error.to_string()).allowed(OF_FILES))?;
        let mut points = columns[0].iter().zip(&columns[1]).map(|(x, y)| [*x, *y]).collect::<Vec<[f64; 2]>>();
        // A closed line may end where it began.
        if points.len() > 1 && points.first() == points.last() {
            points.pop();
        }
        shape.remove("file");
        shape.insert("kind", "polygon".into());
        shape.insert("points", Value::Array(points.iter().map(|p| Value::Array(Array::from_iter(*p))).collect()));
    }
    Ok(())
}

/// An error whose advice is where every key is explained, for this scene.
fn with_help(bad: BadInput, base: &BuiltIn) -> BadInput {
    bad.readvised(|advice| advice.replace(&format!("scenes {}`", SCENES[0].name), &format!("scenes {}`", base.name)))
}

fn unreadable(name: &str, path: &Path, error: &std::io::Error) -> BadInput {
    let scenes: Vec<&str> = SCENES.iter().map(|scene| scene.name).collect();
    let allowed = format!("a built-in scene ({}) or the path of a TOML file", scenes.join(", "));
    if path.is_dir() {
        let config = path.join("config.toml");
        let bad = BadInput::new(format!("`{name}` is a folder, not a scene")).allowed(allowed);
        return match config.is_file() {
            true => bad.advice(format!("the configuration of that run: {}", config.display())),
            false => bad,
        };
    }
    let looks_like_a_name = !name.contains(['/', '\\', '.']);
    if error.kind() == std::io::ErrorKind::NotFound && looks_like_a_name {
        return builtin::unknown("scene or file", name, SCENES).allowed(allowed);
    }
    let problem = match error.kind() {
        std::io::ErrorKind::NotFound => format!("no such file: {name}"),
        std::io::ErrorKind::InvalidData => format!("{name} is not a text file (UTF-8)"),
        _ => format!("can not read {name}: {error}"),
    };
    BadInput::new(problem).allowed(allowed).advice(format!("hydrograd scenes {} > my.toml", SCENES[0].name))
}

fn finish(mut merged: Merged, source: Source) -> Result<Loaded, BadInput> {
    merged.check_method()?;
    let mut config: Config = merged.read();
    if let Some(file) = config.design.file.clone().filter(|_| config.scene == Family::HeatedChannel) {
        if config.design.offsets.is_none() && config.design.nodes.is_none() {
            let columns =
                shape::read_columns(Path::new(&file)).map_err(|bad| match merged.places().get("design.file") {
                    Some(place) => bad.advice(format!("design.file was given by {place}")),
                    None => bad,
                })?;
            merged.remove("design.file");
            let array = |numbers: Vec<f64>| Value::Array(Array::from_iter(numbers));
            merged.set("design.nodes", array(columns.nodes), &file);
            merged.set("design.offsets", array(columns.offsets), &file);
            // If no layer chooses the walls, the file does.
            let says = |key: &str| merged.places().contains_key(key);
            let (walls, offsets) = (says("design.walls"), says("design.top_offsets"));
            let takes = config.design.walls == DesignWalls::Both || !walls;
            if let Some(top) = shape::read_column(Path::new(&file), shape::TOP, false)?.filter(|_| takes && !offsets) {
                merged.set("design.top_offsets", array(top.offsets), &file);
                merged.set("design.walls", Value::from("both"), &file);
            }
            config = merged.read();
        }
    }
    // The configuration of a run is later read from another folder.
    if let Some(model) = config.surrogate.model.clone().filter(|model| Path::new(model).is_relative()) {
        let place = merged.places().get("surrogate.model").cloned().unwrap_or_default();
        if let Ok(absolute) = std::path::absolute(&model) {
            merged.set("surrogate.model", Value::from(absolute.to_string_lossy().into_owned()), &place);
            config = merged.read();
        }
    }
    // Not every method supports two materials.
    if config.scene == Family::Slab && !merged.places().contains_key("method.name") {
        let place = ["heat.conductivity_ratio", "heat.capacity_ratio"]
            .into_iter()
            .zip([config.heat.conductivity_ratio, config.heat.capacity_ratio]);
        if let Some((key, _)) = place.into_iter().find(|(_, ratio)| *ratio != 1.0) {
            if let Some(able) = Method::that(|can| can.two_materials).first() {
                merged.choose(able, key);
                config = merged.read();
            }
        }
    }
    let mut given = merged.clone();
    // A scene's default method already has its defaults.
    if config.scene.built_in().methods()[0] != config.method.name() {
        given_sides(&mut merged, &config);
        method_defaults(&mut merged, &config);
        config = merged.read();
    }
    if merged.is_text("time.cfl", AUTO) {
        merged.set("time.cfl", Value::from(config.cfl_limit().safe), "time.cfl = \"auto\"");
        config = merged.read();
    }
    if config.scene.has_design() {
        // Surrogates err for rough walls, which an optimiser of many nodes exploits.
        let says = merged.places().contains_key("design.parametrisation");
        if config.optimise.dynamics != DynamicsName::Solver && !says {
            merged.set("design.parametrisation", Value::from("b-spline"), "optimise.dynamics");
            config = merged.read();
        }
        // If the solver corrects each proposal, early and given frames are accurate enough, for a tenth of the steps.
        if config.surrogate.trust == Trust::Region {
            for (key, value) in [("settle", Value::from(300)), ("first_frames", Value::from("detached"))] {
                let key = format!("surrogate.{key}");
                if !merged.places().contains_key(&key) {
                    merged.set(&key, value, "surrogate.trust = region");
                }
            }
            config = merged.read();
        }
        fit_window(&mut merged, &config);
        // The rows of dummy particles fill the kernel, so its length comes first.
        see_further(&mut merged, &config);
        config = merged.read();
        fit_rows(&mut merged, &config);
    } else if config.has_design() {
        fit_window(&mut merged, &config);
    }
    let mut config = merged.checked(check_shape)?;
    // The fit of a wall over x and z to its file needs checked values.
    if let Some(file) = config.design.file.clone().filter(|_| config.scene == Family::HeatedChannel3d) {
        let points = start_shape::control_points(&config, &SplineSurface::of_config(&config, &[]))?;
        for all in [&mut merged, &mut given] {
            all.remove("design.file");
            all.set("design.offsets", Value::Array(Array::from_iter(points.iter().copied())), &file);
        }
        config = merged.read();
    }
    Ok(Loaded { config, text: merged.text(), source, places: merged.places().clone(), given })
}

/// Checks the wall's shape, and the values of shapes and formulas at every particle. `Config` cannot check these.
pub fn check_shape(config: &Config) -> Result<(), BadInput> {
    match config.scene {
        Family::HeatedChannel => Shape::from_config(config).map(|_| ()),
        Family::HeatedChannel3d => {
            start_shape::control_points(config, &SplineSurface::of_config(config, &[])).map(|_| ())
        }
        // Fixed particles around shapes are placed by the commands that have them.
        Family::Custom if config.is_around_shapes() => Ok(()),
        Family::Custom => super::custom::build::<f64>(config).map(|_| ()),
        _ => Ok(()),
    }
}

/// Sides that are given say which directions are periodic, if `region.periodic` does not, and that an inflow drives the flow.
fn given_sides(merged: &mut Merged, config: &Config) {
    let (sides, dimension) = (config.region.sides.all(), config.region.size.len());
    let mut periodic = config.region.periodic.clone();
    if sides.iter().any(|(_, side)| side.is_some()) {
        // The defaults are those of the plane.
        periodic.resize(dimension, false);
    }
    for (k, (_, side)) in sides.into_iter().enumerate() {
        if let (Some(side), Some(periodic)) = (side, periodic.get_mut(k / 2)) {
            *periodic = side.kind == SideKind::Periodic;
        }
    }
    if periodic != config.region.periodic && !merged.places().contains_key("region.periodic") {
        merged.set("region.periodic", Value::Array(Array::from_iter(periodic)), "region.sides");
    }
    // The body force of the scene's defaults is that of a periodic channel.
    let enters = sides.iter().any(|(_, side)| side.is_some_and(|side| side.kind == SideKind::Inflow));
    if enters && !merged.places().contains_key("region.acceleration") {
        let none = vec![0.0; dimension];
        merged.set("region.acceleration", Value::Array(Array::from_iter(none)), "region.sides");
    }
}

/// Applies the defaults of the chosen method for keys outside of its section.
fn method_defaults(merged: &mut Merged, config: &Config) {
    let place = format!("method.name = {}", config.method.name());
    let of = |config: &Config| -> BTreeMap<String, Value> { values(config).into_iter().collect() };
    let (now, usual) = (of(config), of(&config.scene.defaults()));
    let text = |of: &BTreeMap<String, Value>, key: &str| of.get(key).map(Value::to_string);
    for default in config.method.usual(config.scene.has_design()) {
        // A value in a preset or in a run's configuration may be the default of another method.
        let given = default.unless == Given::AtAll && merged.places().contains_key(default.key);
        if !given && text(&now, default.key) == text(&usual, default.key) {
            let is_whole = now.get(default.key).is_some_and(Value::is_integer);
            let value = if is_whole { Value::from(default.value as i64) } else { Value::from(default.value) };
            merged.set(default.key, value, &place);
        }
    }
}

/// Whether a layer gave a key a value that differs from the built-in one. (`hydrograd scenes NAME > my.toml` writes all
/// keys, so equal values are not choices.)
fn is_wish(merged: &Merged, key: &str, differs: bool) -> bool {
    differs && merged.places().contains_key(key)
}

/// Gives moving particles the smoothing length with which they stay between rough walls, if none is given.
fn see_further(merged: &mut Merged, config: &Config) {
    let is_given = merged.places().contains_key("resolution.smoothing_length");
    if !is_given && Shape::rough_turn(config).is_some() {
        merged.set("resolution.smoothing_length", Value::from(ROUGH_SMOOTHING_LENGTH), "a rough wall");
    }
}

/// Shortens a default window to fit a short run, and reduces its default samples to fit the window.
fn fit_window(merged: &mut Merged, config: &Config) {
    let usual = config.usual().0.objective;
    let (dx, dt, end) = (config.resolution.dx, config.time_step(), config.duration());
    if !(dx > 0.0 && dx.is_finite() && dt > 0.0 && end.is_finite()) {
        return; // `check` reports these.
    }
    let mut window = config.objective.window;
    if config.objective.periods.is_some() {
        return;
    }
    if window > end && !is_wish(merged, "objective.window", window != usual.window) {
        window = 0.25 * end;
        merged.set("objective.window", Value::from(window), "a quarter of the run");
    }
    let (samples, steps) = (config.objective.samples, ((window / dt).round() as i64).max(1));
    if samples as i64 > steps && window <= end && !is_wish(merged, "objective.samples", samples != usual.samples) {
        merged.set("objective.samples", Value::from(steps), "the steps in objective.window");
    }
}

/// Adds default rows of dummy particles for a deep wall or a wide kernel.
fn fit_rows(merged: &mut Merged, config: &Config) {
    let (dx, given) = (config.resolution.dx, config.channel.wall_rows);
    if !(dx > 0.0 && dx.is_finite()) {
        return;
    }
    let deep = if config.method.facts().wall_cells { (config.design.bound / dx - 1e-9).ceil() } else { 0.0 };
    let wide = config.least_wall_rows() as f64;
    let rows = deep.max(wide);
    let differs = given != config.usual().0.channel.wall_rows;
    if rows > given as f64 && rows < 1000.0 && !is_wish(merged, "channel.wall_rows", differs) {
        let place = if wide < deep { "design.bound / resolution.dx" } else { "the kernel's support" };
        merged.set("channel.wall_rows", Value::from(rows as i64), place);
    }
}
