//! What the loader must know of a kind of configuration: a scene ([`Config`](crate::config::scene::Config)) or a training
//! ([`Settings`](crate::config::training::Settings)).

use serde::{de::DeserializeOwned, Serialize};
use toml_edit::{DocumentMut, Item, TableLike, Value};

use crate::config::range::Number;
use crate::error::BadInput;

/// Keys, and those that they take the place of.
pub type Alternative = (&'static [&'static str], &'static [&'static str]);

/// A kind of configuration, read from layers of TOML (see [`crate::config::layers`]).
pub trait Schema: Default + Serialize + DeserializeOwned {
    /// Keys that say the same thing in different ways: a layer that gives one of the first removes the second, unless it
    /// gives them too.
    const ALTERNATIVES: &'static [Alternative];
    /// How one assignment looks, for messages.
    const FORM: &'static str;
    /// Where every key is explained, for messages.
    const HELP: &'static str;

    /// Complete texts. The comment above a key in the first text that has it describes the key.
    fn texts() -> Vec<&'static str>;

    /// A value with every key, those that usually are absent included.
    fn complete() -> Self;

    /// Every number with its range.
    fn numbers(&self) -> Vec<Number>;

    /// The values that it began with, and whose they are, for messages: `the built-in scene's`.
    fn usual(&self) -> (Self, &'static str);

    /// Where a key was set that no layer set.
    fn origin(&self) -> String;

    /// How the values fit together, once every number is in its range.
    ///
    /// # Errors
    /// The first thing that does not; with the key at fault, from which the loader finds the place.
    fn check_together(&self) -> Result<(), BadInput>;

    /// Checks every number and how they fit together.
    ///
    /// # Errors
    /// The first thing wrong.
    fn check(&self) -> Result<(), BadInput> {
        let (usual, whose) = self.usual();
        for ((key, value, range), (_, default, _)) in self.numbers().into_iter().zip(usual.numbers()) {
            if !range.contains(value) {
                let bad = BadInput::new(format!("{key} = {value} is out of range"));
                let bad = bad.key(key).allowed(range.describe(key));
                return Err(match values(&usual).iter().any(|(path, _)| path == key) {
                    true => bad.advice(format!("{whose} {key} = {default}")),
                    // A key that usually is absent has no usual value.
                    false => bad,
                });
            }
        }
        self.check_together()
    }
}

/// The values of a table by their paths (`section.key`), in their order.
pub(crate) fn flatten(table: &dyn TableLike) -> Vec<(String, &Item)> {
    let mut found = Vec::new();
    for (key, item) in table.iter() {
        match item.as_table_like() {
            Some(inner) => found.extend(flatten(inner).into_iter().map(|(rest, item)| (format!("{key}.{rest}"), item))),
            None => found.push((key.to_string(), item)),
        }
    }
    found
}

/// Every key that a configuration has, with its value.
pub fn values<S: Schema>(config: &S) -> Vec<(String, Value)> {
    let text = toml::to_string(config).expect("a configuration is representable in TOML");
    let document: DocumentMut = text.parse().expect("toml writes valid TOML");
    let found = flatten(document.as_table()).into_iter();
    found.filter_map(|(path, item)| Some((path, value_of(item)?))).collect()
}

/// The value of an item: of `[[key]]` sections an array of inline tables.
pub(crate) fn value_of(item: &Item) -> Option<Value> {
    match item {
        Item::ArrayOfTables(tables) => Some(Value::Array(tables.clone().into_array())),
        _ => item.as_value().cloned(),
    }
}

/// Every key of a kind of configuration, as `key` or `section.key`.
pub fn known_keys<S: Schema>() -> Vec<String> {
    values(&S::complete()).into_iter().map(|(path, _)| path).collect()
}

/// The comment above a key in the first text that has it: its meaning, units and range, on one line.
pub fn description<S: Schema>(path: &str) -> Option<String> {
    let all = S::texts().into_iter().flat_map(described::<S>);
    all.filter(|(key, comment)| key == path && !comment.is_empty()).map(|(_, comment)| comment).next()
}

/// The keys of a text, those commented out included, each with the comment above it.
pub fn described<S: Schema>(text: &str) -> Vec<(String, String)> {
    let known = known_keys::<S>();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::scene::Config;
    use crate::config::training::Settings;

    /// A key without a range would be a number that is never checked; of a seed every value is allowed.
    fn every_number_has_a_range<S: Schema>(seed: &str) {
        let complete = S::complete();
        let numbers = complete.numbers();
        let with_range: Vec<&str> = numbers.iter().map(|(key, _, _)| *key).collect();
        let mut expected = Vec::new();
        for (path, value) in values(&complete) {
            if (value.is_integer() || value.is_float()) && path != seed {
                assert!(with_range.contains(&path.as_str()), "{path} has no range");
                expected.push(path);
            }
        }
        assert_eq!(expected.len(), with_range.len(), "a key is there twice, or is none");
        S::default().check().unwrap();
    }

    #[test]
    fn every_number_of_a_scene_has_a_range() {
        every_number_has_a_range::<Config>("run.seed");
    }

    #[test]
    fn every_number_of_a_training_has_a_range() {
        every_number_has_a_range::<Settings>("seed");
    }
}
