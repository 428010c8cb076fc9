//! hydrograd: differentiable particle flow on candle tensors.

pub mod adjoint;
pub mod blocks;
pub mod cli;
pub mod dataset;
pub mod design;
pub mod error;
pub mod io;
pub mod kernel;
pub mod lanes;
pub mod neighbours;
pub mod particles;
pub mod random;
pub mod report;
pub mod scene;
pub mod solver;
pub mod sph;
pub mod surrogate;
