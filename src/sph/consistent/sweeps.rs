//! The sweeps of the consistent method over particles, for f32 and f64.
//!
//! They are called through a trait with implementations that are not generic, see [`crate::sph::standard::sweeps`].

use super::blocks::Blocks;
use super::geometry::Geometry;
use super::kept::Kept;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;

/// Calls a macro with the signature of every sweep and the function that implements it.
macro_rules! sweeps {
    ($with:ident) => {
        $with! {
            fn known(geometry: &Geometry<'_, Self>, kept: &mut Kept<Self>, known: &mut [Self]) = consistent::known;
            fn known_bar(geometry: &Geometry<'_, Self>, kept: &Kept<Self>, known: &[Self], bar: &mut [Self]) = consistent::known_bar;
            fn derivatives(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                derivatives: &mut Vec<Self>,
            ) = consistent::derivatives;
            fn derivatives_bar(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                derivatives: &[Self],
                bar: &mut [Self],
                known_bar: &mut [Self],
            ) = consistent::derivatives_bar;
            fn continuity(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                derivatives: &[Self],
                kept: &Kept<Self>,
                pressure: &mut [Self],
            ) = continuity::forward;
            fn continuity_bar(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                derivatives: &[Self],
                kept: &Kept<Self>,
                bar: &[Self],
                known_bar: &mut [Self],
                derivatives_bar: &mut [Self],
            ) = continuity::backward;
            fn wall_pressure(geometry: &Geometry<'_, Self>, kept: &mut Kept<Self>, known: &[Self], pressure: &mut [Self]) = consistent::wall_pressure;
            fn wall_pressure_bar(
                geometry: &Geometry<'_, Self>,
                kept: &Kept<Self>,
                known: &[Self],
                filled: &[Self],
                pressure_bar: &mut [Self],
                known_bar: &mut [Self],
            ) = consistent::wall_pressure_bar;
            fn pressure_gradient(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                pressure: &[Self],
                gradient: &mut Vec<Self>,
            ) = consistent::pressure_gradient;
            fn pressure_gradient_bar(
                geometry: &Geometry<'_, Self>,
                kept: &Kept<Self>,
                gradient: &[Self],
                bar: &mut [Self],
                known_bar: &mut [Self],
                pressure_bar: &mut [Self],
            ) = consistent::pressure_gradient_bar;
            fn advance(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                derivatives: &[Self],
                gradient: &[Self],
                state: &mut [Self],
            ) = advance::forward;
            fn advance_bar(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                derivatives: &[Self],
                state: &[Self],
                state_bar: &[Self],
                known_bar: &mut [Self],
                derivatives_bar: &mut [Self],
                gradient_bar: &mut [Self],
            ) = advance::backward;
            fn tables(blocks: &mut Blocks, list: &NeighbourList, surface: &[u32]) = Blocks::rebuild::<Self>;
        }
    };
}
pub(super) use sweeps;

macro_rules! declare {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $output:ty)? = $sweep:path;)*) => {
        /// The sweeps of a precision: forward, and the adjoints with names that end in `_bar`.
        #[allow(clippy::too_many_arguments)]
        pub trait Sweeps: Real {
            $(fn $name($($argument: $type),*) $(-> $output)?;)*
        }
    };
}
sweeps!(declare);
