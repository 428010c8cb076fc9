//! Gradients of long runs in bounded memory.
pub mod check;
pub mod schedule;
pub mod segments;
