//! Layers of configuration: texts and `key=value` settings laid over a complete text, each checked alone first, so that an
//! error points into the text that the user wrote. Scenes and trainings are read by the same code: see [`Schema`].

use std::collections::BTreeMap;
use std::ops::Range;

use toml_edit::{Document, DocumentMut, Item, Value};

use crate::config::schema::{description, flatten, known_keys, value_of, values, Schema};
use crate::config::suggest;
use crate::error::BadInput;

/// One assignment, `key=value`, or an option that stands for one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// What the user wrote, for messages.
    pub label: String,
    /// `key=value` or `section.key=value`; the value in TOML, quotes optional around a single word.
    pub assignment: String,
}

impl Setting {
    /// From an assignment, which names itself in messages.
    pub fn set(assignment: &str) -> Self {
        Self { label: assignment.to_string(), assignment: assignment.to_string() }
    }

    /// From an option, e.g. `--threads 2` for `run.threads=2`.
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
    ///
    /// # Errors
    /// No TOML, an unknown key, a value of the wrong type; with file and line.
    pub fn from_text<S: Schema>(name: &str, text: &str) -> Result<Self, BadInput> {
        let spanned = Document::parse(text)
            .map_err(|error| BadInput::new(cut(&error.to_string())).place(name).advice(S::HELP))?;
        let found = flatten(spanned.as_table());
        if let Err(error) = toml::from_str::<S>(text) {
            let at = error.span().unwrap_or_default();
            let inside = |span: Range<usize>| span.contains(&at.start);
            let key = found.iter().find(|(_, item)| item.span().is_some_and(inside));
            let key = key.map(|(path, _)| path.clone());
            return Err(explain::<S>(&error, &error.to_string(), key.as_deref()).place(name));
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
        let known = known_keys::<S>();
        let entries = flatten(owned.as_table())
            .into_iter()
            .zip(places)
            .map(|((path, item), place)| entry(&known, path, item, place))
            .collect::<Result<_, _>>()?;
        Ok(Self { entries })
    }

    /// Reads one assignment.
    ///
    /// # Errors
    /// As [`Layer::from_text`], with the setting's label.
    pub fn from_setting<S: Schema>(setting: &Setting) -> Result<Self, BadInput> {
        let bad = |problem: String| BadInput::new(problem).place(&setting.label);
        let Some((path, text)) = setting.assignment.split_once('=') else {
            return Err(bad("there is no `=`".into()).allowed(S::FORM));
        };
        let keys: Vec<&str> = path.split('.').map(str::trim).collect();
        if keys.iter().any(|key| key.is_empty()) {
            return Err(bad(format!("`{path}` is not a key")).allowed(S::FORM));
        }
        let value = parse_value(text.trim()).map_err(|problem| bad(problem).allowed("a TOML value"))?;

        let mut document = DocumentMut::new();
        let mut item: &mut Item = document.as_item_mut();
        for key in &keys {
            item = &mut item[key];
        }
        *item = Item::Value(value);
        if let Err(error) = toml::from_str::<S>(&document.to_string()) {
            let key = keys.join(".");
            return Err(explain::<S>(&error, error.message(), Some(&key)).place(&setting.label));
        }
        let known = known_keys::<S>();
        let entries = flatten(document.as_table())
            .into_iter()
            .map(|(path, item)| entry(&known, path, item, setting.label.clone()))
            .collect::<Result<_, _>>()?;
        Ok(Self { entries })
    }

    /// The values of a configuration that are not the default ones; `place` is said to have set them.
    pub fn from_value<S: Schema>(config: &S, place: &str) -> Self {
        let usual: BTreeMap<String, String> =
            values(&S::default()).into_iter().map(|(path, value)| (path, value.to_string())).collect();
        let differs = |(path, value): &(String, Value)| usual.get(path) != Some(&value.to_string());
        let entries = values(config).into_iter().filter(differs);
        Self { entries: entries.map(|(path, value)| Entry { path, value, place: place.to_string() }).collect() }
    }

    /// Changes a text, such as a path that is relative to the file that names it.
    pub fn change(mut self, path: &str, change: impl Fn(&str) -> String) -> Self {
        for entry in self.entries.iter_mut().filter(|entry| entry.path == path) {
            if let Some(text) = entry.value.as_str() {
                entry.value = change(text).into();
            }
        }
        self
    }

    /// The string value of a key of this layer.
    pub fn string(&self, path: &str) -> Option<&str> {
        self.entries.iter().find(|entry| entry.path == path).and_then(|entry| entry.value.as_str())
    }

    /// The keys, and where each was written.
    pub fn keys(&self) -> impl Iterator<Item = (&str, &str)> {
        self.entries.iter().map(|entry| (entry.path.as_str(), entry.place.as_str()))
    }

    fn has(&self, path: &str) -> bool {
        self.entries.iter().any(|entry| entry.path == path)
    }
}

/// Layers merged over a complete text: it with its comments, and who set each key.
#[derive(Debug, Clone)]
pub struct Merged {
    document: DocumentMut,
    places: BTreeMap<String, String>,
}

impl Merged {
    /// Starts from a complete text (a built-in one, or one resolved before).
    pub fn new(text: &str, places: BTreeMap<String, String>) -> Self {
        let document = text.parse().expect("a complete text is valid TOML");
        Self { document, places }
    }

    /// Lays `layer` over what is there. Of keys that say the same thing in different ways the last layer that speaks wins.
    pub fn apply<S: Schema>(&mut self, layer: &Layer) {
        for (given, replaced) in S::ALTERNATIVES {
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
                (table.expect("a complete text has every section"), key)
            }
        }
    }

    /// Whether a key has a text.
    pub fn is_text(&self, path: &str, text: &str) -> bool {
        let (section, key) = path.split_once('.').unwrap_or(("", path));
        self.document.get(section).and_then(|table| table.get(key)).and_then(Item::as_str) == Some(text)
    }

    /// What the layers amount to, not checked yet.
    pub fn read<S: Schema>(&self) -> S {
        toml::from_str(&self.text()).expect("every layer was read alone, so their union can be read")
    }

    /// What the layers amount to, checked: every number, how they fit together, and then by `more`, which may know what
    /// this layer of the program does not.
    ///
    /// # Errors
    /// The first thing wrong, with the place where its key was set.
    pub fn checked<S: Schema>(&self, more: impl Fn(&S) -> Result<(), BadInput>) -> Result<S, BadInput> {
        let config: S = self.read();
        let origin = config.origin();
        let place_of = |key: &str| {
            // The place of `design.offsets[3]` is that of the array.
            let key = key.split('[').next().unwrap_or(key);
            Some(self.places.get(key).cloned().unwrap_or_else(|| origin.clone()))
        };
        config.check().and_then(|()| more(&config)).map_err(|bad| bad.located(place_of))?;
        Ok(config)
    }

    /// The text with every key, comments included.
    pub fn text(&self) -> String {
        self.document.to_string()
    }

    pub fn places(&self) -> &BTreeMap<String, String> {
        &self.places
    }
}

/// An entry, if it is a value at the path of a key (serde would also read a section from an array, by position).
fn entry(known: &[String], path: String, item: &Item, place: String) -> Result<Entry, BadInput> {
    match value_of(item) {
        Some(value) if known.contains(&path) => Ok(Entry { path, value, place }),
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

/// Longest line of a file that a message shows.
const SHOWN: usize = 160;

/// A message about a text, whose lines may be as long as they like.
fn cut(message: &str) -> String {
    let line = |line: &str| match line.char_indices().nth(SHOWN) {
        Some((at, _)) => format!("{} ...", &line[..at]),
        None => line.to_string(),
    };
    message.trim_end().lines().map(line).collect::<Vec<_>>().join("\n")
}

/// Turns serde's message into one for users: plain words for Rust's types, the key's description, a suggestion.
fn explain<S: Schema>(error: &toml::de::Error, text: &str, key: Option<&str>) -> BadInput {
    let mut text = cut(text);
    for (rust, plain) in [
        ("expected usize", "expected a whole number, 0 or more"),
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected i64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected an array of numbers"),
        ("expected struct ", "expected a section, "),
    ] {
        text = text.replace(rust, plain);
    }
    let message = error.message();
    if !message.starts_with("unknown") {
        let bad = BadInput::new(text);
        return match key.and_then(|key| description::<S>(key).map(|what| format!("{key}: {what}"))) {
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
    let elsewhere = known_keys::<S>().into_iter().find(|path| path.ends_with(&ends_with));
    match (elsewhere, suggest::nearest(given, &expected)) {
        (Some(path), _) if message.starts_with("unknown field") => bad.advice(format!("`{path}`")),
        (_, Some(near)) => bad.advice(format!("`{near}`")),
        _ => bad.advice(S::HELP),
    }
}
