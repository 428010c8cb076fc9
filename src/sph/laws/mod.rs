//! Laws of the fluid, one per file: what a pair of particles contributes, and its derivative.
pub mod body_force;
pub mod conduction;
pub mod equation_of_state;
pub mod pressure;
pub mod transport_velocity;
pub mod viscosity;
