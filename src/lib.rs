//! hydrograd: differentiable particle flow on candle tensors.

pub mod adjoint;
pub mod cli;
pub mod config;
pub mod dataset;
pub mod design;
pub mod error;
pub mod io;
pub mod numerics;
pub mod particles;
pub mod report;
pub mod scene;
pub mod sph;
pub mod surrogate;
