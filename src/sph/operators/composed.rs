//! The operators' composed form: the same formulas from ordinary candle ops over the padded list.
//!
//! Slow and readable, and nothing in it reads a tensor's numbers: it runs on whatever device and in whatever type the state
//! is in. It is what the fused kernels are tested against, values and gradients, and the path for
//! devices without them.

use crate::numerics::gather::Gather;
use crate::numerics::lanes::Real;
use crate::sph::chain::Step;
use crate::sph::model::Model;
use candle_core::{Result, Tensor};

/// The pairs of a list as tensors.
pub struct Pairs {
    particles: usize,
    capacity: usize,
    /// Who stands where in the list, `[N K]`.
    index: Gather,
    /// 1 where an entry is a pair, 0 in the padding, `[1, N, K]`.
    pub mask: Tensor,
    /// r_i - r_j, `[D, N, K]`.
    pub difference: Tensor,
    /// |r_i - r_j|, 10 h in the padding (where the kernel is 0), `[1, N, K]`.
    pub distance: Tensor,
    /// 1 for fluid, `[1, N]`.
    pub is_fluid: Tensor,
}

impl Pairs {
    pub fn new<R: Real>(step: &Step<R>, moved: &Tensor) -> Result<Self> {
        let (model, list) = (&*step.model, &*step.list);
        let (n, k, d) = (list.particles, list.capacity, model.layout.dimension);
        let (index, mask) = list.tensors(moved.device(), moved.dtype())?;
        let mut pairs = Self {
            particles: n,
            capacity: k,
            index,
            difference: mask.clone(),
            distance: mask.clone(),
            mask,
            is_fluid: fluid_mask(model, moved)?,
        };
        let position = moved.narrow(0, 0, d)?;
        let raw = (pairs.own(&position)? - pairs.other(&position)?)?;
        let images = (0..d).map(|c| model.domain.nearest_of(c, &raw.narrow(0, c, 1)?)).collect::<Result<Vec<_>>>()?;
        pairs.difference = Tensor::cat(&images, 0)?;
        // The padding names the particle itself: distance 0, whose root has no derivative. Moved far away instead.
        let far = pairs.mask.affine(-1.0, 1.0)?.affine((10.0 * model.kernel.smoothing_length).powi(2), 0.0)?;
        pairs.distance = (pairs.difference.sqr()?.sum_keepdim(0)? + far)?.sqrt()?;
        Ok(pairs)
    }

    /// A field `[C, N]` of the row's own particle, `[C, N, K]`.
    pub fn own(&self, field: &Tensor) -> Result<Tensor> {
        let c = field.dim(0)?;
        field.unsqueeze(2)?.broadcast_as((c, self.particles, self.capacity))?.contiguous()
    }

    /// A field `[C, N]` of the neighbours, `[C, N, K]`.
    pub fn other(&self, field: &Tensor) -> Result<Tensor> {
        let c = field.dim(0)?;
        self.index.rows(field, 1)?.reshape((c, self.particles, self.capacity))
    }
}

/// Mass of every particle, `[1, N]`.
pub fn mass<R: Real>(step: &Step<R>, moved: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    if l.mass {
        moved.narrow(0, l.moved_mass(), 1)
    } else {
        per_particle(vec![R::of(model.mass); model.particles()], moved)
    }
}

/// 1 for fluid, 0 for walls, `[1, N]`, of the type and on the device of `like`.
pub fn fluid_mask<R: Real>(model: &Model<R>, like: &Tensor) -> Result<Tensor> {
    let n = model.particles();
    per_particle((0..n).map(|i| R::of(model.is_fluid(i) as u8 as f64)).collect(), like)
}

/// A number of each particle as a tensor `[1, N]`, of the type and on the device of `like`.
pub fn per_particle<R: Real>(values: Vec<R>, like: &Tensor) -> Result<Tensor> {
    let n = values.len();
    Tensor::from_vec(values, (1, n), like.device())?.to_dtype(like.dtype())
}

/// 1 where x < limit, else 0: piecewise constant, so without derivative.
pub fn below(x: &Tensor, limit: f64) -> Result<Tensor> {
    let x = x.detach();
    x.lt(limit)?.to_dtype(x.dtype())
}

/// 1 where x > limit, else 0.
pub fn above(x: &Tensor, limit: f64) -> Result<Tensor> {
    let x = x.detach();
    x.gt(limit)?.to_dtype(x.dtype())
}
