//! Data that the operators of one step share: the constants, the neighbour list and cached results.

use super::model::Standard;
use super::pair_cache::PairCache;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;
use crate::sph::composed::Pairs;
use crate::sph::masks::per_particle;
use crate::sph::method::Place;
use candle_core::{Result, Tensor};
use std::sync::{Arc, Mutex, MutexGuard};

/// The inputs of an operator besides its tensors: the constants of the scene and the neighbour list of the step.
#[derive(Debug, Clone)]
pub struct Step<R> {
    pub model: Arc<Standard<R>>,
    pub list: Arc<NeighbourList>,
}

impl<R: Real> Step<R> {
    /// With the present neighbour list.
    pub fn now(model: &Arc<Standard<R>>, place: &Place<'_, R>) -> Arc<Self> {
        Arc::new(Self { model: model.clone(), list: place.neighbourhood.list.clone() })
    }

    /// The pairs of the neighbour list as tensors, for a moved state `[M, N]`.
    pub fn pairs(&self, moved: &Tensor) -> Result<Pairs> {
        Pairs::new(&self.model.flow, &self.list, moved)
    }

    /// Mass of every particle of a moved state, `[1, N]`.
    pub fn mass(&self, moved: &Tensor) -> Result<Tensor> {
        let l = self.model.layout;
        if l.mass {
            moved.narrow(0, l.moved_mass(), 1)
        } else {
            per_particle(vec![R::of(self.model.mass); self.model.particles()], moved)
        }
    }
}

/// The context of the operators of one step at one moved state, with the results that they cache for each other.
#[derive(Debug)]
pub struct Chain<R: Real> {
    pub step: Arc<Step<R>>,
    kept: Mutex<PairCache<R>>,
}

impl<R: Real> Chain<R> {
    /// A context for one moved state; what the density pass caches belongs to its positions.
    pub fn new(step: Arc<Step<R>>) -> Arc<Self> {
        // The reused buffers have arbitrary content, so none is marked as filled.
        let kept = step.model.caches.take().unwrap_or_default();
        let kept = Mutex::new(PairCache { has_pairs: false, has_fluid_records: false, ..kept });
        Arc::new(Self { step, kept })
    }

    /// A cotangent of the moved state, all zero.
    pub fn moved_bar(&self) -> Vec<R> {
        let model = &*self.step.model;
        vec![R::default(); model.layout.moved_rows() * model.particles()]
    }

    pub fn kept(&self) -> MutexGuard<'_, PairCache<R>> {
        self.kept.lock().unwrap_or_else(|e| e.into_inner())
    }
}

impl<R: Real> Drop for Chain<R> {
    fn drop(&mut self) {
        let kept = std::mem::take(self.kept.get_mut().unwrap_or_else(|e| e.into_inner()));
        self.step.model.caches.give_back(kept);
    }
}

/// Mass of a particle, from the moved state's mass row or the scene's constant.
#[derive(Clone, Copy)]
pub struct Masses<'a, R> {
    row: Option<&'a [R]>,
    constant: R,
}

impl<'a, R: Real> Masses<'a, R> {
    pub fn new(model: &Standard<R>, moved: &'a [R]) -> Self {
        let from = model.layout.moved_mass() * model.particles();
        Self { row: model.layout.mass.then(|| &moved[from..]), constant: R::of(model.mass) }
    }
    #[inline(always)]
    pub fn of(&self, i: usize) -> R {
        self.row.map_or(self.constant, |row| row[i])
    }
}
