//! Pressure and temperature of dummy particles: those of the fluid at their mirror images.
//!
//! At each point r_b of the wall's surface a field of the fluid is fitted by c_0 + c_1.s, s = (r - r_b)/dx, with weights W
//! (first-order moving least squares; 1e-3 sum W is added to the diagonal of the linear terms, so that few neighbours do
//! no harm). A dummy particle whose mirror image in the nearest point of the surface is at r_m has the value of that fit at
//! r_m: the field is even across the wall, its normal derivative there zero.
//!
//! The mirror image of a dummy particle stands in its rows of velocity, which it has no other use for.

use super::blocks::{counts, gather, get, position, width};
use super::geometry::Geometry;
use super::kept::Kept;
use super::stencil::{accumulate, dot, factorise, packed, solve};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::sph::pairs::{stride, RowGeometry};
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
    records: &'a [R],
    /// Whether the matrices are made here.
    first: bool,
    /// `[blocks, P, width]`.
    factors: Shared<'a, R>,
    /// `[blocks, N K, width]`.
    coefficients: Shared<'a, R>,
}

/// r_j - r_i, its square, and q = (1, s).
#[inline(always)]
fn around<L: Lanes, const D: usize, const K: usize, const G: usize>(
    pairs: &RowGeometry<L, D>,
    scale: L,
    here: &[[L; 4]; G],
    there: &[[L; 4]; G],
) -> ([L; D], L, [L; K]) {
    let (r, r2) = pairs.difference::<true>(&position::<L, D, G>(there), &position::<L, D, G>(here));
    let mut q = [L::splat(L::Real::of(1.0)); K];
    for d in 0..D {
        q[1 + d] = r[d] * scale;
    }
    (r, r2, q)
}

impl<R: Real, const D: usize, const K: usize, const P: usize, const N: usize, const G: usize> RowKernel<R>
    for Fitting<'_, R, D, K, P, N, G>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let pairs = RowGeometry::<L, D>::new(&geometry.model.domain, geometry.model.kernel.cutoff());
        let kernel = geometry.model.kernel.lanes::<L>();
        let scale = L::splat(R::of(1.0 / geometry.model.fits.spacing));
        let table = &geometry.blocks.surface;
        for block in rows {
            let mut part = 0;
            while part < width {
                let place = block * width + part;
                let count = counts::<L>(&table.count[place..]);
                // SAFETY (of every gather): tables name particles only.
                let own = unsafe { gather::<L, G>(self.records.as_ptr(), table.members[place..].as_ptr()) };
                let (mut matrix, mut right) = ([L::zero(); P], [[L::zero(); K]; N]);
                let from = block * table.capacity * width + part;
                for k in 0..table.depth[block] as usize {
                    let index = unsafe { table.index.as_ptr().add(from + k * width) };
                    let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                    let (_, r2, q) = around::<L, D, K, G>(&pairs, scale, &own, &other);
                    let w = L::splat(R::of(k as f64)).select_less(count, kernel.value(r2), L::zero());
                    if self.first {
                        accumulate::<L, K, P>(&mut matrix, w, &q);
                    }
                    for field in 0..N {
                        let weighted = w * get(&other, D + field);
                        for a in 0..K {
                            right[field][a] = weighted.mul_add(q[a], right[field][a]);
                        }
                    }
                }
                let to = block * P * width + part;
                if self.first {
                    let sum = matrix[0];
                    let extra = sum * L::splat(R::of(REGULARISATION));
                    for a in 1..K {
                        let place = super::stencil::at(a, a);
                        matrix[place] += extra;
                    }
                    let least = sum.mul_add(L::splat(R::of(1e-9)), L::splat(R::of(1e-30)));
                    factorise::<L, K, P>(&mut matrix, least);
                    for a in 0..P {
                        // SAFETY: each block writes its own rows.
                        unsafe { self.factors.store(to + a * width, matrix[a]) };
                    }
                } else {
                    for a in 0..P {
                        // SAFETY: written by the first pass.
                        matrix[a] = unsafe { L::load(self.factors.as_ptr().add(to + a * width)) };
                    }
                }
                let to = block * N * K * width + part;
                for field in 0..N {
                    let c = solve::<L, K, P>(&matrix, right[field]);
                    for a in 0..K {
                        // SAFETY: each block writes its own rows.
                        unsafe { self.coefficients.store(to + (field * K + a) * width, c[a]) };
                    }
                }
                part += L::COUNT;
            }
        }
    }
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
    if fits.dummies.is_empty() {
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
        let factors = Shared::new(&mut kept.wall_factors);
        let coefficients = Shared::new(coefficients);
        macro_rules! go {
            ($d:literal, $k:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {
                run_rows(
                    &Fitting::<R, $d, $k, $p, $n, $g> {
                        geometry: *geometry,
                        records: &records,
                        first: all,
                        factors,
                        coefficients,
                    },
                    blocks,
                )
            };
        }
        sizes!(d, count, go)
    }
    let (unknowns, width) = (d + 1, width::<R>());
    for &(dummy, place) in &fits.dummies {
        let (i, place) = (dummy as usize, place as usize);
        let point = fits.surface[place] as usize;
        let from = place / width * count * unknowns * width + place % width;
        for field in 0..count {
            let c = |a: usize| coefficients[from + (field * unknowns + a) * width];
            let mut value = c(0);
            for a in 0..d {
                value += c(1 + a) * mirror(geometry, known, i, point, a);
            }
            fields[field * n + i] = value;
        }
    }
}

/// lambda of every fit, and the records of the pairs' adjoint.
struct Solving<'a, R, const K: usize, const P: usize, const N: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    factors: &'a [R],
    coefficients: &'a [R],
    bar: Shared<'a, R>,
    records: Shared<'a, R>,
}

impl<R: Real, const K: usize, const P: usize, const N: usize, const B: usize> RowKernel<R>
    for Solving<'_, R, K, P, N, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let width = width::<R>();
        let table = &self.geometry.blocks.surface;
        for block in rows {
            let base = block * N * K * width;
            let mut part = 0;
            while part < width {
                let from = block * P * width + part;
                let mut factor = [L::zero(); P];
                for a in 0..P {
                    // SAFETY: every block has its rows.
                    factor[a] = unsafe { L::load(self.factors.as_ptr().add(from + a * width)) };
                }
                for field in 0..N {
                    let place = |a: usize| base + part + (field * K + a) * width;
                    let mut bar = [L::zero(); K];
                    for a in 0..K {
                        // SAFETY: as above.
                        bar[a] = unsafe { L::load(self.bar.as_ptr().add(place(a))) };
                    }
                    let lambda = solve::<L, K, P>(&factor, bar);
                    for a in 0..K {
                        // SAFETY: each block writes its own rows.
                        unsafe { self.bar.store(place(a), lambda[a]) };
                    }
                }
                part += L::COUNT;
            }
            for lane in 0..width {
                let place = block * width + lane;
                if place >= table.places {
                    break;
                }
                let i = table.members[place] as usize;
                // SAFETY: each point has one place.
                let record = unsafe { self.records.slice(4 * B * i..4 * B * (i + 1)) };
                for k in 0..N * K {
                    // SAFETY: the block's lambda is complete.
                    record[k] = unsafe { self.bar.get(base + k * width + lane) };
                    record[N * K + k] = self.coefficients[base + k * width + lane];
                }
            }
        }
    }
}

struct Backward<'a, R, const D: usize, const K: usize, const N: usize, const G: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    records: &'a [R],
    bars: &'a [R],
    /// Rows of the points on the surface, or of the fluid.
    surface: bool,
    position_bar: Shared<'a, R>,
    fields_bar: Shared<'a, R>,
}

impl<R: Real, const D: usize, const K: usize, const N: usize, const G: usize, const B: usize> RowKernel<R>
    for Backward<'_, R, D, K, N, G, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let pairs = RowGeometry::<L, D>::new(&geometry.model.domain, geometry.model.kernel.cutoff());
        let kernel = geometry.model.kernel.lanes::<L>();
        let scale = L::splat(R::of(1.0 / geometry.model.fits.spacing));
        let regularisation = L::splat(R::of(REGULARISATION));
        let blocks = geometry.blocks;
        let table = if self.surface { &blocks.surface } else { &blocks.wall };
        let n = geometry.model.particles();
        for block in rows {
            let mut part = 0;
            while part < width {
                let place = block * width + part;
                let count = counts::<L>(&table.count[place..]);
                let members = table.members[place..].as_ptr();
                // SAFETY (of every gather): tables name particles only, and each has records; those of other particles than
                // points on the surface are zero.
                let own = unsafe { gather::<L, G>(self.records.as_ptr(), members) };
                let own_bar = unsafe { gather::<L, B>(self.bars.as_ptr(), members) };
                let (mut position_bar, mut fields_bar) = ([L::zero(); D], [L::zero(); N]);
                let from = block * table.capacity * width + part;
                for k in 0..table.depth[block] as usize {
                    let index = unsafe { table.index.as_ptr().add(from + k * width) };
                    let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                    // The point, and the fluid particle that it sees.
                    let (point, fluid) = if self.surface { (&own, &other) } else { (&other, &own) };
                    let bar = if self.surface { own_bar } else { unsafe { gather::<L, B>(self.bars.as_ptr(), index) } };
                    let (r, r2, q) = around::<L, D, K, G>(&pairs, scale, point, fluid);
                    let (w, f, _) = kernel.all(r2);
                    let there = |x: L| L::splat(R::of(k as f64)).select_less(count, x, L::zero());
                    let (w, f) = (there(w), there(f));
                    let mut value_bar = L::zero();
                    let mut toward = [L::zero(); D];
                    for field in 0..N {
                        let (mut lambda, mut c) = ([L::zero(); K], [L::zero(); K]);
                        for a in 0..K {
                            let place = field * K + a;
                            lambda[a] = get(&bar, place);
                            c[a] = get(&bar, N * K + place);
                        }
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
                    let (along, radial) = (w * scale, f * value_bar);
                    for d in 0..D {
                        // By the fluid particle's position; the point's is the opposite.
                        position_bar[d] += along.mul_add(toward[d], radial * r[d]);
                    }
                }
                // SAFETY (both): each place writes its own particle.
                for d in 0..D {
                    let bar = if self.surface { -position_bar[d] } else { position_bar[d] };
                    table.scatter(place, bar, |i, bar| unsafe { self.position_bar.add(d * n + i, bar) });
                }
                // Points give the fluid's fields nothing: the fluid takes its share itself.
                if !self.surface {
                    for field in 0..N {
                        table.scatter(place, fields_bar[field], |i, bar| unsafe {
                            self.fields_bar.add(field * n + i, bar)
                        });
                    }
                }
                part += L::COUNT;
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
    if fits.dummies.is_empty() {
        return;
    }
    let (n, l) = (geometry.model.particles(), geometry.model.layout);
    let d = l.dimension;
    let (count, blocks) = (fields.len() / n, geometry.blocks.surface.blocks());
    let buffers = &geometry.model.scratch.buffers;
    let (unknowns, width) = (d + 1, width::<R>());
    let coefficients = if all { &kept.wall_coefficients } else { &kept.pressure_coefficients };
    let mut bar = buffers.buffer(coefficients.len());
    bar.fill(R::default());
    let scale = R::of(1.0 / fits.spacing);
    for &(dummy, place) in &fits.dummies {
        let (i, place) = (dummy as usize, place as usize);
        let point = fits.surface[place] as usize;
        let from = place / width * count * unknowns * width + place % width;
        for field in 0..count {
            let value_bar = std::mem::take(&mut fields_bar[field * n + i]);
            let at = |a: usize| from + (field * unknowns + a) * width;
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
    bars.fill(R::default());
    macro_rules! go {
        ($d:literal, $k:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {{
            const { assert!(4 * $g == stride($d + $n) && 4 * $b == stride(2 * $n * $k)) };
            let solving = Solving::<R, $k, $p, $n, $b> {
                geometry: *geometry,
                factors: &kept.wall_factors,
                coefficients,
                bar: Shared::new(&mut bar),
                records: Shared::new(&mut bars),
            };
            run_rows(&solving, blocks);
            let mut backward = Backward::<R, $d, $k, $n, $g, $b> {
                geometry: *geometry,
                records: &records,
                bars: &bars,
                surface: true,
                position_bar: Shared::new(known_bar),
                fields_bar: Shared::new(fields_bar),
            };
            run_rows(&backward, blocks);
            backward.surface = false;
            run_rows(&backward, geometry.blocks.fluid.blocks());
        }};
    }
    sizes!(d, count, go)
}
