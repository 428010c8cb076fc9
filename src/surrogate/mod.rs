//! Learned flow: models that advance particles by one (large) step, their training and evaluation.
//!
//! Time is counted in frames here (dt = 1): a velocity is the displacement from one frame to the next.

pub mod displacement;
pub mod evaluate;
pub mod linear;
mod load;
pub mod metrics;
pub mod predictor;
pub mod rollout;
pub mod sinkhorn;
pub mod still;
pub mod study;

pub use load::load_predictor;
