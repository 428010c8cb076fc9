//! Fields of a cloud at any point of the fluid: the Taylor polynomial of second order of the nearest particle,
//!
//! ```text
//!   f(p) = f_i + r . grad f_i + r . (grad grad f_i) r / 2,   r = p - r_i,
//! ```
//!
//! with the derivatives of [`super::fit`]. It is exact for quadratic fields, and of third order for smooth ones.

use super::fit::COEFFICIENTS;
use super::nearest::Nearest;
use super::particles::{Cloud, Shaped};
use super::placing::Polygon;

/// A point of the fluid: its nearest particle, and the image of the point that is near it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    pub particle: usize,
    pub place: [f64; 2],
}

impl Sample {
    /// The monomials x, y, x^2 / 2, x y, y^2 / 2 of the vector from the particle to the point. `position`: `[2][N]`.
    pub fn monomials(&self, position: &[Vec<f64>; 2]) -> [f64; 5] {
        let [x, y]: [f64; 2] = std::array::from_fn(|d| self.place[d] - position[d][self.particle]);
        [x, y, 0.5 * x * x, x * y, 0.5 * y * y]
    }

    /// A field `[N]` with its derivatives `[N]` at the point.
    pub fn value(&self, position: &[Vec<f64>; 2], field: &[f64], derivatives: &[[f64; COEFFICIENTS]]) -> f64 {
        let (q, d) = (self.monomials(position), &derivatives[self.particle]);
        field[self.particle] + (0..5).map(|a| q[a] * d[a]).sum::<f64>()
    }

    /// The derivatives along x and y at the point, of the same polynomial.
    pub fn slope(&self, position: &[Vec<f64>; 2], derivatives: &[[f64; COEFFICIENTS]]) -> [f64; 2] {
        let ([x, y, ..], d) = (self.monomials(position), &derivatives[self.particle]);
        [d[0] + d[2] * x + d[3] * y, d[1] + d[3] * x + d[4] * y]
    }
}

/// Finds the particles that points are interpolated from, in a cloud of one shape.
#[derive(Debug)]
pub struct Interpolation<'a> {
    cloud: &'a Cloud,
    position: &'a [Vec<f64>; 2],
    /// The outlines of this shape, not of the reference cloud's.
    polygons: Vec<Polygon>,
    near: Nearest,
}

impl<'a> Interpolation<'a> {
    pub fn new(cloud: &'a Cloud, shaped: &'a Shaped) -> Self {
        let (plane, position) = (cloud.ground.plane, &shaped.position);
        let places: Vec<[f64; 2]> =
            position[0].iter().zip(&position[1]).map(|(&x, &y)| plane.wrapped([x, y])).collect();
        let polygon = |(outline, numbers): (&super::outline::Outline, &Vec<f64>)| {
            Polygon::of(&outline.points(&outline.samples(8), numbers))
        };
        let polygons = cloud.ground.outlines.iter().zip(&shaped.numbers).map(polygon).collect();
        Self { cloud, position, polygons, near: Nearest::new(plane, cloud.ground.dx, &places) }
    }

    /// The particle that a point is interpolated from; none inside of shapes and outside of the box.
    pub fn sample(&self, p: [f64; 2]) -> Option<Sample> {
        let ground = &self.cloud.ground;
        let (plane, most) = (ground.plane, 2.0 * ground.far * ground.dx);
        let slack = 1e-9 * ground.dx;
        if (0..2).any(|d| !plane.periodic[d] && !(-slack..=plane.size[d] + slack).contains(&p[d])) {
            return None;
        }
        let p = plane.wrapped(p);
        let (_, particle) = self.near.one(p, most)?;
        // Points inside of shapes are nearest to particles on walls.
        if particle >= self.cloud.places.inside && ground.is_in_wall(&self.polygons, p, None).is_some() {
            return None;
        }
        let own = [self.position[0][particle], self.position[1][particle]];
        let r = plane.between(own, p);
        Some(Sample { particle, place: [own[0] + r[0], own[1] + r[1]] })
    }
}
