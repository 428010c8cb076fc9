//! The memory of a step: fields with ghosts, lines along x.

use super::grid::{Fields, Grid};
use crate::numerics::lanes::Real;

/// Fields `[rows + 4, stride]`, as numbered in [`super::grid::Fields`].
pub mod field {
    // Of the step's start, ghosts included.
    pub const P: usize = 0;
    pub const U: usize = 1;
    pub const V: usize = 2;
    pub const T: usize = 3;
    /// delta c dx grad rho, fluid rows.
    pub const GX: usize = 4;
    pub const GY: usize = 5;
    /// Mass flux m, in fluid rows with delta c dx grad rho added; before and behind the kick.
    pub const MX: usize = 6;
    pub const MY: usize = 7;
    pub const KICKED_MX: usize = 8;
    pub const KICKED_MY: usize = 9;
    // Metric.
    pub const S: usize = 10;
    pub const K: usize = 11;
    // Adjoint: cotangents over what divides the sums: of pressure, temperature, u, v. Zero in ghost rows.
    pub const BAR_P: usize = 12;
    pub const BAR_T: usize = 13;
    pub const BAR_U: usize = 14;
    pub const BAR_V: usize = 15;
    /// Velocity behind the kick, fluid rows.
    pub const KICKED_U: usize = 16;
    pub const KICKED_V: usize = 17;
    /// Cotangents of fields, collected.
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

/// Lines `[stride]` along x.
pub mod line {
    /// The metric of columns: D, o_b', D'.
    pub const D: usize = 0;
    pub const BOTTOM_SLOPE: usize = 1;
    pub const STRETCH_SLOPE: usize = 2;
    /// D S/(1 + S^2) on the bottom and on the top wall.
    pub const BOTTOM_LEAN: usize = 3;
    pub const TOP_LEAN: usize = 4;
    /// Cotangents of conormal derivatives times their lean.
    pub const BOTTOM_ALONG: usize = 5;
    pub const TOP_ALONG: usize = 6;
    /// Cotangents of D, sum S and sum eta S of columns, from the two pair sweeps; of the leans.
    pub const BARS: usize = 7;
    pub const BOTTOM_LEAN_BAR: usize = 13;
    pub const TOP_LEAN_BAR: usize = 14;
    /// Momentum along x and mass of columns.
    pub const MOMENTUM: usize = 15;
    pub const MASS: usize = 16;
    pub const COUNT: usize = 17;
}

/// Memory that a step borrows; holds the metric of the walls that it saw last.
#[derive(Debug)]
pub struct Work<R> {
    /// Fields, then lines.
    pub(crate) numbers: Vec<R>,
    /// Heights of both walls that the metric is of.
    pub(crate) walls: Vec<R>,
}

impl<R: Real> Work<R> {
    pub(crate) fn new(grid: &Grid) -> Self {
        Self { numbers: vec![R::default(); field::COUNT * grid.field() + line::COUNT * grid.stride], walls: Vec::new() }
    }

    /// The numbers as threads share them.
    pub(crate) fn fields(&mut self, grid: Grid) -> Fields<'_, R> {
        Fields::new(grid, field::COUNT, &mut self.numbers)
    }

    /// A line.
    pub(crate) fn line(&mut self, grid: &Grid, line: usize) -> &mut [R] {
        &mut self.numbers[field::COUNT * grid.field() + line * grid.stride..][..grid.stride]
    }
}
