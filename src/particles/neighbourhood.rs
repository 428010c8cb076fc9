//! The neighbour list of a run: kept while its skin lasts, rebuilt from where it was built before.

use super::domain::Images;
use super::neighbour_list::{NeighbourError, NeighbourList, Workspace};
use super::{Domain, Search};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;

/// Who the particles are, and how far they see.
#[derive(Debug, Clone, Copy)]
pub struct Reach<'a> {
    /// `[N]`.
    pub tags: &'a [u8],
    pub domain: &'a Domain,
    /// Support radius of the smoothing kernel.
    pub cutoff: f64,
    /// Extra reach of the list, which lets it serve several steps.
    pub skin: f64,
}

impl Reach<'_> {
    /// Cut-off and skin.
    pub fn distance(&self) -> f64 {
        self.cutoff + self.skin
    }
}

/// The neighbour list of a run and the positions it was built from.
#[derive(Debug, Clone)]
pub struct Neighbourhood<R> {
    pub list: Arc<NeighbourList>,
    /// `[D, N]`.
    pub reference: Arc<Vec<R>>,
    /// Another one for every list that was ever built: who has made something of a list knows whether it is still of this
    /// one.
    pub identity: u64,
    workspace: Workspace<R>,
}

/// Lists that were built.
static BUILT: AtomicU64 = AtomicU64::new(1);

impl<R: Search> Neighbourhood<R> {
    /// Builds the list from positions `[D.., N]` (the leading rows of a state will do).
    ///
    /// # Errors
    /// Lost or clumped particles, a box too small.
    pub fn build(reach: &Reach, position: &[R]) -> Result<Self, NeighbourError> {
        let mut new = Self::empty();
        new.rebuild(reach, position)?;
        Ok(new)
    }

    /// A list that [`Self::rebuild_at`] has still to build.
    pub fn empty() -> Self {
        let list = Arc::new(NeighbourList::default());
        Self { list, reference: Arc::new(Vec::new()), identity: 0, workspace: Workspace::default() }
    }

    /// The same list and reference, for somebody who only reads them.
    pub fn shared(&self) -> Self {
        let (list, reference) = (self.list.clone(), self.reference.clone());
        Self { list, reference, identity: self.identity, workspace: Workspace::default() }
    }

    /// Builds the list of another run's or an earlier reference, in the old list's memory unless somebody else still
    /// holds it.
    ///
    /// # Errors
    /// As for [`Self::build`].
    pub fn rebuild_at(&mut self, reach: &Reach, reference: &Arc<Vec<R>>) -> Result<(), NeighbourError> {
        // The same place in memory: states of one list are known by it.
        self.reference = reference.clone();
        self.rebuild_list(reach)
    }

    /// Builds the list anew, likewise.
    fn rebuild(&mut self, reach: &Reach, position: &[R]) -> Result<(), NeighbourError> {
        let position = &position[..reach.domain.dimension * reach.tags.len()];
        match Arc::get_mut(&mut self.reference) {
            Some(reference) => {
                reference.clear();
                reference.extend_from_slice(position);
            }
            None => self.reference = Arc::new(position.to_vec()),
        }
        self.rebuild_list(reach)
    }

    fn rebuild_list(&mut self, reach: &Reach) -> Result<(), NeighbourError> {
        if Arc::get_mut(&mut self.list).is_none() {
            let list = NeighbourList { capacity: self.list.capacity, ..NeighbourList::default() };
            self.list = Arc::new(list);
        }
        self.identity = BUILT.fetch_add(1, Ordering::Relaxed);
        let list = Arc::get_mut(&mut self.list).expect("just made, or nobody else's");
        R::rebuild(list, &self.reference, reach.tags, reach.domain, reach.distance(), &mut self.workspace)
    }

    /// Rebuilds the list if somebody has moved half the skin since it was built. Whether it does depends on the
    /// positions and the reference only, so a replay does the same.
    ///
    /// # Errors
    /// As for [`Self::build`]; a particle that moved half the cut-off in one step.
    pub fn update(&mut self, reach: &Reach, position: &[R]) -> Result<(), NeighbourError> {
        let moved = R::largest_move(reach, position, &self.reference)?;
        // One step never moves a particle that far unless the run has diverged.
        if moved > 0.5 * reach.cutoff {
            let particle = furthest(reach, position, &self.reference);
            return Err(NeighbourError::TooFast { particle, distance: moved, cutoff: reach.cutoff });
        }
        if 2.0 * moved >= reach.skin {
            self.rebuild(reach, position)?;
        }
        Ok(())
    }
}

/// The particle that has moved furthest since the list was built.
fn furthest<R: Real>(reach: &Reach, position: &[R], reference: &[R]) -> usize {
    let (n, domain) = (reach.tags.len(), reach.domain);
    let moved = |i: usize| -> f64 {
        let along = |d: usize| domain.nearest(d, position[d * n + i].f64() - reference[d * n + i].f64());
        (0..domain.dimension).map(|d| along(d).powi(2)).sum()
    };
    (0..n).max_by(|&i, &j| moved(i).total_cmp(&moved(j))).unwrap_or_default()
}

/// Distance that the fastest particle has moved since the list was built.
///
/// # Errors
/// A position that is not a number.
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
