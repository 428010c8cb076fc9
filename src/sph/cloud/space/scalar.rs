//! Systems of one unknown a particle, such as heat and the map of positions: GMRES with incomplete factors.

use crate::numerics::krylov::{gmres, gmres_restarted};
use crate::numerics::sparse_lu::{dot, BlockMatrix, Singular};
use crate::numerics::two_level::TwoLevel;

/// Products of a solution with one unknown a particle.
const PRODUCTS: (usize, usize) = (100, 1000);
/// Products of one in a preconditioner.
const NEARLY: usize = 80;

/// A system of one unknown a particle, with its incomplete factors.
#[derive(Debug)]
pub struct Scalar {
    matrix: BlockMatrix,
    factors: TwoLevel,
    threads: usize,
}

impl Scalar {
    /// # Errors
    /// A particle without a diagonal entry.
    pub fn new(matrix: BlockMatrix, threads: usize) -> Result<Self, Singular> {
        let factors = TwoLevel::new(&matrix, threads)?;
        Ok(Self { matrix, factors, threads })
    }

    /// The solution to rounding.
    pub fn solve(&self, right: &[f64]) -> Option<Vec<f64>> {
        self.solve_to(right, 1e-12)
    }

    fn solve_to(&self, right: &[f64], tolerance: f64) -> Option<Vec<f64>> {
        let times = |x: &[f64]| self.matrix.times_on(x, self.threads);
        gmres_restarted(right, tolerance, PRODUCTS, &times, &|x| self.factors.solve(&self.matrix, x, self.threads))
    }

    /// The solution to a part of the norm of the right-hand side, from a first guess.
    pub fn solve_from(&self, right: &[f64], first: &[f64], tolerance: f64) -> Option<Vec<f64>> {
        let left: Vec<f64> = right.iter().zip(self.matrix.times_on(first, self.threads)).map(|(b, y)| b - y).collect();
        let norm = |x: &[f64]| dot(x, x).sqrt();
        let (least, now) = (tolerance * norm(right), norm(&left));
        if now <= least {
            return Some(first.to_vec());
        }
        let change = self.solve_to(&left, least / now)?;
        Some(first.iter().zip(change).map(|(x, change)| x + change).collect())
    }

    pub(super) fn size(&self) -> usize {
        self.matrix.nodes()
    }

    pub(super) fn times(&self, x: &[f64]) -> Vec<f64> {
        self.matrix.times_on(x, self.threads)
    }

    /// A solution to a part of the norm of the right-hand side, of a preconditioner.
    pub(super) fn nearly(&self, right: &[f64], tolerance: f64) -> Vec<f64> {
        let solve = |x: &[f64]| self.factors.solve(&self.matrix, x, self.threads);
        gmres(right, tolerance, NEARLY, &|x| self.times(x), &solve).unwrap_or_else(|| solve(right))
    }

    /// Memory of the matrix and its factors.
    pub fn bytes(&self) -> usize {
        12 * self.matrix.values.len() + self.factors.bytes()
    }
}
