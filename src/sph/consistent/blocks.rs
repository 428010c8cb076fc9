//! The neighbour list turned round: as many particles as there are lanes stand side by side, each with its own neighbours
//! below it.
//!
//! A moving-least-squares fit has 35 sums per particle and a matrix to factorise. With the lanes over a particle's
//! neighbours every sum would end in a reduction and the factorisation would use one lane; with the lanes over particles
//! neither happens, and a particle's sums run in the order of its neighbours whatever the instruction set is.

use crate::numerics::lanes::{Lanes, Real, WIDEST};
use crate::numerics::pool::fit;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::particles::NeighbourList;
use crate::sph::own::Own;
use crate::sph::pairs::Names;
use std::iter::StepBy;
use std::marker::PhantomData;
use std::ops::Range;

/// Particles side by side: a cache line of numbers.
pub const fn width<R>() -> usize {
    64 / std::mem::size_of::<R>()
}

/// The first places of the vectors of some blocks.
#[inline(always)]
pub fn vectors<L: Lanes>(blocks: Range<usize>) -> StepBy<Range<usize>> {
    let width = width::<L::Real>();
    (blocks.start * width..blocks.end * width).step_by(L::COUNT)
}

/// Some particles and their neighbours of one kind. Only [`Blocks::rebuild`] fills a table: every number in it is that of a
/// particle of the neighbour list, and `index` has room for `depth` rows of every block.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// Particle of each place, `[blocks, width]`; behind the last one it is repeated.
    members: Vec<u32>,
    /// Places that are somebody's.
    pub places: usize,
    /// Rows of each block: the most neighbours of its particles.
    depth: Vec<u32>,
    /// Neighbours of each place; 0 behind the last.
    count: Vec<u32>,
    /// Rows that each block has room for.
    capacity: usize,
    /// `[blocks, capacity, width]`; a particle itself where it has no neighbour left.
    index: Vec<u32>,
}

impl Table {
    pub fn blocks(&self) -> usize {
        self.depth.len()
    }

    /// Room for a number of every pair.
    pub fn pairs(&self) -> usize {
        self.index.len()
    }

    #[inline(always)]
    pub fn particle(&self, place: usize) -> usize {
        self.members[place] as usize
    }

    /// Each particle with its place.
    pub fn each(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.members[..self.places].iter().map(|&i| i as usize).enumerate()
    }

    /// The neighbours of the particle at a place.
    pub fn neighbours(&self, place: usize) -> impl Iterator<Item = u32> + '_ {
        let (width, count) = (self.members.len() / self.blocks(), self.count[place] as usize);
        let from = place / width * self.capacity * width + place % width;
        (0..count).map(move |k| self.index[from + k * width])
    }

    /// The particles at a vector of places.
    #[inline(always)]
    pub fn own<L: Lanes>(&self, place: usize) -> Names<'_, L> {
        Names::first_of(&self.members[place..])
    }

    /// How many neighbours each of a vector of places has.
    #[inline(always)]
    pub fn counts<L: Lanes>(&self, place: usize) -> L {
        let mut numbers = [L::Real::default(); WIDEST];
        for lane in 0..L::COUNT {
            numbers[lane] = L::Real::of(self.count[place + lane] as f64);
        }
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { L::load(numbers.as_ptr()) }
    }

    /// Rows of the block of a place.
    #[inline(always)]
    pub fn depth<R>(&self, place: usize) -> usize {
        self.depth[place / width::<R>()] as usize
    }

    /// The pairs of a vector of places, row by row.
    #[inline(always)]
    pub fn pairs_of<L: Lanes>(&self, place: usize) -> Pairs<'_, L> {
        let width = width::<L::Real>();
        let (from, depth) = (place / width * self.capacity * width + place % width, self.depth::<L::Real>(place));
        assert!(depth == 0 || from + (depth - 1) * width + L::COUNT <= self.index.len());
        Pairs { index: &self.index, from, row: 0, depth, lanes: PhantomData }
    }

    /// [`Self::pairs_of`] with the numbers that were kept of each pair, as `index`.
    #[inline(always)]
    pub fn pairs_with<'a, L: Lanes>(&'a self, place: usize, numbers: &'a [L::Real]) -> PairsWith<'a, L> {
        assert!(numbers.len() >= self.index.len());
        PairsWith { pairs: self.pairs_of(place), numbers }
    }

    /// Calls `each` with the particle and the number of every lane that is somebody's, of lanes that begin at a place.
    #[inline(always)]
    fn scatter<L: Lanes>(&self, place: usize, value: L, mut each: impl FnMut(usize, L::Real)) {
        let numbers = value.numbers();
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
        fit(&mut self.index, self.members.len() * self.capacity, !list.own.is_empty());
        let blocks = self.blocks();
        let filling = Filling {
            list,
            part,
            places: self.places,
            width,
            capacity: self.capacity,
            members: &self.members,
            depth: Own::new(&mut self.depth),
            count: Own::new(&mut self.count),
            index: Own::new(&mut self.index),
            real: PhantomData::<R>,
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
    depth: Own<'a, u32>,
    count: Own<'a, u32>,
    index: Own<'a, u32>,
    real: PhantomData<R>,
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
            self.depth.set(block, depth as u32);
            let to = block * self.capacity * self.width;
            // SAFETY: each block writes its own rows.
            let index = unsafe { self.index.slice(to..to + depth * self.width) };
            for (lane, &i) in members.iter().enumerate() {
                let neighbours = &self.list.row(i as usize)[part(lane)];
                self.count.set(from + lane, neighbours.len() as u32);
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

/// Loads a vector of places' numbers in rows `row ..`.
#[inline(always)]
pub fn load<L: Lanes, const K: usize>(numbers: &[L::Real], at: Place, row: usize) -> [L; K] {
    let mut values = [L::zero(); K];
    assert!(at.row(row + K - 1) + L::COUNT <= numbers.len());
    for k in 0..K {
        // SAFETY: the last row ends in the numbers, and the others stand before it.
        values[k] = unsafe { L::load(numbers.as_ptr().add(at.row(row + k))) };
    }
    values
}

/// Stores a vector of places' numbers in rows `row ..`.
#[inline(always)]
pub fn store<L: Lanes, const K: usize>(numbers: &Own<'_, L::Real>, at: Place, row: usize, values: [L; K]) {
    for k in 0..K {
        numbers.store(at.row(row + k), values[k]);
    }
}

/// Numbers of particles, which the sweeps over a table write: a particle has one place.
pub struct OfParticles<'a, R>(Own<'a, R>);

impl<'a, R: Real> OfParticles<'a, R> {
    pub fn new(numbers: &'a mut [R]) -> Self {
        Self(Own::new(numbers))
    }

    /// Sets number k of the particles' records, `[N, width]`.
    #[inline(always)]
    pub fn set<L: Lanes<Real = R>>(&self, table: &Table, place: usize, [k, width]: [usize; 2], value: L) {
        table.scatter(place, value, |i, value| self.0.set(width * i + k, value));
    }

    /// Adds to the particles' numbers in a row that begins at `row`.
    #[inline(always)]
    pub fn add<L: Lanes<Real = R>>(&self, table: &Table, place: usize, row: usize, value: L) {
        table.scatter(place, value, |i, value| self.0.add(row + i, value));
    }
}

/// The pairs of a vector of places, see [`Table::pairs_of`].
pub struct Pairs<'a, L> {
    index: &'a [u32],
    from: usize,
    row: usize,
    depth: usize,
    lanes: PhantomData<L>,
}

/// See [`Table::pairs_with`].
pub struct PairsWith<'a, L: Lanes> {
    pairs: Pairs<'a, L>,
    numbers: &'a [L::Real],
}

/// A row of pairs.
pub struct Pair<'a, L> {
    row: usize,
    /// Where it stands in the index, and in what is kept of pairs.
    pub at: usize,
    pub names: Names<'a, L>,
}

impl<'a, L: Lanes> Iterator for Pairs<'a, L> {
    type Item = Pair<'a, L>;

    #[inline(always)]
    fn next(&mut self) -> Option<Pair<'a, L>> {
        if self.row == self.depth {
            return None;
        }
        let (row, at) = (self.row, self.from + self.row * width::<L::Real>());
        self.row += 1;
        // SAFETY: `Table::pairs_of` has checked that the last row ends in the index.
        let names = Names::first_of(unsafe { self.index.get_unchecked(at..at + L::COUNT) });
        Some(Pair { row, at, names })
    }
}

impl<'a, L: Lanes> Iterator for PairsWith<'a, L> {
    type Item = (Pair<'a, L>, L);

    #[inline(always)]
    fn next(&mut self) -> Option<(Pair<'a, L>, L)> {
        let pair = self.pairs.next()?;
        // SAFETY: the pair's place is in the index, and `Table::pairs_with` has checked that there are as many numbers.
        let number = unsafe { L::load(self.numbers.as_ptr().add(pair.at)) };
        Some((pair, number))
    }
}

impl<L: Lanes> Pair<'_, L> {
    /// A value where a particle has a neighbour here, 0 where it stands in for one that it lacks; `counts` are
    /// [`Table::counts`].
    #[inline(always)]
    pub fn there(&self, counts: L, value: L) -> L {
        L::splat(L::Real::of(self.row as f64)).select_less(counts, value, L::zero())
    }
}
