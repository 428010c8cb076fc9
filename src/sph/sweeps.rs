//! Every sweep over particles, compiled in this crate for `f32` and `f64`.
//!
//! A generic function is compiled where it is called: each test, bench and binary would compile all kernels for three
//! instruction sets again (two minutes each). So the operators call their sweeps through this trait, whose
//! implementations are not generic.

use super::chain::Step;
use super::model::Model;
use crate::particles::Search;
use crate::sph::operators::pairs::PairCache;
use crate::sph::operators::{assemble, density, drift, rates, wall_condition};

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
    fn assemble(step: &Step<Self>, moved: &[Self], rates: &[Self], state: &mut [Self]) = assemble::forward;
    fn assemble_bar(
        step: &Step<Self>,
        moved: &[Self],
        state_bar: &[Self],
        moved_bar: &mut [Self],
        rates_bar: &mut [Self],
    ) = assemble::backward;
    fn density(step: &Step<Self>, moved: &[Self], kept: &mut PairCache<Self>, differentiate: bool, density: &mut [Self]) = density::forward;
    fn density_bar(
        step: &Step<Self>,
        moved: &[Self],
        kept: &PairCache<Self>,
        density: &[Self],
        density_bar: &[Self],
        moved_bar: &mut [Self],
    ) = density::backward;
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
}
