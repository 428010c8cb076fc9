//! Continuity: the rate of an evolved density.
//!
//! drho_i/dt = rho_i sum_j V_j (u_i - u_j) . grad_i W_ij, V_j = m_j/rho_j, over fluid and wall particles (Adami, Hu and
//! Adams 2013, eq. 5 differentiated; JAX-SPH's `rho_evol_fn`). A free surface needs no particles beyond it.

use crate::numerics::lanes::Lanes;
use crate::sph::composed::Pairs;
use crate::sph::pairs::Mask;
use candle_core::{Result, Tensor};

/// A term of the rate beside continuity: drho_i/dt gains rho_i s_i sum_j V_j F X_ij, where X_ij = -X_ji is what the pair
/// exchanges and s_i a factor of particle i.
pub trait DensityTerm: Copy + Send + Sync {
    /// Whether it does anything.
    const ACTS: bool = true;
    /// s_i and rho_i ds_i/drho_i.
    fn share<L: Lanes>(&self, density: L) -> (L, L);
    /// X_ij and its derivatives.
    fn exchange<L: Lanes, const D: usize>(&self, meeting: &Meeting<L, D>) -> Exchange<L, D>;
}

/// A pair of particles i (`own`) and j, as a [`DensityTerm`] sees it.
pub struct Meeting<'a, L, const D: usize> {
    /// rho_i, rho_j.
    pub density: [L; 2],
    /// A vector of each of them: what that is, the term says.
    pub vector: [[L; D]; 2],
    /// r_i - r_j, and 1/|r_i - r_j|, 0 in the padding.
    pub difference: &'a [L; D],
    pub inverse: L,
    /// Lanes in which both particles are fluid.
    pub fluid: &'a Mask<L>,
    /// Whether i is fluid. The rows of walls have fluid j only.
    pub own_is_fluid: bool,
}

/// X_ij and its derivatives by the fields of i.
pub struct Exchange<L, const D: usize> {
    pub value: L,
    pub by_density: L,
    pub by_difference: [L; D],
    pub by_vector: [L; D],
}

/// No term.
#[derive(Debug, Clone, Copy)]
pub struct ContinuityAlone;

impl DensityTerm for ContinuityAlone {
    const ACTS: bool = false;

    #[inline(always)]
    fn share<L: Lanes>(&self, _: L) -> (L, L) {
        (L::zero(), L::zero())
    }
    #[inline(always)]
    fn exchange<L: Lanes, const D: usize>(&self, _: &Meeting<L, D>) -> Exchange<L, D> {
        let nothing = L::zero();
        Exchange { value: nothing, by_density: nothing, by_difference: [nothing; D], by_vector: [nothing; D] }
    }
}

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
