//! The sections `[fluid]`, `[flow]` and `[heat]`: materials and driving forces.

use crate::config::range::Range::{Finite, NotNegative, Positive, Within};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "fluid.": Fluid {
        density: f64 = 1.0, Positive;
        viscosity: f64 = 0.01, Positive;
        body_force: f64 = 2.3, NotNegative;
        gravity: [f64; 3] = [0.0, -1.0, 0.0];
        body_force_region: BodyForceRegion = BodyForceRegion::Fluid;
        drive: DriveName = DriveName::BodyForce;
        #[serde(skip_serializing_if = "Option::is_none")]
        flow_rate: Option<f64> = None, Positive;
        #[serde(skip_serializing_if = "Option::is_none")]
        pumping_power: Option<f64> = None, Positive;
        conductivity: f64 = 7.313, Positive;
        heat_capacity: f64 = 305.27, Positive;
        inlet_temperature: f64 = 1.0, Finite;
        #[serde(skip_serializing_if = "is_zero")]
        expansion: f64 = 0.0, Finite;
        #[serde(skip_serializing_if = "Option::is_none")]
        reference_temperature: Option<f64> = None, Finite;
        reference_velocity: f64 = 1.0, Positive;
        sound_speed_factor: f64 = 10.0, Within(1.0, 1000.0);
    }
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BodyForceRegion {
    Fluid,
    OriginalChannel,
}

/// The quantity that is held, see [`crate::sph::laws::drive`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriveName {
    BodyForce,
    /// The acceleration that maintains a given flow rate.
    FlowRate,
    /// The acceleration that has a given power.
    PumpingPower,
}

section! {
    /// The verification flows: reference velocity, density and length are 1.
    "flow.": Flow {
        reynolds: f64 = 100.0, Positive;
    }
}

section! {
    /// Heat of the verification flows.
    "heat.": Heat {
        conductivity_ratio: f64 = 1.0, Within(1e-6, 1e6);
        capacity_ratio: f64 = 1.0, Within(1e-6, 1e6);
        prandtl: f64 = 1.0, Within(1e-3, 1e3);
        upper_wall: UpperWall = UpperWall::Isothermal;
    }
}

/// The upper wall of the isothermal channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpperWall {
    Isothermal,
    Adiabatic,
}
