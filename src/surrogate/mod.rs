//! Learned flow: models that advance particles by one (large) step, their training and evaluation.
//!
//! Time is counted in frames here (dt = 1): a velocity is the displacement from one frame to the next.

pub mod adamw;
pub mod checkpoint;
pub mod composed;
pub mod conduction;
pub mod egnn;
pub mod evaluate;
pub mod features;
pub mod gather;
pub mod gns;
pub mod graph;
pub mod integrate;
pub mod interaction;
pub mod layer_norm;
pub mod learned;
pub mod linear;
mod load;
pub mod loss;
pub mod matrix;
pub mod memory;
pub mod metrics;
pub mod mlp;
pub mod model;
pub mod noise;
pub mod predictor;
pub mod rollout;
pub mod row;
pub mod samples;
pub mod settings;
pub mod setup;
pub mod sinkhorn;
pub mod still;
pub mod study;
pub mod train;

pub use load::load_predictor;
