//! Means over the neighbours of fixed particles,
//!
//! ```text
//!   (G f)_i = (f_i + sum_j W_ij f_j) / (1 + sum_j W_ij),
//! ```
//!
//! with the neighbours and weights of fits of second order ([`super::fit`]), applied twice. Smooth fields change by h^2, beside walls by
//! h, and 1 % is left of a checkerboard on a square lattice. Weights are those of the reference cloud, so that means do not depend on
//! the shape.
//!
//! (Means that keep linear fields, which change them by h^2 beside walls too, were tried for [`super::deferred_correction`] in time:
//! differences of pressures on the surface of schaefer-turek-1 are then as far off as without a correction, not twice as far, but the
//! drag of schaefer-turek-2 with dx = 0.0082 oscillates by 1 % from step to step.)

use super::fit::Stencils;

/// How often means are taken. (With one what changes from particle to particle still grows in steps in time: the drag of
/// schaefer-turek-2 with dx = 0.0082 oscillates by 1 % where means are over twice as many neighbours.)
const TIMES: usize = 2;

/// The weights of means of the first particles among themselves.
#[derive(Debug)]
pub struct Smoothing {
    /// Where those of each begin, `[count + 1]`.
    first: Vec<usize>,
    /// Particles and their weights.
    list: Vec<(u32, f64)>,
}

impl Smoothing {
    /// Means among the first `count` particles.
    pub fn new(stencils: &Stencils, count: usize) -> Self {
        let (mut first, mut list) = (vec![0], vec![]);
        for i in 0..count {
            let pairs = (0..stencils.count(i)).map(|k| stencils.pair(i, k));
            let among = pairs.filter(|&(j, weight, _)| weight > 0.0 && j < count);
            let all: Vec<_> = among.map(|(j, weight, _)| (j as u32, weight)).chain([(i as u32, 1.0)]).collect();
            let total: f64 = all.iter().map(|(_, weight)| weight).sum();
            list.extend(all.into_iter().map(|(j, weight)| (j, weight / total)));
            first.push(list.len());
        }
        Self { first, list }
    }

    /// The particles of the mean of particle i, with their weights.
    fn of(&self, i: usize) -> &[(u32, f64)] {
        &self.list[self.first[i]..self.first[i + 1]]
    }

    /// Smooths W fields, `[count][W]`.
    pub fn apply<const W: usize>(&self, rows: &mut Vec<[f64; W]>) {
        for _ in 0..TIMES {
            let mean = |i: usize| {
                let mut sum = [0.0; W];
                for &(j, weight) in self.of(i) {
                    (0..W).for_each(|c| sum[c] += weight * rows[j as usize][c]);
                }
                sum
            };
            *rows = (0..rows.len()).map(mean).collect();
        }
    }

    /// The transpose of [`Self::apply`].
    pub fn transposed<const W: usize>(&self, rows: &mut Vec<[f64; W]>) {
        for _ in 0..TIMES {
            let mut all = vec![[0.0; W]; rows.len()];
            for (i, row) in rows.iter().enumerate() {
                for &(j, weight) in self.of(i) {
                    (0..W).for_each(|c| all[j as usize][c] += weight * row[c]);
                }
            }
            *rows = all;
        }
    }
}
