//! GMRES (Saad and Schultz 1986) with a preconditioner on the right, and IDR(s) for large systems.

use super::random;
use super::sparse_lu::dot;

/// A product with a matrix, or an approximate solution.
pub type Operator<'a> = &'a dyn Fn(&[f64]) -> Vec<f64>;

/// Solves A x = b to a relative residual, or returns none after `most` products with A.
///
/// `times` is the product with A and `precondition` an approximate solution with A.
pub fn gmres(
    b: &[f64],
    tolerance: f64,
    most: usize,
    times: Operator<'_>,
    precondition: Operator<'_>,
) -> Option<Vec<f64>> {
    let (x, rest) = cycle(b, tolerance, most, times, precondition);
    (rest <= tolerance).then_some(x)
}

/// [`gmres`] that begins anew after `each` products, whose basis it forgets.
pub fn gmres_restarted(
    b: &[f64],
    tolerance: f64,
    (each, most): (usize, usize),
    times: Operator<'_>,
    precondition: Operator<'_>,
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

/// s of [`idr`]. (In space a step of 84,169 particles takes 78 to 90 products, where GMRES takes 68 to 78 with all their vectors, and 91 to 117
/// if it begins anew after 37.)
const SHADOW: usize = 4;

/// Solves A x = b as [`gmres_restarted`] does, with the memory of some twenty vectors however many products it takes, by induced dimension
/// reduction: IDR(s) (Sonneveld and van Gijzen 2008) in the variant of van Gijzen and Sonneveld (2011). `precondition` must be linear to
/// rounding.
pub fn idr(
    b: &[f64],
    tolerance: f64,
    most: usize,
    times: Operator<'_>,
    precondition: Operator<'_>,
) -> Option<Vec<f64>> {
    let norm = |x: &[f64]| dot(x, x).sqrt();
    let add = |to: &mut [f64], share: f64, x: &[f64]| to.iter_mut().zip(x).for_each(|(to, x)| *to += share * x);
    let least = tolerance * norm(b);
    let mut stream = random::stream(0, "idr");
    let mut shadow = || -> Vec<f64> { b.iter().map(|_| random::uniform(&mut stream) - 0.5).collect() };
    let shadows: [Vec<f64>; SHADOW] = std::array::from_fn(|_| shadow());
    let (mut x, mut left) = (vec![0.0; b.len()], b.to_vec());
    let mut products = 0;
    loop {
        // From the true residual, which that of the recurrences leaves in the end.
        let start = norm(&left);
        if start <= least {
            return Some(x);
        }
        if products >= most || !start.is_finite() {
            return None;
        }
        let zeros = || -> [Vec<f64>; SHADOW] { std::array::from_fn(|_| vec![0.0; b.len()]) };
        // A directions = images, whose products with the shadows are `m`, a lower triangle.
        let (mut directions, mut images) = (zeros(), zeros());
        let mut m = [[0.0; SHADOW]; SHADOW];
        (0..SHADOW).for_each(|k| m[k][k] = 1.0);
        let mut omega = 1.0;
        let mut now = start;
        'reduce: while now > least && products < most {
            let mut f: [f64; SHADOW] = std::array::from_fn(|k| dot(&shadows[k], &left));
            for k in 0..SHADOW {
                let mut c = [0.0; SHADOW];
                for i in k..SHADOW {
                    c[i] = (f[i] - (k..i).map(|j| m[i][j] * c[j]).sum::<f64>()) / m[i][i];
                }
                let mut rest = left.clone();
                (k..SHADOW).for_each(|i| add(&mut rest, -c[i], &images[i]));
                let mut direction = precondition(&rest);
                direction.iter_mut().for_each(|x| *x *= omega);
                (k..SHADOW).for_each(|i| add(&mut direction, c[i], &directions[i]));
                let mut image = times(&direction);
                products += 1;
                for i in 0..k {
                    let share = dot(&shadows[i], &image) / m[i][i];
                    add(&mut image, -share, &images[i]);
                    add(&mut direction, -share, &directions[i]);
                }
                (k..SHADOW).for_each(|i| m[i][k] = dot(&shadows[i], &image));
                let share = f[k] / m[k][k];
                if !share.is_finite() {
                    break 'reduce;
                }
                add(&mut left, -share, &image);
                add(&mut x, share, &direction);
                (directions[k], images[k]) = (direction, image);
                now = norm(&left);
                if now <= least {
                    break 'reduce;
                }
                (k + 1..SHADOW).for_each(|i| f[i] -= share * m[i][k]);
            }
            let direction = precondition(&left);
            let image = times(&direction);
            products += 1;
            // Not too short a step where image and residual are nearly at right angles (Sleijpen and van der Vorst 1995).
            let along = dot(&image, &left) / (norm(&image) * now);
            omega = along / along.abs() * along.abs().max(0.7) * now / norm(&image);
            if !omega.is_finite() {
                break;
            }
            add(&mut left, -omega, &image);
            add(&mut x, omega, &direction);
            now = norm(&left);
        }
        left = b.iter().zip(times(&x)).map(|(b, product)| b - product).collect();
        products += 1;
        let end = norm(&left);
        if end > least && end > 0.5 * start {
            return None;
        }
    }
}

/// The best solution in the space of at most `most` products, and its relative residual.
fn cycle(b: &[f64], tolerance: f64, most: usize, times: Operator<'_>, precondition: Operator<'_>) -> (Vec<f64>, f64) {
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
