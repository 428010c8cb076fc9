//! What networks are made of: perceptrons and rounds of messages, fused and from candle-nn's layers, their parameters and
//! optimiser.
pub mod adamw;
pub mod graph;
pub mod interaction;
pub mod layers;
pub mod matrix;
pub mod mlp;
pub mod parameters;
pub mod row;
