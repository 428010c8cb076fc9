//! The sweeps of the consistent method, compiled in this crate for `f32` and `f64`.

use super::blocks::Blocks;
use super::geometry::Geometry;
use super::kept::Kept;
use super::sweeps::{sweeps, Sweeps};
use super::{advance, continuity, operators as consistent};
use crate::particles::NeighbourList;

macro_rules! implement {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $output:ty)? = $sweep:path;)*) => {
        implement!(f32 { $($name($($argument: $type),*) = $sweep;)* });
        implement!(f64 { $($name($($argument: $type),*) = $sweep;)* });
    };
    ($real:ident { $($name:ident($($argument:ident: $type:ty),*) = $sweep:path;)* }) => {
        impl Sweeps for $real {
            $(fn $name($($argument: $type),*) {
                $sweep($($argument),*)
            })*
        }
    };
}
sweeps!(implement);
