//! Inverse problems: what a flow must have begun with, or be made of, to end as it was seen to end.
//!
//! [`initial_velocity`] finds the velocities at the start from the places at the end, [`calibration`] viscosity and conductivity
//! from a trajectory. Both go through the gradient of [`crate::adjoint`], in the memory that is allowed.
pub mod calibration;
pub mod initial_velocity;
pub mod matching;
