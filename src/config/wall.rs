//! The section `[wall]`.

use crate::config::range::Range::Finite;
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "wall.": Wall {
        hot_temperature: f64 = 1.23, Finite;
        hot_isotherm: HotIsotherm = HotIsotherm::Surface;
        mass: MassConvention = MassConvention::ColumnArea;
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlipName {
    NoSlip,
    FreeSlip,
}
