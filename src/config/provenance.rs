//! The configuration in the form that data sets and checkpoints record.

use crate::config::before;
use crate::config::scene::Config;

impl Config {
    /// The configuration as TOML with every key, which reads back to it.
    pub fn recorded(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self as &dyn erased_serde::Serialize)
    }

    /// A recorded configuration, possibly by an earlier version.
    pub fn from_record(text: &str) -> Result<Self, toml::de::Error> {
        let mut table: toml::Table = text.parse()?;
        before::translate(&mut table);
        table.try_into()
    }
}
