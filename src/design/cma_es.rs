//! CMA-ES (Hansen and Ostermeier 2001), a search without gradients, for comparison.
//!
//! Each generation draws designs x = m + s B D z around a mean m, with standard normal z, and ranks them by loss. The
//! better half gives the next mean. The covariance C = B D^2 B^T learns successful directions (rank one from the path
//! of the mean, rank mu from the generation). The step s grows while means move in one direction and shrinks when they
//! turn. The constants are those of Hansen 2016, "The CMA evolution strategy: a tutorial", table 1, without negative
//! weights.
//!
//! A design outside of the limits is replaced by the nearest one inside with a penalty: f(nearest) + |x - nearest|^2 /
//! step^2 times the fall of f so far (section B.5 there). The search takes many evaluations, so it is for few
//! variables, such as the control points of a B-spline.

use super::limits::Limits;
use crate::error::Error;
use crate::numerics::random::{stream, Normal};

#[derive(Debug, Clone, PartialEq)]
pub struct Evaluated {
    pub variables: Vec<f64>,
    pub loss: f64,
}

/// Evaluates at least `evaluations` designs, in whole generations, and returns them in order; the first is `first`.
/// `step` is the distance of the first generation from it. The search ends early when the mean no longer changes.
///
/// # Errors
/// Those of `loss`, which end the search. A design whose run diverges should have an infinite loss instead.
pub fn search(
    first: &[f64],
    step: f64,
    evaluations: usize,
    seed: u64,
    limits: &Limits,
    loss: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
) -> Result<Vec<Evaluated>, Error> {
    let begin = loss(first)?;
    let mut seen = vec![Evaluated { variables: first.to_vec(), loss: begin }];
    let mut least = begin;
    let mut normal = Normal::new(stream(seed, "cma-es"));
    let mut cloud = Cloud::new(first, step);
    while seen.len() < evaluations && !cloud.is_a_point() {
        let mut ranked = Vec::new();
        for _ in 0..cloud.designs {
            let drawn = cloud.draw(&mut normal);
            let mut nearest: Vec<f64> = (0..first.len()).map(|k| cloud.mean[k] + cloud.step * drawn[k]).collect();
            let wanted = nearest.clone();
            limits.nearest(&mut nearest);
            let found = loss(&nearest)?;
            let distance: f64 = wanted.iter().zip(&nearest).map(|(x, near)| (x - near).powi(2)).sum();
            least = least.min(found);
            seen.push(Evaluated { variables: nearest, loss: found });
            let fall = (begin - least).max(1e-3 * begin.abs());
            let price = if distance > 0.0 { distance / (step * step) * fall } else { 0.0 };
            ranked.push((found + price, drawn));
        }
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        cloud.learn(&ranked.into_iter().map(|(_, drawn)| drawn).collect::<Vec<_>>());
    }
    Ok(seen)
}

/// The distribution from which designs are drawn.
struct Cloud {
    /// Number of designs in a generation.
    designs: usize,
    /// Weights of the better half, the best first; their sum is 1.
    weights: Vec<f64>,
    generation: i32,
    mean: Vec<f64>,
    /// Step s.
    step: f64,
    /// Covariance C, row by row.
    covariance: Vec<Vec<f64>>,
    /// Columns of B, and the diagonal of D.
    axes: Vec<Vec<f64>>,
    lengths: Vec<f64>,
    /// Paths of the mean: p_s, in coordinates in which the distribution is isotropic, and p_c.
    path_round: Vec<f64>,
    path: Vec<f64>,
}

impl Cloud {
    fn new(mean: &[f64], step: f64) -> Self {
        let n = mean.len();
        let designs = 4 + (3.0 * (n as f64).ln()) as usize;
        let raw: Vec<f64> =
            (1..=designs / 2).map(|rank| ((designs as f64 + 1.0) / 2.0).ln() - (rank as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let one: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|k| f64::from(u8::from(i == k))).collect()).collect();
        Self {
            designs,
            weights: raw.iter().map(|weight| weight / sum).collect(),
            generation: 0,
            mean: mean.to_vec(),
            step,
            covariance: one.clone(),
            axes: one,
            lengths: vec![1.0; n],
            path_round: vec![0.0; n],
            path: vec![0.0; n],
        }
    }

    /// Whether the distribution is so narrow that its mean no longer changes.
    fn is_a_point(&self) -> bool {
        let longest = self.step * self.lengths.iter().fold(0.0_f64, |most, &length| most.max(length));
        !longest.is_finite() || self.mean.iter().all(|&x| x + 0.2 * longest == x)
    }

    /// A random deviation B D z.
    fn draw(&self, normal: &mut Normal) -> Vec<f64> {
        let mut drawn = vec![0.0; self.mean.len()];
        for (axis, length) in self.axes.iter().zip(&self.lengths) {
            let z = normal.next() * length;
            drawn.iter_mut().zip(axis).for_each(|(drawn, axis)| *drawn += z * axis);
        }
        drawn
    }

    /// Updates the distribution by a generation's deviations, sorted by loss.
    fn learn(&mut self, ranked: &[Vec<f64>]) {
        let size = self.mean.len();
        let n = size as f64;
        let mass = 1.0 / self.weights.iter().map(|weight| weight * weight).sum::<f64>();
        let fade_step = (mass + 2.0) / (n + mass + 5.0);
        let damping = 1.0 + 2.0 * (((mass - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + fade_step;
        let fade_path = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n);
        let rank_one = 2.0 / ((n + 1.3).powi(2) + mass);
        let rank_mu = (1.0 - rank_one).min(2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0).powi(2) + mass));
        // E |N(0, 1)|.
        let expected = n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n));

        let mut moved = vec![0.0; size];
        for (weight, drawn) in self.weights.iter().zip(ranked) {
            moved.iter_mut().zip(drawn).for_each(|(moved, drawn)| *moved += weight * drawn);
        }
        self.mean.iter_mut().zip(&moved).for_each(|(mean, moved)| *mean += self.step * moved);
        self.generation += 1;
        // B D^-1 B^T times the move of the mean.
        let mut round = vec![0.0; size];
        for (axis, length) in self.axes.iter().zip(&self.lengths) {
            let along: f64 = axis.iter().zip(&moved).map(|(axis, moved)| axis * moved).sum();
            round.iter_mut().zip(axis).for_each(|(round, axis)| *round += along / length * axis);
        }
        let gain = (fade_step * (2.0 - fade_step) * mass).sqrt();
        for (path, round) in self.path_round.iter_mut().zip(&round) {
            *path = (1.0 - fade_step) * *path + gain * round;
        }
        let length = self.path_round.iter().map(|x| x * x).sum::<f64>().sqrt();
        let memory = (1.0 - (1.0 - fade_step).powi(2 * self.generation)).sqrt();
        // A path that is long because the step is too short must not stretch the distribution as well.
        let goes_on = f64::from(u8::from(length / memory < (1.4 + 2.0 / (n + 1.0)) * expected));
        let gain = goes_on * (fade_path * (2.0 - fade_path) * mass).sqrt();
        for (path, moved) in self.path.iter_mut().zip(&moved) {
            *path = (1.0 - fade_path) * *path + gain * moved;
        }
        let lost = (1.0 - goes_on) * fade_path * (2.0 - fade_path);
        let kept = 1.0 - rank_one - rank_mu + rank_one * lost;
        for i in 0..size {
            for k in 0..size {
                let chosen = self.weights.iter().zip(ranked);
                let chosen: f64 = chosen.map(|(weight, drawn)| weight * drawn[i] * drawn[k]).sum();
                self.covariance[i][k] =
                    kept * self.covariance[i][k] + rank_one * self.path[i] * self.path[k] + rank_mu * chosen;
            }
        }
        self.step *= (fade_step / damping * (length / expected - 1.0)).exp();
        (self.lengths, self.axes) = axes(self.covariance.clone());
        self.lengths.iter_mut().for_each(|length| *length = length.max(1e-40).sqrt());
    }
}

/// Eigenvalues and eigenvectors of a symmetric matrix by Jacobi's rotations.
pub fn axes(mut matrix: Vec<Vec<f64>>) -> (Vec<f64>, Vec<Vec<f64>>) {
    let n = matrix.len();
    let mut vectors: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|k| f64::from(u8::from(i == k))).collect()).collect();
    // Each sweep squares the off-diagonal part once it is small, so ten suffice.
    for _ in 0..30 {
        let beside: f64 = (0..n).map(|i| (0..i).map(|k| matrix[i][k].powi(2)).sum::<f64>()).sum();
        let all: f64 = matrix.iter().flatten().map(|x| x * x).sum();
        if beside <= 1e-32 * all {
            break;
        }
        for i in 0..n {
            for k in 0..i {
                if matrix[i][k] == 0.0 {
                    continue;
                }
                let half = (matrix[k][k] - matrix[i][i]) / (2.0 * matrix[i][k]);
                let tangent = half.signum() / (half.abs() + (half * half + 1.0).sqrt());
                let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
                let sine = tangent * cosine;
                for row in &mut matrix {
                    (row[i], row[k]) = (cosine * row[i] - sine * row[k], sine * row[i] + cosine * row[k]);
                }
                for table in [&mut matrix, &mut vectors] {
                    for at in 0..n {
                        let (x, y) = (table[i][at], table[k][at]);
                        (table[i][at], table[k][at]) = (cosine * x - sine * y, sine * x + cosine * y);
                    }
                }
            }
        }
    }
    ((0..n).map(|i| matrix[i][i]).collect(), vectors)
}
