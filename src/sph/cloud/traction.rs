//! The momentum that comes through a small area with the normal times area a: the traction of the fluid less what it carries,
//!
//! ```text
//!   push = -p a + nu (grad u + grad u^T) a - u (u . a).
//! ```

use crate::numerics::sparse_lu::dot;

/// A small area and the flow there, in D dimensions; or the cotangents of these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch<const D: usize> {
    pub velocity: [f64; D],
    /// The derivative of u_e along b at `[e][b]`.
    pub gradient: [[f64; D]; D],
    pub pressure: f64,
    /// Normal times area.
    pub area: [f64; D],
}

/// A vector along one direction.
pub fn unit<const N: usize>(along: usize, length: f64) -> [f64; N] {
    std::array::from_fn(|k| if k == along { length } else { 0.0 })
}

impl<const D: usize> Patch<D> {
    /// Twice the rate of strain.
    fn strain(&self, e: usize, b: usize) -> f64 {
        self.gradient[e][b] + self.gradient[b][e]
    }

    /// The push along e, given the kinematic viscosity.
    pub fn push(&self, viscosity: f64, e: usize) -> f64 {
        let viscous: f64 = (0..D).map(|b| viscosity * self.strain(e, b) * self.area[b]).sum();
        viscous - self.pressure * self.area[e] - self.velocity[e] * dot(&self.velocity, &self.area)
    }

    /// The cotangents of the patch and of the viscosity, given those of the push.
    pub fn push_back(&self, viscosity: f64, weight: [f64; D]) -> (Self, f64) {
        let (u, a) = (self.velocity, self.area);
        let (through, carried) = (dot(&u, &a), dot(&weight, &u));
        let strained = |b: usize| -> f64 { (0..D).map(|e| weight[e] * self.strain(e, b)).sum() };
        let back = Self {
            velocity: std::array::from_fn(|b| -carried * a[b] - weight[b] * through),
            gradient: std::array::from_fn(|e| {
                std::array::from_fn(|b| viscosity * (weight[e] * a[b] + weight[b] * a[e]))
            }),
            pressure: -dot(&weight, &a),
            area: std::array::from_fn(|b| viscosity * strained(b) - carried * u[b] - weight[b] * self.pressure),
        };
        (back, (0..D).map(|b| strained(b) * a[b]).sum())
    }
}
