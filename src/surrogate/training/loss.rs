//! The loss of a training, and its targets.

use crate::dataset::Metadata;
use crate::surrogate::features::{displacement, Normalisation};
use candle_core::{Device, Result, Tensor};

/// The normalised acceleration (a - mean)/s of three frames `[N, D]` (f64), the last of which is the target.
pub fn target_acceleration(frames: [&Tensor; 3], normalisation: &Normalisation, metadata: &Metadata) -> Result<Tensor> {
    let [before, now, next] = frames;
    let change = (displacement(next, now, metadata)? - displacement(now, before, metadata)?)?;
    let row = |values: &[f64]| Tensor::from_slice(values, (1, metadata.dim), &Device::Cpu);
    change
        .broadcast_sub(&row(&normalisation.acceleration_mean)?)?
        .broadcast_div(&row(&normalisation.acceleration_scale)?)
}

/// Mean over the particles with mask 1 of the sum over components of (prediction - target)^2.
///
/// All are `[N, C]`. Each column of the mask may leave out different particles.
pub fn loss(prediction: &Tensor, target: &Tensor, mask: &Tensor) -> Result<Tensor> {
    let square = (prediction - target)?.sqr()?;
    let count = mask.sum(0)?.clamp(1.0, f64::INFINITY)?;
    square.broadcast_mul(mask)?.sum(0)?.broadcast_div(&count)?.sum_all()
}
