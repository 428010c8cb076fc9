//! Layers of configuration: texts and `--set` options laid over a built-in scene, each checked alone first,
//! so that an error points into the text that the user wrote.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use toml_edit::{Document, DocumentMut, Item, TableLike, Value};

use crate::config::builtin::{BuiltIn, SCENES};
use crate::config::scene::Config;
use crate::config::suggest;
use crate::error::BadInput;

/// One assignment from the command line: `--set key=value`, or an option that stands for one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// What the user wrote, for messages.
    pub label: String,
    /// `section.key=value`; the value in TOML, quotes optional around a single word.
    pub assignment: String,
}

impl Setting {
    /// From the text after `--set`.
    pub fn set(assignment: &str) -> Self {
        Self { label: format!("--set {assignment}"), assignment: assignment.to_string() }
    }

    /// From another option, e.g. `--threads 2` for `run.threads=2`.
    pub fn option(option: &str, key: &str, value: impl std::fmt::Display) -> Self {
        Self { label: format!("{option} {value}"), assignment: format!("{key}={value}") }
    }
}

/// A key, its value, and where the user wrote it.
#[derive(Debug, Clone)]
struct Entry {
    path: String,
    value: Value,
    place: String,
}

/// Checked entries of one text or option.
#[derive(Debug, Clone)]
pub struct Layer {
    entries: Vec<Entry>,
}

impl Layer {
    /// Reads a whole TOML text; `name` is the file's name for messages.
    pub fn from_text(name: &str, text: &str) -> Result<Self, BadInput> {
        let spanned = Document::parse(text).map_err(|error| {
            BadInput::new(error.to_string().trim_end())
                .place(name)
                .advice("`hydrograd scenes heated-channel` prints a file to begin with")
        })?;
        let found = flatten(spanned.as_table());
        if let Err(error) = toml::from_str::<Config>(text) {
            let at = error.span().unwrap_or_default();
            let inside = |span: Range<usize>| span.contains(&at.start);
            let key = found.iter().find(|(_, item)| item.span().is_some_and(inside));
            let key = key.map(|(path, _)| path.clone());
            return Err(explain(&error, &error.to_string(), key.as_deref()).place(name));
        }
        let places: Vec<String> = found
            .iter()
            .map(|(_, item)| {
                let start = item.span().map_or(0, |span| span.start);
                format!("{name}, line {}", text[..start].matches('\n').count() + 1)
            })
            .collect();
        // Values cloned from a spanned document would refer to its text; the mutable form owns them.
        let owned = spanned.into_mut();
        let entries = flatten(owned.as_table())
            .into_iter()
            .zip(places)
            .map(|((path, item), place)| entry(path, item, place))
            .collect::<Result<_, _>>()?;
        Ok(Self { entries })
    }

    /// Reads `section.key=value`.
    pub fn from_setting(setting: &Setting) -> Result<Self, BadInput> {
        let form = "--set section.key=value, for example --set time.end=1.5";
        let bad = |problem: String| BadInput::new(problem).place(&setting.label);
        let Some((path, text)) = setting.assignment.split_once('=') else {
            return Err(bad("there is no `=`".into()).allowed(form));
        };
        let keys: Vec<&str> = path.split('.').map(str::trim).collect();
        if keys.iter().any(|key| key.is_empty()) {
            return Err(bad(format!("`{path}` is not a key")).allowed(form));
        }
        let value = parse_value(text.trim()).map_err(|problem| bad(problem).allowed("a TOML value"))?;

        let mut document = DocumentMut::new();
        let mut item: &mut Item = document.as_item_mut();
        for key in &keys {
            item = &mut item[key];
        }
        *item = Item::Value(value);
        if let Err(error) = toml::from_str::<Config>(&document.to_string()) {
            let key = keys.join(".");
            return Err(explain(&error, error.message(), Some(&key)).place(&setting.label));
        }
        let entries = flatten(document.as_table())
            .into_iter()
            .map(|(path, item)| entry(path, item, setting.label.clone()))
            .collect::<Result<_, _>>()?;
        Ok(Self { entries })
    }

    /// Makes a relative `design.file` relative to the folder of the file that names it.
    pub fn relative_to(mut self, folder: &Path) -> Self {
        for entry in &mut self.entries {
            if let ("design.file", Some(file)) = (entry.path.as_str(), entry.value.as_str()) {
                entry.value = folder.join(file).to_string_lossy().as_ref().into();
            }
        }
        self
    }

    /// The string value of a key of this layer.
    pub fn string(&self, path: &str) -> Option<&str> {
        self.entries.iter().find(|entry| entry.path == path).and_then(|entry| entry.value.as_str())
    }

    /// An error if the scene has no use for a key of this layer, or if the layer names another scene.
    pub fn fits(&self, scene: &BuiltIn) -> Result<(), BadInput> {
        let keys: Vec<String> = described(scene.text).into_iter().map(|(path, _)| path).collect();
        for entry in &self.entries {
            let name = entry.value.as_str().unwrap_or_default();
            if entry.path == "scene" && name != scene.name {
                return Err(BadInput::new(format!("the run is one of scene {} already", scene.name))
                    .place(&entry.place)
                    .allowed("the scene as the command's argument, or in a file")
                    .advice(format!("hydrograd simulate {name}")));
            }
            if keys.contains(&entry.path) {
                continue;
            }
            let section = |path: &str| path.split('.').next().unwrap_or_default().to_string();
            let own = section(&entry.path);
            let mut near: Vec<String> = keys.iter().filter(|key| section(key) == own).cloned().collect();
            if near.is_empty() {
                near = keys.iter().map(|key| section(key)).filter(|section| section != "scene").collect();
                near.dedup();
            }
            let what = match own.as_str() {
                "design" | "objective" | "optimise" if scene.name != SCENES[0].name => ", which has no design",
                _ => "",
            };
            let bad = BadInput::new(format!("`{}` is not a key of scene {}{what}", entry.path, scene.name))
                .place(&entry.place)
                .allowed(near.join(", "));
            let others =
                SCENES.iter().filter(|other| described(other.text).iter().any(|(path, _)| *path == entry.path));
            let others: Vec<&str> = others.map(|other| other.name).collect();
            return Err(bad.advice(format!("leave it out, or take a scene that has it: {}", others.join(", "))));
        }
        Ok(())
    }

    fn has(&self, path: &str) -> bool {
        self.entries.iter().any(|entry| entry.path == path)
    }
}

/// Layers merged over a built-in scene: the text with its comments, and who set each key.
#[derive(Debug, Clone)]
pub struct Merged {
    document: DocumentMut,
    places: BTreeMap<String, String>,
}

impl Merged {
    /// Starts from a complete text (a built-in scene, or one resolved before).
    pub fn new(text: &str, places: BTreeMap<String, String>) -> Self {
        let document = text.parse().expect("a complete scene is valid TOML");
        Self { document, places }
    }

    /// Lays `layer` over what is there.
    pub fn apply(&mut self, layer: &Layer) {
        // Keys that say the same thing in different ways: the last layer that speaks wins.
        let alternatives = [
            (["time.end"].as_slice(), ["time.steps"].as_slice()),
            (&["design.shape"], &["design.offsets", "design.file"]),
            (&["design.offsets"], &["design.file"]),
            (&["design.file"], &["design.offsets", "design.nodes"]),
        ];
        for (given, replaced) in alternatives {
            if given.iter().any(|path| layer.has(path)) {
                let not_given = replaced.iter().filter(|path| !layer.has(path));
                not_given.for_each(|path| self.remove(path));
            }
        }
        for entry in &layer.entries {
            self.set(&entry.path, entry.value.clone(), &entry.place);
        }
    }

    /// Sets one key; the comment above it stays.
    pub fn set(&mut self, path: &str, mut value: Value, place: &str) {
        let (table, key) = self.table_of(path);
        match table.get_mut(key).and_then(Item::as_value_mut) {
            Some(old) => {
                *value.decor_mut() = old.decor().clone();
                *old = value;
            }
            None => {
                value.decor_mut().clear();
                table.insert(key, Item::Value(value));
            }
        }
        self.places.insert(path.to_string(), place.to_string());
    }

    pub fn remove(&mut self, path: &str) {
        let (table, key) = self.table_of(path);
        table.remove(key);
        self.places.remove(path);
    }

    fn table_of<'a>(&mut self, path: &'a str) -> (&mut toml_edit::Table, &'a str) {
        match path.split_once('.') {
            None => (self.document.as_table_mut(), path),
            Some((section, key)) => {
                let table = self.document[section].as_table_mut();
                (table.expect("a complete scene has every section"), key)
            }
        }
    }

    pub fn text(&self) -> String {
        self.document.to_string()
    }

    pub fn places(&self) -> &BTreeMap<String, String> {
        &self.places
    }
}

fn flatten(table: &dyn TableLike) -> Vec<(String, &Item)> {
    let mut found = Vec::new();
    for (key, item) in table.iter() {
        match item.as_table_like() {
            Some(inner) => found.extend(flatten(inner).into_iter().map(|(rest, item)| (format!("{key}.{rest}"), item))),
            None => found.push((key.to_string(), item)),
        }
    }
    found
}

/// An entry, if it is a value at the path of a key (serde would also read a section from an array, by position).
fn entry(path: String, item: &Item, place: String) -> Result<Entry, BadInput> {
    match item.as_value() {
        Some(value) if known_keys().contains(&path) => Ok(Entry { path, value: value.clone(), place }),
        _ => Err(BadInput::new(format!("`{path}` is a section, not a value"))
            .place(place)
            .allowed(format!("[{path}] with one line per key"))),
    }
}

/// A TOML value, a bare number such as `.5`, or a word without quotes.
fn parse_value(text: &str) -> Result<Value, String> {
    if let Ok(value) = text.parse::<Value>() {
        return Ok(value);
    }
    if text.is_empty() {
        return Err("there is no value after `=`".into());
    }
    if text.starts_with(['[', '{', '"', '\'']) {
        return Err(format!("`{text}` is not a complete TOML value"));
    }
    Ok(text.parse::<f64>().map_or_else(|_| Value::from(text), Value::from))
}

/// Every key of a configuration, as `section.key`.
pub fn known_keys() -> Vec<String> {
    let mut config = Config::default();
    config.time.steps = Some(1);
    config.design.nodes = Some(vec![]);
    config.design.offsets = Some(vec![]);
    config.design.file = Some(String::new());
    let text = toml::to_string(&config).expect("a configuration is representable in TOML");
    let document: DocumentMut = text.parse().expect("toml writes valid TOML");
    flatten(document.as_table()).into_iter().map(|(path, _)| path).collect()
}

/// The comment above a key in the first built-in scene that has it: its meaning, units and range, on one line.
pub fn description(path: &str) -> Option<String> {
    let all = SCENES.iter().flat_map(|scene| described(scene.text));
    all.filter(|(key, comment)| key == path && !comment.is_empty()).map(|(_, comment)| comment).next()
}

/// The keys of a scene's text, those commented out included, each with the comment above it.
pub fn described(text: &str) -> Vec<(String, String)> {
    let known = known_keys();
    let (mut section, mut comment, mut found) = ("", Vec::new(), Vec::new());
    for line in text.lines() {
        let bare = line.trim_start_matches("# ");
        let key = bare.split_once(" = ").map_or("", |(key, _)| key);
        let path = format!("{section}.{key}").trim_start_matches('.').to_string();
        if known.contains(&path) {
            found.push((path, comment.join(" ")));
            comment.clear();
        } else if line.starts_with('#') {
            comment.push(bare);
        } else {
            comment.clear();
        }
        if let Some(name) = line.strip_prefix('[') {
            section = name.trim_end_matches(']');
        }
    }
    found
}

/// Turns serde's message into one for users: plain words for Rust's types, the key's description, a suggestion.
fn explain(error: &toml::de::Error, text: &str, key: Option<&str>) -> BadInput {
    let mut text = text.trim_end().to_string();
    for (rust, plain) in [
        ("expected usize", "expected a whole number, 0 or more"),
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected an array of numbers"),
        ("expected struct ", "expected a section, "),
    ] {
        text = text.replace(rust, plain);
    }
    let message = error.message();
    if !message.starts_with("unknown") {
        let bad = BadInput::new(text);
        return match key.and_then(|key| description(key).map(|what| format!("{key}: {what}"))) {
            Some(allowed) => bad.allowed(allowed),
            None => bad,
        };
    }
    // unknown field `given`, expected one of `a`, `b`
    let mut words = message.split('`').skip(1).step_by(2);
    let given = words.next().unwrap_or_default();
    let expected: Vec<&str> = words.collect();
    // The expected names go into the line of allowed values.
    let problem = text.rsplit_once(", expected").map_or(text.as_str(), |(problem, _)| problem);
    let bad = BadInput::new(problem).allowed(expected.join(", "));
    let ends_with = format!(".{given}");
    let elsewhere = known_keys().into_iter().find(|path| path.ends_with(&ends_with));
    match (elsewhere, suggest::nearest(given, &expected)) {
        (Some(path), _) if message.starts_with("unknown field") => bad.advice(format!("`{path}`")),
        (_, Some(near)) => bad.advice(format!("`{near}`")),
        _ => bad.advice("`hydrograd scenes heated-channel` prints every key with its meaning"),
    }
}
