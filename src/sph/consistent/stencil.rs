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

/// Number of monomials up to second order: D linear, then D (D + 1) / 2 quadratic ones.
pub const fn monomials(dimension: usize) -> usize {
    dimension + dimension * (dimension + 1) / 2
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

/// The monomials q(s).
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
    q
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
pub fn laplacian<R: Real, const D: usize>(d: impl Fn(usize) -> R) -> R {
    let mut sum = R::default();
    for a in 0..D {
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

#[cfg(test)]
mod tests {
    use super::*;

    type L = <f64 as Real>::Portable;

    fn lane(x: L) -> f64 {
        x.largest()
    }

    #[test]
    fn monomials_have_their_places_and_derivatives() {
        assert_eq!((monomials(2), monomials(3), packed(5), packed(9)), (5, 9, 15, 45));
        let s = [L::splat(0.3), L::splat(-0.7), L::splat(1.1)];
        let q = values::<L, 3, 9>(&s).map(lane);
        let right = [0.3, -0.7, 1.1, 0.045, -0.21, 0.33, 0.245, -0.77, 0.605];
        assert!(q.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-15), "{q:?}");
        let c: [L; 9] = std::array::from_fn(|k| L::splat(0.1 * k as f64 - 0.2));
        let n = [L::splat(0.5), L::splat(0.2), L::splat(-0.6)];
        let (s_bar, n_bar) = pull_back_along::<L, 3, 9>(&s, &n, &c);
        for a in 0..3 {
            let f = |by_s: f64, by_n: f64| {
                let (mut s, mut n) = (s, n);
                s[a] += L::splat(by_s);
                n[a] += L::splat(by_n);
                lane(dot(&along::<L, 3, 9>(&s, &n), &c))
            };
            assert!((lane(s_bar[a]) - (f(1e-5, 0.0) - f(-1e-5, 0.0)) / 2e-5).abs() < 1e-9, "{a}");
            assert!((lane(n_bar[a]) - (f(0.0, 1e-5) - f(0.0, -1e-5)) / 2e-5).abs() < 1e-9, "{a}");
            let g = |h: f64| {
                let moved = std::array::from_fn(|k| s[k] + L::splat(h) * n[k]);
                lane(values::<L, 3, 9>(&moved)[a + 3])
            };
            assert!((lane(along::<L, 3, 9>(&s, &n)[a + 3]) - (g(1e-5) - g(-1e-5)) / 2e-5).abs() < 1e-9, "{a}");
        }
        let bar = pull_back::<L, 3, 9>(&s, &c).map(lane);
        for a in 0..3 {
            let f = |h: f64| {
                let mut moved = s;
                moved[a] += L::splat(h);
                lane(dot(&values::<L, 3, 9>(&moved), &c))
            };
            let difference = (f(1e-5) - f(-1e-5)) / 2e-5;
            assert!((bar[a] - difference).abs() < 1e-9, "{a}");
        }
    }

    #[test]
    fn a_factorised_matrix_is_solved() {
        let mut matrix = [L::zero(); 15];
        let points: Vec<[f64; 2]> = (0..9).map(|k| [(k as f64).sin(), (1.7 * k as f64).cos()]).collect();
        let mut b = [L::zero(); 5];
        let x = [1.0, -2.0, 0.5, 3.0, -0.25];
        for p in &points {
            let q = values::<L, 2, 5>(&[L::splat(p[0]), L::splat(p[1])]);
            accumulate::<L, 5, 15>(&mut matrix, L::splat(0.7), &q);
            let f: f64 = q.iter().zip(x).map(|(q, x)| lane(*q) * x).sum();
            for k in 0..5 {
                b[k] = (L::splat(0.7) * q[k]).mul_add(L::splat(f), b[k]);
            }
        }
        factorise::<L, 5, 15>(&mut matrix, L::splat(1e-12));
        let found = solve::<L, 5, 15>(&matrix, b).map(lane);
        assert!(found.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-11), "{found:?}");
    }
}
