//! Design optimisation: from a wall shape to an objective, its gradient, and a better shape.
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
pub mod judge;
pub mod limits;
pub mod objectives;
pub mod optimise;
pub mod optimisers;
pub mod parametrisations;
pub mod problem;
pub mod relief;
pub mod search;
pub mod shape;
pub mod shapes;
pub mod sqp;
pub mod start_shape;
pub mod team;

pub use deformation::Deformation;
pub use judge::{Judge, Scheduled};
pub use optimise::Optimisation;
pub use parametrisations::Parametrisation;
pub use problem::Problem;
pub use search::Search;
