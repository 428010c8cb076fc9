//! The adjoint of [`super::fit`]: cotangents of positions, given those of derivatives.
//!
//! Derivatives are sums over pairs, d_a = sum_j c_ja (f_j - f_i), so the cotangent of a coefficient c_ja is d_bar_a (f_j - f_i), summed
//! over fields; and over times where particles stay while the flow goes on, so that positions are looked at once, after all of
//! them.

use super::fit::{
    by_fit, fit, monomials_of, offset, Coefficients, Fit, Origin, Stencils, COEFFICIENTS, COEFFICIENTS_3D,
};
use crate::numerics::lanes::{array, Lanes, WIDEST};
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::{dot, monomials, packed, pull_back, solve, to_third};

/// Cotangents of all coefficients, `[blocks, K, C, WIDEST]`.
#[derive(Debug, Clone)]
pub struct PairCotangents<const C: usize = COEFFICIENTS> {
    value: Vec<f64>,
}

impl<const C: usize> PairCotangents<C> {
    pub fn zeros<const D: usize>(stencils: &Stencils<D>) -> Self {
        Self { value: vec![0.0; stencils.list.len() * C] }
    }

    /// Adds those of fields `[N]`, given the cotangents of all derivatives and S of each, or of the first B of them, `[fields][N][B]`.
    ///
    /// # Panics
    /// More than five fields.
    pub fn add<const D: usize, const B: usize>(
        &mut self,
        stencils: &Stencils<D>,
        fields: &[&[f64]],
        bar: &[Vec<[f64; B]>],
    ) {
        assert!(fields.len() <= FIELDS);
        let padded: Vec<Vec<f64>> = fields.iter().map(|field| stencils.padded_field(field)).collect();
        run_parts(&Collect::<D, B, C> { stencils, fields: &padded, bar }, stencils.parts(&mut self.value, C));
    }
}

impl<const C: usize> PairCotangents<C> {
    /// That of coefficient c of neighbour k of a particle.
    pub(super) fn of_pair<const D: usize>(
        &mut self,
        stencils: &Stencils<D>,
        (i, k): (usize, usize),
        c: usize,
    ) -> &mut f64 {
        &mut self.value[(stencils.row(i, k) * C + c) * WIDEST + i % WIDEST]
    }

    /// Those of the coefficients of `small`, whose neighbours are the first of those of `all`, given where the coefficients in all places are
    /// from. Those of `all` stay here; where `small` has no neighbours all do.
    pub(super) fn split<const D: usize>(
        &mut self,
        all: &Stencils<D>,
        small: &Stencils<D>,
        origins: impl Fn(usize) -> [Origin; C],
    ) -> Self {
        let mut found = Self::zeros(small);
        for block in 0..all.first.len() - 1 {
            let (from, to) = (all.first[block], small.first[block]);
            if small.first[block + 1] == to {
                continue;
            }
            for lane in 0..WIDEST {
                let origins = origins(block * WIDEST + lane);
                for k in 0..all.first[block + 1] - from {
                    let own = &mut self.value[(from + k) * C * WIDEST + lane..];
                    let [of_small, of_all] = by_fit(&origins, &std::array::from_fn(|c| own[c * WIDEST]));
                    (0..C).for_each(|c| own[c * WIDEST] = of_all[c]);
                    if k < small.first[block + 1] - to {
                        let other = &mut found.value[(to + k) * C * WIDEST + lane..];
                        (0..C).for_each(|c| other[c * WIDEST] = of_small[c]);
                    }
                }
            }
        }
        found
    }
}

/// Fields of a flow in space: three velocities, pressure and temperature.
const FIELDS: usize = 5;

struct Collect<'a, const D: usize, const B: usize, const C: usize> {
    stencils: &'a Stencils<D>,
    fields: &'a [Vec<f64>],
    bar: &'a [Vec<[f64; B]>],
}

impl<'a, const D: usize, const B: usize, const C: usize> PartKernel<f64> for Collect<'a, D, B, C> {
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let (stencils, count) = (self.stencils, self.fields.len());
        for l in (0..WIDEST).step_by(L::COUNT) {
            let mut numbers = [[[0.0; WIDEST]; B]; FIELDS];
            for f in 0..count {
                for lane in 0..L::COUNT {
                    let i = block * WIDEST + l + lane;
                    if i < stencils.particles {
                        let bar = &self.bar[f][i];
                        for a in 0..B {
                            numbers[f][a][lane] = bar[a];
                        }
                    }
                }
            }
            for k in 0..stencils.count(block * WIDEST) {
                let place = (stencils.first[block] + k) * WIDEST + l;
                let to = k * C * WIDEST + l;
                let mut sums: [L; B] = array(|a| L::load_part(&part[to + a * WIDEST..]));
                for f in 0..count {
                    let field = &self.fields[f];
                    // SAFETY: the tables have whole blocks, and the list names particles.
                    let other = unsafe { L::gather(field.as_ptr(), stencils.list.as_ptr().add(place)) };
                    let difference = other - L::load_part(&field[block * WIDEST + l..]);
                    for a in 0..B {
                        sums[a] = L::load_part(&numbers[f][a]).mul_add(difference, sums[a]);
                    }
                }
                for (a, sum) in sums.into_iter().enumerate() {
                    // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                    unsafe { sum.store(part[to + a * WIDEST..][..L::COUNT].as_mut_ptr()) };
                }
            }
        }
    }
}

impl<const D: usize> Stencils<D> {
    /// The cotangents of the distances of all pairs of blocks whose fits have Q monomials, `[blocks, K, D, WIDEST]`.
    fn pull_back_of<const Q: usize, const P: usize, const C: usize>(
        &self,
        position: &[Vec<f64>; D],
        known: &Known<'_, C>,
        pairs: &mut [f64],
    ) {
        let kernel = Backward::<D, Q, P, C> { stencils: self, position, known };
        run_parts(&kernel, self.parts(pairs, D));
    }

    /// Adds the cotangents of positions, given those of the distances of pairs.
    fn spread(&self, pairs: &[f64], position_bar: &mut [Vec<f64>; D]) {
        for i in 0..self.particles {
            for k in 0..self.count(i) {
                let j = self.neighbour(i, k);
                for d in 0..D {
                    let r_bar = pairs[((self.first[i / WIDEST] + k) * D + d) * WIDEST + i % WIDEST];
                    position_bar[d][j] += r_bar;
                    position_bar[d][i] -= r_bar;
                }
            }
        }
    }
}

/// What adjoints in a number of dimensions are made of.
macro_rules! in_dimension {
    ($dimension: literal, $coefficients: ident) => {
        impl Stencils<$dimension> {
            /// The cotangents of positions `[D][N]`, added to `position_bar`, given those of the derivatives of fields.
            ///
            /// `fields`: F of `[N]`; `bar`: `[F][N][C]`, the cotangents of all derivatives and S of each field.
            pub fn pull_back(
                &self,
                position: &[Vec<f64>; $dimension],
                fields: &[&[f64]],
                bar: &[Vec<[f64; $coefficients]>],
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                self.pull_back_known(position, Known::Fields(fields, bar), position_bar);
            }

            /// The same, given the cotangents of all pairs' coefficients.
            pub fn pull_back_pairs(
                &self,
                position: &[Vec<f64>; $dimension],
                pairs: &PairCotangents<$coefficients>,
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                self.pull_back_known(position, Known::Pairs(pairs), position_bar);
            }

            fn pull_back_known(
                &self,
                position: &[Vec<f64>; $dimension],
                known: Known<'_, $coefficients>,
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                const SECOND: usize = monomials($dimension);
                const THIRD: usize = to_third($dimension);
                let padded = self.padded(position);
                let mut pairs = vec![0.0; self.list.len() * $dimension];
                self.pull_back_of::<SECOND, { packed(SECOND) }, $coefficients>(&padded, &known, &mut pairs);
                if self.has_third() {
                    self.pull_back_of::<THIRD, { packed(THIRD) }, $coefficients>(&padded, &known, &mut pairs);
                }
                self.spread(&pairs, position_bar);
            }
        }
    };
}

in_dimension!(2, COEFFICIENTS);
in_dimension!(3, COEFFICIENTS_3D);

/// Parts of the particles whose sums are apart from each other, for any number of threads.
const PARTS: usize = 4;

impl<const C: usize> Coefficients<C> {
    /// The cotangents of fields `[N]` by those of their slopes at the first particles, `[fields][count]`.
    pub fn slopes_back<const D: usize>(&self, stencils: &Stencils<D>, slopes: &[Vec<[f64; D]>]) -> Vec<Vec<f64>> {
        let (n, count) = (stencils.particles, slopes.first().map_or(0, Vec::len));
        let share = count.div_ceil(WIDEST).div_ceil(PARTS) * WIDEST;
        let mut sums = vec![vec![vec![0.0; n]; slopes.len()]; PARTS];
        run_parts(&SlopesBack { coefficients: self, stencils, slopes, share }, sums.iter_mut());
        let mut parts = sums.into_iter();
        let mut all = parts.next().unwrap_or_default();
        for (to, from) in parts.flat_map(|part| part.into_iter().enumerate()) {
            all[to].iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
        all
    }
}

struct SlopesBack<'a, const D: usize, const C: usize> {
    coefficients: &'a Coefficients<C>,
    stencils: &'a Stencils<D>,
    slopes: &'a [Vec<[f64; D]>],
    /// Particles of a part.
    share: usize,
}

impl<'a, const D: usize, const C: usize> PartKernel<f64> for SlopesBack<'a, D, C> {
    /// `[fields][N]`.
    type Part = &'a mut Vec<Vec<f64>>;

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, number: usize, part: &mut Self::Part) {
        let (stencils, count) = (self.stencils, self.slopes[0].len());
        for i in number * self.share..count.min((number + 1) * self.share) {
            for k in 0..stencils.count(i) {
                let (c, j) = (self.coefficients.slope::<D>(i, k), stencils.neighbour(i, k));
                for (slopes, to) in self.slopes.iter().zip(part.iter_mut()) {
                    let mut sum = 0.0;
                    for e in 0..D {
                        sum += c[e] * slopes[i][e];
                    }
                    to[j] += sum;
                    to[i] -= sum;
                }
            }
        }
    }
}

/// What is known of the coefficients' cotangents: for each of some fields the numbers of particles and the cotangents of their
/// derivatives, or the sums of [`PairCotangents`].
enum Known<'a, const C: usize> {
    Fields(&'a [&'a [f64]], &'a [Vec<[f64; C]>]),
    Pairs(&'a PairCotangents<C>),
}

impl<const C: usize> Known<'_, C> {
    /// Number of products of a vector over the derivatives with one over the neighbours; sums of pairs have one for each derivative.
    fn products(&self) -> usize {
        match self {
            Self::Fields(fields, _) => fields.len(),
            Self::Pairs(_) => C,
        }
    }
}

struct Backward<'a, const D: usize, const Q: usize, const P: usize, const C: usize> {
    stencils: &'a Stencils<D>,
    position: &'a [Vec<f64>; D],
    known: &'a Known<'a, C>,
}

impl<'a, const D: usize, const Q: usize, const P: usize, const C: usize> PartKernel<f64> for Backward<'a, D, Q, P, C> {
    type Part = &'a mut [f64];

    /// With lambda = M^-1 d_bar and e_j = f_j - f_i - d.q_j: q_bar = W sum_f (lambda e - d (lambda.q)), where S adds
    /// -S_bar A sum_j W q to d_bar and -S_bar A W d to q_bar, A = 2 D / (h^2 sum W s^2).
    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let stencils = self.stencils;
        if stencils.is_third(block) != (Q > monomials(D)) {
            return;
        }
        let neighbours = stencils.count(block * WIDEST);
        for l in (0..WIDEST).step_by(L::COUNT) {
            let third = L::load_part(&stencils.third[block * WIDEST + l..]);
            let Fit { factor, inverse_scale, square, .. } = fit::<L, D, Q, P>(stencils, self.position, block, l);
            let second = inverse_scale * inverse_scale;
            for to in (0..D * neighbours).map(|k| k * WIDEST + l) {
                part[to..to + L::COUNT].fill(0.0);
            }
            for product in 0..self.known.products() {
                let derivative = |a: usize| match self.known {
                    Known::Fields(_, bar) => stencils.lanes(block, l, |i| bar[product][i][a]),
                    Known::Pairs(_) => L::splat(if a == product { 1.0 } else { 0.0 }),
                };
                let left = derivative(C - 1) * L::splat(2.0 * D as f64) * second / square;
                let own = match self.known {
                    Known::Fields(fields, _) => stencils.lanes(block, l, |i| fields[product][i]),
                    Known::Pairs(_) => L::zero(),
                };
                let difference = |k: usize| match self.known {
                    Known::Fields(fields, _) => {
                        let place = (stencils.first[block] + k) * WIDEST + l;
                        let mut numbers = [0.0; WIDEST];
                        for lane in 0..L::COUNT {
                            numbers[lane] = fields[product][stencils.list[place + lane] as usize];
                        }
                        L::load_part(&numbers[..]) - own
                    }
                    Known::Pairs(pairs) => {
                        L::load_part(&pairs.value[((stencils.first[block] + k) * C + product) * WIDEST + l..])
                    }
                };
                let (mut right, mut sum) = ([L::zero(); Q], [L::zero(); Q]);
                for k in 0..neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = monomials_of::<L, D, Q>(&s, third);
                    let weighted = w * difference(k);
                    for a in 0..Q {
                        right[a] = weighted.mul_add(q[a], right[a]);
                        sum[a] = w.mul_add(q[a], sum[a]);
                    }
                }
                let d = solve::<L, Q, P>(&factor, right);
                let mut d_bar = [L::zero(); Q];
                for (a, d_bar) in d_bar.iter_mut().enumerate() {
                    *d_bar = -(left * sum[a]);
                    if a < C - 1 {
                        let unit = if a < D { inverse_scale } else { second };
                        *d_bar = derivative(a) * unit + *d_bar;
                    }
                }
                let lambda = solve::<L, Q, P>(&factor, d_bar);
                // The cotangent of sum W s^2.
                let mut rest = L::zero();
                for k in 0..neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = monomials_of::<L, D, Q>(&s, third);
                    rest = w.mul_add(difference(k) - dot(&d, &q), rest);
                }
                let square_bar = -(left * rest) / square;
                for k in 0..neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = monomials_of::<L, D, Q>(&s, third);
                    let (error, along) = (difference(k) - dot(&d, &q), dot(&lambda, &q));
                    let mut q_bar = [L::zero(); Q];
                    for a in 0..Q {
                        q_bar[a] = w * (lambda[a] * error - d[a] * along - left * d[a]);
                    }
                    (monomials(D)..Q).for_each(|a| q_bar[a] = q_bar[a] * third);
                    let s_bar = pull_back::<L, D, Q>(&s, &q_bar);
                    for d in 0..D {
                        let to = (D * k + d) * WIDEST + l;
                        let value = (s_bar[d] + L::splat(2.0) * square_bar * w * s[d]) * inverse_scale;
                        let sum = L::load_part(&part[to..to + L::COUNT]) + value;
                        // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                        unsafe { sum.store(part[to..to + L::COUNT].as_mut_ptr()) };
                    }
                }
            }
        }
    }
}
