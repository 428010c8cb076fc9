//! The distance of a run from observations, as an objective.
//!
//! ```text
//!   sum over frames  w_f mean_i ( |x_i - x*_i|^2 / length^2 + (T_i - T*_i)^2 / warmth^2 ),     i over the fluid
//! ```
//!
//! The difference x - x* is to the nearest image. Particles are compared one by one, so the run and the observations
//! must start with the same ones.

use crate::adjoint::{Fields, Objective};
use crate::particles::Domain;
use candle_core::{Device, Result, Tensor};
use std::collections::BTreeMap;

/// Observations after a step: positions `[D, N]`, temperatures `[N]` relative to the reference.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen {
    pub position: Vec<f64>,
    pub temperature: Option<Vec<f64>>,
    pub weight: f64,
}

/// The objective, which is minimised.
pub struct Matching {
    pub seen: BTreeMap<usize, Seen>,
    pub domain: Domain,
    /// Whether each particle counts, `[N]`.
    pub fluid: Vec<bool>,
    /// Scales of differences of positions and of temperatures.
    pub length: f64,
    pub warmth: f64,
}

impl Objective for Matching {
    fn weight(&self, step: usize) -> Option<f64> {
        self.seen.get(&step).map(|seen| seen.weight)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        let Some(seen) = self.seen.get(&fields.step) else { candle_core::bail!("nothing was seen at this step") };
        let (d, n) = (self.domain.dimension, self.fluid.len());
        let like = |values: Vec<f64>, rows: usize| {
            Tensor::from_vec(values, (rows, n), &Device::Cpu)?.to_dtype(fields.position.dtype())
        };
        let count = self.fluid.iter().filter(|fluid| **fluid).count() as f64;
        let fluid = like(self.fluid.iter().map(|&fluid| if fluid { 1.0 / count } else { 0.0 }).collect(), 1)?;
        let target = like(seen.position.clone(), d)?;
        let mut sum = None;
        for k in 0..d {
            let apart = (fields.position.narrow(0, k, 1)? - target.narrow(0, k, 1)?)?;
            let square = self.domain.nearest_of(k, &apart)?.sqr()?.mul(&fluid)?.sum_all()?;
            let square = square.affine(self.length.powi(-2), 0.0)?;
            sum = Some(match sum {
                None => square,
                Some(sum) => (sum + square)?,
            });
        }
        let Some(mut sum) = sum else { candle_core::bail!("particles without a place") };
        if let (Some(temperature), Some(seen)) = (&fields.temperature, &seen.temperature) {
            let apart = (temperature - like(seen.clone(), 1)?)?;
            sum = (sum + apart.sqr()?.mul(&fluid)?.sum_all()?.affine(self.warmth.powi(-2), 0.0)?)?;
        }
        Ok(sum)
    }
}
