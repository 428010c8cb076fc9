//! Results that the sweeps of one step share.

use crate::numerics::lanes::Real;
use crate::numerics::pool::fit;
use crate::particles::NeighbourList;
use crate::sph::flow::Flow;
use crate::sph::pairs::{pack_positions, stride, Records};

/// Results of one sweep that later sweeps of the same step reuse, so that nothing is computed or packed twice.
#[derive(Debug, Default)]
pub struct PairCache<R> {
    /// Positions x y (z) in records of 4 numbers, `[N, 4]`.
    pub position: Vec<R>,
    /// F = W'(d)/d of every pair of a fluid particle, `[N, K]` as the neighbour list, 0 in the padding and beyond the
    /// cut-off. The adjoints recompute it together with G = F'(d)/d, which is faster than reading it in large scenes.
    pub slope: Vec<R>,
    /// All that the pair pass reads of a particle, `[N, stride]`, see [`super::wall_condition`].
    pub records: Vec<R>,
    /// Whether `position` and `slope` are filled.
    pub has_pairs: bool,
    /// Whether `records` is filled for fluid particles.
    pub has_fluid_records: bool,
}

impl<R: Real> PairCache<R> {
    /// Forgets all results, and keeps their memory.
    pub fn clear(&mut self) {
        let Self { position, slope, records, has_pairs, has_fluid_records } = self;
        [position, slope, records].into_iter().for_each(Vec::clear);
        (*has_pairs, *has_fluid_records) = (false, false);
    }
    /// Packs the positions and makes room for F. The first sweep of a step calls it.
    pub fn make_room(&mut self, flow: &Flow<R>, list: &NeighbourList, moved: &[R]) {
        pack_positions(flow, moved, None, &mut self.position);
        fit(&mut self.slope, list.index.len(), flow.part.is_some());
        self.has_pairs = true;
    }
    /// Positions and records of so many particles.
    #[inline(always)]
    pub fn seen(&self, particles: usize, fields: usize) -> (Records<'_, R>, Records<'_, R>) {
        (Records::new(&self.position, 4, particles), Records::new(&self.records, stride(fields), particles))
    }
}
