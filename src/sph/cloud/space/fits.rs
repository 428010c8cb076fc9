//! The two fits of a particle in space: slopes and S by one of second order, second derivatives by one of third order near shapes.
//!
//! Where the spacing grows away from a shape, neighbours on the two sides are not alike, and the Laplacian of a fit of second order has
//! an error of first order with the same sign everywhere. In the drag of an array of spheres that was the largest error (-0.64 % of -0.9 % with 20
//! spacings; the others nearly cancel, see the page). A fit of third order to more neighbours has none. Slopes and S stay with fits of
//! second order: those of third order hardly see a checkerboard of the pressure, and the drag would be 3 to 13 % off. So do both
//! at the first layer on a wall, where neighbours are on one side and a fit of third order would have larger errors.

use super::super::fit::{Coefficients, Stencils, COEFFICIENTS_3D as C, LEFT_3D as LEFT};
use super::super::nearest::Region;

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

/// The stencils of both fits. The neighbours of slopes are the first of those of second derivatives.
#[derive(Debug, Clone)]
pub struct Fits {
    /// None where all derivatives are of one fit.
    slopes: Option<Stencils<3>>,
    /// Those of second derivatives, which have all neighbours.
    pub all: Stencils<3>,
}

impl Fits {
    /// The fits of particles at `places`, given the distance and number of those `near` each, nearest first.
    ///
    /// # Errors
    /// A particle with too few of them.
    pub fn new(
        region: Region<3>,
        places: &[[f64; 3]],
        kinds: &[Where],
        near: &[Vec<(f64, u32)>],
    ) -> Result<Self, usize> {
        let count = |which: usize| move |i: usize| kinds[i].counts()[which];
        let slopes = Stencils::new(region, places, count(0), |_| false, near)?;
        let all = Stencils::new(region, places, count(1), |i| kinds[i] == Where::NearShape, near)?;
        Ok(Self { slopes: Some(slopes), all })
    }

    /// One fit for all derivatives.
    pub fn of_one(all: Stencils<3>) -> Self {
        Self { slopes: None, all }
    }

    /// The coefficients of all pairs of [`Self::all`] for positions `[3][N]`.
    pub fn coefficients(&self, position: &[Vec<f64>; 3]) -> Coefficients<C> {
        let mut found = self.all.coefficients(position);
        if let Some(slopes) = &self.slopes {
            found.take_slopes(&slopes.coefficients(position), |i| slopes.count(i), 3);
        }
        found
    }

    /// The cotangents of positions `[3][N]`, added to `position_bar`, given those of the derivatives of fields, see
    /// [`Stencils::pull_back`].
    pub fn pull_back(
        &self,
        position: &[Vec<f64>; 3],
        fields: &[&[f64]],
        bar: &[Vec<[f64; C]>],
        position_bar: &mut [Vec<f64>; 3],
    ) {
        let Some(slopes) = &self.slopes else {
            return self.all.pull_back(position, fields, bar, position_bar);
        };
        let is_slope = |c: usize| c < 3 || c == LEFT;
        let part = |of_slopes: bool| -> Vec<Vec<[f64; C]>> {
            let kept = |bar: &[f64; C]| std::array::from_fn(|c| if is_slope(c) == of_slopes { bar[c] } else { 0.0 });
            bar.iter().map(|bar| bar.iter().map(kept).collect()).collect()
        };
        slopes.pull_back(position, fields, &part(true), position_bar);
        self.all.pull_back(position, fields, &part(false), position_bar);
    }
}
