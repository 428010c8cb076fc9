//! Interpolation at target points.
//!
//! Three ways to look at the flow through a column of targets:
//!
//! * `fluid`: f(t) = sum_j W(|t - r_j|) f_j / sum_j W(|t - r_j|), Shepard-normalised (eq. 12 of the original report), for
//!   f = density, velocity along x, temperature, over fluid particles: what users of JAX-SPH do. Next to a wall the sum is
//!   one-sided and takes the flow there for that further in.
//! * `fluid-and-walls`: the same over fluid and extrapolated walls, which removes that bias. The product of three smoothed
//!   fields is still not the smoothed product: the flux of a parabolic profile comes out about 2 % low at ten rows.
//! * `flux`: the fluxes themselves, not normalised: sum_j W m_j u_j, sum_j W V_j u_j, sum_j W m_j u_j T_j over fluid particles.
//!   With targets up to three spacings beyond the walls every particle counts with its whole kernel, so the sum over the
//!   targets is conservative: heat through the targets balances heat through the walls.

pub use crate::config::scene::Interpolation as Mode;
use crate::numerics::lanes::Real;
use crate::sph::operators::composed;
use crate::sph::operators::pairs::Masses;
use crate::sph::step::{input, output, read, tensor, Step};
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use std::sync::Arc;

/// Fields interpolated: density, velocity along x, temperature (0 without heat); or fluxes of mass, volume and heat.
pub const FIELDS: usize = 3;

/// moved `[M, N]`, primitives `[C, N]` -> `[3, targets]`.
#[derive(Debug, Clone)]
pub struct Interpolation<R> {
    pub step: Arc<Step<R>>,
    pub targets: Arc<Vec<[f64; 3]>>,
    pub mode: Mode,
}

/// A particle in reach of a target: its number, t - r, W and F.
struct Near<R> {
    particle: usize,
    difference: [R; 3],
    weight: R,
    slope: R,
}

impl<R: Real> Interpolation<R> {
    /// Rows of the primitives that are interpolated.
    fn rows(&self) -> [Option<usize>; FIELDS] {
        let l = self.step.model.layout;
        [Some(0), Some(l.primitive_velocity()), l.heat.then(|| l.primitive_temperature())]
    }

    fn takes(&self, j: usize) -> bool {
        self.step.model.is_fluid(j) || (self.mode == Mode::FluidAndWalls && self.step.list.count[j] > 0)
    }

    fn near(&self, target: &[f64; 3], moved: &[R]) -> Vec<Near<R>> {
        use crate::numerics::lanes::Lanes;
        let model = &*self.step.model;
        let n = model.particles();
        // One pair at a time through the same kernel code: lane 0 of the portable lanes.
        let kernel = model.kernel.lanes::<R::Portable>();
        let cutoff = R::of(model.kernel.cutoff());
        let inverse = model.domain.inverse_period();
        let mut near = Vec::new();
        for j in 0..n {
            let mut difference = [R::default(); 3];
            let mut r2 = R::default();
            for d in 0..model.layout.dimension {
                let mut dr = R::of(target[d]) - moved[d * n + j];
                dr -= R::of(model.domain.size[d]) * (dr * R::of(inverse[d]) + R::of(0.5)).floor();
                difference[d] = dr;
                r2 += dr * dr;
            }
            if r2 < cutoff * cutoff && self.takes(j) {
                let lanes = <R::Portable as Lanes>::splat(r2);
                let count = R::of(<R::Portable as Lanes>::COUNT as f64);
                near.push(Near {
                    particle: j,
                    difference,
                    weight: kernel.value(lanes).sum() / count,
                    slope: kernel.slope(lanes).sum() / count,
                });
            }
        }
        near
    }

    fn value(near: &[Near<R>], row: &[R]) -> (R, R) {
        let weight: R = near.iter().map(|p| p.weight).sum();
        let sum: R = near.iter().map(|p| p.weight * row[p.particle]).sum();
        (if weight > R::default() { sum / weight } else { R::default() }, weight)
    }

    /// What a particle carries: mass, density, velocity along x, temperature.
    fn carried(&self, moved: &[R], primitives: &[R], j: usize) -> (R, R, R, R) {
        let (n, l) = (self.step.model.particles(), self.step.model.layout);
        let mass = Masses::new(&self.step.model, moved).of(j);
        let t = if l.heat { primitives[l.primitive_temperature() * n + j] } else { R::default() };
        (mass, primitives[j], primitives[l.primitive_velocity() * n + j], t)
    }

    fn forward_flux(&self, moved: &[R], primitives: &[R]) -> Vec<R> {
        let m = self.targets.len();
        let mut values = vec![R::default(); FIELDS * m];
        for (k, target) in self.targets.iter().enumerate() {
            for p in self.near(target, moved) {
                let (mass, density, u, t) = self.carried(moved, primitives, p.particle);
                let flux = p.weight * mass * u;
                values[k] += flux;
                values[m + k] += flux / density;
                values[2 * m + k] += flux * t;
            }
        }
        values
    }

    fn backward_flux(&self, moved: &[R], primitives: &[R], bar: &[R], moved_bar: &mut [R], primitives_bar: &mut [R]) {
        let (n, m, l) = (self.step.model.particles(), self.targets.len(), self.step.model.layout);
        for (k, target) in self.targets.iter().enumerate() {
            for p in self.near(target, moved) {
                let j = p.particle;
                let (mass, density, u, t) = self.carried(moved, primitives, j);
                // Value: W m u c with c = bar of mass flux + bar of volume flux / rho + bar of heat flux T.
                let c = bar[k] + bar[m + k] / density + bar[2 * m + k] * t;
                let flux = p.weight * mass * u;
                primitives_bar[l.primitive_velocity() * n + j] += p.weight * mass * c;
                primitives_bar[j] -= bar[m + k] * flux / (density * density);
                if l.heat {
                    primitives_bar[l.primitive_temperature() * n + j] += bar[2 * m + k] * flux;
                }
                if l.mass {
                    moved_bar[l.moved_mass() * n + j] += p.weight * u * c;
                }
                let factor = mass * u * c * p.slope;
                for d in 0..l.dimension {
                    moved_bar[d * n + j] -= factor * p.difference[d];
                }
            }
        }
    }

    /// The forward pass, on plain numbers: `[3, targets]`.
    pub fn forward(&self, moved: &[R], primitives: &[R]) -> Vec<R> {
        if self.mode == Mode::Flux {
            return self.forward_flux(moved, primitives);
        }
        let (n, m) = (self.step.model.particles(), self.targets.len());
        let mut values = vec![R::default(); FIELDS * m];
        for (k, target) in self.targets.iter().enumerate() {
            let near = self.near(target, moved);
            for (f, row) in self.rows().into_iter().enumerate() {
                if let Some(row) = row {
                    values[f * m + k] = Self::value(&near, &primitives[row * n..(row + 1) * n]).0;
                }
            }
        }
        values
    }

    /// The adjoint, on plain numbers; the outputs must be zero.
    pub fn backward(
        &self,
        moved: &[R],
        primitives: &[R],
        values_bar: &[R],
        moved_bar: &mut [R],
        primitives_bar: &mut [R],
    ) {
        if self.mode == Mode::Flux {
            return self.backward_flux(moved, primitives, values_bar, moved_bar, primitives_bar);
        }
        let (n, m) = (self.step.model.particles(), self.targets.len());
        for (k, target) in self.targets.iter().enumerate() {
            let near = self.near(target, moved);
            for (f, row) in self.rows().into_iter().enumerate() {
                let Some(row) = row else { continue };
                let field = &primitives[row * n..(row + 1) * n];
                let (value, weight) = Self::value(&near, field);
                if weight <= R::default() {
                    continue;
                }
                let bar = values_bar[f * m + k] / weight;
                for p in &near {
                    let j = p.particle;
                    primitives_bar[row * n + j] += bar * p.weight;
                    // dW/dr_j = -F (t - r_j)
                    let factor = bar * (field[j] - value) * p.slope;
                    for d in 0..self.step.model.layout.dimension {
                        moved_bar[d * n + j] -= factor * p.difference[d];
                    }
                }
            }
        }
    }

    /// The same from ordinary candle ops: the oracle.
    pub fn composed(&self, moved: &Tensor, primitives: &Tensor) -> Result<Tensor> {
        let model = &*self.step.model;
        let (n, m, d) = (model.particles(), self.targets.len(), model.layout.dimension);
        let device = moved.device();
        let mut r2: Option<Tensor> = None;
        for k in 0..d {
            let t: Vec<R> = self.targets.iter().map(|t| R::of(t[k])).collect();
            let t = Tensor::from_vec(t, (m, 1), device)?;
            let mut dr = t.broadcast_sub(&moved.narrow(0, k, 1)?)?;
            if model.domain.periodic[k] {
                let size = model.domain.size[k];
                let turns = dr.detach().affine(1.0 / size, 0.0)?.round()?;
                dr = (dr - turns.affine(size, 0.0)?)?;
            }
            let square = dr.sqr()?;
            r2 = Some(match r2 {
                Some(sum) => (sum + square)?,
                None => square,
            });
        }
        let takes: Vec<R> = (0..n).map(|j| R::of(self.takes(j) as u8 as f64)).collect();
        let takes = Tensor::from_vec(takes, (1, n), device)?;
        // A target on top of a particle: the root has no derivative at 0, and W needs none there.
        let distance = r2.expect("2 or 3 dimensions").affine(1.0, 1e-30)?.sqrt()?;
        let w = composed::quintic(&model.kernel, &distance)?.broadcast_mul(&takes)?;
        if self.mode == Mode::Flux {
            let l = model.layout;
            let mass = composed::mass(&self.step, moved)?;
            let velocity = primitives.narrow(0, l.primitive_velocity(), 1)?;
            let flux = w.broadcast_mul(&mass.mul(&velocity)?)?;
            let volume = flux.broadcast_div(&primitives.narrow(0, 0, 1)?)?;
            let heat = if l.heat {
                flux.broadcast_mul(&primitives.narrow(0, l.primitive_temperature(), 1)?)?
            } else {
                flux.zeros_like()?
            };
            return Tensor::stack(&[flux.sum(1)?, volume.sum(1)?, heat.sum(1)?], 0);
        }
        let total = w.sum(1)?;
        let mut rows = Vec::new();
        for row in self.rows() {
            rows.push(match row {
                Some(row) => w.broadcast_mul(&primitives.narrow(0, row, 1)?)?.sum(1)?.div(&total)?,
                None => total.zeros_like()?,
            });
        }
        Tensor::stack(&rows, 0)
    }
}

impl<R: Real> CustomOp2 for Interpolation<R> {
    fn name(&self) -> &'static str {
        "interpolation"
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        Ok(output(self.forward(input(s1, l1)?, input(s2, l2)?), (FIELDS, self.targets.len())))
    }
    fn bwd(
        &self,
        moved: &Tensor,
        primitives: &Tensor,
        _: &Tensor,
        values_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (l, n) = (self.step.model.layout, self.step.model.particles());
        let mut moved_bar = vec![R::default(); l.moved_rows() * n];
        let mut primitives_bar = vec![R::default(); l.primitive_rows() * n];
        read(moved, |m| {
            read(primitives, |p| {
                read(&values_bar.contiguous()?, |bar| {
                    self.backward(m, p, bar, &mut moved_bar, &mut primitives_bar);
                    Ok(())
                })
            })
        })?;
        Ok((Some(tensor(moved_bar, l.moved_rows(), n)?), Some(tensor(primitives_bar, l.primitive_rows(), n)?)))
    }
}
