//! Relaxation of predicted particles by a few pseudo-steps of SPH (Neural SPH: Toshev, Erbesdobler, Adams and Brandstetter
//! 2024, arXiv:2402.06275), against the clustering of learned particles in long rollouts.
//!
//! In units of the particle spacing, with particles of mass 1 and the quintic kernel W of smoothing length 1, a
//! pseudo-step moves the fluid by
//!
//! ```text
//!   r_i += strength a_i,     a_i = - sum_j (V_i^2 + V_j^2) (p_ij - viscosity u_ij / d_ij e_ij) grad W_ij,
//!   rho_i = sum_j W_ij,      p_i = 100 (rho_i - 1),      V_i = 1/rho_i,
//!   p_ij = (rho_j p_i + rho_i p_j) / (rho_i + rho_j)     (Adami, Hu and Adams 2012, eq. 8)
//! ```
//!
//! where the term of viscosity acts on u, the displacement since the last frame, and is the pair viscosity of the same
//! paper (eq. 10). A density below 0.98 counts as 1, so that free surfaces and fluid beside a thin wall stay, and one
//! above 1.02 as 1.02. Walls have the mean pressure of the fluid around them, and minus its mean displacement plus twice
//! their own. Particles must have equal volumes: data with a shaped wall are refused.

use crate::dataset::extent::Extent;
use crate::dataset::{kind, Metadata};
use crate::numerics::gather::Gather;
use crate::particles::neighbour_list::NeighbourList;
use crate::particles::tag;
use crate::sph::kernels::{Kernel, KernelName};
use crate::surrogate::features::{displacement, wrap};
use crate::surrogate::predictor::{Frame, Predictor, Scenery};
use candle_core::{Device, Tensor};

/// Settings of a relaxation; the defaults are the paper's for most of its flows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// Number of pseudo-steps after each frame.
    pub steps: usize,
    pub strength: f64,
    pub viscosity: f64,
}

impl Default for Relaxation {
    fn default() -> Self {
        Self { steps: 1, strength: 0.03, viscosity: 0.0 }
    }
}

/// The square of the speed of sound, in spacings per frame: p = c^2 (rho - 1).
const STIFFNESS: f64 = 100.0;
/// A smaller density is that of a free surface.
const SURFACE: f64 = 0.98;

impl Relaxation {
    /// Relaxed positions `[N, D]`, given those that a model predicts and those of the frame before. Kinematic particles
    /// are where they were in that frame, and neighbours are constant in derivatives.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn apply(&self, scenery: &Scenery, last: &Tensor, predicted: &Tensor) -> anyhow::Result<Tensor> {
        let metadata = scenery.metadata;
        let fluid = scenery.kind.iter().map(|&k| if kind::is_kinematic(k) { 0.0 } else { 1.0 });
        let fluid = Tensor::from_vec(fluid.collect::<Vec<f64>>(), (scenery.kind.len(), 1), &Device::Cpu)?;
        let walls = fluid.affine(-1.0, 1.0)?;
        let mut position = (predicted.broadcast_mul(&fluid)? + last.broadcast_mul(&walls)?)?;
        for _ in 0..self.steps {
            let moved = (displacement(&position, last, metadata)? / metadata.dx)?;
            let acceleration = self.acceleration(scenery, &position, &moved, &fluid, &walls)?;
            let shift = acceleration.broadcast_mul(&fluid)?.affine(self.strength * metadata.dx, 0.0)?;
            position = wrap(&(position + shift)?, metadata)?;
        }
        Ok(position)
    }

    /// a `[N, D]` for positions and displacements since the last frame `[N, D]`, the latter in spacings.
    fn acceleration(
        &self,
        scenery: &Scenery,
        position: &Tensor,
        moved: &Tensor,
        fluid: &Tensor,
        walls: &Tensor,
    ) -> anyhow::Result<Tensor> {
        let (metadata, n) = (scenery.metadata, scenery.kind.len());
        let kernel = Kernel::new(KernelName::QuinticSpline, metadata.dim, 1.0);
        let (i, j) = pairs(scenery, position, kernel.cutoff() * metadata.dx)?;
        let (i, j) = (Gather::new(&i, n, &Device::Cpu)?, Gather::new(&j, n, &Device::Cpu)?);
        let (own, other, sums) =
            (|of: &Tensor| i.rows(of, 0), |of: &Tensor| j.rows(of, 0), |of: &Tensor| i.sums(of, 0));
        let apart = (displacement(&own(position)?, &other(position)?, metadata)? / metadata.dx)?;
        let distance = apart.sqr()?.sum_keepdim(1)?.sqrt()?;
        // W and F = W'(d)/d, so that grad W = F (r_i - r_j).
        let (weight, slope) = kernel.composed(&distance)?;
        let density = sums(&weight)?.affine(1.0, kernel.at_zero())?;
        let is_inside = density.ge(SURFACE)?.to_dtype(density.dtype())?;
        let density = (density.clamp(0.0, 2.0 - SURFACE)?.mul(&is_inside)? + is_inside.affine(-1.0, 1.0)?)?;
        let pressure = density.affine(STIFFNESS, -STIFFNESS)?;
        // Walls take both from the fluid around them, where there is any.
        let of_fluid = weight.mul(&other(fluid)?)?;
        let seen = sums(&of_fluid)?;
        let seen = (&seen + seen.eq(0.0)?.to_dtype(seen.dtype())?)?;
        let mean = |of: &Tensor| sums(&of_fluid.broadcast_mul(&other(of)?)?)?.broadcast_div(&seen);
        let pressure = (pressure.mul(fluid)? + mean(&pressure)?.mul(walls)?)?;
        let density = pressure.affine(1.0 / STIFFNESS, 1.0)?;
        let (own_density, other_density) = (own(&density)?, other(&density)?);
        let weighted = (other_density.mul(&own(&pressure)?)? + own_density.mul(&other(&pressure)?)?)?;
        let shared = weighted.div(&(&own_density + &other_density)?)?;
        let volumes = (own_density.sqr()?.recip()? + other_density.sqr()?.recip()?)?;
        let mut force = apart.broadcast_mul(&shared.mul(&slope)?.neg()?)?;
        if self.viscosity > 0.0 {
            let own_motion = moved.broadcast_mul(fluid)?;
            let mirrored = (moved.affine(2.0, 0.0)? - mean(moved)?)?.broadcast_mul(walls)?;
            let moved = (own_motion + mirrored)?;
            let sheared = (own(&moved)? - other(&moved)?)?.broadcast_mul(&slope)?;
            force = (force + sheared.affine(self.viscosity, 0.0)?)?;
        }
        Ok(sums(&force.broadcast_mul(&volumes)?)?)
    }
}

/// A model whose predictions are relaxed.
pub struct Relaxed {
    pub model: Box<dyn Predictor>,
    pub relaxation: Relaxation,
}

impl Predictor for Relaxed {
    fn name(&self) -> String {
        format!("{}, relaxed", self.model.name())
    }

    fn window(&self) -> usize {
        self.model.window()
    }

    fn unlike(&self, metadata: &Metadata) -> Option<String> {
        self.model.unlike(metadata)
    }

    fn next(&self, scenery: &Scenery, window: &[Frame]) -> anyhow::Result<Frame> {
        let mut frame = self.model.next(scenery, window)?;
        let Some(last) = window.last() else { anyhow::bail!("a window without frames") };
        let tensor = |position: &[f64]| {
            let d = scenery.metadata.dim;
            Tensor::from_slice(position, (position.len() / d, d), &Device::Cpu)
        };
        let relaxed = self.relaxation.apply(scenery, &tensor(&last.position)?, &tensor(&frame.position)?)?;
        frame.position = relaxed.flatten_all()?.to_vec1::<f64>()?;
        Ok(frame)
    }
}

/// Pairs of fluid with everything, and of walls with fluid, within a distance: their receivers and senders.
fn pairs(scenery: &Scenery, position: &Tensor, reach: f64) -> anyhow::Result<(Vec<u32>, Vec<u32>)> {
    let (metadata, n) = (scenery.metadata, scenery.kind.len());
    let (d, extent) = (metadata.dim, Extent::of(metadata));
    let numbers = position.detach().t()?.contiguous()?.flatten_all()?.to_vec1::<f64>()?;
    let corner: Vec<f64> = numbers.iter().enumerate().map(|(at, &x)| extent.from_corner(at / n, x)).collect();
    let tags: Vec<u8> =
        scenery.kind.iter().map(|&k| if kind::is_kinematic(k) { tag::WALL } else { tag::FLUID }).collect();
    let guess = if d == 2 { 32 } else { 128 };
    let list = NeighbourList::build(&corner, &tags, &metadata.domain(), reach, guess)?;
    let (mut receivers, mut senders) = (Vec::new(), Vec::new());
    for &i in list.fluid_rows.iter().chain(&list.wall_rows) {
        for &j in &list.row(i as usize)[..list.count[i as usize] as usize] {
            receivers.push(i);
            senders.push(j);
        }
    }
    Ok((receivers, senders))
}
