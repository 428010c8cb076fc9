//! What comes of a validation run.

use serde::{Deserialize, Serialize};

/// Sees the share of a run that is done.
pub type Progress<'a> = &'a mut dyn FnMut(f64);

/// A named line of a picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    pub name: String,
    pub points: Vec<(f64, f64)>,
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    pub error: f64,
    /// What was measured and, last, what it is compared with; may be none.
    pub curves: Vec<Curve>,
}

impl Curve {
    pub(super) fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points }
    }
}

impl Found {
    /// What was measured beside what it is compared with.
    pub(super) fn beside(error: f64, ours: Vec<(f64, f64)>, reference: &str, theirs: Vec<(f64, f64)>) -> Self {
        Self { error, curves: vec![Curve::new("hydrograd", ours), Curve::new(reference, theirs)] }
    }
}
