//! The box that particles live in, and the nearest images over its periodic edges.

use crate::numerics::lanes::{array, Lanes, Real};
use candle_core::{Result, Tensor};

/// The box: `dimension` (2 or 3) lengths, periodic or not direction by direction. Its lower corner is at 0 where it is
/// periodic; where it is not, the corner does not matter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Domain {
    pub dimension: usize,
    pub size: [f64; 3],
    pub periodic: [bool; 3],
}

impl Domain {
    /// 1 / size in periodic directions, 0 in the others: `d - size * round(d * inverse)` is then the nearest image
    /// everywhere.
    #[inline]
    pub fn inverse_period(&self) -> [f64; 3] {
        array(|d| if self.periodic[d] { 1.0 / self.size[d] } else { 0.0 })
    }

    /// A difference of coordinates in direction `d`: the shortest one of all images.
    #[inline]
    pub fn nearest(&self, d: usize, difference: f64) -> f64 {
        match self.periodic[d] {
            true => difference - self.size[d] * (difference * (1.0 / self.size[d])).round(),
            false => difference,
        }
    }

    /// [`Self::nearest`] in the precision of a run.
    #[inline(always)]
    pub fn nearest_image<R: Real>(&self, d: usize, difference: R) -> R {
        let inverse = R::of(self.inverse_period()[d]);
        difference - R::of(self.size[d]) * (difference * inverse + R::of(0.5)).floor()
    }

    /// The image of a coordinate that lies in the box, where it is periodic in direction `d`.
    pub fn wrapped(&self, d: usize, coordinate: f64) -> f64 {
        if !self.periodic[d] {
            return coordinate;
        }
        let inside = coordinate.rem_euclid(self.size[d]);
        // Just below 0, the remainder rounds to the box's length itself.
        if inside < self.size[d] {
            inside
        } else {
            0.0
        }
    }

    /// [`Self::nearest`] of tensors that hold differences in direction `d`. Which image it is does not change with an
    /// infinitesimal step: a constant as far as derivatives go.
    pub fn nearest_of(&self, d: usize, difference: &Tensor) -> Result<Tensor> {
        if !self.periodic[d] {
            return Ok(difference.clone());
        }
        let turns = difference.detach().affine(1.0 / self.size[d], 0.0)?.round()?;
        difference - turns.affine(self.size[d], 0.0)?
    }

    /// [`Self::wrapped`] of tensors that hold coordinates in direction `d`.
    pub fn wrapped_of(&self, d: usize, coordinate: &Tensor) -> Result<Tensor> {
        if !self.periodic[d] {
            return Ok(coordinate.clone());
        }
        let turns = coordinate.detach().affine(1.0 / self.size[d], 0.0)?.floor()?;
        coordinate - turns.affine(self.size[d], 0.0)?
    }
}

/// [`Domain::nearest`] in lanes.
#[derive(Clone, Copy)]
pub struct Images<L: Lanes, const D: usize> {
    size: [L; D],
    inverse: [L; D],
}

impl<L: Lanes, const D: usize> Images<L, D> {
    #[inline(always)]
    pub fn new(domain: &Domain) -> Self {
        let inverse = domain.inverse_period();
        let of = L::Real::of;
        Self { size: array(|d| L::splat(of(domain.size[d]))), inverse: array(|d| L::splat(of(inverse[d]))) }
    }

    #[inline(always)]
    pub fn nearest(&self, d: usize, difference: L) -> L {
        difference - self.size[d] * (difference * self.inverse[d]).round()
    }
}

/// A coordinate in direction `d` after a step: back into the box, where it is periodic.
#[inline(always)]
pub fn wrapped<R: Real>(domain: &Domain, d: usize, x: R) -> R {
    if !domain.periodic[d] {
        return x;
    }
    let size = R::of(domain.size[d]);
    let up = if x < R::default() { x + size } else { x };
    // Not `else`: a tiny negative x plus the size rounds to the size itself.
    if up >= size {
        up - size
    } else {
        up
    }
}
