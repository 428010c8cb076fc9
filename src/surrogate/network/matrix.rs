//! Products of small row-major matrices on the calling thread, by the `gemm` crate.
//!
//! The blocks of rows that these are called for are the same for any number of threads, and so are the results.

use crate::numerics::lanes::Real;

/// A stored matrix as it is meant: its numbers, and the strides between rows and between columns.
type View<'a, R> = (&'a [R], usize, usize);

fn product<R: Real>(c: &mut [R], (m, k, n): (usize, usize, usize), a: View<R>, b: View<R>, add: bool) {
    assert!(c.len() == m * n && a.0.len() == m * k && b.0.len() == k * n, "sizes of a product");
    if m == 0 || n == 0 {
        return;
    }
    let (one, read) = (R::of(1.0), if add { R::of(1.0) } else { R::default() });
    // SAFETY: the lengths were checked; each view covers its slice exactly, and c overlaps neither a nor b.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            c.as_mut_ptr(),
            1,
            n as isize,
            add,
            a.0.as_ptr(),
            a.2 as isize,
            a.1 as isize,
            b.0.as_ptr(),
            b.2 as isize,
            b.1 as isize,
            read,
            one,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// `c [m, n] = a [m, k] b [k, n]`, or `c += a b`.
pub fn multiply<R: Real>(c: &mut [R], a: &[R], b: &[R], (m, k, n): (usize, usize, usize), add: bool) {
    product(c, (m, k, n), (a, k, 1), (b, n, 1), add);
}

/// `c [m, n] = a [m, k] b^T` with b stored as `[n, k]`, or `c += a b^T`.
pub fn multiply_by_transposed<R: Real>(c: &mut [R], a: &[R], b: &[R], (m, k, n): (usize, usize, usize), add: bool) {
    product(c, (m, k, n), (a, k, 1), (b, 1, k), add);
}

/// `c [m, n] += a^T b` with a stored as `[k, m]`: what `k` rows add to the gradient of a weight.
pub fn add_transposed<R: Real>(c: &mut [R], a: &[R], b: &[R], (m, k, n): (usize, usize, usize)) {
    product(c, (m, k, n), (a, 1, m), (b, n, 1), true);
}
