//! The flow through a section of targets at the outlet.
//!
//! There are three ways to measure it:
//!
//! * `fluid`: f(t) = sum_j W(|t - r_j|) f_j / sum_j W(|t - r_j|), Shepard-normalised, for f = density, velocity along x
//!   and temperature, over fluid particles, as users of JAX-SPH do. Next to a wall the sum is one-sided and represents
//!   the flow further inside.
//! * `fluid-and-walls`: the same over fluid and wall particles with extrapolated values, which removes that bias. The
//!   product of three smoothed fields is still not the smoothed product: the flux of a parabolic profile is about 2 %
//!   low at ten rows.
//! * `flux`: the fluxes without normalisation: sum_j W m_j u_j, sum_j W V_j u_j, sum_j W m_j u_j T_j over fluid
//!   particles. With targets up to three spacings beyond the walls every particle counts with its whole kernel, so the
//!   sum over the targets is conservative: heat through the targets balances heat through the walls. Fixed particles between
//!   walls, whose pairs carry products of means, have their own sum for that, [`Fields::carried_heat`].

use crate::adjoint::Fields;
pub use crate::config::scene::Interpolation as Mode;
use crate::particles::tag;
use crate::sph::interpolation::Interpolation;
use candle_core::{DType, Result, Tensor};
use std::sync::Arc;

/// Targets across the flow, and how the flow is measured there.
#[derive(Debug, Clone)]
pub struct Outlet {
    pub interpolation: Interpolation,
    pub mode: Mode,
    /// Spacing of the targets. In three dimensions, where they are a square lattice, it is the square of their spacing
    /// over the span of the channel, so that flows are per depth.
    pub spacing: f64,
}

/// Sums over the targets of rho u, u and rho u T, without their spacing.
pub struct Flows<T> {
    pub mass: T,
    pub volume: T,
    pub heat: T,
}

impl Outlet {
    /// x of the targets.
    pub fn place(&self) -> f64 {
        self.interpolation.targets[0][0]
    }

    /// The flow through the targets, on the graph if the fields are. The heat is 0 without temperature.
    pub fn flows(&self, fields: &Fields) -> Result<Flows<Tensor>> {
        let taken = match self.mode {
            Mode::FluidAndWalls => fields.active.clone(),
            Mode::Fluid | Mode::Flux => Arc::new(fields.tags.iter().map(|&t| t == tag::FLUID).collect()),
        };
        let velocity = fields.velocity.narrow(0, 0, 1)?;
        let temperature = fields.temperature.clone().map_or_else(|| velocity.zeros_like(), Ok)?;
        let sums = |rows: &[&Tensor]| self.interpolation.sums(&fields.position, &Tensor::cat(rows, 0)?, &taken);
        if self.mode == Mode::Flux {
            let flux = fields.mass.mul(&velocity)?;
            let sums = sums(&[&flux, &flux.div(&fields.density)?, &flux.mul(&temperature)?])?.sum(1)?;
            let heat = match &fields.carried_heat {
                Some(carried) => carried.affine(1.0 / self.spacing, 0.0)?,
                None => sums.get(2)?,
            };
            return Ok(Flows { mass: sums.get(0)?, volume: sums.get(1)?, heat });
        }
        let sums = sums(&[&velocity.ones_like()?, &fields.density, &velocity, &temperature])?;
        // Where no particle is in reach, all sums are 0, and so is the average.
        let weight = sums.get(0)?;
        let weight = (&weight + weight.eq(0.0)?.to_dtype(weight.dtype())?)?;
        let average = |row: usize| sums.get(row)?.div(&weight);
        let (density, velocity) = (average(1)?, average(2)?);
        let flux = density.mul(&velocity)?;
        Ok(Flows { mass: flux.sum_all()?, volume: velocity.sum_all()?, heat: flux.mul(&average(3)?)?.sum_all()? })
    }

    /// [`Self::flows`] as numbers.
    pub fn numbers(&self, fields: &Fields) -> Result<Flows<f64>> {
        let flows = self.flows(fields)?;
        let number = |tensor: &Tensor| tensor.to_dtype(DType::F64)?.to_scalar::<f64>();
        Ok(Flows { mass: number(&flows.mass)?, volume: number(&flows.volume)?, heat: number(&flows.heat)? })
    }
}
