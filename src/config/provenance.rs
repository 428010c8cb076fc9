//! The configuration as data sets and checkpoints record it.

use crate::config::scene::{Config, Family, Formulation, OptimiserName};

/// The keys that files of before there was a choice of equations leave out, and what they meant there.
pub const BEFORE: [&str; 3] = ["fluid.formulation=standard", "resolution.smoothing_length=1.0", "optimise.method=adam"];

impl Config {
    /// The configuration as TOML that reads back to it: every key.
    ///
    /// # Errors
    /// None that can come up: a configuration is representable in TOML.
    pub fn recorded(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// A configuration that was recorded, perhaps by an earlier version.
    ///
    /// # Errors
    /// Text that is no configuration.
    pub fn from_record(text: &str) -> Result<Self, toml::de::Error> {
        let mut config: Self = toml::from_str(text)?;
        let table: toml::Table = text.parse()?;
        let has = |section: &str, key: &str| table.get(section).is_some_and(|section| section.get(key).is_some());
        // (The channel in three dimensions is younger, and has no such key.)
        if !has("fluid", "formulation") && config.scene != Family::HeatedChannel3d {
            config.fluid.formulation = Formulation::Standard;
            if !has("resolution", "smoothing_length") {
                config.resolution.smoothing_length = 1.0;
            }
            if !has("optimise", "method") {
                config.optimise.method = OptimiserName::Adam;
            }
        }
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_reads_back() {
        let mut config = Config::default();
        assert_eq!(Config::from_record(&config.recorded().unwrap()).unwrap(), config);
        config.fluid.formulation = Formulation::Standard;
        assert_eq!(Config::from_record(&config.recorded().unwrap()).unwrap(), config);
    }

    #[test]
    fn records_of_before_are_of_the_standard_formulation() {
        let text = Config::default().recorded().unwrap();
        let gone = ["formulation", "smoothing_length", "method"];
        let old: Vec<&str> = text.lines().filter(|line| !gone.iter().any(|key| line.starts_with(key))).collect();
        let found = Config::from_record(&old.join("\n")).unwrap();
        assert_eq!(found.fluid.formulation, Formulation::Standard);
        assert_eq!((found.resolution.smoothing_length, found.optimise.method), (1.0, OptimiserName::Adam));
    }
}
