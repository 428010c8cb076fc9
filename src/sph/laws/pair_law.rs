//! The interface of a pair law: its contribution to the sums of a particle, the derivative, and the composed form.

use crate::numerics::lanes::Lanes;
use crate::sph::composed::Pairs;
use crate::sph::pairs::Mask;
use candle_core::{Result, Tensor};

/// What laws take from a scene beside their own keys.
#[derive(Debug, Clone, Copy)]
pub struct Scales {
    pub sound_speed: f64,
    pub smoothing_length: f64,
    pub reference_density: f64,
}

/// The fields of one particle of a pair.
#[derive(Clone, Copy)]
pub struct Side<L, const D: usize> {
    /// V = m/rho.
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    /// rho w / 2, where w is the shift of the transport velocity; 0 without one.
    pub transport: [L; D],
    /// Temperature; 0 without heat.
    pub temperature: L,
    /// Conductivity relative to that of the scene; 0 without materials.
    pub conductivity: L,
    /// Body force per mass on fluid, the unit normal into the fluid of a wall; 0 where no law reads it.
    pub facing: [L; D],
    /// u . n of a wall's own velocity; 0 for fluid, and where no law reads it.
    pub crossing: L,
}

/// A pair of particles i (`own`) and j (`other`).
pub struct Pair<'a, L, const D: usize> {
    pub own: &'a Side<L, D>,
    pub other: &'a Side<L, D>,
    /// r_i - r_j to the nearest image.
    pub difference: [L; D],
    /// |r_i - r_j|^2.
    pub square: L,
    /// F = W'(d)/d.
    pub slope: L,
    /// c = (V_i^2 + V_j^2) F, the factor of [`Sums::common`].
    pub weight: L,
    /// Lanes in which both particles are fluid.
    pub fluid: Mask<L>,
    /// Whether i is fluid. The rows of walls have fluid j only.
    pub own_is_fluid: bool,
}

/// Sums of particle i over its pairs.
pub struct Sums<L, const D: usize> {
    /// e of the present pair; the force on i gains c e (Adami, Hu and Adams 2013, eq. 8).
    pub common: [L; D],
    pub force: [L; D],
    /// sum of c r_ij: the transport acceleration by the background pressure, over -p_b.
    pub spread: [L; D],
    /// Rate of heat, over 2 k/c_p.
    pub warmth: L,
}

/// Cotangents of the rates of a pair: those of i minus those of j, each over the particle's mass.
pub struct Bars<L, const D: usize> {
    /// alpha, of the acceleration.
    pub acceleration: [L; D],
    /// alpha . r_ij.
    pub along: L,
    /// beta, of the transport acceleration, times its pressure constant.
    pub transport: [L; D],
    /// gamma, of the temperature rate, times 2 k/c_p.
    pub temperature: L,
}

/// Derivatives of a pair's part l = c s + ... of the scalar product of cotangents and rates.
pub struct PairBar<L, const D: usize> {
    /// s = alpha . e + beta . r, the part that is multiplied with c.
    pub scalar: L,
    /// Derivative of s with respect to r_ij.
    pub by_difference: [L; D],
    /// Derivative of l with respect to F, except through c.
    pub by_slope: L,
    /// Derivatives with respect to the fields of the row's own particle, summed over the row.
    pub own: SideBar<L, D>,
}

/// Derivatives with respect to the fields of the row's own particle, summed over the row.
#[derive(Clone, Copy)]
pub struct SideBar<L, const D: usize> {
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    pub transport: [L; D],
    pub temperature: L,
    pub facing: [L; D],
    pub crossing: L,
    pub position: [L; D],
}

/// The fields of the particles as tensors, for the composed form.
pub struct PairFields {
    /// Mass, `[1, N]`; so are volume and density.
    pub mass: Tensor,
    pub volume: Tensor,
    pub density: Tensor,
    /// Velocity, `[D, N]`.
    pub velocity: Tensor,
    /// Shift of the transport velocity, `[D, N]`, if there is one.
    pub shift: Option<Tensor>,
    /// Temperature, `[1, N]`, if there is heat.
    pub temperature: Option<Tensor>,
    /// Relative conductivity, `[1, N]`, if there are several materials.
    pub conductivity: Option<Tensor>,
    /// F and c, `[1, N, K]`.
    pub slope: Tensor,
    pub weight: Tensor,
    /// What [`Side::facing`] and [`Side::crossing`] are made of.
    pub faces: Faces,
}

/// What a law may read of the particles at a wall.
pub struct Faces {
    /// Body force per mass on each particle, `[D, N]`.
    pub given: Tensor,
    /// Unit normals of wall particles, `[D, N]`, 0 for fluid.
    pub normals: Tensor,
    /// Velocity, `[D, N]`; wall particles have the wall's velocity.
    pub velocity: Tensor,
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
    pub fn add(sum: &mut Option<Tensor>, term: Tensor) -> Result<()> {
        *sum = Some(match sum.take() {
            Some(sum) => (sum + term)?,
            None => term,
        });
        Ok(())
    }
}

pub trait PairLaw: Copy + Send + Sync {
    /// Whether it reads [`Side::transport`] and gives a transport acceleration.
    const TRANSPORT: bool = false;
    /// Whether it reads [`Side::temperature`] and gives a temperature rate.
    const HEAT: bool = false;
    /// Whether it reads [`Side::conductivity`].
    const MATERIALS: bool = false;
    /// Whether it reads [`Side::facing`] and [`Side::crossing`].
    const FACES: bool = false;

    /// What particle i itself contributes to all of its pairs.
    type Own<L: Lanes, const D: usize>: Copy;

    fn prepare<L: Lanes, const D: usize>(&self, own: &Side<L, D>) -> Self::Own<L, D>;

    /// Adds the pair's share to the sums of i.
    fn add<L: Lanes, const D: usize>(&self, own: &Self::Own<L, D>, pair: &Pair<L, D>, sums: &mut Sums<L, D>);

    /// Adds the derivatives of the pair's share of alpha . acceleration + beta . transport + gamma temperature rate.
    fn adjoint<L: Lanes, const D: usize>(
        &self,
        own: &Self::Own<L, D>,
        pair: &Pair<L, D>,
        bars: &Bars<L, D>,
        to: &mut PairBar<L, D>,
    );

    /// [`Self::add`] from candle's operators.
    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()>;

    /// What it is called in a plan.
    fn name(&self, names: &mut Vec<&'static str>);

    /// Whether it does anything in this scene.
    fn acts(&self) -> bool {
        true
    }
}

macro_rules! tuple_of_laws {
    ($($law:ident $place:tt),*) => {
        impl<$($law: PairLaw),*> PairLaw for ($($law,)*) {
            const TRANSPORT: bool = $($law::TRANSPORT ||)* false;
            const HEAT: bool = $($law::HEAT ||)* false;
            const MATERIALS: bool = $($law::MATERIALS ||)* false;
            const FACES: bool = $($law::FACES ||)* false;
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
            fn adjoint<Z: Lanes, const N: usize>(&self, own: &Self::Own<Z, N>, pair: &Pair<Z, N>, bars: &Bars<Z, N>, to: &mut PairBar<Z, N>) {
                $(self.$place.adjoint(&own.$place, pair, bars, to);)*
            }
            fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
                $(self.$place.composed(pairs, fields, sums)?;)*
                Ok(())
            }
            fn name(&self, names: &mut Vec<&'static str>) {
                $(self.$place.name(names);)*
            }
            fn acts(&self) -> bool {
                $(self.$place.acts() ||)* false
            }
        }
    };
}
tuple_of_laws!(A 0);
tuple_of_laws!(A 0, B 1);
tuple_of_laws!(A 0, B 1, C 2);
tuple_of_laws!(A 0, B 1, C 2, E 3);
tuple_of_laws!(A 0, B 1, C 2, E 3, G 4);

/// A law that a scene may have: decided row by row at run time, instead of by another compiled sweep.
impl<A: PairLaw> PairLaw for Option<A> {
    const TRANSPORT: bool = A::TRANSPORT;
    const HEAT: bool = A::HEAT;
    const MATERIALS: bool = A::MATERIALS;
    const FACES: bool = A::FACES;
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
        to: &mut PairBar<L, D>,
    ) {
        if let (Some(law), Some(own)) = (self, own) {
            law.adjoint(own, pair, bars, to);
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
    fn acts(&self) -> bool {
        self.is_some()
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
