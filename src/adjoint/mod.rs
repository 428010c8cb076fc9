//! Gradients of long runs in bounded memory, for anything that advances in steps. Nothing here depends on SPH.
pub mod check;
pub mod dynamics;
pub mod gradient;
pub mod run;
pub mod schedule;

pub use dynamics::{Dynamics, Fields, Objective, RunError};
pub use run::{run, Observer};
