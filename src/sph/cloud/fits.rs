//! Derivatives of a particle by two fits: some by one of second order, the others by one of third order to more neighbours.
//!
//! A fit of third order has smaller errors, but hardly sees a checkerboard of the pressure, so that slopes and S ([`super::fit`]) stay with one
//! of second order.

use super::fit::{Coefficients, Stencils, COEFFICIENTS, COEFFICIENTS_3D};
use super::fit_adjoint::PairCotangents;

/// The stencils of both fits. The neighbours of the smaller one are the first of those of the other.
#[derive(Debug, Clone)]
pub struct Fits<const D: usize = 2> {
    /// The smaller fit, of slopes and S; none where all derivatives are of one fit, and no neighbours in blocks where they are.
    small: Option<Stencils<D>>,
    /// The other fit, which has all neighbours.
    pub all: Stencils<D>,
}

impl<const D: usize> Fits<D> {
    /// Two fits.
    pub fn of_two(small: Stencils<D>, all: Stencils<D>) -> Self {
        Self { small: Some(small), all }
    }

    /// One fit for all derivatives.
    pub fn of_one(all: Stencils<D>) -> Self {
        Self { small: None, all }
    }
}

/// Those of C coefficients that are of the smaller fit.
fn of_small<const D: usize, const C: usize>() -> [bool; C] {
    std::array::from_fn(|c| c < D || c == C - 1)
}

/// Derivatives `[fields][N]` of which those that `kept` says, of particle i and coefficient c, are kept, and the others 0.
fn part<const C: usize>(bar: &[Vec<[f64; C]>], kept: impl Fn(usize, usize) -> bool) -> Vec<Vec<[f64; C]>> {
    let of = |(i, bar): (usize, &[f64; C])| std::array::from_fn(|c| if kept(i, c) { bar[c] } else { 0.0 });
    bar.iter().map(|field| field.iter().enumerate().map(of).collect()).collect()
}

/// What fits in a number of dimensions are made of.
macro_rules! in_dimension {
    ($dimension: literal, $coefficients: ident) => {
        impl Fits<$dimension> {
            /// The coefficients of all pairs of [`Self::all`] for positions `[D][N]`.
            pub fn coefficients(&self, position: &[Vec<f64>; $dimension]) -> Coefficients<$coefficients> {
                let mut found = self.all.coefficients(position);
                if let Some(small) = &self.small {
                    let taken = of_small::<$dimension, $coefficients>();
                    found.take(&small.coefficients(position), |i| small.count(i), &taken);
                }
                found
            }

            /// The cotangents of positions `[D][N]`, added to `position_bar`, given those of the derivatives of fields, see
            /// [`Stencils::pull_back`].
            pub fn pull_back(
                &self,
                position: &[Vec<f64>; $dimension],
                fields: &[&[f64]],
                bar: &[Vec<[f64; $coefficients]>],
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                let Some(small) = &self.small else {
                    return self.all.pull_back(position, fields, bar, position_bar);
                };
                let taken = of_small::<$dimension, $coefficients>();
                let is_taken = |i: usize, c: usize| taken[c] && small.count(i) > 0;
                small.pull_back(position, fields, &part(bar, is_taken), position_bar);
                self.all.pull_back(position, fields, &part(bar, |i, c| !is_taken(i, c)), position_bar);
            }

            /// The same, given the cotangents of all coefficients of pairs of [`Self::all`].
            pub fn pull_back_pairs(
                &self,
                position: &[Vec<f64>; $dimension],
                mut pairs: PairCotangents<$coefficients>,
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                if let Some(small) = &self.small {
                    let taken = of_small::<$dimension, $coefficients>();
                    let own = pairs.split(&self.all, small, &taken);
                    small.pull_back_pairs(position, &own, position_bar);
                }
                self.all.pull_back_pairs(position, &pairs, position_bar);
            }
        }
    };
}

in_dimension!(2, COEFFICIENTS);
in_dimension!(3, COEFFICIENTS_3D);
