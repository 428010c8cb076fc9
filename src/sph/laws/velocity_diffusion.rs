//! Diffusion of the velocity, a term of delta-SPH in the momentum equation.
//!
//! du_i/dt gains alpha h c rho_0/rho_i sum_j V_j pi_ij grad_i W_ij over fluid j, pi_ij = (u_i - u_j) . r_ij/r_ij^2
//! (Marrone et al. 2011, eq. 4; JAX-SPH's `acceleration_delta_fn`). It damps compression and expansion.

use super::pair_law::PairFields;
use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VelocityDiffusion {
    /// alpha; 0.01 ... 0.1 is usual.
    pub strength: f64,
    /// Speed of sound c.
    pub sound_speed: f64,
    /// Smoothing length h.
    pub smoothing_length: f64,
    /// Reference density rho_0.
    pub reference_density: f64,
}

impl VelocityDiffusion {
    /// The gain of the force on each particle, `[D, N]`, by candle's operators.
    pub fn composed(&self, pairs: &Pairs, fields: &PairFields) -> Result<Tensor> {
        let velocity = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?;
        let pi = velocity.mul(&pairs.difference)?.sum_keepdim(0)?.div(&pairs.distance.sqr()?)?;
        let fluid = pairs.other(&pairs.is_fluid)?;
        let weight = pairs.other(&fields.volume)?.mul(&fields.slope)?.mul(&pi)?.mul(&fluid)?;
        let factor = self.strength * self.smoothing_length * self.sound_speed * self.reference_density;
        // m_i/rho_i = V_i.
        let sum = pairs.difference.broadcast_mul(&weight)?.sum(2)?;
        sum.broadcast_mul(&fields.volume)?.affine(factor, 0.0)
    }
}
