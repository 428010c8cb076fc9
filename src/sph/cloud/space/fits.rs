//! The two fits of a particle in space: slopes and S by one of second order, second derivatives by one of third order near shapes.
//!
//! Where the spacing grows away from a shape, neighbours on the two sides are not alike, and the Laplacian of a fit of second order has
//! an error of first order with the same sign everywhere. In the drag of an array of spheres that was the largest error (-0.64 % of -0.9 % with 20
//! spacings; the others nearly cancel, see the page). A fit of third order to more neighbours has none. Slopes and S stay with fits of
//! second order: those of third order hardly see a checkerboard of the pressure, and the drag would be 3 to 13 % off. So do both
//! at the first layer on a wall, where neighbours are on one side and a fit of third order would have larger errors.

use super::super::fit::Stencils;
use super::super::fits::Fits;
use super::super::nearest::Region;
use crate::numerics::lanes::WIDEST;

/// Neighbours of slopes, and of all derivatives far from shapes.
const NEIGHBOURS: usize = 32;
/// The same on the boundary, where all are on one side. (With 32 the drag of an array of spheres is 2 % off, pressures
/// oscillate from point to point, and the iterations hardly converge.)
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
    /// Neighbours of slopes, and of second derivatives.
    fn counts(self) -> [usize; 2] {
        match self {
            Self::Boundary => [ON_BOUNDARY; 2],
            Self::Far => [NEIGHBOURS; 2],
            Self::NearShape => [NEIGHBOURS, OF_THIRD_ORDER],
        }
    }

    /// How many particles near each must be known.
    pub fn needs(self) -> usize {
        self.counts()[1] + 1
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
    let all = Stencils::new(region, places, |i| kinds[i].counts()[1], is_third, &near)?;
    let slopes = |i: usize| if all.is_third(i / WIDEST) { kinds[i].counts()[0] } else { 0 };
    Ok(Fits::of_two(Stencils::new(region, places, slopes, |_| false, &near)?, all))
}
