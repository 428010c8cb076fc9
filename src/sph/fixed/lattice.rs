//! Particles on a lattice that is mapped to the space between two walls: positions, areas, masses.

use super::channel::Channel;
use super::factors::Factors;
use super::ghosts::Ghosts;
use super::grid::{self, Grid};
use super::stencil::{self, Stencil};
use super::work::Work;
use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::numerics::pool::Pool;
use candle_core::Tensor;
use std::sync::OnceLock;

/// Rows of a state `[6, N]`. Boundary points have a position; their other rows are zero.
pub mod row {
    pub const X: usize = 0;
    pub const Y: usize = 1;
    pub const U: usize = 2;
    pub const V: usize = 3;
    pub const P: usize = 4;
    pub const T: usize = 5;
    pub const COUNT: usize = 6;
}

/// Fixed particles in a channel, with everything that does not change between steps.
#[derive(Debug)]
pub struct Fixed<R> {
    pub channel: Channel,
    pub(crate) grid: Grid,
    pub(crate) stencil: Stencil<R>,
    pub(crate) ghosts: Ghosts<R>,
    /// 1 where a column's temperature is computed, 0 at the inlet, `[columns + 16]`.
    pub(crate) open: Vec<R>,
    /// The last column whose temperature is computed; the columns after it have the same temperature.
    pub(crate) outlet: usize,
    /// Buffers that steps reuse.
    pub(crate) works: Pool<Work<R>>,
    /// See [`super::newton`]; made when they are first asked for.
    pub(crate) reference: OnceLock<Option<Factors>>,
}

impl<R: Real> Fixed<R> {
    /// # Errors
    /// Too few columns or rows for the stencils; a kernel that reaches beyond them; an outlet before the first column.
    pub fn new(channel: Channel) -> Result<Self, BadInput> {
        let least = 2 * grid::REACH + 1;
        if channel.columns < least || channel.rows < least {
            return Err(BadInput::new(format!(
                "{} columns and {} rows of fixed particles",
                channel.columns, channel.rows
            ))
            .allowed(format!("at least {least} of each"))
            .advice("a smaller resolution.dx"));
        }
        if channel.kernel.cutoff() > (grid::REACH as f64 + 1.0 + 1e-9) * channel.spacing {
            return Err(BadInput::new(
                "fixed particles see two neighbours in each direction; this kernel reaches further",
            )
            .key("resolution.smoothing_length")
            .allowed(format!("a support of at most {} dx", grid::REACH + 1)));
        }
        let near = 1e-9 * channel.spacing;
        let Some(outlet) = (0..channel.columns).rev().find(|&i| channel.x(i) <= channel.outlet_above + near) else {
            return Err(BadInput::new("the outlet begins before the first column of particles"));
        };
        // A particle at the outlet sees columns with its own temperature on all of its reach, and not the inlet's behind them.
        let outlet = outlet.min(channel.columns - 1 - grid::REACH);
        let grid = Grid::new(channel.columns, channel.rows);
        // Nor does one behind the inlet see the outlet's columns.
        let is_open = |i: usize| i >= grid::REACH && channel.x(i) >= channel.inlet_below - near;
        let mut open: Vec<R> = (0..channel.columns).map(|i| R::of(f64::from(u8::from(is_open(i))))).collect();
        open.resize(channel.columns + grid::UNIT, R::default());
        Ok(Self {
            grid,
            stencil: stencil::stencil(&channel.kernel, channel.spacing),
            ghosts: Ghosts::new(&channel, &grid),
            open,
            outlet,
            works: Pool::default(),
            reference: OnceLock::new(),
            channel,
        })
    }

    pub fn fluid_particles(&self) -> usize {
        self.channel.columns * self.channel.rows
    }

    /// Number of particles: fluid particles, then points of the bottom wall, then points of the top wall.
    pub fn particles(&self) -> usize {
        self.fluid_particles() + 2 * self.channel.columns
    }

    /// Number of values of a state.
    pub fn state_length(&self) -> usize {
        row::COUNT * self.particles()
    }

    /// Height between flat walls.
    pub fn height(&self) -> f64 {
        self.channel.rows as f64 * self.channel.spacing
    }

    /// Reference coordinate eta of a row of the lattice; negative and beyond the height for ghost rows.
    pub(crate) fn eta(&self, row: isize) -> f64 {
        (row as f64 + 0.5) * self.channel.spacing
    }

    /// A state `[6, N]` at the inlet's temperature with velocity u(eta) along x. The walls are at the heights `bottom`
    /// above 0 and `top` above the channel's height, both `[columns]`.
    pub fn state(&self, bottom: &[f64], top: &[f64], u: &dyn Fn(f64) -> f64) -> Vec<R> {
        let (n, nx) = (self.particles(), self.channel.columns);
        let mut state = vec![R::default(); self.state_length()];
        for i in 0..n {
            let (row, column) = (i / nx, i % nx);
            state[row::X * n + i] = R::of(self.channel.x(column));
            let stretch = (self.height() + top[column] - bottom[column]) / self.height();
            let eta = self.eta(row as isize);
            state[row::Y * n + i] = R::of(if row < self.channel.rows {
                state[row::U * n + i] = R::of(u(eta));
                bottom[column] + stretch * eta
            } else if row == self.channel.rows {
                bottom[column]
            } else {
                self.height() + top[column]
            });
        }
        state
    }

    /// Weights of rows in an integral over eta from wall to wall, over dx, `[fluid particles]`, for quantities that are
    /// zero on the walls: 11/12 in the rows next to the walls, else 1.
    ///
    /// By the Euler-Maclaurin formula the sum of rows lacks dx^2/24 (f' on the top wall - f' on the bottom wall), and
    /// f' on a wall is 2 f_1/dx.
    pub fn section_weights(&self) -> Vec<f64> {
        let (nx, ny) = (self.channel.columns, self.channel.rows);
        (0..nx * ny).map(|i| self.row_weight(i / nx)).collect()
    }

    /// Area of the fluid particles, D dx^2, `[fluid particles]`.
    pub fn volumes(&self, state: &[R]) -> Vec<f64> {
        let (bottom, top) = self.walls(state);
        let square = self.channel.spacing * self.channel.spacing;
        let nx = self.channel.columns;
        (0..self.fluid_particles())
            .map(|i| (top[i % nx].f64() - bottom[i % nx].f64()) / self.height() * square)
            .collect()
    }

    /// Density rho of a pressure.
    pub fn density(&self, pressure: R) -> R {
        let c = &self.channel;
        R::of(c.density) + pressure * R::of(1.0 / (c.sound_speed * c.sound_speed))
    }

    /// Mass of fluid particles in sums over a cross-section, rho D dx^2 times [`Self::section_weights`]; 0 for walls;
    /// `[1, N]`, on the graph.
    pub fn masses(&self, state: &Tensor) -> candle_core::Result<Tensor> {
        let (nx, fluid, c) = (self.channel.columns, self.fluid_particles(), &self.channel);
        let y = state.narrow(0, row::Y, 1)?;
        let height = (y.narrow(1, fluid + nx, nx)? - y.narrow(1, fluid, nx)?)?;
        let stretch = Tensor::cat(&vec![height; self.channel.rows], 1)?;
        let square = c.spacing * c.spacing / self.height();
        let weights: Vec<R> = self.section_weights().into_iter().map(|w| R::of(w * square)).collect();
        let weights = Tensor::from_vec(weights, (1, fluid), state.device())?.to_dtype(state.dtype())?;
        let density = state.narrow(0, row::P, 1)?.narrow(1, 0, fluid)?;
        let density = density.affine(1.0 / (c.sound_speed * c.sound_speed), c.density)?;
        let masses = stretch.mul(&weights)?.mul(&density)?;
        Tensor::cat(&[masses, Tensor::zeros((1, 2 * nx), state.dtype(), state.device())?], 1)
    }

    /// Heights of the points of the bottom and the top wall, `[columns]` each.
    pub fn walls<'a>(&self, state: &'a [R]) -> (&'a [R], &'a [R]) {
        let y = &state[row::Y * self.particles()..][..self.particles()];
        y[self.fluid_particles()..].split_at(self.channel.columns)
    }

    /// A workspace for one step.
    pub fn work(&self) -> Work<R> {
        self.works.take().unwrap_or_else(|| Work::new(&self.grid))
    }

    /// Returns a workspace for reuse.
    pub fn done(&self, work: Work<R>) {
        self.works.give_back(work);
    }
}
