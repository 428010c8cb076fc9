//! Training: its start, samples, noise, loss, the loop and checkpoints.
pub mod batch;
pub mod begin;
pub mod checkpoint;
pub mod loss;
pub mod noise;
pub mod objective;
pub mod samples;
pub mod train;
