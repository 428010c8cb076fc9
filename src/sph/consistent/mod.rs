//! The consistent formulation: second-order operators, an evolved pressure, no background pressure.
//!
//! Summation SPH takes the derivative of a field over a disordered arrangement with an error of order one, and hides it
//! behind a background pressure that keeps particles in order; over a wall that is not flat that pressure carries shear
//! stress, and the flow is up to 13 % slow. Here derivatives are exact for quadratics whatever the arrangement is, so nothing
//! needs to be hidden: the pressure is a field of its own, and particles are kept apart by a shift whose effect on every field
//! is accounted for (arbitrary Lagrangian-Eulerian form). One step of a state (r, u, p, T):
//!
//! ```text
//!   wall values    p and T of dummy particles, from the fluid                                    [wall_values]
//!   derivatives    of u, p, T at the fluid (first and second), volumes V                         [derivatives]
//!   shift          w                                                                             [shift]
//!   continuity     p += dt (-c^2 div u + w.grad p + 2 delta c dx sum_j V_j (-F_ij) [...]),
//!                  then its mean is subtracted                                                   [continuity]
//!   wall values    of the new p
//!   gradient       of the new p                                                                  [derivatives]
//!   advance        u += dt (-grad p / rho + nu lap u + g + w.grad u)
//!                  T += dt (alpha lap T + w.grad T)
//!                  r += dt (u + w)                           or of second order in time            [advance]
//!   drive          where the flow rate or the power is given: the kick that holds it                [drive]
//! ```
//!
//! Sources: Liu and Liu (2006) and Tamai and Koshizuka (2014) for the operators, Antuono et al. (2010) for the diffusive term,
//! Oger et al. (2016) for the shift in ALE form.

pub mod advance;
pub mod blocks;
pub mod composed;
pub mod continuity;
pub mod derivatives;
pub mod drive;
pub mod operators;
pub mod shift;
pub mod stencil;
pub mod wall_values;

pub use blocks::Blocks;
pub use shift::Shift;

use super::model::Model;

/// What a scene's model knows for this formulation.
#[derive(Debug, Clone)]
pub struct Consistent<R> {
    /// Particle spacing dx: the unit of length of the fits.
    pub spacing: f64,
    pub sound_speed: f64,
    /// Reference velocity U.
    pub velocity: f64,
    /// Kinematic.
    pub viscosity: f64,
    /// Thermal.
    pub diffusivity: f64,
    /// Strength of the pressure's diffusion.
    pub delta: f64,
    pub shift: Shift,
    /// What a particle counts in the fits of velocity, pressure and temperature, and as a place where no heat flows into the
    /// wall, `[N, 4]`: the fluid in all fits, dummy particles in that of the pressure; of the points on the wall's surface
    /// some have the wall's velocity, some its temperature, and some its normal.
    pub weights: Vec<R>,
    /// Points on the wall's surface whose fits give dummy particles their values.
    pub surface: Vec<u32>,
    /// Dummy particles, and the places in `surface` of the points whose fits give them their values.
    pub dummies: Vec<(u32, u32)>,
    /// What a fluid particle counts in sums over a section, `[N]`: 11/12 beside a wall, where the midpoint rule overestimates
    /// what falls to zero on the wall, else 1.
    pub quadrature: Vec<R>,
}

/// Everything that the operators of a step know besides fields.
#[derive(Debug)]
pub struct Geometry<'a, R> {
    pub model: &'a Model<R>,
    pub consistent: &'a Consistent<R>,
    pub blocks: &'a Blocks,
    pub times: TimeSteps,
}

/// The time step, and the one before it: 0 where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeSteps {
    pub now: f64,
    pub before: f64,
}

impl<R: crate::numerics::lanes::Real> Consistent<R> {
    /// Whether a wall's particle is no point whose temperature is known.
    pub fn holds_no_temperature(&self, i: usize) -> bool {
        self.weights[4 * i + derivatives::TEMPERATURE] == R::default()
    }
    /// Whether a wall's particle has something else than a velocity in its rows of velocity.
    pub fn holds_no_velocity(&self, i: usize) -> bool {
        self.weights[4 * i] == R::default()
    }
}

impl<R> Clone for Geometry<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<R> Copy for Geometry<'_, R> {}

/// What one operator of a step leaves for those behind it and for the adjoints.
#[derive(Debug, Default)]
pub struct Kept<R> {
    /// Positions and fields of the derivatives of all fields, and of those of the new pressure.
    pub records: Vec<R>,
    pub pressure_records: Vec<R>,
    /// W and F of the fluid's pairs.
    pub value: Vec<R>,
    pub slope: Vec<R>,
    /// The factorised matrices of the fits.
    pub factors: Vec<R>,
    /// Of the fits on the wall's surface: matrices, and coefficients of all fields and of the new pressure.
    pub wall_factors: Vec<R>,
    pub wall_coefficients: Vec<R>,
    pub pressure_coefficients: Vec<R>,
    /// Of the derivatives of all fields.
    pub spread: Vec<R>,
    /// Where each particle of a chain stands between those of the rows beside it: a place to begin the search from.
    pub hints: Vec<u32>,
}
