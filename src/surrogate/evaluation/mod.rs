//! A model against the truth: rollouts and their metrics.
pub mod metrics;
pub mod rollout;
pub mod scores;
pub mod sinkhorn;
