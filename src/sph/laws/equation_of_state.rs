//! Tait's equation of state.

use crate::numerics::lanes::{Lanes, Real};
use candle_core::{Result, Tensor};

/// p = p_ref ((rho / rho_ref)^gamma - 1) + p_background (Cole 1948; Monaghan 1994), with p_ref = rho_ref c^2 / gamma.
///
/// `gamma` is a positive whole number (1 for the internal flows here, 7 for water).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EquationOfState {
    pub reference_density: f64,
    pub reference_pressure: f64,
    pub background_pressure: f64,
    pub gamma: i32,
}

impl EquationOfState {
    #[inline(always)]
    pub fn pressure<R: Real>(&self, density: R) -> R {
        let ratio = density * R::of(1.0 / self.reference_density);
        // (x - 1) first: for gamma = 1 in f32, p_ref x - p_ref would lose the digits that matter.
        let power = if self.gamma == 1 { ratio - R::of(1.0) } else { R::of(ratio.f64().powi(self.gamma) - 1.0) };
        R::of(self.reference_pressure) * power + R::of(self.background_pressure)
    }

    /// dp/drho.
    #[inline(always)]
    pub fn slope<R: Real>(&self, density: R) -> R {
        let factor = self.gamma as f64 * self.reference_pressure / self.reference_density;
        if self.gamma == 1 {
            R::of(factor)
        } else {
            R::of(factor * (density.f64() / self.reference_density).powi(self.gamma - 1))
        }
    }

    /// Density of a pressure; not a number for gamma > 1 and a pressure below p(0).
    #[inline(always)]
    pub fn density<R: Real>(&self, pressure: R) -> R {
        let x = (pressure - R::of(self.background_pressure)) * R::of(1.0 / self.reference_pressure);
        let power = if self.gamma == 1 { x + R::of(1.0) } else { R::of((x.f64() + 1.0).powf(1.0 / self.gamma as f64)) };
        power * R::of(self.reference_density)
    }

    /// p(0), the pressure constant of the transport velocity.
    pub fn at_vacuum(&self) -> f64 {
        self.background_pressure - self.reference_pressure
    }

    /// Pressure, in lanes.
    #[inline(always)]
    pub fn pressure_lanes<L: Lanes>(&self, density: L) -> L {
        let number = |x: f64| L::splat(L::Real::of(x));
        let ratio = density * number(1.0 / self.reference_density);
        let power = if self.gamma == 1 { ratio } else { self.power_lanes(ratio, self.gamma) };
        number(self.reference_pressure).mul_add(power - number(1.0), number(self.background_pressure))
    }

    /// dp/drho, in lanes.
    #[inline(always)]
    pub fn slope_lanes<L: Lanes>(&self, density: L) -> L {
        let number = |x: f64| L::splat(L::Real::of(x));
        let factor = self.gamma as f64 * self.reference_pressure / self.reference_density;
        if self.gamma == 1 {
            return number(factor);
        }
        number(factor) * self.power_lanes(density * number(1.0 / self.reference_density), self.gamma - 1)
    }

    /// Density of a pressure, in lanes, by Newton's method from a density that is not far away: from 3 % off, six steps reach
    /// rounding for any gamma in use.
    #[inline(always)]
    pub fn density_lanes<L: Lanes>(&self, pressure: L, near: L) -> L {
        let number = |x: f64| L::splat(L::Real::of(x));
        let power = (pressure - number(self.at_vacuum())) * number(1.0 / self.reference_pressure);
        if self.gamma == 1 {
            return power * number(self.reference_density);
        }
        let mut ratio = near * number(1.0 / self.reference_density);
        for _ in 0..6 {
            let slope = self.power_lanes(ratio, self.gamma - 1);
            ratio = ratio - (slope * ratio - power) / (slope * number(self.gamma as f64));
        }
        ratio * number(self.reference_density)
    }

    #[inline(always)]
    fn power_lanes<L: Lanes>(&self, x: L, exponent: i32) -> L {
        let mut power = if exponent > 0 { x } else { L::splat(L::Real::of(1.0)) };
        for _ in 1..exponent {
            power = power * x;
        }
        power
    }

    /// Pressure of a tensor of densities, from candle's operators.
    pub fn pressure_composed(&self, density: &Tensor) -> Result<Tensor> {
        let ratio = density.affine(1.0 / self.reference_density, 0.0)?;
        let power = if self.gamma == 1 { ratio } else { ratio.powf(self.gamma as f64)? };
        power.affine(self.reference_pressure, self.at_vacuum())
    }

    /// Density of a tensor of pressures.
    pub fn density_composed(&self, pressure: &Tensor) -> Result<Tensor> {
        let power = pressure.affine(1.0 / self.reference_pressure, -self.at_vacuum() / self.reference_pressure)?;
        let power = if self.gamma == 1 { power } else { power.powf(1.0 / self.gamma as f64)? };
        power.affine(self.reference_density, 0.0)
    }
}
