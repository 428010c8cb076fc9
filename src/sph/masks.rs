//! Tensors of one value per particle, and masks by coordinate.

use crate::numerics::lanes::Real;
use candle_core::{Result, Tensor};

/// A value per particle as a tensor `[1, N]`, with the type and device of `like`.
pub fn per_particle<R: Real>(values: Vec<R>, like: &Tensor) -> Result<Tensor> {
    let n = values.len();
    Tensor::from_vec(values, (1, n), like.device())?.to_dtype(like.dtype())
}

/// 1 where x < limit, else 0. It is piecewise constant, so it has no derivative.
pub fn below(x: &Tensor, limit: f64) -> Result<Tensor> {
    let x = x.detach();
    x.lt(limit)?.to_dtype(x.dtype())
}

/// 1 where x > limit, else 0.
pub fn above(x: &Tensor, limit: f64) -> Result<Tensor> {
    let x = x.detach();
    x.gt(limit)?.to_dtype(x.dtype())
}
