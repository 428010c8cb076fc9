//! The section `[time]`.

use crate::config::range::{
    Range::{Above, Positive, Within},
    MAX_STEPS,
};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "time.": Time {
        /// Physical time to simulate.
        end: f64 = 2.5, Positive;
        /// Number of steps; if given, it replaces `end`.
        #[serde(skip_serializing_if = "Option::is_none")]
        steps: Option<usize> = None, Within(1.0, MAX_STEPS);
        /// Time step; if given, it replaces the largest stable one.
        #[serde(skip_serializing_if = "Option::is_none")]
        step: Option<f64> = None, Positive;
        /// Acoustic time step: dt <= cfl * dx / (sound speed + reference velocity).
        #[serde(deserialize_with = "crate::config::stability::cfl")]
        cfl: f64 = 1.5, Above(0.0, 4.0);
        /// Diffusive time step: dt <= diffusion_number * dx^2 / max(viscosity / density, thermal diffusivity).
        diffusion_number: f64 = 0.25, Above(0.0, 1.0);
        /// Whether a step is divided where the flow is faster or accelerated more than expected.
        adaptive: bool = false;
        /// Initial flow: at rest, or with the developed parabolic profile (steady in half the time).
        start: Start = Start::Developed;
        /// Random displacement of the fluid particles at the start, standard deviation in spacings.
        jitter: f64 = 0.05, Within(0.0, 0.3);
        /// Extra reach of the neighbour list, in spacings.
        skin: f64 = 0.2, Above(0.0, 2.0);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    Rest,
    Developed,
}
