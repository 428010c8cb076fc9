//! The map from the numbers of shapes (a radius, a corner, a point of a line) to the initial state of a custom scene.
//!
//! A point on the surface keeps its relative place on its shape: the same angle on a disc, the same fraction of an
//! edge. When the numbers change it moves by d, and the normal of an edge turns from m to n. Then
//!
//! ```text
//!   points on the surface   move by d, and those that carry the normal get n
//!   dummy particles         move with their foot, by d - a (n - m) at depth a; their mirror image by d + a (n - m)
//!   fluid                   moves by sum_k w_k d_k / sum_k w_k over the points k, w_k = 1 / r_k^4 at the first numbers
//! ```
//!
//! so that fluid beside a wall moves with the wall, and fluid far from moving walls hardly moves (inverse distance
//! weighting, as in mesh deformation: Witteveen and Bijl, AIAA 2009-3996). The particles stay the same, so the state is
//! a smooth function of the numbers.

use crate::config::custom::{Kind, Part, ShapeEntry, ShapeNumber};
use crate::numerics::lanes::Real;
use crate::particles::Domain;

/// A vector; in two dimensions the last component is 0.
type Vector = [f64; 3];

#[derive(Debug, Clone)]
pub struct Shapes {
    /// The shapes with their initial numbers.
    pub entries: Vec<ShapeEntry>,
    /// The numbers that are variables.
    pub numbers: Vec<ShapeNumber>,
    pub domain: Domain,
    /// The first of the D rows of the state that hold normals and mirror images.
    pub vector: usize,
    pub points: Vec<Point>,
    pub dummies: Vec<Dummy>,
    pub fluid: Vec<usize>,
}

/// A place on a shape's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct On {
    pub shape: usize,
    pub at: At,
}

/// The relative place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum At {
    /// On a disc, ball or cylinder: the direction from the centre.
    Round(Vector),
    /// On a box: the fractions along its sides.
    Box(Vector),
    /// On a line: on the edge that ends at point `to`, at a fraction of its length. `away` is the side of a thick line,
    /// 1 or -1; `faces` is the side of the edge on which the fluid is.
    Edge { to: usize, share: f64, away: f64, faces: f64 },
    /// At an end or a corner of a line, in this direction from the point.
    Corner(usize, Vector),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    pub particle: usize,
    /// The place on a shape; none on a shape that never moves.
    pub on: Option<On>,
    /// Whether the point carries a normal.
    pub leans: bool,
    /// Whether the point moves the fluid. Of several points at one place only one does.
    pub leads: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dummy {
    pub particle: usize,
    pub foot: On,
    /// Depth behind the surface.
    pub depth: f64,
}

/// The derivative of a place and its normal by a variable.
struct Slope {
    variable: usize,
    place: Vector,
    normal: Vector,
}

/// The change of a place when the numbers change.
#[derive(Default)]
struct Moved {
    /// Displacement d.
    by: Vector,
    /// Change of the normal, n - m.
    turned: Vector,
    /// New normal n.
    normal: Option<Vector>,
}

fn unit(d: usize) -> Vector {
    std::array::from_fn(|e| if e == d { 1.0 } else { 0.0 })
}

fn scaled(factor: f64, a: Vector) -> Vector {
    a.map(|a| factor * a)
}

fn sum(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|e| a[e] + b[e])
}

fn minus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|e| a[e] - b[e])
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The ends of an edge, its length, and the unit vectors along it and to its left.
struct Edge {
    ends: [Vector; 2],
    length: f64,
    along: Vector,
    left: Vector,
}

impl Edge {
    fn of(entry: &ShapeEntry, to: usize) -> Self {
        let points = entry.points.as_deref().unwrap_or_default();
        let ends = [(to + points.len() - 1) % points.len(), to].map(|k| [points[k][0], points[k][1], 0.0]);
        let difference = minus(ends[1], ends[0]);
        let length = dot(difference, difference).sqrt();
        let along = scaled(1.0 / length, difference);
        Self { ends, length, along, left: [-along[1], along[0], 0.0] }
    }
}

/// Half the thickness of a line; 0 for the edges of a polygon.
fn half(entry: &ShapeEntry) -> f64 {
    0.5 * entry.thickness.unwrap_or(0.0)
}

/// Fractions within this distance of an edge's ends count as the ends.
const END: f64 = 1e-9;

impl On {
    /// The place on a shape's surface with this normal into the fluid; none on a shape that is given by a formula.
    pub fn of(shape: usize, entry: &ShapeEntry, place: Vector, normal: Vector) -> Option<Self> {
        let vector = |numbers: &Option<Vec<f64>>| {
            let numbers = numbers.as_deref().unwrap_or_default();
            std::array::from_fn(|d| numbers.get(d).copied().unwrap_or(0.0))
        };
        let at = match entry.kind {
            Kind::Disc | Kind::Cylinder => {
                let along = (entry.kind == Kind::Cylinder).then(|| entry.axis.unwrap_or_default().direction());
                let mut away: Vector = minus(place, vector(&entry.centre));
                along.into_iter().for_each(|d| away[d] = 0.0);
                At::Round(scaled(1.0 / dot(away, away).sqrt(), away))
            }
            Kind::Box => {
                let (lower, upper): (Vector, Vector) = (vector(&entry.lower), vector(&entry.upper));
                let share = |x: f64, low: f64, high: f64| if high > low { (x - low) / (high - low) } else { 0.0 };
                At::Box(std::array::from_fn(|d| share(place[d], lower[d], upper[d])))
            }
            Kind::Polyline | Kind::Polygon => {
                let count = entry.points.as_ref().map_or(0, Vec::len);
                let first = if entry.kind == Kind::Polygon { 0 } else { 1 };
                let flat = [place[0], place[1], 0.0];
                let share = |edge: &Edge| (dot(minus(flat, edge.ends[0]), edge.along) / edge.length).clamp(0.0, 1.0);
                let foot = |edge: &Edge| sum(edge.ends[0], scaled(share(edge) * edge.length, edge.along));
                let square = |a: Vector| dot(a, a);
                let edges = (first..count).map(|to| (to, Edge::of(entry, to)));
                let nearest = |a: &(usize, Edge), b: &(usize, Edge)| {
                    square(minus(flat, foot(&a.1))).total_cmp(&square(minus(flat, foot(&b.1))))
                };
                let (to, edge) = edges.min_by(nearest)?;
                let (share, away) = (share(&edge), minus(flat, foot(&edge)));
                let corner = match share {
                    share if share < END => Some((to + count - 1) % count),
                    share if share > 1.0 - END => Some(to),
                    _ => None,
                };
                match corner {
                    Some(point) => {
                        let size = square(away).sqrt();
                        At::Corner(point, scaled(if size > 0.0 { 1.0 / size } else { 0.0 }, away))
                    }
                    None => {
                        let away = dot(away, edge.left).signum();
                        At::Edge { to, share, away, faces: dot(normal, edge.left).signum() }
                    }
                }
            }
            Kind::Where | Kind::Ellipse | Kind::Spline | Kind::BSpline | Kind::Naca | Kind::File => return None,
        };
        Some(Self { shape, at })
    }

    /// The change from one shape to another.
    fn moved(&self, from: &ShapeEntry, to: &ShapeEntry) -> Moved {
        let of = |numbers: &Option<Vec<f64>>| numbers.clone().unwrap_or_default();
        let change = |from: &Option<Vec<f64>>, to: &Option<Vec<f64>>| -> Vector {
            let (from, to) = (of(from), of(to));
            std::array::from_fn(|d| if d < from.len() { to[d] - from[d] } else { 0.0 })
        };
        match self.at {
            At::Round(direction) => {
                let grown = to.radius.unwrap_or_default() - from.radius.unwrap_or_default();
                Moved { by: sum(change(&from.centre, &to.centre), scaled(grown, direction)), ..Moved::default() }
            }
            At::Box(share) => {
                let (lower, upper) = (change(&from.lower, &to.lower), change(&from.upper, &to.upper));
                let by = std::array::from_fn(|d| (1.0 - share[d]) * lower[d] + share[d] * upper[d]);
                Moved { by, ..Moved::default() }
            }
            At::Edge { to: point, share, away, faces } => {
                let [from_edge, to_edge] = [from, to].map(|entry| Edge::of(entry, point));
                let place = |entry: &ShapeEntry, edge: &Edge| {
                    let between = sum(scaled(1.0 - share, edge.ends[0]), scaled(share, edge.ends[1]));
                    sum(between, scaled(half(entry) * away, edge.left))
                };
                let normal = scaled(faces, to_edge.left);
                Moved {
                    by: minus(place(to, &to_edge), place(from, &from_edge)),
                    turned: minus(normal, scaled(faces, from_edge.left)),
                    normal: Some(normal),
                }
            }
            At::Corner(point, direction) => {
                let at = |entry: &ShapeEntry| {
                    let [x, y] = entry.points.as_deref().unwrap_or_default()[point];
                    sum([x, y, 0.0], scaled(half(entry), direction))
                };
                Moved { by: minus(at(to), at(from)), ..Moved::default() }
            }
        }
    }

    /// The derivatives of place and normal by a number of the shape, if they depend on it.
    fn slope(&self, entry: &ShapeEntry, part: Part) -> Option<(Vector, Vector)> {
        let still = [0.0; 3];
        match (self.at, part) {
            (At::Round(_), Part::Centre(d)) => Some((unit(d), still)),
            (At::Round(direction), Part::Radius) => Some((direction, still)),
            (At::Box(share), Part::Lower(d)) => Some((scaled(1.0 - share[d], unit(d)), still)),
            (At::Box(share), Part::Upper(d)) => Some((scaled(share[d], unit(d)), still)),
            (At::Edge { to, away, .. }, Part::Thickness) => Some((scaled(0.5 * away, Edge::of(entry, to).left), still)),
            (At::Edge { to, share, away, faces }, Part::Point(point, d)) => {
                let count = entry.points.as_ref().map_or(0, Vec::len);
                let (end, sign) = match point {
                    point if point == to => (share, 1.0),
                    point if (point + 1) % count == to => (1.0 - share, -1.0),
                    _ => return None,
                };
                let edge = Edge::of(entry, to);
                // The vector to the left turns by -along (left . change of the edge) / length.
                let turn = scaled(-sign * edge.left[d] / edge.length, edge.along);
                Some((sum(scaled(end, unit(d)), scaled(half(entry) * away, turn)), scaled(faces, turn)))
            }
            (At::Corner(at, _), Part::Point(point, d)) if at == point => Some((unit(d), still)),
            (At::Corner(_, direction), Part::Thickness) => Some((scaled(0.5, direction), still)),
            _ => None,
        }
    }
}

impl Shapes {
    /// The shapes after changes of the variables.
    pub fn changed(&self, changes: &[f64]) -> Vec<ShapeEntry> {
        let mut entries = self.entries.clone();
        for (number, change) in self.numbers.iter().zip(changes) {
            if let Some(it) = number.of(&mut entries) {
                *it += change;
            }
        }
        entries
    }

    fn moved(&self, on: Option<On>, entries: &[ShapeEntry]) -> Moved {
        on.map_or_else(Moved::default, |on| on.moved(&self.entries[on.shape], &entries[on.shape]))
    }

    fn slopes<'a>(&'a self, on: On, entries: &'a [ShapeEntry]) -> impl Iterator<Item = Slope> + 'a {
        let own = self.numbers.iter().enumerate().filter(move |(_, number)| number.shape == on.shape);
        own.filter_map(move |(variable, number)| {
            let (place, normal) = on.slope(&entries[on.shape], number.part)?;
            Some(Slope { variable, place, normal })
        })
    }

    /// The weight of each point that moves the fluid for a particle of the initial state, and the sum of weights.
    fn weights(&self, n: usize, base: &[f64], particle: usize) -> (Vec<f64>, f64) {
        let dimension = self.domain.dimension;
        let weight = |point: &Point| {
            let apart = |d: usize| self.domain.nearest(d, base[d * n + particle] - base[d * n + point.particle]);
            let square: f64 = (0..dimension).map(|d| apart(d).powi(2)).sum();
            1.0 / (square * square)
        };
        let weights: Vec<f64> = self.points.iter().map(|point| if point.leads { weight(point) } else { 0.0 }).collect();
        let sum = weights.iter().sum();
        (weights, sum)
    }

    /// Moves the particles of the initial state `[F, N]`.
    pub fn deform(&self, n: usize, changes: &[f64], state: &mut [f64]) {
        // Without changes the state stays the same to the bit.
        if changes.iter().all(|&change| change == 0.0) {
            return;
        }
        let (dimension, entries, base) = (self.domain.dimension, self.changed(changes), state.to_vec());
        let points: Vec<Moved> = self.points.iter().map(|point| self.moved(point.on, &entries)).collect();
        let mut step = |particle: usize, by: Vector| {
            for d in 0..dimension {
                let x = &mut state[d * n + particle];
                *x = self.domain.wrapped(d, *x + by[d]);
            }
        };
        for (point, moved) in self.points.iter().zip(&points) {
            step(point.particle, moved.by);
        }
        for &i in &self.fluid {
            let (weights, total) = self.weights(n, &base, i);
            let mut by = [0.0; 3];
            for (weight, moved) in weights.iter().zip(&points) {
                by = sum(by, scaled(weight / total, moved.by));
            }
            step(i, by);
        }
        let mut mirrors = Vec::with_capacity(self.dummies.len());
        for dummy in &self.dummies {
            let moved = self.moved(Some(dummy.foot), &entries);
            step(dummy.particle, minus(moved.by, scaled(dummy.depth, moved.turned)));
            mirrors.push(sum(moved.by, scaled(dummy.depth, moved.turned)));
        }
        for (dummy, by) in self.dummies.iter().zip(mirrors) {
            (0..dimension).for_each(|d| state[(self.vector + d) * n + dummy.particle] += by[d]);
        }
        for (point, moved) in self.points.iter().zip(&points) {
            if let Some(normal) = moved.normal.filter(|_| point.leans) {
                (0..dimension).for_each(|d| state[(self.vector + d) * n + point.particle] = normal[d]);
            }
        }
    }

    /// The adjoint of [`Self::deform`]: adds to the derivative by the changes.
    pub fn pull_back<R: Real>(
        &self,
        n: usize,
        base: &[f64],
        changes: &[f64],
        state_bar: &[R],
        changes_bar: &mut [f64],
    ) {
        let (dimension, entries) = (self.domain.dimension, self.changed(changes));
        let bar = |row: usize, i: usize| -> Vector {
            std::array::from_fn(|d| if d < dimension { state_bar[(row + d) * n + i].f64() } else { 0.0 })
        };
        let mut places: Vec<Vector> = self.points.iter().map(|point| bar(0, point.particle)).collect();
        for &i in &self.fluid {
            let (weights, total) = self.weights(n, base, i);
            let fluid = bar(0, i);
            for (place, weight) in places.iter_mut().zip(weights) {
                *place = sum(*place, scaled(weight / total, fluid));
            }
        }
        let mut add = |on: On, place: Vector, normal: Vector| {
            for slope in self.slopes(on, &entries) {
                changes_bar[slope.variable] += dot(slope.place, place) + dot(slope.normal, normal);
            }
        };
        for (point, place) in self.points.iter().zip(places) {
            if let Some(on) = point.on {
                add(on, place, if point.leans { bar(self.vector, point.particle) } else { [0.0; 3] });
            }
        }
        for dummy in &self.dummies {
            let (place, mirror) = (bar(0, dummy.particle), bar(self.vector, dummy.particle));
            add(dummy.foot, sum(place, mirror), scaled(dummy.depth, minus(mirror, place)));
        }
    }
}
