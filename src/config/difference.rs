//! Differences between configurations. A run or a data set can be continued only without differences in most keys.

use std::collections::BTreeMap;

use crate::config::schema::{values, Schema};

/// A key with different values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    pub key: String,
    /// The value as TOML; `nothing` where the key is absent.
    pub before: String,
    pub now: String,
}

impl std::fmt::Display for Difference {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{} = {}, not {}", self.key, self.before, self.now)
    }
}

/// The keys whose values differ, in alphabetical order, except for the keys and sections in `free`.
pub fn differences<S: Schema>(before: &S, now: &S, free: &[&str]) -> Vec<Difference> {
    let texts = |config: &S| -> BTreeMap<String, String> {
        values(config).into_iter().map(|(key, value)| (key, value.to_string().trim().to_string())).collect()
    };
    let (before, now) = (texts(before), texts(now));
    let mut keys: Vec<&String> = before.keys().chain(now.keys()).collect();
    keys.sort();
    keys.dedup();
    let is_free = |key: &str| {
        let section = key.split_once('.').map(|(section, _)| section);
        free.contains(&key) || section.is_some_and(|section| free.contains(&section))
    };
    let shown = |of: &BTreeMap<String, String>, key: &str| of.get(key).map_or("nothing".into(), String::clone);
    keys.into_iter()
        .filter(|key| before.get(*key) != now.get(*key) && !is_free(key))
        .map(|key| Difference { key: key.clone(), before: shown(&before, key), now: shown(&now, key) })
        .collect()
}

/// The first of the [`differences`] in words.
pub fn difference<S: Schema>(before: &S, now: &S, free: &[&str]) -> Option<String> {
    differences(before, now, free).first().map(Difference::to_string)
}
