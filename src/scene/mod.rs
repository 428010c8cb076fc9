//! Scenes: configuration, geometry, wall shapes.
pub mod builtin;
pub mod config;
pub mod derived;
pub mod heated_channel;
pub mod layers;
pub mod load;
pub mod memory_size;
pub mod shape;
pub mod start_shape;
pub mod suggest;
pub mod validate;
