//! The wall as a smooth function of x along the channel and z across it, with n x m control points c_jk over the hot
//! section a < x < b and the span 0 <= z < S, which is periodic:
//!
//! ```text
//!   y(x, z) = sum_jk c_jk N_j(x) P_k(z)
//!   N_j(x)  = B((x - a)/h - j),                       h = (b - a)/(n + 3),   j = 0 ... n - 1
//!   P_k(z)  = sum over whole r of B(z/g - k + 3/2 + m r),      g = S/m,      k = 0 ... m - 1
//!   B(t)    = (4 - 6 d^2 + 3 d^3)/6 for d = |t - 2| < 1, (2 - d)^3/6 for 1 <= d < 2, else 0
//! ```
//!
//! with the cardinal cubic B-spline B (de Boor, A Practical Guide to Splines, 1978, ch. IX). Unlike in
//! [`super::BSpline`], the knots are evenly spaced up to the ends of the hot section, so the wall and its first two
//! derivatives are zero there, and the surface has no steps. Along x the N_j sum to one from a + 3h to b - 3h and to
//! less outside; the P_k sum to one everywhere. So the condition |c_jk| <= bound limits |y|, and neighbours that differ
//! by at most 2 bound limit the slopes to 2 bound/h and 2 bound/g.
//!
//! Control points are numbered along x first, and are where their splines are largest: x = a + (j + 2) h, z = (k + 1/2)
//! g.

use super::column_averages::fitted;
use super::{ColumnAverages, Parametrisation, Variables};
use crate::config::scene::Config;
use crate::design::limits::Limits;
use crate::design::shape::Shape;

/// Points per control point and direction of a [`Parametrisation::sampled`] wall.
const SAMPLES: usize = 8;

#[derive(Debug, Clone, PartialEq)]
pub struct SplineSurface {
    /// The hot section.
    from: f64,
    to: f64,
    span: f64,
    /// Numbers of control points, n along x and m along z.
    counts: [usize; 2],
    /// z of each control point, `[n m]`.
    across: Vec<f64>,
    facts: Variables,
}

impl SplineSurface {
    /// The surface of a configuration, with heights at `places` (x, z).
    pub fn of_config(config: &Config, places: &[[f64; 2]]) -> Self {
        let (channel, design) = (&config.channel, &config.design);
        let counts = [design.control_points, design.control_points_across];
        let ([h, g], count) = (config.control_distances(), counts[0] * counts[1]);
        let each = |of: &dyn Fn(usize, usize) -> f64| {
            (0..count).map(|i| of(i % counts[0], i / counts[0])).collect::<Vec<f64>>()
        };
        let mut surface = Self {
            from: channel.hot_from,
            to: channel.hot_to,
            span: channel.span,
            counts,
            across: each(&|_, k| (k as f64 + 0.5) * g),
            facts: Variables {
                name: "design.offsets",
                positions: each(&|j, _| channel.hot_from + (j as f64 + 2.0) * h),
                limits: Limits::within(vec![-design.bound; count], vec![design.bound; count]),
                averages: ColumnAverages::new(count, vec![]),
            },
        };
        surface.facts.averages = surface.map(places.iter().copied());
        surface
    }

    /// The linear map from control points to heights at places.
    fn map(&self, places: impl Iterator<Item = [f64; 2]>) -> ColumnAverages {
        let weights = |[x, z]: [f64; 2]| {
            let (along, across) = (self.along(x), self.around(z));
            let pairs =
                across.iter().flat_map(|(k, p)| along.iter().map(move |(j, n)| (k * self.counts[0] + j, n * p)));
            pairs.collect()
        };
        ColumnAverages::new(self.variables(), places.map(weights).collect())
    }

    /// The N_j(x) that are not 0, as pairs (j, value).
    fn along(&self, x: f64) -> Vec<(usize, f64)> {
        let place = (x - self.from) / (self.to - self.from) * (self.counts[0] as f64 + 3.0);
        let values = (0..self.counts[0]).map(|j| (j, cubic(place - j as f64)));
        values.filter(|(_, value)| *value > 0.0).collect()
    }

    /// The P_k(z) that are not 0, as pairs (k, value).
    fn around(&self, z: f64) -> Vec<(usize, f64)> {
        let m = self.counts[1] as f64;
        let place = (z / self.span).rem_euclid(1.0) * m;
        // All periods that overlap this one: a spline is four control distances wide, while the span may have only one.
        let value = |k: usize| (-4..=4).map(|r| cubic(place - k as f64 + 1.5 + m * r as f64)).sum();
        (0..self.counts[1]).map(|k| (k, value(k))).filter(|(_, value)| *value > 0.0).collect()
    }

    /// The control points whose wall is nearest to heights at points (x, z).
    pub fn fitted(&self, x: &[f64], z: &[f64], heights: &[f64]) -> Vec<f64> {
        let map = self.map(x.iter().zip(z).map(|(&x, &z)| [x, z]));
        let mut points = fitted(&map, heights, vec![0.0; self.variables()]);
        self.limits().clamp(&mut points);
        points
    }
}

/// B(t).
fn cubic(t: f64) -> f64 {
    match (t - 2.0).abs() {
        d if d < 1.0 => (4.0 - 6.0 * d * d + 3.0 * d * d * d) / 6.0,
        d if d < 2.0 => (2.0 - d).powi(3) / 6.0,
        _ => 0.0,
    }
}

impl Parametrisation for SplineSurface {
    fn facts(&self) -> &Variables {
        &self.facts
    }

    fn across(&self) -> Option<&[f64]> {
        Some(&self.across)
    }

    fn height(&self, variables: &[f64], x: f64, z: f64) -> f64 {
        self.map([[x, z]].into_iter()).heights(variables)[0]
    }

    /// The heights on a grid over the hot section, x first.
    fn sampled(&self, variables: &[f64]) -> Shape {
        let evenly = |from: f64, width: f64, control_points: usize| -> Vec<f64> {
            let count = SAMPLES * control_points;
            (0..count).map(|i| from + (i as f64 + 0.5) * width / count as f64).collect()
        };
        let xs = evenly(self.from, self.to - self.from, self.counts[0]);
        let zs = evenly(0.0, self.span, self.counts[1]);
        let grid = || zs.iter().flat_map(|&z| xs.iter().map(move |&x| [x, z]));
        Shape {
            nodes: grid().map(|[x, _]| x).collect(),
            across: Some(grid().map(|[_, z]| z).collect()),
            offsets: self.map(grid()).heights(variables),
            top: None,
            hot_from: self.from,
            hot_to: self.to,
        }
    }

    /// Neighbours along x, and those along z, which is periodic.
    fn neighbours(&self) -> Vec<(usize, usize)> {
        let [n, m] = self.counts;
        let along = (0..m).flat_map(|k| (1..n).map(move |j| (k * n + j - 1, k * n + j)));
        let around = (0..m).flat_map(|k| (0..n).map(move |j| (k * n + j, (k + 1) % m * n + j)));
        along.chain(around).collect()
    }
}
