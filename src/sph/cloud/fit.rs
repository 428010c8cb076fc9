//! Derivatives at fixed particles by fits of second order, with weights that do not depend on the shape.
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
//!   S f = 4 / (h^2 sum_j W s^2) sum_j W (f_j - f_i - d.q),   s = r_ij / h_i,
//! ```
//!
//! which vanishes for quadratic fields, is of fourth order for smooth ones, and sees a checkerboard.
//!
//! Tables of pairs are `[blocks, K, WIDEST]`, those of particles `[blocks, fields, WIDEST]`: a block is WIDEST particles.

use super::nearest::Plane;
use crate::numerics::lanes::{Lanes, WIDEST};
use crate::numerics::sparse_lu::BlockMatrix;
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::sph::consistent::stencil::{accumulate, at, dot, factorise, pull_back, solve, values};

/// Coefficients of a pair: the derivatives x, y, xx, xy, yy, and S.
pub const COEFFICIENTS: usize = 6;
/// The index of S.
pub const LEFT: usize = 5;
/// Monomials of second order in the plane, and the numbers of their matrix.
const Q: usize = 5;
const P: usize = 15;
/// The scale of a fit in R.
const SCALE: f64 = 2.5;

/// R and h of a fit, given the distance of the first neighbour that is left out.
pub(super) fn reach_and_scale(distance: f64) -> (f64, f64) {
    let reach = 1.0001 * distance;
    (reach, reach / SCALE)
}

/// W of a neighbour at a distance, and what is added to the difference of two places where the neighbour is a periodic image.
pub(super) fn weight_and_shift(plane: Plane, [own, to]: [[f64; 2]; 2], distance: f64, reach: f64) -> (f64, [f64; 2]) {
    let q = distance / reach;
    let r = plane.between(own, to);
    ((1.0 - q).powi(4) * (1.0 + 4.0 * q), std::array::from_fn(|d| r[d] - (to[d] - own[d])))
}

/// The stencils of all particles: neighbours, weights and scales of the reference cloud.
#[derive(Debug, Clone)]
pub struct Stencils {
    pub particles: usize,
    /// Number of neighbours of each particle, K.
    pub neighbours: usize,
    pub list: Vec<u32>,
    /// What is added to r_ij where the neighbour is a periodic image, `[2][blocks, K, WIDEST]`.
    shift: [Vec<f64>; 2],
    weight: Vec<f64>,
    /// h_i, `[blocks, WIDEST]`.
    scale: Vec<f64>,
}

/// Rows of a table of pairs: the number of particles rounded up to whole blocks.
pub fn blocks(particles: usize) -> usize {
    particles.div_ceil(WIDEST)
}

/// Place of particle i and neighbour k in a table of pairs.
#[inline(always)]
pub fn pair(neighbours: usize, i: usize, k: usize) -> usize {
    (i / WIDEST * neighbours + k) * WIDEST + i % WIDEST
}

/// Place of field `k` of `fields` of particle i in a table of particles.
#[inline(always)]
pub fn field(fields: usize, i: usize, k: usize) -> usize {
    (i / WIDEST * fields + k) * WIDEST + i % WIDEST
}

impl Stencils {
    /// A matrix of zeros for equations of `size` fields at the particles, in which those of each contain its neighbours.
    pub fn matrix(&self, size: usize) -> BlockMatrix {
        let neighbours = |i: usize| (0..self.neighbours).map(|k| self.neighbour(i, k) as u32).collect();
        BlockMatrix::of_lists(self.particles, size, neighbours)
    }

    /// The stencils of particles at `places`, given the distance and number of those `near` each, nearest first.
    ///
    /// # Errors
    /// A particle with fewer than `neighbours + 1` of them.
    pub fn new(plane: Plane, places: &[[f64; 2]], neighbours: usize, near: &[Vec<(f64, u32)>]) -> Result<Self, usize> {
        let (n, rows) = (places.len(), blocks(places.len()));
        let empty = vec![0.0; rows * neighbours * WIDEST];
        let mut all = Self {
            particles: n,
            neighbours,
            list: vec![0; rows * neighbours * WIDEST],
            shift: [empty.clone(), empty.clone()],
            weight: empty,
            scale: vec![1.0; rows * WIDEST],
        };
        for i in 0..n {
            let found = &near[i];
            if found.len() <= neighbours {
                return Err(i);
            }
            let (reach, scale) = reach_and_scale(found[neighbours].0);
            all.scale[i] = scale;
            for (k, &(distance, j)) in found[..neighbours].iter().enumerate() {
                let place = pair(neighbours, i, k);
                let (weight, shift) = weight_and_shift(plane, [places[i], places[j as usize]], distance, reach);
                all.list[place] = j;
                all.weight[place] = weight;
                (0..2).for_each(|d| all.shift[d][place] = shift[d]);
            }
        }
        // Lanes behind the last particle repeat it, so that their numbers are finite.
        for i in n..rows * WIDEST {
            all.scale[i] = all.scale[n - 1];
            for k in 0..neighbours {
                let (to, from) = (pair(neighbours, i, k), pair(neighbours, n - 1, k));
                (all.list[to], all.weight[to]) = (all.list[from], all.weight[from]);
                (0..2).for_each(|d| all.shift[d][to] = all.shift[d][from]);
            }
        }
        Ok(all)
    }

    pub fn neighbour(&self, i: usize, k: usize) -> usize {
        self.list[pair(self.neighbours, i, k)] as usize
    }

    /// The scale h of a particle's fit.
    pub fn scale(&self, i: usize) -> f64 {
        self.scale[i]
    }

    /// Neighbour, weight and constant shift of a pair.
    pub fn pair(&self, i: usize, k: usize) -> (usize, f64, [f64; 2]) {
        let place = pair(self.neighbours, i, k);
        (self.list[place] as usize, self.weight[place], [self.shift[0][place], self.shift[1][place]])
    }

    /// The coefficients of all pairs for positions `[2][N]`, `[blocks, K, COEFFICIENTS, WIDEST]`.
    pub fn coefficients(&self, position: &[Vec<f64>; 2]) -> Coefficients {
        let padded = self.padded(position);
        let width = self.neighbours * COEFFICIENTS * WIDEST;
        let mut value = vec![0.0; blocks(self.particles) * width];
        run_parts(&Forward { stencils: self, position: &padded }, value.chunks_exact_mut(width));
        Coefficients { neighbours: self.neighbours, value }
    }

    /// The cotangents of positions `[2][N]`, added to `position_bar`, given those of the derivatives of fields.
    ///
    /// `fields`: F of `[N]`; `bar`: `[F][N][COEFFICIENTS]`, the cotangents of x, y, xx, xy, yy and S of each field.
    pub fn pull_back(
        &self,
        position: &[Vec<f64>; 2],
        fields: &[&[f64]],
        bar: &[Vec<[f64; COEFFICIENTS]>],
        position_bar: &mut [Vec<f64>; 2],
    ) {
        let padded = self.padded(position);
        let width = 2 * self.neighbours * WIDEST;
        let mut pairs = vec![0.0; blocks(self.particles) * width];
        run_parts(&Backward { stencils: self, position: &padded, fields, bar }, pairs.chunks_exact_mut(width));
        for i in 0..self.particles {
            for k in 0..self.neighbours {
                let j = self.neighbour(i, k);
                for d in 0..2 {
                    let r_bar = pairs[field(2 * self.neighbours, i, 2 * k + d)];
                    position_bar[d][j] += r_bar;
                    position_bar[d][i] -= r_bar;
                }
            }
        }
    }

    /// A field with whole blocks.
    fn padded_field(&self, field: &[f64]) -> Vec<f64> {
        let mut padded = Vec::with_capacity(blocks(self.particles) * WIDEST);
        padded.extend_from_slice(field);
        padded.resize(blocks(self.particles) * WIDEST, field[self.particles - 1]);
        padded
    }

    fn padded(&self, position: &[Vec<f64>; 2]) -> [Vec<f64>; 2] {
        [self.padded_field(&position[0]), self.padded_field(&position[1])]
    }
}

/// The coefficients of all pairs.
#[derive(Debug, Clone, Default)]
pub struct Coefficients {
    neighbours: usize,
    value: Vec<f64>,
}

impl Coefficients {
    /// x, y, xx, xy, yy and S of neighbour k of particle i.
    #[inline(always)]
    pub fn of(&self, i: usize, k: usize) -> [f64; COEFFICIENTS] {
        let first = (i / WIDEST * self.neighbours + k) * COEFFICIENTS * WIDEST + i % WIDEST;
        std::array::from_fn(|c| self.value[first + c * WIDEST])
    }

    /// The derivatives of a field at particle i.
    pub fn derivatives(&self, stencils: &Stencils, i: usize, value: &[f64]) -> [f64; COEFFICIENTS] {
        let mut sum = [0.0; COEFFICIENTS];
        for k in 0..self.neighbours {
            let (c, difference) = (self.of(i, k), value[stencils.neighbour(i, k)] - value[i]);
            (0..COEFFICIENTS).for_each(|a| sum[a] += c[a] * difference);
        }
        sum
    }
}

/// The slopes along x and y of the particles of a block.
struct Slopes<'a> {
    coefficients: &'a Coefficients,
    stencils: &'a Stencils,
    fields: &'a [&'a [f64]],
}

impl<'a> PartKernel<f64> for Slopes<'a> {
    /// `[fields][2][WIDEST]`.
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let neighbours = self.stencils.neighbours;
        for l in (0..WIDEST).step_by(L::COUNT) {
            for (f, field) in self.fields.iter().enumerate() {
                let own = L::load_part(&field[block * WIDEST + l..]);
                let mut sum = [L::zero(); 2];
                for k in 0..neighbours {
                    let place = (block * neighbours + k) * WIDEST + l;
                    // SAFETY: the tables have whole blocks, and the list names particles.
                    let other = unsafe { L::gather(field.as_ptr(), self.stencils.list.as_ptr().add(place)) };
                    for (d, sum) in sum.iter_mut().enumerate() {
                        let from = ((block * neighbours + k) * COEFFICIENTS + d) * WIDEST + l;
                        *sum = L::load_part(&self.coefficients.value[from..]).mul_add(other - own, *sum);
                    }
                }
                for (d, sum) in sum.into_iter().enumerate() {
                    let to = (2 * f + d) * WIDEST + l;
                    // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                    unsafe { sum.store(part[to..to + L::COUNT].as_mut_ptr()) };
                }
            }
        }
    }
}

impl Coefficients {
    /// The derivatives along x and y of fields `[N]` at the first `count` particles: `[fields][count]`.
    pub fn slopes(&self, stencils: &Stencils, fields: &[&[f64]], count: usize) -> Vec<Vec<[f64; 2]>> {
        let padded: Vec<Vec<f64>> = fields.iter().map(|field| stencils.padded_field(field)).collect();
        let padded: Vec<&[f64]> = padded.iter().map(Vec::as_slice).collect();
        let width = 2 * fields.len() * WIDEST;
        let mut all = vec![0.0; blocks(count) * width];
        run_parts(&Slopes { coefficients: self, stencils, fields: &padded }, all.chunks_exact_mut(width));
        let of = |f: usize, i: usize| [0, 1].map(|d| all[field(2 * fields.len(), i, 2 * f + d)]);
        (0..fields.len()).map(|f| (0..count).map(|i| of(f, i)).collect()).collect()
    }
}

/// The same in all lanes; what a fit needs of WIDEST or fewer particles.
struct Fit<L> {
    factor: [L; P],
    inverse_scale: L,
    /// sum_j W s^2.
    square: L,
    /// M^-1 sum_j W q.
    mean: [L; Q],
}

/// s of neighbour k of the particles from lane `l` of a block on, and its weight.
#[inline(always)]
fn offset<L: Lanes<Real = f64>>(
    stencils: &Stencils,
    position: &[Vec<f64>; 2],
    (block, l, k): (usize, usize, usize),
    inverse_scale: L,
) -> ([L; 2], L) {
    let place = (block * stencils.neighbours + k) * WIDEST + l;
    let i = block * WIDEST + l;
    let s = std::array::from_fn(|d| {
        // SAFETY: the tables have whole blocks, and the list names particles.
        let (to, from) = unsafe {
            (L::gather(position[d].as_ptr(), stencils.list.as_ptr().add(place)), L::load(position[d].as_ptr().add(i)))
        };
        (to - from + L::load_part(&stencils.shift[d][place..])) * inverse_scale
    });
    (s, L::load_part(&stencils.weight[place..]))
}

#[inline(always)]
fn fit<L: Lanes<Real = f64>>(stencils: &Stencils, position: &[Vec<f64>; 2], block: usize, l: usize) -> Fit<L> {
    let inverse_scale = L::splat(1.0) / L::load_part(&stencils.scale[block * WIDEST + l..]);
    let (mut factor, mut sum, mut square) = ([L::zero(); P], [L::zero(); Q], L::zero());
    for k in 0..stencils.neighbours {
        let (s, w) = offset(stencils, position, (block, l, k), inverse_scale);
        let q = values::<L, 2, Q>(&s);
        accumulate(&mut factor, w, &q);
        square = w.mul_add(s[0] * s[0] + s[1] * s[1], square);
        for a in 0..Q {
            sum[a] = w.mul_add(q[a], sum[a]);
        }
    }
    let least = L::splat(1e-12) * (factor[at(0, 0)] + factor[at(1, 1)]);
    factorise::<L, Q, P>(&mut factor, least);
    Fit { mean: solve::<L, Q, P>(&factor, sum), factor, inverse_scale, square }
}

struct Forward<'a> {
    stencils: &'a Stencils,
    position: &'a [Vec<f64>; 2],
}

impl<'a> PartKernel<f64> for Forward<'a> {
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        for l in (0..WIDEST).step_by(L::COUNT) {
            let Fit { factor, inverse_scale, square, mean } = fit::<L>(self.stencils, self.position, block, l);
            let second = inverse_scale * inverse_scale;
            let strength = L::splat(4.0) * second / square;
            for k in 0..self.stencils.neighbours {
                let (s, w) = offset(self.stencils, self.position, (block, l, k), inverse_scale);
                let q = values::<L, 2, Q>(&s);
                let c = solve::<L, Q, P>(&factor, q);
                for a in 0..COEFFICIENTS {
                    let value = match a {
                        LEFT => strength * w * (L::splat(1.0) - dot(&q, &mean)),
                        0 | 1 => w * c[a] * inverse_scale,
                        _ => w * c[a] * second,
                    };
                    let to = (k * COEFFICIENTS + a) * WIDEST + l;
                    // SAFETY: COUNT lanes from l on are within the row of WIDEST.
                    unsafe { value.store(part[to..to + L::COUNT].as_mut_ptr()) };
                }
            }
        }
    }
}

struct Backward<'a> {
    stencils: &'a Stencils,
    position: &'a [Vec<f64>; 2],
    fields: &'a [&'a [f64]],
    bar: &'a [Vec<[f64; COEFFICIENTS]>],
}

impl<'a> PartKernel<f64> for Backward<'a> {
    type Part = &'a mut [f64];

    /// With lambda = M^-1 d_bar and e_j = f_j - f_i - d.q_j: q_bar = W sum_f (lambda e - d (lambda.q)), where S adds
    /// -S_bar A sum_j W q to d_bar and -S_bar A W d to q_bar, A = 4 / (h^2 sum W s^2).
    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let stencils = self.stencils;
        for l in (0..WIDEST).step_by(L::COUNT) {
            let Fit { factor, inverse_scale, square, .. } = fit::<L>(stencils, self.position, block, l);
            let lane = |of: &dyn Fn(usize) -> f64| -> L {
                let mut numbers = [0.0; WIDEST];
                for (lane, number) in numbers[..L::COUNT].iter_mut().enumerate() {
                    let i = block * WIDEST + l + lane;
                    *number = if i < stencils.particles { of(i) } else { 0.0 };
                }
                L::load_part(&numbers[..])
            };
            let second = inverse_scale * inverse_scale;
            for to in (0..2 * stencils.neighbours).map(|k| k * WIDEST + l) {
                part[to..to + L::COUNT].fill(0.0);
            }
            for (values_of, bar) in self.fields.iter().zip(self.bar) {
                let left = lane(&|i| bar[i][LEFT]) * L::splat(4.0) * second / square;
                let own = lane(&|i| values_of[i]);
                let difference = |k: usize| {
                    let place = (block * stencils.neighbours + k) * WIDEST + l;
                    let mut numbers = [0.0; WIDEST];
                    for lane in 0..L::COUNT {
                        numbers[lane] = values_of[stencils.list[place + lane] as usize];
                    }
                    L::load_part(&numbers[..]) - own
                };
                let (mut right, mut sum) = ([L::zero(); Q], [L::zero(); Q]);
                for k in 0..stencils.neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = values::<L, 2, Q>(&s);
                    let weighted = w * difference(k);
                    for a in 0..Q {
                        right[a] = weighted.mul_add(q[a], right[a]);
                        sum[a] = w.mul_add(q[a], sum[a]);
                    }
                }
                let d = solve::<L, Q, P>(&factor, right);
                let mut d_bar = [L::zero(); Q];
                for (a, d_bar) in d_bar.iter_mut().enumerate() {
                    let unit = if a < 2 { inverse_scale } else { second };
                    *d_bar = lane(&|i| bar[i][a]) * unit - left * sum[a];
                }
                let lambda = solve::<L, Q, P>(&factor, d_bar);
                // The cotangent of sum W s^2.
                let mut rest = L::zero();
                for k in 0..stencils.neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = values::<L, 2, Q>(&s);
                    rest = w.mul_add(difference(k) - dot(&d, &q), rest);
                }
                let square_bar = -(left * rest) / square;
                for k in 0..stencils.neighbours {
                    let (s, w) = offset(stencils, self.position, (block, l, k), inverse_scale);
                    let q = values::<L, 2, Q>(&s);
                    let (error, along) = (difference(k) - dot(&d, &q), dot(&lambda, &q));
                    let mut q_bar = [L::zero(); Q];
                    for a in 0..Q {
                        q_bar[a] = w * (lambda[a] * error - d[a] * along - left * d[a]);
                    }
                    let s_bar = pull_back::<L, 2, Q>(&s, &q_bar);
                    for d in 0..2 {
                        let to = (2 * k + d) * WIDEST + l;
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
