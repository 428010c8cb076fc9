//! Models that predict the next frame, learned or not.
pub mod baselines;
pub mod composed_gns;
pub mod egnn;
pub mod gns;
pub mod learned;
pub mod load;
pub mod setup;
pub mod sizes;
