//! Methods that solve a scene. The section `[method]` names one and has its keys. Each method is a file here with a
//! TOML text of its keys in `data/methods`.

pub mod consistent;
pub mod fixed;
pub mod kind;
pub mod standard;

use consistent::Consistent;
use fixed::Fixed;
use kind::{Facts, Kind};
use serde::{de::Error, Deserialize, Deserializer, Serialize};
use standard::Standard;
use std::collections::BTreeSet;

/// A method, with its keys; the first one is the default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "kebab-case")]
pub enum Method {
    Consistent(Consistent),
    Standard(Standard),
    Fixed(Fixed),
}

pub const METHODS: &[&Facts] = &[&consistent::FACTS, &standard::FACTS, &fixed::FACTS];

impl std::ops::Deref for Method {
    type Target = dyn Kind;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Consistent(own) => own,
            Self::Standard(own) => own,
            Self::Fixed(own) => own,
        }
    }
}

impl Default for Method {
    fn default() -> Self {
        Self::Consistent(Consistent::default())
    }
}

impl Method {
    pub fn names() -> Vec<&'static str> {
        METHODS.iter().map(|facts| facts.name).collect()
    }

    pub fn name(&self) -> &'static str {
        self.facts().name
    }

    /// The method with a name, with default values.
    pub fn named(name: &str) -> Option<Self> {
        toml::Table::from_iter([("name".to_string(), name.into())]).try_into().ok()
    }

    /// The keys of the method with a name, without their section.
    pub fn keys_of(name: &str) -> Vec<String> {
        let keys = Self::named(name).and_then(|method| toml::Table::try_from(method).ok()).unwrap_or_default();
        keys.into_iter().map(|(key, _)| key).filter(|key| key != "name").collect()
    }

    /// The names of the methods that have a key, which is given without its section.
    pub fn having(key: &str) -> Vec<&'static str> {
        Self::names().into_iter().filter(|name| Self::keys_of(name).iter().any(|own| own == key)).collect()
    }

    /// The names of the methods with a capability.
    pub fn that(can: impl Fn(&Facts) -> bool) -> Vec<&'static str> {
        METHODS.iter().filter(|facts| can(facts)).map(|facts| facts.name).collect()
    }
}

/// Reads a method from its section. A section without a name is of the first method that has all its keys; it will be
/// merged into a section with a name.
pub fn section<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Method, D::Error> {
    let mut keys = toml::Table::deserialize(deserializer)?;
    if !keys.contains_key("name") {
        let has_all = |name: &&str| keys.keys().all(|key| Method::keys_of(name).contains(key));
        let unknown = keys.keys().find(|key| Method::having(key).is_empty());
        let name = match (Method::names().into_iter().find(has_all), unknown) {
            (Some(name), _) => name,
            (None, None) => return Err(D::Error::custom("keys of several methods, and no name")),
            (None, Some(key)) => {
                let all: BTreeSet<String> = Method::names().into_iter().flat_map(Method::keys_of).collect();
                let all = all.iter().map(|key| format!(", `{key}`")).collect::<String>();
                return Err(D::Error::custom(format!("unknown field `{key}`, expected one of `name`{all}")));
            }
        };
        keys.insert("name".into(), name.into());
    }
    keys.try_into().map_err(|error: toml::de::Error| D::Error::custom(error.message()))
}
