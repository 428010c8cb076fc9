//! The objective of the bench's gradients in scenes without heat.

use crate::adjoint::{Fields, Objective};
use crate::particles::tag;
use candle_core::{Result, Tensor};

/// The sum of u^2 over the fluid at the last step.
pub struct SquaredVelocity {
    pub steps: usize,
}

impl Objective for SquaredVelocity {
    fn weight(&self, step: usize) -> Option<f64> {
        (step == self.steps).then_some(1.0)
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        let fluid: Vec<f64> = fields.tags.iter().map(|&t| f64::from(u8::from(t == tag::FLUID))).collect();
        let fluid = Tensor::new(fluid, fields.velocity.device())?.to_dtype(fields.velocity.dtype())?;
        fields.velocity.sqr()?.sum(0)?.mul(&fluid)?.sum_all()
    }
}
