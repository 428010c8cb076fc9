//! Laws of the fluid, one per file: what a pair of particles contributes, and its derivative.
//!
//! A [`PairLaw`] is written once over lanes: its contribution to the sums of particle i, the derivative of that by the
//! fields of i (the pair pass has a row for j too), and the same from candle's operators. A tuple of laws is a law, so the
//! pair pass ([`super::operators::rates`]) names none. Which tuples there are stands in `with_laws`; a law that few scenes
//! have joins the last, optional one (`Option<Law>` is a law), so that it does not double their number.

pub mod artificial_viscosity;
pub mod body_force;
pub mod conduction;
pub mod continuity;
pub mod density_diffusion;
pub mod drive;
pub mod equation_of_state;
pub mod pressure;
pub mod riemann;
pub mod transport_velocity;
pub mod velocity_diffusion;
pub mod viscosity;

pub use artificial_viscosity::ArtificialViscosity;
pub use conduction::Conduction;
pub use density_diffusion::{DensityDiffusion, DensityGradient};
pub use pressure::Pressure;
pub use riemann::Riemann;
pub use transport_velocity::TransportVelocity;
pub use velocity_diffusion::VelocityDiffusion;
pub use viscosity::Viscosity;

use super::operators::composed::Pairs;
use super::operators::pairs::Mask;
use crate::numerics::lanes::Lanes;
use candle_core::{Result, Tensor};

/// What flows between two particles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Flux {
    /// Mean pressure and shear stress (Adami, Hu and Adams 2013).
    #[default]
    Pair,
    /// The same with diffusion of density and velocity: delta-SPH (Marrone et al. 2011).
    Delta(DensityDiffusion, VelocityDiffusion),
    /// The state between the two that a Riemann problem has (Zhang, Hu and Adams 2017).
    Riemann(Riemann),
}

/// What walls do to a flow along them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Slip {
    /// It has their velocity.
    #[default]
    None,
    /// Nothing: it keeps its own.
    Free,
}

/// One particle of a pair.
#[derive(Clone, Copy)]
pub struct Side<L, const D: usize> {
    /// V = m/rho.
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    /// rho w / 2, w the transport velocity's shift; 0 without one.
    pub transport: [L; D],
    /// 0 without heat.
    pub temperature: L,
    /// Over that of the scene; 0 without materials.
    pub conductivity: L,
}

/// A pair: i (`own`) and j (`other`).
pub struct Pair<'a, L, const D: usize> {
    pub own: &'a Side<L, D>,
    pub other: &'a Side<L, D>,
    /// r_i - r_j, its nearest image.
    pub difference: [L; D],
    /// |r_i - r_j|^2.
    pub square: L,
    /// F = W'(d)/d.
    pub slope: L,
    /// c = (V_i^2 + V_j^2) F, what [`Sums::common`] is multiplied with.
    pub weight: L,
    /// Lanes where both are fluid.
    pub fluid: Mask<L>,
}

/// Sums of particle i over its pairs.
pub struct Sums<L, const D: usize> {
    /// e of the present pair: the force of i gains c e (Adami, Hu and Adams 2013, eq. 8).
    pub common: [L; D],
    /// Force.
    pub force: [L; D],
    /// sum of c r_ij: the background pressure's share of the transport acceleration, over -p_b.
    pub spread: [L; D],
    /// Heat, over 2 k/c_p.
    pub warmth: L,
}

/// Cotangents of the rates of a pair: those of i less those of j, each over its mass.
pub struct Bars<L, const D: usize> {
    /// Of the acceleration, alpha.
    pub acceleration: [L; D],
    /// alpha . r_ij.
    pub along: L,
    /// Of the transport acceleration, times its pressure constant, beta.
    pub transport: [L; D],
    /// Of the temperature rate, times 2 k/c_p, gamma.
    pub temperature: L,
}

/// Derivatives of one pair's share l = c s + ... of the scalar product of cotangents and rates.
pub struct PairBar<L, const D: usize> {
    /// s = alpha . e + beta . r: all that is multiplied with c.
    pub scalar: L,
    /// Derivative of s by r_ij.
    pub by_difference: [L; D],
    /// Derivative of l by F, where F does not stand in c.
    pub by_slope: L,
}

/// Derivatives by the fields of the row's own side, summed over the row.
#[derive(Clone, Copy)]
pub struct SideBar<L, const D: usize> {
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    pub transport: [L; D],
    pub temperature: L,
    pub position: [L; D],
}

/// The particles' fields as tensors, for the composed form.
pub struct PairFields {
    /// `[1, N]`.
    pub mass: Tensor,
    pub volume: Tensor,
    pub density: Tensor,
    /// `[D, N]`.
    pub velocity: Tensor,
    /// `[D, N]`, if there is a transport velocity.
    pub shift: Option<Tensor>,
    /// `[1, N]`, if there is heat.
    pub temperature: Option<Tensor>,
    /// `[1, N]`, if there are materials.
    pub conductivity: Option<Tensor>,
    /// F and c, `[1, N, K]`.
    pub slope: Tensor,
    pub weight: Tensor,
}

/// [`Sums`] as tensors; none where no law has added anything.
#[derive(Default)]
pub struct PairTensors {
    /// e, `[D, N, K]`.
    pub common: Option<Tensor>,
    /// `[D, N]`.
    pub force: Option<Tensor>,
    pub spread: Option<Tensor>,
    /// `[1, N]`.
    pub warmth: Option<Tensor>,
}

impl PairTensors {
    /// Adds to one of the sums.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn add(sum: &mut Option<Tensor>, term: Tensor) -> Result<()> {
        *sum = Some(match sum.take() {
            Some(sum) => (sum + term)?,
            None => term,
        });
        Ok(())
    }
}

/// A law of pairs.
pub trait PairLaw: Copy + Send + Sync {
    /// Whether it reads [`Side::transport`] and gives a transport acceleration.
    const TRANSPORT: bool = false;
    /// Whether it reads [`Side::temperature`] and gives a temperature rate.
    const HEAT: bool = false;
    /// Whether it reads [`Side::conductivity`].
    const MATERIALS: bool = false;

    /// What particle i itself contributes to all of its pairs.
    type Own<L: Lanes, const D: usize>: Copy;

    fn prepare<L: Lanes, const D: usize>(&self, own: &Side<L, D>) -> Self::Own<L, D>;

    /// Adds the pair's share to the sums of i.
    fn add<L: Lanes, const D: usize>(&self, own: &Self::Own<L, D>, pair: &Pair<L, D>, sums: &mut Sums<L, D>);

    /// Adds the derivatives of the pair's share of alpha . acceleration + beta . transport + gamma temperature rate by the
    /// fields of i, and to the pair's own.
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        own: &Self::Own<L, D>,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        pair_bar: &mut PairBar<L, D>,
        bar: &mut SideBar<L, D>,
    );

    /// [`Self::add`] from candle's operators.
    ///
    /// # Errors
    /// Tensor errors.
    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()>;

    /// What it is called in a plan.
    fn name(&self, names: &mut Vec<&'static str>);
}

macro_rules! tuple_of_laws {
    ($($law:ident $place:tt),*) => {
        impl<$($law: PairLaw),*> PairLaw for ($($law,)*) {
            const TRANSPORT: bool = $($law::TRANSPORT ||)* false;
            const HEAT: bool = $($law::HEAT ||)* false;
            const MATERIALS: bool = $($law::MATERIALS ||)* false;
            type Own<Z: Lanes, const N: usize> = ($($law::Own<Z, N>,)*);

            #[inline(always)]
            fn prepare<Z: Lanes, const N: usize>(&self, own: &Side<Z, N>) -> Self::Own<Z, N> {
                ($(self.$place.prepare(own),)*)
            }
            #[inline(always)]
            fn add<Z: Lanes, const N: usize>(&self, own: &Self::Own<Z, N>, pair: &Pair<Z, N>, sums: &mut Sums<Z, N>) {
                $(self.$place.add(&own.$place, pair, sums);)*
            }
            #[inline(always)]
            fn adjoint<Z: Lanes, const N: usize>(
                &self,
                own: &Self::Own<Z, N>,
                pair: &Pair<Z, N>,
                bars: &Bars<Z, N>,
                pair_bar: &mut PairBar<Z, N>,
                bar: &mut SideBar<Z, N>,
            ) {
                $(self.$place.adjoint(&own.$place, pair, bars, pair_bar, bar);)*
            }
            fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
                $(self.$place.composed(pairs, fields, sums)?;)*
                Ok(())
            }
            fn name(&self, names: &mut Vec<&'static str>) {
                $(self.$place.name(names);)*
            }
        }
    };
}
tuple_of_laws!(A 0, B 1);
tuple_of_laws!(A 0, B 1, C 2);
tuple_of_laws!(A 0, B 1, C 2, E 3);
tuple_of_laws!(A 0, B 1, C 2, E 3, G 4);

/// A law that a scene may have: decided row by row at run time, instead of by another compiled sweep.
impl<A: PairLaw> PairLaw for Option<A> {
    const TRANSPORT: bool = A::TRANSPORT;
    const HEAT: bool = A::HEAT;
    const MATERIALS: bool = A::MATERIALS;
    type Own<L: Lanes, const D: usize> = Option<A::Own<L, D>>;

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, own: &Side<L, D>) -> Self::Own<L, D> {
        self.as_ref().map(|law| law.prepare(own))
    }
    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, own: &Self::Own<L, D>, pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        if let (Some(law), Some(own)) = (self, own) {
            law.add(own, pair, sums);
        }
    }
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        own: &Self::Own<L, D>,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        pair_bar: &mut PairBar<L, D>,
        bar: &mut SideBar<L, D>,
    ) {
        if let (Some(law), Some(own)) = (self, own) {
            law.adjoint(own, pair, bars, pair_bar, bar);
        }
    }
    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        self.as_ref().map_or(Ok(()), |law| law.composed(pairs, fields, sums))
    }
    fn name(&self, names: &mut Vec<&'static str>) {
        if let Some(law) = self {
            law.name(names);
        }
    }
}

/// Scalar product over dimensions.
#[inline(always)]
pub fn dot<L: Lanes, const D: usize>(a: &[L; D], b: &[L; D]) -> L {
    let mut sum = a[0] * b[0];
    for d in 1..D {
        sum = a[d].mul_add(b[d], sum);
    }
    sum
}

/// Calls `$go` with the laws of a model and the constant of its dimension. These are all tuples that the pair pass is
/// compiled for: transport velocity or none, heat or none, and either nothing else or whatever the scene has of the rest;
/// and heat in materials, without a transport velocity.
macro_rules! with_laws {
    ($model:expr, |$laws:ident, $d:ident| $go:expr) => {{
        use $crate::sph::laws::{Conduction, Pressure, TransportVelocity, Viscosity};
        let model = $model;
        let (pressure, viscosity) = (Pressure(model.equation_of_state), Viscosity(model.viscosity));
        let (transport, conduction, further) = (TransportVelocity, Conduction::<false>, model.artificial_viscosity);
        macro_rules! of {
            ($dimension:literal) => {{
                const $d: usize = $dimension;
                let materials = model.heat.as_ref().is_some_and(|heat| heat.materials.is_some());
                assert!(!(materials && model.layout.transport), "materials go without a transport velocity");
                match (model.layout.transport, model.layout.heat, further.is_some()) {
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
