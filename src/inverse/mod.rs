//! Inverse problems: what a flow must have begun with, or be made of, to end as it was seen to end.
//!
//! [`initial_state`] finds places or velocities at the start from the places at the end, [`calibration`] viscosity and conductivity
//! from a trajectory. Both go through the gradient of [`crate::adjoint`], in the memory that is allowed, and are [`search`]ed for
//! alike. With a learned model in the place of the solver: [`crate::surrogate::initial_velocity`].
pub mod calibration;
pub mod initial_state;
pub mod matching;
pub mod search;
