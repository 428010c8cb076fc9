//! Buoyancy by Boussinesq's approximation: warm fluid is pushed against gravity.
//!
//! The density is constant but in its weight, rho g (1 - beta (T - T0)), so the acceleration of the fluid is
//!
//! ```text
//!   g - beta (T - T0) g
//! ```
//!
//! with the expansion beta and the temperature T0 at which there is no buoyancy (Boussinesq 1903; de Vahl Davis 1983). The first
//! part is the body force, which the pressure balances in a closed box; it stays, so the pressure has that of the depth. The second part is
//! this law: `by` (T - `at`).

use candle_core::{Result, Tensor};

/// An acceleration by the temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Buoyancy {
    /// -beta g, per temperature.
    pub by: [f64; 3],
    /// T0, in the units in which the flow keeps temperatures (relative to its reference).
    pub at: f64,
}

impl Buoyancy {
    /// That of a fluid with an expansion under gravity (of as many components as dimensions); none without expansion or gravity.
    pub fn new(expansion: f64, gravity: &[f64], at: f64) -> Option<Self> {
        let by = std::array::from_fn(|d| -expansion * gravity.get(d).unwrap_or(&0.0));
        (by != [0.0; 3]).then_some(Self { by, at })
    }

    /// Component `d` of the acceleration at a temperature.
    #[inline(always)]
    pub fn along(&self, d: usize, temperature: f64) -> f64 {
        self.by[d] * (temperature - self.at)
    }

    /// The acceleration `[D, N]` at temperatures `[1, N]`, by candle's operators.
    pub fn composed(&self, dimension: usize, temperature: &Tensor) -> Result<Tensor> {
        let along = |d: usize| temperature.affine(self.by[d], -self.by[d] * self.at);
        Tensor::cat(&(0..dimension).map(along).collect::<Result<Vec<_>>>()?, 0)
    }
}
