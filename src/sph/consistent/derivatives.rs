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

use super::blocks::{load, store, vectors, width, OfParticles, Place, Table};
use super::geometry::{Around, Geometry};
use super::kept::Kept;
use super::kinds::{kind, rows, KINDS, NO_FLUX, PRESSURE, TEMPERATURE};
use super::stencil::{accumulate, along, dot, factorise, monomials, packed, pull_back, pull_back_along, solve, values};
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::fit;
use crate::numerics::sweep::{clear, run_each, run_rows, RowKernel};
use crate::sph::own::Own;
use crate::sph::pairs::{get, stride, vector, Records};
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

/// With more than one field (all of them) the matrices are made here, for one (the new pressure) they are there.
struct Forward<'a, R, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize> {
    geometry: Geometry<'a, R>,
    /// Position and fields of every particle, `[N, 4 G]`.
    records: Records<'a, R>,
    /// W and F of the fluid's pairs, as the table's index, and the matrices, `[blocks, KINDS, P, width]`, where they are made.
    made: [Own<'a, R>; 3],
    /// W of the fluid's pairs and the matrices, where they are there.
    value: &'a [R],
    factors: &'a [R],
    /// `[blocks, rows, width]`.
    derivatives: Own<'a, R>,
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize> RowKernel<R>
    for Forward<'_, R, D, Q, P, N, G>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for place in vectors::<L>(rows) {
            if N > 1 {
                self.with_matrices::<L>(place);
            } else {
                self.again::<L>(place);
            }
        }
    }
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const G: usize>
    Forward<'_, R, D, Q, P, N, G>
{
    #[inline(always)]
    fn with_matrices<L: Lanes<Real = R>>(&self, place: usize) {
        let geometry = &self.geometry;
        let around = Around::<L, D>::new(geometry);
        let (fluid, wall) = (&geometry.blocks.fluid, &geometry.blocks.wall);
        let isotropic = geometry.model.fits.shift.is_isotropic();
        let [value, slope, factors] = &self.made;
        let own = self.records.groups::<L, G>(fluid.own(place));
        let mut matrix = [L::zero(); P];
        let mut right = [[L::zero(); Q]; N];
        let (mut sum, mut spread) = (L::zero(), [L::zero(); D]);
        for pair in fluid.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, r2) = around.towards(&own, &other);
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
            value.store(pair.at, w);
            slope.store(pair.at, f);
        }
        let lacking = |table: &Table| L::splat(R::of(table.depth::<R>(place) as f64)) - table.counts::<L>(place);
        let mut padding = lacking(fluid);
        let mut matrices = [matrix; KINDS];
        let has_walls = wall.depth::<R>(place) > 0;
        if has_walls {
            for pair in wall.pairs_of::<L>(place) {
                let other = self.records.groups::<L, G>(pair.names);
                let weights = around.weights(pair.names);
                let (r, r2) = around.towards(&own, &other);
                let (w, f, _) = around.kernel.all(r2);
                let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
                for kind in 0..KINDS {
                    accumulate::<L, Q, P>(&mut matrices[kind], w * weights[kind], &q);
                }
                if N > D + 1 {
                    let q = along::<L, D, Q>(&around.scaled(&r, 1.0), &vector(&other, D));
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
            padding += lacking(wall);
        }
        // A particle stands in for the neighbours that it lacks: nothing but sum W notices.
        let at_zero = L::splat(R::of(geometry.model.kernel.at_zero()));
        let sum = at_zero.mul_add(L::splat(R::of(1.0)) - padding, sum);
        let least = L::splat(R::of(LEAST_PIVOT)) * sum;
        if has_walls {
            for kind in 0..KINDS {
                factorise::<L, Q, P>(&mut matrices[kind], least);
            }
        } else {
            factorise::<L, Q, P>(&mut matrices[0], least);
            matrices[1] = matrices[0];
            matrices[2] = matrices[0];
        }
        for kind in 0..KINDS {
            store(factors, Place::of::<R>(place, const { KINDS * P }), kind * P, matrices[kind]);
        }
        let to = Place::of::<R>(place, const { self::rows(D, N) });
        for field in 0..N {
            let d = solve::<L, Q, P>(&matrices[kind(D, N, field)], right[field]);
            store(&self.derivatives, to, field * Q, d);
        }
        store(&self.derivatives, to, N * Q, [L::splat(R::of(1.0)) / sum]);
        store(&self.derivatives, to, N * Q + 1, spread);
    }

    /// With the matrices and the fluid's W of the pass before.
    #[inline(always)]
    fn again<L: Lanes<Real = R>>(&self, place: usize) {
        let around = Around::<L, D>::new(&self.geometry);
        let (fluid, wall) = (&self.geometry.blocks.fluid, &self.geometry.blocks.wall);
        let own = self.records.groups::<L, G>(fluid.own(place));
        let mut right = [[L::zero(); Q]; N];
        for (pair, w) in fluid.pairs_with::<L>(place, self.value) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, _) = around.towards(&own, &other);
            let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
            add_right::<L, D, Q, N, G>(&mut right, [w; N], &q, &own, &other);
        }
        for pair in wall.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, r2) = around.towards(&own, &other);
            let w = around.kernel.value(r2);
            let q = values::<L, D, Q>(&around.scaled(&r, 1.0));
            let weights = of_fields::<L, D, N>(w, &around.weights(pair.names));
            add_right::<L, D, Q, N, G>(&mut right, weights, &q, &own, &other);
        }
        let to = Place::of::<R>(place, const { self::rows(D, N) });
        for field in 0..N {
            let factor = load_factor::<L, P>(self.factors, place, kind(D, N, field));
            store(&self.derivatives, to, field * Q, solve::<L, Q, P>(&factor, right[field]));
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
fn load_factor<L: Lanes, const P: usize>(factors: &[L::Real], place: usize, kind: usize) -> [L; P] {
    load(factors, Place::of::<L::Real>(place, const { KINDS * P }), kind * P)
}

/// Particles whose records are packed field by field: as many as stay in a core's first cache.
const PACKED_TOGETHER: usize = 128;

/// Packs positions and fields `[fields, N]` into records.
pub(super) fn pack<R: Real>(geometry: &Geometry<'_, R>, position: &[R], fields: &[R], records: &mut Vec<R>) {
    let n = geometry.model.particles();
    let d = geometry.model.layout.dimension;
    let count = fields.len() / n;
    let stride = stride(d + count);
    records.resize(stride * n, R::default());
    let records = Own::new(records);
    run_each(n.div_ceil(PACKED_TOGETHER), |piece| {
        let some = piece * PACKED_TOGETHER..n.min((piece + 1) * PACKED_TOGETHER);
        // SAFETY: the records of a piece are its own.
        let records = unsafe { records.slice(some.start * stride..some.end * stride) };
        for k in 0..d + count {
            let of = if k < d { &position[k * n..] } else { &fields[(k - d) * n..] };
            for (record, value) in records.chunks_exact_mut(stride).zip(&of[some.clone()]) {
                record[k] = *value;
            }
        }
    });
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
        let changes = geometry.model.part.is_some();
        fit(&mut kept.value, geometry.blocks.fluid.pairs(), changes);
        fit(&mut kept.slope, geometry.blocks.fluid.pairs(), changes);
        kept.factors.resize(blocks * KINDS * packed(monomials(d)) * width::<R>(), R::default());
    }
    derivatives.resize(blocks * rows(d, count) * width::<R>(), R::default());
    let records = if first { &kept.records } else { &kept.pressure_records };
    let records = Records::new(records, stride(d + count), n);
    let (factors, derivatives) = (&mut kept.factors, Own::new(derivatives));
    let (made, value, factors): ([&mut [R]; 3], &[R], &[R]) = match first {
        true => ([&mut kept.value, &mut kept.slope, factors], &[], &[]),
        false => ([&mut [], &mut [], &mut []], &kept.value, factors),
    };
    let (geometry, made) = (*geometry, made.map(Own::new));
    macro_rules! go {
        ($d:literal, $q:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {
            run_rows(&Forward::<R, $d, $q, $p, $n, $g> { geometry, records, made, value, factors, derivatives }, blocks)
        };
    }
    sizes!(d, count, go)
}

/// lambda of every fit, as the records of all that a pair's adjoint reads of its other side.
struct Solving<'a, R, const D: usize, const Q: usize, const P: usize, const N: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    factors: &'a [R],
    derivatives: &'a [R],
    bar: &'a [R],
    records: OfParticles<'a, R>,
}

impl<R: Real, const D: usize, const Q: usize, const P: usize, const N: usize, const B: usize> RowKernel<R>
    for Solving<'_, R, D, Q, P, N, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (fluid, to) = (&self.geometry.blocks.fluid, &self.records);
        for place in vectors::<L>(rows) {
            let at = Place::of::<R>(place, const { self::rows(D, N) });
            for field in 0..N {
                let factor = load_factor::<L, P>(self.factors, place, kind(D, N, field));
                let lambda = solve::<L, Q, P>(&factor, load(self.bar, at, field * Q));
                let d = load::<L, Q>(self.derivatives, at, field * Q);
                for a in 0..Q {
                    to.set(fluid, place, [field * Q + a, 4 * B], lambda[a]);
                    to.set(fluid, place, [(N + field) * Q + a, 4 * B], d[a]);
                }
            }
            // V = 1 / sum W.
            let ([volume], [bar]) = (load::<L, 1>(self.derivatives, at, N * Q), load(self.bar, at, N * Q));
            to.set(fluid, place, [2 * N * Q, 4 * B], -(volume * volume * bar));
            let spread_bar = load::<L, D>(self.bar, at, N * Q + 1);
            for d in 0..D {
                to.set(fluid, place, [2 * N * Q + 1 + d, 4 * B], spread_bar[d]);
            }
        }
    }
}

struct Backward<'a, R, const D: usize, const Q: usize, const N: usize, const G: usize, const B: usize> {
    geometry: Geometry<'a, R>,
    records: Records<'a, R>,
    bars: Records<'a, R>,
    /// The fluid's particles, or the wall's.
    solid: bool,
    position_bar: OfParticles<'a, R>,
    fields_bar: OfParticles<'a, R>,
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
            let (lambda, d): ([L; Q], [L; Q]) = (vector(self.0, field * Q), vector(self.0, (N + field) * Q));
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
        let (lambda, d): ([L; Q], [L; Q]) = (vector(self.0, (N - 1) * Q), vector(self.0, (2 * N - 1) * Q));
        let (l, slope) = (-(weight * dot(&lambda, &q)), dot(&d, &q));
        *value_bar = l.mul_add(slope, *value_bar);
        let toward_lambda = -(weight * slope);
        let mut toward = [L::zero(); Q];
        for a in 0..Q {
            toward[a] = toward_lambda.mul_add(lambda[a], l * d[a]);
        }
        pull_back_along::<L, D, Q>(s, n, &toward)
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
        around: &Around<'_, L, D>,
        own: &[[L; 4]; G],
        other: &[[L; 4]; G],
        own_bar: &[[L; 4]; B],
        other_bar: &[[L; 4]; B],
        weights: &[L; 4],
        sums: &mut PairBar<L, D, N>,
    ) {
        let (r, r2) = around.towards(own, other);
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
                let (s, n) = (around.scaled(&r, 1.0), vector(other, D));
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
                let (s, n) = (around.scaled(&r, -1.0), vector(own, D));
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
            let at = 2 * N * Q + 1;
            let (a, b): ([L; D], [L; D]) = (vector(own_bar, at), vector(other_bar, at));
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
}

impl<R: Real, const D: usize, const Q: usize, const N: usize, const G: usize, const B: usize> RowKernel<R>
    for Backward<'_, R, D, Q, N, G, B>
{
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (n, blocks) = (self.geometry.model.particles(), self.geometry.blocks);
        let around = Around::<L, D>::new(&self.geometry);
        let one = [L::splat(R::of(1.0)); 4];
        let table = if self.solid { &blocks.solid } else { &blocks.fluid };
        for place in vectors::<L>(rows) {
            let mut sums = PairBar { position: [L::zero(); D], fields: [L::zero(); N] };
            let members = table.own(place);
            // (The walls' cotangents are zero.)
            let (own, own_bar) = (self.records.groups::<L, G>(members), self.bars.groups::<L, B>(members));
            if self.solid {
                let weights = around.weights(members);
                for pair in table.pairs_of::<L>(place) {
                    let (other, other_bar) = (self.records.groups(pair.names), self.bars.groups(pair.names));
                    self.pair::<L, false, true>(&around, &own, &other, &own_bar, &other_bar, &weights, &mut sums);
                }
            } else {
                for pair in table.pairs_of::<L>(place) {
                    let (other, other_bar) = (self.records.groups(pair.names), self.bars.groups(pair.names));
                    self.pair::<L, true, true>(&around, &own, &other, &own_bar, &other_bar, &one, &mut sums);
                }
                let counts = blocks.wall.counts::<L>(place);
                for pair in blocks.wall.pairs_of::<L>(place) {
                    let (other, mut weights) = (self.records.groups(pair.names), around.weights(pair.names));
                    // F is not zero where a particle stands in for the neighbours that it lacks: c must not notice.
                    weights[PRESSURE] = pair.there(counts, weights[PRESSURE]);
                    self.pair::<L, true, false>(&around, &own, &other, &own_bar, &own_bar, &weights, &mut sums);
                }
            }
            for d in 0..D {
                self.position_bar.add(table, place, d * n, sums.position[d]);
            }
            for field in 0..N {
                self.fields_bar.add(table, place, field * n, sums.fields[field]);
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
    let mut bars = buffers.buffer(stride(bar_fields(d, count)) * n);
    // Walls have no fit.
    clear(&mut bars);
    macro_rules! go {
        ($d:literal, $q:literal, $p:literal, $n:literal, $g:literal, $b:literal) => {{
            const { assert!(4 * $b == stride(bar_fields($d, $n)) && 4 * $g == stride($d + $n)) };
            let solving = Solving::<R, $d, $q, $p, $n, $b> {
                geometry: *geometry,
                factors: &kept.factors,
                derivatives,
                bar: derivatives_bar,
                records: OfParticles::new(&mut bars),
            };
            run_rows(&solving, blocks);
            geometry.model.refresh_records(&mut bars, 4 * $b, 0, bar_fields($d, $n));
            let mut backward = Backward::<R, $d, $q, $n, $g, $b> {
                geometry: *geometry,
                records: Records::new(records, 4 * $g, n),
                bars: Records::new(&bars, 4 * $b, n),
                solid: false,
                position_bar: OfParticles::new(position_bar),
                fields_bar: OfParticles::new(fields_bar),
            };
            run_rows(&backward, blocks);
            backward.solid = true;
            run_rows(&backward, geometry.blocks.solid.blocks());
        }};
    }
    sizes!(d, count, go)
}
