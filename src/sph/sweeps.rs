//! Every sweep over particles, compiled in this crate for `f32` and `f64`.
//!
//! A generic function is compiled where it is called: each test, bench and binary would compile all kernels for three
//! instruction sets again (two minutes each). So the operators call their sweeps through this trait, whose
//! implementations are not generic.

use super::chain::Step;
use super::model::Model;
use crate::particles::{NeighbourList, Search};
use crate::sph::consistent::{advance, continuity, operators as consistent, Blocks, Geometry, Kept};
use crate::sph::operators::pairs::PairCache;
use crate::sph::operators::{assemble, density, drift, evolution, rates, wall_condition};

macro_rules! sweeps {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $output:ty)? = $sweep:path;)*) => {
        /// The sweeps of a precision: `forward` and (ending in `_bar`) `backward` of the operators' files.
        #[allow(clippy::too_many_arguments)]
        pub trait Sweeps: Search {
            $(fn $name($($argument: $type),*) $(-> $output)?;)*
        }
        sweeps!(impl f32 { $($name($($argument: $type),*) $(-> $output)? = $sweep;)* });
        sweeps!(impl f64 { $($name($($argument: $type),*) $(-> $output)? = $sweep;)* });
    };
    (impl $real:ident { $($name:ident($($argument:ident: $type:ty),*) $(-> $output:ty)? = $sweep:path;)* }) => {
        impl Sweeps for $real {
            $(fn $name($($argument: $type),*) $(-> $output)? {
                $sweep($($argument),*)
            })*
        }
    };
}
sweeps! {
    fn drift(model: &Model<Self>, dt: f64, state: &[Self], moved: &mut [Self]) = drift::forward;
    fn drift_bar(model: &Model<Self>, dt: f64, moved_bar: &[Self], state_bar: &mut [Self]) = drift::backward;
    fn assemble(step: &Step<Self>, moved: &[Self], primitives: &[Self], rates: &[Self], state: &mut [Self]) = assemble::forward;
    fn assemble_bar(
        step: &Step<Self>,
        moved: &[Self],
        state_bar: &[Self],
        moved_bar: &mut [Self],
        rates_bar: &mut [Self],
    ) = assemble::backward;
    fn density(step: &Step<Self>, moved: &[Self], kept: &mut PairCache<Self>, density: &mut [Self]) = density::forward;
    fn density_bar(
        step: &Step<Self>,
        moved: &[Self],
        density: &[Self],
        density_bar: &[Self],
        moved_bar: &mut [Self],
    ) = density::backward;
    fn evolution(
        step: &Step<Self>,
        dt: f64,
        moved: &[Self],
        kept: &mut PairCache<Self>,
        density: &mut [Self],
    ) = evolution::forward;
    fn evolution_bar(
        step: &Step<Self>,
        dt: f64,
        moved: &[Self],
        density: &[Self],
        density_bar: &[Self],
        moved_bar: &mut [Self],
    ) = evolution::backward;
    fn primitives(
        step: &Step<Self>,
        moved: &[Self],
        density: &[Self],
        kept: &mut PairCache<Self>,
        primitives: Option<&mut [Self]>,
    ) = wall_condition::forward;
    fn primitives_bar(
        step: &Step<Self>,
        kept: &PairCache<Self>,
        primitives_bar: &[Self],
        moved_bar: &mut [Self],
        density_bar: &mut [Self],
    ) = wall_condition::backward;
    fn keep_records(step: &Step<Self>, moved: &[Self], primitives: &[Self], kept: &mut PairCache<Self>) = rates::keep_records;
    fn rates(step: &Step<Self>, moved: &[Self], kept: &PairCache<Self>, rates: &mut [Self]) = rates::forward;
    fn rates_bar(
        step: &Step<Self>,
        moved: &[Self],
        kept: &PairCache<Self>,
        rates: &[Self],
        rates_bar: &[Self],
        moved_bar: &mut [Self],
        primitives_bar: &mut [Self],
    ) = rates::backward;
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
