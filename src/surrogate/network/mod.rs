//! The parts of networks: perceptrons and rounds of message passing, fused and from candle-nn's layers, with their
//! parameters and the optimiser.
pub mod adamw;
pub mod graph;
pub mod interaction;
pub mod layers;
pub mod matrix;
pub mod messages;
pub mod mlp;
pub mod parameters;
pub mod row;
pub mod split_layer;
