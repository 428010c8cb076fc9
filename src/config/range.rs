//! Ranges of single numbers.

use crate::config::suggest;
use crate::error::BadInput;

/// Largest number of particles. More are taken for a mistake in `resolution.dx`.
const MAX_PARTICLES: f64 = 1e8;

/// Largest number of steps. More are taken for a mistake in `time.*`.
pub const MAX_STEPS: f64 = 1e9;

/// Tolerance within which a number of spacings is a whole number.
pub const WHOLE: f64 = 1e-6;

/// A key, its value, and the range that it must be in.
pub type Number = (&'static str, f64, Range);

/// The range of a number, which must be finite.
#[derive(Debug, Clone, Copy)]
pub enum Range {
    Finite,
    Positive,
    NotNegative,
    AtLeast(f64),
    /// Both ends are included.
    Within(f64, f64),
    /// Above the first number, up to and including the second.
    Above(f64, f64),
    /// From and including the first number, below the second.
    Below(f64, f64),
}

impl Range {
    pub fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Finite => true,
                Self::Positive => value > 0.0,
                Self::NotNegative => value >= 0.0,
                Self::AtLeast(low) => value >= low,
                Self::Within(low, high) => (low..=high).contains(&value),
                Self::Above(low, high) => low < value && value <= high,
                Self::Below(low, high) => (low..high).contains(&value),
            }
    }

    /// The range in words, for messages.
    pub fn describe(self, key: &str) -> String {
        match self {
            Self::Finite => format!("{key}: any finite number"),
            Self::Positive => format!("{key} > 0, finite"),
            Self::NotNegative => format!("{key} >= 0, finite"),
            Self::AtLeast(low) => format!("{key} >= {low}, finite"),
            Self::Within(low, high) => format!("{low} <= {key} <= {high}"),
            Self::Above(low, high) => format!("{low} < {key} <= {high}"),
            Self::Below(low, high) => format!("{low} <= {key} < {high}"),
        }
    }
}

/// Returns an error if a spacing makes too many particles.
pub fn countable(dx: f64, particles: f64) -> Result<(), BadInput> {
    match particles > MAX_PARTICLES {
        false => Ok(()),
        true => Err(BadInput::at("resolution.dx", format!("resolution.dx = {dx} makes {particles:.1e} particles"))
            .allowed(format!("at most {MAX_PARTICLES:.0e} particles"))),
    }
}

/// Whether a number is whole and above 0, up to rounding.
pub fn is_whole(count: f64) -> bool {
    count.round() >= 1.0 && (count - count.round()).abs() <= WHOLE
}

/// The whole number of spacings nearest to a length, as a length in few digits; at least one spacing.
pub fn whole_spacings(length: f64, dx: f64) -> f64 {
    let near = (length / dx).round().max(1.0) * dx;
    suggest::shortest(near, |short| ((short - near) / dx).abs() <= 0.1 * WHOLE)
}

/// A number of spacings in words.
pub fn spacings(count: f64) -> String {
    match count {
        6.0 => "six spacings".into(),
        _ => format!("{} spacings", (1e6 * count).round() / 1e6),
    }
}
