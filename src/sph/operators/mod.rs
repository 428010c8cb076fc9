//! Operators of a step: fused sweep, adjoint, and the same composed from candle's operators.
pub mod assemble;
pub mod composed;
pub mod density;
pub mod drift;
pub mod interpolation;
pub mod pairs;
pub mod rates;
pub mod wall_condition;
