//! Scenes: configuration, geometry, wall shapes.
pub mod accuracy;
pub mod builtin;
pub mod config;
pub mod derived;
pub mod flow;
pub mod heated_channel;
pub mod layers;
pub mod lid_driven_cavity;
pub mod load;
pub mod memory_size;
pub mod poiseuille;
pub mod reverse_poiseuille;
pub mod shape;
pub mod start_shape;
pub mod suggest;
pub mod taylor_green;
pub mod validate;
