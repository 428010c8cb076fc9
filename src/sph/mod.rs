//! Smoothed particle hydrodynamics (SPH): the parts that all methods share, and a folder for each method.
//!
//! A [`method::Method`] advances, differentiates and shows a state. [`solver`] runs any method and has no equation
//! itself.
pub mod cloud;
pub mod composed;
pub mod consistent;
pub mod divergence;
pub mod division;
pub mod dynamics;
pub mod fixed;
pub mod flow;
pub mod interpolation;
pub mod inventory;
pub mod kernels;
pub mod lattice;
pub mod laws;
pub mod masks;
pub mod method;
pub mod own;
pub mod pace;
pub mod pairs;
pub mod part;
pub mod plan;
mod precisions;
pub mod relief;
pub mod rows;
pub mod solver;
pub mod spread;
pub mod spread_gradient;
pub mod standard;
pub mod sweeps;

pub use method::Model;
pub use sweeps::Sweeps;
