//! What a person sees: tables, progress, memory, plots, pages.

pub mod memory;
pub mod page;
pub mod plots;
pub mod progress;
pub mod table;
pub mod text;

/// The version that files and documents name as their writer.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
