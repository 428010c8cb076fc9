//! The neighbour list turned round: as many particles as there are lanes stand side by side, each with its own neighbours
//! below it.
//!
//! A moving-least-squares fit has 35 sums per particle and a matrix to factorise. With the lanes over a particle's
//! neighbours every sum would end in a reduction and the factorisation would use one lane; with the lanes over particles
//! neither happens, and a particle's sums run in the order of its neighbours whatever the instruction set is.

use crate::numerics::lanes::{Lanes, Real, WIDEST};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::particles::NeighbourList;
use std::ops::Range;

/// Particles side by side: a cache line of numbers.
pub const fn width<R>() -> usize {
    64 / std::mem::size_of::<R>()
}

/// Some particles and their neighbours of one kind.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// Particle of each place, `[blocks, width]`; behind the last one it is repeated.
    pub members: Vec<u32>,
    /// Places that are somebody's.
    pub places: usize,
    /// Rows of each block: the most neighbours of its particles.
    pub depth: Vec<u32>,
    /// Neighbours of each place; 0 behind the last.
    pub count: Vec<u32>,
    /// Rows that each block has room for.
    pub capacity: usize,
    /// `[blocks, capacity, width]`; a particle itself where it has no neighbour left.
    pub index: Vec<u32>,
}

impl Table {
    pub fn blocks(&self) -> usize {
        self.depth.len()
    }

    /// Calls `each` with the particle and the number of every lane that is somebody's, of lanes that begin at a place.
    #[inline(always)]
    pub fn scatter<L: Lanes>(&self, place: usize, value: L, mut each: impl FnMut(usize, L::Real)) {
        let mut numbers = [L::Real::default(); WIDEST];
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { value.store(numbers.as_mut_ptr()) };
        for lane in 0..L::COUNT {
            if place + lane < self.places {
                each(self.members[place + lane] as usize, numbers[lane]);
            }
        }
    }

    /// Sets who stands where.
    fn seat<R>(&mut self, particles: impl Iterator<Item = u32>) {
        let width = width::<R>();
        self.members.clear();
        self.members.extend(particles);
        self.places = self.members.len();
        let last = self.members.last().copied().unwrap_or(0);
        self.members.resize(self.places.next_multiple_of(width), last);
        let blocks = self.members.len() / width;
        self.depth.resize(blocks, 0);
        self.count.resize(blocks * width, 0);
    }

    /// Fills in the neighbours: a part of each particle's row.
    fn fill<R: Real>(&mut self, list: &NeighbourList, part: impl Fn(&NeighbourList, usize) -> Range<usize> + Sync) {
        let width = width::<R>();
        let most = self.members[..self.places].iter().map(|&i| part(list, i as usize).len()).max().unwrap_or(0);
        self.capacity = self.capacity.max(most.next_multiple_of(4));
        self.index.resize(self.members.len() * self.capacity, 0);
        let blocks = self.blocks();
        let filling = Filling {
            list,
            part,
            places: self.places,
            width,
            capacity: self.capacity,
            members: &self.members,
            depth: Shared::new(&mut self.depth),
            count: Shared::new(&mut self.count),
            index: Shared::new(&mut self.index),
            real: std::marker::PhantomData::<R>,
        };
        run_rows(&filling, blocks);
    }
}

struct Filling<'a, R, F> {
    list: &'a NeighbourList,
    part: F,
    places: usize,
    width: usize,
    capacity: usize,
    members: &'a [u32],
    depth: Shared<'a, u32>,
    count: Shared<'a, u32>,
    index: Shared<'a, u32>,
    real: std::marker::PhantomData<R>,
}

impl<R: Real, F: Fn(&NeighbourList, usize) -> Range<usize> + Sync> RowKernel<R> for Filling<'_, R, F> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for block in rows {
            let from = block * self.width;
            let members = &self.members[from..from + self.width];
            let part = |lane: usize| match from + lane < self.places {
                true => (self.part)(self.list, members[lane] as usize),
                false => 0..0,
            };
            let depth = (0..self.width).map(|lane| part(lane).len()).max().unwrap_or(0);
            // SAFETY (all): each block writes its own part.
            unsafe { self.depth.set(block, depth as u32) };
            let to = block * self.capacity * self.width;
            let index = unsafe { self.index.slice(to..to + depth * self.width) };
            for (lane, &i) in members.iter().enumerate() {
                let neighbours = &self.list.row(i as usize)[part(lane)];
                unsafe { self.count.set(from + lane, neighbours.len() as u32) };
                for k in 0..depth {
                    index[k * self.width + lane] = neighbours.get(k).copied().unwrap_or(i);
                }
            }
        }
    }
}

/// The tables of a neighbour list.
#[derive(Debug, Clone, Default)]
pub struct Blocks {
    /// Fluid particles and their fluid neighbours.
    pub fluid: Table,
    /// The same particles and the wall's points near them.
    pub wall: Table,
    /// Points on the wall's surface and the fluid near them.
    pub surface: Table,
    /// All of the wall's points that have fluid near them, and that.
    pub solid: Table,
}

impl Blocks {
    /// Builds the tables of a list; `surface` are the points on the wall's surface, in order.
    pub fn rebuild<R: Real>(&mut self, list: &NeighbourList, surface: &[u32]) {
        let fluid_part = |list: &NeighbourList, i: usize| 0..list.fluid_count[i] as usize;
        self.fluid.seat::<R>(list.fluid_rows.iter().copied());
        self.fluid.fill::<R>(list, fluid_part);
        self.wall.seat::<R>(list.fluid_rows.iter().copied());
        self.wall.fill::<R>(list, |list, i| list.fluid_count[i] as usize..list.count[i] as usize);
        self.surface.seat::<R>(surface.iter().copied());
        self.surface.fill::<R>(list, fluid_part);
        self.solid.seat::<R>(list.wall_rows.iter().copied());
        self.solid.fill::<R>(list, fluid_part);
    }
}

/// Where the numbers of one place stand in `[blocks, rows, width]`.
#[derive(Clone, Copy)]
pub struct Place {
    base: usize,
    width: usize,
}

impl Place {
    #[inline(always)]
    pub fn of<R>(place: usize, rows: usize) -> Self {
        let width = width::<R>();
        Self { base: place / width * rows * width + place % width, width }
    }

    /// That of row k.
    #[inline(always)]
    pub fn row(&self, k: usize) -> usize {
        self.base + k * self.width
    }
}

/// Numbers of some places as lanes.
#[inline(always)]
pub fn counts<L: Lanes>(count: &[u32]) -> L {
    let mut numbers = [L::Real::default(); WIDEST];
    for lane in 0..L::COUNT {
        numbers[lane] = L::Real::of(count[lane] as f64);
    }
    // SAFETY: no lane type is wider than WIDEST.
    unsafe { L::load(numbers.as_ptr()) }
}

/// Loads and transposes `G` groups of four numbers of each record.
///
/// # Safety
/// `index` must be readable for COUNT numbers of records in `records`, 4 G long.
#[inline(always)]
pub unsafe fn gather<L: Lanes, const G: usize>(records: *const L::Real, index: *const u32) -> [[L; 4]; G] {
    let mut all = [[L::zero(); 4]; G];
    for group in 0..G {
        // SAFETY: as the caller promises.
        all[group] = unsafe { L::gather4(records.add(4 * group), 4 * G, index) };
    }
    all
}

/// The position, which stands first in a record.
#[inline(always)]
pub fn position<L: Lanes, const D: usize, const G: usize>(record: &[[L; 4]; G]) -> [L; D] {
    let mut position = [L::zero(); D];
    for d in 0..D {
        position[d] = get(record, d);
    }
    position
}

/// A field of gathered groups.
#[inline(always)]
pub fn get<L: Lanes, const G: usize>(groups: &[[L; 4]; G], field: usize) -> L {
    groups[field / 4][field % 4]
}
