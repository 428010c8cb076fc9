//! Gradients at points of walls by fits of third order, for what passes through walls.
//!
//! A fit at a wall has neighbours on one side only, so the error of one of second order is large there: by the flux through the
//! walls of a channel the heat of a disc off its centre is 0.7 % off (dx = 0.02), by fits of third order 0.02 %. As in
//! [`super::fit`], neighbours and weights are constants of the reference cloud:
//!
//! ```text
//!   M = sum_j W q q^T,   d = M^-1 sum_j W q (f_j - f_i),   q = (x, y, x^2, x y, y^2, x^3, x^2 y, x y^2, y^3) of r_ij / h_i.
//! ```

use super::fit::{reach_and_scale, weight_and_shift};
use super::nearest::Plane;

/// Neighbours of a fit. (With 25 the heat of ten geometries is 0.36 % off at most, with fits of fourth order to 36 0.48 %.)
pub const NEIGHBOURS: usize = 25;
/// Monomials of third order.
const Q: usize = 9;

/// The neighbours of one point of a wall.
#[derive(Debug, Clone)]
pub struct WallFit {
    particle: usize,
    inverse_scale: f64,
    /// Neighbour, weight and what is added to r_ij where it is a periodic image.
    near: Vec<(usize, f64, [f64; 2])>,
}

/// What a fit finds: its neighbours' monomials, the factor of M, the differences of a field, and its derivatives.
struct Fitted {
    q: Vec<[f64; Q]>,
    s: Vec<[f64; 2]>,
    factor: [[f64; Q]; Q],
    difference: Vec<f64>,
    d: [f64; Q],
}

fn monomials([x, y]: [f64; 2]) -> [f64; Q] {
    [x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
}

/// The derivatives of the monomials by x and y.
fn slopes([x, y]: [f64; 2]) -> [[f64; Q]; 2] {
    [
        [1.0, 0.0, 2.0 * x, y, 0.0, 3.0 * x * x, 2.0 * x * y, y * y, 0.0],
        [0.0, 1.0, 0.0, x, 2.0 * y, 0.0, x * x, 2.0 * x * y, 3.0 * y * y],
    ]
}

/// Cholesky's factor of a symmetric matrix; a direction without neighbours is left out.
fn factorised<const N: usize>(mut m: [[f64; N]; N]) -> [[f64; N]; N] {
    let least = 1e-12 * (m[0][0] + m[1][1]);
    for a in 0..N {
        for b in 0..=a {
            let sum: f64 = (0..b).map(|c| m[a][c] * m[b][c]).sum();
            let rest = m[a][b] - sum;
            m[a][b] = if a == b { rest.max(least).sqrt() } else { rest / m[b][b] };
        }
    }
    m
}

fn solved<const N: usize>(factor: &[[f64; N]; N], mut x: [f64; N]) -> [f64; N] {
    for a in 0..N {
        let sum: f64 = (0..a).map(|b| factor[a][b] * x[b]).sum();
        x[a] = (x[a] - sum) / factor[a][a];
    }
    for a in (0..N).rev() {
        let sum: f64 = (a + 1..N).map(|b| factor[b][a] * x[b]).sum();
        x[a] = (x[a] - sum) / factor[a][a];
    }
    x
}

/// The fit of values by terms with weights, given all three of each neighbour: the factor of M, and the coefficients of the terms.
pub(super) fn fit<const N: usize>(rows: impl Iterator<Item = ([f64; N], f64, f64)>) -> ([[f64; N]; N], [f64; N]) {
    let (mut m, mut right) = ([[0.0; N]; N], [0.0; N]);
    for (q, w, e) in rows {
        for a in 0..N {
            right[a] += w * q[a] * e;
            (0..=a).for_each(|b| m[a][b] += w * q[a] * q[b]);
        }
    }
    let factor = factorised(m);
    (factor, solved(&factor, right))
}

fn dot(a: &[f64; Q], b: &[f64; Q]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl WallFit {
    /// The fit of a particle, given the distance and number of those near it, nearest first; none where these are too few.
    pub fn new(plane: Plane, places: &[[f64; 2]], particle: usize, near: &[(f64, u32)]) -> Option<Self> {
        let (reach, scale) = reach_and_scale(near.get(NEIGHBOURS)?.0);
        let of = |&(distance, j): &(f64, u32)| {
            let (weight, shift) = weight_and_shift(plane, [places[particle], places[j as usize]], distance, reach);
            (j as usize, weight, shift)
        };
        Some(Self { particle, inverse_scale: 1.0 / scale, near: near[..NEIGHBOURS].iter().map(of).collect() })
    }

    fn fitted(&self, position: &[Vec<f64>; 2], field: &[f64]) -> Fitted {
        let i = self.particle;
        let offset = |&(j, _, shift): &(usize, f64, [f64; 2])| -> [f64; 2] {
            std::array::from_fn(|d| (position[d][j] - position[d][i] + shift[d]) * self.inverse_scale)
        };
        let s: Vec<[f64; 2]> = self.near.iter().map(offset).collect();
        let q: Vec<[f64; Q]> = s.iter().map(|s| monomials(*s)).collect();
        let difference: Vec<f64> = self.near.iter().map(|(j, ..)| field[*j] - field[i]).collect();
        let (factor, d) = fit(q.iter().zip(&self.near).zip(&difference).map(|((q, (_, w, _)), e)| (*q, *w, *e)));
        Fitted { q, s, d, factor, difference }
    }

    /// The gradient of a field `[N]` for positions `[2][N]`.
    pub fn gradient(&self, position: &[Vec<f64>; 2], field: &[f64]) -> [f64; 2] {
        let d = self.fitted(position, field).d;
        [d[0] * self.inverse_scale, d[1] * self.inverse_scale]
    }

    /// Adds the cotangents of positions and field, given that of the gradient.
    ///
    /// With lambda = M^-1 d_bar and e = f_j - f_i: e_bar = W lambda.q, q_bar = W (lambda (e - d.q) - d (lambda.q)).
    pub fn pull_back(
        &self,
        (position, field): (&[Vec<f64>; 2], &[f64]),
        bar: [f64; 2],
        position_bar: &mut [Vec<f64>; 2],
        field_bar: &mut [f64],
    ) {
        let i = self.particle;
        let Fitted { q, s, factor, difference, d } = self.fitted(position, field);
        let mut d_bar = [0.0; Q];
        (0..2).for_each(|e| d_bar[e] = bar[e] * self.inverse_scale);
        let lambda = solved(&factor, d_bar);
        for (k, (j, w, _)) in self.near.iter().enumerate() {
            let (along, error) = (dot(&lambda, &q[k]), difference[k] - dot(&d, &q[k]));
            field_bar[*j] += w * along;
            field_bar[i] -= w * along;
            let q_bar: [f64; Q] = std::array::from_fn(|a| w * (lambda[a] * error - d[a] * along));
            for (e, slope) in slopes(s[k]).iter().enumerate() {
                let r_bar = dot(slope, &q_bar) * self.inverse_scale;
                position_bar[e][*j] += r_bar;
                position_bar[e][i] -= r_bar;
            }
        }
    }
}
