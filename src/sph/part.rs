//! The part of a flow that one of several ranks computes: the particles in its block, and copies of others near them.
//!
//! Operators compute own particles only, and walls near them. Before another operator reads what one has found, copies get what their
//! owners found.

use crate::numerics::lanes::Real;
use crate::numerics::ranks::Ranks;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::Instant;

/// The particles of a rank, and who shares which of them.
#[derive(Debug)]
pub struct Part {
    pub ranks: Ranks,
    /// Whether a particle is the rank's own, `[n]`; all others are copies.
    pub own: Vec<bool>,
    /// Ranks that have copies of own particles, and of which.
    pub lent: Vec<(usize, Vec<u32>)>,
    /// Ranks that own what is copied here, and which these are.
    pub copies: Vec<(usize, Vec<u32>)>,
    /// Whether the whole flow has walls, whether or not this part has.
    pub has_walls: bool,
    pub traffic: Arc<Traffic>,
}

/// What a rank has sent to others in steps.
#[derive(Debug, Default)]
pub struct Traffic {
    pub messages: AtomicU64,
    pub bytes: AtomicU64,
    /// What that took, with waiting for those of others.
    pub nanoseconds: AtomicU64,
}

impl Part {
    /// Replaces the values of copies in a field `[rows, n]` by those of their owners.
    pub fn refresh<R: Real>(&self, field: &mut [R]) {
        let n = self.own.len();
        self.exchange(field, field.len() / n.max(1), |row, i| row * n + i);
    }

    /// Adds the values of copies in a field `[rows, n]` to those of their owners, and sets them to 0: the adjoint of
    /// [`Self::refresh`], for sums that give something to particles of other ranks.
    pub fn give_back<R: Real>(&self, field: &mut [R]) {
        let clock = Instant::now();
        let n = self.own.len();
        let rows = field.len() / n.max(1);
        let each = |of: &'_ [u32]| -> Vec<usize> {
            (0..rows).flat_map(|row| of.iter().map(move |&i| row * n + i as usize)).collect()
        };
        let mut to = Vec::with_capacity(self.copies.len());
        for (rank, of) in &self.copies {
            let take = |at: usize| std::mem::take(&mut field[at]).f64();
            to.push((*rank, each(of).into_iter().map(take).collect::<Vec<f64>>()));
        }
        let from: Vec<(usize, usize)> = self.lent.iter().map(|(rank, of)| (*rank, rows * of.len())).collect();
        self.count(&to);
        for ((_, of), found) in self.lent.iter().zip(self.ranks.swap(&to, &from)) {
            each(of).into_iter().zip(found).for_each(|(at, value)| field[at] += R::of(value));
        }
        self.time(clock);
    }

    fn count(&self, to: &[(usize, Vec<f64>)]) {
        let sent: usize = to.iter().map(|(_, numbers)| numbers.len()).sum();
        self.traffic.messages.fetch_add(to.len() as u64, Ordering::Relaxed);
        self.traffic.bytes.fetch_add(8 * sent as u64, Ordering::Relaxed);
    }

    fn time(&self, clock: Instant) {
        self.traffic.nanoseconds.fetch_add(clock.elapsed().as_nanos() as u64, Ordering::Relaxed);
    }

    /// [`Self::refresh`] for `count` numbers of each particle; `at` is where number k of particle i stands.
    pub fn exchange<R: Real>(&self, numbers: &mut [R], count: usize, at: impl Fn(usize, usize) -> usize) {
        let clock = Instant::now();
        let each = |of: &'_ [u32]| -> Vec<usize> {
            (0..count).flat_map(|k| of.iter().map(move |&i| (k, i as usize))).map(|(k, i)| at(k, i)).collect()
        };
        let packed = |of: &[u32]| each(of).into_iter().map(|at| numbers[at].f64()).collect();
        let to: Vec<(usize, Vec<f64>)> = self.lent.iter().map(|(rank, of)| (*rank, packed(of))).collect();
        let from: Vec<(usize, usize)> = self.copies.iter().map(|(rank, of)| (*rank, count * of.len())).collect();
        self.count(&to);
        for ((_, of), found) in self.copies.iter().zip(self.ranks.swap(&to, &from)) {
            each(of).into_iter().zip(found).for_each(|(at, value)| numbers[at] = R::of(value));
        }
        self.time(clock);
    }
}
