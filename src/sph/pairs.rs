//! What every sweep over pairs shares: rows, differences, masses, packing.

use super::model::Model;
use crate::lanes::{Lanes, Real};
use crate::neighbours::NeighbourList;
use crate::particles::Domain;

/// Differences of positions with the minimum image, in lanes.
pub struct RowGeometry<L, const D: usize> {
    size: [L; D],
    inverse: [L; D],
}

impl<L: Lanes, const D: usize> RowGeometry<L, D> {
    #[inline(always)]
    pub fn new(domain: &Domain) -> Self {
        let inverse = domain.inverse_period();
        Self {
            size: std::array::from_fn(|d| L::splat(L::Real::of(domain.size[d]))),
            inverse: std::array::from_fn(|d| L::splat(L::Real::of(inverse[d]))),
        }
    }

    /// Record i (4 numbers) in every lane.
    #[inline(always)]
    pub fn splat(&self, records: &[L::Real], i: usize) -> [L; 4] {
        std::array::from_fn(|q| L::splat(records[4 * i + q]))
    }

    /// r_i - r_j and its square.
    #[inline(always)]
    pub fn difference(&self, here: &[L], there: &[L]) -> ([L; D], L) {
        let mut r2 = L::zero();
        let dr = std::array::from_fn(|d| {
            let raw = here[d] - there[d];
            let dr = raw - self.size[d] * (raw * self.inverse[d]).round();
            r2 = dr.mul_add(dr, r2);
            dr
        });
        (dr, r2)
    }
}

/// Zeroes the lanes of a vector that lie outside the part of the row that is summed.
#[derive(Clone, Copy)]
pub struct Mask<L> {
    lane: L,
    begin: L,
    end: L,
    whole: bool,
}

impl<L: Lanes> Mask<L> {
    #[inline(always)]
    pub fn apply(&self, value: L) -> L {
        if self.whole {
            value
        } else {
            let inside = self.lane.select_less(self.begin, L::zero(), value);
            self.lane.select_less(self.end, inside, L::zero())
        }
    }
}

/// The vectors of row i: where their particle numbers stand, and their mask.
#[inline(always)]
pub fn row<L: Lanes>(list: &NeighbourList, i: usize) -> Vectors<'_, L> {
    part(list, i, 0, list.count[i] as usize)
}

/// [`row`] for the entries `from..to` only.
#[inline(always)]
pub fn part<L: Lanes>(list: &NeighbourList, i: usize, from: usize, to: usize) -> Vectors<'_, L> {
    Vectors { row: list.row(i), at: from / L::COUNT * L::COUNT, from, to, lanes: std::marker::PhantomData }
}

/// Iterator of [`row`]. Not a function that takes a closure: big closures are not inlined, and an AVX-512 body outside
/// of its `target_feature` function runs five times slower.
pub struct Vectors<'a, L> {
    row: &'a [u32],
    at: usize,
    from: usize,
    to: usize,
    lanes: std::marker::PhantomData<L>,
}

impl<L: Lanes> Iterator for Vectors<'_, L> {
    type Item = (*const u32, Mask<L>);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        if self.at >= self.to {
            return None;
        }
        let number = |x: usize| L::splat(L::Real::of(x as f64));
        let at = self.at;
        let mask = Mask {
            lane: L::ramp() + number(at),
            begin: number(self.from),
            end: number(self.to),
            whole: at >= self.from && at + L::COUNT <= self.to,
        };
        self.at += L::COUNT;
        // Rows are padded to a multiple of every lane count, with valid particle numbers.
        Some((self.row[at..at + L::COUNT].as_ptr(), mask))
    }
}

/// Rows of all particles that take part in pairs: fluid, then reachable walls.
pub fn all_rows(list: &NeighbourList) -> usize {
    list.fluid_rows.len() + list.wall_rows.len()
}

/// The particle of a row of [`all_rows`].
#[inline(always)]
pub fn particle_of_row(list: &NeighbourList, row: usize) -> usize {
    let fluids = list.fluid_rows.len();
    (if row < fluids { list.fluid_rows[row] } else { list.wall_rows[row - fluids] }) as usize
}

/// Mass of a particle, from the moved state's mass row or the scene's constant.
#[derive(Clone, Copy)]
pub struct Masses<'a, R> {
    row: Option<&'a [R]>,
    constant: R,
}

impl<'a, R: Real> Masses<'a, R> {
    pub fn new(model: &Model<R>, moved: &'a [R]) -> Self {
        let from = model.layout.moved_mass() * model.particles();
        Self { row: model.layout.mass.then(|| &moved[from..]), constant: R::of(model.mass) }
    }
    #[inline(always)]
    pub fn of(&self, i: usize) -> R {
        self.row.map_or(self.constant, |row| row[i])
    }
}

/// Positions as records of 4: x y [z], then `extra` in place D.
pub fn pack_positions<R: Real>(model: &Model<R>, moved: &[R], extra: Option<&dyn Fn(usize) -> R>, records: &mut [R]) {
    let (n, dimension) = (model.particles(), model.layout.dimension);
    for i in 0..n {
        let record = &mut records[4 * i..4 * i + 4];
        for d in 0..dimension {
            record[d] = moved[d * n + i];
        }
        record[dimension] = extra.map_or(R::default(), |f| f(i));
    }
}
