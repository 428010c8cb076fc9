//! design
pub mod objective;
