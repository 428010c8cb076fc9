//! Smoothed particle hydrodynamics: one law, one file; [`step`] chains the operators.
pub mod advance;
pub mod body_force;
pub mod composed;
pub mod density;
pub mod drift;
pub mod equation_of_state;
pub mod heat;
pub mod interpolation;
pub mod model;
pub mod pairs;
pub mod plan;
pub mod pressure;
pub mod primitives;
pub mod rates;
pub mod step;
pub mod transport_velocity;
pub mod viscosity;
