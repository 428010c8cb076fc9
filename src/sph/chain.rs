//! What the operators of one step share: its constants and list, and what they keep for each other.

use super::model::Model;
use super::operators::pairs::PairCache;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;
use std::sync::{Arc, Mutex, MutexGuard};

/// What an operator knows besides its tensors: the scene's constants and the list of this step.
#[derive(Debug, Clone)]
pub struct Step<R> {
    pub model: Arc<Model<R>>,
    pub list: Arc<NeighbourList>,
}

/// The operators of one step at one moved state, and what they keep for each other.
#[derive(Debug)]
pub struct Chain<R: Real> {
    pub step: Arc<Step<R>>,
    kept: Mutex<PairCache<R>>,
}

impl<R: Real> Chain<R> {
    /// For one chain of operators on one moved state: what the density pass keeps belongs to its positions.
    pub fn new(step: Arc<Step<R>>) -> Arc<Self> {
        // With arbitrary content, and not marked as having any.
        let kept = step.model.scratch.caches.take().unwrap_or_default();
        let kept = Mutex::new(PairCache { has_pairs: false, has_fluid_records: false, has_records: false, ..kept });
        Arc::new(Self { step, kept })
    }

    /// A cotangent of the moved state, zero.
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
        self.step.model.scratch.caches.give_back(kept);
    }
}
