//! Computes the next frame from a model's output: v += a, p = (p + v) wrapped, T += dT.

use super::features::{wrap, Inputs, Normalisation};
use crate::dataset::Metadata;
use candle_core::{DType, Device, Result, Tensor};

/// The next positions `[N, D]` (f64) from an output `[N, >= D]` of any precision.
pub fn position(
    last: &Tensor,
    inputs: &Inputs,
    output: &Tensor,
    normalisation: &Normalisation,
    metadata: &Metadata,
) -> Result<Tensor> {
    let row = |values: &[f64]| Tensor::from_slice(values, (1, metadata.dim), &Device::Cpu);
    let acceleration = output
        .narrow(1, 0, metadata.dim)?
        .to_dtype(DType::F64)?
        .broadcast_mul(&row(&normalisation.acceleration_scale)?)?
        .broadcast_add(&row(&normalisation.acceleration_mean)?)?;
    wrap(&((last + &inputs.velocity)? + acceleration)?, metadata)
}

/// The next temperatures `[N]` (f64) from the output's column after the acceleration.
pub fn temperature(
    last: &Tensor,
    output: &Tensor,
    normalisation: &Normalisation,
    metadata: &Metadata,
) -> Result<Tensor> {
    let [mean, scale] = normalisation.change.unwrap_or([0.0, 1.0]);
    let change = output.narrow(1, metadata.dim, 1)?.to_dtype(DType::F64)?.affine(scale, mean)?;
    last + change.squeeze(1)?
}
