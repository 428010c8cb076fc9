//! Particles, the box they live in, and who is near whom: a cell grid and the padded neighbour list built from it.

pub mod cells;
pub mod decomposition;
pub mod domain;
mod error;
pub mod neighbour_list;
pub mod neighbourhood;
pub mod placer;
pub mod reach;

pub use domain::Domain;
pub use neighbour_list::NeighbourList;
pub use neighbourhood::Neighbourhood;
pub use reach::Reach;

/// What a particle is. Values as in JAX-SPH's files.
pub mod tag {
    pub const FLUID: u8 = 0;
    pub const WALL: u8 = 1;
    pub const MOVING_WALL: u8 = 2;
    /// A wall particle whose temperature is given.
    pub const HOT_WALL: u8 = 3;
    /// A point on a wall's surface.
    pub const SURFACE: u8 = 4;
    /// One whose temperature is given.
    pub const HOT_SURFACE: u8 = 5;

    /// What a particle is, in words.
    pub fn name(tag: u8) -> &'static str {
        match tag {
            FLUID => "fluid",
            MOVING_WALL => "moving wall",
            HOT_WALL => "wall of set temperature",
            SURFACE | HOT_SURFACE => "point on a wall's surface",
            _ => "wall",
        }
    }

    /// Whether it is a point on a wall's surface: no particle that data sets have.
    pub fn is_on_surface(tag: u8) -> bool {
        matches!(tag, SURFACE | HOT_SURFACE)
    }
}
