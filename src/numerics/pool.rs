//! Things that come back: a buffer that one step is done with is the next step's again, neither cleared nor asked of the
//! system.

use super::lanes::Real;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard};

/// A pile of things that nobody uses at the moment.
#[derive(Debug)]
pub struct Pool<T>(Arc<Mutex<Vec<T>>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Vec::new())))
    }
}

impl<T> Clone for Pool<T> {
    /// The same pile.
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> Pool<T> {
    fn lock(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// What was given back last, if anything is there.
    pub fn take(&self) -> Option<T> {
        self.lock().pop()
    }

    pub fn give_back(&self, thing: T) {
        self.lock().push(thing);
    }
}

/// Brings numbers that are all written anew to a length. Where they have too little room, they get a sixteenth more than they need in its place,
/// not twice as much beside it as by `resize`; the first time only if it is known that their number `changes`.
pub fn fit<T: Copy + Default>(numbers: &mut Vec<T>, length: usize, changes: bool) {
    if numbers.capacity() < length {
        let more = if changes || numbers.capacity() > 0 { length / 16 } else { 0 };
        *numbers = Vec::new();
        *numbers = Vec::with_capacity(length + more);
    }
    numbers.resize(length, T::default());
}

/// Buffers of numbers.
pub type Buffers<R> = Pool<Vec<R>>;

impl<R: Real> Buffers<R> {
    /// A buffer of this length; what stands in it is anybody's guess.
    pub fn buffer(&self, length: usize) -> Buffer<R> {
        let mut pile = self.lock();
        // The same operator comes again and again: a buffer of its own length needs nothing. One of about that length is as
        // good (the number of a graph's edges changes a little from step to step); another one would be missed by its own
        // operator.
        let about = |v: &Vec<R>| 4 * v.capacity() <= 5 * length && 5 * v.capacity() >= 4 * length;
        let place = pile.iter().rposition(|v| v.len() == length).or_else(|| pile.iter().rposition(about));
        let numbers = place.map(|place| pile.swap_remove(place));
        drop(pile);
        let mut numbers = numbers.unwrap_or_default();
        if numbers.capacity() < length {
            // `resize` would double it, and a buffer twice as long is nobody's: the pile would grow with every step.
            numbers = Vec::with_capacity(length + length / 16);
        }
        numbers.resize(length, R::default());
        Buffer { numbers, pool: self.clone() }
    }
}

/// A buffer; back on the pile when dropped.
#[derive(Debug)]
pub struct Buffer<R: Real> {
    numbers: Vec<R>,
    pool: Buffers<R>,
}

impl<R: Real> Drop for Buffer<R> {
    fn drop(&mut self) {
        let numbers = std::mem::take(&mut self.numbers);
        if numbers.capacity() > 0 {
            self.pool.give_back(numbers);
        }
    }
}

impl<R: Real> Deref for Buffer<R> {
    type Target = Vec<R>;
    fn deref(&self) -> &Vec<R> {
        &self.numbers
    }
}

impl<R: Real> DerefMut for Buffer<R> {
    fn deref_mut(&mut self) -> &mut Vec<R> {
        &mut self.numbers
    }
}
