//! The standard method: density by summation or continuity, pair forces and a background pressure.
//!
//! Each pair law is a file of [`crate::sph::laws`], each operator of a step one here:
//!
//! ```text
//! state --drift--> moved --density--> rho --wall condition--> primitives --rates--> rates
//!                    |                                          |                     |
//!                    +--------------------------- assemble ----+---------------------+--> state
//! ```
//!
//! The density is summed ([`density`]) or evolves ([`evolution`]); between drift and density the neighbour list is made valid
//! for the moved state. The order is that of JAX-SPH, so that states agree to rounding. A step is executed on reused buffers
//! (`worker`), as a fused node on candle's graph ([`whole_step`]), or composed of candle's own operators (`tape`).

pub mod assemble;
pub mod chain;
mod compiled;
pub mod density;
mod density_gradient;
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
pub mod sweeps;
mod tape;
pub mod wall_condition;
pub mod wall_heat;
pub mod whole_step;
mod worker;

pub use layout::Layout;
pub use model::{Laws, Standard};
pub use sweeps::Sweeps;
