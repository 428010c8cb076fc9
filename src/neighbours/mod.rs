//! Who is near whom: a cell grid and the padded neighbour list built from it.
pub mod cells;
pub mod list;
pub use list::NeighbourList;
