//! Derivatives on a lattice as factors of Fourier's modes.
//!
//! With the weights c_r of the neighbours at distances r, (D f)_i = sum_r c_r (f_(i+r) - f_i), a mode exp(i k x) becomes
//! itself times
//!
//! ```text
//!   first derivatives    i d_a(k),   d_a = sum_r c_r sin(k.r)
//!   Laplacian            -K(k),      K = sum_r c_r (1 - cos(k.r))
//! ```
//!
//! Fits are of fourth degree to the neighbours in a block of five in each direction (fourth order); spectral derivatives
//! have d = k and K = k^2. A mode that alternates from particle to particle along an axis has no first derivative along
//! it.

use crate::config::method::fixed::Derivatives;
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::consistent::stencil::{accumulate, factorise, packed, solve};
use std::f64::consts::{PI, TAU};

/// Neighbours in each direction of an axis.
const REACH: isize = 2;
const DEGREE: usize = 4;

/// The factors of all modes of a spectrum.
#[derive(Debug, Clone)]
pub struct Symbols {
    /// d of each direction, `[D][modes]`.
    pub first: Vec<Vec<f64>>,
    /// K, `[modes]`.
    pub laplacian: Vec<f64>,
    /// 1 over the sum of squares of d, and 0 where that is 0.
    pub inverse: Vec<f64>,
}

/// The weights of a lattice's fit in units of its spacing.
#[derive(Debug, Clone)]
pub struct Weights {
    /// Neighbours, in spacings.
    pub places: Vec<Vec<isize>>,
    /// Of the derivative along each direction, `[D][neighbours]`.
    pub first: Vec<Vec<f64>>,
    /// Of the Laplacian.
    pub laplacian: Vec<f64>,
}

/// All vectors of `dimension` whole numbers `from` ... `to`.
fn vectors(dimension: usize, from: isize, to: isize) -> Vec<Vec<isize>> {
    (0..dimension).fold(vec![vec![]], |all, _| {
        all.iter().flat_map(|v| (from..=to).map(|x| [v.as_slice(), &[x]].concat())).collect()
    })
}

impl Weights {
    /// The weights of fits in one, two or three dimensions.
    pub fn of_fits(dimension: usize) -> Self {
        // The numbers of monomials of degree 1 to 4.
        match dimension {
            1 => Self::fitted::<4, { packed(4) }>(1),
            2 => Self::fitted::<14, { packed(14) }>(2),
            _ => Self::fitted::<34, { packed(34) }>(3),
        }
    }

    fn fitted<const Q: usize, const P: usize>(dimension: usize) -> Self {
        type Number = <f64 as Real>::Portable;
        let places = vectors(dimension, -REACH, REACH).into_iter().filter(|r| r.iter().any(|&x| x != 0));
        let places: Vec<Vec<isize>> = places.collect();
        let powers = vectors(dimension, 0, DEGREE as isize).into_iter();
        let powers: Vec<Vec<isize>> = powers.filter(|p| (1..=DEGREE as isize).contains(&p.iter().sum())).collect();
        let farthest = REACH as f64 * (dimension as f64).sqrt();
        let monomials: Vec<[Number; Q]> = places
            .iter()
            .map(|r| {
                let value = |p: &Vec<isize>| r.iter().zip(p).map(|(&x, &p)| (x as f64).powi(p as i32)).product();
                std::array::from_fn(|k| Number::splat(value(&powers[k])))
            })
            .collect();
        // That of the fits around shapes, which ends behind the last neighbour.
        let weight = |r: &Vec<isize>| {
            let q = r.iter().map(|x| (x * x) as f64).sum::<f64>().sqrt() / (farthest + 1.0);
            Number::splat((1.0 - q).powi(4) * (1.0 + 4.0 * q))
        };
        let mut matrix = [Number::zero(); P];
        for (r, q) in places.iter().zip(&monomials) {
            accumulate(&mut matrix, weight(r), q);
        }
        factorise::<_, Q, P>(&mut matrix, Number::splat(f64::MIN_POSITIVE));
        // The coefficient of x_a^n in the polynomial that fits is the n-th derivative over n!.
        let coefficient = |a: usize, n: isize| -> Vec<f64> {
            let is_it = |p: &Vec<isize>| p[a] == n && p.iter().sum::<isize>() == n;
            let unit: [Number; Q] = std::array::from_fn(|k| Number::splat(if is_it(&powers[k]) { 1.0 } else { 0.0 }));
            let row = solve(&matrix, unit);
            let of =
                |r: &Vec<isize>, q: &[Number; Q]| (0..Q).map(|k| (row[k] * q[k] * weight(r)).numbers()[0]).sum::<f64>();
            places.iter().zip(&monomials).map(|(r, q)| of(r, q)).collect()
        };
        let mut laplacian = vec![0.0; places.len()];
        for a in 0..dimension {
            laplacian.iter_mut().zip(coefficient(a, 2)).for_each(|(sum, c)| *sum += 2.0 * c);
        }
        Self { first: (0..dimension).map(|a| coefficient(a, 1)).collect(), laplacian, places }
    }
}

impl Symbols {
    /// The factors for a lattice `shape` in a box of `size`.
    pub fn new(shape: &[usize], size: &[f64], derivatives: Derivatives) -> Self {
        let d = shape.len();
        let half = shape[d - 1] / 2 + 1;
        let modes = shape[..d - 1].iter().product::<usize>() * half;
        // The whole wave numbers of a mode, -n/2 < m <= n/2.
        let numbers = |mode: usize| -> Vec<isize> {
            let mut rest = mode / half;
            let mut m = vec![(mode % half) as isize; d];
            for a in (0..d - 1).rev() {
                let i = rest % shape[a];
                m[a] = if 2 * i > shape[a] { i as isize - shape[a] as isize } else { i as isize };
                rest /= shape[a];
            }
            m
        };
        let mut all = Self { first: vec![vec![0.0; modes]; d], laplacian: vec![0.0; modes], inverse: vec![0.0; modes] };
        let weights = (derivatives == Derivatives::Fits).then(|| Weights::of_fits(d));
        let dx = size[0] / shape[0] as f64;
        for mode in 0..modes {
            let m = numbers(mode);
            match &weights {
                None => {
                    for a in 0..d {
                        let k = TAU * m[a] as f64 / size[a];
                        all.laplacian[mode] += k * k;
                        all.first[a][mode] = if 2 * m[a] == shape[a] as isize { 0.0 } else { k };
                    }
                }
                Some(weights) => {
                    for (j, r) in weights.places.iter().enumerate() {
                        let phase: f64 = (0..d).map(|a| 2.0 * PI * (m[a] * r[a]) as f64 / shape[a] as f64).sum();
                        let (sin, cos) = phase.sin_cos();
                        (0..d).for_each(|a| all.first[a][mode] += weights.first[a][j] * sin / dx);
                        all.laplacian[mode] += weights.laplacian[j] * (1.0 - cos) / (dx * dx);
                    }
                    // Sines of whole multiples of pi are 0, but for rounding.
                    for a in 0..d {
                        if 2 * m[a] == shape[a] as isize {
                            all.first[a][mode] = 0.0;
                        }
                    }
                }
            }
            let square: f64 = all.first.iter().map(|first| first[mode].powi(2)).sum();
            all.inverse[mode] = if square > 0.0 { 1.0 / square } else { 0.0 };
        }
        all
    }
}
