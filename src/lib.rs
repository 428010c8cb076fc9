//! hydrograd: differentiable particle flow on candle tensors.

pub mod adjoint;
pub mod cli;
pub mod design;
pub mod error;
pub mod io;
pub mod neighbours;
pub mod report;
pub mod scene;
pub mod sph;
