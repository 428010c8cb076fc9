//! Fluxes from a Riemann problem between the particles of each pair (Zhang, Hu and Adams 2017).
//!
//! Along the line from i (left) to j (right), u_L = -u_i . e and u_R = -u_j . e with e = r_ij/d. The linear solver's
//! state between them is U* = (u_L + u_R)/2 + (p_L - p_R)/(2 rho c), P* = (p_L + p_R)/2 + beta rho (u_L - u_R)/2, with
//! the mean density rho and the dissipation limiter beta = min(eta max(u_L - u_R, 0), c) (their eq. 10 and 11). Then
//!
//! * drho_i/dt = 2 rho_i sum_j V_j (u_i - v*) . grad_i W, v* = (u_i + u_j)/2 - (U* - (u_L + u_R)/2) e (eq. 8);
//! * du_i/dt = -2 sum_j m_j P*/(rho_i rho_j) grad_i W + 2 sum_j m_j eta/(rho_i rho_j) (u_i - u_j) F with the viscosity
//!   eta (eq. 9, and Zhang, Hu and Adams 2019, eq. 6).
//!
//! The state on a wall's side follows from the fluid's: u_L = -u_i . n, u_R = -u_L + 2 u_wall . n, the pressure p_R =
//! p_L - rho_L g . r_ij and its density, with the wall's normal n into the fluid (Zhang et al. 2017, eq. 12 and 13;
//! Yang, Rakhsha, Hu and Negrut 2020, eq. 15). The signs of u_R are those of JAX-SPH, whose walls do not move along n.

use super::continuity::Flowing;
use super::equation_of_state::EquationOfState;
use super::pair_law::PairFields;
use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Riemann {
    /// Speed of sound c.
    pub sound_speed: f64,
    /// eta of the dissipation limiter. 3 is usual; larger values dissipate more.
    pub limiter: f64,
}

/// The inputs of the Riemann problems besides densities and velocities.
pub struct Surroundings<'a> {
    pub pairs: &'a Pairs,
    pub state: EquationOfState,
    /// Body force per mass on each particle, `[D, N]`.
    pub given: &'a Tensor,
    /// Unit normals of wall particles, `[D, N]`, 0 for fluid.
    pub normals: &'a Tensor,
    /// Velocity, `[D, N]`; wall particles have the wall's velocity.
    pub velocity: &'a Tensor,
}

/// Pressure and density on both sides of a pair, `[1, N, K]`.
struct Sides {
    pressure: [Tensor; 2],
    density: [Tensor; 2],
}

/// `of_fluid` where the mask is 1, `of_wall` where it is 0.
fn choose(is_fluid: &Tensor, of_fluid: &Tensor, of_wall: &Tensor) -> Result<Tensor> {
    of_fluid.mul(is_fluid)? + of_wall.mul(&is_fluid.affine(-1.0, 1.0)?)?
}

impl Surroundings<'_> {
    fn sides(&self, density: &Tensor) -> Result<Sides> {
        let (pairs, fluid) = (self.pairs, self.pairs.other(&self.pairs.is_fluid)?);
        let pressure = self.state.pressure_composed(density)?;
        let (p, rho) = (pairs.own(&pressure)?, pairs.own(density)?);
        let lift = pairs.own(self.given)?.mul(&pairs.difference)?.sum_keepdim(0)?.mul(&rho)?;
        let p_wall = (&p - lift)?;
        let rho_wall = self.state.density_composed(&p_wall)?;
        let (p_other, rho_other) = (pairs.other(&pressure)?, pairs.other(density)?);
        let right = (choose(&fluid, &p_other, &p_wall)?, choose(&fluid, &rho_other, &rho_wall)?);
        Ok(Sides { pressure: [p, right.0], density: [rho, right.1] })
    }
}

impl Riemann {
    /// drho/dt, `[1, N]`, by candle's operators; 0 for wall particles.
    pub fn density_rate(&self, around: &Surroundings, flowing: &Flowing) -> Result<Tensor> {
        let sides = around.sides(flowing.density)?;
        let [p_left, p_right] = sides.pressure;
        let mean = (&sides.density[0] + &sides.density[1])?.affine(0.5 * self.sound_speed, 0.0)?;
        // 2 (u_i - v*) . e d = (u_i - u_j) . r + (p_L - p_R) d/(rho c).
        let jump = (p_left - p_right)?.div(&mean)?.mul(&around.pairs.distance)?;
        let rate = flowing.weight()?.mul(&(flowing.parting()? + jump)?)?.sum(2)?;
        rate.mul(flowing.density)?.mul(&around.pairs.is_fluid)
    }

    /// The force on each particle, `[D, N]`, by candle's operators. Walls in `fields` have the velocity for the shear
    /// stress.
    pub fn force(&self, around: &Surroundings, fields: &PairFields, viscosity: f64) -> Result<Tensor> {
        let pairs = around.pairs;
        let sides = around.sides(&fields.density)?;
        let [p_left, p_right] = &sides.pressure;
        let (u_i, u_j) = (pairs.own(around.velocity)?, pairs.other(around.velocity)?);
        let fluid = pairs.other(&pairs.is_fluid)?;
        let unit = pairs.difference.broadcast_div(&pairs.distance)?;
        let along = |u: &Tensor, n: &Tensor| u.mul(n)?.sum_keepdim(0);
        // u_L - u_R is -(u_i - u_j) . e, and -2 (u_i + u_j) . n at walls.
        let normal = pairs.other(around.normals)?;
        let closing =
            choose(&fluid, &along(&(&u_j - &u_i)?, &unit)?, &along(&(&u_i + &u_j)?, &normal)?.affine(-2.0, 0.0)?)?;
        let most = closing.ones_like()?.affine(self.sound_speed, 0.0)?;
        let beta = closing.relu()?.affine(self.limiter, 0.0)?.minimum(&most)?;
        let mean = (&sides.density[0] + &sides.density[1])?;
        let star = ((p_left + p_right)?.affine(0.5, 0.0)? + mean.mul(&closing)?.mul(&beta)?.affine(0.25, 0.0)?)?;
        // m_i m_j/(rho_i rho_j) F = V_i V_j F.
        let weight = pairs.own(&fields.volume)?.mul(&pairs.other(&fields.volume)?)?.mul(&fields.slope)?;
        let pressing = pairs.difference.broadcast_mul(&star.affine(-2.0, 0.0)?)?;
        let shear = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?.affine(2.0 * viscosity, 0.0)?;
        (pressing + shear)?.broadcast_mul(&weight)?.sum(2)
    }
}
