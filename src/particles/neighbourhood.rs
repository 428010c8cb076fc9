//! The neighbour list of a run: kept while its skin lasts, rebuilt from where it was built before.

use super::neighbour_list::{NeighbourError, NeighbourList, Workspace};
use super::reach::{largest_move, Reach};
use crate::numerics::lanes::Real;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

/// The neighbour list of a run and the positions it was built from.
#[derive(Debug, Clone)]
pub struct Neighbourhood<R> {
    pub list: Arc<NeighbourList>,
    /// `[D, N]`.
    pub reference: Arc<Vec<R>>,
    /// Another one for every list that was ever built: who has made something of a list knows whether it is still of this
    /// one.
    pub identity: u64,
    /// For a part of the particles: where they were when ranks got copies of them.
    pub copied: Option<Copied<R>>,
    /// Whether the list is of other particles, so that the next [`Self::update`] builds it wherever they are.
    is_due: bool,
    workspace: Workspace<R>,
}

/// Copies of particles of other ranks, and how long they serve.
#[derive(Debug, Clone)]
pub struct Copied<R> {
    /// Where particles were when they were copied, `[D, N]`.
    pub at: Arc<Vec<R>>,
    /// Lists can be built as long as no particle has moved half of this since then.
    pub serves: f64,
}

/// Lists that were built.
static BUILT: AtomicU64 = AtomicU64::new(1);

impl<R: Real> Neighbourhood<R> {
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
        let (reference, copied, workspace) = Default::default();
        Self { list, reference, identity: 0, copied, is_due: false, workspace }
    }

    /// A list of particles, some of them copies, that the next [`Self::update`] builds.
    pub fn due(copied: Copied<R>) -> Self {
        let mut new = Self::empty();
        new.take_others(copied);
        new
    }

    /// Takes other particles, whose list the next [`Self::update`] builds, in the old list's memory.
    pub fn take_others(&mut self, copied: Copied<R>) {
        if let Some(list) = Arc::get_mut(&mut self.list) {
            list.forget();
        }
        self.reference = copied.at.clone();
        (self.copied, self.is_due) = (Some(copied), true);
    }

    /// Builds the list of another run's or an earlier reference, in the old list's memory unless somebody else still
    /// holds it.
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
        list.within = reach.bounds_of_all(&self.reference);
        if list.own.is_empty() {
            list.own.extend_from_slice(reach.own);
            list.lent.extend_from_slice(reach.lent);
        }
        list.rebuild(&self.reference, reach.tags, reach.domain, reach.distance(), &mut self.workspace)
    }

    /// Rebuilds the list if somebody has moved half the skin since it was built. Whether it does depends on the
    /// positions and the reference only, so a replay does the same. Ranks that have a part of the particles each agree on it.
    ///
    /// # Errors
    /// Lost or clumped particles, a box too small; that another rank has them. [`NeighbourError::UsedUp`] on all ranks, with the list
    /// as it was.
    pub fn update(&mut self, reach: &Reach, position: &[R]) -> Result<(), NeighbourError> {
        let found = largest_move(reach, position, &self.reference);
        // A rank that cannot go on stops all.
        let moved = reach.most(*found.as_ref().unwrap_or(&f64::INFINITY));
        found?;
        // One step never moves a particle that far unless the run has diverged.
        if moved > 0.5 * reach.cutoff {
            let particle = furthest(reach, position, &self.reference);
            return Err(NeighbourError::TooFast { particle, distance: moved, cutoff: reach.cutoff });
        }
        if 2.0 * moved < reach.skin && !self.is_due {
            return Ok(());
        }
        if let Some(copied) = &self.copied {
            let away = reach.most(largest_move(reach, position, &copied.at).unwrap_or(f64::INFINITY));
            if 2.0 * away > copied.serves {
                return Err(match self.is_due {
                    true => NeighbourError::TooFast { particle: 0, distance: away, cutoff: reach.cutoff },
                    false => NeighbourError::UsedUp,
                });
            }
        }
        self.is_due = false;
        let rebuilt = self.rebuild(reach, position);
        let failed = reach.most(if rebuilt.is_ok() { 0.0 } else { f64::INFINITY });
        rebuilt?;
        match failed == 0.0 {
            true => Ok(()),
            false => Err(NeighbourError::TooFast { particle: 0, distance: failed, cutoff: reach.cutoff }),
        }
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
