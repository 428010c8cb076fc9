//! How the sweeps of a method are compiled in this crate, for `f32` and `f64`.
//!
//! A generic function is compiled where it is called, so each test, bench and binary would compile all kernels for
//! three instruction sets again (two minutes each). Therefore operators call their sweeps through a trait, whose
//! implementations are not generic. A method's `sweeps` is a macro that gives each of these two macros the signature of every
//! sweep and the function that implements it.

/// Declares the trait.
macro_rules! declare {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $sweep:path;)*) => {
        /// The sweeps of a precision: forward, and the adjoints with names that end in `_bar`.
        #[allow(clippy::too_many_arguments)]
        pub trait Sweeps: $crate::numerics::lanes::Real {
            $(fn $name($($argument: $type),*);)*
        }
    };
}
pub(super) use declare;

/// Implements it.
macro_rules! implement {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) = $sweep:path;)*) => {
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
pub(super) use implement;
