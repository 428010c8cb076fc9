//! design
pub mod objective;
pub mod parametrisation;
