//! First and second derivatives of all fields at the fluid's particles, by [`super::stencil`]'s fits.
//!
//! Near a wall each field is fitted to what is known of it there: the velocity to the fluid and the points on the wall's
//! surface, the pressure to the fluid and the dummy particles behind the surface, the temperature to the fluid, the hot
//! points of the surface, and, at points where the wall is not hot, to a vanishing derivative along the wall's normal n:
//! M += w W q_n q_n^T with q_n = dq/dn and nothing added to b. (Such points have their normal in their rows of velocity, which
//! they have no other use for. That condition, and points that are wholly hot or not, 1/8 dx and 7/8 dx from the edge, put
//! the edge of the hot wall where it is: Q is within 0.3 % of finite elements; with dummy particles that have the fluid's
//! temperature, and with points half a spacing from the edge, the hot wall ends a quarter of a spacing too early.) So each kind of field has its own matrix M there; away from
//! walls all three are the same one, and it is factorised once.
//!
//! Besides, V_i = 1 / sum_j W_ij over fluid, dummy particles and i itself, and, for the isotropic shift,
//! c_i = sum_j F_ij r_ij over the same.

use super::blocks::{counts, gather, get, position, width, Table};
use super::geometry::Geometry;
use super::kept::Kept;
use super::kinds::{kind, rows, KINDS, NO_FLUX, PRESSURE, TEMPERATURE};
use super::stencil::{accumulate, along, dot, factorise, monomials, packed, pull_back, pull_back_along, solve, values};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::sph::kernels::KernelLanes;
use crate::sph::pairs::{stride, RowGeometry};
use std::ops::Range;

/// A pivot below this share of sum W belongs to a direction without neighbours.
pub(super) const LEAST_PIVOT: f64 = 1e-9;

/// Groups of four in a record of a fit's cotangents: lambda and d of each field, and that of sum W and of c.
const fn bar_fields(dimension: usize, fields: usize) -> usize {
    2 * fields * monomials(dimension) + 1 + dimension
}

/// Calls a macro with dimension, monomials, numbers of a matrix, fields, groups of a record, and groups of the cotangents' record.
macro_rules! sizes {
    ($dimension:expr, $fields:expr, $go:ident) => {
        match ($dimension, $fields) {
            (2, 1) => $go!(2, 5, 15, 1, 1, 4),
            (2, 3) => $go!(2, 5, 15, 3, 2, 9),
            (2, _) => $go!(2, 5, 15, 4, 2, 11),
            (_, 1) => $go!(3, 9, 45, 1, 1, 6),
            (_, 4) => $go!(3, 9, 45, 4, 2, 19),
            (_, _) => $go!(3, 9, 45, 5, 2, 24),
        }
    };
}

/// What a pair's geometry is made of.
struct Around<L: Lanes, const D: usize> {
    pairs: RowGeometry<L, D>,
    kernel: KernelLanes<L>,
    scale: L,
}

impl<L: Lanes, const D: usize> Around<L, D> {
    #[inline(always)]
    fn new<R: Real>(geometry: &Geometry<'_, R>) -> Self
    where
        L: Lanes<Real = R>,
    {
        Self {
            pairs: RowGeometry::new(&geometry.model.domain, geometry.model.kernel.cutoff()),
            kernel: geometry.model.kernel.lanes::<L>(),
            scale: L::splat(R::of(1.0 / geometry.model.fits.spacing)),
        }
    }

    /// r_j - r_i and its square.
    #[inline(always)]
    fn towards(&self, here: &[L; D], there: &[L; D]) -> ([L; D], L) {
        self.pairs.difference::<true>(there, here)
    }

    /// r over the spacing.
    #[inline(always)]
    fn scaled(&self, r: &[L; D], sign: f64) -> [L; D] {
        let scale = self.scale * L::splat(L::Real::of(sign));
        let mut s = *r;
        for d in 0..D {
            s[d] = r[d] * scale;
        }
        s
    }
}

/// Where a point on the surface has its normal.
#[inline(always)]
fn normal<L: Lanes, const D: usize, const G: usize>(record: &[[L; 4]; G]) -> [L; D] {
    let mut normal = [L::zero(); D];
    for d in 0..D {
        normal[d] = get(record, D + d);
    }
    normal
}

/// With more than one field (all of them) the matrices are made here, for one (the new pressure) they are there.
struct Forward<'a, R, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize> {
    geometry: Geometry<'a, R>,
    /// Position and fields of every particle, `[N, 4 G]`.
    records: &'a [R],
    /// W and F of the fluid's pairs, as the table's index.
    value: Shared<'a, R>,
    slope: Shared<'a, R>,
    /// `[blocks, KINDS, P, width]`.
    factors: Shared<'a, R>,
    /// `[blocks, rows, width]`.
    derivatives: Shared<'a, R>,
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize> RowKernel<R>
    for Forward<'_, R, D, Q, P, N, G>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let width = width::<R>();
        for block in rows {
            let mut part = 0;
            while part < width {
                if N > 1 {
                    self.with_matrices::<L>(block, part);
                } else {
                    self.again::<L>(block, part);
                }
                part += L::COUNT;
            }
        }
    }
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize>
    Forward<'_, R, D, Q, P, N, G>
{
    #[inline(always)]
    fn with_matrices<L: Lanes<Real = R>>(&self, block: usize, part: usize) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let around = Around::<L, D>::new(geometry);
        let (fluid, wall) = (&geometry.blocks.fluid, &geometry.blocks.wall);
        let place = block * width + part;
        let isotropic = geometry.model.fits.shift.is_isotropic();
        // SAFETY (of every gather below): tables name particles only, and each has a record.
        let own = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.members[place..].as_ptr()) };
        let here = position::<L, D, G>(&own);
        let mut matrix = [L::zero(); P];
        let mut right = [[L::zero(); Q]; N];
        let (mut sum, mut spread) = (L::zero(), [L::zero(); D]);
        let depth = fluid.depth[block] as usize;
        let from = block * fluid.capacity * width + part;
        for k in 0..depth {
            let at = from + k * width;
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.index.as_ptr().add(at)) };
            let (r, r2) = around.towards(&here, &position::<L, D, G>(&other));
            let (w, f, _) = around.kernel.all(r2);
            let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
            accumulate::<L, Q, P>(&mut matrix, w, &q);
            add_right::<L, D, Q, N, G>(&mut right, [w; N], &q, &own, &other);
            sum += w;
            if isotropic {
                for d in 0..D {
                    spread[d] = (-f).mul_add(r[d], spread[d]);
                }
            }
            // SAFETY: each block writes its own pairs.
            unsafe {
                self.value.store(at, w);
                self.slope.store(at, f);
            }
        }
        let mut padding = L::splat(R::of(depth as f64)) - counts::<L>(&fluid.count[place..]);
        let mut matrices = [matrix; KINDS];
        let walls = wall.depth[block] as usize;
        if walls > 0 {
            let from = block * wall.capacity * width + part;
            for k in 0..walls {
                let index = unsafe { wall.index.as_ptr().add(from + k * width) };
                let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                let weights = unsafe { L::gather4(geometry.model.fits.weights.as_ptr(), 4, index) };
                let (r, r2) = around.towards(&here, &position::<L, D, G>(&other));
                let (w, f, _) = around.kernel.all(r2);
                let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
                for kind in 0..KINDS {
                    accumulate::<L, Q, P>(&mut matrices[kind], w * weights[kind], &q);
                }
                if N > D + 1 {
                    let q = along::<L, D, Q>(&around.scaled(&r, 1.0), &normal::<L, D, G>(&other));
                    accumulate::<L, Q, P>(&mut matrices[TEMPERATURE], w * weights[NO_FLUX], &q);
                }
                add_right::<L, D, Q, N, G>(&mut right, of_fields::<L, D, N>(w, &weights), &q, &own, &other);
                sum += w * weights[PRESSURE];
                if isotropic {
                    for d in 0..D {
                        spread[d] = (-(f * weights[PRESSURE])).mul_add(r[d], spread[d]);
                    }
                }
            }
            padding += L::splat(R::of(walls as f64)) - counts::<L>(&wall.count[place..]);
        }
        // A particle stands in for the neighbours that it lacks: nothing but sum W notices.
        let at_zero = L::splat(R::of(geometry.model.kernel.at_zero()));
        let sum = at_zero.mul_add(L::splat(R::of(1.0)) - padding, sum);
        let least = L::splat(R::of(LEAST_PIVOT)) * sum;
        if walls > 0 {
            for kind in 0..KINDS {
                factorise::<L, Q, P>(&mut matrices[kind], least);
            }
        } else {
            factorise::<L, Q, P>(&mut matrices[0], least);
            matrices[1] = matrices[0];
            matrices[2] = matrices[0];
        }
        let to = block * const { KINDS } * P * width + part;
        for kind in 0..KINDS {
            for a in 0..P {
                // SAFETY: as above.
                unsafe { self.factors.store(to + (kind * P + a) * width, matrices[kind][a]) };
            }
        }
        let to = block * const { self::rows(D, N) } * width + part;
        for field in 0..N {
            let d = solve::<L, Q, P>(&matrices[kind(D, N, field)], right[field]);
            for a in 0..Q {
                // SAFETY: as above.
                unsafe { self.derivatives.store(to + (field * Q + a) * width, d[a]) };
            }
        }
        // SAFETY: as above.
        unsafe {
            self.derivatives.store(to + N * Q * width, L::splat(R::of(1.0)) / sum);
            for d in 0..D {
                self.derivatives.store(to + (N * Q + 1 + d) * width, spread[d]);
            }
        }
    }

    /// With the matrices and the fluid's W of the pass before.
    #[inline(always)]
    fn again<L: Lanes<Real = R>>(&self, block: usize, part: usize) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let around = Around::<L, D>::new(geometry);
        let (fluid, wall) = (&geometry.blocks.fluid, &geometry.blocks.wall);
        let place = block * width + part;
        // SAFETY (of every gather and load below): as in the first pass.
        let own = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.members[place..].as_ptr()) };
        let here = position::<L, D, G>(&own);
        let mut right = [[L::zero(); Q]; N];
        let from = block * fluid.capacity * width + part;
        for k in 0..fluid.depth[block] as usize {
            let at = from + k * width;
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.index.as_ptr().add(at)) };
            let w = unsafe { L::load(self.value.as_ptr().add(at)) };
            let (r, _) = around.towards(&here, &position::<L, D, G>(&other));
            let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
            add_right::<L, D, Q, N, G>(&mut right, [w; N], &q, &own, &other);
        }
        let from = block * wall.capacity * width + part;
        for k in 0..wall.depth[block] as usize {
            let index = unsafe { wall.index.as_ptr().add(from + k * width) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let weights = unsafe { L::gather4(geometry.model.fits.weights.as_ptr(), 4, index) };
            let (r, r2) = around.towards(&here, &position::<L, D, G>(&other));
            let w = around.kernel.value(r2);
            let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
            add_right::<L, D, Q, N, G>(&mut right, of_fields::<L, D, N>(w, &weights), &q, &own, &other);
        }
        let to = block * const { self::rows(D, N) } * width + part;
        for field in 0..N {
            let factor = load_factor::<R, L, P>(self.factors.as_ptr(), block, part, kind(D, N, field));
            let d = solve::<L, Q, P>(&factor, right[field]);
            for a in 0..Q {
                // SAFETY: each block writes its own rows.
                unsafe { self.derivatives.store(to + (field * Q + a) * width, d[a]) };
            }
        }
    }
}

/// Adds W q (f_j - f_i) of every field, with its own W.
#[inline(always)]
fn add_right<L: Lanes, const D: usize, const Q: usize, const N: usize, const G: usize>(
    right: &mut [[L; Q]; N],
    values: [L; N],
    q: &[L; Q],
    own: &[[L; 4]; G],
    other: &[[L; 4]; G],
) {
    for field in 0..N {
        let weighted = values[field] * (get(other, D + field) - get(own, D + field));
        for a in 0..Q {
            right[field][a] = weighted.mul_add(q[a], right[field][a]);
        }
    }
}

/// W of a wall's particle in the fit of every field.
#[inline(always)]
fn of_fields<L: Lanes, const D: usize, const N: usize>(w: L, weights: &[L; 4]) -> [L; N] {
    let mut values = [w; N];
    for field in 0..N {
        values[field] = w * weights[kind(D, N, field)];
    }
    values
}

#[inline(always)]
fn load_factor<R: Real, L: Lanes<Real = R>, const P: usize>(
    factors: *const R,
    block: usize,
    part: usize,
    kind: usize,
) -> [L; P] {
    let width = width::<R>();
    let from = block * KINDS * P * width + part + kind * P * width;
    let mut factor = [L::zero(); P];
    for a in 0..P {
        // SAFETY: every block has its factors.
        factor[a] = unsafe { L::load(factors.add(from + a * width)) };
    }
    factor
}

/// Packs positions and fields `[fields, N]` into records.
pub(super) fn pack<R: Real>(geometry: &Geometry<'_, R>, position: &[R], fields: &[R], records: &mut Vec<R>) {
    let n = geometry.model.particles();
    let d = geometry.model.layout.dimension;
    let count = fields.len() / n;
    let stride = stride(d + count);
    records.resize(stride * n, R::default());
    for (i, record) in records.chunks_exact_mut(stride).enumerate() {
        for k in 0..d {
            record[k] = position[k * n + i];
        }
        for k in 0..count {
            record[d + k] = fields[k * n + i];
        }
    }
}

/// Derivatives of fields `[fields, N]`, `[blocks, rows, width]`: of all of them with new matrices, or of the pressure alone
/// with those that `kept` has.
pub fn forward<R: Real>(
    geometry: &Geometry<'_, R>,
    position: &[R],
    fields: &[R],
    kept: &mut Kept<R>,
    derivatives: &mut Vec<R>,
) {
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    let (count, blocks) = (fields.len() / n, geometry.blocks.fluid.blocks());
    let first = count > 1;
    let records = if first { &mut kept.records } else { &mut kept.pressure_records };
    pack(geometry, position, fields, records);
    if first {
        kept.value.resize(geometry.blocks.fluid.index.len(), R::default());
        kept.slope.resize(geometry.blocks.fluid.index.len(), R::default());
        kept.factors.resize(blocks * KINDS * packed(monomials(d)) * width::<R>(), R::default());
    }
    derivatives.resize(blocks * rows(d, count) * width::<R>(), R::default());
    let records = if first { &kept.records } else { &kept.pressure_records };
    let (value, slope) = (Shared::new(&mut kept.value), Shared::new(&mut kept.slope));
    let (factors, derivatives) = (Shared::new(&mut kept.factors), Shared::new(derivatives));
    macro_rules! go {
        ($d:literal, $q:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {
            run_rows(
                &Forward::<R, $d, $q, $p, $n, $g> { geometry: *geometry, records, value, slope, factors, derivatives },
                blocks,
            )
        };
    }
    sizes!(d, count, go)
}

/// lambda of every fit, and the records of all that a pair's adjoint reads of its other side.
struct Solving<'a, R, const D: usize, const Q: usize, const P: usize, const N: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    factors: &'a [R],
    derivatives: &'a [R],
    bar: &'a [R],
    lambda: Shared<'a, R>,
    records: Shared<'a, R>,
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const B: usize> RowKernel<R>
    for Solving<'_, R, D, Q, P, N, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let width = width::<R>();
        let fluid = &self.geometry.blocks.fluid;
        for block in rows {
            let base = block * const { self::rows(D, N) } * width;
            let mut part = 0;
            while part < width {
                let from = base + part;
                for field in 0..N {
                    let mut bar = [L::zero(); Q];
                    for a in 0..Q {
                        // SAFETY: every block has its rows.
                        bar[a] = unsafe { L::load(self.bar.as_ptr().add(from + (field * Q + a) * width)) };
                    }
                    let factor = load_factor::<R, L, P>(self.factors.as_ptr(), block, part, kind(D, N, field));
                    let lambda = solve::<L, Q, P>(&factor, bar);
                    for a in 0..Q {
                        // SAFETY: each block writes its own rows.
                        unsafe { self.lambda.store(from + (field * Q + a) * width, lambda[a]) };
                    }
                }
                // V = 1 / sum W.
                let last = from + N * Q * width;
                // SAFETY: as above.
                unsafe {
                    let volume = L::load(self.derivatives.as_ptr().add(last));
                    let bar = L::load(self.bar.as_ptr().add(last));
                    self.lambda.store(last, -(volume * volume * bar));
                    for d in 0..D {
                        let bar = L::load(self.bar.as_ptr().add(last + (1 + d) * width));
                        self.lambda.store(last + (1 + d) * width, bar);
                    }
                }
                part += L::COUNT;
            }
            for lane in 0..width {
                let place = block * width + lane;
                if place >= fluid.places {
                    break;
                }
                let i = fluid.members[place] as usize;
                // SAFETY: each fluid particle has one place, and writes its own record; the block's lambda is complete.
                let record = unsafe { self.records.slice(4 * B * i..4 * B * (i + 1)) };
                let lambda = |k: usize| unsafe { self.lambda.get(base + k * width + lane) };
                for k in 0..N * Q {
                    record[k] = lambda(k);
                    record[N * Q + k] = self.derivatives[base + k * width + lane];
                }
                for k in 0..1 + D {
                    record[2 * N * Q + k] = lambda(N * Q + k);
                }
            }
        }
    }
}

struct Backward<'a, R, const D: usize, const Q: usize, const N: usize, const G: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    records: &'a [R],
    bars: &'a [R],
    /// The fluid's particles, or the wall's.
    solid: bool,
    position_bar: Shared<'a, R>,
    fields_bar: Shared<'a, R>,
}

/// What a pair's two fits give to one of its sides.
struct PairBar<L, const D: usize, const N: usize> {
    position: [L; D],
    fields: [L; N],
}

/// A fit's lambda, d and the cotangents of sum W and c.
struct Fit<'a, L, const B: usize>(&'a [[L; 4]; B]);

impl<L: Lanes, const B: usize> Fit<'_, L, B> {
    /// What the fit around a particle makes of a neighbour at s, with its fields' differences to the particle's: adds
    /// W_bar, and gives s_bar over W and the lambda.q.
    #[inline(always)]
    fn of<const D: usize, const Q: usize, const N: usize>(
        &self,
        s: &[L; D],
        difference: &[L; N],
        weights: &[L; 4],
        value_bar: &mut L,
    ) -> ([L; D], [L; N]) {
        let q = values::<L, D, Q>(s);
        let mut toward = [L::zero(); Q];
        let mut along = [L::zero(); N];
        for field in 0..N {
            let (mut lambda, mut d) = ([L::zero(); Q], [L::zero(); Q]);
            for a in 0..Q {
                lambda[a] = get(self.0, field * Q + a);
                d[a] = get(self.0, (N + field) * Q + a);
            }
            let weight = weights[kind(D, N, field)];
            let l = weight * dot(&lambda, &q);
            let e = difference[field] - dot(&d, &q);
            let weighted = weight * e;
            *value_bar = l.mul_add(e, *value_bar);
            for a in 0..Q {
                toward[a] = (-d[a]).mul_add(l, lambda[a].mul_add(weighted, toward[a]));
            }
            along[field] = l;
        }
        *value_bar = weights[PRESSURE].mul_add(get(self.0, 2 * N * Q), *value_bar);
        (pull_back::<L, D, Q>(s, &toward), along)
    }

    /// What the fit of the temperature makes of a point at s, where no heat flows along n: adds W_bar, and gives s_bar and
    /// n_bar over W.
    #[inline(always)]
    fn of_no_flux<const D: usize, const Q: usize, const N: usize>(
        &self,
        s: &[L; D],
        n: &[L; D],
        weight: L,
        value_bar: &mut L,
    ) -> ([L; D], [L; D]) {
        let q = along::<L, D, Q>(s, n);
        let (mut lambda, mut d) = ([L::zero(); Q], [L::zero(); Q]);
        for a in 0..Q {
            lambda[a] = get(self.0, (N - 1) * Q + a);
            d[a] = get(self.0, (2 * N - 1) * Q + a);
        }
        let (l, slope) = (-(weight * dot(&lambda, &q)), dot(&d, &q));
        *value_bar = l.mul_add(slope, *value_bar);
        let toward_lambda = -(weight * slope);
        let mut toward = [L::zero(); Q];
        for a in 0..Q {
            toward[a] = toward_lambda.mul_add(lambda[a], l * d[a]);
        }
        pull_back_along::<L, D, Q>(s, n, &toward)
    }

    #[inline(always)]
    fn spread<const D: usize, const Q: usize, const N: usize>(&self) -> [L; D] {
        let mut spread = [L::zero(); D];
        for d in 0..D {
            spread[d] = get(self.0, 2 * N * Q + 1 + d);
        }
        spread
    }
}

impl<R: Real, const D: usize, const Q: usize, const N: usize, const G: usize, const B: usize>
    Backward<'_, R, D, Q, N, G, B>
{
    /// One pair's share of the cotangents of i's position and fields: from i's own fit if `OWN`, from the other's if `OTHER`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn pair<L: Lanes<Real = R>, const OWN: bool, const OTHER: bool>(
        &self,
        around: &Around<L, D>,
        own: &[[L; 4]; G],
        other: &[[L; 4]; G],
        own_bar: &[[L; 4]; B],
        other_bar: &[[L; 4]; B],
        weights: &[L; 4],
        sums: &mut PairBar<L, D, N>,
    ) {
        let (here, there) = (position::<L, D, G>(own), position::<L, D, G>(other));
        let (r, r2) = around.towards(&here, &there);
        let (w, f, g) = around.kernel.all(r2);
        let mut difference = [L::zero(); N];
        for field in 0..N {
            difference[field] = get(other, D + field) - get(own, D + field);
        }
        let mut value_bar = L::zero();
        let scaled = w * around.scale;
        if OWN {
            let fit = Fit(own_bar);
            let (s_bar, along) = fit.of::<D, Q, N>(&around.scaled(&r, 1.0), &difference, weights, &mut value_bar);
            for d in 0..D {
                sums.position[d] = (-scaled).mul_add(s_bar[d], sums.position[d]);
            }
            for field in 0..N {
                sums.fields[field] = (-w).mul_add(along[field], sums.fields[field]);
            }
            if N > D + 1 && !OTHER {
                let (s, n) = (around.scaled(&r, 1.0), normal::<L, D, G>(other));
                let (s_bar, _) = fit.of_no_flux::<D, Q, N>(&s, &n, weights[NO_FLUX], &mut value_bar);
                for d in 0..D {
                    sums.position[d] = (-scaled).mul_add(s_bar[d], sums.position[d]);
                }
            }
        }
        if OTHER {
            let mut back = difference;
            for field in 0..N {
                back[field] = -difference[field];
            }
            let fit = Fit(other_bar);
            let (s_bar, along) = fit.of::<D, Q, N>(&around.scaled(&r, -1.0), &back, weights, &mut value_bar);
            for d in 0..D {
                sums.position[d] = scaled.mul_add(s_bar[d], sums.position[d]);
            }
            for field in 0..N {
                sums.fields[field] = w.mul_add(along[field], sums.fields[field]);
            }
            if N > D + 1 && !OWN {
                let (s, n) = (around.scaled(&r, -1.0), normal::<L, D, G>(own));
                let (s_bar, n_bar) = fit.of_no_flux::<D, Q, N>(&s, &n, weights[NO_FLUX], &mut value_bar);
                for d in 0..D {
                    sums.position[d] = scaled.mul_add(s_bar[d], sums.position[d]);
                    sums.fields[d] = w.mul_add(n_bar[d], sums.fields[d]);
                }
            }
        }
        // dW/dr_i = F (r_i - r_j).
        let radial = f * value_bar;
        for d in 0..D {
            sums.position[d] = (-radial).mul_add(r[d], sums.position[d]);
        }
        if N > 1 && self.geometry.model.fits.shift.is_isotropic() {
            // c_i = sum F (r_i - r_j): a pair adds F gamma.(r_i - r_j).
            let (a, b) = (Fit(own_bar).spread::<D, Q, N>(), Fit(other_bar).spread::<D, Q, N>());
            let mut gamma = [L::zero(); D];
            for d in 0..D {
                if OWN {
                    gamma[d] += a[d];
                }
                if OTHER {
                    gamma[d] = gamma[d] - b[d];
                }
                gamma[d] = gamma[d] * weights[PRESSURE];
            }
            let along = dot(&gamma, &r) * g;
            for d in 0..D {
                sums.position[d] += f.mul_add(gamma[d], along * r[d]);
            }
        }
    }

    #[inline(always)]
    fn write<L: Lanes<Real = R>>(&self, table: &Table, place: usize, sums: &PairBar<L, D, N>) {
        let n = self.geometry.model.particles();
        // SAFETY (both): each place writes its own particle.
        for d in 0..D {
            table.scatter(place, sums.position[d], |i, bar| unsafe { self.position_bar.add(d * n + i, bar) });
        }
        for field in 0..N {
            table.scatter(place, sums.fields[field], |i, bar| unsafe { self.fields_bar.add(field * n + i, bar) });
        }
    }
}

impl<R: Real, const D: usize, const Q: usize, const N: usize, const G: usize, const B: usize> RowKernel<R>
    for Backward<'_, R, D, Q, N, G, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let around = Around::<L, D>::new(geometry);
        let blocks = geometry.blocks;
        let one = [L::splat(R::of(1.0)); 4];
        for block in rows {
            let mut part = 0;
            while part < width {
                let mut sums = PairBar { position: [L::zero(); D], fields: [L::zero(); N] };
                let table = if self.solid { &blocks.solid } else { &blocks.fluid };
                let place = block * width + part;
                let members = table.members[place..].as_ptr();
                // SAFETY (of every gather): as in the forward pass; the walls' cotangents are zero.
                let own = unsafe { gather::<L, G>(self.records.as_ptr(), members) };
                let own_bar = unsafe { gather::<L, B>(self.bars.as_ptr(), members) };
                let from = block * table.capacity * width + part;
                if self.solid {
                    let weights = unsafe { L::gather4(geometry.model.fits.weights.as_ptr(), 4, members) };
                    for k in 0..table.depth[block] as usize {
                        let index = unsafe { table.index.as_ptr().add(from + k * width) };
                        let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                        let other_bar = unsafe { gather::<L, B>(self.bars.as_ptr(), index) };
                        self.pair::<L, false, true>(&around, &own, &other, &own_bar, &other_bar, &weights, &mut sums);
                    }
                } else {
                    for k in 0..table.depth[block] as usize {
                        let index = unsafe { table.index.as_ptr().add(from + k * width) };
                        let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                        let other_bar = unsafe { gather::<L, B>(self.bars.as_ptr(), index) };
                        self.pair::<L, true, true>(&around, &own, &other, &own_bar, &other_bar, &one, &mut sums);
                    }
                    let wall = &blocks.wall;
                    let from = block * wall.capacity * width + part;
                    let count = counts::<L>(&wall.count[place..]);
                    for k in 0..wall.depth[block] as usize {
                        let index = unsafe { wall.index.as_ptr().add(from + k * width) };
                        let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
                        let mut weights = unsafe { L::gather4(geometry.model.fits.weights.as_ptr(), 4, index) };
                        // F is not zero where a particle stands in for the neighbours that it lacks: c must not notice.
                        weights[PRESSURE] = L::splat(R::of(k as f64)).select_less(count, weights[PRESSURE], L::zero());
                        self.pair::<L, true, false>(&around, &own, &other, &own_bar, &own_bar, &weights, &mut sums);
                    }
                }
                self.write::<L>(table, place, &sums);
                part += L::COUNT;
            }
        }
    }
}

/// The adjoint of [`forward`]: adds to the cotangents of positions `[D, N]` and fields `[fields, N]`.
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    kept: &Kept<R>,
    derivatives: &[R],
    derivatives_bar: &[R],
    position_bar: &mut [R],
    fields_bar: &mut [R],
) {
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    let (count, blocks) = (fields_bar.len() / n, geometry.blocks.fluid.blocks());
    let buffers = &geometry.model.scratch.buffers;
    let records = if count > 1 { &kept.records } else { &kept.pressure_records };
    let mut lambda = buffers.buffer(derivatives.len());
    let mut bars = buffers.buffer(stride(bar_fields(d, count)) * n);
    // Walls have no fit.
    bars.fill(R::default());
    macro_rules! go {
        ($d:literal, $q:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {{
            const { assert!(4 * $b == stride(bar_fields($d, $n)) && 4 * $g == stride($d + $n)) };
            let solving = Solving::<R, $d, $q, $p, $n, $b> {
                geometry: *geometry,
                factors: &kept.factors,
                derivatives,
                bar: derivatives_bar,
                lambda: Shared::new(&mut lambda),
                records: Shared::new(&mut bars),
            };
            run_rows(&solving, blocks);
            let (position_bar, fields_bar) = (Shared::new(position_bar), Shared::new(fields_bar));
            let mut backward = Backward::<R, $d, $q, $n, $g, $b> {
                geometry: *geometry,
                records,
                bars: &bars,
                solid: false,
                position_bar,
                fields_bar,
            };
            run_rows(&backward, blocks);
            backward.solid = true;
            run_rows(&backward, geometry.blocks.solid.blocks());
        }};
    }
    sizes!(d, count, go)
}
