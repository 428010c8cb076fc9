//! The sections `[channel]`, `[tank]` and `[water]`: the geometry of the built-in scenes.

use crate::config::range::Range::{Finite, NotNegative, Positive, Within};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "channel.": Channel {
        /// Length of the periodic direction x.
        length: f64 = 1.0, Positive;
        /// Height of the fluid between the undeformed walls.
        height: f64 = 0.2, Positive;
        /// In three dimensions: width along z, across the flow, which is periodic.
        span: f64 = 0.2, Positive;
        /// Rows of dummy particles per wall: at least the kernel's support.
        wall_rows: usize = 2, Within(0.0, 100.0);
        /// The hot section of the bottom wall: hot_from < x < hot_to.
        hot_from: f64 = 0.25, NotNegative;
        hot_to: f64 = 0.75, NotNegative;
        /// Fluid at x < inlet_length is reset to the inlet temperature.
        inlet_length: f64 = 0.06, NotNegative;
        /// Fluid at x > length - outlet_length does not conduct.
        outlet_length: f64 = 0.06, NotNegative;
    }
}

section! {
    /// A tank with walls on all sides.
    "tank.": Tank {
        /// Inner length along x.
        length: f64 = 5.36, Positive;
        /// Inner height along y.
        height: f64 = 2.0, Positive;
        /// Depth along z, which is periodic.
        depth: f64 = 0.4, Positive;
    }
}

section! {
    /// The initial block of water in the tank.
    "water.": Water {
        length: f64 = 2.0, Positive;
        height: f64 = 1.0, Positive;
        /// Position of its lower corner relative to that of the tank.
        x: f64 = 0.0, NotNegative;
        y: f64 = 0.0, NotNegative;
        /// Downward speed.
        speed: f64 = 0.0, Finite;
    }
}
