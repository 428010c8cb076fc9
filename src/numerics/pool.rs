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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_comes_back_to_who_had_it() {
        let pool = Buffers::<f64>::default();
        let place = |length: usize| pool.buffer(length).as_ptr() as usize;
        let (long, short) = (place(1000), place(100));
        assert_ne!(long, short);
        for _ in 0..3 {
            assert_eq!((place(1000), place(100)), (long, short));
        }
        // About as long.
        assert_eq!(place(950), long);
        // Two at a time are two.
        let (a, b) = (pool.buffer(100), pool.buffer(100));
        assert_ne!(a.as_ptr(), b.as_ptr());
        assert_eq!((a.len(), b.len()), (100, 100));
    }

    #[test]
    fn lengths_that_change_a_little_do_not_pile_up() {
        let pool = Buffers::<f64>::default();
        for step in 0..500 {
            // Up and down by some per cent, with a stride that repeats late.
            let lengths = [1, 2, 3].map(|k| 1000 * k + 37 * step % 101);
            let held = lengths.map(|length| pool.buffer(length));
            assert_eq!(held.each_ref().map(|buffer| buffer.len()), lengths);
        }
        assert!(pool.lock().len() <= 4, "{} buffers for three at a time", pool.lock().len());
    }
}
