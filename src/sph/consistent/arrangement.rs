//! The settings that keep particles evenly spread. [`super::shift`] computes the shift itself.

use std::collections::BTreeMap;

#[derive(Debug, Clone, PartialEq)]
pub enum Shift {
    None,
    Chain(Chain),
    Isotropic(Isotropic),
}

impl Shift {
    pub fn is_isotropic(&self) -> bool {
        matches!(self, Self::Isotropic(_))
    }

    /// That of some particles; `known` is the new number of each. The first and the last of a row's part have no right neighbours.
    pub fn of(&self, particles: usize, known: &dyn Fn(&u32) -> Option<u32>) -> Self {
        match self {
            Self::None => Self::None,
            Self::Chain(chain) => {
                let rows = chain.rows.iter().map(|row| row.iter().filter_map(known).collect()).collect();
                Self::Chain(Chain::new(chain.strength, chain.is_still, rows, particles))
            }
            Self::Isotropic(isotropic) => {
                let normals = isotropic.normals.iter().filter_map(|(i, normal)| Some((known(i)?, *normal)));
                Self::Isotropic(Isotropic { normals: normals.collect(), ..*isotropic })
            }
        }
    }
}

/// Rows of particles between the walls. The first row is the surface of the lower wall, the last that of the upper one.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// Strength k.
    pub strength: f64,
    /// Whether the rows stay in place (`method.shift = "rows"`).
    pub is_still: bool,
    /// Indices of the particles of each row, sorted by x.
    pub rows: Vec<Vec<u32>>,
    /// Row of each particle and its place in that row, `[N]`; (0, 0) for particles in no row.
    pub seat: Vec<(u32, u32)>,
}

impl Chain {
    pub fn new(strength: f64, is_still: bool, rows: Vec<Vec<u32>>, particles: usize) -> Self {
        let mut seat = vec![(0, 0); particles];
        for (r, row) in rows.iter().enumerate() {
            for (c, &i) in row.iter().enumerate() {
                seat[i as usize] = (r as u32, c as u32);
            }
        }
        Self { strength, is_still, rows, seat }
    }

    /// The row of a particle, and its predecessor and successor in that row.
    #[inline(always)]
    pub fn beside(&self, i: usize) -> (usize, u32, u32) {
        let (r, c) = (self.seat[i].0 as usize, self.seat[i].1 as usize);
        let own = &self.rows[r];
        (r, own[(c + own.len() - 1) % own.len()], own[(c + 1) % own.len()])
    }
}

/// A shift away from regions with many particles.
#[derive(Debug, Clone, PartialEq)]
pub struct Isotropic {
    /// Strength k.
    pub strength: f64,
    /// Largest shift velocity over the reference velocity: |w| <= limit U.
    pub limit: f64,
    /// Inward unit normals of the points on the wall's surface, by particle index.
    pub normals: BTreeMap<u32, [f64; 3]>,
}
