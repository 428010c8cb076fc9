//! Smoothed particle hydrodynamics: one law, one file; [`step`] chains the operators.
pub mod chain;
pub mod consistent;
pub mod divergence;
pub mod division;
pub mod dynamics;
pub mod fixed;
pub mod kernels;
pub mod laws;
pub mod model;
pub mod operators;
pub mod plan;
pub mod solver;
pub mod step;
pub mod sweeps;

pub use sweeps::Sweeps;
