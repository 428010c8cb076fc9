//! The shapes of custom scenes, and which positions they contain.

use crate::config::custom::{functions, Kind, ShapeEntry};
use crate::config::formula::{Formula, Function, ReadFormula};
use crate::error::BadInput;
use crate::sph::cloud::nearest::Plane;
pub(super) use crate::sph::cloud::outline::is_inside;
use crate::sph::cloud::outline::{area_within, Outline};
use std::f64::consts::PI;

/// The edges of round outlines turn by no more. Radians.
const ROUND: f64 = 0.01;

/// A shape with parsed formulas.
pub struct Shape<'a> {
    pub entry: &'a ShapeEntry,
    pub positive: Option<Function>,
    pub on_wall: OnWall,
    /// A fine polygon, of shapes that are curves.
    pub polygon: Vec<[f64; 2]>,
}

/// What formulas give on a wall.
#[derive(Debug)]
pub struct OnWall {
    pub velocity: Vec<Function>,
    pub temperature: Option<Function>,
    /// Into the fluid.
    pub heat_flux: Option<Function>,
}

impl OnWall {
    /// Parses the formulas of a shape or side; `key` is its key in messages, such as `shapes[2]`.
    ///
    /// # Errors
    /// An invalid formula.
    pub fn new(
        key: &str,
        dimension: usize,
        velocity: Option<&Vec<Formula>>,
        temperature: Option<&Formula>,
        heat_flux: Option<&Formula>,
        read: ReadFormula,
    ) -> Result<Self, BadInput> {
        let one = |name: &str, formula: Option<&Formula>| {
            formula.map(|formula| read(formula, &format!("{key}.{name}"), dimension)).transpose()
        };
        Ok(Self {
            velocity: match velocity {
                Some(velocity) => functions(&format!("{key}.velocity"), velocity, dimension, read)?,
                None => vec![],
            },
            temperature: one("temperature", temperature)?,
            heat_flux: one("heat_flux", heat_flux)?,
        })
    }

    pub fn of_shape(place: usize, entry: &ShapeEntry, dimension: usize, read: ReadFormula) -> Result<Self, BadInput> {
        let ShapeEntry { velocity, temperature, heat_flux, .. } = entry;
        let key = format!("shapes[{place}]");
        Self::new(&key, dimension, velocity.as_ref(), temperature.as_ref(), heat_flux.as_ref(), read)
    }

    fn all(&self) -> impl Iterator<Item = &Function> {
        self.velocity.iter().chain(&self.temperature).chain(&self.heat_flux)
    }

    /// Whether any of them depends on the place (or time).
    pub fn varies(&self) -> bool {
        self.all().any(|function| !function.is_constant())
    }

    /// Whether any of them depends on time.
    pub fn has_time(&self) -> bool {
        self.all().any(Function::has_time)
    }
}

impl<'a> Shape<'a> {
    pub fn new(entry: &'a ShapeEntry, place: usize, dimension: usize) -> Result<Self, BadInput> {
        let positive = entry.positive.as_ref();
        let positive = positive.map(|formula| formula.function(&format!("shapes[{place}].positive"), dimension));
        Ok(Self {
            entry,
            positive: positive.transpose()?,
            on_wall: OnWall::of_shape(place, entry, dimension, Formula::function)?,
            polygon: polygon(entry),
        })
    }

    /// Whether the shape contains a position, without periodic images.
    pub fn contains(&self, p: [f64; 3], dimension: usize) -> bool {
        let ShapeEntry { kind, lower, upper, centre, radius, axis, points, thickness, .. } = self.entry;
        // A checked configuration has the keys that its kind needs.
        let (lower, upper) = (lower.as_deref().unwrap_or_default(), upper.as_deref().unwrap_or_default());
        let (centre, radius) = (centre.as_deref().unwrap_or_default(), radius.unwrap_or_default());
        let points = points.as_deref().unwrap_or_default();
        match kind {
            Kind::Box => (0..dimension).all(|d| lower[d] <= p[d] && p[d] < upper[d]),
            Kind::Disc => (0..dimension).map(|d| (p[d] - centre[d]).powi(2)).sum::<f64>() < radius * radius,
            Kind::Cylinder => {
                let along = axis.unwrap_or_default().direction();
                let across = (0..dimension).filter(|&d| d != along);
                across.map(|d| (p[d] - centre[d]).powi(2)).sum::<f64>() < radius * radius
            }
            Kind::Polyline => {
                let half = 0.5 * thickness.unwrap_or_default();
                points.windows(2).any(|ends| distance([p[0], p[1]], ends[0], ends[1]) < half)
            }
            Kind::Polygon => is_inside([p[0], p[1]], points),
            Kind::Ellipse | Kind::Spline | Kind::BSpline | Kind::Naca => is_inside([p[0], p[1]], &self.polygon),
            Kind::File => false,
            Kind::Where => self.positive.as_ref().is_some_and(|positive| positive.at(p) > 0.0),
        }
    }

    /// The corners of its outline in the plane, counter-clockwise, of round ones close ones; none of `where`.
    pub(super) fn outline(&self, plane: &Plane) -> Vec<[f64; 2]> {
        let ShapeEntry { lower, upper, centre, radius, points, thickness, .. } = self.entry;
        // A checked configuration has the keys that its kind needs.
        let plain = |of: &Option<Vec<f64>>| of.as_ref().map_or([0.0; 2], |of| [of[0], of[1]]);
        let points = points.as_deref().unwrap_or_default();
        let mut found = match self.entry.kind {
            Kind::Box => {
                let (mut low, mut high) = (plain(lower), plain(upper));
                // One that is longer than a period touches its own images.
                for d in 0..2 {
                    if plane.periodic[d] && high[d] - low[d] > plane.size[d] {
                        (low[d], high[d]) = (0.0, plane.size[d]);
                    }
                }
                vec![low, [high[0], low[1]], high, [low[0], high[1]]]
            }
            Kind::Disc => around(plain(centre), [1.0, 0.0], 2.0 * PI, radius.unwrap_or_default()),
            Kind::Polygon => points.to_vec(),
            Kind::Polyline => around_line(points, 0.5 * thickness.unwrap_or_default()),
            _ => self.polygon.clone(),
        };
        if area_within(found.len(), |k| found[k]) < 0.0 {
            found.reverse();
        }
        found
    }
}

/// A shape that is a curve as a polygon whose edges are a few hundredths of its size.
fn polygon(entry: &ShapeEntry) -> Vec<[f64; 2]> {
    if !entry.kind.is_curve() {
        return vec![];
    }
    let Some(outline) = Outline::new(entry, 0.0) else { return vec![] };
    let samples = outline.samples(if entry.kind == Kind::Naca { 1 } else { 12 });
    outline.points(&samples, &outline.numbers).iter().map(|on| on.place).collect()
}

/// Points on an arc about `centre` that begins in a direction.
fn around(centre: [f64; 2], [x, y]: [f64; 2], turn: f64, radius: f64) -> Vec<[f64; 2]> {
    let count = (turn / ROUND).ceil();
    let at = |k: usize| {
        let (sin, cos) = (turn * k as f64 / count).sin_cos();
        [centre[0] + radius * (x * cos - y * sin), centre[1] + radius * (x * sin + y * cos)]
    };
    (0..=count as usize).map(at).collect()
}

/// What is no farther than `half` from a line through points.
fn around_line(points: &[[f64; 2]], half: f64) -> Vec<[f64; 2]> {
    // There and back, with the line on the left.
    let way: Vec<[f64; 2]> =
        points.iter().chain(points.iter().rev().skip(1).take(points.len().saturating_sub(2))).copied().collect();
    let corner = |k: usize| {
        let (before, own, after) = (way[(k + way.len() - 1) % way.len()], way[k], way[(k + 1) % way.len()]);
        let (a, b) = (right_of(before, own), right_of(own, after));
        let turn = (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]);
        match turn {
            // It turns back at its ends.
            _ if turn.abs() > PI - 1e-9 => around(own, a, PI, half),
            _ if turn > 0.0 => around(own, a, turn, half),
            _ => {
                let by = half / (1.0 + a[0] * b[0] + a[1] * b[1]);
                vec![[own[0] + by * (a[0] + b[0]), own[1] + by * (a[1] + b[1])]]
            }
        }
    };
    (0..way.len()).flat_map(corner).collect()
}

/// The unit normal on the right of an edge.
pub(super) fn right_of(from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length = along[0].hypot(along[1]);
    [along[1] / length, -along[0] / length]
}

/// The distance of a point from the segment between two others.
pub(super) fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (along, to) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = along[0] * along[0] + along[1] * along[1];
    let part = if square > 0.0 { ((to[0] * along[0] + to[1] * along[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (to[0] - part * along[0]).hypot(to[1] - part * along[1])
}
