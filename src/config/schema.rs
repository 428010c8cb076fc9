//! The interface of a kind of configuration: a scene ([`Config`](crate::config::scene::Config)) or a training
//! ([`Settings`](crate::config::training::Settings)).

use serde::{de::DeserializeOwned, Serialize};
use toml_edit::{DocumentMut, Item, TableLike, Value};

use crate::config::range::Number;
use crate::error::BadInput;

/// Keys, and the keys that they replace.
pub type Alternative = (&'static [&'static str], &'static [&'static str]);

/// A kind of configuration, read from layers of TOML (see [`crate::config::layers`]).
pub trait Schema: Default + Serialize + DeserializeOwned {
    /// Alternative keys: a layer with one of the first removes the second, unless it has them too.
    const ALTERNATIVES: &'static [Alternative];
    /// The form of an assignment, for messages.
    const FORM: &'static str;
    /// Where every key is explained, for messages.
    const HELP: &'static str;

    /// Complete texts. The comment above a key in the first text that has it describes the key.
    fn texts() -> Vec<&'static str>;

    /// Values that together have every key, including optional ones.
    fn complete() -> Vec<Self>;

    /// Every number with its range.
    fn numbers(&self) -> Vec<Number>;

    /// The default values and their origin, for messages, such as `the built-in scene's`.
    fn usual(&self) -> (Self, &'static str);

    /// The place of keys that no layer set.
    fn origin(&self) -> String;

    /// Checks that the values are consistent, after every number was found to be in its range.
    ///
    /// # Errors
    /// The first inconsistency, with the wrong key, from which the loader finds the place.
    fn check_together(&self) -> Result<(), BadInput>;

    /// Checks the range of every number, and that the values are consistent.
    fn check(&self) -> Result<(), BadInput> {
        let (usual, whose) = self.usual();
        for (key, value, range) in self.numbers() {
            if !range.contains(value) {
                let bad = BadInput::new(format!("{key} = {value} is out of range"));
                let bad = bad.key(key).allowed(range.describe(key));
                let default = usual.numbers().into_iter().find(|(other, _, _)| *other == key);
                return Err(match default.filter(|_| values(&usual).iter().any(|(path, _)| path == key)) {
                    Some((_, default, _)) => bad.advice(format!("{key}={default} ({whose})")),
                    // An optional key may have no default.
                    None => bad,
                });
            }
        }
        self.check_together()
    }
}

/// The values of a table by their paths (`section.key`), in order. A table in a section is a value.
pub(crate) fn flatten(table: &dyn TableLike) -> Vec<(String, &Item)> {
    let mut found = Vec::new();
    for (key, item) in table.iter() {
        match item.as_table_like() {
            Some(inner) => found.extend(inner.iter().map(|(rest, item)| (format!("{key}.{rest}"), item))),
            None => found.push((key.to_string(), item)),
        }
    }
    found
}

/// Every key of a configuration with its value.
pub fn values<S: Schema>(config: &S) -> Vec<(String, Value)> {
    let text =
        toml::to_string(config as &dyn erased_serde::Serialize).expect("a configuration is representable in TOML");
    let document: DocumentMut = text.parse().expect("toml writes valid TOML");
    let found = flatten(document.as_table()).into_iter();
    found.filter_map(|(path, item)| Some((path, value_of(item)?))).collect()
}

/// The value of an item; an array of inline tables for `[[key]]` sections, an inline table for `[section.key]`.
pub(crate) fn value_of(item: &Item) -> Option<Value> {
    match item {
        Item::ArrayOfTables(tables) => Some(Value::Array(tables.clone().into_array())),
        Item::Table(table) => Some(Value::InlineTable(table.clone().into_inline_table())),
        _ => item.as_value().cloned(),
    }
}

/// Every key of a kind of configuration, as `key` or `section.key`.
pub fn known_keys<S: Schema>() -> Vec<String> {
    let mut keys: Vec<String> = Vec::new();
    for (path, _) in S::complete().iter().flat_map(values) {
        if !keys.contains(&path) {
            keys.push(path);
        }
    }
    keys
}

/// The comment above a key in the first text that has it: its meaning, units and range, on one line.
pub fn description<S: Schema>(path: &str) -> Option<String> {
    let all = S::texts().into_iter().flat_map(described::<S>);
    all.filter(|(key, comment)| key == path && !comment.is_empty()).map(|(_, comment)| comment).next()
}

/// The keys of a text, including those that are commented out, with the comment above each.
pub fn described<S: Schema>(text: &str) -> Vec<(String, String)> {
    let known = known_keys::<S>();
    let (mut section, mut comment, mut found) = ("", Vec::new(), Vec::new());
    for line in text.lines() {
        let bare = line.trim_start_matches("# ");
        let key = bare.split_once(" = ").map_or("", |(key, _)| key);
        let path = format!("{section}.{key}").trim_start_matches('.').to_string();
        if known.contains(&path) {
            // Several methods may have the same key.
            if !found.iter().any(|(other, _)| *other == path) {
                found.push((path, comment.join(" ")));
            }
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
