//! The neighbour search's sweeps, compiled in this crate for `f32` and `f64`.
//!
//! A generic function is compiled where it is called: each test, bench and binary would compile all kernels for three
//! instruction sets again. So sweeps are called through a trait whose implementations are not generic; those of the
//! operators through [`crate::sph::Sweeps`].

use super::neighbour_list::{NeighbourError, NeighbourList, Workspace};
use super::reach::{self, Reach};
use super::Domain;
use crate::numerics::lanes::Real;

/// A scalar that the neighbour search is compiled for.
pub trait Search: Real {
    /// [`NeighbourList::rebuild`].
    ///
    /// # Errors
    /// As there.
    fn rebuild(
        list: &mut NeighbourList,
        position: &[Self],
        tags: &[u8],
        domain: &Domain,
        reach: f64,
        workspace: &mut Workspace<Self>,
    ) -> Result<(), NeighbourError>;

    /// [`reach::largest_move`].
    ///
    /// # Errors
    /// As there.
    fn largest_move(reach: &Reach, position: &[Self], reference: &[Self]) -> Result<f64, NeighbourError>;
}

macro_rules! search {
    ($($real:ident)*) => {
        $(impl Search for $real {
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
            fn largest_move(reach: &Reach, position: &[Self], reference: &[Self]) -> Result<f64, NeighbourError> {
                reach::largest_move(reach, position, reference)
            }
        })*
    };
}
search!(f32 f64);
