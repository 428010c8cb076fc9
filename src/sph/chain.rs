//! What the operators of one step share: its constants and list, and what they keep for each other.

use super::model::Model;
use super::operators::pairs::PairCache;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;
use candle_core::Tensor;
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
    /// The state behind this step, if it is known: a replay need not compute the rates again.
    after: Option<Tensor>,
    /// Whether the cotangent of the moved state is passed on from operator to operator.
    carries: bool,
    moved_bar: Mutex<Option<Vec<R>>>,
}

impl<R: Real> Chain<R> {
    /// For one chain of operators on one moved state: what the density pass keeps belongs to its positions.
    pub fn new(step: Arc<Step<R>>) -> Arc<Self> {
        Self::with(step, None, false)
    }

    /// [`Self::new`] for operators that stand in one line, [`super::operators::density`] first. All of them read the moved
    /// state, and for each candle would allocate, clear and add up a cotangent of its full size: a fifth of a gradient step
    /// of 950 particles. Here only the density's operator has the moved state as its variable, the others get it
    /// detached and add their shares to one cotangent, which that first (in the backward pass: last) one returns.
    pub fn carrying(step: Arc<Step<R>>, after: Option<Tensor>) -> Arc<Self> {
        Self::with(step, after, true)
    }

    fn with(step: Arc<Step<R>>, after: Option<Tensor>, carries: bool) -> Arc<Self> {
        // With arbitrary content, and not marked as having any.
        let kept = step.model.scratch.caches.take().unwrap_or_default();
        let kept = Mutex::new(PairCache { has_pairs: false, has_records: false, ..kept });
        Arc::new(Self { step, kept, after, carries, moved_bar: Mutex::new(None) })
    }

    /// The state behind this step `[F, N]`, if it is known.
    pub fn after(&self) -> Option<&Tensor> {
        self.after.as_ref()
    }

    /// The moved state as the operators behind the first are to get it.
    pub fn shared(&self, moved: &Tensor) -> Tensor {
        if self.carries {
            moved.detach()
        } else {
            moved.clone()
        }
    }

    /// The cotangent of the moved state so far: what operators behind this one have added, else zero.
    pub fn moved_bar(&self) -> Vec<R> {
        let so_far = self.moved_bar.lock().unwrap_or_else(|e| e.into_inner()).take();
        so_far.unwrap_or_else(|| {
            let model = &*self.step.model;
            vec![R::default(); model.layout.moved_rows() * model.particles()]
        })
    }

    /// That cotangent with an operator's share: passed on, or to be returned to candle.
    pub fn pass_on(&self, moved_bar: Vec<R>) -> Option<Vec<R>> {
        if self.carries {
            *self.moved_bar.lock().unwrap_or_else(|e| e.into_inner()) = Some(moved_bar);
            return None;
        }
        Some(moved_bar)
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
