//! The temperature beside a corner with which a wall points into the fluid, where no polynomial fits it.
//!
//! Close to it conduction alone counts. With beta > pi the angle of the fluid about the corner, and phi that from one of the walls,
//!
//! ```text
//!   T = T_corner + A r^(pi/beta) sin(pi phi / beta) + g . r + ...
//! ```
//!
//! (Grisvard 1985, section 4.4), so that the flux through the walls grows without bound towards the corner. A and g are those of a fit to the nearest
//! places, with the weights of [`super::fit`], and the heat of a wall from the corner to a distance l is - k (A l^(pi/beta) + g . n l). (By
//! polynomials the heat of boxes and pentagons of seven spacings is 14 % too small, by this fit 1 % off, from 12 to 25 neighbours.)

use super::fit::weight;
use super::wall_fit;
use std::f64::consts::PI;

/// Neighbours of a fit.
pub const NEIGHBOURS: usize = 18;
/// Places may be this far behind the walls. Radians.
const BEHIND: f64 = 0.05;

/// A corner of a wall, with the fluid on the right of both of its edges.
#[derive(Debug, Clone, Copy)]
pub struct Corner {
    pub place: [f64; 2],
    /// Direction of the edge that begins in the corner.
    direction: f64,
    /// beta.
    angle: f64,
}

/// What the fit finds: A and g, in units of `reach`.
#[derive(Debug, Clone, Copy)]
pub struct CornerFit {
    power: f64,
    reach: f64,
    found: [f64; 3],
}

impl Corner {
    /// The corner at `place` between an edge along `to` that ends there and one along `from` that begins there; none where the wall does not point into
    /// the fluid by more than `least`. Radians.
    pub fn new(place: [f64; 2], to: [f64; 2], from: [f64; 2], least: f64) -> Option<Self> {
        let turn = (to[0] * from[1] - to[1] * from[0]).atan2(to[0] * from[0] + to[1] * from[1]);
        (turn > least).then(|| Self { place, direction: from[1].atan2(from[0]), angle: PI + turn })
    }

    /// phi of a place relative to the corner, from the edge that begins there; none inside the wall.
    pub fn angle_of(&self, r: [f64; 2]) -> Option<f64> {
        let phi = (self.direction - r[1].atan2(r[0])).rem_euclid(2.0 * PI);
        if phi <= self.angle + BEHIND {
            return Some(phi.min(self.angle));
        }
        (phi >= 2.0 * PI - BEHIND).then_some(0.0)
    }

    /// The fit to places relative to the corner and temperatures less that of the corner, nearest first; none where these are too few.
    pub fn fit(&self, near: &[([f64; 2], f64)]) -> Option<CornerFit> {
        let length = |r: [f64; 2]| r[0].hypot(r[1]);
        let (power, reach) = (PI / self.angle, length(near.get(NEIGHBOURS)?.0));
        // Places inside of the wall are none of the fit's.
        let row = |&(r, difference): &([f64; 2], f64)| {
            let (q, phi) = (length(r) / reach, self.angle_of(r)?);
            Some(([q.powf(power) * (power * phi).sin(), r[0] / reach, r[1] / reach], weight(q), difference))
        };
        Some(CornerFit { power, reach, found: wall_fit::fit(near[..NEIGHBOURS].iter().filter_map(row)).1 })
    }
}

impl CornerFit {
    /// The integral of the temperature's derivative along the normal, into the fluid, over the part of an edge that is no farther from the
    /// corner than `length`.
    pub fn slope(&self, normal: [f64; 2], length: f64) -> f64 {
        let (part, [singular, x, y]) = (length / self.reach, self.found);
        singular * part.powf(self.power) + (x * normal[0] + y * normal[1]) * part
    }
}
