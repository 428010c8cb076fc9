//! How the lattice lies in memory: fields of rows with margins, so that a vector's neighbours are plain loads.
//!
//! Row r = 0 .. rows - 1 is fluid, from the bottom; rows -2, -1, rows, rows + 1 are ghosts beyond the walls. Along x the
//! channel is periodic: the two columns beyond either end are copies of those at the other end.

use crate::numerics::lanes::{Lanes, Real, WIDEST};
use crate::numerics::sweep::{run_rows, run_rows_alone, RowKernel};
use crate::sph::own::Own;
use std::ops::Range;

/// Rows of ghosts beyond each wall, and columns that are copied beyond each end: how far a stencil reaches.
pub const REACH: usize = 2;
/// Columns in front of column 0: a whole vector, of which the last [`REACH`] are copies.
const MARGIN: usize = 8;
/// Columns that are computed together, all rows of them: the unit that threads share out. Ghosts are made of fluid rows of
/// the same column, so a unit can make those of what it has just computed, and threads need not meet in between.
pub const UNIT: usize = 8;

/// As many units and fewer are swept on one thread: a sweep of 500 particles takes 6 us, and a step has four.
const ALONE: usize = 8;

/// Runs a sweep over units.
pub fn run<R: Real, K: RowKernel<R>>(kernel: &K, units: usize) {
    if units <= ALONE {
        run_rows_alone(kernel, 0..units);
    } else {
        run_rows(kernel, units);
    }
}

/// The shape of a field `[rows + 4, stride]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    pub columns: usize,
    pub rows: usize,
    /// Numbers from a row to the next.
    pub stride: usize,
}

impl Grid {
    pub fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, stride: MARGIN + columns.next_multiple_of(WIDEST) + MARGIN }
    }
    /// Numbers of a field.
    pub fn field(&self) -> usize {
        (self.rows + 2 * REACH) * self.stride
    }
    /// Units of columns.
    pub fn units(&self) -> usize {
        self.columns.div_ceil(UNIT)
    }
    /// The columns of some units.
    #[inline(always)]
    pub fn columns_of(&self, units: Range<usize>) -> Range<usize> {
        units.start * UNIT..(units.end * UNIT).min(self.columns)
    }
    /// Where a column stands in a row (also in a line `[stride]`).
    #[inline(always)]
    pub fn column(&self, column: isize) -> usize {
        (column + MARGIN as isize) as usize
    }
    #[inline(always)]
    pub fn place(&self, row: isize, column: isize) -> usize {
        (row + REACH as isize) as usize * self.stride + self.column(column)
    }
    #[inline(always)]
    pub fn is_fluid(&self, row: isize) -> bool {
        row >= 0 && row < self.rows as isize
    }
    /// All rows, ghosts included.
    #[inline(always)]
    pub fn all_rows(&self) -> Range<isize> {
        -(REACH as isize)..(self.rows + REACH) as isize
    }
    /// Rows in a stencil's reach of `row`: all for a fluid row, only fluid for a ghost.
    #[inline(always)]
    pub fn reach_of(&self, row: isize) -> Range<isize> {
        let (from, to) = (row - REACH as isize, row + REACH as isize + 1);
        match self.is_fluid(row) {
            true => from..to,
            false => from.max(0)..to.min(self.rows as isize),
        }
    }
    /// Fills the copies beyond both ends of a row, or of a line.
    pub fn wrap<R: Copy>(&self, row: &mut [R]) {
        let n = self.columns as isize;
        for k in 0..REACH as isize {
            row[self.column(n + k)] = row[self.column(k)];
            row[self.column(-1 - k)] = row[self.column(n - 1 - k)];
        }
    }
}

/// Many fields of one grid and, behind them, lines `[stride]` in one piece of memory, which threads write each in columns of
/// its own.
pub struct Fields<'a, R> {
    pub grid: Grid,
    numbers: Own<'a, R>,
    /// Where the lines begin.
    lines: usize,
}

impl<'a, R: Real> Fields<'a, R> {
    pub fn new(grid: Grid, fields: usize, lines: usize, numbers: &'a mut [R]) -> Self {
        let first_line = fields * grid.field();
        assert!(numbers.len() >= first_line + lines * grid.stride, "a field or a line without numbers");
        Self { grid, numbers: Own::new(numbers), lines: first_line }
    }

    /// A field's numbers at a row from a column on, both of fluid particles or up to [`REACH`] beyond; behind the last column
    /// come copies, then anything. Sweeps read only what was written before them, or by the unit itself.
    #[inline(always)]
    pub fn get<L: Lanes<Real = R>>(&self, field: usize, row: isize, column: isize) -> L {
        self.load(field * self.grid.field() + self.grid.place(row, column))
    }

    /// [`Self::get`] of a line.
    #[inline(always)]
    pub fn line<L: Lanes<Real = R>>(&self, line: usize, column: isize) -> L {
        self.load(self.lines + line * self.grid.stride + self.grid.column(column))
    }

    /// Stores what belongs to columns `column ..` of a unit, and the copies that are made of them.
    #[inline(always)]
    pub fn put<L: Lanes<Real = R>>(&self, field: usize, row: isize, column: usize, value: L) {
        self.store(field * self.grid.field() + self.grid.place(row, 0), column, value);
    }

    /// [`Self::put`] of a line.
    #[inline(always)]
    pub fn put_line<L: Lanes<Real = R>>(&self, line: usize, column: usize, value: L) {
        self.store(self.lines + line * self.grid.stride + self.grid.column(0), column, value);
    }

    /// Sum of a line's columns, in their order.
    pub fn sum_of_line(&self, line: usize) -> f64 {
        let from = self.lines + line * self.grid.stride + self.grid.column(0);
        (0..self.grid.columns).map(|column| self.numbers.get(from + column).f64()).sum()
    }

    #[inline(always)]
    fn load<L: Lanes<Real = R>>(&self, place: usize) -> L {
        // SAFETY: `new` has checked that fields and lines are there, whose margins are as wide as the widest vector.
        unsafe { L::load(self.numbers.as_ptr().add(place)) }
    }

    #[inline(always)]
    fn store<L: Lanes<Real = R>>(&self, start: usize, column: usize, value: L) {
        let n = self.grid.columns;
        store_part(&self.numbers, start + column, value, n - column);
        if column < REACH || column + L::COUNT > n - REACH {
            // Only the unit that has a column makes its copies.
            let copy = |from: usize, to: usize| self.numbers.set(to, self.numbers.get(from));
            for k in column..n.min(column + L::COUNT) {
                if k < REACH {
                    copy(start + k, start + n + k);
                }
                if k >= n - REACH {
                    copy(start + k, start + k - n);
                }
            }
        }
    }
}

/// Stores the first `count` lanes, or all, in columns of a unit's own: a sweep over units gives each to one thread.
#[inline(always)]
pub fn store_part<L: Lanes>(to: &Own<'_, L::Real>, place: usize, value: L, count: usize) {
    if count >= L::COUNT {
        return to.store(place, value);
    }
    let lanes = value.numbers();
    (0..count).for_each(|k| to.set(place + k, lanes[k]));
}
