//! Learned flow: models that advance particles by one (large) step, their training and evaluation.
//!
//! A step of a learned model: [`features`] of a window of frames and their graph, a network of [`models`] made of what
//! [`network`] has, and [`integrate`]: next frame. [`predictor`] hides all of it from [`evaluation`], which compares with the
//! truth; [`training`] moves the parameters; [`differentiable_rollout`] has the steps on candle's graph,
//! [`dynamics`] makes them what a gradient runs, [`design`] judges a wall by them, and
//! [`initial_velocity`] finds what a flow began with. Networks compute with
//! fused operators, or with candle-nn's layers ([`network::layers`]), on the same parameters.
//!
//! Time is counted in frames here (dt = 1): a velocity is the displacement from one frame to the next.

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
pub mod training;

pub use models::load::{load_learned, load_predictor, HEATED_CHANNEL, TAYLOR_GREEN};
