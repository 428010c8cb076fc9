//! The sections `[resolution]` and `[time]`: particle spacing, smoothing kernel and time step.

use crate::config::range::{
    Range::{Above, Positive, Within},
    MAX_STEPS,
};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "resolution.": Resolution {
        dx: f64 = 0.02, Positive;
        kernel: KernelName = KernelName::QuinticSpline;
        smoothing_length: f64 = 0.8, Within(0.5, 3.0);
        /// Spacing of fixed particles on surfaces of shapes; none: dx / 3.
        #[serde(skip_serializing_if = "Option::is_none")]
        surface: Option<f64> = None, Positive;
        /// The largest spacing of fixed particles far from bodies, in dx; none: 1.
        #[serde(skip_serializing_if = "Option::is_none")]
        far: Option<f64> = None, Within(1.0, 64.0);
        #[serde(skip_serializing_if = "Option::is_none")]
        growth: Option<f64> = None, Within(0.01, 0.3);
    }
}

/// The smoothing kernel W(r, h).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelName {
    /// Quintic spline (Morris, Fox and Zhu 1997): reaches 3 h.
    QuinticSpline,
    /// Cubic spline (Monaghan and Lattanzio 1985): reaches 2 h.
    CubicSpline,
    /// Wendland's C2 function (Wendland 1995; Dehnen and Aly 2012): reaches 2 h.
    WendlandC2,
    /// Wendland's C4 function: reaches 2 h.
    WendlandC4,
    /// Wendland's C6 function: reaches 2 h.
    WendlandC6,
    /// Gaussian (Gingold and Monaghan 1977), cut off at 3 h.
    Gaussian,
    /// Super-Gaussian (Monaghan 1992), negative in its outer part, cut off at 3 h.
    SuperGaussian,
}

impl KernelName {
    /// Radius beyond which the kernel is zero, in smoothing lengths.
    pub fn support(self) -> f64 {
        match self {
            Self::QuinticSpline | Self::Gaussian | Self::SuperGaussian => 3.0,
            Self::CubicSpline | Self::WendlandC2 | Self::WendlandC4 | Self::WendlandC6 => 2.0,
        }
    }
}

section! {
    "time.": Time {
        end: f64 = 2.5, Positive;
        #[serde(skip_serializing_if = "Option::is_none")]
        steps: Option<usize> = None, Within(1.0, MAX_STEPS);
        #[serde(skip_serializing_if = "Option::is_none")]
        step: Option<f64> = None, Positive;
        #[serde(deserialize_with = "crate::config::stability::cfl")]
        cfl: f64 = 1.5, Above(0.0, 4.0);
        diffusion_number: f64 = 0.25, Above(0.0, 1.0);
        adaptive: bool = false;
        start: Start = Start::Developed;
        jitter: f64 = 0.05, Within(0.0, 0.3);
        skin: f64 = 0.2, Above(0.0, 2.0);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    Rest,
    Developed,
}
