//! The sweeps of the standard method over particles, for f32 and f64.
//!
//! They are called through a trait with implementations that are not generic, see `src/sph/precisions.rs`.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use crate::sph::precisions::declare;

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

sweeps!(declare);
