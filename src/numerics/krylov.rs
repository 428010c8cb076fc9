//! GMRES (Saad and Schultz 1986) with a preconditioner on the right.

use super::sparse_lu::dot;

/// Solves A x = b to a relative residual, or returns none after `most` products with A.
///
/// `times` is the product with A and `precondition` an approximate solution with A.
pub fn gmres(
    b: &[f64],
    tolerance: f64,
    most: usize,
    times: &dyn Fn(&[f64]) -> Vec<f64>,
    precondition: &dyn Fn(&[f64]) -> Vec<f64>,
) -> Option<Vec<f64>> {
    let (x, rest) = cycle(b, tolerance, most, times, precondition);
    (rest <= tolerance).then_some(x)
}

/// [`gmres`] that begins anew after `each` products, whose basis it forgets.
pub fn gmres_restarted(
    b: &[f64],
    tolerance: f64,
    (each, most): (usize, usize),
    times: &dyn Fn(&[f64]) -> Vec<f64>,
    precondition: &dyn Fn(&[f64]) -> Vec<f64>,
) -> Option<Vec<f64>> {
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let size = norm(b);
    let mut x = vec![0.0; b.len()];
    let mut left = b.to_vec();
    for _ in 0..most.div_ceil(each) {
        let rest = norm(&left);
        if rest <= tolerance * size {
            return Some(x);
        }
        let (more, found) = cycle(&left, tolerance * size / rest, each, times, precondition);
        x.iter_mut().zip(&more).for_each(|(x, more)| *x += more);
        if !found.is_finite() {
            return None;
        }
        left = b.iter().zip(times(&x)).map(|(b, product)| b - product).collect();
        if found <= tolerance * size / rest {
            return Some(x);
        }
    }
    None
}

/// The best solution in the space of at most `most` products, and its relative residual.
fn cycle(
    b: &[f64],
    tolerance: f64,
    most: usize,
    times: &dyn Fn(&[f64]) -> Vec<f64>,
    precondition: &dyn Fn(&[f64]) -> Vec<f64>,
) -> (Vec<f64>, f64) {
    let n = b.len();
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let size = norm(b);
    if size == 0.0 {
        return (vec![0.0; n], 0.0);
    }
    let mut basis: Vec<Vec<f64>> = vec![b.iter().map(|x| x / size).collect()];
    let mut directions: Vec<Vec<f64>> = vec![];
    // Columns of the triangle, the rotations that made them, and the right-hand side under these.
    let (mut columns, mut rotations, mut right): (Vec<Vec<f64>>, Vec<[f64; 2]>, Vec<f64>) =
        (vec![], vec![], vec![size]);
    for k in 0..most {
        let direction = precondition(&basis[k]);
        let mut next = times(&direction);
        directions.push(direction);
        let mut column = vec![];
        // Twice where much cancels, so that the basis is orthogonal to rounding.
        let mut length = norm(&next);
        for round in 0..2 {
            let before = length;
            for (j, known) in basis.iter().enumerate() {
                let share = dot(known, &next);
                next.iter_mut().zip(known).for_each(|(x, known)| *x -= share * known);
                match round {
                    0 => column.push(share),
                    _ => column[j] += share,
                }
            }
            length = norm(&next);
            if length > 0.1 * before {
                break;
            }
        }
        for (j, [cos, sin]) in rotations.iter().enumerate() {
            let (a, b) = (column[j], column[j + 1]);
            (column[j], column[j + 1]) = (cos * a + sin * b, cos * b - sin * a);
        }
        let last = column[k];
        let whole = last.hypot(length);
        if whole.is_nan() || whole == 0.0 {
            return (vec![0.0; n], f64::NAN);
        }
        let [cos, sin] = [last / whole, length / whole];
        column[k] = whole;
        rotations.push([cos, sin]);
        columns.push(column);
        let rest = right[k];
        right[k] = cos * rest;
        right.push(-sin * rest);
        let is_done = right[k + 1].abs() <= tolerance * size;
        if is_done || k + 1 == most || length < 1e-14 * whole {
            let mut shares = right[..=k].to_vec();
            for row in (0..=k).rev() {
                for later in row + 1..=k {
                    shares[row] -= columns[later][row] * shares[later];
                }
                shares[row] /= columns[row][row];
            }
            let mut x = vec![0.0; n];
            for (share, direction) in shares.iter().zip(&directions) {
                x.iter_mut().zip(direction).for_each(|(x, d)| *x += share * d);
            }
            return (x, right[k + 1].abs() / size);
        }
        next.iter_mut().for_each(|x| *x /= length);
        basis.push(next);
    }
    (vec![0.0; n], 1.0)
}
