//! Configuration: what a run is, as read from TOML and `key=value`.
pub mod builtin;
pub mod derived;
pub mod layers;
pub mod memory_size;
pub mod scene;
pub mod suggest;
pub mod training;
pub mod validate;
