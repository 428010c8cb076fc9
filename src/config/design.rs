//! The section `[design]`: the shape of a channel's walls.

use crate::config::range::Range::{Finite, NotNegative, Positive, Within};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "design.": Design {
        /// The walls that are shaped.
        walls: DesignWalls = DesignWalls::Bottom;
        parametrisation: ParametrisationName = ParametrisationName::Nodes;
        /// Control points of the B-spline, along the channel.
        control_points: usize = 8, Within(4.0, 1000.0);
        /// In three dimensions: control points across the channel.
        control_points_across: usize = 4, Within(1.0, 1000.0);
        /// Named initial shape; `offsets` and `file` take precedence.
        shape: ShapeName = ShapeName::Flat;
        /// Amplitude of the named shape.
        amplitude: f64 = 0.01, Finite;
        /// Periods of sine and cosine over the hot section.
        periods: f64 = 1.0, Positive;
        /// In three dimensions: periods over the span of a cosine that multiplies the named shape.
        periods_across: usize = 0, Within(0.0, 1000.0);
        /// Positions of the nodes; default: one per spacing, hot_from + dx/2, hot_from + 3 dx/2, ...
        #[serde(skip_serializing_if = "Option::is_none")]
        nodes: Option<Vec<f64>> = None;
        /// Height of the wall above y = 0 at each node; positive narrows the channel.
        #[serde(skip_serializing_if = "Option::is_none")]
        offsets: Option<Vec<f64>> = None;
        /// Depth of the top wall below y = H at the same nodes; default: flat.
        #[serde(skip_serializing_if = "Option::is_none")]
        top_offsets: Option<Vec<f64>> = None;
        /// CSV file with columns x, offset, and top for both walls (a run's shape.csv).
        #[serde(skip_serializing_if = "Option::is_none")]
        file: Option<String> = None;
        /// |offset| <= bound.
        bound: f64 = 0.02, NotNegative;
    }
}

/// The walls that the optimiser changes, between channel.hot_from and channel.hot_to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DesignWalls {
    /// The bottom wall, which has the hot section.
    Bottom,
    /// The bottom and the top wall, independently of each other.
    Both,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ParametrisationName {
    /// The offset of every node.
    Nodes,
    /// The control points of a cubic B-spline over the hot section.
    BSpline,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShapeName {
    Flat,
    /// Every offset equal to the amplitude.
    Uniform,
    Sine,
    Cosine,
    /// From -amplitude to +amplitude.
    Linear,
    /// Random and uniform in +-amplitude at each node, by the run's seed.
    Random,
}
