//! Outlines of shapes: closed curves that depend smoothly on the shape's numbers.
//!
//! An outline is c(t; s), t in [0, 1) counter-clockwise, s the numbers of the shape. It is written once for numbers and
//! once for [`Dual`] numbers, whose slopes are the exact derivatives by one of them. Corners are rounded: the last part of
//! both edges is replaced by a parabola (a quadratic Bezier curve with the corner as its middle control point).

use crate::config::custom::{Kind, Part, ShapeEntry};
use std::f64::consts::{PI, TAU};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number, or a number with its derivative by one other.
pub trait Scalar:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    fn of(value: f64) -> Self;
    /// Without its slope.
    fn value(self) -> f64;
    fn sqrt(self) -> Self;
    fn sin(self) -> Self;
    fn cos(self) -> Self;
}

impl Scalar for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn sin(self) -> Self {
        f64::sin(self)
    }
    fn cos(self) -> Self {
        f64::cos(self)
    }
}

/// value + slope e with e^2 = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual {
    pub value: f64,
    pub slope: f64,
}

impl Dual {
    pub fn new(value: f64, slope: f64) -> Self {
        Self { value, slope }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.value + other.value, self.slope + other.slope)
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.value - other.value, self.slope - other.slope)
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self::new(self.value * other.value, self.slope * other.value + self.value * other.slope)
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self::new(value, (self.slope - value * other.slope) / other.value)
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.value, -self.slope)
    }
}

impl Scalar for Dual {
    fn of(value: f64) -> Self {
        Self::new(value, 0.0)
    }
    fn value(self) -> f64 {
        self.value
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        Self::new(root, 0.5 * self.slope / root)
    }
    fn sin(self) -> Self {
        Self::new(self.value.sin(), self.slope * self.value.cos())
    }
    fn cos(self) -> Self {
        Self::new(self.value.cos(), -self.slope * self.value.sin())
    }
}

/// A point of an outline and the derivative by t there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnOutline<S> {
    pub place: [S; 2],
    pub along: [S; 2],
}

/// The outline of a shape.
#[derive(Debug, Clone)]
pub struct Outline {
    curve: Curve,
    /// The numbers of the shape, in the order of [`Part`]s.
    pub parts: Vec<Part>,
    pub numbers: Vec<f64>,
    /// How many of them the outline depends on; the others are parameters of formulas on the wall.
    pub geometry: usize,
    /// Whether the curve runs clockwise, as the corners of a polygon may.
    clockwise: bool,
}

#[derive(Debug, Clone)]
enum Curve {
    /// Centre and radius.
    Disc,
    /// Centre, semi-axes, and angle in degrees.
    Ellipse,
    /// Centre and radii: r(angle) is the periodic cubic spline through them. `curvature`: second derivatives at the
    /// knots by the radii, `[n, n]`.
    Radial { curvature: Vec<f64> },
    /// Control points of a closed uniform cubic B-spline.
    BSpline,
    /// Corners, of which lengths `[n]` of both edges are rounded off.
    Path { corners: Corners, cut: Vec<f64> },
}

/// How the corners of a path follow from numbers.
#[derive(Debug, Clone)]
enum Corners {
    /// x and y of each.
    Given,
    /// Those of a box: lower x, lower y, upper x, upper y.
    Box,
    /// Those around a line of points with a thickness, the last number.
    Line,
    /// Constant points, turned by an angle in degrees, made larger and moved: centre, size, angle.
    Moved(Vec<[f64; 2]>),
}

/// Corners that round the end of a line, without the two at its sides.
const CAP: usize = 5;

/// The thickness of a NACA four-digit section with a closed trailing edge (Abbott and von Doenhoff 1959).
fn naca(digits: &str) -> Vec<[f64; 2]> {
    let digit = |k: usize| digits.as_bytes().get(k).map_or(0.0, |d| f64::from(d - b'0'));
    let (camber, place, thickness) = (0.01 * digit(0), 0.1 * digit(1), 0.1 * digit(2) + 0.01 * digit(3));
    let count = 80;
    let mut points = vec![];
    for k in 0..2 * count {
        // From the trailing edge along the upper side to the leading edge, and back below.
        let angle = PI * k as f64 / count as f64;
        let (x, upper) = (0.5 * (1.0 + angle.cos()), k < count);
        let half = 5.0 * thickness * (0.2969 * x.sqrt() + x * (-0.1260 + x * (-0.3516 + x * (0.2843 - 0.1036 * x))));
        let (line, slope) = match x < place {
            _ if camber == 0.0 || place == 0.0 => (0.0, 0.0),
            true => (camber / (place * place) * (2.0 * place - x) * x, 2.0 * camber / (place * place) * (place - x)),
            false => {
                let rest = (1.0 - place) * (1.0 - place);
                (camber / rest * (1.0 - 2.0 * place + (2.0 * place - x) * x), 2.0 * camber / rest * (place - x))
            }
        };
        let (sin, cos) = slope.atan().sin_cos();
        let side = if upper { half } else { -half };
        points.push([x - side * sin - 0.5, line + side * cos]);
    }
    points
}

fn sum<S: Scalar>(a: [S; 2], b: [S; 2]) -> [S; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

fn difference<S: Scalar>(a: [S; 2], b: [S; 2]) -> [S; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn scaled<S: Scalar>(factor: S, a: [S; 2]) -> [S; 2] {
    [factor * a[0], factor * a[1]]
}

pub(super) fn cross<S: Scalar>(a: [S; 2], b: [S; 2]) -> S {
    a[0] * b[1] - a[1] * b[0]
}

pub(super) fn length<S: Scalar>(a: [S; 2]) -> S {
    (a[0] * a[0] + a[1] * a[1]).sqrt()
}

/// The point with coordinates along and across a direction.
fn turned<S: Scalar>(along: [S; 2], x: S, y: S) -> [S; 2] {
    [along[0] * x - along[1] * y, along[1] * x + along[0] * y]
}

fn radians<S: Scalar>(degrees: S) -> S {
    degrees * S::of(PI / 180.0)
}

impl Corners {
    fn of<S: Scalar>(&self, s: &[S]) -> Vec<[S; 2]> {
        let pairs = |s: &[S]| s.chunks_exact(2).map(|c| [c[0], c[1]]).collect::<Vec<[S; 2]>>();
        match self {
            Self::Given => pairs(s),
            Self::Box => vec![[s[0], s[1]], [s[2], s[1]], [s[2], s[3]], [s[0], s[3]]],
            Self::Moved(points) => {
                let angle = radians(s[3]);
                let along = [angle.cos(), angle.sin()];
                let point = |[x, y]: &[f64; 2]| sum([s[0], s[1]], turned(along, s[2] * S::of(*x), s[2] * S::of(*y)));
                points.iter().map(point).collect()
            }
            Self::Line => {
                let (points, half) = (pairs(&s[..s.len() - 1]), s[s.len() - 1] * S::of(0.5));
                // Along the line on its right side, round its end, and back on the other side.
                let there: Vec<[S; 2]> = points.clone();
                let back: Vec<[S; 2]> = points.iter().rev().copied().collect();
                let mut corners = vec![];
                for way in [there, back] {
                    for k in 0..way.len() - 1 {
                        let along = |k: usize| {
                            let edge = difference(way[k + 1], way[k]);
                            scaled(S::of(1.0) / length(edge), edge)
                        };
                        let now = along(k);
                        if k == 0 {
                            corners.push(sum(way[0], turned(now, S::of(0.0), -half)));
                        } else {
                            // Where the sides of both edges meet.
                            let before = along(k - 1);
                            let middle = sum(before, now);
                            let square = middle[0] * middle[0] + middle[1] * middle[1];
                            corners.push(sum(way[k], turned(scaled(S::of(2.0) / square, middle), S::of(0.0), -half)));
                        }
                        if k + 2 == way.len() {
                            corners.push(sum(way[k + 1], turned(now, S::of(0.0), -half)));
                            for c in 1..=CAP {
                                let (sin, cos) = (PI * c as f64 / (CAP + 1) as f64 - 0.5 * PI).sin_cos();
                                // Corners a little outside of the round, so that parabolas between them follow it.
                                let out = half * S::of(1.0 / (0.5 * PI / (CAP + 1) as f64).cos().sqrt());
                                corners.push(sum(way[k + 1], turned(now, out * S::of(cos), out * S::of(sin))));
                            }
                        }
                    }
                }
                corners
            }
        }
    }
}

impl Outline {
    /// The outline of a checked shape, whose corners are rounded to about `radius`; none for a shape given by a formula.
    pub fn new(entry: &ShapeEntry, radius: f64) -> Option<Self> {
        let mut parts = vec![];
        let mut numbers = vec![];
        let mut add = |part: Part, number: f64| {
            parts.push(part);
            numbers.push(number);
        };
        let mut vector = |of: fn(usize) -> Part, numbers: &Option<Vec<f64>>| {
            numbers.iter().flatten().enumerate().for_each(|(k, x)| add(of(k), *x));
        };
        let path = |corners: Corners| Curve::Path { corners, cut: vec![] };
        let curve = match entry.kind {
            Kind::Disc => {
                vector(Part::Centre, &entry.centre);
                add(Part::Radius, entry.radius?);
                Curve::Disc
            }
            Kind::Ellipse => {
                vector(Part::Centre, &entry.centre);
                vector(Part::Axis, &entry.axes);
                add(Part::Angle, entry.angle.unwrap_or(0.0));
                Curve::Ellipse
            }
            Kind::Spline => {
                vector(Part::Centre, &entry.centre);
                vector(Part::Radii, &entry.radii);
                Curve::Radial { curvature: curvatures(entry.radii.as_ref()?.len()) }
            }
            Kind::Box => {
                vector(Part::Lower, &entry.lower);
                vector(Part::Upper, &entry.upper);
                path(Corners::Box)
            }
            Kind::Polygon | Kind::Polyline | Kind::BSpline => {
                for (k, [x, y]) in entry.points.iter().flatten().enumerate() {
                    add(Part::Point(k, 0), *x);
                    add(Part::Point(k, 1), *y);
                }
                match entry.kind {
                    Kind::Polyline => {
                        add(Part::Thickness, entry.thickness?);
                        path(Corners::Line)
                    }
                    Kind::Polygon => path(Corners::Given),
                    _ => Curve::BSpline,
                }
            }
            Kind::Naca => {
                vector(Part::Centre, &entry.centre);
                add(Part::Chord, entry.chord.unwrap_or(1.0));
                add(Part::Angle, entry.angle.unwrap_or(0.0));
                path(Corners::Moved(naca(entry.digits.as_deref()?)))
            }
            Kind::Cylinder | Kind::Where | Kind::File => return None,
        };
        let geometry = numbers.len();
        parts.extend((0..entry.parameters.len()).map(Part::Parameter));
        numbers.extend(&entry.parameters);
        let mut outline = Self { curve, parts, numbers, geometry, clockwise: false };
        if let Curve::Path { corners, cut } = &mut outline.curve {
            let points = corners.of(&outline.numbers[..geometry]);
            let n = points.len();
            *cut = (0..n)
                .map(|k| {
                    let (a, b, turn) = around_corner(&points, k);
                    // No more than a third of an edge is cut off at each end.
                    let least = length(a).min(length(b)) / 3.0;
                    (radius * (0.5 * turn.min(0.9 * PI)).tan()).clamp(1e-3 * least, least)
                })
                .collect();
        }
        let samples = outline.samples(16);
        outline.clockwise = area(&outline.points(&samples, &outline.numbers)) < 0.0;
        Some(outline)
    }

    /// Parameters along the whole curve, ascending; `each`: how many per part of it.
    pub fn samples(&self, each: usize) -> Vec<f64> {
        let pieces = match &self.curve {
            Curve::Disc | Curve::Ellipse => 16,
            Curve::Radial { .. } => self.geometry - 2,
            Curve::BSpline => self.geometry / 2,
            Curve::Path { cut, .. } => 2 * cut.len(),
        };
        let count = pieces * each;
        (0..count).map(|k| k as f64 / count as f64).collect()
    }

    /// The radius of a circle of the area within it.
    pub fn radius(&self) -> f64 {
        (area(&self.points(&self.samples(8), &self.numbers)).abs() / PI).sqrt()
    }

    /// Its corners in which it turns by more than 45 degrees: next to them fields have a singularity that the rounding cuts off.
    pub fn corners(&self) -> Vec<[f64; 2]> {
        let Curve::Path { corners, .. } = &self.curve else { return vec![] };
        let points = corners.of(&self.numbers[..self.geometry]);
        (0..points.len()).filter(|&k| around_corner(&points, k).2 > 0.25 * PI).map(|k| points[k]).collect()
    }

    /// The shape's centre: that which is among its numbers, or else the centroid of the area within the outline, drawn with a few straight
    /// lines for each piece.
    pub fn centre<S: Scalar>(&self, s: &[S]) -> [S; 2] {
        let number = |d: usize| self.parts.iter().position(|part| *part == Part::Centre(d));
        match (number(0), number(1)) {
            (Some(x), Some(y)) => [s[x], s[y]],
            _ => {
                let points = self.points(&self.samples(8), s);
                centroid_within(points.len(), |k| points[k].place)
            }
        }
    }

    /// The width in t of pieces between which the outline may turn; none where it is smooth.
    pub fn piece(&self) -> Option<f64> {
        match &self.curve {
            Curve::Path { cut, .. } => Some(0.5 / cut.len() as f64),
            _ => None,
        }
    }

    /// Points at parameters, for numbers of the shape.
    pub fn points<S: Scalar>(&self, parameters: &[f64], s: &[S]) -> Vec<OnOutline<S>> {
        self.points_at(&parameters.iter().map(|&t| S::of(t)).collect::<Vec<_>>(), s)
    }

    /// Points at parameters that depend on the numbers, too.
    pub fn points_at<S: Scalar>(&self, parameters: &[S], s: &[S]) -> Vec<OnOutline<S>> {
        let s = &s[..self.geometry];
        let way = if self.clockwise { -1.0 } else { 1.0 };
        let corners = match &self.curve {
            Curve::Path { corners, .. } => corners.of(s),
            _ => vec![],
        };
        let curvature: Vec<S> = match &self.curve {
            Curve::Radial { curvature } => {
                let radii = &s[2..];
                let row = |row: &[f64]| row.iter().zip(radii).fold(S::of(0.0), |sum, (c, r)| sum + S::of(*c) * *r);
                curvature.chunks_exact(radii.len()).map(row).collect()
            }
            _ => vec![],
        };
        let at = |t: &S| {
            let t = if self.clockwise { S::of(1.0) - *t } else { *t };
            let found = self.at(t - S::of(t.value().floor()), s, &corners, &curvature);
            OnOutline { place: found.place, along: scaled(S::of(way), found.along) }
        };
        parameters.iter().map(at).collect()
    }

    fn at<S: Scalar>(&self, t: S, s: &[S], corners: &[[S; 2]], curvature: &[S]) -> OnOutline<S> {
        let (of, one) = (S::of, S::of(1.0));
        let angle = of(TAU) * t;
        let (sin, cos) = (angle.sin(), angle.cos());
        // The piece of so many that t is in, and the way through it.
        let within = |pieces: usize| {
            let place = t * of(pieces as f64);
            let piece = (place.value() as usize).min(pieces - 1);
            (piece, place - of(piece as f64))
        };
        match &self.curve {
            Curve::Disc => OnOutline {
                place: [s[0] + s[2] * cos, s[1] + s[2] * sin],
                along: [-(s[2] * of(TAU) * sin), s[2] * of(TAU) * cos],
            },
            Curve::Ellipse => {
                let angle = radians(s[4]);
                let axis = [angle.cos(), angle.sin()];
                OnOutline {
                    place: sum([s[0], s[1]], turned(axis, s[2] * cos, s[3] * sin)),
                    along: turned(axis, -(s[2] * of(TAU) * sin), s[3] * of(TAU) * cos),
                }
            }
            Curve::Radial { .. } => {
                let n = curvature.len();
                let (k, b) = within(n);
                let (width, next) = (TAU / n as f64, (k + 1) % n);
                let a = one - b;
                let (r0, r1, m0, m1) = (s[2 + k], s[2 + next], curvature[k], curvature[next]);
                let square = of(width * width / 6.0);
                let radius = r0 * a + r1 * b + m0 * (a * a * a - a) * square + m1 * (b * b * b - b) * square;
                let (sixth, three) = (of(width / 6.0), of(3.0));
                let slope = (r1 - r0) * of(1.0 / width)
                    + m0 * (one - three * a * a) * sixth
                    + m1 * (three * b * b - one) * sixth;
                let along = [slope * cos - radius * sin, slope * sin + radius * cos];
                OnOutline { place: [s[0] + radius * cos, s[1] + radius * sin], along: scaled(of(TAU), along) }
            }
            Curve::BSpline => {
                let n = s.len() / 2;
                let (k, u) = within(n);
                let (v, square) = (one - u, u * u);
                let cube = square * u;
                let (half, three) = (of(0.5), of(3.0));
                let basis = [
                    v * v * v,
                    three * cube - of(6.0) * square + of(4.0),
                    three * square - three * cube + three * u + one,
                    cube,
                ];
                let slope =
                    [-(half * v * v), of(1.5) * square - of(2.0) * u, u + half - of(1.5) * square, half * square];
                let (mut place, mut along) = ([of(0.0); 2], [of(0.0); 2]);
                for b in 0..4 {
                    let point = (k + b + n - 1) % n;
                    let point = [s[2 * point], s[2 * point + 1]];
                    place = sum(place, scaled(basis[b] * of(1.0 / 6.0), point));
                    along = sum(along, scaled(slope[b] * of(n as f64), point));
                }
                OnOutline { place, along }
            }
            Curve::Path { cut, .. } => {
                let n = corners.len();
                let (piece, u) = within(2 * n);
                let k = piece / 2;
                let unit = |from: usize, to: usize| {
                    let edge = difference(corners[to % n], corners[from % n]);
                    scaled(S::of(1.0) / length(edge), edge)
                };
                let (next, rate) = ((k + 1) % n, (2 * n) as f64);
                let ahead = unit(k, next);
                let end = difference(corners[next], scaled(S::of(cut[next]), ahead));
                if piece.is_multiple_of(2) {
                    // An edge between what is cut off at both ends.
                    let start = sum(corners[k], scaled(S::of(cut[k]), ahead));
                    let edge = difference(end, start);
                    return OnOutline { place: sum(start, scaled(u, edge)), along: scaled(S::of(rate), edge) };
                }
                // The corner after it.
                let after = sum(corners[next], scaled(S::of(cut[next]), unit(next, (next + 1) % n)));
                let (a, b) = (difference(corners[next], end), difference(after, corners[next]));
                let double = of(2.0) * u;
                let place = sum(end, sum(scaled(double - u * u, a), scaled(u * u, b)));
                let along = sum(scaled(of(2.0) - double, a), scaled(double, b));
                OnOutline { place, along: scaled(S::of(rate), along) }
            }
        }
    }

    /// The points with their derivatives by number `which` of the shape.
    pub fn slopes(&self, parameters: &[f64], s: &[f64], which: usize) -> Vec<OnOutline<Dual>> {
        self.points(parameters, &seeded(s, Some(which)))
    }
}

/// The edges before and after a corner of a closed line, and by how much it turns there.
fn around_corner(points: &[[f64; 2]], k: usize) -> ([f64; 2], [f64; 2], f64) {
    let n = points.len();
    let edge = |k: usize| difference(points[(k + 1) % n], points[k % n]);
    let (a, b) = (edge(k + n - 1), edge(k));
    (a, b, (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]).abs())
}

/// Numbers, of which one may be what derivatives are by.
pub fn seeded(s: &[f64], which: Option<usize>) -> Vec<Dual> {
    s.iter().enumerate().map(|(k, &x)| Dual::new(x, if Some(k) == which { 1.0 } else { 0.0 })).collect()
}

/// Whether a point is inside a closed line: a ray from it crosses the line an odd number of times.
pub fn is_inside([x, y]: [f64; 2], points: &[[f64; 2]]) -> bool {
    let mut inside = false;
    let mut from = points[points.len() - 1];
    for &to in points {
        if (from[1] > y) != (to[1] > y) && x < from[0] + (y - from[1]) / (to[1] - from[1]) * (to[0] - from[0]) {
            inside = !inside;
        }
        from = to;
    }
    inside
}

/// Area inside of a closed line of points, positive if it runs counter-clockwise.
pub fn area<S: Scalar>(points: &[OnOutline<S>]) -> S {
    area_within(points.len(), |k| points[k].place)
}

/// The area within a polygon, positive if it runs counter-clockwise, given its corners.
pub fn area_within<S: Scalar>(corners: usize, corner: impl Fn(usize) -> [S; 2]) -> S {
    let cross = |k: usize| {
        let (a, b) = (corner(k), corner((k + 1) % corners));
        a[0] * b[1] - a[1] * b[0]
    };
    S::of(0.5) * (0..corners).map(cross).fold(S::of(0.0), |sum, part| sum + part)
}

/// The centroid of the area within a polygon, given its corners.
pub fn centroid_within<S: Scalar>(corners: usize, corner: impl Fn(usize) -> [S; 2]) -> [S; 2] {
    // Seen from the first corner, which keeps digits.
    let first = corner(0);
    let mut moment = [S::of(0.0); 2];
    let mut twice_area = S::of(0.0);
    for k in 1..corners - 1 {
        let (a, b) = (difference(corner(k), first), difference(corner(k + 1), first));
        let cross = a[0] * b[1] - a[1] * b[0];
        twice_area = twice_area + cross;
        moment = sum(moment, scaled(cross, sum(a, b)));
    }
    sum(first, scaled(S::of(1.0 / 3.0) / twice_area, moment))
}

/// The second derivatives at n equal knots of a periodic cubic spline, by the values there, `[n, n]`:
/// m_{k-1} + 4 m_k + m_{k+1} = 6 (r_{k-1} - 2 r_k + r_{k+1}) / width^2.
fn curvatures(n: usize) -> Vec<f64> {
    let width = TAU / n as f64;
    // The system is circulant, so each row of its inverse is the first one shifted; solved by relaxation, which divides the
    // error by more than 2 in each turn.
    let mut column = vec![0.0; n];
    let right = |k: usize| match k {
        0 => -12.0,
        k if k == 1 && n == 2 => 12.0,
        k if k == 1 || k == n - 1 => 6.0,
        _ => 0.0,
    };
    for _ in 0..120 {
        for k in 0..n {
            column[k] = (right(k) / (width * width) - column[(k + n - 1) % n] - column[(k + 1) % n]) / 4.0;
        }
    }
    (0..n * n).map(|at| column[(at / n + n - at % n) % n]).collect()
}
