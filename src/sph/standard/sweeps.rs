//! The sweeps of the standard method over particles, for f32 and f64.
//!
//! A generic function is compiled where it is called, so each test, bench and binary would compile all kernels for
//! three instruction sets again (two minutes each). Therefore operators call their sweeps through this trait, whose
//! implementations (in `compiled.rs`) are not generic.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use crate::numerics::lanes::Real;

/// Calls a macro with the signature of every sweep and the function that implements it.
macro_rules! sweeps {
    ($with:ident) => {
        $with! {
            fn drift(model: &Standard<Self>, dt: f64, state: &[Self], moved: &mut [Self]) = drift::forward;
            fn drift_bar(model: &Standard<Self>, dt: f64, moved_bar: &[Self], state_bar: &mut [Self]) = drift::backward;
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
