//! Inputs of the operators of a step besides fields, and what is made of pairs.

use super::blocks::Blocks;
use super::model::Consistent;
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::kernels::KernelLanes;
use crate::sph::pace::TimeSteps;
use crate::sph::pairs::{vector, Names, Records, RowGeometry};

/// The model, the tables of the neighbour list and the time steps.
#[derive(Debug, Clone, Copy)]
pub struct Geometry<'a, R> {
    pub model: &'a Consistent<R>,
    pub blocks: &'a Blocks,
    pub times: TimeSteps,
}

/// What a pair's geometry is made of.
pub struct Around<'a, L: Lanes, const D: usize> {
    pairs: RowGeometry<L, D>,
    pub kernel: KernelLanes<L>,
    /// 1/dx.
    pub scale: L,
    weights: Records<'a, L::Real>,
}

impl<'a, L: Lanes, const D: usize> Around<'a, L, D> {
    #[inline(always)]
    pub fn new(geometry: &Geometry<'a, L::Real>) -> Self {
        let (model, fits) = (geometry.model, &geometry.model.fits);
        let pairs = RowGeometry::new(&model.flow);
        Self {
            kernel: pairs.kernel,
            pairs,
            scale: L::splat(L::Real::of(1.0 / fits.spacing)),
            weights: Records::new(&fits.weights, 4, model.particles()),
        }
    }

    /// r_j - r_i and its square, from the records of i and j, which begin with their positions.
    #[inline(always)]
    pub fn towards<const G: usize>(&self, here: &[[L; 4]; G], there: &[[L; 4]; G]) -> ([L; D], L) {
        self.pairs.difference::<true>(&vector::<L, D, G>(there, 0), &vector::<L, D, G>(here, 0))
    }

    /// r over the spacing.
    #[inline(always)]
    pub fn scaled(&self, r: &[L; D], sign: f64) -> [L; D] {
        let scale = self.scale * L::splat(L::Real::of(sign));
        let mut s = *r;
        for d in 0..D {
            s[d] = r[d] * scale;
        }
        s
    }

    /// [`super::Fits::weights`] of some particles.
    #[inline(always)]
    pub fn weights(&self, names: Names<'_, L>) -> [L; 4] {
        self.weights.groups::<L, 1>(names)[0]
    }
}
