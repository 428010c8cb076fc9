//! The sections `[channel]`, `[tank]` and `[water]`: the geometry of the built-in scenes.

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
