//! Sweeps over rows: a kernel compiled for every instruction set, run by all threads.

pub use super::lanes::RowKernel;
use super::lanes::{InstructionSet, Lanes, Real, WIDEST};
use super::thread_pool::ThreadPool;
use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Runs a kernel over some rows on this thread alone, with the best instruction set: for sweeps so short that waking others
/// costs more than they save.
pub fn run_rows_alone<R: Real, K: RowKernel<R>>(kernel: &K, rows: Range<usize>) {
    R::run(kernel, rows, InstructionSet::best());
}

/// Most threads that share a sweep; more would have nothing to do in the sizes that this program is for.
const MOST_THREADS: usize = 64;
/// Pieces that a thread's share is cut into, so that others can help it out: at least and at most, and rows of a piece in between.
const PIECES: (usize, usize, usize) = (8, 64, 256);

/// Where a thread's share of the rows has got to. Alone on its cache lines.
#[repr(align(128))]
struct Cursor(AtomicUsize);

/// Runs a kernel over `count` rows on all threads, with the best instruction set.
///
/// Every thread begins with the same share of the rows in every sweep, so what it wrote in the last one is still in its
/// core's cache; who is done takes pieces of the others' shares. (If rows went to whoever comes first, the second thread
/// would gain nothing in a step of 950 particles.)
pub fn run_rows<R: Real, K: RowKernel<R>>(kernel: &K, count: usize) {
    deal(count, &|rows| run_rows_alone(kernel, rows));
}

/// [`run_rows`] for some rows.
pub fn run_some_rows<R: Real, K: RowKernel<R>>(kernel: &K, rows: Range<usize>) {
    deal(rows.len(), &|part| run_rows_alone(kernel, rows.start + part.start..rows.start + part.end));
}

/// Calls `each` for every row on all threads: for loops that move numbers and hardly compute.
pub fn run_each(count: usize, each: impl Fn(usize) + Sync) {
    // (A loop, because `for_each` on a reference leaves a call for each row.)
    deal(count, &|rows| {
        for row in rows {
            each(row);
        }
    });
}

/// [`run_rows`], compiled once for all kernels.
fn deal(count: usize, run: &(dyn Fn(Range<usize>) + Sync)) {
    let pool = ThreadPool::global();
    let threads = pool.threads().min(MOST_THREADS);
    if threads == 1 {
        return run(0..count);
    }
    let (least, most, rows) = PIECES;
    let pieces = (count / (threads * rows)).clamp(least, most);
    let piece = count.div_ceil(threads * pieces).max(1);
    let share = piece * pieces;
    let cursors: [Cursor; MOST_THREADS] = std::array::from_fn(|_| Cursor(AtomicUsize::new(0)));
    pool.run(&|thread| {
        for k in 0..threads {
            let owner = (thread + k) % threads;
            let end = count.min((owner + 1) * share);
            loop {
                let from = owner * share + cursors[owner].0.fetch_add(piece, Ordering::Relaxed);
                if from >= end {
                    break;
                }
                run(from..end.min(from + piece));
            }
        }
    });
}

/// Numbers that are copied or zeroed at a time.
pub const STRETCH: usize = 4096;

/// Fills a stretch of memory with numbers of another, or with zeros.
struct Filling<'a, R> {
    from: Option<&'a [R]>,
    to: Shared<'a, MaybeUninit<R>>,
}

impl<R: Real> RowKernel<R> for Filling<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let range = rows.start * STRETCH..self.to.length.min(rows.end * STRETCH);
        // SAFETY: each row is a stretch of its own.
        let to = unsafe { self.to.slice(range.clone()) };
        match self.from {
            Some(from) => to.iter_mut().zip(&from[range]).for_each(|(to, from)| *to = MaybeUninit::new(*from)),
            None => to.fill(MaybeUninit::new(R::default())),
        }
    }
}

fn fill<R: Real>(from: Option<&[R]>, to: &mut [MaybeUninit<R>]) {
    let count = to.len().div_ceil(STRETCH);
    run_rows(&Filling { from, to: Shared::new(to) }, count);
}

/// Numbers as memory that may be written.
fn memory<R: Real>(numbers: &mut [R]) -> &mut [MaybeUninit<R>] {
    // SAFETY: the same layout, and [`fill`] writes numbers only.
    unsafe { &mut *(numbers as *mut [R] as *mut [MaybeUninit<R>]) }
}

/// Zeroes numbers, on all threads.
pub fn clear<R: Real>(numbers: &mut [R]) {
    fill(None, memory(numbers));
}

/// Copies numbers, on all threads.
pub fn copy<R: Real>(from: &[R], to: &mut [R]) {
    assert_eq!(from.len(), to.len());
    fill(Some(from), memory(to));
}

/// A vector of `count` numbers, on all threads.
fn filled<R: Real>(from: Option<&[R]>, count: usize) -> Vec<R> {
    let mut numbers = Vec::with_capacity(count);
    fill(from, &mut numbers.spare_capacity_mut()[..count]);
    // SAFETY: `fill` has written that many.
    unsafe { numbers.set_len(count) };
    numbers
}

/// A copy of numbers, made on all threads.
pub fn copied<R: Real>(from: &[R]) -> Vec<R> {
    filled(Some(from), from.len())
}

/// So many zeros, written on all threads.
pub fn zeros<R: Real>(count: usize) -> Vec<R> {
    filled(None, count)
}

/// A kernel over parts, each with what is written for it. Nothing else is written, so no two threads write the same.
pub trait PartKernel<R: Real>: Sync {
    type Part: Send;
    /// See [`RowKernel::MOST_LANES`].
    const MOST_LANES: usize = WIDEST;
    /// Must be `#[inline(always)]`, so that it is compiled with the features of its caller.
    fn part<L: Lanes<Real = R>>(&self, number: usize, part: &mut Self::Part);
}

/// Runs a kernel over its parts on all threads, see [`run_rows`].
pub fn run_parts<R: Real, K: PartKernel<R>>(kernel: &K, parts: impl IntoIterator<Item = K::Part>) {
    let parts: Vec<_> = parts.into_iter().map(Mutex::new).collect();
    run_rows(&Parts { kernel, parts: &parts }, parts.len());
}

struct Parts<'a, R: Real, K: PartKernel<R>> {
    kernel: &'a K,
    /// Each is locked once, by the thread that computes it.
    parts: &'a [Mutex<K::Part>],
}

impl<R: Real, K: PartKernel<R>> RowKernel<R> for Parts<'_, R, K> {
    const MOST_LANES: usize = K::MOST_LANES;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for k in rows {
            self.kernel.part::<L>(k, &mut self.parts[k].lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}

/// The numbers of each of some parts of rows that follow each other, `width` to a row.
///
/// # Panics
/// There are fewer numbers.
pub fn cut<'a, T>(mut numbers: &'a mut [T], parts: &[Range<usize>], width: usize) -> Vec<&'a mut [T]> {
    let part = |part: &Range<usize>| numbers.split_off_mut(..part.len() * width).expect("numbers of every row");
    parts.iter().map(part).collect()
}

/// A slice that several threads write, each to places of its own.
pub struct Shared<'a, T> {
    pointer: *mut T,
    length: usize,
    lifetime: std::marker::PhantomData<&'a mut [T]>,
}

// SAFETY: access goes through `set`/`add`, whose contract is that no two threads touch the same place.
unsafe impl<T: Send> Sync for Shared<'_, T> {}

impl<'a, T: Copy> Shared<'a, T> {
    pub fn new(slice: &'a mut [T]) -> Self {
        Self { pointer: slice.as_mut_ptr(), length: slice.len(), lifetime: std::marker::PhantomData }
    }
    /// For reading places that nobody writes during the sweep.
    #[inline(always)]
    pub fn as_ptr(&self) -> *const T {
        self.pointer
    }
    /// Writes one place.
    ///
    /// # Safety
    /// No other thread may access `place` during the sweep.
    #[inline(always)]
    pub unsafe fn set(&self, place: usize, value: T) {
        assert!(place < self.length);
        // SAFETY: in bounds, and exclusively ours by the contract.
        unsafe { *self.pointer.add(place) = value }
    }
    /// Reads one place that this thread may have written.
    ///
    /// # Safety
    /// No other thread may write `place` during the sweep.
    #[inline(always)]
    pub unsafe fn get(&self, place: usize) -> T {
        assert!(place < self.length);
        // SAFETY: in bounds, and not written by others by the contract.
        unsafe { *self.pointer.add(place) }
    }
    /// Adds to one place.
    ///
    /// # Safety
    /// No other thread may access `place` during the sweep.
    #[inline(always)]
    pub unsafe fn add(&self, place: usize, value: T)
    where
        T: std::ops::AddAssign,
    {
        assert!(place < self.length);
        // SAFETY: in bounds, and exclusively ours by the contract.
        unsafe { *self.pointer.add(place) += value }
    }
    /// Stores COUNT numbers from `place` on.
    ///
    /// # Safety
    /// No other thread may access these places during the sweep.
    #[inline(always)]
    pub unsafe fn store<L: Lanes<Real = T>>(&self, place: usize, value: L)
    where
        T: Real,
    {
        assert!(place + L::COUNT <= self.length);
        // SAFETY: in bounds, and exclusively ours by the contract.
        unsafe { value.store(self.pointer.add(place)) }
    }
    /// A stretch of places as a slice.
    ///
    /// # Safety
    /// No other thread may access the stretch during the sweep.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn slice(&self, range: Range<usize>) -> &mut [T] {
        assert!(range.start <= range.end && range.end <= self.length);
        // SAFETY: in bounds, and exclusively ours by the contract.
        unsafe { std::slice::from_raw_parts_mut(self.pointer.add(range.start), range.len()) }
    }
}
