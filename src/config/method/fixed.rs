//! The method `fixed`: the consistent equations on a fixed lattice mapped between the walls, see [`crate::sph::fixed`].

use crate::config::method::kind::{Facts, Given, Kind, Usual};
use crate::config::range::{Number, Range::Within};
use crate::config::section::section;
use crate::config::stability::{CflLimit, FIXED};
use serde::{Deserialize, Serialize};

pub const FACTS: Facts = Facts {
    name: "fixed",
    about: "the consistent equations on a lattice that does not move, mapped between the walls: fast, and it has a steady state",
    text: include_str!("../../../data/methods/fixed.toml"),
    moves: false,
    counterpart: Some("consistent"),
    steady: true,
    divides_steps: false,
    force_region: false,
    ..super::consistent::FACTS
};

section! {
    #[derive(Copy)]
    "method.": Fixed {
        pressure_diffusion: f64 = 0.1, Within(0.0, 1.0);
        flow: FlowKind = FlowKind::Steady;
        pressure: PressureKind = PressureKind::Incompressible;
        derivatives: Derivatives = Derivatives::Spectral;
        tolerance: f64 = 1e-3, Within(1e-9, 1.0);
    }
}

/// The derivatives of particles on the lattice of a periodic box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Derivatives {
    /// Of fits of fourth degree to the neighbours.
    Fits,
    /// Of all modes exactly.
    #[default]
    Spectral,
}

/// Whether a scene of one's own with fixed particles is steady, or goes on in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlowKind {
    Steady,
    Unsteady,
}

/// What the pressure of a flow in time around shapes follows from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PressureKind {
    /// A velocity without divergence: both are solved for together in each step.
    #[default]
    Incompressible,
    /// A speed of sound: explicit steps.
    WeaklyCompressible,
}

impl Kind for Fixed {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn numbers(&self) -> Vec<Number> {
        Self::numbers(self)
    }

    fn cfl_limit(&self, _jitter: f64) -> CflLimit {
        FIXED
    }

    /// Steps of fixed particles carry sound with the flow explicitly, so they must be smaller for a faster flow.
    /// Measured limits are CFL 1.2 at Mach 0.115 (height 0.2) and 0.8 at 0.194 (0.26).
    fn largest_cfl(&self, mach: f64) -> f64 {
        if mach > 0.12 {
            1.2 * 0.12 / mach
        } else {
            f64::INFINITY
        }
    }

    fn usual(&self, has_design: bool) -> Vec<Usual> {
        // The configuration of a run of moving particles has their CFL number.
        let cfl = Usual { key: "time.cfl", value: 1.2, unless: Given::AnotherValue };
        // Around shapes an epoch is a fraction of a second.
        let epochs = Usual { key: "optimise.epochs", value: 60.0, unless: Given::AtAll };
        vec![if has_design { cfl } else { epochs }]
    }
}
