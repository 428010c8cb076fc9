//! The macro for a section of a configuration: each key with its default and, for numbers, its range.

use crate::config::range::{Number, Range};

pub trait MayBeNumber {
    fn number(&self) -> Option<f64>;
}

impl MayBeNumber for f64 {
    fn number(&self) -> Option<f64> {
        Some(*self)
    }
}

impl MayBeNumber for usize {
    fn number(&self) -> Option<f64> {
        Some(*self as f64)
    }
}

impl MayBeNumber for u64 {
    fn number(&self) -> Option<f64> {
        Some(*self as f64)
    }
}

impl<T: MayBeNumber> MayBeNumber for Option<T> {
    fn number(&self) -> Option<f64> {
        self.as_ref().and_then(T::number)
    }
}

/// The number of a key with its range; none if it is absent.
pub fn number(key: &'static str, value: &impl MayBeNumber, range: Range) -> Option<Number> {
    value.number().map(|value| (key, value, range))
}

/// Defines the struct of a section from the prefix of its keys, such as `"time."`, and lines `key: type = default;` or
/// `key: type = default, range;`.
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
