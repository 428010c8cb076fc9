//! The wall as a cubic B-spline curve with n control points c_j over the hot section a < x < b:
//!
//! ```text
//!   y(x) = sum_j c_j N_j(x),      N_j cubic B-splines on the knots  a a a a  a + h ... b - h  b b b b,   h = (b - a) / (n - 3)
//! ```
//!
//! by the recurrence of Cox and de Boor (de Boor, A Practical Guide to Splines, 1978, ch. X; Piegl and Tiller, The
//! NURBS Book, 1997, algorithm A2.2). The end knots are fourfold ("clamped"), so the N_j sum to one in the whole
//! section, and the wall begins at c_0 and ends at c_{n-1}. Outside the section it is zero, so it may jump at both
//! ends, as with [`super::Nodes`]. Inside, it is twice continuously differentiable.
//!
//! The control points are at the Greville abscissae g_j = (t_{j+1} + t_{j+2} + t_{j+3}) / 3: with c_j = p + q g_j the
//! curve is the line p + q x. It lies in the convex hull of its control points, so |c_j| <= bound limits |y|; dy/dx is
//! a quadratic B-spline curve with the control points (c_{j+1} - c_j) / (g_{j+1} - g_j), so limits on those limit the
//! slope.

use super::column_averages::fitted;
use super::{ColumnAverages, Parametrisation, Polygon, Variables};
use crate::design::limits::Limits;
use crate::design::shape::{HotSection, Shape, MAX_SLOPE};
use crate::error::BadInput;

/// Smallest number of control points, for one cubic.
pub const FEWEST: usize = 4;

#[derive(Debug, Clone, PartialEq)]
pub struct BSpline {
    section: HotSection,
    /// Knots, `[n + 4]`.
    knots: Vec<f64>,
    /// Its positions are the Greville abscissae.
    facts: Variables,
}

impl BSpline {
    /// A curve with `control_points` of height up to `bound`.
    ///
    /// # Errors
    /// Fewer than [`FEWEST`] control points.
    pub fn new(control_points: usize, section: HotSection, bound: f64) -> Result<Self, BadInput> {
        if control_points < FEWEST {
            let problem = format!("design.control_points = {control_points} is too few for a cubic B-spline");
            return Err(BadInput::new(problem).key("design.control_points").allowed(format!("at least {FEWEST}")));
        }
        let spans = control_points - 3;
        let inner = (0..=spans).map(|k| match k {
            // The last knot is the end to the bit.
            _ if k == spans => section.to,
            _ => section.from + (section.to - section.from) * (k as f64 / spans as f64),
        });
        let knots: Vec<f64> = [section.from; 3].into_iter().chain(inner).chain([section.to; 3]).collect();
        let greville: Vec<f64> = (0..control_points).map(|j| knots[j + 1..j + 4].iter().sum::<f64>() / 3.0).collect();
        let facts = Variables {
            name: "control points",
            limits: Limits::symmetric(bound, &greville, MAX_SLOPE),
            positions: greville,
            averages: ColumnAverages::new(control_points, vec![]),
        };
        let mut spline = Self { section, knots, facts };
        let weights = section.weights(|from, to| spline.integrals(from, to));
        spline.facts.averages = ColumnAverages::new(control_points, weights);
        Ok(spline)
    }

    /// Uses the heights of a polygon, if given, instead of averages over columns.
    pub fn as_polygon(mut self, polygon: Option<&Polygon>) -> Self {
        if let Some(polygon) = polygon {
            let height = |variables: &[f64], x| self.height(variables, x, 0.0);
            self.facts.averages = ColumnAverages::of_polygon(self.variables(), polygon, height);
        }
        self
    }

    /// The last non-empty span k with knots[k] <= x < knots[k + 1].
    fn span(&self, x: f64) -> usize {
        let last = self.variables() - 1;
        (self.knots.partition_point(|knot| *knot <= x).max(4) - 1).min(last)
    }

    /// Index of the first of the four B-splines that are not zero at x, and their values.
    pub fn basis(&self, x: f64) -> (usize, [f64; 4]) {
        let span = self.span(x);
        let (mut left, mut right) = ([0.0; 4], [0.0; 4]);
        let mut values = [1.0, 0.0, 0.0, 0.0];
        for degree in 1..4 {
            left[degree] = x - self.knots[span + 1 - degree];
            right[degree] = self.knots[span + degree] - x;
            let mut carried = 0.0;
            for r in 0..degree {
                let share = values[r] / (right[r + 1] + left[degree - r]);
                values[r] = carried + right[r + 1] * share;
                carried = left[degree - r] * share;
            }
            values[degree] = carried;
        }
        (span - 3, values)
    }

    /// Integrals over `from ..= to` of the B-splines, as pairs (index, integral), by two Gauss points per piece between
    /// knots, which is exact for cubics.
    fn integrals(&self, from: f64, to: f64) -> Vec<(usize, f64)> {
        let (first, last) = (self.span(from) - 3, self.span(to));
        let mut integrals: Vec<(usize, f64)> = (first..=last).map(|j| (j, 0.0)).collect();
        let mut start = from;
        while start < to {
            let end = self.knots[self.span(start) + 1].min(to);
            let (middle, half) = (0.5 * (start + end), 0.5 * (end - start));
            for side in [-1.0, 1.0] {
                let (j, values) = self.basis(middle + side * half / 3f64.sqrt());
                for (k, value) in values.into_iter().enumerate() {
                    integrals[j + k - first].1 += half * value;
                }
            }
            if end <= start {
                break;
            }
            start = end;
        }
        integrals.retain(|(_, integral)| *integral > 0.0);
        integrals
    }

    /// The height of the curve inside the section and at its ends.
    fn curve(&self, variables: &[f64], x: f64) -> f64 {
        let (first, values) = self.basis(x);
        values.iter().zip(&variables[first..]).map(|(n, c)| n * c).sum()
    }

    /// Control points whose curve is nearest to a wall's offsets at its nodes and, if nodes are few, to the wall's
    /// heights at the Greville abscissae (see `fitted`), clamped to the limits.
    pub fn fitted(&self, wall: &Shape) -> Vec<f64> {
        let weights = wall.nodes.iter().map(|&x| {
            let (first, values) = self.basis(x);
            values.into_iter().enumerate().map(|(k, value)| (first + k, value)).collect()
        });
        let map = ColumnAverages::new(self.variables(), weights.collect());
        let inside = |x: f64| {
            let margin = 1e-9 * (self.section.to - self.section.from);
            x.clamp(self.section.from + margin, self.section.to - margin)
        };
        let first = self.positions().iter().map(|&g| wall.height(inside(g))).collect();
        let mut points = fitted(&map, &wall.offsets, first);
        self.limits().project(&mut points);
        points
    }
}

impl Parametrisation for BSpline {
    fn facts(&self) -> &Variables {
        &self.facts
    }

    fn height(&self, variables: &[f64], x: f64, _: f64) -> f64 {
        match self.section.from < x && x < self.section.to {
            true => self.curve(variables, x),
            false => 0.0,
        }
    }

    /// The heights at as many evenly spaced points as there are columns, at least four per control point.
    fn sampled(&self, variables: &[f64]) -> Shape {
        let section = self.section;
        let columns = (0..section.columns()).filter_map(|column| section.part(column)).count();
        let count = columns.max(4 * variables.len());
        let width = (section.to - section.from) / count as f64;
        let nodes: Vec<f64> = (0..count).map(|k| section.from + (k as f64 + 0.5) * width).collect();
        let offsets = nodes.iter().map(|&x| self.curve(variables, x)).collect();
        Shape { nodes, across: None, offsets, top: None, hot_from: section.from, hot_to: section.to }
    }
}
