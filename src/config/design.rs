//! The section `[design]`: the shape of a channel's walls.

use crate::config::range::Range::{Finite, NotNegative, Positive, Within};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "design.": Design {
        walls: DesignWalls = DesignWalls::Bottom;
        parametrisation: ParametrisationName = ParametrisationName::Nodes;
        control_points: usize = 8, Within(4.0, 1000.0);
        control_points_across: usize = 4, Within(1.0, 1000.0);
        shape: ShapeName = ShapeName::Flat;
        amplitude: f64 = 0.01, Finite;
        periods: f64 = 1.0, Positive;
        periods_across: usize = 0, Within(0.0, 1000.0);
        #[serde(skip_serializing_if = "Option::is_none")]
        nodes: Option<Vec<f64>> = None;
        #[serde(skip_serializing_if = "Option::is_none")]
        offsets: Option<Vec<f64>> = None;
        #[serde(skip_serializing_if = "Option::is_none")]
        top_offsets: Option<Vec<f64>> = None;
        #[serde(skip_serializing_if = "Option::is_none")]
        file: Option<String> = None;
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
