//! Particles on a lattice in a box, with plane walls at its ends.

use crate::numerics::random::{stream, Normal};
use crate::particles::Domain;

/// A lattice of particles in a box, x fastest, with walls of dummy particles at its ends.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    pub dimension: usize,
    pub spacing: f64,
    /// Number of particles along each direction, including walls.
    pub cells: [usize; 3],
    /// Number of rows of dummy particles at both ends of each direction.
    pub wall_rows: [usize; 3],
    pub periodic: [bool; 3],
    /// The size of the box, if it is not cells times the spacing to the bit.
    pub size: Option<[f64; 3]>,
    /// Indices of the cells that have a particle, if not all have one.
    pub occupied: Option<Vec<usize>>,
    /// Coordinate of a row's first particle: (row + 1/2 - before) spacing + corner.
    pub before: [f64; 3],
    pub corner: [f64; 3],
}

impl Lattice {
    /// A lattice without walls, periodic in all directions, with its corner at 0.
    pub fn new(dimension: usize, spacing: f64, cells: [usize; 3]) -> Self {
        let (wall_rows, periodic, before, corner) = ([0; 3], [true; 3], [0.0; 3], [0.0; 3]);
        Self { dimension, spacing, cells, wall_rows, periodic, size: None, occupied: None, before, corner }
    }

    /// A lattice with cells `inside` between walls of some rows, with the inside's corner at 0.
    pub fn between(
        wall_rows: [usize; 3],
        dimension: usize,
        spacing: f64,
        inside: [usize; 3],
        periodic: [bool; 3],
    ) -> Self {
        let cells = std::array::from_fn(|d| inside[d] + 2 * wall_rows[d]);
        let corner = wall_rows.map(|rows| 0.0 - rows as f64 * spacing);
        Self { wall_rows, periodic, corner, ..Self::new(dimension, spacing, cells) }
    }

    /// A plane channel of height 1, periodic in x, with the surface of the lower wall at y = 0.
    pub fn channel(columns: usize, rows: usize, walls: usize) -> Self {
        Self {
            wall_rows: [0, walls, 0],
            periodic: [true, false, false],
            corner: [0.0, -(walls as f64) / rows as f64, 0.0],
            ..Self::new(2, 1.0 / rows as f64, [columns, rows + 2 * walls, 1])
        }
    }

    pub fn particles(&self) -> usize {
        let cells = || self.cells[..self.dimension].iter().product();
        self.occupied.as_ref().map_or_else(cells, Vec::len)
    }

    /// Keeps wall particles, and the fluid particles in a block of cells that are counted without walls.
    pub fn with_block(mut self, first: [usize; 3], behind: [usize; 3]) -> Self {
        let is_in = |rows: [usize; 3]| {
            (0..self.dimension).all(|d| (first[d]..behind[d]).contains(&rows[d].wrapping_sub(self.wall_rows[d])))
        };
        let occupied = (0..self.particles()).filter(|&i| self.is_wall(i) || is_in(self.rows(i))).collect();
        self.occupied = Some(occupied);
        self
    }

    /// Unit normals of wall particles into the fluid, `[D, N]`, 0 for fluid: from a particle to the nearest point of
    /// the box between the walls. Those of a `lid` are normal to its plane, wherever its particles have moved.
    pub fn normals(&self, lid: bool) -> Vec<f64> {
        let (n, half) = (self.particles(), 0.5);
        let mut normals = vec![0.0; self.dimension * n];
        for i in (0..n).filter(|&i| self.is_wall(i)) {
            let rows = self.rows(i);
            let mut normal: [f64; 3] = std::array::from_fn(|d| {
                if d >= self.dimension || self.wall_rows[d] == 0 {
                    return 0.0;
                }
                let (low, high) = (self.wall_rows[d] as f64, (self.cells[d] - self.wall_rows[d]) as f64);
                let at = rows[d] as f64 + half;
                at.clamp(low, high) - at
            });
            if lid && self.is_above(i, 1) {
                normal = [0.0, -1.0, 0.0];
            }
            let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
            (0..self.dimension).for_each(|d| normals[d * n + i] = normal[d] / length);
        }
        normals
    }

    /// Row of a particle along each direction.
    pub fn rows(&self, i: usize) -> [usize; 3] {
        let cells = self.cells;
        let i = self.occupied.as_ref().map_or(i, |occupied| occupied[i]);
        [i % cells[0], i / cells[0] % cells[1], i / (cells[0] * cells[1])]
    }

    /// Whether a particle is in the wall at the lower or at the upper end of direction `d`.
    pub fn is_below(&self, i: usize, d: usize) -> bool {
        self.rows(i)[d] < self.wall_rows[d]
    }
    pub fn is_above(&self, i: usize, d: usize) -> bool {
        self.rows(i)[d] + self.wall_rows[d] >= self.cells[d]
    }

    pub fn is_wall(&self, i: usize) -> bool {
        (0..self.dimension).any(|d| self.is_below(i, d) || self.is_above(i, d))
    }

    /// Position of a particle of the lattice.
    pub fn place(&self, i: usize) -> [f64; 3] {
        let rows = self.rows(i);
        let place = |d: usize| (rows[d] as f64 + 0.5 - self.before[d]) * self.spacing + self.corner[d];
        std::array::from_fn(|d| if d < self.dimension { place(d) } else { 0.0 })
    }

    /// The box; its size is 1 in directions beyond the dimension.
    pub fn domain(&self) -> Domain {
        let dimension = self.dimension;
        let of_cells =
            || std::array::from_fn(|d| if d < dimension { self.cells[d] as f64 * self.spacing } else { 1.0 });
        let periodic = std::array::from_fn(|d| d < dimension && self.periodic[d]);
        Domain { dimension, size: self.size.unwrap_or_else(of_cells), periodic }
    }

    /// Positions `[D, N]`; those of fluid particles are random with a standard deviation of `jitter` spacings.
    pub fn positions(&self, domain: &Domain, jitter: f64, seed: u64) -> Vec<f64> {
        let n = self.particles();
        let mut positions = vec![0.0; self.dimension * n];
        let mut normal = Normal::new(stream(seed, "jitter"));
        for i in 0..n {
            let place = self.place(i);
            for d in 0..self.dimension {
                let mut x = place[d];
                if !self.is_wall(i) {
                    x += jitter * self.spacing * normal.next();
                }
                positions[d * n + i] = if domain.periodic[d] { x.rem_euclid(domain.size[d]) } else { x };
            }
        }
        positions
    }
}

/// The thermal condition of a plane wall: a temperature (relative to the reference) where from < x < to, adiabatic
/// elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WallHeat {
    pub temperature: f64,
    pub from: f64,
    pub to: f64,
}

impl WallHeat {
    pub const ADIABATIC: Self = Self { temperature: 0.0, from: 0.0, to: 0.0 };

    pub fn isothermal(temperature: f64) -> Self {
        Self { temperature, from: f64::NEG_INFINITY, to: f64::INFINITY }
    }

    /// The temperature of the wall at x, where it is not adiabatic.
    pub fn at(&self, x: f64) -> Option<f64> {
        (x > self.from && x < self.to).then_some(self.temperature)
    }
}
