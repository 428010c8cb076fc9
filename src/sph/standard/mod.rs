//! The standard method: density by summation or continuity, pair forces and a background pressure.
//!
//! Each pair law is a file of [`crate::sph::laws`]; [`step`] has the order of the operators.
pub mod assemble;
pub mod chain;
mod compiled;
pub mod density;
pub mod drift;
pub mod evolution;
pub mod layout;
mod method;
pub mod model;
pub mod pair_cache;
mod plan;
pub mod rates;
pub mod records;
pub mod renormalisation;
pub mod step;
pub mod sweeps;
mod tape;
pub mod wall_condition;
pub mod wall_heat;
pub mod whole_step;
mod worker;

pub use layout::Layout;
pub use model::{Laws, Standard};
pub use sweeps::Sweeps;
