//! Continuity: the rate of an evolved density.
//!
//! drho_i/dt = rho_i sum_j V_j (u_i - u_j) . grad_i W_ij, V_j = m_j/rho_j, over fluid and wall particles (Adami, Hu and
//! Adams 2013, eq. 5 differentiated; JAX-SPH's `rho_evol_fn`). A free surface needs no particles beyond it.

use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

/// The fields of all particles from which the rate of the density is computed.
pub struct Flowing<'a> {
    pub pairs: &'a Pairs,
    /// Density, `[1, N]`.
    pub density: &'a Tensor,
    /// V = m/rho, `[1, N]`.
    pub volume: &'a Tensor,
    /// Velocity, `[D, N]`; wall particles have the wall's velocity.
    pub velocity: &'a Tensor,
    /// F = W'(d)/d, `[1, N, K]`.
    pub slope: &'a Tensor,
}

impl Flowing<'_> {
    /// V_j F, `[1, N, K]`.
    pub fn weight(&self) -> Result<Tensor> {
        self.pairs.other(self.volume)?.mul(self.slope)
    }

    /// (u_i - u_j) . r_ij, `[1, N, K]`.
    pub fn parting(&self) -> Result<Tensor> {
        let velocity = (self.pairs.own(self.velocity)? - self.pairs.other(self.velocity)?)?;
        velocity.mul(&self.pairs.difference)?.sum_keepdim(0)
    }
}

/// drho/dt, `[1, N]`, from candle's operators.
pub fn composed(flowing: &Flowing) -> Result<Tensor> {
    flowing.weight()?.mul(&flowing.parting()?)?.sum(2)?.mul(flowing.density)
}
