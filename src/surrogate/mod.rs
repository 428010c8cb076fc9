//! Learned flow: models that advance particles by one (large) step, their training and evaluation.
//!
//! Time is counted in frames here (dt = 1): a velocity is the displacement from one frame to the next.

pub mod conduction;
pub mod differentiable_rollout;
pub mod evaluation;
pub mod features;
pub mod integrate;
pub mod models;
pub mod network;
pub mod predictor;
pub mod training;

pub use models::load::load_predictor;
