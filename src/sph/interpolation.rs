//! Kernel sums over particles at target points: f(t) = sum_j W(|t - r_j|) f_j.
//!
//! The caller chooses the fields: a field and 1 for a Shepard average, or m u T for a flux. The adjoint is f_bar_j =
//! sum_t W f_bar(t), r_bar_j = -sum_t F (t - r_j) f_bar(t) f_j.

use crate::config::scene::Kernels;
use crate::numerics::candle::{apply2, Operator};
use crate::numerics::lanes::Real;
use crate::particles::Domain;
use crate::sph::kernels::Kernel;
use candle_core::{DType, Result, Shape, Tensor};
use std::marker::PhantomData;
use std::sync::Arc;

/// The target points, and the kernel of the sums.
#[derive(Debug, Clone)]
pub struct Interpolation {
    pub kernel: Kernel,
    pub domain: Domain,
    pub targets: Arc<Vec<[f64; 3]>>,
    pub kernels: Kernels,
}

/// A particle in reach of a target: its index, t - r, W and F.
struct Near<R> {
    particle: usize,
    difference: [R; 3],
    weight: R,
    slope: R,
}

impl Interpolation {
    /// Positions `[D, N]`, fields `[C, N]` -> sums `[C, targets]` over the particles whose `taken` is true.
    pub fn sums(&self, position: &Tensor, fields: &Tensor, taken: &Arc<Vec<bool>>) -> Result<Tensor> {
        if self.kernels == Kernels::Composed {
            return self.composed(position, fields, taken);
        }
        let (of, taken) = (self.clone(), taken.clone());
        match position.dtype() {
            DType::F32 => apply2(Sums::<f32> { of, taken, real: PhantomData }, position, fields),
            _ => apply2(Sums::<f64> { of, taken, real: PhantomData }, position, fields),
        }
    }

    /// The same sums by ordinary candle operators, as reference for tests.
    pub fn composed(&self, position: &Tensor, fields: &Tensor, taken: &[bool]) -> Result<Tensor> {
        let (n, m, device) = (taken.len(), self.targets.len(), position.device());
        // Keeps the root differentiable where a target coincides with a particle; W has no slope there.
        let mut r2 = Tensor::full(1e-30, (m, n), device)?.to_dtype(position.dtype())?;
        for d in 0..self.domain.dimension {
            let targets: Vec<f64> = self.targets.iter().map(|t| t[d]).collect();
            let targets = Tensor::from_vec(targets, (m, 1), device)?.to_dtype(position.dtype())?;
            let difference = targets.broadcast_sub(&position.narrow(0, d, 1)?)?;
            r2 = (r2 + self.domain.nearest_of(d, &difference)?.sqr()?)?;
        }
        let taken: Vec<f64> = taken.iter().map(|&taken| f64::from(u8::from(taken))).collect();
        let taken = Tensor::from_vec(taken, (1, n), device)?.to_dtype(position.dtype())?;
        let weights = self.kernel.composed(&r2.sqrt()?)?.0.broadcast_mul(&taken)?;
        fields.matmul(&weights.t()?)
    }
}

struct Sums<R> {
    of: Interpolation,
    taken: Arc<Vec<bool>>,
    real: PhantomData<R>,
}

impl<R: Real> Sums<R> {
    fn near(&self, target: &[f64; 3], position: &[R]) -> Vec<Near<R>> {
        let (n, domain) = (self.taken.len(), &self.of.domain);
        let cutoff = R::of(self.of.kernel.cutoff());
        let mut near = Vec::new();
        for j in (0..n).filter(|&j| self.taken[j]) {
            let mut difference = [R::default(); 3];
            let mut r2 = R::default();
            for d in 0..domain.dimension {
                let dr = domain.nearest_image(d, R::of(target[d]) - position[d * n + j]);
                difference[d] = dr;
                r2 += dr * dr;
            }
            if r2 < cutoff * cutoff {
                let (weight, slope) = self.of.kernel.pair(r2);
                near.push(Near { particle: j, difference, weight, slope });
            }
        }
        near
    }
}

impl<R: Real> Operator<2> for Sums<R> {
    type Real = R;
    const NAME: &'static str = "interpolation";

    fn forward(&self, [position, fields]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let (n, m) = (self.taken.len(), self.of.targets.len());
        let count = fields.len() / n;
        let mut sums = vec![R::default(); count * m];
        for (k, target) in self.of.targets.iter().enumerate() {
            for p in self.near(target, position) {
                for c in 0..count {
                    sums[c * m + k] += p.weight * fields[c * n + p.particle];
                }
            }
        }
        Ok((sums, (count, m).into()))
    }

    fn adjoint(&self, [position, fields]: [&[R]; 2], _: &[R], bar: &[R], _: [bool; 2]) -> Result<[Option<Vec<R>>; 2]> {
        let (n, m) = (self.taken.len(), self.of.targets.len());
        let mut position_bar = vec![R::default(); position.len()];
        let mut fields_bar = vec![R::default(); fields.len()];
        for (k, target) in self.of.targets.iter().enumerate() {
            for p in self.near(target, position) {
                let j = p.particle;
                let mut along = R::default();
                for c in 0..fields.len() / n {
                    fields_bar[c * n + j] += p.weight * bar[c * m + k];
                    along += bar[c * m + k] * fields[c * n + j];
                }
                // dW/dr_j = -F (t - r_j)
                for d in 0..self.of.domain.dimension {
                    position_bar[d * n + j] -= along * p.slope * p.difference[d];
                }
            }
        }
        Ok([Some(position_bar), Some(fields_bar)])
    }
}
