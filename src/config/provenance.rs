//! The configuration as a data set records it.

use toml_edit::DocumentMut;

use crate::config::scene::Config;
use crate::config::schema::values;

/// Keys that came after the first data sets. With their defaults they are not recorded: the same data set keeps its bytes.
const LATER: [&str; 7] = [
    "resolution.kernel",
    "resolution.smoothing_length",
    "fluid.artificial_viscosity",
    "objective.kind",
    "design.parametrisation",
    "design.control_points",
    "optimise.method",
];

impl Config {
    /// The configuration as TOML that reads back to it.
    ///
    /// # Errors
    /// None that can come up: a configuration is representable in TOML.
    pub fn recorded(&self) -> Result<String, toml::ser::Error> {
        let text = toml::to_string(self)?;
        let Ok(mut document) = text.parse::<DocumentMut>() else { return Ok(text) };
        let usual = values(&Self::default());
        for (path, value) in values(self) {
            let is_usual = usual.iter().any(|(key, other)| *key == path && other.to_string() == value.to_string());
            if let (true, true, Some((section, key))) = (is_usual, LATER.contains(&path.as_str()), path.split_once('.'))
            {
                if let Some(table) = document[section].as_table_mut() {
                    table.remove(key);
                }
            }
        }
        Ok(document.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::scene::KernelName;

    #[test]
    fn later_keys_are_recorded_only_if_they_say_something() {
        let mut config = Config::default();
        let text = config.recorded().unwrap();
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
        // What is left is what stood there, line by line.
        let full = toml::to_string(&config).unwrap();
        let left: Vec<&str> = text.lines().collect();
        let gone: Vec<&str> = full.lines().filter(|line| !left.contains(line)).collect();
        let mut expected: Vec<&str> = LATER.iter().filter_map(|path| Some(path.split_once('.')?.1)).collect();
        let mut keys: Vec<&str> = gone.iter().filter_map(|line| Some(line.split_once(" = ")?.0)).collect();
        expected.sort_unstable();
        keys.sort_unstable();
        assert_eq!(keys, expected);
        assert_eq!(left.len() + gone.len(), full.lines().count());
        config.resolution.kernel = KernelName::WendlandC2;
        let text = config.recorded().unwrap();
        assert!(text.contains("kernel = \"wendland-c2\"") && !text.contains("smoothing_length"), "{text}");
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
    }
}
