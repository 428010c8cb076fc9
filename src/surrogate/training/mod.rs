//! Training: how it begins, samples, noise, loss, the loop, checkpoints.
pub mod batch;
pub mod begin;
pub mod checkpoint;
pub mod loss;
pub mod noise;
pub mod samples;
pub mod train;
