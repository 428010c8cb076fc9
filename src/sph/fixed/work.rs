//! Buffers of a step: fields with ghosts, and lines along x.

use super::grid::{Fields, Grid};
use crate::numerics::lanes::Real;

/// Indices of fields `[rows + 4, stride]`, see [`super::grid::Fields`].
pub mod field {
    // Fields at the start of the step, with ghosts.
    pub const P: usize = 0;
    pub const U: usize = 1;
    pub const V: usize = 2;
    pub const T: usize = 3;
    /// delta c dx grad rho in fluid rows.
    pub const GX: usize = 4;
    pub const GY: usize = 5;
    /// Mass flux m before and after the kick. In fluid rows delta c dx grad rho is added.
    pub const MX: usize = 6;
    pub const MY: usize = 7;
    pub const KICKED_MX: usize = 8;
    pub const KICKED_MY: usize = 9;
    // Metric.
    pub const S: usize = 10;
    pub const K: usize = 11;
    // Cotangents of pressure, temperature, u and v over the denominators of their sums; zero in ghost rows.
    pub const BAR_P: usize = 12;
    pub const BAR_T: usize = 13;
    pub const BAR_U: usize = 14;
    pub const BAR_V: usize = 15;
    /// Velocity after the kick, in fluid rows.
    pub const KICKED_U: usize = 16;
    pub const KICKED_V: usize = 17;
    /// Accumulated cotangents of fields.
    pub const MX_BAR: usize = 18;
    pub const MY_BAR: usize = 19;
    pub const U_BAR: usize = 20;
    pub const V_BAR: usize = 21;
    pub const T_BAR: usize = 22;
    pub const P_BAR: usize = 23;
    pub const GX_BAR: usize = 24;
    pub const GY_BAR: usize = 25;
    pub const COUNT: usize = 26;
}

/// Indices of lines `[stride]` along x.
pub mod line {
    /// D, o_b' and D' of the columns.
    pub const D: usize = 0;
    pub const BOTTOM_SLOPE: usize = 1;
    pub const STRETCH_SLOPE: usize = 2;
    /// D S/(1 + S^2) on the bottom and on the top wall.
    pub const LEAN: [usize; 2] = [3, 4];
    /// Cotangents of the conormal derivatives times their lean.
    pub const ALONG: [usize; 2] = [5, 6];
    /// Cotangents of D, sum S and sum eta S of the columns from both pair sweeps, then those of the leans.
    pub const BARS: usize = 7;
    pub const LEAN_BAR: [usize; 2] = [13, 14];
    /// Momentum along x and mass of columns.
    pub const MOMENTUM: usize = 15;
    pub const MASS: usize = 16;
    pub const COUNT: usize = 17;
}

/// The buffers of a step, with the metric of the walls for which they were last used.
#[derive(Debug)]
pub struct Work<R> {
    /// Fields, then lines.
    pub(crate) numbers: Vec<R>,
    /// Heights of both walls to which the metric belongs.
    pub(crate) walls: Vec<R>,
}

impl<R: Real> Work<R> {
    pub(crate) fn new(grid: &Grid) -> Self {
        Self { numbers: vec![R::default(); field::COUNT * grid.field() + line::COUNT * grid.stride], walls: Vec::new() }
    }

    /// The buffers in a form that threads share.
    pub(crate) fn fields(&mut self, grid: Grid) -> Fields<'_, R> {
        Fields::new(grid, field::COUNT, line::COUNT, &mut self.numbers)
    }

    pub(crate) fn line(&mut self, grid: &Grid, line: usize) -> &mut [R] {
        &mut self.numbers[field::COUNT * grid.field() + line * grid.stride..][..grid.stride]
    }
}
