//! The channel that a lattice of fixed particles fills.

use crate::sph::kernels::Kernel;
use crate::sph::laws::drive::Drive;

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

    /// Fraction of each column's cell, x - dx/2 .. x + dx/2, in which the bottom wall is hot, `[columns]`.
    pub fn hot_share(&self) -> Vec<f64> {
        let half = 0.5 * self.spacing;
        (0..self.columns)
            .map(|i| {
                let covered = self.hot[1].min(self.x(i) + half) - self.hot[0].max(self.x(i) - half);
                let share = (covered / self.spacing).clamp(0.0, 1.0);
                // An edge at the end of a cell must not give a fraction of 1e-15.
                if share < 1e-9 {
                    0.0
                } else if share > 1.0 - 1e-9 {
                    1.0
                } else {
                    share
                }
            })
            .collect()
    }
}
