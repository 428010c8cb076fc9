//! From a wall shape to a number, its gradient, and a better shape.
pub mod adam;
pub mod diagnostics;
pub mod objectives;
pub mod optimise;
pub mod parametrisation;
pub mod shape;
pub mod space;
