//! Eigenvalues of a linear map by Arnoldi's method: the outermost ones, of a matrix that is known by its products only.

use super::sparse_lu::dot;
use num_complex::Complex64;

/// An eigenvalue, and how far it may be off: the residual of its vector, relative to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eigenvalue {
    pub value: Complex64,
    pub residual: f64,
}

/// Steps of the QR algorithm for an eigenvalue.
const STEPS: usize = 60;

/// The eigenvalues of the map in the Krylov space of `first`, of at most `most` dimensions (Saad 2011, chapter 6).
pub fn outermost(first: &[f64], most: usize, map: &mut dyn FnMut(&[f64]) -> Vec<f64>) -> Vec<Eigenvalue> {
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let size = norm(first);
    let mut basis: Vec<Vec<f64>> = vec![first.iter().map(|x| x / size).collect()];
    let mut columns: Vec<Vec<f64>> = vec![];
    for k in 0..most {
        let mut next = map(&basis[k]);
        let mut column = vec![0.0; k + 2];
        // Twice, so that the basis is orthogonal to rounding.
        for _ in 0..2 {
            for (j, known) in basis.iter().enumerate() {
                let share = dot(known, &next);
                next.iter_mut().zip(known).for_each(|(x, known)| *x -= share * known);
                column[j] += share;
            }
        }
        let length = norm(&next);
        column[k + 1] = length;
        columns.push(column);
        if !length.is_finite() || length < 1e-13 {
            break;
        }
        next.iter_mut().for_each(|x| *x /= length);
        basis.push(next);
    }
    let m = columns.len();
    let last = columns[m - 1][m];
    let matrix = |i: usize, j: usize| if i <= j + 1 { columns[j][i] } else { 0.0 };
    let hessenberg: Vec<Vec<Complex64>> =
        (0..m).map(|i| (0..m).map(|j| Complex64::new(matrix(i, j), 0.0)).collect()).collect();
    let of = |value: Complex64| {
        let vector = eigenvector(&hessenberg, value);
        Eigenvalue { value, residual: last * vector[m - 1].norm() / value.norm().max(f64::MIN_POSITIVE) }
    };
    eigenvalues(hessenberg.clone()).into_iter().map(of).collect()
}

/// The eigenvalues of a Hessenberg matrix, by QR steps with Wilkinson's shift.
pub fn eigenvalues(mut h: Vec<Vec<Complex64>>) -> Vec<Complex64> {
    let mut found = vec![];
    let mut end = h.len();
    let mut steps = 0;
    while end > 1 {
        let small =
            |k: usize, h: &Vec<Vec<Complex64>>| h[k][k - 1].norm() <= 1e-15 * (h[k][k].norm() + h[k - 1][k - 1].norm());
        let begin = (1..end).rev().find(|&k| small(k, &h)).unwrap_or(0);
        if begin == end - 1 || steps > STEPS {
            found.push(h[end - 1][end - 1]);
            (end, steps) = (end - 1, 0);
            continue;
        }
        steps += 1;
        let (a, b, c, d) = (h[end - 2][end - 2], h[end - 2][end - 1], h[end - 1][end - 2], h[end - 1][end - 1]);
        let half = (a - d) * 0.5;
        let root = (half * half + b * c).sqrt();
        let near = if (half + root).norm() > (half - root).norm() { half + root } else { half - root };
        let shift = if near.norm() > 0.0 { d - b * c / near } else { d };
        // QR by rotations of neighbouring rows, then RQ by the same of columns.
        (begin..end).for_each(|k| h[k][k] -= shift);
        let mut rotations = vec![];
        for k in begin..end - 1 {
            let (x, y) = (h[k][k], h[k + 1][k]);
            let length = (x.norm_sqr() + y.norm_sqr()).sqrt().max(f64::MIN_POSITIVE);
            let (cos, sin) = (x / length, y / length);
            for j in k..end {
                let (p, q) = (h[k][j], h[k + 1][j]);
                h[k][j] = cos.conj() * p + sin.conj() * q;
                h[k + 1][j] = cos * q - sin * p;
            }
            rotations.push((cos, sin));
        }
        for (k, (cos, sin)) in rotations.into_iter().enumerate().map(|(k, r)| (k + begin, r)) {
            for row in h.iter_mut().take((k + 2).min(end)).skip(begin) {
                let (p, q) = (row[k], row[k + 1]);
                row[k] = p * cos + q * sin;
                row[k + 1] = q * cos.conj() - p * sin.conj();
            }
        }
        (begin..end).for_each(|k| h[k][k] += shift);
    }
    found.extend(h.first().map(|row| row[0]));
    found
}

/// A unit eigenvector, by two steps of inverse iteration.
fn eigenvector(h: &[Vec<Complex64>], value: Complex64) -> Vec<Complex64> {
    let m = h.len();
    let near = value + Complex64::new(1e-10, 1e-10) * value.norm().max(1e-300);
    let mut vector = vec![Complex64::new(1.0, 0.0); m];
    for _ in 0..2 {
        let mut a: Vec<Vec<Complex64>> = h.to_vec();
        (0..m).for_each(|k| a[k][k] -= near);
        for k in 0..m.saturating_sub(1) {
            if a[k + 1][k].norm() > a[k][k].norm() {
                a.swap(k, k + 1);
                vector.swap(k, k + 1);
            }
            if a[k][k].norm() == 0.0 {
                continue;
            }
            let factor = a[k + 1][k] / a[k][k];
            for j in k..m {
                let pivot = a[k][j];
                a[k + 1][j] -= factor * pivot;
            }
            let pivot = vector[k];
            vector[k + 1] -= factor * pivot;
        }
        for k in (0..m).rev() {
            let known: Complex64 = (k + 1..m).map(|j| a[k][j] * vector[j]).sum();
            let pivot = if a[k][k].norm() > 0.0 { a[k][k] } else { Complex64::new(1e-300, 0.0) };
            vector[k] = (vector[k] - known) / pivot;
        }
        let size = vector.iter().map(|x| x.norm_sqr()).sum::<f64>().sqrt();
        vector.iter_mut().for_each(|x| *x /= size);
    }
    vector
}
