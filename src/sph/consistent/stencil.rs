//! Second-order moving least squares around a particle (Liu and Liu 2006; Tamai and Koshizuka 2014).
//!
//! With s = (r_j - r_i) / dx and the monomials q(s) = (s_x, s_y, (s_z,) s_x^2/2, s_x s_y, ..., s_y^2/2, ...), the derivatives
//! d of a field f at particle i (in units of dx: df/dx = d_x / dx, d2f/dx2 = d_xx / dx^2) are the solution of
//!
//! ```text
//!   M d = b,   M = sum_j W_ij q q^T,   b = sum_j W_ij q (f_j - f_i):
//! ```
//!
//! Derivatives of quadratic fields are exact on any arrangement. M is factorised once for all fields. The adjoint is
//! that of the solution, not of the factorisation: with the cotangent d_bar and lambda = M^-1 d_bar (M is symmetric),
//!
//! ```text
//!   b_bar = lambda,   M_bar = -lambda d^T,   so with e = f_j - f_i - d.q
//!   W_bar = sum_f (lambda.q) e,   q_bar = W sum_f (lambda e - d (lambda.q)),   f_j_bar = -f_i_bar = W lambda.q.
//! ```

use crate::numerics::lanes::{Lanes, Real};
use std::ops::AddAssign;

/// Number of monomials up to second order: D linear, then D (D + 1) / 2 quadratic ones.
pub const fn monomials(dimension: usize) -> usize {
    dimension + dimension * (dimension + 1) / 2
}

/// Number of monomials up to third order: those up to second order, then s_a s_b s_c / 6 with a <= b <= c.
pub const fn to_third(dimension: usize) -> usize {
    monomials(dimension) + dimension * (dimension + 1) * (dimension + 2) / 6
}

/// Number of stored entries of a symmetric matrix: the lower triangle, row by row.
pub const fn packed(size: usize) -> usize {
    size * (size + 1) / 2
}

/// Index of (row, column <= row) in a packed matrix.
#[inline(always)]
pub const fn at(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// Index of the quadratic monomial of components a <= b.
#[inline(always)]
pub const fn quadratic(dimension: usize, a: usize, b: usize) -> usize {
    // Row a of the upper triangle has dimension - a entries.
    dimension + a * dimension - a * (a + 1) / 2 + b
}

/// The monomials q(s), up to second order or, if Q is [`to_third`], to third.
#[inline(always)]
pub fn values<L: Lanes, const D: usize, const Q: usize>(s: &[L; D]) -> [L; Q] {
    let half = L::splat(L::Real::of(0.5));
    let mut q = [L::zero(); Q];
    for a in 0..D {
        q[a] = s[a];
        q[quadratic(D, a, a)] = half * s[a] * s[a];
        for b in a + 1..D {
            q[quadratic(D, a, b)] = s[a] * s[b];
        }
    }
    if Q > monomials(D) {
        for (k, [a, b, c]) in cubics::<D>().enumerate() {
            q[monomials(D) + k] = L::splat(L::Real::of(1.0 / 6.0)) * s[a] * s[b] * s[c];
        }
    }
    q
}

/// Components of the monomials of third order.
#[inline(always)]
fn cubics<const D: usize>() -> impl Iterator<Item = [usize; 3]> {
    (0..D).flat_map(|a| (a..D).flat_map(move |b| (b..D).map(move |c| [a, b, c])))
}

/// The derivative of sum_k c_k q_k(s) with respect to s.
#[inline(always)]
pub fn pull_back<L: Lanes, const D: usize, const Q: usize>(s: &[L; D], c: &[L; Q]) -> [L; D] {
    let mut bar = [L::zero(); D];
    for a in 0..D {
        bar[a] = c[quadratic(D, a, a)].mul_add(s[a], c[a]);
        for b in 0..D {
            if b != a {
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                bar[a] = c[quadratic(D, low, high)].mul_add(s[b], bar[a]);
            }
        }
    }
    if Q > monomials(D) {
        for (k, [a, b, e]) in cubics::<D>().enumerate() {
            let part = L::splat(L::Real::of(1.0 / 6.0)) * c[monomials(D) + k];
            bar[a] += part * s[b] * s[e];
            bar[b] += part * s[a] * s[e];
            bar[e] += part * s[a] * s[b];
        }
    }
    bar
}

/// The derivative of q(s) along n. A field has no derivative along n at s if the product of d with this is 0.
#[inline(always)]
pub fn along<L: Lanes, const D: usize, const Q: usize>(s: &[L; D], n: &[L; D]) -> [L; Q] {
    let mut q = [L::zero(); Q];
    for a in 0..D {
        q[a] = n[a];
        q[quadratic(D, a, a)] = n[a] * s[a];
        for b in a + 1..D {
            q[quadratic(D, a, b)] = n[a].mul_add(s[b], n[b] * s[a]);
        }
    }
    q
}

/// The derivatives of sum_k c_k (dq/dn)_k with respect to s and n.
#[inline(always)]
pub fn pull_back_along<L: Lanes, const D: usize, const Q: usize>(
    s: &[L; D],
    n: &[L; D],
    c: &[L; Q],
) -> ([L; D], [L; D]) {
    let mut s_bar = [L::zero(); D];
    for a in 0..D {
        s_bar[a] = c[quadratic(D, a, a)] * n[a];
        for b in 0..D {
            if b != a {
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                s_bar[a] = c[quadratic(D, low, high)].mul_add(n[b], s_bar[a]);
            }
        }
    }
    // dq/dn is linear in n with the derivative of q by s as coefficients.
    (s_bar, pull_back::<L, D, Q>(s, c))
}

#[inline(always)]
pub fn laplacian<T: AddAssign, const D: usize>(d: impl Fn(usize) -> T) -> T {
    let mut sum = d(quadratic(D, 0, 0));
    for a in 1..D {
        sum += d(quadratic(D, a, a));
    }
    sum
}

/// Adds w q q^T.
#[inline(always)]
pub fn accumulate<L: Lanes, const Q: usize, const P: usize>(matrix: &mut [L; P], w: L, q: &[L; Q]) {
    for row in 0..Q {
        let weighted = w * q[row];
        for column in 0..=row {
            matrix[at(row, column)] = weighted.mul_add(q[column], matrix[at(row, column)]);
        }
    }
}

/// Factorises M = C C^T in place, with 1/C_kk on the diagonal. A pivot below `least` is replaced by it: a particle with
/// too few neighbours for a second-order fit gets a smooth result of lower order.
#[inline(always)]
pub fn factorise<L: Lanes, const Q: usize, const P: usize>(matrix: &mut [L; P], least: L) {
    for row in 0..Q {
        for column in 0..row {
            let mut sum = matrix[at(row, column)];
            for k in 0..column {
                sum = (-matrix[at(row, k)]).mul_add(matrix[at(column, k)], sum);
            }
            matrix[at(row, column)] = sum * matrix[at(column, column)];
        }
        let mut pivot = matrix[at(row, row)];
        for k in 0..row {
            pivot = (-matrix[at(row, k)]).mul_add(matrix[at(row, k)], pivot);
        }
        let pivot = pivot.select_less(least, least, pivot);
        matrix[at(row, row)] = L::splat(L::Real::of(1.0)) / pivot.sqrt();
    }
}

/// M^-1 b, given the factor C of [`factorise`].
#[inline(always)]
pub fn solve<L: Lanes, const Q: usize, const P: usize>(factor: &[L; P], mut b: [L; Q]) -> [L; Q] {
    for row in 0..Q {
        for k in 0..row {
            b[row] = (-factor[at(row, k)]).mul_add(b[k], b[row]);
        }
        b[row] = b[row] * factor[at(row, row)];
    }
    for row in (0..Q).rev() {
        for k in row + 1..Q {
            b[row] = (-factor[at(k, row)]).mul_add(b[k], b[row]);
        }
        b[row] = b[row] * factor[at(row, row)];
    }
    b
}

/// The scalar product a.b.
#[inline(always)]
pub fn dot<L: Lanes, const Q: usize>(a: &[L; Q], b: &[L; Q]) -> L {
    let mut sum = a[0] * b[0];
    for k in 1..Q {
        sum = a[k].mul_add(b[k], sum);
    }
    sum
}
