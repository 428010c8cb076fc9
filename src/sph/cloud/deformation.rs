//! How fixed particles follow a shape: a harmonic map.
//!
//! Points on an outline move with it, at frozen parameters, other points of the boundary stay, and inside the displacement
//! is the solution of Laplace's equation with the reference cloud's own fits (as in a mesh morphing; Helenbrook 2003). It
//! is linear in the displacement of the outlines, so one factorisation serves all shapes.

use super::equations::Operators;
use super::fit::Stencils;
use crate::numerics::sparse_lu::{BlockMatrix, Order, Singular, SparseLu};
use std::sync::Arc;

/// The map of a reference cloud.
#[derive(Debug)]
pub struct Deformation {
    inside: usize,
    matrix: BlockMatrix,
    lu: SparseLu,
}

impl Deformation {
    /// # Errors
    /// A reference cloud whose Laplace equation has no solution.
    pub fn new(
        stencils: &Stencils,
        operators: &Operators,
        places: &[[f64; 2]],
        inside: usize,
        threads: usize,
    ) -> Result<Self, Singular> {
        let n = stencils.particles;
        let mut matrix = BlockMatrix::of_lists(n, 1, |i| {
            (0..stencils.neighbours).map(|k| stencils.neighbour(i, k) as u32).collect()
        });
        for i in 0..n {
            let diagonal = matrix.entry(i, i as u32);
            if i >= inside {
                matrix.values[diagonal] = 1.0;
                continue;
            }
            for k in 0..stencils.neighbours {
                let c = operators.flow.of(i, k);
                let entry = matrix.entry(i, stencils.neighbour(i, k) as u32);
                matrix.values[entry] += c[2] + c[4];
                matrix.values[diagonal] -= c[2] + c[4];
            }
        }
        let order = Arc::new(Order::new(&matrix, |i| places[i]));
        let lu = SparseLu::new(&order, &matrix, threads)?;
        Ok(Self { inside, matrix, lu })
    }

    fn solve(&self, right: &[f64], transposed: bool) -> Vec<f64> {
        let mut x = self.lu.solve(right, transposed);
        let rest: Vec<f64> = right.iter().zip(self.matrix.times(&x, transposed)).map(|(r, p)| r - p).collect();
        x.iter_mut().zip(self.lu.solve(&rest, transposed)).for_each(|(x, more)| *x += more);
        x
    }

    /// The displacement of all particles `[N]` along a direction, given that of the boundary `[N - inside]`.
    pub fn displacement(&self, boundary: &[f64]) -> Vec<f64> {
        if boundary.iter().all(|&x| x == 0.0) {
            return vec![0.0; self.inside + boundary.len()];
        }
        let mut right = vec![0.0; self.inside];
        right.extend_from_slice(boundary);
        self.solve(&right, false)
    }

    /// The adjoint: cotangents of the boundary's displacement, given those of all.
    pub fn pull_back(&self, bar: &[f64]) -> Vec<f64> {
        self.solve(bar, true)[self.inside..].to_vec()
    }
}
