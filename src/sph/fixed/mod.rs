//! Fixed particles: the kernel in the reference lattice of a channel, the walls' shape in the metric of a map.
//!
//! A total-Lagrangian (arbitrary Lagrangian-Eulerian) form of SPH: particles stay on the lattice (xi, eta), mapped to
//!
//! x = xi, y = o_b(x) + D eta, D = (H + o_t - o_b)/H, S = dy/dxi = o_b' + D' eta,
//!
//! where a prime is the kernel's own derivative along x. With
//! K_xx = D, K_xy = -S, K_yy = (1 + S^2)/D averaged over a pair, Omega = K : l the pair's weight of div K grad,
//! m = (D rho u, rho (v - S u)) the mass flux through the lattice, and one flux M_ab = -M_ba per pair for mass, momentum and
//! heat alike,
//!
//! * M = (m_a + m_b) . g - delta c dx w [rho_b - rho_a - (grad rho_a + grad rho_b) . r_ab / 2];
//! * D rho' = -sum M;
//! * D rho u' = sum (nu Omega - M/2)(u_b - u_a) - sum [g_x (D_a + D_b) - g_y (S_a + S_b)] (p_b - p_a)/2 + D rho g;
//! * D rho v' = sum (nu Omega - M/2)(v_b - v_a) - sum g_y p_b;
//! * D rho T' = sum (alpha rho_a Omega - M/2)(T_b - T_a);
//!
//! p = c^2 (rho - 1), everything per reference density. Differences of p, so that a uniform pressure exerts no force over
//! any wall: the kernel's derivatives of D and of S cancel only over walls that are smooth, and Q is better too (0.24 for
//! 0.33 % on average). Two rows of ghosts beyond each wall: u, v, m_x and a hot T quadratic through the wall's value, m_y
//! odd, p linear, an adiabatic T even with the flux along the wall taken out (conormal).
//!
//! A step (symplectic): M, kick u and v (and what a [`Drive`] adds), M again of the new velocities, rho and T by the same M. Mass is kept to rounding.
//! The steady state does not depend on the step: at H = 0.2 over walls of +-0.02 its Q is within 1.0 % (dx = 0.02) and 0.5 %
//! (0.01) of finite elements. dt: at most 1.2 dx/(c + u), and what diffusion allows.
//!
//! Needs a channel: rows from wall to wall, periodic in x. Antuono et al. 2010 (delta term with gradient correction);
//! Morris, Fox and Zhu 1997 (viscosity, boundary values); Bonet and Lok 1999 (kernels with corrected moments).
//!
//! One sweep of a step is one [`sweeps`] kernel; [`adjoint`] has their reverses and [`composed`] the same from candle's
//! operators; [`steady`] finds steady states and their gradients.

pub mod adjoint;
pub mod composed;
mod drive;
pub mod ghosts;
pub mod grid;
pub mod metric;
pub mod operator;
pub mod steady;
pub mod stencil;
pub mod sweeps;
pub mod work;

pub use operator::FixedStep;
pub use work::Work;

use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::numerics::pool::Pool;
use crate::sph::consistent::operators::Shown;
use crate::sph::kernels::Kernel;
use crate::sph::laws::drive::Drive;
use crate::sph::model::Model;
use candle_core::Tensor;
use ghosts::Ghosts;
use grid::Grid;
use stencil::Stencil;

/// Rows of a state `[6, N]`. Boundary points have a position, and zeros.
pub mod row {
    pub const X: usize = 0;
    pub const Y: usize = 1;
    pub const U: usize = 2;
    pub const V: usize = 3;
    pub const P: usize = 4;
    pub const T: usize = 5;
    pub const COUNT: usize = 6;
}

/// A heated channel, as [`Fixed`] is built of it. Lengths, times, temperatures in the scene's units.
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
    /// What drives the flow instead; then the body force is 0.
    pub drive: Option<Drive>,
    /// Strength of the diffusion of the density; 0.1 is right, 0.02 too little.
    pub delta: f64,
    pub dt: f64,
    /// Where the bottom wall is hot, from .. to.
    pub hot: [f64; 2],
    /// Temperature of the hot wall above the inlet's; stored temperatures are above the inlet's too.
    pub hot_excess: f64,
    /// Columns with x below this have the inlet's temperature.
    pub inlet_below: f64,
    /// Columns with x above this have the temperature of the last one that is not.
    pub outlet_above: f64,
    /// What the flux along the bottom wall counts where that is adiabatic: 1, or 0 for none (see [`ghosts`]).
    pub conormal: f64,
}

impl Channel {
    /// x of a column.
    pub fn x(&self, column: usize) -> f64 {
        self.first_column_x + column as f64 * self.spacing
    }

    /// The share of each column's cell, x - dx/2 .. x + dx/2, in which the bottom wall is hot.
    pub fn hot_share(&self) -> Vec<f64> {
        let half = 0.5 * self.spacing;
        (0..self.columns)
            .map(|i| {
                let covered = self.hot[1].min(self.x(i) + half) - self.hot[0].max(self.x(i) - half);
                let share = (covered / self.spacing).clamp(0.0, 1.0);
                // An edge on a cell's end must not become a share of 1e-15.
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

/// Fixed particles in a channel: everything that does not change from step to step.
#[derive(Debug)]
pub struct Fixed<R> {
    pub channel: Channel,
    pub(crate) grid: Grid,
    pub(crate) stencil: Stencil<R>,
    pub(crate) ghosts: Ghosts<R>,
    /// 1 where a column's temperature is computed, 0 at the inlet, `[columns + 16]`.
    pub(crate) open: Vec<R>,
    /// The last column whose temperature is computed; those behind it have the same.
    pub(crate) outlet: usize,
    /// What steps borrow, so that they do not allocate.
    pub(crate) works: Pool<Work<R>>,
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
        let grid = Grid::new(channel.columns, channel.rows);
        let mut open: Vec<R> =
            (0..channel.columns).map(|i| R::of((channel.x(i) >= channel.inlet_below - near) as u8 as f64)).collect();
        open.resize(channel.columns + grid::UNIT, R::default());
        Ok(Self {
            grid,
            stencil: stencil::stencil(&channel.kernel, channel.spacing),
            ghosts: Ghosts::new(&channel, &grid),
            open,
            outlet,
            works: Pool::default(),
            channel,
        })
    }

    pub fn fluid_particles(&self) -> usize {
        self.channel.columns * self.channel.rows
    }

    /// Fluid particles, then the points of the bottom wall, then those of the top wall.
    pub fn particles(&self) -> usize {
        self.fluid_particles() + 2 * self.channel.columns
    }

    /// Numbers of a state.
    pub fn state_length(&self) -> usize {
        row::COUNT * self.particles()
    }

    /// Height between flat walls.
    pub fn height(&self) -> f64 {
        self.channel.rows as f64 * self.channel.spacing
    }

    pub fn length(&self) -> f64 {
        self.channel.columns as f64 * self.channel.spacing
    }

    /// eta of a row of the lattice, ghosts included.
    pub(crate) fn eta(&self, row: isize) -> f64 {
        (row as f64 + 0.5) * self.channel.spacing
    }

    /// A state `[6, N]` at rest (or with a velocity u of each row) and at the inlet's temperature, between walls that are
    /// `bottom` above 0 and `top` above the height, both `[columns]`.
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

    /// Weights of rows in an integral from wall to wall over eta, over dx, `[fluid particles]`: 1, and 11/12 in the rows next
    /// to the walls, for quantities that are zero on them.
    ///
    /// Euler and Maclaurin: the sum of rows lacks dx^2/24 (f' on the top wall - f' on the bottom wall), and f' on a wall is
    /// 2 f_1/dx there.
    pub fn section_weights(&self) -> Vec<f64> {
        let (nx, ny) = (self.channel.columns, self.channel.rows);
        (0..nx * ny).map(|i| self.row_weight(i / nx)).collect()
    }

    /// Area of the fluid particles of a state, D dx^2, `[fluid particles]`.
    pub fn volumes(&self, state: &[R]) -> Vec<f64> {
        let (bottom, top) = self.walls(state);
        let square = self.channel.spacing * self.channel.spacing;
        let nx = self.channel.columns;
        (0..self.fluid_particles())
            .map(|i| (top[i % nx].f64() - bottom[i % nx].f64()) / self.height() * square)
            .collect()
    }

    /// rho of a pressure.
    pub fn density(&self, pressure: R) -> R {
        let c = &self.channel;
        R::of(c.density) + pressure * R::of(1.0 / (c.sound_speed * c.sound_speed))
    }

    /// Mass of the fluid's particles as sections count it, rho D dx^2 times [`Self::section_weights`], 0 for walls, `[1, N]`,
    /// on the graph.
    ///
    /// # Errors
    /// Tensor errors.
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

    /// A state as fields are made of it, on the graph.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn shown(&self, model: &Model<R>, state: &Tensor) -> candle_core::Result<Shown> {
        let wall_heat = model.wall_heat_until.map(|until| self.heating(state, until)).transpose()?;
        Ok(Shown { known: state.clone(), masses: self.masses(state)?, wall_heat })
    }

    /// Heights of the bottom and of the top wall's points, `[columns]` each.
    pub fn walls<'a>(&self, state: &'a [R]) -> (&'a [R], &'a [R]) {
        let y = &state[row::Y * self.particles()..][..self.particles()];
        y[self.fluid_particles()..].split_at(self.channel.columns)
    }

    /// A workspace that no other step has.
    pub fn work(&self) -> Work<R> {
        self.works.take().unwrap_or_else(|| Work::new(&self.grid))
    }

    /// For the next step.
    pub fn done(&self, work: Work<R>) {
        self.works.give_back(work);
    }
}
