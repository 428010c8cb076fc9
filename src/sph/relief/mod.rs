//! Fixed particles in a channel in three dimensions whose lower wall is a relief over x and z: the steady flow by Newton's method.
//!
//! Particles are on a cubic lattice (x, eta, z), 0 <= eta <= H, whose columns follow the wall's height s(x, z):
//!
//! ```text
//!   y = eta + s(x, z) (1 - eta/H).
//! ```
//!
//! Columns stay in order for any s < H, so that this map cannot fold, and wall and fluid depend on s at their own column alone. The
//! equations are those around bodies ([`super::cloud::space`]): fits of second order at the mapped places, incompressible. What heat
//! passes through the walls is by fits of third order, and points of the wall beside an end of the hot section are hot in part, so that
//! the end acts where it is ([`lattice`]). The flow is periodic along x and z; heat enters at x = 0 with the inlet's temperature.
//!
//! A step goes from any state to the steady one, whatever its length in time: a run is one step, and its adjoint one transposed
//! system. So all that runs, optimises and checks channels does so with these particles too.
pub mod lattice;
mod method;
mod operator;

pub use lattice::{Channel, OverRelief};
pub use method::ReliefParticles;
