//! The box of a data set: the nearest images of [`Domain`], with a lower corner that need not be 0.

use super::Metadata;
use crate::particles::Domain;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    pub domain: Domain,
    pub low: [f64; 3],
}

impl Extent {
    pub fn of(metadata: &Metadata) -> Self {
        let low = std::array::from_fn(|d| metadata.bounds.get(d).map_or(0.0, |bounds| bounds[0]));
        Self { domain: metadata.domain(), low }
    }

    pub fn dimension(&self) -> usize {
        self.domain.dimension
    }

    /// A difference of coordinates in direction `d` to the nearest image.
    pub fn shortest(&self, d: usize, difference: f64) -> f64 {
        self.domain.nearest(d, difference)
    }

    /// `to - from`, `[N, D]`.
    pub fn displacement(&self, to: &[f64], from: &[f64]) -> Vec<f64> {
        let pairs = to.iter().zip(from).enumerate();
        pairs.map(|(index, (to, from))| self.shortest(index % self.dimension(), to - from)).collect()
    }

    /// The image of a coordinate inside the box, if direction `d` is periodic.
    pub fn wrapped(&self, d: usize, coordinate: f64) -> f64 {
        match self.domain.periodic[d] {
            true => self.low[d] + self.from_corner(d, coordinate),
            false => coordinate,
        }
    }

    /// The wrapped coordinate relative to the lower end of the box, as the neighbour search needs it.
    pub fn from_corner(&self, d: usize, coordinate: f64) -> f64 {
        self.domain.wrapped(d, coordinate - self.low[d])
    }
}
