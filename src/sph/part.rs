//! The part of a flow that one of several ranks computes: the particles in its block, and copies of others near them.
//!
//! Operators compute own particles only, and walls near them. Before another operator reads what one has found, copies get what their
//! owners found.

use crate::numerics::lanes::Real;
use crate::numerics::ranks::{Ranks, Swap};
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
    /// Own particles that some rank has copies of, ascending.
    pub lent_to_any: Vec<u32>,
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
        let n = self.own.len();
        let (clock, rows) = (Instant::now(), field.len() / n.max(1));
        let to = packed(&self.copies, rows, |row, i| std::mem::take(&mut field[row * n + i]));
        self.count(&to);
        for ((_, of), found) in self.lent.iter().zip(self.ranks.begin_swap(to, &lengths(&self.lent, rows)).wait()) {
            numbers(of, rows).zip(found).for_each(|((row, i), value)| field[row * n + i] += R::of(value));
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
        let swap = self.begin(count, |k, i| numbers[at(k, i)]);
        self.finish(swap, count, |k, i, value| numbers[at(k, i)] = value);
    }

    /// Begins an exchange of `count` numbers of each particle: number k of particle i is `get(k, i)`. All ranks begin and
    /// [finish](Self::finish) the same ones in the same order.
    pub fn begin<R: Real>(&self, count: usize, get: impl Fn(usize, usize) -> R) -> Swap {
        let clock = Instant::now();
        let to = packed(&self.lent, count, get);
        self.count(&to);
        let swap = self.ranks.begin_swap(to, &lengths(&self.copies, count));
        self.time(clock);
        swap
    }

    /// Waits for the numbers of copies; `set(k, i, value)` takes them.
    pub fn finish<R: Real>(&self, swap: Swap, count: usize, mut set: impl FnMut(usize, usize, R)) {
        let clock = Instant::now();
        for ((_, of), found) in self.copies.iter().zip(swap.wait()) {
            numbers(of, count).zip(found).for_each(|((k, i), value)| set(k, i, R::of(value)));
        }
        self.time(clock);
    }
}

/// Particles of an exchange with each of some ranks.
type With = [(usize, Vec<u32>)];

/// Number k and particle i of everything that is exchanged of some particles, in the order of messages.
fn numbers(of: &[u32], count: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
    (0..count).flat_map(move |k| of.iter().map(move |&i| (k, i as usize)))
}

/// Messages to ranks.
fn packed<R: Real>(with: &With, count: usize, mut get: impl FnMut(usize, usize) -> R) -> Vec<(usize, Vec<f64>)> {
    with.iter().map(|(rank, of)| (*rank, numbers(of, count).map(|(k, i)| get(k, i).f64()).collect())).collect()
}

/// How long messages from ranks are.
fn lengths(with: &With, count: usize) -> Vec<(usize, usize)> {
    with.iter().map(|(rank, of)| (*rank, count * of.len())).collect()
}
