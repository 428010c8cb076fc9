//! The sections `[channel]`, `[tank]`, `[water]` and `[wall]`: the geometry of the built-in scenes, and their walls.

use crate::config::range::Range::{Finite, NotNegative, Positive, Within};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "channel.": Channel {
        length: f64 = 1.0, Positive;
        height: f64 = 0.2, Positive;
        span: f64 = 0.2, Positive;
        wall_rows: usize = 2, Within(0.0, 100.0);
        hot_from: f64 = 0.25, NotNegative;
        hot_to: f64 = 0.75, NotNegative;
        inlet_length: f64 = 0.06, NotNegative;
        outlet_length: f64 = 0.06, NotNegative;
    }
}

section! {
    /// A tank with walls on all sides.
    "tank.": Tank {
        length: f64 = 5.36, Positive;
        height: f64 = 2.0, Positive;
        depth: f64 = 0.4, Positive;
    }
}

section! {
    /// The initial block of water in the tank.
    "water.": Water {
        length: f64 = 2.0, Positive;
        height: f64 = 1.0, Positive;
        x: f64 = 0.0, NotNegative;
        y: f64 = 0.0, NotNegative;
        speed: f64 = 0.0, Finite;
    }
}

section! {
    "wall.": Wall {
        hot_temperature: f64 = 1.23, Finite;
        hot_isotherm: HotIsotherm = HotIsotherm::Surface;
        mass: MassConvention = MassConvention::ColumnArea;
        slip: Slip = Slip::None;
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
pub enum Slip {
    /// The fluid at a wall has the wall's velocity.
    #[default]
    #[serde(rename = "no-slip")]
    None,
    /// The wall exerts no shear stress.
    #[serde(rename = "free-slip")]
    Free,
}
