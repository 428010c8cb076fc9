//! What every sweep over pairs shares: rows, records, differences, packing.

use crate::numerics::lanes::{array, Lanes, Real};
use crate::numerics::pool::{fit, Buffer};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::particles::domain::Images;
use crate::particles::NeighbourList;
use crate::sph::flow::Flow;
use crate::sph::kernels::KernelLanes;
use crate::sph::own::Own;
use std::marker::PhantomData;
use std::ops::Range;

/// Calls `$go` with the constant of a flow's dimension.
macro_rules! with_dimension {
    ($dimension:expr, |$d:ident| $go:expr) => {
        if $dimension == 2 {
            const $d: usize = 2;
            $go
        } else {
            const $d: usize = 3;
            $go
        }
    };
}
pub(super) use with_dimension;

/// Differences of positions and the kernel of them, in lanes.
pub struct RowGeometry<L: Lanes, const D: usize> {
    pub kernel: KernelLanes<L>,
    images: Images<L, D>,
    /// Between these no neighbour within the cut-off lies across a periodic edge.
    low: [L::Real; D],
    high: [L::Real; D],
}

impl<L: Lanes, const D: usize> RowGeometry<L, D> {
    #[inline(always)]
    pub fn new(flow: &Flow<L::Real>) -> Self {
        let (domain, cutoff) = (&flow.domain, flow.kernel.cutoff());
        let edge = |d: usize, at: f64, none: f64| L::Real::of(if domain.periodic[d] { at } else { none });
        Self {
            kernel: flow.kernel.lanes(),
            images: Images::new(domain),
            low: array(|d| edge(d, cutoff, f64::NEG_INFINITY)),
            high: array(|d| edge(d, domain.size[d] - cutoff, f64::INFINITY)),
        }
    }

    /// Whether a particle at the start of this record may have neighbours across a periodic edge. The others need no
    /// nearest image: who lies behind the edge is out of reach either way.
    #[inline(always)]
    pub fn at_edge(&self, record: &[L::Real]) -> bool {
        let mut edge = false;
        for d in 0..D {
            edge |= record[d] < self.low[d] || record[d] > self.high[d];
        }
        edge
    }

    /// r_i - r_j (its nearest image, if `EDGE`) and its square.
    #[inline(always)]
    pub fn difference<const EDGE: bool>(&self, here: &[L], there: &[L]) -> ([L; D], L) {
        let mut r2 = L::zero();
        let mut difference = [L::zero(); D];
        for d in 0..D {
            let raw = here[d] - there[d];
            let dr = if EDGE { self.images.nearest(d, raw) } else { raw };
            r2 = dr.mul_add(dr, r2);
            difference[d] = dr;
        }
        (difference, r2)
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

    /// `inside` in the lanes that are summed, `outside` in the others.
    #[inline(always)]
    pub fn choose(&self, inside: L, outside: L) -> L {
        if self.whole {
            inside
        } else {
            let inside = self.lane.select_less(self.begin, outside, inside);
            self.lane.select_less(self.end, inside, outside)
        }
    }

    /// Whether every lane is summed.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// The same vector's lanes up to the entry `end` only.
    #[inline(always)]
    pub fn up_to(&self, at: usize, end: usize) -> Self {
        let whole = self.whole && at + L::COUNT <= end;
        Self { end: L::splat(L::Real::of(end as f64)), whole, ..*self }
    }
}

/// The numbers of COUNT particles, one for each lane.
#[derive(Clone, Copy)]
pub struct Names<'a, L> {
    numbers: &'a [u32],
    lanes: PhantomData<L>,
}

impl<'a, L: Lanes> Names<'a, L> {
    /// The first COUNT of some numbers of a neighbour list: all of them are below the list's number of particles.
    #[inline(always)]
    pub fn first_of(numbers: &'a [u32]) -> Self {
        Self { numbers: &numbers[..L::COUNT], lanes: PhantomData }
    }
}

/// Records of all particles of a neighbour list.
#[derive(Clone, Copy)]
pub struct Records<'a, R> {
    numbers: &'a [R],
    width: usize,
}

impl<'a, R: Real> Records<'a, R> {
    /// Records of so many particles, each `width` numbers long.
    #[inline(always)]
    pub fn new(numbers: &'a [R], width: usize, particles: usize) -> Self {
        assert!(numbers.len() >= width * particles, "a particle without a record");
        Self { numbers, width }
    }

    /// Numbers of a record.
    #[inline(always)]
    pub fn width(&self) -> usize {
        self.width
    }

    /// A particle's own record.
    #[inline(always)]
    pub fn of(&self, i: usize) -> &'a [R] {
        &self.numbers[i * self.width..(i + 1) * self.width]
    }

    /// `values[name]`, of records that are one number long.
    #[inline(always)]
    pub fn numbers<L: Lanes<Real = R>>(&self, names: Names<'_, L>) -> L {
        self.check(1, names);
        // SAFETY: every particle has a record, see `new`, and names are of particles.
        unsafe { L::gather(self.numbers.as_ptr(), names.numbers.as_ptr()) }
    }

    /// Whole records of G groups of four numbers, transposed.
    #[inline(always)]
    pub fn groups<L: Lanes<Real = R>, const G: usize>(&self, names: Names<'_, L>) -> [[L; 4]; G] {
        self.check(4 * G, names);
        let mut all = [[L::zero(); 4]; G];
        for group in 0..G {
            // SAFETY: as for `numbers`.
            all[group] = unsafe { L::gather4(self.numbers.as_ptr().add(4 * group), 4 * G, names.numbers.as_ptr()) };
        }
        all
    }

    /// Whole records of so many fields.
    #[inline(always)]
    pub fn fields<L: Lanes<Real = R>>(&self, fields: usize, names: Names<'_, L>) -> Fields<L> {
        self.check(stride(fields), names);
        // SAFETY: as for `numbers`.
        unsafe { gather_fields(self.numbers.as_ptr(), fields, names) }
    }

    #[inline(always)]
    fn check<L: Lanes>(&self, width: usize, names: Names<'_, L>) {
        debug_assert_eq!(width, self.width);
        debug_assert!(names.numbers.iter().all(|&i| (i as usize + 1) * width <= self.numbers.len()));
    }
}

/// The vectors of row i: their particles and their mask.
#[inline(always)]
pub fn row<L: Lanes>(list: &NeighbourList, i: usize) -> Vectors<'_, L> {
    part(list, i, 0, list.count[i] as usize)
}

/// [`row`] for the entries `from..to` only.
#[inline(always)]
pub fn part<L: Lanes>(list: &NeighbourList, i: usize, from: usize, to: usize) -> Vectors<'_, L> {
    Vectors { row: list.row(i), at: from / L::COUNT * L::COUNT, from, to, lanes: PhantomData }
}

/// [`row`] with the numbers that were kept of each pair, as the list's index.
#[inline(always)]
pub fn row_with<'a, L: Lanes>(list: &'a NeighbourList, i: usize, numbers: &'a [L::Real]) -> RowWith<'a, L> {
    let numbers = &numbers[i * list.capacity..(i + 1) * list.capacity];
    assert!(numbers.len() >= list.row(i).len());
    RowWith { vectors: row(list, i), numbers }
}

/// Iterator of [`row`]. Not a function that takes a closure: big closures are not inlined, and an AVX-512 body outside
/// of its `target_feature` function runs five times slower.
pub struct Vectors<'a, L> {
    row: &'a [u32],
    at: usize,
    from: usize,
    to: usize,
    lanes: PhantomData<L>,
}

impl<'a, L: Lanes> Iterator for Vectors<'a, L> {
    type Item = (Names<'a, L>, Mask<L>);

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
        Some((Names::first_of(&self.row[at..]), mask))
    }
}

/// Iterator of [`row_with`].
pub struct RowWith<'a, L: Lanes> {
    vectors: Vectors<'a, L>,
    numbers: &'a [L::Real],
}

impl<'a, L: Lanes> Iterator for RowWith<'a, L> {
    type Item = (Names<'a, L>, Mask<L>, L);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        let at = self.vectors.at;
        let (names, mask) = self.vectors.next()?;
        // SAFETY: this vector ends in the row, and `row_with` has checked that the row has as many numbers.
        Some((names, mask, unsafe { L::load(self.numbers.as_ptr().add(at)) }))
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

/// A record's fields in lanes: up to four groups of 4, of which the compiler keeps those that are used.
pub type Fields<L> = [[L; 4]; 4];

/// Records are whole groups of 4 numbers.
pub const fn stride(fields: usize) -> usize {
    fields.next_multiple_of(4)
}

/// The records of COUNT particles, loaded whole and transposed.
///
/// # Safety
/// The particles must have a record in `records`, `stride(fields)` long.
#[inline(always)]
pub unsafe fn gather_fields<L: Lanes>(records: *const L::Real, fields: usize, names: Names<'_, L>) -> Fields<L> {
    let (width, index) = (stride(fields), names.numbers.as_ptr());
    let nothing = [L::zero(); 4];
    // SAFETY: as the caller promises.
    unsafe {
        [
            L::gather4(records, width, index),
            if fields > 4 { L::gather4(records.add(4), width, index) } else { nothing },
            if fields > 8 { L::gather4(records.add(8), width, index) } else { nothing },
            if fields > 12 { L::gather4(records.add(12), width, index) } else { nothing },
        ]
    }
}

/// A field of a record.
#[inline(always)]
pub fn get<L: Lanes, const G: usize>(record: &[[L; 4]; G], field: usize) -> L {
    record[field / 4][field % 4]
}

/// Fields of a record from one on.
#[inline(always)]
pub fn vector<L: Lanes, const K: usize, const G: usize>(record: &[[L; 4]; G], from: usize) -> [L; K] {
    let mut vector = [L::zero(); K];
    for k in 0..K {
        vector[k] = get(record, from + k);
    }
    vector
}

/// A record in every lane.
// Loops, not `array::from_fn`: its closures are not always inlined, and then run without AVX.
#[inline(always)]
pub fn splat_fields<L: Lanes>(record: &[L::Real], fields: usize) -> Fields<L> {
    let mut all = [[L::zero(); 4]; 4];
    for group in 0..4 {
        for q in 0..4 {
            if 4 * group + q < fields {
                all[group][q] = L::splat(record[4 * group + q]);
            }
        }
    }
    all
}

/// Writes records of `width` numbers, of every particle one.
struct Packing<'a, R, F> {
    width: usize,
    write: F,
    records: Own<'a, R>,
}

impl<R: Real, F: Fn(usize, &mut [R]) + Sync> RowKernel<R> for Packing<'_, R, F> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for i in rows {
            // SAFETY: each row writes its own record.
            (self.write)(i, unsafe { self.records.slice(i * self.width..(i + 1) * self.width) });
        }
    }
}

/// Records of `width` numbers of every particle, as `write` fills those with arbitrary content, in a buffer of the flow.
pub fn packed<R: Real>(flow: &Flow<R>, width: usize, write: impl Fn(usize, &mut [R]) + Sync) -> Buffer<R> {
    let n = flow.particles();
    let mut records = flow.scratch.buffers.buffer(width * n);
    run_rows(&Packing { width, write, records: Own::new(&mut records) }, n);
    records
}

/// Positions as records of 4: x y (z), then `extra`.
pub fn pack_positions<R: Real>(
    flow: &Flow<R>,
    moved: &[R],
    extra: Option<&(dyn Fn(usize) -> R + Sync)>,
    records: &mut Vec<R>,
) {
    let (n, d) = (flow.particles(), flow.dimension());
    fit(records, 4 * n, flow.part.is_some());
    let write = |i: usize, record: &mut [R]| {
        record[2..].fill(extra.map_or(R::default(), |f| f(i)));
        (0..d).for_each(|k| record[k] = moved[k * n + i]);
    };
    run_rows(&Packing { width: 4, write, records: Own::new(records) }, n);
}
