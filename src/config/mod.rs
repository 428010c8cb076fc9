//! Configuration: what a run or a training is, as read from TOML and `key=value`.
pub mod builtin;
pub mod custom;
pub mod derived;
pub mod device;
pub mod difference;
pub mod formula;
pub mod layers;
pub mod memory_size;
pub mod provenance;
pub mod range;
pub mod scene;
pub mod schema;
pub mod stability;
pub mod suggest;
pub mod training;
pub mod validate;
