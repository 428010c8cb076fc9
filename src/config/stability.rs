//! Up to which CFL numbers the solver holds, and what `time.cfl = "auto"` takes.
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
//! Fixed particles were not mapped: 0.9 is three quarters of the 1.2 that was found to hold over gentle walls.

use super::scene::{Config, Formulation, IntegratorName, Motion};
use serde::de::{self, Deserializer};
use std::fmt;

/// CFL numbers of a kind of step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CflLimit {
    /// Courant number, of the speed that the flow has, above which runs diverge: between the last that held and the first that
    /// failed.
    pub most: f64,
    /// Four fifths of the last that held.
    pub safe: f64,
}

pub const VERLET: CflLimit = CflLimit { most: 1.3, safe: 1.0 };
/// From a start that is so disordered that walls see gaps.
pub const VERLET_FROM_NOISE: CflLimit = CflLimit { safe: 0.4, ..VERLET };
pub const SYMPLECTIC_EULER: CflLimit = CflLimit { most: 1.85, safe: 1.4 };
pub const STANDARD: CflLimit = CflLimit { most: 2.15, safe: 1.6 };
pub const FREE_SURFACE: CflLimit = CflLimit { most: 2.15, safe: 0.8 };
pub const FIXED: CflLimit = CflLimit { most: 1.25, safe: 0.9 };

impl Config {
    /// That of this configuration's steps.
    pub fn cfl_limit(&self) -> CflLimit {
        match (self.fluid.formulation, self.time.integrator) {
            _ if self.fluid.motion == Motion::Fixed => FIXED,
            _ if self.scene.has_surface() => FREE_SURFACE,
            (Formulation::Standard, _) => STANDARD,
            (Formulation::Consistent, IntegratorName::Verlet) if self.time.jitter > 0.1 => VERLET_FROM_NOISE,
            (Formulation::Consistent, IntegratorName::Verlet) => VERLET,
            (Formulation::Consistent, IntegratorName::SymplecticEuler) => SYMPLECTIC_EULER,
        }
    }
}

/// What a configuration calls a CFL number that follows from its steps.
pub const AUTO: &str = "auto";

/// A number; not a number for [`AUTO`], until the loader has put one in its place.
pub(super) fn cfl<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    struct Visitor;
    impl de::Visitor<'_> for Visitor {
        type Value = f64;

        fn expecting(&self, out: &mut fmt::Formatter) -> fmt::Result {
            write!(out, "a number or \"{AUTO}\"")
        }
        fn visit_f64<E: de::Error>(self, number: f64) -> Result<f64, E> {
            Ok(number)
        }
        fn visit_i64<E: de::Error>(self, number: i64) -> Result<f64, E> {
            Ok(number as f64)
        }
        fn visit_str<E: de::Error>(self, text: &str) -> Result<f64, E> {
            match text {
                AUTO => Ok(f64::NAN),
                _ => Err(E::invalid_value(de::Unexpected::Str(text), &self)),
            }
        }
    }
    deserializer.deserialize_any(Visitor)
}
