//! Products of small row-major matrices on the calling thread, by the `gemm` crate.
//!
//! The blocks of rows that these are called for are the same for any number of threads, and so are the results.

use crate::numerics::lanes::Real;

/// How the stored matrix is meant: rows and columns of what is multiplied, and the strides between them.
#[derive(Clone, Copy)]
struct View<'a, R> {
    numbers: &'a [R],
    row_stride: usize,
    column_stride: usize,
}

fn product<R: Real>(c: &mut [R], (m, k, n): (usize, usize, usize), a: View<R>, b: View<R>, add: bool) {
    assert!(c.len() == m * n && a.numbers.len() == m * k && b.numbers.len() == k * n, "sizes of a product");
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
            a.numbers.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.numbers.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
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
    let a = View { numbers: a, row_stride: k, column_stride: 1 };
    product(c, (m, k, n), a, View { numbers: b, row_stride: n, column_stride: 1 }, add);
}

/// `c [m, n] = a [m, k] b^T` with b stored as `[n, k]`, or `c += a b^T`.
pub fn multiply_by_transposed<R: Real>(c: &mut [R], a: &[R], b: &[R], (m, k, n): (usize, usize, usize), add: bool) {
    let a = View { numbers: a, row_stride: k, column_stride: 1 };
    product(c, (m, k, n), a, View { numbers: b, row_stride: 1, column_stride: k }, add);
}

/// `c [m, n] += a^T b` with a stored as `[k, m]`: what `k` rows add to the gradient of a weight.
pub fn add_transposed<R: Real>(c: &mut [R], a: &[R], b: &[R], (m, k, n): (usize, usize, usize)) {
    let a = View { numbers: a, row_stride: 1, column_stride: m };
    product(c, (m, k, n), a, View { numbers: b, row_stride: n, column_stride: 1 }, true);
}
