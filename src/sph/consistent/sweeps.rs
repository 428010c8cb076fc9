//! The sweeps of the consistent method over particles, for f32 and f64.
//!
//! They are called through a trait with implementations that are not generic, see `src/sph/precisions.rs`.

use super::blocks::Blocks;
use super::geometry::Geometry;
use super::kept::Kept;
use crate::particles::NeighbourList;
use crate::sph::precisions::declare;

/// Calls a macro with the signature of every sweep and the function that implements it.
macro_rules! sweeps {
    ($with:ident) => {
        $with! {
            fn fill(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                fields: &mut [Self],
                kept: &mut Kept<Self>,
                all: bool,
            ) = wall_values::fill;
            fn fill_bar(
                geometry: &Geometry<'_, Self>,
                known: &[Self],
                fields: &[Self],
                kept: &Kept<Self>,
                all: bool,
                fields_bar: &mut [Self],
                known_bar: &mut [Self],
            ) = wall_values::backward;
            fn derivatives(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                derivatives: &mut Vec<Self>,
            ) = operators::derivatives;
            fn derivatives_bar(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                derivatives: &[Self],
                bar: &mut [Self],
                known_bar: &mut [Self],
            ) = operators::derivatives_bar;
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
            fn pressure_gradient(
                geometry: &Geometry<'_, Self>,
                kept: &mut Kept<Self>,
                known: &[Self],
                pressure: &[Self],
                gradient: &mut Vec<Self>,
            ) = operators::pressure_gradient;
            fn pressure_gradient_bar(
                geometry: &Geometry<'_, Self>,
                kept: &Kept<Self>,
                gradient: &[Self],
                bar: &mut [Self],
                known_bar: &mut [Self],
                pressure_bar: &mut [Self],
            ) = operators::pressure_gradient_bar;
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

sweeps!(declare);
