//! Ranges of single numbers.

/// A key, its value, and the range that it must be in.
pub type Number = (&'static str, f64, Range);

/// The range of one number; all are finite.
#[derive(Debug, Clone, Copy)]
pub enum Range {
    Finite,
    Positive,
    NotNegative,
    AtLeast(f64),
    /// Both ends included.
    Within(f64, f64),
    /// Above the first, up to the second.
    Above(f64, f64),
    /// From the first on, below the second.
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

    /// In words, for messages.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_belong_or_not() {
        assert!(Range::Within(0.0, 1.0).contains(0.0) && Range::Within(0.0, 1.0).contains(1.0));
        assert!(!Range::Above(0.0, 1.0).contains(0.0) && Range::Above(0.0, 1.0).contains(1.0));
        assert!(Range::Below(0.0, 1.0).contains(0.0) && !Range::Below(0.0, 1.0).contains(1.0));
        assert!(Range::AtLeast(2.0).contains(2.0) && !Range::AtLeast(2.0).contains(1.0));
        assert!(!Range::Positive.contains(0.0) && Range::NotNegative.contains(0.0));
        for value in [f64::NAN, f64::INFINITY] {
            assert!(!Range::Finite.contains(value) && !Range::AtLeast(0.0).contains(value));
        }
    }
}
