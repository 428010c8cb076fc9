//! What networks are made of: perceptrons, rounds of messages, their parameters and optimiser.
pub mod adamw;
pub mod graph;
pub mod interaction;
pub mod layers;
pub mod matrix;
pub mod memory;
pub mod mlp;
pub mod parameters;
pub mod row;
