//! Buffers that come back: what a training step keeps for its adjoint is the next step's again, neither cleared nor
//! asked of the system.

use crate::numerics::lanes::Real;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex};

/// A pile of free buffers.
#[derive(Debug, Clone)]
pub struct Memory<R: Real>(Arc<Mutex<Vec<Vec<R>>>>);

/// A buffer; back on the pile when dropped.
#[derive(Debug)]
pub struct Owned<R: Real> {
    numbers: Vec<R>,
    pile: Memory<R>,
}

impl<R: Real> Default for Memory<R> {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Vec::new())))
    }
}

impl<R: Real> Memory<R> {
    /// A buffer of this length; what stands in it is anybody's guess.
    pub fn take(&self, length: usize) -> Owned<R> {
        let mut pile = self.0.lock().unwrap_or_else(|e| e.into_inner());
        // The smallest that is large enough; else a new one for the largest of those that are not.
        let fit = |v: &Vec<R>| if v.capacity() >= length { (0, v.capacity()) } else { (1, usize::MAX - v.capacity()) };
        let best = (0..pile.len()).min_by_key(|&k| fit(&pile[k]));
        let mut numbers = best.map(|k| pile.swap_remove(k)).unwrap_or_default();
        drop(pile);
        if numbers.capacity() < length {
            // The number of edges changes a little from step to step: an eighth more than is asked for lasts.
            numbers = Vec::with_capacity(length + length / 8);
        }
        numbers.resize(length, R::default());
        Owned { numbers, pile: self.clone() }
    }
}

impl<R: Real> Drop for Owned<R> {
    fn drop(&mut self) {
        let numbers = std::mem::take(&mut self.numbers);
        if numbers.capacity() > 0 {
            self.pile.0.lock().unwrap_or_else(|e| e.into_inner()).push(numbers);
        }
    }
}

impl<R: Real> Deref for Owned<R> {
    type Target = Vec<R>;
    fn deref(&self) -> &Vec<R> {
        &self.numbers
    }
}

impl<R: Real> DerefMut for Owned<R> {
    fn deref_mut(&mut self) -> &mut Vec<R> {
        &mut self.numbers
    }
}
