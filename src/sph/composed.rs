//! The composed form of the operators: the same formulas by ordinary candle operators over the padded neighbour list.
//!
//! It is slow and readable, and never reads a tensor's numbers, so it runs on any device and in any type. The values
//! and gradients of the fused kernels are tested against it, and devices without fused kernels use it.

use crate::numerics::gather::Gather;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;
use crate::sph::flow::Flow;
use crate::sph::masks::per_particle;
use candle_core::{Result, Tensor};

/// The pairs of a neighbour list as tensors.
pub struct Pairs {
    particles: usize,
    capacity: usize,
    /// Index of the neighbour at each place of the list, `[N K]`.
    index: Gather,
    /// 1 for a pair, 0 in the padding, `[1, N, K]`.
    pub mask: Tensor,
    /// r_i - r_j, `[D, N, K]`.
    pub difference: Tensor,
    /// r_i - r_j|, and 10 h in the padding, where the kernel is 0; `[1, N, K]`.
    pub distance: Tensor,
    /// 1 for fluid particles, 0 for others, `[1, N]`.
    pub is_fluid: Tensor,
}

impl Pairs {
    /// The pairs of a list, with positions in the first rows of `moved`.
    pub fn new<R: Real>(flow: &Flow<R>, list: &NeighbourList, moved: &Tensor) -> Result<Self> {
        let (n, k, d) = (list.particles, list.capacity, flow.dimension());
        let (index, mask) = list.tensors(moved.device(), moved.dtype())?;
        let mut pairs = Self {
            particles: n,
            capacity: k,
            index,
            difference: mask.clone(),
            distance: mask.clone(),
            mask,
            is_fluid: fluid_mask(flow, moved)?,
        };
        let position = moved.narrow(0, 0, d)?;
        let raw = (pairs.own(&position)? - pairs.other(&position)?)?;
        let images = (0..d).map(|c| flow.domain.nearest_of(c, &raw.narrow(0, c, 1)?)).collect::<Result<Vec<_>>>()?;
        pairs.difference = Tensor::cat(&images, 0)?;
        // In the padding the neighbour is the particle itself, at distance 0, where the root has no derivative. Move it
        // away.
        let far = pairs.mask.affine(-1.0, 1.0)?.affine((10.0 * flow.kernel.smoothing_length).powi(2), 0.0)?;
        pairs.distance = (pairs.difference.sqr()?.sum_keepdim(0)? + far)?.sqrt()?;
        Ok(pairs)
    }

    /// The field `[C, N]` of each row's own particle, `[C, N, K]`.
    pub fn own(&self, field: &Tensor) -> Result<Tensor> {
        let c = field.dim(0)?;
        field.unsqueeze(2)?.broadcast_as((c, self.particles, self.capacity))?.contiguous()
    }

    /// The field `[C, N]` of the neighbours, `[C, N, K]`.
    pub fn other(&self, field: &Tensor) -> Result<Tensor> {
        let c = field.dim(0)?;
        self.index.rows(field, 1)?.reshape((c, self.particles, self.capacity))
    }
}

/// 1 for fluid, 0 for walls, `[1, N]`, with the type and device of `like`.
pub fn fluid_mask<R: Real>(flow: &Flow<R>, like: &Tensor) -> Result<Tensor> {
    let n = flow.particles();
    per_particle((0..n).map(|i| R::of(flow.is_fluid(i) as u8 as f64)).collect(), like)
}
