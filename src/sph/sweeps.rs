//! Every sweep over particles, compiled in this crate for `f32` and `f64`.
//!
//! A generic function is compiled where it is called: each test, bench and binary would compile all kernels for three
//! instruction sets again (two minutes each). So the operators call their sweeps through this trait, whose
//! implementations are not generic.

use super::model::Model;
use super::pairs::Kept;
use super::step::Step;
use super::{advance, density, drift, primitives, rates, step};
use crate::neighbours::list::{NeighbourError, NeighbourList, Workspace};
use crate::particles::Domain;

/// The sweeps of a precision: `forward` and (ending in `_bar`) `backward` of the operators' files, and the neighbour
/// list's.
#[allow(clippy::too_many_arguments)]
pub trait Sweeps: Sized {
    fn drift(model: &Model<Self>, dt: f64, state: &[Self], moved: &mut [Self]);
    fn drift_bar(model: &Model<Self>, dt: f64, moved_bar: &[Self], state_bar: &mut [Self]);
    fn advance(step: &Step<Self>, moved: &[Self], rates: &[Self], state: &mut [Self]);
    fn advance_bar(
        step: &Step<Self>,
        moved: &[Self],
        state_bar: &[Self],
        moved_bar: &mut [Self],
        rates_bar: &mut [Self],
    );
    fn density(step: &Step<Self>, moved: &[Self], kept: &mut Kept<Self>, differentiate: bool, density: &mut [Self]);
    fn density_bar(
        step: &Step<Self>,
        moved: &[Self],
        kept: &Kept<Self>,
        density: &[Self],
        density_bar: &[Self],
        moved_bar: &mut [Self],
    );
    fn primitives(
        step: &Step<Self>,
        moved: &[Self],
        density: &[Self],
        kept: &mut Kept<Self>,
        primitives: Option<&mut [Self]>,
    );
    fn primitives_bar(
        step: &Step<Self>,
        kept: &Kept<Self>,
        primitives_bar: &[Self],
        moved_bar: &mut [Self],
        density_bar: &mut [Self],
    );
    fn keep_records(step: &Step<Self>, moved: &[Self], primitives: &[Self], kept: &mut Kept<Self>);
    fn rates(step: &Step<Self>, moved: &[Self], kept: &Kept<Self>, rates: &mut [Self]);
    fn rates_bar(
        step: &Step<Self>,
        moved: &[Self],
        kept: &Kept<Self>,
        rates: &[Self],
        rates_bar: &[Self],
        moved_bar: &mut [Self],
        primitives_bar: &mut [Self],
    );
    fn largest_move(model: &Model<Self>, position: &[Self], reference: &[Self]) -> Result<f64, NeighbourError>;
    fn rebuild(
        list: &mut NeighbourList,
        position: &[Self],
        tags: &[u8],
        domain: &Domain,
        reach: f64,
        workspace: &mut Workspace<Self>,
    ) -> Result<(), NeighbourError>;
}

macro_rules! sweeps {
    ($($real:ty),*) => {$(
        impl Sweeps for $real {
            fn drift(model: &Model<Self>, dt: f64, state: &[Self], moved: &mut [Self]) {
                drift::forward(model, dt, state, moved);
            }
            fn drift_bar(model: &Model<Self>, dt: f64, moved_bar: &[Self], state_bar: &mut [Self]) {
                drift::backward(model, dt, moved_bar, state_bar);
            }
            fn advance(step: &Step<Self>, moved: &[Self], rates: &[Self], state: &mut [Self]) {
                advance::forward(step, moved, rates, state);
            }
            fn advance_bar(
                step: &Step<Self>,
                moved: &[Self],
                state_bar: &[Self],
                moved_bar: &mut [Self],
                rates_bar: &mut [Self],
            ) {
                advance::backward(step, moved, state_bar, moved_bar, rates_bar);
            }
            fn density(
                step: &Step<Self>,
                moved: &[Self],
                kept: &mut Kept<Self>,
                differentiate: bool,
                density: &mut [Self],
            ) {
                density::forward(step, moved, kept, differentiate, density);
            }
            fn density_bar(
                step: &Step<Self>,
                moved: &[Self],
                kept: &Kept<Self>,
                density: &[Self],
                density_bar: &[Self],
                moved_bar: &mut [Self],
            ) {
                density::backward(step, moved, kept, density, density_bar, moved_bar);
            }
            fn primitives(
                step: &Step<Self>,
                moved: &[Self],
                density: &[Self],
                kept: &mut Kept<Self>,
                primitives: Option<&mut [Self]>,
            ) {
                primitives::forward(step, moved, density, kept, primitives);
            }
            fn primitives_bar(
                step: &Step<Self>,
                kept: &Kept<Self>,
                primitives_bar: &[Self],
                moved_bar: &mut [Self],
                density_bar: &mut [Self],
            ) {
                primitives::backward(step, kept, primitives_bar, moved_bar, density_bar);
            }
            fn keep_records(step: &Step<Self>, moved: &[Self], primitives: &[Self], kept: &mut Kept<Self>) {
                rates::keep_records(step, moved, primitives, kept);
            }
            fn rates(step: &Step<Self>, moved: &[Self], kept: &Kept<Self>, rates: &mut [Self]) {
                rates::forward(step, moved, kept, rates);
            }
            fn rates_bar(
                step: &Step<Self>,
                moved: &[Self],
                kept: &Kept<Self>,
                rates: &[Self],
                rates_bar: &[Self],
                moved_bar: &mut [Self],
                primitives_bar: &mut [Self],
            ) {
                rates::backward(step, moved, kept, rates, rates_bar, moved_bar, primitives_bar);
            }
            fn largest_move(
                model: &Model<Self>,
                position: &[Self],
                reference: &[Self],
            ) -> Result<f64, NeighbourError> {
                step::largest_move(model, position, reference)
            }
            fn rebuild(
                list: &mut NeighbourList,
                position: &[Self],
                tags: &[u8],
                domain: &Domain,
                reach: f64,
                workspace: &mut Workspace<Self>,
            ) -> Result<(), NeighbourError> {
                list.rebuild(position, tags, domain, reach, workspace)
            }
        }
    )*};
}
sweeps!(f32, f64);
