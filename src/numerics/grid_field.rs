//! Fields between the points of a grid: cubic Lagrange polynomials through the four nearest points along each axis.

/// A grid whose point i is at i L / N along an axis, in the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    pub shape: [usize; 2],
    pub size: [f64; 2],
    pub periodic: [bool; 2],
}

/// Points that a polynomial goes through.
pub const POINTS: usize = 4;

impl Grid {
    /// First point and weights along an axis. Beyond the ends of an axis that is not periodic the outermost polynomial goes on.
    fn along(&self, d: usize, x: f64) -> (i64, [f64; POINTS]) {
        let at = x / self.size[d] * self.shape[d] as f64;
        let first = at.floor() as i64 - 1;
        let last = (self.shape[d] - POINTS) as i64;
        let first = if self.periodic[d] { first } else { first.clamp(0, last) };
        let s = at - first as f64;
        let weight = |k: usize| {
            let others = (0..POINTS).filter(|&j| j != k);
            others.map(|j| (s - j as f64) / (k as f64 - j as f64)).product()
        };
        (first, std::array::from_fn(weight))
    }

    /// The points that the value at a place is a sum over, with their weights. Along each axis there are at least [`POINTS`].
    pub fn weights(&self, place: [f64; 2]) -> impl Iterator<Item = (usize, f64)> + '_ {
        let [(i, by_x), (j, by_y)] = [0, 1].map(|d| self.along(d, place[d]));
        let wrapped = |d: usize, k: i64| k.rem_euclid(self.shape[d] as i64) as usize;
        (0..POINTS * POINTS).map(move |k| {
            let (a, b) = (k / POINTS, k % POINTS);
            let point = wrapped(0, i + a as i64) * self.shape[1] + wrapped(1, j + b as i64);
            (point, by_x[a] * by_y[b])
        })
    }

    /// A field `[points]` at a place.
    pub fn value(&self, field: &[f64], place: [f64; 2]) -> f64 {
        self.weights(place).map(|(k, weight)| weight * field[k]).sum()
    }
}

/// A velocity on a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct GridVelocity {
    pub grid: Grid,
    /// `[2][points]`.
    pub velocity: [Vec<f64>; 2],
}
