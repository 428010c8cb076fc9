//! The two fits of a particle in space: slopes and S by one of second order, second derivatives by one of third order near shapes.
//!
//! Where the spacing grows away from a shape, neighbours on the two sides are not alike, and the Laplacian of a fit of second order has
//! an error of first order with the same sign everywhere. In the drag of an array of spheres that was the largest error (-0.64 % of -0.9 % with 20
//! spacings; the others nearly cancel, see the page). A fit of third order to more neighbours has none. Slopes and S stay with fits of
//! second order: those of third order hardly see a checkerboard of the pressure, and the drag would be 3 to 13 % off. So do both
//! at the first layer on a wall, where neighbours are on one side and a fit of third order would have larger errors.
//!
//! A fit of second order takes more neighbours where S ([`super::super::fit`]) sees too little of the particle itself. Where layers
//! around a shape meet the lattice the nearest neighbours lie near a quadric, whose values no such fit can tell from a constant: S has
//! hardly anything of the particle's own value, slopes have large coefficients, and pressures oscillate.

use super::super::fit::{reach_and_scale, weight, Stencils};
use super::super::fits::Fits;
use super::super::nearest::Region;
use super::super::wall_fit::fit;
use crate::numerics::lanes::WIDEST;

/// Neighbours of slopes, and of all derivatives far from shapes: the first of these numbers with which S has SEEN of a particle's own
/// value, times h^2 (0.47 on a lattice), or that with which it has most.
const NEIGHBOURS: [usize; 6] = [32, 36, 40, 46, 52, 60];
/// With 32 everywhere a hundredth of the particles has less than 0.08, and the drag of a cylinder of 2.5 spacings between sides where the
/// fluid slips is 26 % above the plane's on a fine cloud (of 3.6 spacings 6.2 %, by its surface 10.5 %). With 0.2 it is 11 % (1.9, 4.2), with 0.25 7.4 %
/// (1.4, 3.2), with 0.35 3.7 % (0.7, 1.2), and with 0.4 3.5 % (0.6, 0.8).
const SEEN: f64 = 0.35;
/// Neighbours on the boundary, where all are on one side. (With 32 the drag of an array of spheres is 2 % off, pressures
/// oscillate from point to point, and the iterations hardly converge. What passes through it by fits of third order to 125, as
/// [over reliefs](super::super::fits), makes the heat by the surface of a cylinder half as wrong, -9 instead of -16 % with 3.5 spacings and -5 instead
/// of -8 % with five, but its drag by the surface 1 % larger, 1.8 and 0.9 % too large, and figures by balance no better, for more time.)
const ON_BOUNDARY: usize = 56;
/// Neighbours of fits of third order. (With 56 the drag of an array of spheres is up to 0.5 % lower.)
const OF_THIRD_ORDER: usize = 44;

/// Where a particle is, which decides on its fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Where {
    Boundary,
    /// Away from shapes, or next to the boundary.
    Far,
    /// Near a shape, but not next to it.
    NearShape,
}

impl Where {
    /// How many particles near each should be known.
    pub fn needs(self) -> usize {
        match self {
            Self::Boundary => ON_BOUNDARY + 1,
            Self::Far | Self::NearShape => OF_THIRD_ORDER.max(NEIGHBOURS[NEIGHBOURS.len() - 1]) + 1,
        }
    }
}

/// The fits of particles at `places`, given the distance and number of those `near` each, nearest first.
///
/// # Errors
/// A particle with too few of them.
pub fn fits<'a>(
    region: Region<3>,
    places: &[[f64; 3]],
    kinds: &[Where],
    near: impl Fn(usize) -> &'a [(f64, u32)],
) -> Result<Fits<3>, usize> {
    let is_third = |i: usize| kinds[i] == Where::NearShape;
    let slopes: Vec<usize> = (0..places.len()).map(|i| count(region, places, i, kinds[i], near(i))).collect();
    let counts = |i: usize| if is_third(i) { slopes[i].max(OF_THIRD_ORDER) } else { slopes[i] };
    let all = Stencils::new(region, places, counts, is_third, &near)?;
    let small = |i: usize| if all.is_third(i / WIDEST) { slopes[i] } else { 0 };
    Ok(Fits::of_two(Stencils::new(region, places, small, |_| false, &near)?, all))
}

/// How many neighbours the slopes of particle i have, of those `near` it.
fn count(region: Region<3>, places: &[[f64; 3]], i: usize, kind: Where, near: &[(f64, u32)]) -> usize {
    if kind == Where::Boundary {
        return ON_BOUNDARY;
    }
    let (mut most, mut best) = (f64::NEG_INFINITY, NEIGHBOURS[0]);
    for count in NEIGHBOURS.into_iter().take_while(|&count| count < near.len()) {
        let seen = seen(region, places, i, &near[..=count]);
        if seen > most {
            (most, best) = (seen, count);
        }
        if seen >= SEEN {
            break;
        }
    }
    best
}

/// What S of a fit of second order has of the value of particle i, times h^2, with these particles `near` it, the last of which is left out:
///
/// ```text
///   6 sum_j W (1 - q . m) / sum_j W s^2,   m = M^-1 sum_j W q.
/// ```
///
/// m is the fit of a constant to the neighbours that is 0 at the particle, so it is 0 where they lie on a quadric and the particle does not.
pub fn seen(region: Region<3>, places: &[[f64; 3]], i: usize, near: &[(f64, u32)]) -> f64 {
    let Some(((left_out, _), neighbours)) = near.split_last() else { return 0.0 };
    let (reach, scale) = reach_and_scale(*left_out);
    let of = |&(distance, j): &(f64, u32)| {
        let s = region.between(places[i], places[j as usize]).map(|x| x / scale);
        let [x, y, z] = s;
        ([x, y, z, x * x, x * y, x * z, y * y, y * z, z * z], weight(distance / reach), s)
    };
    let (_, m) = fit(neighbours.iter().map(of).map(|(q, w, _)| (q, w, 1.0)));
    let (mut left, mut square) = (0.0, 0.0);
    for (q, w, s) in neighbours.iter().map(of) {
        left += w * (1.0 - q.iter().zip(m).map(|(q, m)| q * m).sum::<f64>());
        square += w * s.iter().map(|x| x * x).sum::<f64>();
    }
    6.0 * left / square
}
