//! How fixed particles follow a shape: a harmonic map.
//!
//! Points on an outline move with it, at frozen parameters, other points of the boundary stay, and inside the displacement
//! is the solution of Laplace's equation with the reference cloud's own fits (as in a mesh morphing; Helenbrook 2003). It
//! is linear in the displacement of the outlines, so one factorisation serves all shapes.

use super::fit::{Coefficients, Stencils};
use crate::numerics::sparse_lu::{BlockMatrix, Order, Singular, SparseLu};
use crate::sph::consistent::stencil::laplacian;
use std::sync::Arc;

/// Laplace's equation at particles inside, and what is given at the others.
pub(super) fn laplace<const D: usize, const C: usize>(
    stencils: &Stencils<D>,
    operators: &Coefficients<C>,
    inside: usize,
) -> BlockMatrix {
    let mut matrix = stencils.matrix(1);
    for i in 0..stencils.particles {
        let diagonal = matrix.entry(i, i as u32);
        if i >= inside {
            matrix.values[diagonal] = 1.0;
            continue;
        }
        for k in 0..stencils.count(i) {
            let c = operators.of(i, k);
            let value = laplacian::<f64, D>(|a| c[a]);
            let entry = matrix.entry(i, stencils.neighbour(i, k) as u32);
            matrix.values[entry] += value;
            matrix.values[diagonal] -= value;
        }
    }
    matrix
}

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
        operators: &Coefficients,
        places: &[[f64; 2]],
        inside: usize,
        threads: usize,
    ) -> Result<Self, Singular> {
        let matrix = laplace(stencils, operators, inside);
        let order = Arc::new(Order::new(&matrix, |i| places[i]));
        let lu = SparseLu::new(&order, &matrix, threads)?;
        Ok(Self { inside, matrix, lu })
    }

    /// The displacement of all particles `[N]` along a direction, given that of the boundary `[N - inside]`.
    pub fn displacement(&self, boundary: &[f64]) -> Vec<f64> {
        if boundary.iter().all(|&x| x == 0.0) {
            return vec![0.0; self.inside + boundary.len()];
        }
        let mut right = vec![0.0; self.inside];
        right.extend_from_slice(boundary);
        self.lu.refined(&self.matrix, &right, false)
    }

    /// The adjoint: cotangents of the boundary's displacement, given those of all.
    pub fn pull_back(&self, bar: &[f64]) -> Vec<f64> {
        self.lu.refined(&self.matrix, bar, true)[self.inside..].to_vec()
    }
}
