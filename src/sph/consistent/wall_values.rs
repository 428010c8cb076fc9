//! Pressure and temperature of dummy particles: those of the fluid at their mirror images.
//!
//! At each point r_b of the wall's surface a field of the fluid is fitted by c_0 + c_1.s, s = (r - r_b)/dx, with weights W
//! (first-order moving least squares; 1e-3 sum W is added to the diagonal of the linear terms, so that few neighbours do
//! no harm). A dummy particle whose mirror image in the nearest point of the surface is at r_m has the value of that fit at
//! r_m: the field is even across the wall, its normal derivative there zero.
//!
//! The mirror image of a dummy particle stands in its rows of velocity, which it has no other use for.

use super::blocks::{load, store, vectors, width, OfParticles, Place};
use super::geometry::{Around, Geometry};
use super::kept::Kept;
use super::stencil::{accumulate, at, dot, factorise, packed, solve};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{clear, run_rows, RowKernel};
use crate::sph::own::Own;
use crate::sph::pairs::{get, stride, vector, Records};
use std::ops::Range;

/// Added to the linear terms' diagonal, in units of sum W.
const REGULARISATION: f64 = 1e-3;

/// Calls a macro with dimension, unknowns K of a fit, numbers of its matrix, fields, groups of a record, and groups of the
/// cotangents' record.
macro_rules! sizes {
    ($dimension:expr, $fields:expr, $go:ident) => {
        match ($dimension, $fields) {
            (2, 1) => $go!(2, 3, 6, 1, 1, 2),
            (2, _) => $go!(2, 3, 6, 2, 1, 3),
            (_, 1) => $go!(3, 4, 10, 1, 1, 2),
            (_, _) => $go!(3, 4, 10, 2, 2, 4),
        }
    };
}

struct Fitting<'a, R, const D: usize, const K: usize, const P: usize, const N: usize, const G: usize> {
    geometry: Geometry<'a, R>,
    /// Position and fields, `[N, 4 G]`.
    records: Records<'a, R>,
    /// The matrices `[blocks, P, width]`, where they are made, and where they are there.
    made: Option<Own<'a, R>>,
    factors: &'a [R],
    /// `[blocks, N K, width]`.
    coefficients: Own<'a, R>,
}

/// r_j - r_i, its square, and q = (1, s).
#[inline(always)]
fn around<L: Lanes, const D: usize, const K: usize, const G: usize>(
    pairs: &Around<'_, L, D>,
    here: &[[L; 4]; G],
    there: &[[L; 4]; G],
) -> ([L; D], L, [L; K]) {
    let (r, r2) = pairs.towards(here, there);
    let mut q = [L::splat(L::Real::of(1.0)); K];
    for d in 0..D {
        q[1 + d] = r[d] * pairs.scale;
    }
    (r, r2, q)
}

impl<R: Real, const D: usize, const K: usize, const P: usize, const N: usize, const G: usize> RowKernel<R>
    for Fitting<'_, R, D, K, P, N, G>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let pairs = Around::<L, D>::new(&self.geometry);
        let table = &self.geometry.blocks.surface;
        for place in vectors::<L>(rows) {
            let counts = table.counts::<L>(place);
            let own = self.records.groups::<L, G>(table.own(place));
            let (mut matrix, mut right) = ([L::zero(); P], [[L::zero(); K]; N]);
            for pair in table.pairs_of::<L>(place) {
                let other = self.records.groups::<L, G>(pair.names);
                let (_, r2, q) = around::<L, D, K, G>(&pairs, &own, &other);
                let w = pair.there(counts, pairs.kernel.value(r2));
                if self.made.is_some() {
                    accumulate::<L, K, P>(&mut matrix, w, &q);
                }
                for field in 0..N {
                    let weighted = w * get(&other, D + field);
                    for a in 0..K {
                        right[field][a] = weighted.mul_add(q[a], right[field][a]);
                    }
                }
            }
            let of_matrix = Place::of::<R>(place, P);
            if let Some(made) = &self.made {
                let sum = matrix[0];
                let extra = sum * L::splat(R::of(REGULARISATION));
                for a in 1..K {
                    matrix[at(a, a)] += extra;
                }
                let least = sum.mul_add(L::splat(R::of(1e-9)), L::splat(R::of(1e-30)));
                factorise::<L, K, P>(&mut matrix, least);
                store(made, of_matrix, 0, matrix);
            } else {
                matrix = load(self.factors, of_matrix, 0);
            }
            for field in 0..N {
                let c = solve::<L, K, P>(&matrix, right[field]);
                store(&self.coefficients, Place::of::<R>(place, N * K), field * K, c);
            }
        }
    }
}

/// Whether there are no dummy particles, also on other ranks: those exchange what they find, and wait for this one.
fn has_none<R: Real>(geometry: &Geometry<'_, R>) -> bool {
    let others_have = geometry.model.part.as_ref().is_some_and(|part| part.has_walls);
    geometry.model.fits.dummies.is_empty() && !others_have
}

/// The mirror image of a dummy particle from its surface point, in units of dx.
#[inline(always)]
fn mirror<R: Real>(geometry: &Geometry<'_, R>, known: &[R], dummy: usize, point: usize, d: usize) -> R {
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    let raw = known[(l.velocity() + d) * n + dummy] - known[d * n + point];
    geometry.model.domain.nearest_image(d, raw) * R::of(1.0 / geometry.model.fits.spacing)
}

/// Fills in the dummy particles' values of `fields`, `[fields, N]`, with positions and mirror images from `known`, `[F, N]`.
/// `all`: these are all fields, and the matrices are made; else it is the new pressure, with the matrices that there are.
pub fn fill<R: Real>(geometry: &Geometry<'_, R>, known: &[R], fields: &mut [R], kept: &mut Kept<R>, all: bool) {
    let fits = &geometry.model.fits;
    if has_none(geometry) {
        return;
    }
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    let (count, blocks) = (fields.len() / n, geometry.blocks.surface.blocks());
    let mut records = geometry.model.scratch.buffers.buffer(stride(d + count) * n);
    super::derivatives::pack(geometry, known, fields, &mut records);
    if all {
        kept.wall_factors.resize(blocks * packed(d + 1) * width::<R>(), R::default());
    }
    let coefficients = if all { &mut kept.wall_coefficients } else { &mut kept.pressure_coefficients };
    coefficients.resize(blocks * count * (d + 1) * width::<R>(), R::default());
    {
        let (geometry, records) = (*geometry, Records::new(&records, stride(d + count), n));
        let (made, factors): (_, &[R]) = match all {
            true => (Some(Own::new(&mut kept.wall_factors)), &[]),
            false => (None, &kept.wall_factors),
        };
        let coefficients = Own::new(coefficients);
        macro_rules! go {
            ($d:literal, $k:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {
                run_rows(&Fitting::<R, $d, $k, $p, $n, $g> { geometry, records, made, factors, coefficients }, blocks)
            };
        }
        sizes!(d, count, go)
    }
    let unknowns = d + 1;
    for &(dummy, place) in &fits.dummies {
        let (i, place) = (dummy as usize, place as usize);
        let (point, at) = (fits.surface[place] as usize, Place::of::<R>(place, count * unknowns));
        for field in 0..count {
            let c = |a: usize| coefficients[at.row(field * unknowns + a)];
            let mut value = c(0);
            for a in 0..d {
                value += c(1 + a) * mirror(geometry, known, i, point, a);
            }
            fields[field * n + i] = value;
        }
    }
}

/// lambda of every fit, as the records of the pairs' adjoint.
struct Solving<'a, R, const K: usize, const P: usize, const N: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    factors: &'a [R],
    coefficients: &'a [R],
    bar: &'a [R],
    records: OfParticles<'a, R>,
}

impl<R: Real, const K: usize, const P: usize, const N: usize, const B: usize> RowKernel<R>
    for Solving<'_, R, K, P, N, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (table, to) = (&self.geometry.blocks.surface, &self.records);
        for place in vectors::<L>(rows) {
            let factor = load(self.factors, Place::of::<R>(place, P), 0);
            let at = Place::of::<R>(place, N * K);
            for field in 0..N {
                let lambda = solve::<L, K, P>(&factor, load(self.bar, at, field * K));
                let c = load::<L, K>(self.coefficients, at, field * K);
                for a in 0..K {
                    to.set(table, place, [field * K + a, 4 * B], lambda[a]);
                    to.set(table, place, [(N + field) * K + a, 4 * B], c[a]);
                }
            }
        }
    }
}

struct Backward<'a, R, const D: usize, const K: usize, const N: usize, const G: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    records: Records<'a, R>,
    /// 0 for other particles than points on the surface.
    bars: Records<'a, R>,
    /// Rows of the points on the surface, or of the fluid.
    surface: bool,
    position_bar: OfParticles<'a, R>,
    fields_bar: OfParticles<'a, R>,
}

impl<R: Real, const D: usize, const K: usize, const N: usize, const G: usize, const B: usize> RowKernel<R>
    for Backward<'_, R, D, K, N, G, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (n, blocks) = (self.geometry.model.particles(), self.geometry.blocks);
        let pairs = Around::<L, D>::new(&self.geometry);
        let regularisation = L::splat(R::of(REGULARISATION));
        let table = if self.surface { &blocks.surface } else { &blocks.wall };
        for place in vectors::<L>(rows) {
            let counts = table.counts::<L>(place);
            let members = table.own(place);
            let (own, own_bar) = (self.records.groups::<L, G>(members), self.bars.groups::<L, B>(members));
            let (mut position_bar, mut fields_bar) = ([L::zero(); D], [L::zero(); N]);
            for pair in table.pairs_of::<L>(place) {
                let other = self.records.groups::<L, G>(pair.names);
                // The point, and the fluid particle that it sees.
                let (point, fluid) = if self.surface { (&own, &other) } else { (&other, &own) };
                let bar = if self.surface { own_bar } else { self.bars.groups(pair.names) };
                let (r, r2, q) = around::<L, D, K, G>(&pairs, point, fluid);
                let (w, f, _) = pairs.kernel.all(r2);
                let (w, f) = (pair.there(counts, w), pair.there(counts, f));
                let mut value_bar = L::zero();
                let mut toward = [L::zero(); D];
                for field in 0..N {
                    let (lambda, c): ([L; K], [L; K]) = (vector(&bar, field * K), vector(&bar, (N + field) * K));
                    let l = dot(&lambda, &q);
                    let e = get(fluid, D + field) - dot(&c, &q);
                    value_bar = l.mul_add(e, value_bar);
                    for d in 0..D {
                        let both = lambda[1 + d] * c[1 + d];
                        value_bar = (-both).mul_add(regularisation, value_bar);
                        toward[d] = (-c[1 + d]).mul_add(l, lambda[1 + d].mul_add(e, toward[d]));
                    }
                    fields_bar[field] = w.mul_add(l, fields_bar[field]);
                }
                let (along, radial) = (w * pairs.scale, f * value_bar);
                for d in 0..D {
                    // By the fluid particle's position; the point's is the opposite.
                    position_bar[d] += along.mul_add(toward[d], radial * r[d]);
                }
            }
            for d in 0..D {
                let bar = if self.surface { -position_bar[d] } else { position_bar[d] };
                self.position_bar.add(table, place, d * n, bar);
            }
            // Points give the fluid's fields nothing: the fluid takes its share itself.
            if !self.surface {
                for field in 0..N {
                    self.fields_bar.add(table, place, field * n, fields_bar[field]);
                }
            }
        }
    }
}

/// The adjoint of [`fill`]: takes the dummy particles' entries out of `fields_bar`, and adds what they came from to it and to
/// `known_bar` (positions and mirror images). `all` as there.
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    fields: &[R],
    kept: &Kept<R>,
    all: bool,
    fields_bar: &mut [R],
    known_bar: &mut [R],
) {
    let fits = &geometry.model.fits;
    if has_none(geometry) {
        return;
    }
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    let d = l.dimension;
    let (count, blocks) = (fields.len() / n, geometry.blocks.surface.blocks());
    let buffers = &geometry.model.scratch.buffers;
    let unknowns = d + 1;
    // Dummy particles of other ranks belong to points of this one.
    geometry.model.refresh(fields_bar);
    let coefficients = if all { &kept.wall_coefficients } else { &kept.pressure_coefficients };
    let mut bar = buffers.buffer(coefficients.len());
    clear(&mut bar);
    let scale = R::of(1.0 / fits.spacing);
    for &(dummy, place) in &fits.dummies {
        let (i, place) = (dummy as usize, place as usize);
        let (point, places) = (fits.surface[place] as usize, Place::of::<R>(place, count * unknowns));
        for field in 0..count {
            let value_bar = std::mem::take(&mut fields_bar[field * n + i]);
            let at = |a: usize| places.row(field * unknowns + a);
            bar[at(0)] += value_bar;
            for a in 0..d {
                bar[at(1 + a)] += value_bar * mirror(geometry, known, i, point, a);
                let by_mirror = value_bar * coefficients[at(1 + a)] * scale;
                known_bar[(l.velocity() + a) * n + i] += by_mirror;
                known_bar[a * n + point] -= by_mirror;
            }
        }
    }
    let mut records = buffers.buffer(stride(d + count) * n);
    super::derivatives::pack(geometry, known, fields, &mut records);
    let mut bars = buffers.buffer(stride(2 * count * unknowns) * n);
    clear(&mut bars);
    macro_rules! go {
        ($d:literal, $k:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {{
            const { assert!(4 * $g == stride($d + $n) && 4 * $b == stride(2 * $n * $k)) };
            let solving = Solving::<R, $k, $p, $n, $b> {
                geometry: *geometry,
                factors: &kept.wall_factors,
                coefficients,
                bar: &bar,
                records: OfParticles::new(&mut bars),
            };
            run_rows(&solving, blocks);
            geometry.model.refresh_records(&mut bars, 4 * $b, 0, 2 * $n * $k);
            let mut backward = Backward::<R, $d, $k, $n, $g, $b> {
                geometry: *geometry,
                records: Records::new(&records, 4 * $g, n),
                bars: Records::new(&bars, 4 * $b, n),
                surface: true,
                position_bar: OfParticles::new(known_bar),
                fields_bar: OfParticles::new(fields_bar),
            };
            run_rows(&backward, blocks);
            backward.surface = false;
            run_rows(&backward, geometry.blocks.fluid.blocks());
        }};
    }
    sizes!(d, count, go)
}
