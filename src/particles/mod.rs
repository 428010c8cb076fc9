//! Particles, the box they live in, and who is near whom: a cell grid and the padded neighbour list built from it.

pub mod cells;
pub mod neighbour_list;

pub use neighbour_list::NeighbourList;

/// What a particle is. Values as in JAX-SPH's files.
pub mod tag {
    pub const FLUID: u8 = 0;
    pub const WALL: u8 = 1;
    pub const MOVING_WALL: u8 = 2;
    /// A wall particle whose temperature is given.
    pub const HOT_WALL: u8 = 3;
}

/// The box: `dimension` (2 or 3) lengths, periodic or not direction by direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Domain {
    pub dimension: usize,
    pub size: [f64; 3],
    pub periodic: [bool; 3],
}

impl Domain {
    /// 1 / size in periodic directions, 0 in the others: `d - size * round(d * inverse)` is then the
    /// minimum image everywhere.
    pub fn inverse_period(&self) -> [f64; 3] {
        std::array::from_fn(|d| if self.periodic[d] { 1.0 / self.size[d] } else { 0.0 })
    }
}
