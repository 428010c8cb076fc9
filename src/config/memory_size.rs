//! An amount of memory in the notation of users: `200MB`, `1.5 GiB`.
//!
//! The crate `bytesize` (2.7) is not used, because it accepts a number without a unit and 0, rejects `1e3B`, and writes
//! 300 MB as 286.1 MiB, which does not read back.

use crate::config::notation::{self, Written};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemorySize(pub u64);

const UNITS: [(&str, u64); 7] = [
    ("B", 1),
    ("KB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
];

/// The accepted notation, for messages.
pub const FORM: &str = "a number above 0 with its unit, B, KB, MB, GB, KiB, MiB or GiB, such as \"200MB\"";

impl MemorySize {
    pub fn bytes(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl std::str::FromStr for MemorySize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        // A letter in a number can only be that of an exponent, with which no unit begins.
        let at = text.find(|c: char| c.is_ascii_alphabetic() && !"eE".contains(c)).unwrap_or(text.len());
        let (number, unit) = (text[..at].trim(), &text[at..]);
        let bad = |what: &str| format!("`{text}` {what}; expected {FORM}");
        let value: f64 = number.parse().map_err(|_| bad("is not an amount of memory"))?;
        if unit.is_empty() {
            return Err(bad("has no unit"));
        }
        let known = UNITS.iter().find(|(name, _)| name.eq_ignore_ascii_case(unit));
        let Some((_, factor)) = known else {
            return Err(bad(&format!("has the unknown unit `{unit}`")));
        };
        let bytes = (value * *factor as f64).round();
        if !(1.0..=1e18).contains(&bytes) {
            return Err(bad("is out of range"));
        }
        Ok(Self(bytes as u64))
    }
}

impl fmt::Display for MemorySize {
    /// Uses the largest unit without a fraction.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = UNITS.iter().filter(|(_, factor)| self.0.is_multiple_of(*factor));
        let (unit, factor) = whole.max_by_key(|(_, factor)| *factor).unwrap_or(&UNITS[0]);
        write!(out, "{}{unit}", self.0 / factor)
    }
}

impl Serialize for MemorySize {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for MemorySize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        notation::read(deserializer, FORM, |written| match written {
            Written::Text(text) => Some(text.parse()),
            Written::Whole(number) => Some(number.to_string().parse()),
            Written::Number(number) => Some(number.to_string().parse()),
        })
    }
}
