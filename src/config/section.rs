//! The macro for a section of a configuration: each key with its default and, for numbers, its range.

use crate::config::range::{Number, Range};
use serde::Serialize;
use toml::Value;

/// The value of a key with its range; none if the key is absent.
pub fn number(key: &'static str, value: &impl Serialize, range: Range) -> Option<Number> {
    let value = Value::try_from(value).ok()?;
    let number = value.as_float().or_else(|| value.as_integer().map(|number| number as f64))?;
    Some((key, number, range))
}

/// Defines the struct of a section from the prefix of its keys, such as `"time."`, and lines `key: type = default;` or
/// `key: type = default, range;`. What a key means, and its unit, is the comment above it in `data/scenes`, `data/methods`,
/// `data/run.toml` or `data/training.toml`.
macro_rules! section {
    ($(#[$meta:meta])* $prefix:literal: $name:ident {
        $($(#[$of_key:meta])* $key:ident: $type:ty = $default:expr $(, $range:expr)?;)*
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[$of_key])* pub $key: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $default),* }
            }
        }

        impl $name {
            /// The numbers of the section with their ranges.
            pub fn numbers(&self) -> Vec<$crate::config::range::Number> {
                let numbers: Vec<Option<$crate::config::range::Number>> = vec![$($($crate::config::section::number(
                    concat!($prefix, stringify!($key)),
                    &self.$key,
                    $range,
                ),)?)*];
                numbers.into_iter().flatten().collect()
            }
        }
    };
}

pub(crate) use section;
