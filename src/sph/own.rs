//! Numbers that a sweep writes.

use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::Shared;
use std::ops::{AddAssign, Deref};

/// Numbers that the kernel of a sweep writes, each of its rows those that belong to it: its own particle's, its own pairs', its
/// own places'. A sweep gives every row to one thread, so no two threads touch the same numbers. What is no row's own
/// needs the [`Shared`] in it.
pub struct Own<'a, T>(Shared<'a, T>);

impl<'a, T: Copy> Own<'a, T> {
    pub fn new(numbers: &'a mut [T]) -> Self {
        Self(Shared::new(numbers))
    }

    #[inline(always)]
    pub fn get(&self, place: usize) -> T {
        // SAFETY (of all): a place of the row at hand, which belongs to this thread.
        unsafe { self.0.get(place) }
    }

    #[inline(always)]
    pub fn set(&self, place: usize, value: T) {
        unsafe { self.0.set(place, value) }
    }

    #[inline(always)]
    pub fn add(&self, place: usize, value: T)
    where
        T: AddAssign,
    {
        unsafe { self.0.add(place, value) }
    }

    /// Stores COUNT numbers from `place` on.
    #[inline(always)]
    pub fn store<L: Lanes<Real = T>>(&self, place: usize, value: L)
    where
        T: Real,
    {
        unsafe { self.0.store(place, value) }
    }
}

impl<'a, T> Deref for Own<'a, T> {
    type Target = Shared<'a, T>;

    #[inline(always)]
    fn deref(&self) -> &Shared<'a, T> {
        &self.0
    }
}
