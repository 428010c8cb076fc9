//! From a wall shape to a number, its gradient, and a better shape.
//!
//! ```text
//!   variables --parametrisation--> heights of columns --deformation--> initial state --dynamics--> objective
//!       ^                                                                                             |
//!   optimiser <------- pull back <---------- pull back <-------------------- gradient ----------------+
//! ```
pub mod checkpoint;
pub mod cma_es;
pub mod deformation;
pub mod diagnostics;
pub mod limits;
pub mod objectives;
pub mod optimise;
pub mod optimisers;
pub mod parametrisations;
pub mod problem;
pub mod relief;
pub mod shape;
pub mod shapes;
pub mod start_shape;

pub use deformation::Deformation;
pub use optimise::Optimisation;
pub use parametrisations::Parametrisation;
pub use problem::Problem;
