//! Derivatives of a particle by two fits: some by one of second order, the others by one of third order to more neighbours.
//!
//! A fit of third order has smaller errors, but hardly sees a checkerboard of the pressure, so that slopes and S ([`super::fit`]) stay with one
//! of second order.
//!
//! On the walls of a [lattice](crate::sph::relief) both are needed: continuity holds there with the slopes of the smaller fit, and heat passes
//! through by those of the larger one, because the errors of a fit of second order are large where neighbours are on one side. No
//! equation has mixed second derivatives (d^2 / dx dy and the like) there, so their places hold the slopes of the larger fit.

use super::fit::{by_fit, Coefficients, Origin, Stencils, COEFFICIENTS, COEFFICIENTS_3D};
use super::fit_adjoint::PairCotangents;
use crate::numerics::sparse_lu::BlockMatrix;
use crate::sph::consistent::stencil::quadratic;

/// Where the slopes of the larger fit are among the derivatives at points of walls: in the places of xy, xz and yz.
const ACROSS: [usize; 3] = [quadratic(3, 0, 1), quadratic(3, 0, 2), quadratic(3, 1, 2)];

/// The stencils of both fits. The neighbours of the smaller one are the first of those of the other.
#[derive(Debug, Clone)]
pub struct Fits<const D: usize = 2> {
    /// The smaller fit, of slopes and S; none where all derivatives are of one fit, and no neighbours in blocks where they are.
    small: Option<Stencils<D>>,
    /// The other fit, which has all neighbours.
    pub all: Stencils<D>,
    /// The first point of walls that have the slopes of both fits.
    walls: Option<usize>,
}

impl<const D: usize> Fits<D> {
    /// Two fits.
    pub fn of_two(small: Stencils<D>, all: Stencils<D>) -> Self {
        Self { small: Some(small), all, walls: None }
    }

    /// One fit for all derivatives.
    pub fn of_one(all: Stencils<D>) -> Self {
        Self { small: None, all, walls: None }
    }

    /// The fit that has the slopes and S of a particle.
    fn of_slopes(&self, i: usize) -> &Stencils<D> {
        self.small.as_ref().filter(|small| small.count(i) > 0).unwrap_or(&self.all)
    }

    /// The scale h of that fit.
    pub fn scale(&self, i: usize) -> f64 {
        self.of_slopes(i).scale(i)
    }
}

impl Fits<3> {
    /// Two fits, of which the `small` one has neighbours in all blocks with points of walls, the particles from `inside` on, that have the
    /// slopes of both.
    pub fn with_walls(small: Stencils<3>, all: Stencils<3>, inside: usize) -> Self {
        Self { small: Some(small), all, walls: Some(inside) }
    }

    /// How many neighbours of a particle the equations of the flow have: those of the smaller fit on walls that have the slopes of both.
    pub fn of_flow(&self, i: usize) -> usize {
        if self.walls.is_some() { self.of_slopes(i) } else { &self.all }.count(i)
    }

    /// The matrix of the equations of a flow with `size` fields, of zeros.
    pub fn flow_matrix(&self, size: usize) -> BlockMatrix {
        self.all.matrix_of(size, |i| self.of_flow(i))
    }

    /// Where the slopes by which heat passes through the boundary are among the derivatives of its points.
    pub fn across(&self) -> [usize; 3] {
        if self.walls.is_some() {
            ACROSS
        } else {
            [0, 1, 2]
        }
    }
}

impl<const D: usize> Fits<D> {
    /// Which derivatives of particle i are in the C places, where the smaller fit has neighbours.
    fn origins<const C: usize>(&self, i: usize) -> [Origin; C] {
        let is_wall = self.walls.is_some_and(|first| i >= first);
        std::array::from_fn(|c| match ACROSS.iter().position(|&place| place == c) {
            Some(slope) if is_wall => Origin::All(slope),
            _ if is_wall || c < D || c == C - 1 => Origin::Small(c),
            _ => Origin::All(c),
        })
    }

    /// The cotangents of the derivatives `[fields][N]` of the smaller fit and of the other one, given those of all places.
    fn divided<const C: usize>(&self, small: &Stencils<D>, bar: &[Vec<[f64; C]>]) -> [Vec<Vec<[f64; C]>>; 2] {
        let mut found: [Vec<Vec<[f64; C]>>; 2] =
            [bar.iter().map(|field| vec![[0.0; C]; field.len()]).collect(), bar.to_vec()];
        let [of_small, of_all] = &mut found;
        for (f, field) in bar.iter().enumerate() {
            for (i, bar) in field.iter().enumerate().filter(|(i, _)| small.count(*i) > 0) {
                [of_small[f][i], of_all[f][i]] = by_fit(&self.origins(i), bar);
            }
        }
        found
    }
}

/// What fits in a number of dimensions are made of.
macro_rules! in_dimension {
    ($dimension: literal, $coefficients: ident) => {
        impl Fits<$dimension> {
            /// The coefficients of all pairs of [`Self::all`] for positions `[D][N]`.
            pub fn coefficients(&self, position: &[Vec<f64>; $dimension]) -> Coefficients<$coefficients> {
                let mut found = self.all.coefficients(position);
                if let Some(small) = &self.small {
                    found.take(&small.coefficients(position), |i| small.count(i), |i| self.origins(i));
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
                let [of_small, of_all] = self.divided(small, bar);
                small.pull_back(position, fields, &of_small, position_bar);
                self.all.pull_back(position, fields, &of_all, position_bar);
            }

            /// The same, given the cotangents of all coefficients of pairs of [`Self::all`].
            pub fn pull_back_pairs(
                &self,
                position: &[Vec<f64>; $dimension],
                mut pairs: PairCotangents<$coefficients>,
                position_bar: &mut [Vec<f64>; $dimension],
            ) {
                if let Some(small) = &self.small {
                    let own = pairs.split(&self.all, small, |i| self.origins(i));
                    small.pull_back_pairs(position, &own, position_bar);
                }
                self.all.pull_back_pairs(position, &pairs, position_bar);
            }
        }
    };
}

in_dimension!(2, COEFFICIENTS);
in_dimension!(3, COEFFICIENTS_3D);
