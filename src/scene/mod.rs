//! Scenes: configuration, geometry, wall shapes.
pub mod config;
