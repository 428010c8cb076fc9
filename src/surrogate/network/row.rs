//! Arithmetic number by number along rows, in lanes.
//!
//! Written as plain loops these end, once the compiler has to check an index in them, with up to a whole unrolled vector of
//! numbers one by one: with 128 columns that was half of each row, and a tenth of a training step.

use crate::numerics::lanes::Lanes;

/// The numbers of rows from `at` on. (Loops: of an array's `map` the compiler makes ten functions for each kind of lanes.)
///
/// # Safety
/// All rows have at least `at + COUNT` numbers.
#[inline(always)]
unsafe fn load<L: Lanes, const K: usize>(rows: &[&[L::Real]; K], at: usize) -> [L; K] {
    let mut lanes = [L::zero(); K];
    for k in 0..K {
        // SAFETY: as the caller promises.
        lanes[k] = unsafe { L::load(rows[k].as_ptr().add(at)) };
    }
    lanes
}

/// Whether all rows are of one length.
#[inline(always)]
fn are_even<T, const K: usize>(rows: &[&[T]; K], length: usize) -> bool {
    let mut even = true;
    for k in 0..K {
        even &= rows[k].len() == length;
    }
    even
}

/// x <- f(x, the numbers of the other rows at the same place).
///
/// # Panics
/// The lengths differ.
#[inline(always)]
pub fn each<L: Lanes, const K: usize>(x: &mut [L::Real], others: [&[L::Real]; K], f: impl Fn(L, [L; K]) -> L) {
    let length = x.len();
    assert!(are_even(&others, length), "rows of different lengths");
    let whole = length / L::COUNT * L::COUNT;
    for at in (0..whole).step_by(L::COUNT) {
        // SAFETY: all have at least `at + COUNT` numbers.
        unsafe { f(L::load(x.as_ptr().add(at)), load(&others, at)).store(x.as_mut_ptr().add(at)) };
    }
    if whole < length {
        let mut rest = [L::zero(); K];
        for k in 0..K {
            rest[k] = L::load_part(&others[k][whole..]);
        }
        let last = f(L::load_part(&x[whole..]), rest);
        x[whole..].copy_from_slice(&last.numbers()[..length - whole]);
    }
}

/// sum of f(a, b) over two rows.
///
/// # Panics
/// The lengths differ.
#[inline(always)]
pub fn sum<L: Lanes>(a: &[L::Real], b: &[L::Real], f: impl Fn(L, L) -> L) -> L::Real {
    assert!(a.len() == b.len(), "rows of different lengths");
    let mut sum = L::zero();
    let whole = a.len() / L::COUNT * L::COUNT;
    for at in (0..whole).step_by(L::COUNT) {
        // SAFETY: both have at least `at + COUNT` numbers.
        sum += unsafe { f(L::load(a.as_ptr().add(at)), L::load(b.as_ptr().add(at))) };
    }
    if whole < a.len() {
        // Lanes behind the end are taken out again: f need not be 0 there.
        let mut lanes = f(L::load_part(&a[whole..]), L::load_part(&b[whole..])).numbers();
        lanes[a.len() - whole..].fill(L::Real::default());
        sum += L::load_part(&lanes);
    }
    sum.sum()
}

/// sum += f(rows at the same place) over all rows, column by column.
///
/// # Panics
/// The lengths differ, or are no whole rows.
#[inline(always)]
pub fn add_rows<L: Lanes, const K: usize>(sum: &mut [L::Real], rows: [&[L::Real]; K], f: impl Fn([L; K]) -> L) {
    let (width, length) = (sum.len(), rows[0].len());
    assert!(width > 0 && length % width == 0 && are_even(&rows, length), "rows of different lengths");
    // Several sums at a time: each waits for its own last addition only, and none goes through memory.
    let mut at = 0;
    while at + 4 * L::COUNT <= width {
        add_columns::<L, K, 4>(sum, at, rows, &f);
        at += 4 * L::COUNT;
    }
    while at + L::COUNT <= width {
        add_columns::<L, K, 1>(sum, at, rows, &f);
        at += L::COUNT;
    }
    if at < width {
        for row in (0..length).step_by(width) {
            let mut rest = rows;
            for k in 0..K {
                rest[k] = &rows[k][row + at..row + width];
            }
            each::<L, K>(&mut sum[at..], rest, |sum, x| sum + f(x));
        }
    }
}

/// Columns `at .. at + BLOCKS * COUNT` of [`add_rows`].
#[inline(always)]
fn add_columns<L: Lanes, const K: usize, const BLOCKS: usize>(
    sum: &mut [L::Real],
    at: usize,
    rows: [&[L::Real]; K],
    f: &impl Fn([L; K]) -> L,
) {
    let width = sum.len();
    assert!(at + BLOCKS * L::COUNT <= width);
    let mut sums = [L::zero(); BLOCKS];
    for k in 0..BLOCKS {
        sums[k] = L::load_part(&sum[at + k * L::COUNT..]);
    }
    for row in (0..rows[0].len()).step_by(width) {
        for k in 0..BLOCKS {
            // SAFETY: the columns end within a row, and each row within its slice.
            sums[k] += f(unsafe { load(&rows, row + at + k * L::COUNT) });
        }
    }
    for k in 0..BLOCKS {
        let at = at + k * L::COUNT;
        sum[at..at + L::COUNT].copy_from_slice(&sums[k].numbers()[..L::COUNT]);
    }
}

/// rows <- relu(rows + bias).
#[inline(always)]
pub fn activate<L: Lanes>(rows: &mut [L::Real], bias: &[L::Real]) {
    for row in rows.chunks_exact_mut(bias.len()) {
        each::<L, 1>(row, [bias], |x, [b]| (x + b).positive());
    }
}
