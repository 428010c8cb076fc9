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

use crate::numerics::gather::{sums_by_place, Gather};
use crate::numerics::lanes::{array, lanes_of_rows, Lanes, Real};
use crate::numerics::pool::fit;
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::particles::cells::{Cells, Geometry, Runs, ROW_MULTIPLE};
use crate::particles::error::MOST_NEIGHBOURS;
use crate::particles::reach::Bounds;
use crate::particles::{tag, Domain};
use candle_core::{DType, Device, Tensor};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::thread::ThreadId;

pub use crate::particles::error::NeighbourError;

#[derive(Debug, Clone, PartialEq, Default)]
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
    /// Whether a fluid particle has a row, `[N]`; empty where all have.
    pub own: Vec<bool>,
    /// Those that other ranks have copies of, ascending.
    pub lent: Vec<u32>,
    /// Fluid particles with a row, the rows of density and forces: first the lent ones, then those of which none has a copy as neighbour.
    pub fluid_rows: Vec<u32>,
    /// How many of them are lent.
    pub lent_rows: usize,
    /// Fluid particles without a row: copies of what other ranks have.
    pub fluid_copies: Vec<u32>,
    /// Wall particles with a fluid particle in reach: the rows of the wall extrapolation.
    pub wall_rows: Vec<u32>,
    /// Bounds of the whole flow, if the particles are a part of it: cells begin there on every rank, so all find neighbours in the same order.
    pub within: Option<Bounds>,
    /// What [`Self::tensors`] has made.
    pub made: Made,
}

/// The last tensors that were made of a list, where they are worth keeping. Each list has its own.
#[derive(Debug, Default)]
pub struct Made(Mutex<Option<OnDevice>>);

/// Candle's CUDA backend has a stream for each thread, and nothing waits from one to another: tensors stay with theirs.
#[derive(Debug)]
struct OnDevice {
    index: Gather,
    mask: Tensor,
    thread: ThreadId,
}

impl Clone for Made {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl PartialEq for Made {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// What building a list needs besides the list; kept between builds so that none of it is allocated anew.
#[derive(Debug, Clone, Default)]
pub struct Workspace<R> {
    /// Fluid, and walls if there are any, each sorted into the same cells.
    fluid: Cells<R>,
    wall: Cells<R>,
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
        let mut list = Self { capacity: capacity_hint, ..Self::default() };
        list.rebuild(position, tags, domain, reach, &mut Workspace::default())?;
        Ok(list)
    }

    /// Forgets all but the memory and the capacity: the next build may be of other particles.
    pub fn forget(&mut self) {
        self.particles = 0;
        self.own.clear();
        let Self { index, count, fluid_count, lent, fluid_rows, fluid_copies, wall_rows, .. } = self;
        [index, count, fluid_count, lent, fluid_rows, fluid_copies, wall_rows].into_iter().for_each(Vec::clear);
    }

    /// [`Self::build`] in place: `tags` must be those of the first build, or of the first after [`Self::forget`].
    pub fn rebuild<R: Real>(
        &mut self,
        position: &[R],
        tags: &[u8],
        domain: &Domain,
        reach: f64,
        workspace: &mut Workspace<R>,
    ) -> Result<(), NeighbourError> {
        self.made = Made::default();
        let n = tags.len();
        let walls = |&i: &u32| tags[i as usize] != tag::FLUID;
        let is_first = self.particles != n || self.count.len() != n;
        if is_first {
            self.particles = n;
            self.count = vec![0; n];
            self.fluid_count = vec![0; n];
            let has_row = |&i: &u32| self.own.is_empty() || self.own[i as usize];
            (self.fluid_rows, self.fluid_copies) = (0..n as u32).filter(|i| !walls(i)).partition(has_row);
            let is_lent = |i: &u32| self.lent.binary_search(i).is_ok();
            let (lent, others): (Vec<u32>, Vec<u32>) = self.fluid_rows.iter().partition(|i| is_lent(i));
            (self.lent_rows, self.fluid_rows) = (lent.len(), [lent, others].concat());
        }
        let geometry = Geometry::new(position, n, domain, (reach, self.within))?;
        if self.fluid_copies.is_empty() && self.lent_rows == 0 {
            workspace.fluid.fill(&geometry, position, n, &self.fluid_rows);
        } else {
            let all: Vec<u32> = (0..n as u32).filter(|i| !walls(i)).collect();
            workspace.fluid.fill(&geometry, position, n, &all);
        }
        if is_first {
            let all: Vec<u32> = (0..n as u32).filter(walls).collect();
            workspace.wall.fill(&geometry, position, n, &all);
        } else {
            workspace.wall.refill(&geometry, position, n);
        }
        self.capacity = self.capacity.max(ROW_MULTIPLE).next_multiple_of(ROW_MULTIPLE);
        loop {
            fit(&mut self.index, n * self.capacity, !self.own.is_empty());
            match geometry.dimension {
                2 => self.sweep::<R, 2>(&geometry, workspace),
                _ => self.sweep::<R, 3>(&geometry, workspace),
            }
            let (particle, &most) = self.count.iter().enumerate().max_by_key(|(_, c)| **c).unwrap_or((0, &0));
            let most = most as usize;
            if most > MOST_NEIGHBOURS {
                return Err(NeighbourError::Clumped { particle, count: most });
            }
            if most <= self.capacity {
                break;
            }
            // Grown with some room, so that the next builds fit at once.
            self.capacity = (most + 4).next_multiple_of(ROW_MULTIPLE);
            self.index = Vec::new();
        }
        self.wall_rows.clear();
        let count = &self.count;
        self.wall_rows.extend(workspace.wall.members.iter().copied().filter(|&i| count[i as usize] > 0));
        Ok(())
    }

    fn sweep<R: Real, const D: usize>(&mut self, geometry: &Geometry, workspace: &Workspace<R>) {
        let Workspace { fluid, wall } = workspace;
        let search = Search::<R, D> {
            geometry,
            fluid,
            wall,
            capacity: self.capacity,
            own: &self.own,
            index: Shared::new(&mut self.index),
            count: Shared::new(&mut self.count),
            fluid_count: Shared::new(&mut self.fluid_count),
        };
        run_rows(&search, fluid.members.len() + wall.members.len());
    }

    /// For composed operators on a device: who stands where in the list, and 1 where an entry is a pair, 0 in the padding,
    /// `[1, N, K]`.
    pub fn tensors(&self, device: &Device, dtype: DType) -> candle_core::Result<(Gather, Tensor)> {
        if !sums_by_place(device) {
            return self.new_tensors(device, dtype);
        }
        let mut made = self.made.0.lock().unwrap_or_else(PoisonError::into_inner);
        let thread = std::thread::current().id();
        if let Some(OnDevice { index, mask, thread: own }) = &*made {
            if *own == thread && mask.device().same_device(device) && mask.dtype() == dtype {
                return Ok((index.clone(), mask.clone()));
            }
        }
        let (index, mask) = self.new_tensors(device, dtype)?;
        *made = Some(OnDevice { index: index.clone(), mask: mask.clone(), thread });
        Ok((index, mask))
    }

    fn new_tensors(&self, device: &Device, dtype: DType) -> candle_core::Result<(Gather, Tensor)> {
        let (n, k) = (self.particles, self.capacity);
        let mask: Vec<u8> = (0..n * k).map(|e| u8::from((e % k) < self.count[e / k] as usize)).collect();
        let mask = Tensor::from_vec(mask, (1, n, k), device)?.to_dtype(dtype)?;
        Ok((Gather::new(&self.index, n, device)?, mask))
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

/// The search for neighbours: rows are places in the fluid's cells, then in the walls'.
struct Search<'a, R, const D: usize> {
    geometry: &'a Geometry,
    fluid: &'a Cells<R>,
    wall: &'a Cells<R>,
    capacity: usize,
    own: &'a [bool],
    index: Shared<'a, u32>,
    count: Shared<'a, u32>,
    fluid_count: Shared<'a, u32>,
}

/// Neighbours found for one particle, with room for a last whole vector.
type Found = [u32; MOST_NEIGHBOURS + ROW_MULTIPLE];

impl<R: Real, const D: usize> RowKernel<R> for Search<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let fluids = self.fluid.members.len();
        let mut found: Found = [0; MOST_NEIGHBOURS + ROW_MULTIPLE];
        let mut cell = usize::MAX;
        let mut runs = Runs::default();
        let mut own_wall = false;
        for row in rows {
            let wall = row >= fluids;
            let (own, place) = if wall { (self.wall, row - fluids) } else { (self.fluid, row) };
            if cell != own.cell_of_place[place] as usize || wall != own_wall {
                (cell, own_wall) = (own.cell_of_place[place] as usize, wall);
                runs = self.geometry.runs(cell);
            }
            let me = own.number[place];
            if !(wall || self.own.is_empty() || self.own[me as usize]) {
                continue;
            }
            let here: [L; D] = array(|d| L::splat(own.position[d][place]));
            let myself = if wall { None } else { Some(place) };
            let mut total = append::<R, L, D>(self.geometry, &runs, self.fluid, &here, myself, &mut found, 0);
            let fluid_count = total;
            if !wall && !self.wall.members.is_empty() {
                total = append::<R, L, D>(self.geometry, &runs, self.wall, &here, None, &mut found, total);
            }
            let (i, capacity) = (me as usize, self.capacity);
            // SAFETY: every particle stands at one place, so row i and its counts belong to this iteration alone.
            unsafe {
                self.count.set(i, total as u32);
                self.fluid_count.set(i, fluid_count as u32);
                if total <= capacity {
                    let row = self.index.slice(i * capacity..(i + 1) * capacity);
                    row[..total].copy_from_slice(&found[..total]);
                    row[total..].fill(me);
                }
            }
        }
    }
}

/// Appends the particles of `cells` within reach of `here`, but for the one at the place `myself`, to the `total` that
/// `found` has; counts on, without keeping them, when there is no room left.
#[inline(always)]
fn append<R: Real, L: Lanes<Real = R>, const D: usize>(
    geometry: &Geometry,
    runs: &Runs,
    cells: &Cells<R>,
    here: &[L; D],
    myself: Option<usize>,
    found: &mut Found,
    mut total: usize,
) -> usize {
    let reach2 = L::splat(R::of(geometry.reach * geometry.reach));
    for run in &runs.list[..runs.count] {
        let (from, to) = cells.places(run.first, run.last);
        let shift: [L; D] = array(|d| L::splat(R::of(run.shift[d])));
        let mut at = from;
        while at < to {
            let mut r2 = L::zero();
            for d in 0..D {
                // SAFETY: positions are padded by the widest lane count behind the last place.
                let there = unsafe { L::load(cells.position[d].as_ptr().add(at)) };
                let mut dr = here[d] - there + shift[d];
                if geometry.narrow[d] {
                    let size = L::splat(R::of(geometry.size[d]));
                    dr = dr - size * (dr * L::splat(R::of(1.0 / geometry.size[d]))).round();
                }
                r2 = dr.mul_add(dr, r2);
            }
            let mut bits = r2.bits_less(reach2);
            if at + L::COUNT > to {
                bits &= (1 << (to - at)) - 1;
            }
            if let Some(place) = myself.filter(|place| (at..at + L::COUNT).contains(place)) {
                bits &= !(1 << (place - at));
            }
            // SAFETY: numbers are padded as positions are; `found` has room for COUNT behind MOST_NEIGHBOURS.
            unsafe {
                let free = found.as_mut_ptr().add(total.min(MOST_NEIGHBOURS));
                L::compress(cells.number.as_ptr().add(at), bits, free);
            }
            total += bits.count_ones() as usize;
            at += L::COUNT;
        }
    }
    total
}
