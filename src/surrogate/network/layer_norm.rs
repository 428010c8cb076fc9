//! Layer normalisation from ordinary candle operators (candle-nn's fused one cuts the gradient): the oracle of the one
//! in [`crate::surrogate::network::mlp`].

use candle_core::{Result, Tensor, D};

/// (x - mean)/sqrt(var + epsilon) * scale + offset over the last dimension, biased variance.
pub fn layer_norm(x: &Tensor, scale: &Tensor, offset: &Tensor, epsilon: f64) -> Result<Tensor> {
    let centred = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
    let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
    let normalised = centred.broadcast_div(&(variance + epsilon)?.sqrt()?)?;
    normalised.broadcast_mul(scale)?.broadcast_add(offset)
}
