//! How far particles see, and how far they have moved.

use super::domain::Images;
use super::error::NeighbourError;
use super::Domain;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::ranks::Ranks;
use crate::numerics::sweep::{run_rows, RowKernel};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Who the particles are, and how far they see.
#[derive(Debug, Clone, Copy)]
pub struct Reach<'a> {
    /// `[N]`.
    pub tags: &'a [u8],
    /// Whether a fluid particle has a row of the list, `[N]`; empty where all have.
    pub own: &'a [bool],
    /// Those that other ranks have copies of, ascending.
    pub lent: &'a [u32],
    pub domain: &'a Domain,
    /// Support radius of the smoothing kernel.
    pub cutoff: f64,
    /// Extra reach of the list, which lets it serve several steps.
    pub skin: f64,
    /// Who has the other particles of the flow, if these are a part of them. All ranks make their lists anew at the same time.
    pub ranks: Option<&'a Ranks>,
}

/// Lowest and highest coordinates, in three directions.
pub type Bounds = [[f64; 2]; 3];

/// Bounds of some of the particles at positions `[D, N]`.
pub fn bounds<R: Real>(positions: &[R], n: usize, some: impl Iterator<Item = usize>) -> Bounds {
    let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for i in some {
        for (of, row) in bounds.iter_mut().zip(positions.chunks_exact(n)) {
            let x = row[i].f64();
            *of = [of[0].min(x), of[1].max(x)];
        }
    }
    bounds
}

impl Reach<'_> {
    /// Cut-off and skin.
    pub fn distance(&self) -> f64 {
        self.cutoff + self.skin
    }

    /// The largest of the numbers of all ranks.
    pub fn most(&self, own: f64) -> f64 {
        self.ranks.map_or(own, |ranks| ranks.most(own))
    }

    /// Bounds of all particles of the flow at positions `[D, N]`, where these are a part of them.
    pub fn bounds_of_all<R: Real>(&self, positions: &[R]) -> Option<Bounds> {
        let n = self.tags.len();
        let here = || bounds(positions, n, (0..n).filter(|&i| self.own[i]));
        self.ranks.map(|ranks| {
            let all = ranks.all(here().as_flattened());
            let of = |k: usize| all.iter().skip(k).step_by(6).copied();
            [0, 2, 4].map(|k| [of(k).fold(f64::INFINITY, f64::min), of(k + 1).fold(f64::NEG_INFINITY, f64::max)])
        })
    }
}

/// Distance that the fastest particle has moved since the list was built.
pub fn largest_move<R: Real>(reach: &Reach, position: &[R], reference: &[R]) -> Result<f64, NeighbourError> {
    let n = reach.tags.len();
    let largest = LargestMove { reach, position, reference, square: AtomicU64::new(0), lost: AtomicBool::new(false) };
    run_rows(&largest, n);
    if largest.lost.into_inner() {
        for i in 0..n {
            for d in 0..reach.domain.dimension {
                let value = position[d * n + i].f64();
                if !value.is_finite() || value.abs() > 1e10 {
                    return Err(NeighbourError::LostParticle { particle: i, component: d, value });
                }
            }
        }
        return Ok(f64::INFINITY);
    }
    Ok(f64::from_bits(largest.square.into_inner()).sqrt())
}

struct LargestMove<'a, R> {
    reach: &'a Reach<'a>,
    position: &'a [R],
    reference: &'a [R],
    /// Bits of the largest squared distance: those of numbers that are not negative compare like the numbers.
    square: AtomicU64,
    lost: AtomicBool,
}

impl<R: Real> RowKernel<R> for LargestMove<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (n, domain) = (self.reach.tags.len(), self.reach.domain);
        let images = Images::<L, 3>::new(domain);
        let (mut most, mut sum) = (L::zero(), L::zero());
        for from in rows.clone().step_by(L::COUNT) {
            let mut r2 = L::zero();
            for d in 0..domain.dimension {
                let part = |values: &[R]| L::load_part(&values[d * n + from..d * n + rows.end.min(from + L::COUNT)]);
                let dr = images.nearest(d, part(self.position) - part(self.reference));
                r2 = dr.mul_add(dr, r2);
            }
            sum += r2;
            most = r2.select_less(most, most, r2);
        }
        // A sum is not a number, or huge, if one of its terms is.
        let sane = sum.sum() < R::of(1e30);
        if !sane {
            self.lost.store(true, Ordering::Relaxed);
        }
        self.square.fetch_max(most.largest().f64().to_bits(), Ordering::Relaxed);
    }
}
