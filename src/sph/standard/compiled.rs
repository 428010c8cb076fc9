//! The sweeps of the standard method, compiled in this crate for `f32` and `f64`.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use super::sweeps::{sweeps, Sweeps};
use super::{assemble, density, drift, evolution, rates, wall_condition};

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
