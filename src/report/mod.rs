//! What a person sees: tables, progress, memory, plots.

pub mod memory;
pub mod plots;
pub mod progress;
pub mod table;
