//! The shapes of custom scenes, and which positions they contain.

use crate::config::custom::{functions, Kind, ShapeEntry};
use crate::config::formula::{Formula, Function, ReadFormula};
use crate::error::BadInput;
pub(super) use crate::sph::cloud::outline::is_inside;
use crate::sph::cloud::outline::Outline;

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

/// The distance of a point from the segment between two others.
pub(super) fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (along, to) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = along[0] * along[0] + along[1] * along[1];
    let part = if square > 0.0 { ((to[0] * along[0] + to[1] * along[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (to[0] - part * along[0]).hypot(to[1] - part * along[1])
}
