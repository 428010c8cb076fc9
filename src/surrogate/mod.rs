//! Learned models that advance a flow by large time steps, their training and their evaluation.
//!
//! A step of a learned model computes [`features`] of a window of frames and its graph, applies a network of
//! [`models`], which is built from the parts in [`network`], and [`integrate`]s to the next frame. [`predictor`] is its
//! interface for [`evaluation`], which compares it with the truth. [`training`] fits the parameters.
//! [`relaxation`] keeps the particles of long rollouts apart.
//! [`differentiable_rollout`] has steps on candle's graph, [`dynamics`] makes them available to gradients, [`design`]
//! evaluates walls by them, and [`initial_velocity`] finds initial velocities. Networks use fused operators, or
//! candle-nn's layers ([`network::layers`]) with the same parameters.
//!
//! Time is counted in frames (dt = 1): a velocity is the displacement from one frame to the next.

pub mod conduction;
pub mod design;
pub mod differentiable_rollout;
pub mod dynamics;
pub mod evaluation;
pub mod features;
pub mod initial_velocity;
pub mod integrate;
pub mod models;
pub mod network;
pub mod predictor;
pub mod relaxation;
pub mod training;

pub use models::load::{load_learned, load_predictor, HEATED_CHANNEL, TAYLOR_GREEN};
