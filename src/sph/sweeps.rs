//! The precisions that every method is compiled for.

use super::{consistent, standard};

/// A number type that every method has kernels for, `f32` or `f64`. A method with its own kernels adds its trait here.
pub trait Sweeps: standard::Sweeps + consistent::Sweeps {}

impl Sweeps for f32 {}
impl Sweeps for f64 {}
