//! Training: how it begins, samples, noise, loss, the loop, checkpoints, studies.
pub mod begin;
pub mod checkpoint;
pub mod loss;
pub mod noise;
pub mod samples;
pub mod study;
pub mod train;
