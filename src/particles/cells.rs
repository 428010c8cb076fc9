//! Particles sorted into cells of at least one reach, so that neighbours stand in a few runs of contiguous places.

use crate::numerics::lanes::{array, Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::particles::error::NeighbourError;
use crate::particles::reach::Bounds;
use crate::particles::Domain;
use std::ops::Range;

/// Rows are padded to a multiple of the widest lane count.
pub const ROW_MULTIPLE: usize = 16;

/// The cells of a box, and how they hang together over its periodic edges.
#[derive(Debug, Clone)]
pub struct Geometry {
    pub dimension: usize,
    pub reach: f64,
    pub size: [f64; 3],
    /// Directions so short that a cell is its own neighbour's neighbour: there only the nearest image tells the distance.
    pub narrow: [bool; 3],
    periodic: [bool; 3],
    cells: [usize; 3],
    origin: [f64; 3],
    scale: [f64; 3],
}

/// Neighbouring cells that follow each other along x, and what to add to (here - there) across a periodic edge.
#[derive(Debug, Clone, Copy, Default)]
pub struct Run {
    pub first: usize,
    pub last: usize,
    pub shift: [f64; 3],
}

/// The runs around a cell: at most 2 along x for each of 3 x 3 rows.
#[derive(Debug, Clone, Copy, Default)]
pub struct Runs {
    pub list: [Run; 18],
    pub count: usize,
}

impl Geometry {
    /// Errors: a particle that is lost, a box too small.
    pub fn new<R: Real>(
        position: &[R],
        n: usize,
        domain: &Domain,
        (reach, within): (f64, Option<Bounds>),
    ) -> Result<Self, NeighbourError> {
        let mut geometry = Self {
            dimension: domain.dimension,
            reach,
            size: domain.size,
            narrow: [false; 3],
            // What is said of a direction that the scene does not have must not wrap its one layer of cells around.
            periodic: array(|d| d < domain.dimension && domain.periodic[d]),
            cells: [1; 3],
            origin: [0.0; 3],
            scale: [0.0; 3],
        };
        for d in 0..domain.dimension {
            let row = &position[d * n..(d + 1) * n];
            // Ten box lengths: a particle there is lost, and a grid around it would not fit into memory.
            let limit = R::of(10.0 * domain.size[d]);
            let (mut low, mut high, mut sane) = (limit, -limit, true);
            for &x in row {
                sane &= x <= limit && -x <= limit;
                low = if x < low { x } else { low };
                high = if x > high { x } else { high };
            }
            if !sane {
                let lost = |x: &R| !(*x <= limit && -*x <= limit);
                let particle = row.iter().position(lost).unwrap_or(0);
                return Err(NeighbourError::LostParticle { particle, component: d, value: row[particle].f64() });
            }
            let extent = if domain.periodic[d] {
                if domain.size[d] < 2.0 * reach {
                    return Err(NeighbourError::BoxTooSmall { direction: d, size: domain.size[d], reach });
                }
                domain.size[d]
            } else {
                // What lies without goes into the cells at the edges.
                let [low, high] = within.map_or([low.f64(), high.f64()], |within| within[d]);
                geometry.origin[d] = low;
                (high - low).max(reach)
            };
            // 1e-9: a particle exactly on the upper edge of an extent that is a multiple of the reach.
            geometry.cells[d] = ((extent / reach * (1.0 - 1e-9)) as usize).max(1);
            geometry.scale[d] = geometry.cells[d] as f64 / extent;
            geometry.narrow[d] = domain.periodic[d] && geometry.cells[d] < 3;
        }
        Ok(geometry)
    }

    fn count(&self) -> usize {
        self.cells.iter().product()
    }

    /// The neighbouring cells of `at` in direction d: first, last, shift, without wrapping runs together.
    fn around(&self, at: usize, d: usize) -> impl Iterator<Item = (usize, usize, f64)> {
        let (cells, size) = (self.cells[d], self.size[d]);
        let near = match self.narrow[d] {
            true => (0, cells - 1, 0.0),
            false => (at.saturating_sub(1), (at + 1).min(cells - 1), 0.0),
        };
        let wraps = self.periodic[d] && !self.narrow[d];
        let below = (wraps && at == 0).then_some((cells - 1, cells - 1, size));
        let above = (wraps && at + 1 == cells).then_some((0, 0, -size));
        [Some(near), below, above].into_iter().flatten()
    }

    /// The runs of cells around a cell.
    pub fn runs(&self, cell: usize) -> Runs {
        let at = [cell % self.cells[0], cell / self.cells[0] % self.cells[1], cell / self.cells[0] / self.cells[1]];
        let each = |(first, last, shift): (usize, usize, f64)| (first..=last).map(move |cell| (cell, shift));
        let mut runs = Runs::default();
        for (cz, z_shift) in self.around(at[2], 2).flat_map(each) {
            for (cy, y_shift) in self.around(at[1], 1).flat_map(each) {
                let row = (cz * self.cells[1] + cy) * self.cells[0];
                for (first, last, x_shift) in self.around(at[0], 0) {
                    let shift = [x_shift, y_shift, z_shift];
                    runs.list[runs.count] = Run { first: row + first, last: row + last, shift };
                    runs.count += 1;
                }
            }
        }
        runs
    }
}

/// Some of the particles, sorted by cell and within a cell by number.
#[derive(Debug, Clone, Default)]
pub struct Cells<R> {
    /// Their numbers, in the order they were given.
    pub members: Vec<u32>,
    /// Cell of each member.
    cell: Vec<u32>,
    /// First place of each cell, and the end of the last.
    start: Vec<u32>,
    next: Vec<u32>,
    /// By place: cell, number, and positions `[D][places]`. The last two are padded by the widest lane count.
    pub cell_of_place: Vec<u32>,
    pub number: Vec<u32>,
    pub position: [Vec<R>; 3],
}

/// The cell of each member.
struct CellOf<'a, R> {
    geometry: &'a Geometry,
    position: &'a [R],
    n: usize,
    members: &'a [u32],
    cell: Shared<'a, u32>,
}

impl<R: Real> RowKernel<R> for CellOf<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let geometry = self.geometry;
        for k in rows {
            let i = self.members[k] as usize;
            let mut cell = 0;
            for d in (0..geometry.dimension).rev() {
                let x = (self.position[d * self.n + i].f64() - geometry.origin[d]) * geometry.scale[d];
                let last = geometry.cells[d] as i32 - 1;
                cell = cell * geometry.cells[d] as u32 + (x as i32).clamp(0, last) as u32;
            }
            // SAFETY: each row writes its own place.
            unsafe { self.cell.set(k, cell) };
        }
    }
}

impl<R: Real> Cells<R> {
    /// Sorts these particles.
    pub fn fill(&mut self, geometry: &Geometry, position: &[R], n: usize, members: &[u32]) {
        self.members.clear();
        self.members.extend_from_slice(members);
        self.refill(geometry, position, n);
    }

    /// Sorts the same particles at new positions.
    pub fn refill(&mut self, geometry: &Geometry, position: &[R], n: usize) {
        let count = self.members.len();
        self.cell.resize(count, 0);
        let cell = Shared::new(&mut self.cell);
        run_rows(&CellOf { geometry, position, n, members: &self.members, cell }, count);
        self.start.clear();
        self.start.resize(geometry.count() + 1, 0);
        for &c in &self.cell {
            self.start[c as usize + 1] += 1;
        }
        for c in 1..self.start.len() {
            self.start[c] += self.start[c - 1];
        }
        self.next.clear();
        self.next.extend_from_slice(&self.start);
        self.cell_of_place.resize(count, 0);
        self.number.resize(count + ROW_MULTIPLE, 0);
        for d in 0..geometry.dimension {
            self.position[d].resize(count + ROW_MULTIPLE, R::default());
        }
        for (&i, &c) in self.members.iter().zip(&self.cell) {
            let place = self.next[c as usize] as usize;
            self.next[c as usize] += 1;
            self.number[place] = i;
            self.cell_of_place[place] = c;
            for d in 0..geometry.dimension {
                self.position[d][place] = position[d * n + i as usize];
            }
        }
    }

    /// Places of the cells `first..=last` of a row of cells.
    #[inline(always)]
    pub fn places(&self, first: usize, last: usize) -> (usize, usize) {
        (self.start[first] as usize, self.start[last + 1] as usize)
    }
}
