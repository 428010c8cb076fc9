//! The section `[wall]`.

use crate::config::range::Range::Finite;
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "wall.": Wall {
        hot_temperature: f64 = 1.23, Finite;
        /// Where the hot temperature holds: on the wall's surface, or in its dummy particles (as in JAX-SPH).
        hot_isotherm: HotIsotherm = HotIsotherm::Surface;
        /// Particle mass in a deformed column: scaled with the column's area, or constant (as in JAX-SPH).
        mass: MassConvention = MassConvention::ColumnArea;
        /// Standard method: the velocity condition at walls.
        slip: SlipName = SlipName::NoSlip;
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HotIsotherm {
    Surface,
    Dummy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MassConvention {
    ColumnArea,
    Constant,
}

/// The velocity condition at walls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlipName {
    NoSlip,
    FreeSlip,
}
