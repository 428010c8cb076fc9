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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::scene::{Config, Family};
    use crate::config::training::Settings;

    #[test]
    fn scenes_differ_where_it_counts() {
        let before = Config::default();
        let mut now = before.clone();
        assert_eq!(difference(&before, &now, &[]), None);
        now.time.steps = Some(7);
        now.output.frames = 3;
        now.run.threads = 2;
        now.run.seed = 1;
        let found = differences(&before, &now, &["output", "run.threads"]);
        let words: Vec<String> = found.iter().map(Difference::to_string).collect();
        assert_eq!(words, ["run.seed = 0, not 1", "time.steps = nothing, not 7"]);
        now.scene = Family::TaylorGreen;
        let words = difference(&before, &now, &["output", "run", "time"]);
        assert_eq!(words.as_deref(), Some("scene = \"heated-channel\", not \"taylor-green\""));
    }

    #[test]
    fn trainings_differ_key_by_key() {
        let before = Settings::default();
        let mut now = before.clone();
        now.steps += 1;
        now.model.latent = 8;
        let found = differences(&before, &now, &["steps"]);
        assert_eq!(found, [Difference { key: "model.latent".into(), before: "64".into(), now: "8".into() }]);
    }
}
