//! An objective that sees every particle: a sum over the fluid in the final state.

use candle_core::{Result, Tensor};
use hydrograd::adjoint::{Fields, Objective};
use hydrograd::particles::tag;

#[derive(Clone, Copy, PartialEq)]
pub enum Summed {
    /// u^2 / 2.
    KineticEnergy,
    /// Temperature above the reference.
    Heat,
    /// Half the square of that.
    SquaredHeat,
}

pub struct FinalSum {
    pub steps: usize,
    pub of: Summed,
}

impl Objective for FinalSum {
    fn weight(&self, step: usize) -> Option<f64> {
        (step == self.steps).then_some(1.0)
    }
    fn value(&self, fields: &Fields) -> Result<Tensor> {
        let fluid: Vec<f64> = fields.tags.iter().map(|&t| f64::from(u8::from(t == tag::FLUID))).collect();
        let n = fluid.len();
        let fluid = Tensor::from_vec(fluid, (1, n), fields.position.device())?.to_dtype(fields.position.dtype())?;
        let temperature = || fields.temperature.clone().expect("heat");
        let summed = match self.of {
            Summed::KineticEnergy => fields.velocity.sqr()?.affine(0.5, 0.0)?,
            Summed::Heat => temperature(),
            Summed::SquaredHeat => temperature().sqr()?.affine(0.5, 0.0)?,
        };
        summed.broadcast_mul(&fluid)?.sum_all()
    }
}
