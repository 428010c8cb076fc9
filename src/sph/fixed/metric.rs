//! The metric of the map, which depends on the heights of the walls, and its adjoint.
//!
//! D_i = (H + o_t - o_b)/H; o_b' and D' are derivatives by the kernel; S = o_b' + D' eta and K_yy = (1 + S^2)/D in all
//! rows and ghost rows; leans of both walls q = D S/(1 + S^2). It is computed once for walls that do not move.

use super::grid::Grid;
use super::lattice::{row, Fixed};
use super::stencil::{derivative, WIDTH};
use super::work::{field, line, Work};
use crate::numerics::lanes::Real;

/// d/dx of a line by the kernel.
fn slope<R: Real>(grid: &Grid, weights: &[f64; WIDTH], of: &[R], column: usize) -> f64 {
    let from = grid.column(column as isize) - WIDTH / 2;
    weights.iter().zip(&of[from..from + WIDTH]).map(|(w, f)| w * f.f64()).sum()
}

impl<R: Real> Fixed<R> {
    /// Computes the metric of a state's walls, unless the workspace already holds it.
    pub(super) fn metric(&self, state: &[R], work: &mut Work<R>) {
        let grid = &self.grid;
        let (n, nx) = (self.particles(), grid.columns);
        let walls = &state[row::Y * n + self.fluid_particles()..][..2 * nx];
        if work.walls == walls {
            return;
        }
        work.walls.clear();
        work.walls.extend_from_slice(walls);
        let (height, weights) = (self.height(), derivative(&self.stencil));
        let make = |value: &dyn Fn(usize) -> f64, to: &mut [R]| {
            (0..nx).for_each(|i| to[grid.column(i as isize)] = R::of(value(i)));
            grid.wrap(to);
        };
        let (bottom, top) = walls.split_at(nx);
        let mut heights = vec![R::default(); grid.stride];
        make(&|i| bottom[i].f64(), &mut heights);
        make(&|i| slope(grid, &weights, &heights, i), work.line(grid, line::BOTTOM_SLOPE));
        make(&|i| (top[i].f64() - bottom[i].f64()) / height, work.line(grid, line::D));
        let stretch = work.line(grid, line::D).to_vec();
        make(&|i| slope(grid, &weights, &stretch, i), work.line(grid, line::STRETCH_SLOPE));
        let rise = work.line(grid, line::STRETCH_SLOPE).to_vec();
        let bottom_slope = work.line(grid, line::BOTTOM_SLOPE).to_vec();
        for (to, eta) in line::LEAN.into_iter().zip([0.0, height]) {
            let lean = |i: usize| {
                let at = grid.column(i as isize);
                let s = bottom_slope[at].f64() + rise[at].f64() * eta;
                stretch[at].f64() * s / (1.0 + s * s)
            };
            make(&lean, work.line(grid, to));
        }
        for r in grid.all_rows() {
            let eta = R::of(self.eta(r));
            let (from, to) = (grid.place(r, 0) - grid.column(0), grid.stride);
            let (s, k) = (field::S * grid.field() + from, field::K * grid.field() + from);
            // Periodic copies are computed as well, from the copies of their inputs.
            for c in grid.column(-2)..grid.column(nx as isize + 2) {
                let slope = bottom_slope[c] + rise[c] * eta;
                work.numbers[s..s + to][c] = slope;
                work.numbers[k..k + to][c] = (R::of(1.0) + slope * slope) / stretch[c];
            }
        }
    }

    /// Maps the cotangents of D, sum S, sum eta S and the leans of columns to those of the walls' heights, which are
    /// added to `bar`, the rows of the boundary points' y `[2 columns]`.
    pub(super) fn metric_bar(&self, work: &mut Work<R>, bar: &mut [R]) {
        let grid = &self.grid;
        let nx = grid.columns;
        let (height, weights) = (self.height(), derivative(&self.stencil));
        let get = |work: &mut Work<R>, line: usize| -> Vec<f64> {
            let line = work.line(grid, line);
            (0..nx).map(|i| line[grid.column(i as isize)].f64()).collect()
        };
        let [mut d, mut bottom_slope, mut rise] = std::array::from_fn(|k| {
            let (first, second) = (get(work, line::BARS + k), get(work, line::BARS + 3 + k));
            first.iter().zip(second).map(|(a, b)| a + b).collect::<Vec<_>>()
        });
        let (stretch, of_bottom, of_rise) =
            (get(work, line::D), get(work, line::BOTTOM_SLOPE), get(work, line::STRETCH_SLOPE));
        for (lean, eta) in line::LEAN_BAR.into_iter().zip([0.0, height]) {
            for (i, q_bar) in get(work, lean).into_iter().enumerate() {
                let s = of_bottom[i] + of_rise[i] * eta;
                let over = 1.0 / (1.0 + s * s);
                d[i] += q_bar * s * over;
                let s_bar = q_bar * stretch[i] * (1.0 - s * s) * over * over;
                bottom_slope[i] += s_bar;
                rise[i] += eta * s_bar;
            }
        }
        // The kernel's derivative is antisymmetric, so its transpose is its negative.
        let transposed =
            |of: &[f64], i: usize| -> f64 { (0..WIDTH).map(|k| -weights[k] * of[(i + nx + k - WIDTH / 2) % nx]).sum() };
        for i in 0..nx {
            let stretch_bar = (d[i] + transposed(&rise, i)) / height;
            bar[i] += R::of(transposed(&bottom_slope, i) - stretch_bar);
            bar[nx + i] += R::of(stretch_bar);
        }
    }
}
