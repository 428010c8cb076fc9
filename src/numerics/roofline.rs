//! What a machine can do at most: multiply-adds a second, and bytes a second through memory (Williams, Waterman and Patterson 2009).

use super::lanes::{array, Lanes, Real};
use super::sweep::{run_rows, RowKernel, Shared};
use std::hint::black_box;
use std::ops::Range;
use std::time::Instant;

/// What all threads reach together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Roofline {
    /// Operations a second, of which a multiply-add is two.
    pub operations: f64,
    /// Bytes a second of a vector sum over so many bytes, as STREAM's triad counts them (McCalpin 1995).
    pub bytes: f64,
}

/// Chains of multiply-adds that do not wait for each other: enough for two units that need four cycles each.
const CHAINS: usize = 12;
/// Multiply-adds of a chain in a row of the kernel.
const LENGTH: usize = 512;

/// Bytes that no cache holds.
const BEYOND: usize = 1 << 28;

struct MultiplyAdds<'a, R> {
    factor: R,
    sums: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for MultiplyAdds<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let factor = L::splat(self.factor);
        for row in rows {
            let mut chains: [L; CHAINS] = array(|k| L::splat(R::of(k as f64)));
            for _ in 0..LENGTH {
                chains = array(|k| chains[k].mul_add(factor, factor));
            }
            let sum = chains.iter().fold(L::zero(), |sum, &chain| sum + chain);
            // SAFETY: each row has a place of its own.
            unsafe { self.sums.set(row, sum.sum()) };
        }
    }
}

/// a = b + s c, in stretches.
struct Triad<'a, R> {
    factor: R,
    to: Shared<'a, R>,
    left: &'a [R],
    right: &'a [R],
}

/// Numbers of a stretch, a multiple of all lanes.
const STRETCH: usize = 1024;

impl<R: Real> RowKernel<R> for Triad<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let factor = L::splat(self.factor);
        for at in (rows.start * STRETCH..rows.end * STRETCH).step_by(L::COUNT) {
            let (left, right) = (L::load_part(&self.left[at..]), L::load_part(&self.right[at..]));
            // SAFETY: each row is a stretch of its own.
            unsafe { self.to.store(at, right.mul_add(factor, left)) };
        }
    }
}

/// The least seconds of `run` in some tries.
fn best(mut run: impl FnMut()) -> f64 {
    let mut least = f64::INFINITY;
    let begun = Instant::now();
    // Long enough for a core to reach its speed, and for a quiet moment on a shared machine.
    while begun.elapsed().as_secs_f64() < 0.05 {
        let clock = Instant::now();
        run();
        least = least.min(clock.elapsed().as_secs_f64());
    }
    least
}

impl Roofline {
    /// Measures it for numbers of type R and arrays of so many bytes together, which may fit into a cache, and of 256 MB for more.
    /// Takes 0.1 s.
    pub fn measure<R: Real>(bytes: usize) -> Self {
        let bytes = bytes.min(BEYOND);
        let mut sums = vec![R::default(); 4096];
        let lanes = lanes::<R>();
        let count = sums.len();
        let kernel = MultiplyAdds { factor: black_box(R::of(0.5)), sums: Shared::new(&mut sums) };
        let seconds = best(|| run_rows(&kernel, count));
        let operations = (2 * CHAINS * LENGTH * lanes * count) as f64 / seconds;
        black_box(&sums);

        let stretches = (bytes / (3 * STRETCH * size_of::<R>())).max(1);
        let mut all = [(); 3].map(|()| vec![R::of(0.5); stretches * STRETCH]);
        let [to, left, right] = &mut all;
        let triad = Triad { factor: black_box(R::of(0.5)), to: Shared::new(to), left, right };
        let seconds = best(|| run_rows(&triad, stretches));
        let moved = (3 * stretches * STRETCH * size_of::<R>()) as f64;
        black_box(&all);
        Self { operations, bytes: moved / seconds }
    }

    /// The seconds that so many operations and bytes need at least: those of the slower of the two.
    pub fn seconds(&self, operations: f64, bytes: f64) -> f64 {
        (operations / self.operations).max(bytes / self.bytes)
    }
}

/// The lanes that kernels run with.
fn lanes<R: Real>() -> usize {
    struct Count<'a>(Shared<'a, usize>);
    impl<R: Real> RowKernel<R> for Count<'_> {
        #[inline(always)]
        fn rows<L: Lanes<Real = R>>(&self, _: Range<usize>) {
            // SAFETY: there is one row.
            unsafe { self.0.set(0, L::COUNT) };
        }
    }
    let mut count = [0];
    run_rows::<R, _>(&Count(Shared::new(&mut count)), 1);
    count[0]
}
