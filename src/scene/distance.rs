//! The surface of walls of any shape: signed distances, points on the surface, and normals.
//!
//! s(p) is the distance of a position from the nearest wall, negative inside walls: the smallest of all walls, and
//! where fluid is cut out the larger of s and minus that of the fluid's shape. For a shape given by a formula f it is
//! -f / |grad f|, which is accurate to first order near the surface. The foot of p on the surface is p - s grad s.

use super::custom_shape::{self, Shape};
use crate::config::custom::{Fill, Kind, ShapeEntry};
use crate::design::shapes::On;
use crate::particles::Domain;
use crate::sph::cloud::space::surface::from_all;
use std::collections::HashMap;

/// Walls in a box with its corner at 0.
pub struct Walls<'a> {
    pub shapes: &'a [Shape<'a>],
    pub domain: Domain,
    pub images: Vec<[f64; 3]>,
    pub spacing: f64,
}

/// Offsets of the periodic images of a shape in a box, including the shape itself.
pub fn images(domain: &Domain) -> Vec<[f64; 3]> {
    let has = |d: usize| d < domain.dimension && domain.periodic[d];
    (0..27)
        .map(|k| [k % 3, k / 3 % 3, k / 9])
        .filter(|image| (0..3).all(|d| image[d] == 1 || has(d)))
        .map(|image| std::array::from_fn(|d| if has(d) { (image[d] as f64 - 1.0) * domain.size[d] } else { 0.0 }))
        .collect()
}

/// The step of a difference quotient, in spacings.
const STEP: f64 = 1e-3;
/// Number of iterations that find a foot; on plane and round walls the first is exact.
const TURNS: usize = 4;
/// Largest distance of a foot from the surface, in spacings.
const CLOSE: f64 = 0.05;
/// Smallest distance between surface points, in spacings.
const APART: f64 = 0.45;

/// A point on the surface, and the unit normal there into the fluid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    pub place: [f64; 3],
    pub normal: [f64; 3],
}

impl Walls<'_> {
    /// The last shape that contains a position.
    pub fn shape_at(&self, p: [f64; 3]) -> Option<usize> {
        self.shapes.iter().rposition(|shape| {
            let images = if shape.entry.kind == Kind::Where { &[[0.0; 3]] } else { &self.images[..] };
            let shifted = |image: &[f64; 3]| std::array::from_fn(|e| p[e] + image[e]);
            images.iter().any(|image| shape.contains(shifted(image), self.domain.dimension))
        })
    }

    /// The distance s from the nearest wall.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        let mut walls = f64::INFINITY;
        for shape in self.shapes {
            let s = self.of_shape(shape, p);
            walls = match shape.entry.fill {
                Fill::Wall => walls.min(s),
                Fill::Fluid => walls.max(-s),
            };
        }
        // The sides of the box remain walls where fluid is cut out.
        walls.min(self.of_sides(p))
    }

    /// The distance from the closed sides of the box.
    fn of_sides(&self, p: [f64; 3]) -> f64 {
        let sides = (0..self.domain.dimension)
            .filter(|&d| !self.domain.periodic[d])
            .map(|d| p[d].min(self.domain.size[d] - p[d]));
        let outside = sides.clone().map(|s| s.min(0.0).powi(2)).sum::<f64>().sqrt();
        if outside > 0.0 {
            -outside
        } else {
            sides.fold(f64::INFINITY, f64::min)
        }
    }

    /// The place of a foot on its shape; none on a side of the box, or on a shape given by a formula.
    pub fn on(&self, foot: &Foot) -> Option<On> {
        let mut nearest = (self.of_sides(foot.place).abs(), None);
        for (k, shape) in self.shapes.iter().enumerate() {
            if shape.entry.kind == Kind::Where {
                let s = self.of_formula(shape, foot.place).abs();
                nearest = if s < nearest.0 { (s, None) } else { nearest };
                continue;
            }
            for image in &self.images {
                let place = std::array::from_fn(|d| foot.place[d] + image[d]);
                let s = of_entry(shape, place, &self.domain).abs();
                if s < nearest.0 {
                    nearest = (s, Some((k, place)));
                }
            }
        }
        let (k, place) = nearest.1?;
        On::of(k, self.shapes[k].entry, place, foot.normal)
    }

    /// The distance from a shape or the nearest of its periodic images.
    fn of_shape(&self, shape: &Shape, p: [f64; 3]) -> f64 {
        if shape.entry.kind == Kind::Where {
            return self.of_formula(shape, p);
        }
        let of = |image: &[f64; 3]| of_entry(shape, std::array::from_fn(|d| p[d] + image[d]), &self.domain);
        self.images.iter().map(of).fold(f64::INFINITY, f64::min)
    }

    fn of_formula(&self, shape: &Shape, p: [f64; 3]) -> f64 {
        let Some(positive) = &shape.positive else { return f64::INFINITY };
        let (_, steep) = self.slope_of(|p| positive.at(p), p);
        -positive.at(p) / steep.max(f64::MIN_POSITIVE)
    }

    /// grad s, normalised; none where it vanishes, half way between two walls.
    pub fn normal(&self, p: [f64; 3]) -> Option<[f64; 3]> {
        let (slope, length) = self.slope(p);
        (length.is_finite() && length > 0.1).then(|| slope.map(|x| x / length))
    }

    /// grad s and its length, which is 1 except where several walls are equally near.
    fn slope(&self, p: [f64; 3]) -> ([f64; 3], f64) {
        self.slope_of(|p| self.distance(p), p)
    }

    /// The gradient of a function, and its length.
    fn slope_of(&self, f: impl Fn([f64; 3]) -> f64, p: [f64; 3]) -> ([f64; 3], f64) {
        let h = STEP * self.spacing;
        let slope: [f64; 3] = std::array::from_fn(|d| {
            if d >= self.domain.dimension {
                return 0.0;
            }
            let at = |h: f64| f(std::array::from_fn(|e| if e == d { p[e] + h } else { p[e] }));
            (at(h) - at(-h)) / (2.0 * h)
        });
        (slope, slope.iter().map(|x| x * x).sum::<f64>().sqrt())
    }

    /// The foot of a position; none if no wall is near enough, and deep between two walls that touch.
    pub fn foot(&self, p: [f64; 3]) -> Option<Foot> {
        let mut place = p;
        for _ in 0..TURNS {
            let (s, normal) = (self.distance(place), self.normal(place)?);
            (0..self.domain.dimension).for_each(|d| place[d] -= s * normal[d]);
        }
        if self.distance(place).abs() > CLOSE * self.spacing {
            return None;
        }
        // s may have a kink on the surface; the normal towards the original position is well-defined.
        let along: [f64; 3] = std::array::from_fn(|d| p[d] - place[d]);
        let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
        let normal = match length > STEP * self.spacing {
            true => along.map(|x| x * self.distance(p).signum() / length),
            false => self.normal(place)?,
        };
        let foot = Foot { place, normal };
        // Where two walls touch, s is 0 inside them too.
        (self.distance(self.in_front(&foot)) > 0.0).then_some(foot)
    }

    fn in_front(&self, foot: &Foot) -> [f64; 3] {
        self.beside(foot, 0.25 * self.spacing)
    }

    /// The place at a distance from a foot, along its normal.
    pub fn beside(&self, foot: &Foot, by: f64) -> [f64; 3] {
        std::array::from_fn(|d| foot.place[d] + by * foot.normal[d])
    }

    /// The length of the way from a foot through the fluid (`side` 1) or the wall (-1) to the next surface; none if it
    /// is longer than `most`.
    pub fn way(&self, foot: &Foot, side: f64, most: f64) -> Option<f64> {
        let lengths = (1..).map(|k| f64::from(k) * self.spacing / 8.0).take_while(|&length| length <= most);
        lengths.skip(1).find(|&length| side * self.distance(self.beside(foot, side * length)) < 0.0)
    }

    /// The feet of positions, each at least `APART` from all before it. There are none in a corner between walls,
    /// which may have different conditions.
    pub fn points(&self, places: impl Iterator<Item = [f64; 3]>) -> Vec<Foot> {
        let mut feet: Vec<Foot> = Vec::new();
        let mut cells = Cells::new(self);
        for foot in places.filter_map(|place| self.foot(place)).filter(|foot| self.slope(self.in_front(foot)).1 > 0.9) {
            let near = |&k: &usize| self.apart(feet[k].place, foot.place) < APART * self.spacing;
            if !cells.around(foot.place).any(near) {
                cells.add(foot.place, feet.len());
                feet.push(foot);
            }
        }
        feet
    }

    /// The nearest foot of a position, if one is less than a spacing away.
    pub fn finder<'b>(&'b self, feet: &'b [Foot]) -> impl Fn([f64; 3]) -> Option<usize> + 'b {
        let mut cells = Cells::new(self);
        feet.iter().enumerate().for_each(|(k, foot)| cells.add(foot.place, k));
        move |place| {
            let apart = |k: usize| self.apart(feet[k].place, place);
            let near = cells.around(place).map(|&k| (k, apart(k)));
            near.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
        }
    }

    /// The distance between two positions or their nearest periodic images.
    pub fn apart(&self, a: [f64; 3], b: [f64; 3]) -> f64 {
        let along = |d: usize| self.domain.nearest(d, b[d] - a[d]);
        (0..self.domain.dimension).map(|d| along(d).powi(2)).sum::<f64>().sqrt()
    }
}

/// Indices of positions by cells about a spacing wide.
struct Cells {
    dimension: usize,
    /// Number of cells in a period; 0 in directions that are not periodic.
    counts: [i64; 3],
    widths: [f64; 3],
    members: HashMap<[i64; 3], Vec<usize>>,
}

impl Cells {
    fn new(walls: &Walls) -> Self {
        let domain = &walls.domain;
        let counts =
            |d: usize| if domain.periodic[d] { (domain.size[d] / walls.spacing).floor().max(1.0) } else { 0.0 };
        let width = |d: usize| if domain.periodic[d] { domain.size[d] / counts(d) } else { walls.spacing };
        Self {
            dimension: domain.dimension,
            counts: std::array::from_fn(|d| counts(d) as i64),
            widths: std::array::from_fn(width),
            members: HashMap::new(),
        }
    }

    fn cell(&self, place: [f64; 3], step: [i64; 3]) -> [i64; 3] {
        std::array::from_fn(|d| {
            if d >= self.dimension {
                return 0;
            }
            let cell = (place[d] / self.widths[d]).floor() as i64 + step[d];
            match self.counts[d] {
                0 => cell,
                count => cell.rem_euclid(count),
            }
        })
    }

    fn add(&mut self, place: [f64; 3], number: usize) {
        self.members.entry(self.cell(place, [0; 3])).or_default().push(number);
    }

    /// The members of a position's cell and the adjacent ones.
    fn around(&self, place: [f64; 3]) -> impl Iterator<Item = &usize> {
        let depth = if self.dimension == 3 { 3 } else { 1 };
        let steps = (0..9 * depth).map(move |k| [k % 3 - 1, k / 3 % 3 - 1, if depth == 3 { k / 9 - 1 } else { 0 }]);
        steps.filter_map(move |step| self.members.get(&self.cell(place, step))).flatten()
    }
}

/// The distance from a shape. A box that touches a closed side of the domain, or its own periodic image, has no surface
/// there.
fn of_entry(shape: &Shape, p: [f64; 3], domain: &Domain) -> f64 {
    let dimension = domain.dimension;
    let ShapeEntry { kind, lower, upper, centre, radius, axis, points, thickness, .. } = shape.entry;
    // A checked configuration has the keys that its kind needs.
    let (lower, upper) = (lower.as_deref().unwrap_or_default(), upper.as_deref().unwrap_or_default());
    let (centre, radius) = (centre.as_deref().unwrap_or_default(), radius.unwrap_or_default());
    let points = points.as_deref().unwrap_or_default();
    let from_axis = |skip: Option<usize>| {
        let across = (0..dimension).filter(|&d| Some(d) != skip);
        across.map(|d| (p[d] - centre[d]).powi(2)).sum::<f64>().sqrt() - radius
    };
    let from_lines = |ends: &mut dyn Iterator<Item = ([f64; 2], [f64; 2])>| {
        ends.map(|(a, b)| custom_shape::distance([p[0], p[1]], a, b)).fold(f64::INFINITY, f64::min)
    };
    match kind {
        Kind::Box => {
            let reaches = |d: usize| -> (f64, f64) {
                let touches = |place: f64, side: f64| (place - side).abs() < 1e-9 * domain.size[d];
                let closed = !domain.periodic[d];
                // A box as long as the period has no ends: it touches its own images.
                if !closed && upper[d] - lower[d] > domain.size[d] * (1.0 - 1e-9) {
                    return (f64::NEG_INFINITY, f64::INFINITY);
                }
                let low = if closed && touches(lower[d], 0.0) { f64::NEG_INFINITY } else { lower[d] };
                (low, if closed && touches(upper[d], domain.size[d]) { f64::INFINITY } else { upper[d] })
            };
            let beyond: Vec<f64> = (0..dimension)
                .map(|d| {
                    let (low, high) = reaches(d);
                    (low - p[d]).max(p[d] - high)
                })
                .collect();
            from_all(&beyond)
        }
        Kind::Disc => from_axis(None),
        Kind::Cylinder => from_axis(Some(axis.unwrap_or_default().direction())),
        Kind::Polyline => {
            from_lines(&mut points.windows(2).map(|ends| (ends[0], ends[1]))) - 0.5 * thickness.unwrap_or_default()
        }
        Kind::Polygon | Kind::Ellipse | Kind::Spline | Kind::BSpline | Kind::Naca => {
            let points = if *kind == Kind::Polygon { points } else { &shape.polygon };
            let ends = (0..points.len()).map(|k| (points[k], points[(k + 1) % points.len()]));
            let inside = custom_shape::is_inside([p[0], p[1]], points);
            from_lines(&mut ends.into_iter()) * if inside { -1.0 } else { 1.0 }
        }
        // See `of_formula`; a file is a polygon when it is loaded.
        Kind::Where | Kind::File => f64::INFINITY,
    }
}
