//! Evaluation of models: rollouts and their metrics.
pub mod metrics;
pub mod rollout;
pub mod scores;
pub mod sinkhorn;
