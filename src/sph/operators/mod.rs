//! Operators of a step: fused sweep, adjoint, and the same composed from candle's operators.
pub mod assemble;
pub mod composed;
pub mod density;
pub mod drift;
pub mod evolution;
pub mod interpolation;
pub mod pairs;
pub mod rates;
pub mod renormalisation;
pub mod wall_condition;
pub mod whole_step;
