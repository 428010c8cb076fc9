//! Padded neighbour list with a skin.
//!
//! `index` is `[N, K]`: the row of particle i names its neighbours within cut-off + skin at the time of the
//! build, fluid first, then walls, without i itself (a self pair poisons f32 gradients, and its share of the
//! density is a constant). Fluid rows hold every neighbour, wall rows their fluid neighbours only (nothing
//! sums over wall-wall pairs), so the list is symmetric in every pair that is used: j in row i means i in
//! row j. Entries behind `count` name the particle itself; kernels mask them by their position.
//!
//! The list is a pure function of the positions it was built from, so replaying a segment from stored
//! positions gives the same list, the same order of every sum and the same bits.

use crate::lanes::{Real, Shared};
use crate::particles::{tag, Domain};

/// Rows are padded to a multiple of the widest lane count.
const ROW_MULTIPLE: usize = 16;
/// More neighbours than this means that particles have clumped: no flow of this kind has them.
const MOST_NEIGHBOURS: usize = 1024;

#[derive(Debug, Clone, PartialEq)]
pub struct NeighbourList {
    /// N.
    pub particles: usize,
    /// K, grown on demand.
    pub capacity: usize,
    /// `[N, K]`.
    pub index: Vec<u32>,
    /// Neighbours in each row.
    pub count: Vec<u32>,
    /// Of them, how many are fluid (they come first).
    pub fluid_count: Vec<u32>,
    /// Fluid particles: the rows of density and forces.
    pub fluid_rows: Vec<u32>,
    /// Wall particles with a fluid particle in reach: the rows of the wall extrapolation.
    pub wall_rows: Vec<u32>,
}

/// The list could not be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NeighbourError {
    #[error("particle {particle} is at a position that is not a number or far outside the box (component {component}: {value}): the run has diverged; try a smaller time.cfl")]
    LostParticle { particle: usize, component: usize, value: f64 },
    #[error("particle {particle} has {count} neighbours, more than {MOST_NEIGHBOURS}: particles have clumped, the run has diverged; try a smaller time.cfl or a larger fluid.background_pressure_factor")]
    Clumped { particle: usize, count: usize },
    #[error(
        "a particle moved {distance:.3e} (spacing {spacing}) in one step: the run has diverged; try a smaller time.cfl"
    )]
    TooFast { distance: f64, spacing: f64 },
    #[error("the box is {size} long in direction {direction}, shorter than twice the reach {reach} of a particle: use a longer periodic box or a smaller spacing")]
    BoxTooSmall { direction: usize, size: f64, reach: f64 },
}

/// Particles sorted into cells of at least one reach.
struct Grid<R> {
    cells: [usize; 3],
    origin: [f64; 3],
    scale: [f64; 3],
    /// First sorted place of each cell.
    start: Vec<u32>,
    /// Positions `[D][N]` and numbers in cell order.
    position: Vec<Vec<R>>,
    particle: Vec<u32>,
}

impl<R: Real> Grid<R> {
    fn build(position: &[R], n: usize, domain: &Domain, reach: f64) -> Result<Self, NeighbourError> {
        let dimension = domain.dimension;
        let mut origin = [0.0; 3];
        let mut cells = [1; 3];
        let mut scale = [0.0; 3];
        for d in 0..dimension {
            let row = &position[d * n..(d + 1) * n];
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (i, x) in row.iter().enumerate() {
                let x = x.f64();
                // Ten box lengths: a particle there is lost, and a grid around it would not fit into memory.
                if x.is_nan() || x.abs() > 10.0 * domain.size[d] {
                    return Err(NeighbourError::LostParticle { particle: i, component: d, value: x });
                }
                low = low.min(x);
                high = high.max(x);
            }
            let extent = if domain.periodic[d] {
                if domain.size[d] < 2.0 * reach {
                    return Err(NeighbourError::BoxTooSmall { direction: d, size: domain.size[d], reach });
                }
                domain.size[d]
            } else {
                origin[d] = low;
                (high - low).max(reach)
            };
            // 1e-9: a particle exactly on the upper edge of an extent that is a multiple of the reach.
            cells[d] = ((extent / reach * (1.0 - 1e-9)) as usize).max(1);
            scale[d] = cells[d] as f64 / extent;
        }
        let mut grid = Self {
            cells,
            origin,
            scale,
            start: vec![0; cells.iter().product::<usize>() + 1],
            position: vec![vec![R::default(); n]; dimension],
            particle: vec![0; n],
        };
        let cell_of: Vec<u32> = (0..n).map(|i| grid.cell_of(position, n, dimension, i) as u32).collect();
        for &c in &cell_of {
            grid.start[c as usize + 1] += 1;
        }
        for c in 1..grid.start.len() {
            grid.start[c] += grid.start[c - 1];
        }
        let mut next = grid.start.clone();
        for (i, &c) in cell_of.iter().enumerate() {
            let place = next[c as usize] as usize;
            next[c as usize] += 1;
            grid.particle[place] = i as u32;
            for d in 0..dimension {
                grid.position[d][place] = position[d * n + i];
            }
        }
        Ok(grid)
    }

    fn coordinate(&self, value: f64, d: usize) -> usize {
        (((value - self.origin[d]) * self.scale[d]).max(0.0) as usize).min(self.cells[d] - 1)
    }

    fn cell_of(&self, position: &[R], n: usize, dimension: usize, i: usize) -> usize {
        let mut cell = 0;
        for d in (0..dimension).rev() {
            cell = cell * self.cells[d] + self.coordinate(position[d * n + i].f64(), d);
        }
        cell
    }

    /// The cells around `at` in direction d, each once.
    fn around(&self, at: usize, d: usize, periodic: bool) -> ([usize; 3], usize) {
        let cells = self.cells[d] as isize;
        let mut list = [0; 3];
        let mut count = 0;
        for offset in [-1, 0, 1] {
            let raw = at as isize + offset;
            let cell = raw.rem_euclid(cells) as usize;
            // With one or two cells the same cell is reached twice: it must be listed once.
            if (periodic || cell as isize == raw) && !list[..count].contains(&cell) {
                list[count] = cell;
                count += 1;
            }
        }
        (list, count)
    }
}

impl NeighbourList {
    /// Builds the list of all pairs closer than `reach` (cut-off + skin).
    ///
    /// `position` is `[D, N]`; `capacity_hint` saves a second pass when the capacity is already known.
    pub fn build<R: Real>(
        position: &[R],
        tags: &[u8],
        domain: &Domain,
        reach: f64,
        capacity_hint: usize,
    ) -> Result<Self, NeighbourError> {
        let n = tags.len();
        let grid = Grid::build(position, n, domain, reach)?;
        let mut list = Self {
            particles: n,
            capacity: capacity_hint.max(ROW_MULTIPLE).next_multiple_of(ROW_MULTIPLE),
            index: Vec::new(),
            count: vec![0; n],
            fluid_count: vec![0; n],
            fluid_rows: (0..n as u32).filter(|&i| tags[i as usize] == tag::FLUID).collect(),
            wall_rows: Vec::new(),
        };
        loop {
            list.fill(&grid, position, tags, domain, reach);
            let (particle, &most) = list.count.iter().enumerate().max_by_key(|(_, c)| **c).unwrap_or((0, &0));
            let most = most as usize;
            if most > MOST_NEIGHBOURS {
                return Err(NeighbourError::Clumped { particle, count: most });
            }
            if most <= list.capacity {
                break;
            }
            // Grown with some room, so that the next builds fit at once.
            list.capacity = (most + 4).next_multiple_of(ROW_MULTIPLE);
        }
        list.wall_rows =
            (0..n as u32).filter(|&i| tags[i as usize] != tag::FLUID && list.count[i as usize] > 0).collect();
        Ok(list)
    }

    fn fill<R: Real>(&mut self, grid: &Grid<R>, position: &[R], tags: &[u8], domain: &Domain, reach: f64) {
        let (n, capacity, dimension) = (self.particles, self.capacity, domain.dimension);
        self.index.clear();
        self.index.resize(n * capacity, 0);
        let index = Shared::new(&mut self.index);
        let count = Shared::new(&mut self.count);
        let fluid_count = Shared::new(&mut self.fluid_count);
        let wall_of: Vec<bool> = grid.particle.iter().map(|&j| tags[j as usize] != tag::FLUID).collect();
        let size = domain.size.map(R::of);
        let inverse = domain.inverse_period().map(R::of);
        let reach2 = R::of(reach * reach);
        let half = R::of(0.5);
        candle_core::utils::barrier_pool().execute_chunked(n, |rows| {
            let mut fluid: Vec<u32> = Vec::new();
            let mut wall: Vec<u32> = Vec::new();
            for i in rows {
                let own_wall = tags[i] != tag::FLUID;
                let here: [R; 3] =
                    std::array::from_fn(|d| if d < dimension { position[d * n + i] } else { R::default() });
                let mut ranges = [(0usize, 0usize); 27];
                let mut range_count = 0;
                let around: [([usize; 3], usize); 3] = std::array::from_fn(|d| {
                    if d < dimension {
                        grid.around(grid.coordinate(here[d].f64(), d), d, domain.periodic[d])
                    } else {
                        ([0; 3], 1)
                    }
                });
                for &cz in &around[2].0[..around[2].1] {
                    for &cy in &around[1].0[..around[1].1] {
                        for &cx in &around[0].0[..around[0].1] {
                            let c = (cz * grid.cells[1] + cy) * grid.cells[0] + cx;
                            ranges[range_count] = (grid.start[c] as usize, grid.start[c + 1] as usize);
                            range_count += 1;
                        }
                    }
                }
                let candidates: usize = ranges[..range_count].iter().map(|(a, b)| b - a).sum();
                fluid.resize(candidates + 1, 0);
                wall.resize(candidates + 1, 0);
                let (mut fluids, mut walls) = (0, 0);
                for &(from, to) in &ranges[..range_count] {
                    for place in from..to {
                        let mut r2 = R::default();
                        for d in 0..dimension {
                            let mut dr = here[d] - grid.position[d][place];
                            dr -= size[d] * (dr * inverse[d] + half).floor();
                            r2 += dr * dr;
                        }
                        let j = grid.particle[place];
                        let near = r2 < reach2 && j as usize != i;
                        // Without branches: written always, kept by moving on.
                        fluid[fluids] = j;
                        wall[walls] = j;
                        fluids += (near && !wall_of[place]) as usize;
                        walls += (near && wall_of[place] && !own_wall) as usize;
                    }
                }
                let total = fluids + walls;
                // SAFETY: row i and its counts belong to this iteration alone.
                unsafe {
                    count.set(i, total as u32);
                    fluid_count.set(i, fluids as u32);
                    if total <= capacity {
                        let row = index.slice(i * capacity..(i + 1) * capacity);
                        row[..fluids].copy_from_slice(&fluid[..fluids]);
                        row[fluids..total].copy_from_slice(&wall[..walls]);
                        row[total..].fill(i as u32);
                    }
                }
            }
        });
    }

    /// The padded row of particle i.
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[u32] {
        &self.index[i * self.capacity..(i + 1) * self.capacity]
    }

    /// Directed pairs in the list.
    pub fn pairs(&self) -> usize {
        self.count.iter().map(|&c| c as usize).sum()
    }

    pub fn bytes(&self) -> usize {
        4 * (self.index.len() + 2 * self.particles + self.fluid_rows.len() + self.wall_rows.len())
    }
}
