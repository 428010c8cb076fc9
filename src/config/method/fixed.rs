//! The method `fixed`: the consistent equations on a fixed lattice mapped between the walls, see [`crate::sph::fixed`].

use crate::config::method::kind::{Facts, Given, Kind, PlaneChannel, Usual};
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
        deferred_correction: bool = false;
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

    /// A step kicks the velocities first, and moves density with the new ones. So plane sound of wave number k that runs with a flow of
    /// speed u grows at the rate k^2 u (c + u) dt / 2, which is the error of first order of the explicit advection. Three things hold
    /// it: viscosity by nu k^2 / 2, the pressure's diffusion by delta c dx k^4 dx^2 / 8, and the layers at the walls by
    /// (nu c k / 2)^(1/2) / H (Kirchhoff 1868, one wall on either side). The step is the longest one that no wave of the channel needs
    /// shorter, with the stencil's values for waves of a few spacings, u at the centre line, and 5/4 of the walls' share, which makes up
    /// for the slower flow next to them. Largest stable steps were looked for in 22 channels with 7 to 21 spacings between the walls,
    /// Reynolds numbers 18 to 57 and Mach numbers 0.07 to 0.23: where they are below a CFL number of 1.25, this one is
    /// 0.6 to 0.98 of them.
    fn longest_step(&self, channel: &PlaneChannel) -> f64 {
        let PlaneChannel { length, height, speed, sound_speed, kinematic_viscosity, spacing } = *channel;
        let viscosity = kinematic_viscosity / (sound_speed * spacing);
        let mach = speed / sound_speed;
        let waves = (length / spacing / 3.0) as usize;
        // Rates over c / dx; the wave number over 1 / dx.
        let courant = (1..=waves.max(1)).map(|n| {
            let k = std::f64::consts::TAU * n as f64 * spacing / length;
            let square = k * k;
            let slope = k * (1.0 - 0.165 * square + 0.008 * square * square);
            let viscous = viscosity * square * (1.0 - 0.083 * square);
            let diffused = self.pressure_diffusion * square * square * (0.248 - 0.0325 * square);
            let at_walls = 1.25 * (2.0 * viscosity * k).sqrt() * spacing / height;
            (viscous + diffused + at_walls) / (slope * slope * mach * (1.0 + mach))
        });
        courant.fold(f64::INFINITY, f64::min) * spacing / sound_speed
    }

    fn usual(&self, has_design: bool) -> Vec<Usual> {
        // The configuration of a run of moving particles has their CFL number.
        let cfl = Usual { key: "time.cfl", value: 1.2, unless: Given::AnotherValue };
        // Around shapes an epoch is a fraction of a second.
        let epochs = Usual { key: "optimise.epochs", value: 60.0, unless: Given::AtAll };
        vec![if has_design { cfl } else { epochs }]
    }
}
