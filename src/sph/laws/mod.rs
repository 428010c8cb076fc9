//! Laws of the fluid, one per file: the contribution of a pair of particles, and its derivative.
//!
//! A [`PairLaw`] has its contribution to the sums of particle i, the derivative of that with respect to the fields of i
//! (the pair pass visits a pair from both sides), and the same by candle's operators. A tuple of laws is a law, so the
//! pair pass ([`super::standard::rates`]) names none. `with_laws` lists the tuples that are compiled. A law that few
//! scenes use is an element of [`Further`], where `Option<Law>` is a law, so that it does not double the number of
//! tuples: such a law is a file here and a line in [`Further`] and in [`further`].

pub mod artificial_viscosity;
pub mod body_force;
pub mod buoyancy;
pub mod conduction;
pub mod continuity;
pub mod density_diffusion;
pub mod drive;
pub mod equation_of_state;
pub mod pair_law;
pub mod pressure;
pub mod riemann;
pub mod transport_velocity;
pub mod velocity_diffusion;
pub mod viscosity;

use crate::config::scene::{self, FluxName};
pub use crate::config::scene::{DensityGradient, Slip};
pub use artificial_viscosity::ArtificialViscosity;
pub use conduction::Conduction;
pub use density_diffusion::DensityDiffusion;
pub use pair_law::{dot, Bars, Faces, Pair, PairBar, PairFields, PairLaw, PairTensors, Scales, Side, SideBar, Sums};
pub use pressure::Pressure;
pub use riemann::Riemann;
pub use transport_velocity::TransportVelocity;
pub use velocity_diffusion::VelocityDiffusion;
pub use viscosity::Viscosity;

/// The form of the flux between two particles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Flux {
    /// Mean pressure and shear stress (Adami, Hu and Adams 2013).
    #[default]
    Pair,
    /// As `Pair`, with diffusion of the density: delta-SPH (Marrone et al. 2011), to which [`VelocityDiffusion`] belongs.
    Delta(DensityDiffusion),
    /// By the state between the two particles in a Riemann problem (Zhang, Hu and Adams 2017).
    Riemann(Riemann),
}

impl Flux {
    /// The form that the method's keys choose.
    pub fn of(own: &scene::Standard, scales: &Scales) -> Self {
        let Scales { sound_speed, smoothing_length, .. } = *scales;
        let gradient = own.density_gradient;
        match own.flux {
            FluxName::Pair => Self::Pair,
            FluxName::Delta => Self::Delta(DensityDiffusion {
                strength: own.density_diffusion,
                sound_speed,
                smoothing_length,
                gradient,
            }),
            FluxName::Riemann => Self::Riemann(Riemann { sound_speed, limiter: own.riemann_limiter }),
        }
    }
}

/// The laws that few scenes use.
pub type Further = (Option<ArtificialViscosity>, Option<VelocityDiffusion>);

/// Those of them that the method's keys choose.
pub fn further(own: &scene::Standard, scales: &Scales) -> Further {
    (ArtificialViscosity::of(own, scales), VelocityDiffusion::of(own, scales))
}

/// Calls `$go` with the laws of a model and the constant of its dimension. The pair pass is compiled for the tuples
/// here: with or without transport velocity, with or without heat, each with or without the scene's further laws; and
/// for heat in several materials, without transport velocity. Riemann problems take the place of pressure and viscosity,
/// with or without heat.
macro_rules! with_laws {
    ($model:expr, |$laws:ident, $d:ident| $go:expr) => {{
        use $crate::sph::laws::{Conduction, Flux, PairLaw, Pressure, TransportVelocity, Viscosity};
        let model = $model;
        let (pressure, viscosity) = (Pressure(model.equation_of_state), Viscosity(model.viscosity));
        let (transport, conduction, further) = (TransportVelocity, Conduction::<false>, model.laws.further);
        macro_rules! of {
            ($dimension:literal) => {{
                const $d: usize = $dimension;
                let materials = model.heat.as_ref().is_some_and(|heat| heat.materials.is_some());
                assert!(!(materials && model.layout.transport), "materials go without a transport velocity");
                if let Flux::Riemann(law) = model.laws.flux {
                    assert!(!materials && !model.layout.transport, "composed of candle's operators");
                    let fluxes = law.fluxes(model.equation_of_state, model.viscosity);
                    match model.layout.heat {
                        false => of!(go, (fluxes, further)),
                        true => of!(go, (fluxes, conduction, further)),
                    }
                } else {
                    match (model.layout.transport, model.layout.heat, PairLaw::acts(&further)) {
                        _ if materials => of!(go, (pressure, viscosity, Conduction::<true>, further)),
                        (false, false, false) => of!(go, (pressure, viscosity)),
                        (false, true, false) => of!(go, (pressure, viscosity, conduction)),
                        (true, false, false) => of!(go, (pressure, viscosity, transport)),
                        (true, true, false) => of!(go, (pressure, viscosity, transport, conduction)),
                        (false, false, true) => of!(go, (pressure, viscosity, further)),
                        (false, true, true) => of!(go, (pressure, viscosity, conduction, further)),
                        (true, false, true) => of!(go, (pressure, viscosity, transport, further)),
                        (true, true, true) => of!(go, (pressure, viscosity, transport, conduction, further)),
                    }
                }
            }};
            (go, $tuple:expr) => {{
                let $laws = $tuple;
                $go
            }};
        }
        if model.layout.dimension == 2 {
            of!(2)
        } else {
            of!(3)
        }
    }};
}
pub(crate) use with_laws;
