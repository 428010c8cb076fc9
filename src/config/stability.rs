//! Largest stable CFL numbers of the solver, and the values of `time.cfl = "auto"`.
//!
//! Measured by `hydrograd stress` over the noise of the start (jitter 0 to 0.3), f64 and f32 alike, see
//! src/validation/README.md:
//!
//! | steps | scenes | holds at | fails at | `"auto"` |
//! |---|---|---|---|---|
//! | consistent, velocity Verlet | Taylor-Green, cavity | 1.25 | 1.5 | 1 |
//! | the same from a jitter above 0.1 | cavity | 0.5 | 1 | 0.4 |
//! | consistent, symplectic Euler | heated channel | 1.75 | 2 | 1.4 |
//! | standard | heated channel, Taylor-Green | 2 | 2.3 | 1.6 |
//! | standard, free surface | dam break, the finest spacing | 1 | 1.5 | 0.8 |
//!
//! Fixed particles were not mapped: 0.9 is three quarters of the 1.2 that was found to hold over gentle walls. In fast flows their steps are
//! shorter, see [`crate::config::method::fixed`].

use crate::config::notation::{self, Written};
use serde::Deserializer;

/// Limits of the CFL number for a kind of step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CflLimit {
    /// Courant number by the actual speed of the flow above which runs diverge, between the last stable and the first
    /// unstable one.
    pub most: f64,
    /// Four fifths of the last stable one.
    pub safe: f64,
}

pub const VERLET: CflLimit = CflLimit { most: 1.3, safe: 1.0 };
/// For an initial state so disordered that walls see gaps.
pub const VERLET_FROM_NOISE: CflLimit = CflLimit { safe: 0.4, ..VERLET };
pub const SYMPLECTIC_EULER: CflLimit = CflLimit { most: 1.85, safe: 1.4 };
pub const STANDARD: CflLimit = CflLimit { most: 2.15, safe: 1.6 };
pub const FREE_SURFACE: CflLimit = CflLimit { most: 2.15, safe: 0.8 };
pub const FIXED: CflLimit = CflLimit { most: 1.25, safe: 0.9 };

/// The value of `time.cfl` for a CFL number that follows from the steps.
pub const AUTO: &str = "auto";

/// Reads a CFL number. [`AUTO`] gives NaN, which the loader replaces.
pub fn cfl<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    notation::read(deserializer, "a number or \"auto\"", |written| match written {
        Written::Text(AUTO) => Some(Ok(f64::NAN)),
        Written::Text(_) => None,
        Written::Whole(number) => Some(Ok(number as f64)),
        Written::Number(number) => Some(Ok(number)),
    })
}
