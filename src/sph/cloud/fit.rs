//! Derivatives at fixed particles by fits of second or third order, with weights that do not depend on the shape.
//!
//! Every particle i has the K nearest particles of the reference cloud as neighbours, with weights
//! W = (1 - q)^4 (1 + 4 q), q = r0 / R_i, of their reference distances r0, R_i the distance of neighbour K + 1. Lists and
//! weights are constants; only the moments see the positions:
//!
//! ```text
//!   M = sum_j W q q^T,   c_j = W M^-1 q(r_ij / h_i),   d = sum_j c_j (f_j - f_i)
//! ```
//!
//! (see [`crate::sph::consistent::stencil`] for q), so all derivatives are rational functions of the positions. Besides them
//! each particle has what the fit leaves of its neighbours' values, scaled as a Laplacian,
//!
//! ```text
//!   S f = 2 D / (h^2 sum_j W s^2) sum_j W (f_j - f_i - d.q),   s = r_ij / h_i,
//! ```
//!
//! which vanishes for quadratic fields, is of fourth order for smooth ones, and sees a checkerboard. In space a fit may be of third
//! order, with the monomials of [`crate::sph::consistent::stencil::to_third`]; its S vanishes for cubic fields.
//!
//! Tables of pairs are `[blocks, K, WIDEST]` (K of each block), those of particles `[blocks, fields, WIDEST]`: a block is WIDEST particles.

use super::nearest::Region;
use crate::numerics::lanes::{array, Lanes, WIDEST};
use crate::numerics::sparse_lu::BlockMatrix;
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::{
    accumulate, at, dot, factorise, laplacian, monomials, packed, solve, to_third, values,
};

/// Coefficients of a pair in the plane: the derivatives x, y, xx, xy, yy, and S.
pub const COEFFICIENTS: usize = monomials(2) + 1;
/// The index of S.
pub const LEFT: usize = monomials(2);
/// The same in space: x, y, z, xx, xy, xz, yy, yz, zz, and S.
pub const COEFFICIENTS_3D: usize = monomials(3) + 1;
pub const LEFT_3D: usize = monomials(3);
/// The scale of a fit in R.
const SCALE: f64 = 2.5;

/// R and h of a fit, given the distance of the first neighbour that is left out.
pub(super) fn reach_and_scale(distance: f64) -> (f64, f64) {
    let reach = 1.0001 * distance;
    (reach, reach / SCALE)
}

/// W of a neighbour at a distance of q R.
pub(super) fn weight(q: f64) -> f64 {
    (1.0 - q).powi(4) * (1.0 + 4.0 * q)
}

/// W of a neighbour at a distance, and what is added to the difference of two places where the neighbour is a periodic image.
pub(super) fn weight_and_shift<const D: usize>(
    plane: Region<D>,
    [own, to]: [[f64; D]; 2],
    distance: f64,
    reach: f64,
) -> (f64, [f64; D]) {
    let r = plane.between(own, to);
    (weight(distance / reach), std::array::from_fn(|d| r[d] - (to[d] - own[d])))
}

/// The stencils of all particles: neighbours, weights and scales of the reference cloud.
#[derive(Debug, Clone)]
pub struct Stencils<const D: usize = 2> {
    pub particles: usize,
    /// The largest number of neighbours, K.
    pub neighbours: usize,
    /// Rows of pairs before each block, `[blocks + 1]`.
    pub(super) first: Vec<usize>,
    pub list: Vec<u32>,
    /// What is added to r_ij where the neighbour is a periodic image, `[D][blocks, K, WIDEST]`; empty along axes that are not periodic.
    shift: [Vec<f64>; D],
    weight: Vec<f64>,
    /// h_i, `[blocks, WIDEST]`.
    scale: Vec<f64>,
    /// 1 for a fit of third order, 0 for one of second order, `[blocks, WIDEST]`.
    pub(super) third: Vec<f64>,
}

/// Rows of a table of pairs: the number of particles rounded up to whole blocks.
pub fn blocks(particles: usize) -> usize {
    particles.div_ceil(WIDEST)
}

/// Place of field `k` of `fields` of particle i in a table of particles.
#[inline(always)]
pub fn field(fields: usize, i: usize, k: usize) -> usize {
    (i / WIDEST * fields + k) * WIDEST + i % WIDEST
}

impl<const D: usize> Stencils<D> {
    /// A matrix of zeros for equations of `size` fields at the particles, in which those of each contain its neighbours.
    pub fn matrix(&self, size: usize) -> BlockMatrix {
        self.matrix_of(size, |i| self.count(i))
    }

    /// The same with the nearest `count` neighbours of each.
    pub(super) fn matrix_of(&self, size: usize, count: impl Fn(usize) -> usize) -> BlockMatrix {
        let neighbours = |i: usize| (0..count(i)).map(|k| self.neighbour(i, k) as u32).collect();
        BlockMatrix::of_lists(self.particles, size, neighbours)
    }

    /// The stencils of particles at `places`, of `count` neighbours each, given the distance and number of those `near` each, nearest
    /// first. In space fits may be of third order.
    ///
    /// # Errors
    /// A particle with fewer than `count + 1` of them.
    pub fn new<'a>(
        plane: Region<D>,
        places: &[[f64; D]],
        count: impl Fn(usize) -> usize,
        is_third: impl Fn(usize) -> bool,
        near: impl Fn(usize) -> &'a [(f64, u32)],
    ) -> Result<Self, usize> {
        let (n, all_blocks) = (places.len(), blocks(places.len()));
        let mut first = vec![0];
        for block in 0..all_blocks {
            let own = (block * WIDEST..n.min((block + 1) * WIDEST)).map(&count).max();
            first.push(first[block] + own.unwrap_or(0));
        }
        let pairs = first[all_blocks] * WIDEST;
        let mut all = Self {
            particles: n,
            neighbours: (0..n).map(&count).max().unwrap_or(0),
            list: vec![0; pairs],
            first,
            shift: plane.periodic.map(|is_periodic| vec![0.0; if is_periodic { pairs } else { 0 }]),
            weight: vec![0.0; pairs],
            scale: vec![1.0; all_blocks * WIDEST],
            third: vec![0.0; all_blocks * WIDEST],
        };
        // Lanes behind the last particle repeat it, so that their numbers are finite.
        for lane in 0..all_blocks * WIDEST {
            let i = lane.min(n - 1);
            let (found, neighbours) = (near(i), count(i));
            if found.len() <= neighbours {
                return Err(i);
            }
            let (reach, scale) = reach_and_scale(found[neighbours].0);
            all.scale[lane] = scale;
            all.third[lane] = if is_third(i) { 1.0 } else { 0.0 };
            for k in 0..all.count(lane) {
                let place = all.place(lane, k);
                // Where others of the block have more neighbours, a particle is its own, with weight 0.
                let (distance, j) = if k < neighbours { found[k] } else { (reach, i as u32) };
                let (weight, shift) = weight_and_shift(plane, [places[i], places[j as usize]], distance, reach);
                all.list[place] = j;
                all.weight[place] = weight;
                (0..D).filter(|&d| plane.periodic[d]).for_each(|d| all.shift[d][place] = shift[d]);
            }
        }
        Ok(all)
    }

    /// Whether fits of third order are among them.
    pub(super) fn has_third(&self) -> bool {
        self.third.contains(&1.0)
    }

    /// The same of a block.
    #[inline(always)]
    pub(super) fn is_third(&self, block: usize) -> bool {
        self.third[block * WIDEST..(block + 1) * WIDEST].contains(&1.0)
    }

    /// Number of neighbours of particle i, with those that fill up its block.
    pub fn count(&self, i: usize) -> usize {
        self.first[i / WIDEST + 1] - self.first[i / WIDEST]
    }

    /// Row of neighbour k of the block of particle i in a table of pairs.
    #[inline(always)]
    pub(super) fn row(&self, i: usize, k: usize) -> usize {
        self.first[i / WIDEST] + k
    }

    /// Place of particle i and neighbour k in a table of pairs.
    #[inline(always)]
    fn place(&self, i: usize, k: usize) -> usize {
        self.row(i, k) * WIDEST + i % WIDEST
    }

    /// A table of `width` numbers for each pair, cut into blocks.
    pub(super) fn parts<'a>(&self, mut table: &'a mut [f64], width: usize) -> Vec<&'a mut [f64]> {
        let mut parts = vec![];
        for block in 0..self.first.len() - 1 {
            let (part, rest) = table.split_at_mut((self.first[block + 1] - self.first[block]) * width * WIDEST);
            parts.push(part);
            table = rest;
        }
        parts
    }

    pub fn neighbour(&self, i: usize, k: usize) -> usize {
        self.list[self.place(i, k)] as usize
    }

    /// Neighbour k of the particles from lane `l` of a block on.
    #[inline(always)]
    pub(super) fn neighbours_from(&self, (block, l, k): (usize, usize, usize)) -> *const u32 {
        self.list[(self.first[block] + k) * WIDEST + l..].as_ptr()
    }

    /// Numbers of the particles from lane `l` of a block on; 0 behind the last one.
    #[inline(always)]
    pub(super) fn lanes<L: Lanes<Real = f64>>(&self, block: usize, l: usize, of: impl Fn(usize) -> f64) -> L {
        let mut numbers = [0.0; WIDEST];
        for (lane, number) in numbers[..L::COUNT].iter_mut().enumerate() {
            let i = block * WIDEST + l + lane;
            *number = if i < self.particles { of(i) } else { 0.0 };
        }
        L::load_part(&numbers[..])
    }

    /// The scale h of a particle's fit.
    pub fn scale(&self, i: usize) -> f64 {
        self.scale[i]
    }

    /// Neighbour, weight and constant shift of a pair.
    pub fn pair(&self, i: usize, k: usize) -> (usize, f64, [f64; D]) {
        let place = self.place(i, k);
        (
            self.list[place] as usize,
            self.weight[place],
            self.shift.each_ref().map(|shift| shift.get(place).copied().unwrap_or(0.0)),
        )
    }

    /// C coefficients of all pairs of blocks whose fits have Q monomials, with P numbers in their matrix, for positions of whole blocks.
    fn coefficients_of<const Q: usize, const P: usize, const C: usize>(
        &self,
        position: &[Vec<f64>; D],
        value: &mut [f64],
    ) {
        run_parts(&Forward::<D, Q, P, C> { stencils: self, position }, self.parts(value, C));
    }

    /// The first particle whose `nearest` neighbours are not apart and on their side, by 0.4 of their distance at the reference `places`
    /// along it, at positions `[D][N]`.
    pub fn folded(&self, places: &[[f64; D]], position: &[Vec<f64>; D], nearest: usize) -> Option<[f64; D]> {
        let is_folded = |i: usize| {
            (0..nearest).any(|k| {
                let (j, _, shift) = self.pair(i, k);
                let (mut square, mut along) = (0.0, 0.0);
                for d in 0..D {
                    let before = places[j][d] - places[i][d] + shift[d];
                    square += before * before;
                    along += before * (position[d][j] - position[d][i] + shift[d]);
                }
                along.is_nan() || along < 0.4 * square
            })
        };
        let found = (0..self.particles).find(|&i| is_folded(i))?;
        Some(std::array::from_fn(|d| position[d][found]))
    }

    /// A field with whole blocks.
    pub(super) fn padded_field(&self, field: &[f64]) -> Vec<f64> {
        let mut padded = Vec::with_capacity(blocks(self.particles) * WIDEST);
        padded.extend_from_slice(field);
        padded.resize(blocks(self.particles) * WIDEST, field[self.particles - 1]);
        padded
    }

    pub(super) fn padded(&self, position: &[Vec<f64>; D]) -> [Vec<f64>; D] {
        std::array::from_fn(|d| self.padded_field(&position[d]))
    }
}

/// What fits in a number of dimensions are made of.
macro_rules! in_dimension {
    ($dimension: literal, $coefficients: ident) => {
        impl Stencils<$dimension> {
            /// The coefficients of all pairs for positions `[D][N]`, `[blocks, K, C, WIDEST]`.
            pub fn coefficients(&self, position: &[Vec<f64>; $dimension]) -> Coefficients<$coefficients> {
                const SECOND: usize = monomials($dimension);
                const THIRD: usize = to_third($dimension);
                let padded = self.padded(position);
                let mut value = vec![0.0; self.list.len() * $coefficients];
                self.coefficients_of::<SECOND, { packed(SECOND) }, $coefficients>(&padded, &mut value);
                if self.has_third() {
                    self.coefficients_of::<THIRD, { packed(THIRD) }, $coefficients>(&padded, &mut value);
                }
                Coefficients { first: self.first.clone(), value }
            }
        }
    };
}

in_dimension!(2, COEFFICIENTS);
in_dimension!(3, COEFFICIENTS_3D);

/// Which derivative is in a place, where a particle has two fits: one of the smaller fit, or one of the one with all neighbours.
#[derive(Debug, Clone, Copy)]
pub(super) enum Origin {
    Small(usize),
    All(usize),
}

/// The cotangents of a particle's derivatives by the smaller fit and by the other one, given those of its places.
pub(super) fn by_fit<const C: usize>(origins: &[Origin; C], bar: &[f64; C]) -> [[f64; C]; 2] {
    let mut found = [[0.0; C]; 2];
    for (origin, bar) in origins.iter().zip(bar) {
        match *origin {
            Origin::Small(c) => found[0][c] = *bar,
            Origin::All(c) => found[1][c] = *bar,
        }
    }
    found
}

/// The coefficients of all pairs.
#[derive(Debug, Clone, Default)]
pub struct Coefficients<const C: usize = COEFFICIENTS> {
    first: Vec<usize>,
    value: Vec<f64>,
}

impl<const C: usize> Coefficients<C> {
    /// Replaces those of every particle i by what is to be in their places, of these and of the `small` fit, whose `count(i)` neighbours are
    /// the first of this one's; where it has none they stay.
    pub(super) fn take(
        &mut self,
        small: &Self,
        count: impl Fn(usize) -> usize,
        origins: impl Fn(usize) -> [Origin; C],
    ) {
        for i in (0..(self.first.len() - 1) * WIDEST).filter(|&i| count(i) > 0) {
            let (block, origins) = (i / WIDEST, origins(i));
            for k in 0..self.first[block + 1] - self.first[block] {
                let first = (self.first[block] + k) * C * WIDEST + i % WIDEST;
                let own = self.of(i, k);
                let of_small = if k < count(i) { small.of(i, k) } else { [0.0; C] };
                for (c, origin) in origins.iter().enumerate() {
                    self.value[first + c * WIDEST] = match *origin {
                        Origin::Small(from) => of_small[from],
                        Origin::All(from) => own[from],
                    };
                }
            }
        }
    }

    /// First and second derivatives (x, y, xx, xy, yy) and S of neighbour k of particle i.
    #[inline(always)]
    pub fn of(&self, i: usize, k: usize) -> [f64; C] {
        let first = (self.first[i / WIDEST] + k) * C * WIDEST + i % WIDEST;
        std::array::from_fn(|c| self.value[first + c * WIDEST])
    }

    /// The first D of [`Self::of`].
    #[inline(always)]
    pub(super) fn slope<const D: usize>(&self, i: usize, k: usize) -> [f64; D] {
        let first = (self.first[i / WIDEST] + k) * C * WIDEST + i % WIDEST;
        std::array::from_fn(|d| self.value[first + d * WIDEST])
    }

    /// Slopes, the Laplacian and S of neighbour k of the particles from lane `l` of a block on.
    #[inline(always)]
    pub(super) fn sums_from<L: Lanes<Real = f64>, const D: usize, const F: usize>(
        &self,
        (block, l, k): (usize, usize, usize),
    ) -> [L; F] {
        let first = ((self.first[block] + k) * C) * WIDEST + l;
        let of = |c: usize| L::load_part(&self.value[first + c * WIDEST..]);
        array(|f| match f {
            slope if slope < D => of(slope),
            left if left == F - 1 => of(C - 1),
            _ => laplacian::<L, D>(of),
        })
    }

    /// The derivatives of a field at particle i.
    pub fn derivatives<const D: usize>(&self, stencils: &Stencils<D>, i: usize, value: &[f64]) -> [f64; C] {
        let mut sum = [0.0; C];
        for k in 0..stencils.count(i) {
            let (c, difference) = (self.of(i, k), value[stencils.neighbour(i, k)] - value[i]);
            (0..C).for_each(|a| sum[a] += c[a] * difference);
        }
        sum
    }
}

impl<const C: usize> Coefficients<C> {
    /// Adds the cotangents of a field `[N]`, given those of its derivatives at each particle.
    pub fn pull_back<const D: usize>(&self, stencils: &Stencils<D>, derivatives: &[[f64; C]], field: &mut [f64]) {
        for (i, bar) in derivatives.iter().enumerate().filter(|(_, bar)| bar.iter().any(|&x| x != 0.0)) {
            for k in 0..stencils.count(i) {
                let c = self.of(i, k);
                let sum: f64 = c.iter().zip(bar).map(|(c, bar)| c * bar).sum();
                field[stencils.neighbour(i, k)] += sum;
                field[i] -= sum;
            }
        }
    }
}

/// The slopes of the particles of a block.
struct Slopes<'a, const D: usize, const C: usize> {
    coefficients: &'a Coefficients<C>,
    stencils: &'a Stencils<D>,
    fields: &'a [&'a [f64]],
}

impl<'a, const D: usize, const C: usize> PartKernel<f64> for Slopes<'a, D, C> {
    /// `[fields][D][WIDEST]`.
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let first = self.stencils.first[block];
        for l in (0..WIDEST).step_by(L::COUNT) {
            for (f, field) in self.fields.iter().enumerate() {
                let own = L::load_part(&field[block * WIDEST + l..]);
                let mut sum = [L::zero(); D];
                for k in 0..self.stencils.first[block + 1] - first {
                    let place = (first + k) * WIDEST + l;
                    // SAFETY: the tables have whole blocks, and the list names particles.
                    let other = unsafe { L::gather(field.as_ptr(), self.stencils.list.as_ptr().add(place)) };
                    for (d, sum) in sum.iter_mut().enumerate() {
                        let from = ((first + k) * C + d) * WIDEST + l;
                        *sum = L::load_part(&self.coefficients.value[from..]).mul_add(other - own, *sum);
                    }
                }
                for (d, sum) in sum.into_iter().enumerate() {
                    let to = (D * f + d) * WIDEST + l;
                    // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                    unsafe { sum.store(part[to..to + L::COUNT].as_mut_ptr()) };
                }
            }
        }
    }
}

impl<const C: usize> Coefficients<C> {
    /// The derivatives along all directions of fields `[N]` at the first `count` particles: `[fields][count]`.
    pub fn slopes<const D: usize>(
        &self,
        stencils: &Stencils<D>,
        fields: &[&[f64]],
        count: usize,
    ) -> Vec<Vec<[f64; D]>> {
        let padded: Vec<Vec<f64>> = fields.iter().map(|field| stencils.padded_field(field)).collect();
        let padded: Vec<&[f64]> = padded.iter().map(Vec::as_slice).collect();
        let width = D * fields.len() * WIDEST;
        let mut all = vec![0.0; blocks(count) * width];
        run_parts(&Slopes { coefficients: self, stencils, fields: &padded }, all.chunks_exact_mut(width));
        let of = |f: usize, i: usize| std::array::from_fn(|d| all[field(D * fields.len(), i, D * f + d)]);
        (0..fields.len()).map(|f| (0..count).map(|i| of(f, i)).collect()).collect()
    }
}

#[inline(always)]
fn square_of<L: Lanes<Real = f64>, const D: usize>(s: &[L; D]) -> L {
    let mut sum = s[0] * s[0];
    (1..D).for_each(|d| sum += s[d] * s[d]);
    sum
}

/// The same in all lanes; what a fit needs of WIDEST or fewer particles.
pub(super) struct Fit<L, const Q: usize, const P: usize> {
    pub factor: [L; P],
    pub inverse_scale: L,
    /// sum_j W s^2.
    pub square: L,
    /// M^-1 sum_j W q.
    mean: [L; Q],
}

/// s of neighbour k of the particles from lane `l` of a block on, and its weight.
#[inline(always)]
pub(super) fn offset<L: Lanes<Real = f64>, const D: usize>(
    stencils: &Stencils<D>,
    position: &[Vec<f64>; D],
    (block, l, k): (usize, usize, usize),
    inverse_scale: L,
) -> ([L; D], L) {
    let place = (stencils.first[block] + k) * WIDEST + l;
    let i = block * WIDEST + l;
    let s = std::array::from_fn(|d| {
        // SAFETY: the tables have whole blocks, and the list names particles.
        let (to, from) = unsafe {
            (L::gather(position[d].as_ptr(), stencils.list.as_ptr().add(place)), L::load(position[d].as_ptr().add(i)))
        };
        let shift = &stencils.shift[d];
        let apart = if shift.is_empty() { to - from } else { to - from + L::load_part(&shift[place..]) };
        apart * inverse_scale
    });
    (s, L::load_part(&stencils.weight[place..]))
}

/// The monomials of s; those of third order are 0 where `third` is.
#[inline(always)]
pub(super) fn monomials_of<L: Lanes<Real = f64>, const D: usize, const Q: usize>(s: &[L; D], third: L) -> [L; Q] {
    let mut q = values::<L, D, Q>(s);
    (monomials(D)..Q).for_each(|a| q[a] = q[a] * third);
    q
}

#[inline(always)]
pub(super) fn fit<L: Lanes<Real = f64>, const D: usize, const Q: usize, const P: usize>(
    stencils: &Stencils<D>,
    position: &[Vec<f64>; D],
    block: usize,
    l: usize,
) -> Fit<L, Q, P> {
    let inverse_scale = L::splat(1.0) / L::load_part(&stencils.scale[block * WIDEST + l..]);
    let third = L::load_part(&stencils.third[block * WIDEST + l..]);
    let (mut factor, mut sum, mut square) = ([L::zero(); P], [L::zero(); Q], L::zero());
    for k in 0..stencils.count(block * WIDEST) {
        let (s, w) = offset(stencils, position, (block, l, k), inverse_scale);
        let q = monomials_of::<L, D, Q>(&s, third);
        accumulate(&mut factor, w, &q);
        square = w.mul_add(square_of(&s), square);
        for a in 0..Q {
            sum[a] = w.mul_add(q[a], sum[a]);
        }
    }
    let mut trace = factor[at(0, 0)];
    (1..D).for_each(|d| trace += factor[at(d, d)]);
    let least = L::splat(1e-12) * trace;
    factorise::<L, Q, P>(&mut factor, least);
    Fit { mean: solve::<L, Q, P>(&factor, sum), factor, inverse_scale, square }
}

struct Forward<'a, const D: usize, const Q: usize, const P: usize, const C: usize> {
    stencils: &'a Stencils<D>,
    position: &'a [Vec<f64>; D],
}

impl<'a, const D: usize, const Q: usize, const P: usize, const C: usize> PartKernel<f64> for Forward<'a, D, Q, P, C> {
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        if self.stencils.is_third(block) != (Q > monomials(D)) {
            return;
        }
        for l in (0..WIDEST).step_by(L::COUNT) {
            let third = L::load_part(&self.stencils.third[block * WIDEST + l..]);
            let Fit { factor, inverse_scale, square, mean } = fit::<L, D, Q, P>(self.stencils, self.position, block, l);
            let second = inverse_scale * inverse_scale;
            let strength = L::splat(2.0 * D as f64) * second / square;
            for k in 0..self.stencils.count(block * WIDEST) {
                let (s, w) = offset(self.stencils, self.position, (block, l, k), inverse_scale);
                let q = monomials_of::<L, D, Q>(&s, third);
                let c = solve::<L, Q, P>(&factor, q);
                for a in 0..C {
                    let value = match a {
                        left if left == C - 1 => strength * w * (L::splat(1.0) - dot(&q, &mean)),
                        first if first < D => w * c[a] * inverse_scale,
                        _ => w * c[a] * second,
                    };
                    let to = (k * C + a) * WIDEST + l;
                    // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                    unsafe { value.store(part[to..to + L::COUNT].as_mut_ptr()) };
                }
            }
        }
    }
}
