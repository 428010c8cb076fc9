//! The channel that a lattice of fixed particles fills.

use crate::sph::kernels::Kernel;
use crate::sph::laws::drive::Drive;

/// Where the edge between an adiabatic and a hot wall acts on the lattice, in spacings from the middle of a cell towards the hot
/// side, by the share 0, 1/16, ..., 1 of the cell that has the hot wall's [ghosts](super::ghosts).
///
/// T_hot - T grows with the root of the distance from such an edge, which no lattice resolves. Near it, conduction is all that
/// counts, so the place follows from Laplace's equation on the lattice of a half disc alone: it is the x for which the values
/// r^(1/2) sin(theta/2) around x, given on the arc, hold inside too. A share that is the covered part of the cell would be off
/// by up to 0.18 spacings. (Neither the flow, nor the heights, nor finite elements enter. The test `edge` computes the table.)
pub const EDGE: [f64; 17] = [
    0.6845, 0.5464, 0.4288, 0.3275, 0.2395, 0.1622, 0.0938, 0.0328, -0.0219, -0.0711, -0.1159, -0.1566, -0.1938,
    -0.2280, -0.2595, -0.2886, -0.3155,
];

/// The share of a cell for an edge that is `place` spacings from its middle towards the hot side: the inverse of [`EDGE`].
fn share_of_edge(place: f64) -> f64 {
    let last = EDGE.len() - 1;
    match EDGE.iter().position(|&acts| acts <= place) {
        Some(0) => 0.0,
        None => 1.0,
        Some(k) => (k as f64 - (place - EDGE[k]) / (EDGE[k - 1] - EDGE[k])) / last as f64,
    }
}

/// The settings of a heated channel for [`super::Fixed`], in the scene's units of length, time and temperature.
#[derive(Debug, Clone)]
pub struct Channel {
    pub columns: usize,
    pub rows: usize,
    /// Lattice spacing dx in both directions; the length is columns dx, the height between flat walls rows dx.
    pub spacing: f64,
    /// x of column 0.
    pub first_column_x: f64,
    pub kernel: Kernel,
    /// Reference density.
    pub density: f64,
    pub sound_speed: f64,
    /// Kinematic viscosity nu.
    pub viscosity: f64,
    /// Thermal diffusivity alpha.
    pub diffusivity: f64,
    /// Acceleration along x.
    pub body_force: f64,
    /// Drive that replaces the body force, which is then 0.
    pub drive: Option<Drive>,
    /// Strength of the density diffusion; 0.1 is suitable, 0.02 too small.
    pub delta: f64,
    pub dt: f64,
    /// The range of x in which the bottom wall is hot.
    pub hot: [f64; 2],
    /// Temperature of the hot wall above that of the inlet. Stored temperatures are relative to the inlet too.
    pub hot_excess: f64,
    /// Columns with x below this have the inlet's temperature.
    pub inlet_below: f64,
    /// Columns with x above this have the temperature of the last column before it.
    pub outlet_above: f64,
    /// Factor of the flux along the adiabatic part of the bottom wall: 1, or 0 for none (see [`super::ghosts`]).
    pub conormal: f64,
}

impl Channel {
    pub fn x(&self, column: usize) -> f64 {
        self.first_column_x + column as f64 * self.spacing
    }

    /// How hot the bottom wall is in each column's cell, `[columns]`: 1, or 0, and in the cells of both edges the share with
    /// which the edge acts where it is (see [`EDGE`]).
    pub fn hot_share(&self) -> Vec<f64> {
        self.between_edges(share_of_edge).collect()
    }

    /// How much of each column's cell is covered by the part of the bottom wall that is not hot, `[columns]`.
    pub(super) fn cold_cover(&self) -> Vec<f64> {
        self.between_edges(|place| (0.5 - place).clamp(0.0, 1.0)).map(|hot| 1.0 - hot).collect()
    }

    /// [`between_edges`] of each column's cell.
    fn between_edges<'a>(&'a self, part: impl Fn(f64) -> f64 + 'a) -> impl Iterator<Item = f64> + 'a {
        (0..self.columns).map(move |i| between_edges(self.hot, self.spacing, self.x(i), &part))
    }
}

/// The part of the cell around x between both edges of the hot section, given the part on the hot side of an edge that is so many spacings
/// from the middle of the cell towards that side.
pub fn between_edges(hot: [f64; 2], spacing: f64, x: f64, part: impl Fn(f64) -> f64) -> f64 {
    let part = |distance: f64| part(distance / spacing);
    (part(hot[0] - x) + part(x - hot[1]) - 1.0).max(0.0)
}
