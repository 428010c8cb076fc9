//! Differences of positions in a box that is periodic in some directions.

use super::Metadata;

/// The box of a data set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// D.
    pub dimension: usize,
    pub low: [f64; 3],
    pub size: [f64; 3],
    pub periodic: [bool; 3],
}

impl Extent {
    pub fn of(metadata: &Metadata) -> Self {
        Self {
            dimension: metadata.dim,
            low: std::array::from_fn(|d| metadata.bounds.get(d).map_or(0.0, |bounds| bounds[0])),
            size: metadata.size(),
            periodic: metadata.periodic(),
        }
    }

    /// A difference of coordinates in direction `d`: the shortest one of all images.
    pub fn shortest(&self, d: usize, difference: f64) -> f64 {
        match self.periodic[d] {
            true => difference - self.size[d] * (difference / self.size[d]).round(),
            false => difference,
        }
    }

    /// `to - from`, `[N, D]`.
    pub fn displacement(&self, to: &[f64], from: &[f64]) -> Vec<f64> {
        let pairs = to.iter().zip(from).enumerate();
        pairs.map(|(index, (to, from))| self.shortest(index % self.dimension, to - from)).collect()
    }

    /// The image of a coordinate that lies in the box, where it is periodic in direction `d`.
    pub fn wrapped(&self, d: usize, coordinate: f64) -> f64 {
        match self.periodic[d] {
            true => self.low[d] + self.from_corner(d, coordinate),
            false => coordinate,
        }
    }

    /// The same from the box's lower end, where the neighbour search's box begins.
    pub fn from_corner(&self, d: usize, coordinate: f64) -> f64 {
        let from_low = coordinate - self.low[d];
        if !self.periodic[d] {
            return from_low;
        }
        let inside = from_low.rem_euclid(self.size[d]);
        // Just below 0, the remainder rounds to the box's length itself.
        if inside < self.size[d] {
            inside
        } else {
            0.0
        }
    }
}
