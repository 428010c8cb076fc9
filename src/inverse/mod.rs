//! Inverse problems: finds the initial state or the materials of a flow from its observed end or course.
//!
//! [`initial_state`] finds initial positions or velocities from the positions at the end, [`calibration`] viscosity and
//! conductivity from a trajectory. Both use the gradient of [`crate::adjoint`] within the memory budget, and the same
//! [`search`]. [`crate::surrogate::initial_velocity`] uses a learned model instead of the solver.
pub mod calibration;
pub mod initial_state;
pub mod matching;
pub mod search;
