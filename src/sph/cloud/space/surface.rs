//! Surfaces of shapes in three dimensions, which depend smoothly on the shape's numbers.
//!
//! A [`Spot`] is a point of a surface by parameters that do not change when the shape does: a direction of a ball, shares of a
//! box's edges, the parameter of an outline. Place and area (normal into the fluid times area) at a spot are smooth functions of
//! the numbers, written once for numbers and [`super::super::outline::Dual`] ones.

use super::super::nearest::{Nearest, Plane, Region};
use super::super::outline::{cross, OnOutline, Outline, Scalar};
use super::super::placing::{lengths, spread, Polygon};
use super::facets::{Facet, Facets, HalfSpace, BESIDE};
use crate::config::custom::Part;
use std::f64::consts::PI;

/// A point of a surface, and the share of the surface that it stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spot {
    /// A direction from the centre of a ball, and a solid angle.
    Direction([f64; 3], f64),
    /// Of a ball that stands on sides: share of the way between its ends along the axis across these, angle around that axis, and share of the
    /// area, which is as large between any two heights of the same difference (Archimedes).
    Zone { at: f64, around: f64, share: f64 },
    /// A face of a box: its direction and end (0 low, 1 high), shares of the other two edges, share of the face's area.
    Face { along: usize, end: usize, at: [f64; 2], share: f64 },
    /// Parameter of an outline and its change, place along the axis and length there as shares of the column's.
    Column { t: f64, dt: f64, at: f64, length: f64 },
    /// Of an end of a column (0 low, 1 high): parameter of its outline and its change, and what shares of the way from the centroid to the
    /// outline are there, and between which it stands for the surface.
    End { end: usize, t: f64, dt: f64, out: f64, ring: [f64; 2] },
    /// A point of a surface of triangles, in the file's lengths and directions.
    Facet(Facet),
}

/// Place of a spot, and normal into the fluid times area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnSurface<S> {
    pub place: [S; 3],
    pub area: [S; 3],
}

/// An outline in the plane across `axis`, along all of the region or between two ends.
#[derive(Debug)]
pub struct Column {
    outline: Outline,
    axis: usize,
    /// Whether it has ends: the first numbers after those of the outline.
    has_ends: bool,
    /// The length of the region along the axis.
    region: f64,
    standing: Standing,
    polygon: Polygon,
    samples: Nearest<2>,
    plane: Plane,
}

/// The length of the region times this is nothing. (Files have seven digits.)
const NOTHING: f64 = 1e-9;
const NOTHING_OF_FILES: f64 = 1e-6;

/// What sides of the region a shape stands on: what of it is in these or behind them is not there, and the rest ends at the sides.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Standing {
    /// The places of sides on which its low and high ends would be.
    sides: [[Option<f64>; 2]; 3],
}

impl Standing {
    /// For the numbers of a ball.
    pub fn of_ball(region: &Region<3>, numbers: &[f64]) -> Self {
        Self { sides: std::array::from_fn(|d| Self::along(region, d, ball_ends(d, numbers), NOTHING)) }
    }

    /// For triangles and the numbers of their place.
    pub fn of_facets(region: &Region<3>, facets: &Facets, numbers: &[f64]) -> Self {
        let [low, high] = facets_corners(facets, numbers);
        Self { sides: std::array::from_fn(|d| Self::along(region, d, [low[d], high[d]], NOTHING_OF_FILES)) }
    }

    /// For the numbers of a box.
    pub fn of_box(region: &Region<3>, numbers: &[f64]) -> Self {
        Self { sides: std::array::from_fn(|d| Self::along(region, d, [numbers[d], numbers[3 + d]], NOTHING)) }
    }

    /// For a column between two ends along an axis.
    fn of_column(region: &Region<3>, axis: usize, ends: [f64; 2]) -> Self {
        let mut sides = [[None; 2]; 3];
        sides[axis] = Self::along(region, axis, ends, NOTHING);
        Self { sides }
    }

    /// The sides on which something with these ends stands.
    fn along(region: &Region<3>, d: usize, [low, high]: [f64; 2], nothing: f64) -> [Option<f64>; 2] {
        let size = region.size[d];
        let near = nothing * size;
        [(low <= near).then_some(0.0), (high >= size - near).then_some(size)]
            .map(|side| side.filter(|_| !region.periodic[d]))
    }

    fn stands(&self, d: usize, end: usize) -> bool {
        self.sides[d][end].is_some()
    }

    /// The directions across sides that it stands on.
    fn axes(&self) -> impl Iterator<Item = usize> + '_ {
        (0..3).filter(|&d| self.sides[d] != [None, None])
    }

    /// The sides: direction, place, and 1 if the region is above, or -1.
    fn each(&self) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let of = |k: usize| Some((k / 2, self.sides[k / 2][k % 2]?, if k.is_multiple_of(2) { 1.0 } else { -1.0 }));
        (0..6).filter_map(of)
    }

    /// Where what is in the region begins and ends along a direction, of something between two ends.
    fn ends<S: Scalar>(&self, d: usize, all: [S; 2]) -> [S; 2] {
        [0, 1].map(|end| self.sides[d][end].map_or(all[end], S::of))
    }

    /// The lower and the upper corner of what is in the region.
    fn corners<S: Scalar>(&self, s: &[S]) -> [S; 6] {
        let ends = [0, 1, 2].map(|d| self.ends(d, [s[d], s[3 + d]]));
        std::array::from_fn(|k| ends[k % 3][k / 3])
    }

    /// Half the length of what is in the region along a direction, of something between two ends: of what stands on a side as if mirrored by it,
    /// and without an end where it goes from side to side.
    fn half_length(&self, d: usize, all: [f64; 2]) -> f64 {
        let [low, high] = self.ends(d, all);
        let half = [0.5, 1.0, f64::INFINITY][(0..2).filter(|&end| self.stands(d, end)).count()];
        (high - low) * half
    }

    /// Places about a spacing apart along an edge as shares of it, and the step between them. The first row of layers at a distance from the
    /// surface is as far from a side as rows are from each other.
    fn rows(&self, d: usize, length: f64, spacing: f64, is_layer: bool) -> (Vec<f64>, f64) {
        let aside = [0, 1].map(|end| if is_layer && self.stands(d, end) { 1.0 } else { 0.5 });
        let rows = (length / spacing + 1.0 - aside[0] - aside[1]).round().max(1.0);
        let steps = rows - 1.0 + aside[0] + aside[1];
        ((0..rows as usize).map(|k| (k as f64 + aside[0]) / steps).collect(), 1.0 / steps)
    }
}

/// What a surface looks like.
#[derive(Debug)]
pub enum Form {
    /// Numbers: centre, radius.
    Ball(Standing),
    /// Numbers: lower and upper corner.
    Box(Standing),
    Column(Box<Column>),
    /// Numbers: centre, scale, degrees around the axis along z through the centre.
    Facets(Box<Facets>, Standing),
}

/// The surface of a shape.
#[derive(Debug)]
pub struct Surface {
    pub form: Form,
    pub parts: Vec<Part>,
    pub numbers: Vec<f64>,
    /// How many of the numbers the surface depends on.
    pub geometry: usize,
}

/// The two directions across an axis, so that they and the axis are right-handed.
pub fn across(axis: usize) -> [usize; 2] {
    [(axis + 1) % 3, (axis + 2) % 3]
}

fn plane_across(region: &Region<3>, axis: usize) -> Plane {
    let [a, b] = across(axis);
    Plane { size: [region.size[a], region.size[b]], periodic: [region.periodic[a], region.periodic[b]] }
}

/// A vector turned by an angle in degrees around z.
fn turned<S: Scalar>(r: [S; 3], degrees: S) -> [S; 3] {
    let angle = degrees * S::of(PI / 180.0);
    let (sin, cos) = (angle.sin(), angle.cos());
    [cos * r[0] - sin * r[1], sin * r[0] + cos * r[1], r[2]]
}

/// The lower and the upper corner of triangles, for the numbers of their place.
fn facets_corners(facets: &Facets, s: &[f64]) -> [[f64; 3]; 2] {
    facets.corners(|p| turned(p, s[4])).map(|corner| std::array::from_fn(|d| s[d] + s[3] * corner[d]))
}

/// About evenly spaced directions (a Fibonacci lattice on the sphere; Gonzalez 2010).
fn directions(count: usize) -> impl Iterator<Item = [f64; 3]> {
    let golden = PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |k| {
        let z = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (sin, cos) = (golden * k as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * cos, r * sin, z]
    })
}

/// The part of a volume that belongs to an area out of it, r . area over the number of directions that have a place from which r is measured.
pub fn part_of_volume<S: Scalar>(from: &[Option<f64>; 3], on: &OnSurface<S>) -> S {
    let counted = from.iter().enumerate().filter_map(|(d, from)| Some((d, (*from)?)));
    let (sum, count) = counted.fold((S::of(0.0), 0.0), |(sum, count), (d, from)| {
        (sum + (on.place[d] - S::of(from)) * on.area[d], count + 1.0)
    });
    sum * S::of(1.0 / count)
}

/// The distance from what is within several walls, from those of each: exact near one of them, and at right edges.
pub fn from_all(distances: &[f64]) -> f64 {
    let outside = distances.iter().map(|x| x.max(0.0).powi(2)).sum::<f64>().sqrt();
    outside + distances.iter().fold(f64::NEG_INFINITY, |most, x| most.max(*x)).min(0.0)
}

/// Points around an outline, of which those of every second row are half a point further.
fn in_row(k: usize, round: Vec<(f64, f64, f64)>) -> impl Iterator<Item = (f64, f64)> {
    let shift = if k.is_multiple_of(2) { 0.0 } else { 0.5 };
    round.into_iter().map(move |(t, dt, _)| ((t + shift * dt).rem_euclid(1.0), dt))
}

/// A ring of points of a ball: the angle from its lowest point, and the shares of its height between which they stand for it.
struct Ring {
    angle: f64,
    below: f64,
    above: f64,
}

impl Ring {
    fn middle(&self) -> f64 {
        0.5 * (self.below + self.above)
    }
}

/// The heights of the lowest and the highest point of a ball along a direction.
fn ball_ends<S: Scalar>(d: usize, s: &[S]) -> [S; 2] {
    [s[d] - s[3], s[d] + s[3]]
}

/// The area that a line from a centre to a point of an outline sweeps twice, by the parameter.
fn ring_area<S: Scalar>(centre: [S; 2], point: &OnOutline<S>) -> S {
    cross([0, 1].map(|d| point.place[d] - centre[d]), point.along)
}

impl Column {
    /// Where it begins and ends along its axis, for numbers of the shape, be it behind sides.
    fn all<S: Scalar>(&self, s: &[S]) -> [S; 2] {
        let g = self.outline.geometry;
        if self.has_ends {
            [s[g], s[g + 1]]
        } else {
            [0.0, self.region].map(S::of)
        }
    }

    /// Where what is in the region begins and ends.
    fn ends<S: Scalar>(&self, s: &[S]) -> [S; 2] {
        self.standing.ends(self.axis, self.all(s))
    }

    /// Points of the outline that is moved outwards.
    fn moved_out(&self, samples: &[f64], distance: f64) -> Vec<OnOutline<f64>> {
        let mut points = self.outline.points(samples, &self.outline.numbers);
        for point in &mut points {
            let length = point.along[0].hypot(point.along[1]);
            point.place[0] += distance * point.along[1] / length;
            point.place[1] -= distance * point.along[0] / length;
        }
        points
    }

    /// Spots around it in rows, at a distance from it.
    fn around(&self, numbers: &[f64], spacing: f64, distance: f64) -> Vec<Spot> {
        let samples = self.outline.samples(64);
        let way = lengths(&self.moved_out(&samples, distance));
        let round = spread(&samples, &way, &vec![spacing; samples.len()], true, 0.0, 1.0);
        let [low, high] = self.ends(numbers);
        let (rows, length) = self.standing.rows(self.axis, high - low, spacing, distance > 0.0);
        let row =
            |(k, at): (usize, f64)| in_row(k, round.clone()).map(move |(t, dt)| Spot::Column { t, dt, at, length });
        rows.into_iter().enumerate().flat_map(row).collect()
    }

    /// Spots on an end of it, in rings.
    fn on_end(&self, end: usize, spacing: f64) -> Vec<Spot> {
        let samples = self.outline.samples(64);
        let way = lengths(&self.moved_out(&samples, 0.0));
        let rings = ((self.polygon.area() / PI).sqrt() / spacing).round().max(1.0);
        let ring = |k: usize| {
            let ring = [k as f64 / rings, (k as f64 + 1.0) / rings];
            let out = 0.5 * (ring[0] + ring[1]);
            let round = spread(&samples, &way, &vec![spacing / out; samples.len()], true, 0.0, 1.0);
            in_row(k, round).map(move |(t, dt)| Spot::End { end, t, dt, out, ring })
        };
        (0..rings as usize).flat_map(ring).collect()
    }
}

impl Surface {
    /// A column along an axis with an outline across it, through all of the region or between two ends.
    pub fn column(outline: Outline, axis: usize, ends: Option<&[f64]>, region: &Region<3>) -> Self {
        let fine = outline.points(&outline.samples(32), &outline.numbers);
        let plane = plane_across(region, axis);
        let samples: Vec<[f64; 2]> = fine.iter().map(|point| plane.wrapped(point.place)).collect();
        let samples = Nearest::new(plane, 0.02 * plane.size[0].max(plane.size[1]), &samples);
        let (mut parts, mut numbers, mut geometry) = (outline.parts.clone(), outline.numbers.clone(), outline.geometry);
        for (k, end) in ends.into_iter().flatten().enumerate() {
            parts.insert(geometry, Part::End(k));
            numbers.insert(geometry, *end);
            geometry += 1;
        }
        let all = [0.0, region.size[axis]];
        let standing = Standing::of_column(region, axis, ends.map_or(all, |ends| [ends[0], ends[1]]));
        let (polygon, region, has_ends) = (Polygon::of(&fine), region.size[axis], ends.is_some());
        let column = Column { outline, axis, has_ends, region, standing, polygon, samples, plane };
        Self { form: Form::Column(Box::new(column)), parts, numbers, geometry }
    }

    /// Whether all of the outline is seen from the centroid of its section, if the shape is a column with ends: rings on these are the outline
    /// made smaller.
    pub fn has_seen_ends(&self) -> bool {
        let Form::Column(column) = &self.form else { return true };
        let Column { outline, has_ends, .. } = column.as_ref();
        let centre = outline.centre(&self.numbers);
        let sees = |point: &OnOutline<f64>| ring_area(centre, point) > 0.0;
        !has_ends || outline.points(&outline.samples(32), &outline.numbers).iter().all(sees)
    }

    /// The directions along which a surface that stands on sides may not move, since what is behind these would become its surface.
    pub fn is_held_along(&self, d: usize) -> bool {
        matches!(&self.form, Form::Facets(_, standing) if standing.axes().any(|axis| axis == d))
    }

    /// Whether the surface is a ball's that stands on sides which are not opposite.
    pub fn is_ball_in_edge(&self) -> bool {
        matches!(&self.form, Form::Ball(standing) if standing.axes().count() > 1)
    }

    /// Whether a surface of triangles is larger than the region along all directions, such as one in other units.
    pub fn is_larger(&self, region: &Region<3>) -> bool {
        let Form::Facets(facets, _) = &self.form else { return false };
        let [low, high] = facets_corners(facets, &self.numbers);
        (0..3).all(|d| high[d] - low[d] > region.size[d])
    }

    /// The least of its own lengths: radius, half of an edge; a part that stands on a side as if mirrored by it.
    pub fn size(&self) -> f64 {
        match &self.form {
            Form::Ball(standing) => {
                let length = |d: usize| standing.half_length(d, ball_ends(d, &self.numbers));
                standing.axes().map(length).fold(self.numbers[3], f64::min)
            }
            Form::Box(standing) => {
                let length = |d: usize| standing.half_length(d, [self.numbers[d], self.numbers[3 + d]]);
                (0..3).map(length).fold(f64::MAX, f64::min)
            }
            Form::Column(column) => {
                let along = match column.has_ends {
                    true => column.standing.half_length(column.axis, column.all(&self.numbers)),
                    false => f64::INFINITY,
                };
                (0.5 * column.polygon.area()).sqrt().min(along)
            }
            Form::Facets(facets, standing) => {
                let [low, high] = facets_corners(facets, &self.numbers);
                let length = |d: usize| standing.half_length(d, [low[d], high[d]]);
                standing.axes().map(length).fold(self.numbers[3] * facets.half_width, f64::min)
            }
        }
    }

    /// The distance of a place from the surface, negative inside.
    pub fn distance(&self, region: &Region<3>, p: [f64; 3]) -> f64 {
        match &self.form {
            Form::Ball(_) => region.distance([self.numbers[0], self.numbers[1], self.numbers[2]], p) - self.numbers[3],
            Form::Box(_) => {
                let half: [f64; 3] = std::array::from_fn(|d| 0.5 * (self.numbers[3 + d] - self.numbers[d]));
                let r = region.between(std::array::from_fn(|d| self.numbers[d] + half[d]), p);
                from_all(&[0, 1, 2].map(|d| r[d].abs() - half[d]))
            }
            Form::Column(column) => {
                let Column { axis, has_ends, polygon, samples, plane, .. } = column.as_ref();
                let [a, b] = across(*axis);
                let q = [p[a], p[b]];
                let distance = samples.distance(plane.wrapped(q), f64::INFINITY);
                let distance = if polygon.covers(plane, q) { -distance } else { distance };
                if !has_ends {
                    return distance;
                }
                let ([low, high], mut middle) = (column.all(&self.numbers), p);
                let half = 0.5 * (high - low);
                middle[*axis] = low + half;
                from_all(&[distance, region.between(middle, p)[*axis].abs() - half])
            }
            Form::Facets(facets, standing) => {
                // A face that is in a side belongs to the side, and what is there is behind it.
                let mut p = p;
                for (d, side, way) in standing.each() {
                    let least = side + 2.0 * way * NOTHING_OF_FILES * region.size[d];
                    p[d] = if way > 0.0 { p[d].max(least) } else { p[d].min(least) };
                }
                let r = region.between([self.numbers[0], self.numbers[1], self.numbers[2]], p);
                let scale = self.numbers[3];
                let back = turned(r, -self.numbers[4]);
                scale * facets.distance(back.map(|x| x / scale))
            }
        }
    }

    /// Spots about `spacing` apart on the surface at a distance from this one.
    pub fn spread(&self, region: &Region<3>, spacing: f64, distance: f64) -> Vec<Spot> {
        match &self.form {
            Form::Ball(standing) => {
                if let Some(axis) = standing.axes().next() {
                    return self.rings(standing, axis, spacing, distance);
                }
                let r = self.numbers[3] + distance;
                // A point of a hexagonal lattice takes sqrt(3) / 2 of its spacing squared.
                let count = (4.0 * PI * r * r / (0.9 * spacing * spacing)).ceil().max(20.0) as usize;
                directions(count).map(|n| Spot::Direction(n, 4.0 * PI / count as f64)).collect()
            }
            Form::Box(standing) => {
                let corners = standing.corners(&self.numbers);
                let mut spots = vec![];
                for along in 0..3 {
                    let [a, b] = across(along);
                    let rows = |d: usize| standing.rows(d, corners[3 + d] - corners[d], spacing, distance > 0.0).0;
                    let (m, n) = (rows(a), rows(b));
                    let share = 1.0 / (m.len() * n.len()) as f64;
                    for end in (0..2).filter(|&end| !standing.stands(along, end)) {
                        for &x in &m {
                            spots.extend(n.iter().map(|&y| Spot::Face { along, end, at: [x, y], share }));
                        }
                    }
                }
                spots
            }
            Form::Column(column) => {
                let mut spots = column.around(&self.numbers, spacing, distance);
                let is_there = |end: &usize| column.has_ends && !column.standing.stands(column.axis, *end);
                spots.extend((0..2).filter(is_there).flat_map(|end| column.on_end(end, spacing)));
                spots
            }
            Form::Facets(facets, standing) => {
                let (s, scale) = (&self.numbers, self.numbers[3]);
                let half_space = |(d, side, way): (usize, f64, f64)| {
                    let mut across = [0.0; 3];
                    across[d] = way;
                    // Layers at a distance from the surface begin one spacing from the side.
                    let aside = if distance > 0.0 { 0.5 * spacing } else { NOTHING_OF_FILES * region.size[d] };
                    HalfSpace { normal: turned(across, -s[4]), at: (way * (side - s[d]) + aside) / scale }
                };
                let within: Vec<HalfSpace> = standing.each().map(half_space).collect();
                facets.spread(spacing / scale, distance / scale, &within).into_iter().map(Spot::Facet).collect()
            }
        }
    }

    /// Spots in rings about `spacing` apart around the axis of a ball that stands on sides across it, at a distance from the ball.
    fn rings(&self, standing: &Standing, axis: usize, spacing: f64, distance: f64) -> Vec<Spot> {
        let (centre, r) = (self.numbers[axis], self.numbers[3] + distance);
        // Angles from its lowest point, which may be in the side but for rounding.
        let angle_at = |side: f64| ((centre - side) / r).clamp(-1.0, 1.0).acos();
        let end = |end: usize| standing.sides[axis][end].map_or(PI * end as f64, angle_at);
        let (first, all) = (end(0), end(1) - end(0));
        let (rows, step) = standing.rows(axis, all * r, spacing, distance > 0.0);
        let [low, high] = standing.ends(axis, ball_ends(axis, &self.numbers));
        let height = |angle: f64| (centre - r * angle.cos() - low) / (high - low);
        let ring_at = |at: f64| {
            let (angle, half) = (first + all * at, 0.5 * all * step);
            Ring { angle, below: height(angle - half), above: height(angle + half) }
        };
        let mut kept: Vec<Ring> = rows.into_iter().map(ring_at).collect();
        // A ring that is nearer to a side than points may be belongs to the next one.
        let beside = if distance > 0.0 { 0.0 } else { BESIDE * spacing / (high - low) };
        while standing.stands(axis, 0) && kept.len() > 1 && kept[0].middle() < beside {
            let first = kept.remove(0);
            kept[0].below = first.below;
        }
        while let [.., next, last] = kept.as_mut_slice() {
            if !standing.stands(axis, 1) || 1.0 - last.middle() >= beside {
                break;
            }
            next.above = last.above;
            kept.pop();
        }
        let points_of = |(k, ring): (usize, Ring)| {
            let (middle, Ring { angle, below, above }) = (ring.middle(), ring);
            let (sin, cos) = angle.sin_cos();
            let count = (2.0 * PI * r * sin / spacing).round().max(3.0);
            let shift = if k.is_multiple_of(2) { 0.0 } else { 0.5 };
            (0..count as usize).map(move |k| {
                let around = 2.0 * PI * (k as f64 + shift) / count;
                if distance > 0.0 {
                    let [a, b] = across(axis);
                    let mut direction = [-cos; 3];
                    (direction[a], direction[b]) = (sin * around.cos(), sin * around.sin());
                    return Spot::Direction(direction, 1.0);
                }
                Spot::Zone { at: middle, around, share: (above - below) / count }
            })
        };
        kept.into_iter().enumerate().flat_map(points_of).collect()
    }

    /// The x and y of the shape's centre, for numbers of the shape: those among them, the middle of a box, or the centroid of a column's
    /// section (along its axis the middle of what is in the region).
    pub fn centre<S: Scalar>(&self, s: &[S]) -> [S; 2] {
        match &self.form {
            Form::Ball(_) | Form::Facets(..) => [s[0], s[1]],
            Form::Box(_) => [0, 1].map(|d| S::of(0.5) * (s[d] + s[3 + d])),
            Form::Column(column) => {
                let (across, section) = (across(column.axis), column.outline.centre(s));
                let [low, high] = column.ends(s);
                let middle = S::of(0.5) * (low + high);
                [0, 1].map(|d| across.iter().position(|&e| e == d).map_or(middle, |e| section[e]))
            }
        }
    }

    /// A spot for numbers of the shape.
    pub fn at<S: Scalar>(&self, spot: &Spot, s: &[S]) -> OnSurface<S> {
        let zero = S::of(0.0);
        match (*spot, &self.form) {
            (Spot::Direction(n, share), _) => {
                let r = s[3];
                let place = std::array::from_fn(|d| s[d] + r * S::of(n[d]));
                OnSurface { place, area: std::array::from_fn(|d| r * r * S::of(share * n[d])) }
            }
            (Spot::Zone { at, around, share }, Form::Ball(standing)) => {
                let axis = standing.axes().next().unwrap_or(2);
                let ([a, b], [low, high], r) = (across(axis), standing.ends(axis, ball_ends(axis, s)), s[3]);
                let height = low + (high - low) * S::of(at) - s[axis];
                let out = (r * r - height * height).sqrt();
                let mut away = [height; 3];
                (away[a], away[b]) = (out * S::of(around.cos()), out * S::of(around.sin()));
                let share = (high - low) * S::of(2.0 * PI * share);
                OnSurface { place: std::array::from_fn(|d| s[d] + away[d]), area: away.map(|x| share * x) }
            }
            (Spot::Face { along, end, at, share }, Form::Box(standing)) => {
                let (s, [a, b]) = (standing.corners(s), across(along));
                let mut place = [zero; 3];
                place[along] = s[3 * end + along];
                place[a] = s[a] + (s[3 + a] - s[a]) * S::of(at[0]);
                place[b] = s[b] + (s[3 + b] - s[b]) * S::of(at[1]);
                let mut area = [zero; 3];
                let sign = if end == 0 { -1.0 } else { 1.0 };
                area[along] = (s[3 + a] - s[a]) * (s[3 + b] - s[b]) * S::of(sign * share);
                OnSurface { place, area }
            }
            (Spot::Column { t, dt, at, length }, Form::Column(column)) => {
                let ([low, high], [a, b]) = (column.ends(s), across(column.axis));
                let point = column.outline.points(&[t], s)[0];
                let (mut place, mut area) = ([zero; 3], [zero; 3]);
                (place[a], place[b]) = (point.place[0], point.place[1]);
                place[column.axis] = low + (high - low) * S::of(at);
                let of_length = (high - low) * S::of(dt * length);
                (area[a], area[b]) = (point.along[1] * of_length, -point.along[0] * of_length);
                OnSurface { place, area }
            }
            (Spot::End { end, t, dt, out, ring }, Form::Column(column)) => {
                let ([a, b], centre) = (across(column.axis), column.outline.centre(s));
                let point = column.outline.points(&[t], s)[0];
                let (mut place, mut area) = ([zero; 3], [zero; 3]);
                for (k, d) in [a, b].into_iter().enumerate() {
                    place[d] = centre[k] + (point.place[k] - centre[k]) * S::of(out);
                }
                place[column.axis] = column.ends(s)[end];
                let out = if end == 0 { -1.0 } else { 1.0 };
                area[column.axis] =
                    ring_area(centre, &point) * S::of(0.5 * (ring[1].powi(2) - ring[0].powi(2)) * dt * out);
                OnSurface { place, area }
            }
            (Spot::Facet(facet), _) => {
                let (scale, angle) = (s[3], s[4]);
                let place = turned(facet.place.map(S::of), angle);
                let area = turned(facet.area.map(S::of), angle);
                OnSurface {
                    place: std::array::from_fn(|d| s[d] + scale * place[d]),
                    area: area.map(|a| scale * scale * a),
                }
            }
            // Columns' spots are on columns, boxes' on boxes, and zones on balls.
            (Spot::Column { .. } | Spot::End { .. } | Spot::Face { .. } | Spot::Zone { .. }, _) => {
                OnSurface { place: [zero; 3], area: [zero; 3] }
            }
        }
    }

    /// The sides that the shape stands on.
    fn standing(&self) -> Standing {
        match &self.form {
            Form::Column(column) => column.standing,
            Form::Box(standing) | Form::Ball(standing) | Form::Facets(_, standing) => *standing,
        }
    }

    /// Whether the shape ends at a side of the region (2 d + (0 low, 1 high)), which closes it.
    pub fn stands_on(&self, side: usize) -> bool {
        self.standing().stands(side / 2, side % 2)
    }

    /// Where r of [`Self::volume`] begins along each direction; nowhere along the axis of a column without ends, or where a shape goes from
    /// side to side.
    pub fn from(&self, centre: [f64; 3]) -> [Option<f64>; 3] {
        let standing = self.standing();
        std::array::from_fn(|d| match (standing.sides[d], &self.form) {
            ([Some(_), Some(_)], _) => None,
            ([None, None], Form::Column(column)) if d == column.axis && !column.has_ends => None,
            ([None, None], _) => Some(centre[d]),
            ([low, high], _) => low.or(high),
        })
    }

    /// The part of the volume inside the region that belongs to a spot, r . area / 3 with r from `centre`, or from the side that a shape stands
    /// on. (Where there are no spots at either end of a direction it is r . area over the number of the others.)
    pub fn volume<S: Scalar>(&self, on: &OnSurface<S>, centre: [f64; 3]) -> S {
        part_of_volume(&self.from(centre), on)
    }

    /// Whether the shape has for these numbers a surface other than the one that it was made for: it would stand on other sides.
    pub fn stands_elsewhere(&self, region: &Region<3>, numbers: &[f64]) -> bool {
        match &self.form {
            Form::Box(own) => *own != Standing::of_box(region, numbers),
            Form::Column(column) => column.standing != Standing::of_column(region, column.axis, column.all(numbers)),
            Form::Ball(own) => *own != Standing::of_ball(region, numbers),
            Form::Facets(facets, own) => *own != Standing::of_facets(region, facets, numbers),
        }
    }
}
