//! Diffusion of the density, a term of delta-SPH in the continuity equation.
//!
//! drho_i/dt gains delta h c sum_j V_j psi_ij . grad_i W_ij over fluid j, where
//! psi_ij = -2 (rho_j - rho_i) r_ij/r_ij^2 - g_i - g_j
//! (Antuono, Colagrossi, Marrone and Molteni 2010, eq. 5; Marrone et al. 2011, eq. 4). g_i = A_i^-1 sum_j V_j
//! (rho_j - rho_i) grad_i W_ij is the gradient of the density, renormalised by A_i = -sum_j V_j r_ij (x) grad_i W_ij,
//! so that a linear density is not diffused and still water stays at rest.

use super::continuity::{DensityTerm, Exchange, Flowing, Meeting};
use super::pair_law::dot;
use crate::config::scene::DensityGradient;
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use crate::sph::masks::above;
use candle_core::{Result, Tensor};

/// Smallest determinant of A (1 in the interior, 1/2 at a flat surface). Below it the gradient is set to 0.
pub const LEAST_DETERMINANT: f64 = 0.05;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityDiffusion {
    /// delta; 0.1 is usual.
    pub strength: f64,
    /// Speed of sound c.
    pub sound_speed: f64,
    /// Smoothing length h.
    pub smoothing_length: f64,
    pub gradient: DensityGradient,
}

/// A symmetric matrix per particle, stored by rows: `[D D, N]`.
struct Matrices {
    dimension: usize,
    rows: Tensor,
}

impl Matrices {
    /// A = -sum_j V_j F r_ij (x) r_ij.
    fn of(flowing: &Flowing) -> Result<Self> {
        let r = &flowing.pairs.difference;
        let (d, weight) = (r.dim(0)?, flowing.weight()?.neg()?);
        let mut rows = Vec::new();
        for a in 0..d {
            rows.push(r.broadcast_mul(&r.narrow(0, a, 1)?.mul(&weight)?)?.sum(2)?);
        }
        Ok(Self { dimension: d, rows: Tensor::cat(&rows, 0)? })
    }

    fn entry(&self, a: usize, b: usize) -> Result<Tensor> {
        self.rows.narrow(0, a * self.dimension + b, 1)
    }

    /// The inverse by cofactors. If `least` is given, it is 0 where the determinant is not above `least`.
    fn inverse(&self, least: Option<f64>) -> Result<Self> {
        let (d, m) = (self.dimension, |a: usize, b: usize| self.entry(a % self.dimension, b % self.dimension));
        let mut cofactors = Vec::new();
        for a in 0..d {
            for b in 0..d {
                // The cyclic indices give the sign in 3D. The matrix is symmetric, so its adjugate is too.
                cofactors.push(match d {
                    2 if a == b => m(a + 1, b + 1)?,
                    2 => m(a, b)?.neg()?,
                    _ => (m(a + 1, b + 1)?.mul(&m(a + 2, b + 2)?)? - m(a + 1, b + 2)?.mul(&m(a + 2, b + 1)?)?)?,
                });
            }
        }
        let mut determinant = m(0, 0)?.mul(&cofactors[0])?;
        for b in 1..d {
            determinant = (determinant + m(0, b)?.mul(&cofactors[b])?)?;
        }
        let mut rows = Tensor::cat(&cofactors, 0)?;
        if let Some(least) = least {
            let good = above(&determinant, least)?;
            // 1 where there is no inverse, to avoid a division by zero.
            determinant = (determinant.mul(&good)? + good.affine(-1.0, 1.0)?)?;
            rows = rows.broadcast_mul(&good)?;
        }
        Ok(Self { dimension: d, rows: rows.broadcast_div(&determinant)? })
    }

    /// The product with a vector per particle, `[D, N]`, or per pair, `[D, N, K]`, by the neighbours' matrices.
    fn apply(&self, vector: &Tensor, pairs: Option<&Pairs>) -> Result<Tensor> {
        let rows = |a: usize| self.rows.narrow(0, a * self.dimension, self.dimension);
        let row = |a: usize| match pairs {
            Some(pairs) => pairs.other(&rows(a)?)?.mul(vector)?.sum_keepdim(0),
            None => rows(a)?.mul(vector)?.sum_keepdim(0),
        };
        Tensor::cat(&(0..self.dimension).map(row).collect::<Result<Vec<_>>>()?, 0)
    }
}

impl DensityTerm for DensityDiffusion {
    /// s = delta h c/rho.
    #[inline(always)]
    fn share<L: Lanes>(&self, density: L) -> (L, L) {
        let share = L::splat(L::Real::of(self.factor())) / density;
        (share, -share)
    }

    /// X = psi . r, with the gradients g of the density as vectors; 0 at walls.
    #[inline(always)]
    fn exchange<L: Lanes, const D: usize>(&self, at: &Meeting<L, D>) -> Exchange<L, D> {
        let two = at.fluid.apply(L::splat(L::Real::of(2.0)));
        let (mut by_difference, mut by_vector) = ([L::zero(); D], [L::zero(); D]);
        for d in 0..D {
            by_difference[d] = -at.fluid.apply(at.vector[0][d] + at.vector[1][d]);
            by_vector[d] = -at.fluid.apply(at.difference[d]);
        }
        let value = two.mul_add(at.density[0] - at.density[1], dot(&by_difference, at.difference));
        Exchange { value, by_density: two, by_difference, by_vector }
    }
}

impl DensityDiffusion {
    /// delta h c.
    fn factor(&self) -> f64 {
        self.strength * self.smoothing_length * self.sound_speed
    }

    /// The gain of drho/dt, `[1, N]`, by candle's operators.
    pub fn composed(&self, flowing: &Flowing, among_walls: impl FnOnce() -> Result<Tensor>) -> Result<Tensor> {
        let (pairs, r) = (flowing.pairs, &flowing.pairs.difference);
        let weight = flowing.weight()?;
        // rho_j - rho_i.
        let rise = (pairs.other(flowing.density)? - pairs.own(flowing.density)?)?;
        let climb = r.broadcast_mul(&rise.mul(&weight)?)?.sum(2)?;
        let mut matrices = Matrices::of(flowing)?;
        let (own, other) = match self.gradient {
            DensityGradient::Renormalised => {
                let gradient = matrices.inverse(Some(LEAST_DETERMINANT))?.apply(&climb, None)?;
                (gradient.clone(), gradient)
            }
            DensityGradient::JaxSph => {
                // In JAX-SPH the matrices of walls include pairs of wall particles, which our lists lack.
                matrices.rows = (matrices.rows + among_walls()?)?;
                let inverse = matrices.inverse(None)?;
                let along = r.broadcast_mul(&rise.mul(flowing.slope)?)?;
                let other = inverse.apply(&along, Some(pairs))?.sum(2)?.broadcast_mul(flowing.volume)?.neg()?;
                (inverse.apply(&climb, None)?, other)
            }
        };
        let gradients = (pairs.own(&own)? + pairs.other(&other)?)?.mul(r)?.sum_keepdim(0)?;
        let psi = (rise.affine(-2.0, 0.0)? - gradients)?;
        let fluid = pairs.other(&pairs.is_fluid)?;
        let sum = weight.mul(&psi)?.mul(&fluid)?.sum(2)?;
        sum.affine(self.factor(), 0.0)
    }
}
