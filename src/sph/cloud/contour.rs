//! Lines around shapes, through particles, and what flows through them: forces, torques and heat.
//!
//! Between a body and a closed line C around it that encloses nothing else, momentum and heat are conserved. With the traction
//! t = -p n + nu (grad u + grad u^T) n, the normal n out of C, a body force f per mass and the area A of the fluid within C,
//!
//! ```text
//!   force = int_C (t - u u.n) + f A,   heat = int_C (T u.n - alpha n . grad T),   torque = int_C r x (t - u u.n) + int_A r x f.
//! ```
//!
//! In a flow that is not steady, what the fluid within C keeps is missing. Of momentum it follows from what is on C, too, since div u = 0
//! and no fluid goes through the body's surface (du/dt by the equation of momentum, with what [`super::deferred_correction`] adds to it, r
//! from a point within the body):
//!
//! ```text
//!   force = int_C (t - u u.n - r du/dt . n) + f A.
//! ```
//!
//! Of heat it is the mean of dT/dt (by the equation of heat) within C, times A: of particles, each with the share of the area that is nearest
//! to it. Since these shares do not change, it is nothing over a period. Buoyancy has the mean of its particles, too. With sound, where div u
//! is not 0, both are told so, by the means of du/dt - u div u and dT/dt - T div u.
//!
//! This is more accurate by far than sums over the points on the surface: pressure and flux are singular at corners, and vary fast
//! elsewhere, while fields on C are smooth. C is the mean of three lines, 3 to 7 dx away and no farther than half of the way to what is
//! next. They follow cells of the lattice, with corners moved to the nearest particles, which carry them. Between two particles fields and
//! their slopes are cubic with the derivatives that both have (Hermite's interpolation), read at Gauss's two points.
//!
//! The line around a shape that stands on other walls, such as a fin, begins and ends on these. C is closed by what they have in between
//! ([`Contour::feet`]), through which flows what sums over their points say: beside the corner that a fin has with its wall fields are
//! smooth, other than at its tip.

use super::conditions::Conditions;
use super::equations::Bar;
use super::nearest::{Nearest, Plane, Region};
use super::outline::cross;
use super::particles::{At, Balanced, Cloud};
use super::placing::{bounds, BoundaryPoint, Places};
use super::traction::Patch;
use crate::numerics::sparse_lu::dot;
use std::collections::BTreeMap;

/// The largest distances of three lines from their body, in dx, of which the mean is taken. (Not where centres of cells are, so that no rounding
/// decides which of them belong to it.)
pub(super) const REACHES: [f64; 3] = [3.53, 5.03, 6.53];
/// The share of each line in the mean.
pub(super) const SHARE: f64 = 1.0 / REACHES.len() as f64;
/// A cell belongs to a body that is nearer by this factor than all else.
pub(super) const NEARER: f64 = 0.997;
/// Cells from a body to what is next, at least.
pub(super) const CELLS: f64 = 6.0;
/// Corners of the lines go to particles that are nearest to places so far from the corners of cells, in cells.
const ASIDE: [f64; 2] = [0.023, 0.017];
/// Walls that a shape stands on turn by this at most.
const TURN: f64 = 1.0;
/// Distances from a body are those from points on it that are so far from each other, in dx.
const THINNED: f64 = 0.1;

/// Parts of a cell along x and y, whose areas go to the nearest particles.
const PARTS: usize = 4;

/// A corner of the line: a particle, or an image of it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Corner {
    particle: usize,
    shift: [f64; 2],
}

/// A point of a wall that a shape stands on, within lines around it.
#[derive(Debug, Clone, Copy)]
pub struct Foot {
    /// Index of the boundary.
    pub point: usize,
    /// How much of it is within, times the share of the lines that it is within.
    pub share: f64,
    /// To the image that is within.
    pub shift: [f64; 2],
}

/// What a cell of the lattice is to a shape.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cell {
    /// In other walls, or out of the box.
    Wall,
    /// Within this line and those after it.
    Within(usize),
    Beyond,
}

/// The lines around a body, as pieces that have the body on their left.
#[derive(Debug, Clone)]
pub struct Contour {
    pieces: Vec<[Corner; 2]>,
    /// The points on the body, as indices of the boundary.
    surface: Vec<usize>,
    /// What closes the line around a shape that stands on walls.
    feet: Vec<Foot>,
    /// The particles within the lines with their shares of the area, in a flow that may not be steady or has buoyancy.
    within: Vec<(usize, f64)>,
    /// A point within the body, or near it.
    origin: [f64; 2],
    balanced: Balanced,
}

/// A point of a piece.
struct Point {
    /// The shares of values at both ends, and of derivatives along the piece there.
    shares: [[f64; 2]; 2],
    /// From the first end to the second one.
    along: [f64; 2],
    /// The way from the first end, from 0 to 1.
    s: f64,
    /// Normal out of the line times length, and the line's share.
    normal: [f64; 2],
    place: [f64; 2],
}

/// Value and slopes of a field, or their cotangents.
type Read = [f64; 3];

/// Places on a piece and weights of Gauss's two points.
fn gauss() -> [f64; 2] {
    let off = 0.5 / 3f64.sqrt();
    [0.5 - off, 0.5 + off]
}

/// From a place to that of its images which is nearest to another place.
pub(super) fn shift_to<const D: usize>(region: &Region<D>, own: [f64; D], p: [f64; D]) -> [f64; D] {
    let r = region.between(own, p);
    std::array::from_fn(|d| p[d] - r[d] - own[d])
}

fn place(at: &At<'_>, corner: Corner) -> [f64; 2] {
    std::array::from_fn(|d| at.shaped.position[d][corner.particle] + corner.shift[d])
}

/// Points of a line of which none is nearer to the one before than a distance.
fn thinned(points: &[[f64; 2]], apart: f64) -> Vec<[f64; 2]> {
    let mut found: Vec<[f64; 2]> = vec![];
    for p in points {
        if found.last().is_none_or(|q| (p[0] - q[0]).hypot(p[1] - q[1]) >= apart) {
            found.push(*p);
        }
    }
    found
}

/// What a shape stands on.
pub struct Walls {
    /// Sides of the box, see [`super::placing::BoundaryPoint::side`].
    pub sides: Vec<usize>,
    pub shapes: Vec<usize>,
}

impl Walls {
    /// What a shape reaches into.
    pub fn of(cloud: &Cloud, shape: usize) -> Self {
        let (plane, places) = (&cloud.ground.plane, &cloud.places);
        if places.bodies.contains(&shape) {
            return Self { sides: vec![], shapes: vec![] };
        }
        let [low, high] = places.polygons[shape].bounds();
        let reaches_out = |side: &usize| {
            let d = side / 2;
            !plane.periodic[d] && if side.is_multiple_of(2) { low[d] <= 0.0 } else { high[d] >= plane.size[d] }
        };
        let overlaps = |other: &usize| {
            let is_in = |a: usize, b: usize| {
                let polygon = &places.polygons[b];
                places.polygons[a].iter().any(|&p| polygon.covers(plane, plane.wrapped(p)))
            };
            *other != shape && (is_in(shape, *other) || is_in(*other, shape))
        };
        let shapes = (0..places.polygons.len()).filter(overlaps).collect();
        Self { sides: (0..4).filter(reaches_out).collect(), shapes }
    }

    fn is_none(&self) -> bool {
        self.sides.is_empty() && self.shapes.is_empty()
    }
}

/// The angle by which normals at feet on a wall differ.
fn turn(places: &Places, feet: &[Foot], wall: usize) -> f64 {
    let on_wall =
        feet.iter().map(|foot| &places.boundary[foot.point]).filter(|point| point.on.is_some_and(|on| on.0 == wall));
    let normals: Vec<[f64; 2]> = on_wall.map(|point| point.normal).collect();
    let angle = |n: &[f64; 2]| cross(normals[0], *n).atan2(dot(&normals[0], n));
    let [least, most] = normals.iter().map(angle).fold([0.0f64; 2], |[least, most], x| [least.min(x), most.max(x)]);
    most - least
}

/// What is near a body.
struct Beside {
    plane: Plane,
    /// Points on it, of a shape that stands on walls those in the fluid.
    polygon: Vec<[f64; 2]>,
    /// The offsets of its own images that are near.
    images: Vec<[f64; 2]>,
    to_body: Nearest,
    /// From the points on all else.
    to_others: Nearest,
    /// Larger distances do not count.
    most: f64,
}

impl Beside {
    fn new(cloud: &Cloud, body: usize, surface: &[usize], walls: &Walls, most: f64) -> Self {
        let (places, plane, dx) = (&cloud.places, cloud.ground.plane, cloud.ground.dx);
        let polygon = match walls.is_none() {
            true => thinned(&places.polygons[body], THINNED * dx),
            false => surface.iter().map(|&k| places.place[places.boundary[k].particle]).collect(),
        };
        let on_others = places.boundary.iter().filter(|point| match point.on {
            Some((shape, _)) => shape != body && !walls.shapes.contains(&shape),
            None => !point.side.is_some_and(|side| walls.sides.contains(&side)),
        });
        let others: Vec<[f64; 2]> = on_others.map(|point| places.place[point.particle]).collect();
        let wrapped: Vec<[f64; 2]> = polygon.iter().map(|&p| plane.wrapped(p)).collect();
        let [low, high] = bounds(&polygon);
        let is_near = |image: &[f64; 2]| *image != [0.0; 2] && (0..2).all(|d| image[d].abs() < high[d] - low[d] + most);
        let images = plane.images().filter(is_near).collect();
        let (to_body, to_others) = (Nearest::new(plane, dx, &wrapped), Nearest::new(plane, dx, &others));
        Self { plane, polygon, images, to_body, to_others, most }
    }

    fn to_image(&self, p: [f64; 2], image: [f64; 2]) -> f64 {
        let to = |q: &[f64; 2]| (q[0] + image[0] - p[0]).hypot(q[1] + image[1] - p[1]);
        self.polygon.iter().map(to).fold(self.most, f64::min)
    }

    /// How far a place is from the body, and not from another image of it.
    fn to_body(&self, p: [f64; 2]) -> f64 {
        match self.images.is_empty() {
            true => self.to_body.one(self.plane.wrapped(p), self.most).map_or(self.most, |(distance, _)| distance),
            false => self.to_image(p, [0.0; 2]),
        }
    }

    /// How far it is from all else, the body's other images among it.
    fn to_next(&self, p: [f64; 2]) -> f64 {
        let most = self.images.iter().map(|&image| self.to_image(p, image)).fold(self.most, f64::min);
        self.to_others.one(self.plane.wrapped(p), most).map_or(most, |(distance, _)| distance)
    }
}

impl Foot {
    /// Where it is, as seen from its shape.
    pub fn place(&self, at: &At<'_>) -> [f64; 2] {
        let own = at.place_on(self.point);
        std::array::from_fn(|d| own[d] + self.shift[d])
    }
}

/// The cells of the lattice, or finer ones, around a shape.
struct Grid {
    cells: Vec<Cell>,
    count: [usize; 2],
    step: [f64; 2],
    /// The corner of the first cell.
    corner: [f64; 2],
}

impl Grid {
    fn new(cloud: &Cloud, shape: usize, walls: &Walls, beside: &Beside) -> Self {
        let (ground, places) = (&cloud.ground, &cloud.places);
        let (dx, whole) = (ground.dx, &places.polygons[shape]);
        let reach = REACHES[2] * dx;
        let width = beside.polygon.iter().map(|&p| beside.to_next(p)).fold(f64::MAX, f64::min);
        let refined = (CELLS * dx / width).ceil().max(1.0);
        let [low, high] = places.corners;
        let cells = ground.cells(&places.corners);
        let step: [f64; 2] = std::array::from_fn(|d| (high[d] - low[d]) / cells[d] as f64 / refined);
        let [from, to] = bounds(&beside.polygon);
        let first: [f64; 2] = std::array::from_fn(|d| ((from[d] - reach - low[d]) / step[d]).floor() - 1.0);
        let count: [usize; 2] = std::array::from_fn(|d| {
            let last = ((to[d] + reach - low[d]) / step[d]).ceil() + 1.0;
            (last - first[d]) as usize
        });
        let corner = std::array::from_fn(|d| low[d] + first[d] * step[d]);
        let mut grid = Self { cells: vec![], count, step, corner };
        let of = |k: usize| {
            let p = grid.place((k / count[1]) as f64 + 0.5, (k % count[1]) as f64 + 0.5);
            if !walls.is_none() && ground.is_solid(&places.polygons, p, Some(shape)) {
                return Cell::Wall;
            }
            if whole.contains(p) {
                return Cell::Within(0);
            }
            let distance = beside.to_body(p);
            let line = REACHES.iter().position(|&reach| distance < reach * dx);
            line.filter(|_| distance < NEARER * beside.to_next(p)).map_or(Cell::Beyond, Cell::Within)
        };
        grid.cells = (0..count[0] * count[1]).map(of).collect();
        grid
    }

    fn place(&self, i: f64, j: f64) -> [f64; 2] {
        [self.corner[0] + i * self.step[0], self.corner[1] + j * self.step[1]]
    }

    /// The cell that a place is in.
    fn index(&self, p: [f64; 2]) -> [i64; 2] {
        std::array::from_fn(|d| ((p[d] - self.corner[d]) / self.step[d]).floor() as i64)
    }

    fn cell(&self, [i, j]: [i64; 2]) -> Cell {
        let is_inside = |k: i64, d: usize| k >= 0 && (k as usize) < self.count[d];
        if is_inside(i, 0) && is_inside(j, 1) {
            self.cells[i as usize * self.count[1] + j as usize]
        } else {
            Cell::Beyond
        }
    }

    fn is_within(&self, line: usize, cell: [i64; 2]) -> bool {
        matches!(self.cell(cell), Cell::Within(least) if least <= line)
    }

    /// The edges of cells that are a line, as corners of cells, with the shape on their left.
    fn edges(&self, line: usize) -> Vec<[[i64; 2]; 2]> {
        let mut found = vec![];
        for (i, j) in (0..self.count[0] as i64).flat_map(|i| (0..self.count[1] as i64).map(move |j| (i, j))) {
            if !self.is_within(line, [i, j]) {
                continue;
            }
            let sides = [
                ([i, j - 1], [[i, j], [i + 1, j]]),
                ([i + 1, j], [[i + 1, j], [i + 1, j + 1]]),
                ([i, j + 1], [[i + 1, j + 1], [i, j + 1]]),
                ([i - 1, j], [[i, j + 1], [i, j]]),
            ];
            let is_edge = |beyond: [i64; 2]| !self.is_within(line, beyond) && self.cell(beyond) != Cell::Wall;
            found.extend(sides.into_iter().filter(|(beyond, _)| is_edge(*beyond)).map(|(_, edge)| edge));
        }
        found
    }

    /// The particles within the lines, with their shares of the fluid's area there. (A point of a wall has its own if what is there does not
    /// change; otherwise the next particle inside has it.)
    fn shares(&self, cloud: &Cloud, to_inside: &Nearest) -> Vec<(usize, f64)> {
        let (ground, places) = (&cloud.ground, &cloud.places);
        let (plane, most, numbers) = (ground.plane, 4.0 * ground.far * ground.dx, cloud.numbers());
        let all: Vec<[f64; 2]> = places.place.iter().map(|&p| plane.wrapped(p)).collect();
        let to_all = Nearest::new(plane, ground.dx, &all);
        let stays = |k: usize| cloud.stays(k, places.place[places.boundary[k].particle], &numbers);
        let mut found = BTreeMap::new();
        for (i, j) in (0..self.count[0]).flat_map(|i| (0..self.count[1]).map(move |j| (i, j))) {
            let Cell::Within(least) = self.cell([i as i64, j as i64]) else { continue };
            let part = |k: usize| (k as f64 + 0.5) / PARTS as f64;
            for (a, b) in (0..PARTS).flat_map(|a| (0..PARTS).map(move |b| (a, b))) {
                let p = plane.wrapped(self.place(i as f64 + part(a), j as f64 + part(b)));
                if ground.is_solid(&places.polygons, p, None) {
                    continue;
                }
                let own = to_all.one(p, most).map(|(_, particle)| particle);
                let own = own.filter(|&i| i.checked_sub(places.inside).is_none_or(stays));
                if let Some(particle) = own.or_else(|| Some(to_inside.one(p, most)?.1)) {
                    *found.entry(particle).or_insert(0.0) += (REACHES.len() - least) as f64;
                }
            }
        }
        let total: f64 = found.values().sum();
        found.into_iter().map(|(particle, share)| (particle, share / total)).collect()
    }

    /// Whether a wall is next to a corner of cells.
    fn is_on_wall(&self, [i, j]: [i64; 2]) -> bool {
        (0..4).any(|k| self.cell([i - k / 2, j - k % 2]) == Cell::Wall)
    }
}

impl Contour {
    /// The line around a shape, given the points on its surface. None around a shape that goes along a whole
    /// period, or from side to side without a corner: sums over it are as accurate, for they have the fits of third order. None where walls
    /// that it stands on turn within the line: these would have the errors at corners that the line is for.
    pub fn around(cloud: &Cloud, shape: usize, surface: Vec<usize>, balanced: Balanced) -> Option<Self> {
        let (ground, places) = (&cloud.ground, &cloud.places);
        let (plane, dx) = (ground.plane, ground.dx);
        let [from, to] = places.polygons[shape].bounds();
        if surface.is_empty() || (0..2).any(|d| plane.periodic[d] && to[d] - from[d] >= plane.size[d]) {
            return None;
        }
        let walls = Walls::of(cloud, shape);
        let goes_across = (0..2).any(|d| walls.sides.contains(&(2 * d)) && walls.sides.contains(&(2 * d + 1)));
        let has_corner =
            || ground.outlines[shape].corners().iter().any(|&p| !ground.is_solid(&places.polygons, p, Some(shape)));
        if goes_across && !has_corner() {
            return None;
        }
        let beside = Beside::new(cloud, shape, &surface, &walls, 2.0 * REACHES[2] * dx);
        let grid = Grid::new(cloud, shape, &walls, &beside);
        let to_particles = Nearest::new(plane, dx, &places.place[..places.inside]);
        // Points of the walls that it stands on.
        let mut is_other = vec![!walls.is_none(); places.boundary.len()];
        surface.iter().for_each(|&k| is_other[k] = false);
        let others: Vec<usize> = (0..is_other.len()).filter(|&k| is_other[k]).collect();
        let on_others: Vec<[f64; 2]> =
            others.iter().map(|&k| plane.wrapped(places.place[places.boundary[k].particle])).collect();
        let to_others = Nearest::new(plane, dx, &on_others);
        let corner = |node: [i64; 2]| {
            // Rounding shall not decide between particles that are equally near.
            let p = grid.place(node[0] as f64 + ASIDE[0], node[1] as f64 + ASIDE[1]);
            let (most, wrapped) = (4.0 * ground.far * dx, plane.wrapped(p));
            let particle = match grid.is_on_wall(node) {
                true => places.boundary[others[to_others.one(wrapped, most)?.1]].particle,
                false => to_particles.one(wrapped, most)?.1,
            };
            Some(Corner { particle, shift: shift_to(&plane, places.place[particle], p) })
        };
        let mut pieces = vec![];
        // Where lines end on walls.
        let mut ends: Vec<(usize, usize)> = vec![];
        for (line, [from, to]) in
            (0..REACHES.len()).flat_map(|line| grid.edges(line).into_iter().map(move |edge| (line, edge)))
        {
            let Some(piece) = corner(from).zip(corner(to)).filter(|(a, b)| a != b) else { continue };
            let piece = [piece.0, piece.1];
            ends.extend(piece.iter().filter(|end| end.particle >= places.inside).map(|end| (line, end.particle)));
            pieces.push(piece);
        }
        let [from, to] = bounds(&beside.polygon);
        let middle = std::array::from_fn(|d| 0.5 * (from[d] + to[d]));
        let foot = |point: usize| {
            let BoundaryPoint { particle, normal, .. } = places.boundary[point];
            let own = places.place[particle];
            let shift = shift_to(&plane, own, middle);
            let in_fluid = std::array::from_fn(|d| own[d] + shift[d] + 0.5 * grid.step[d] * normal[d]);
            let within = |line: usize| match ends.contains(&(line, particle)) {
                // Half of the wall that the point stands for.
                true => 0.5,
                false => f64::from(u8::from(grid.is_within(line, grid.index(in_fluid)))),
            };
            let share = SHARE * (0..REACHES.len()).map(within).sum::<f64>();
            (share > 0.0).then_some(Foot { point, share, shift })
        };
        let feet: Vec<Foot> = others.into_iter().filter_map(foot).collect();
        if walls.shapes.iter().any(|&wall| turn(places, &feet, wall) > TURN) {
            return None;
        }
        let points = beside.polygon.len() as f64;
        let origin = std::array::from_fn(|d| beside.polygon.iter().map(|p| p[d]).sum::<f64>() / points);
        let needs_within = balanced != Balanced::Steady || cloud.fluid.buoyancy.is_some();
        let within = if needs_within { grid.shares(cloud, &to_particles) } else { vec![] };
        Some(Self { pieces, surface, feet, within, origin, balanced })
    }

    pub fn is_steady(&self) -> bool {
        self.balanced == Balanced::Steady
    }

    /// The points of walls that the shape stands on, which close the line.
    pub fn feet(&self) -> &[Foot] {
        &self.feet
    }

    /// The particles that the line goes through, and those whose change in time it needs.
    pub fn particles(&self) -> impl Iterator<Item = usize> + '_ {
        let through = self.pieces.iter().flatten().map(|corner| corner.particle);
        through.chain(self.within.iter().map(|(particle, _)| *particle))
    }

    fn points(at: &At<'_>, piece: [Corner; 2]) -> [Point; 2] {
        let (a, b) = (place(at, piece[0]), place(at, piece[1]));
        let along = [b[0] - a[0], b[1] - a[1]];
        gauss().map(|s| Point {
            shares: [
                [1.0 - s * s * (3.0 - 2.0 * s), s * (1.0 - s) * (1.0 - s)],
                [s * s * (3.0 - 2.0 * s), s * s * (s - 1.0)],
            ],
            along,
            s,
            normal: [0.5 * SHARE * along[1], -0.5 * SHARE * along[0]],
            place: [a[0] + s * along[0], a[1] + s * along[1]],
        })
    }

    /// A field and its slopes at a point of a piece.
    fn read(at: &At<'_>, piece: [Corner; 2], point: &Point, field: usize) -> Read {
        let (mut found, [x, y]) = ([0.0; 3], point.along);
        for (end, [own, by]) in piece.iter().zip(point.shares) {
            let (value, d) = (at.state.fields[field][end.particle], &at.d.0[field][end.particle]);
            found[0] += own * value + by * (d[0] * x + d[1] * y);
            found[1] += own * d[0] + by * (d[2] * x + d[3] * y);
            found[2] += own * d[1] + by * (d[3] * x + d[4] * y);
        }
        found
    }

    /// Adds the cotangents of what [`Self::read`] gives; returns that of the vector along the piece.
    fn read_back(at: &At<'_>, piece: [Corner; 2], point: &Point, field: usize, of: Read, bar: &mut Bar) -> [f64; 2] {
        let (mut along, [x, y], [value, by_x, by_y]) = ([0.0; 2], point.along, of);
        for (end, [own, by]) in piece.iter().zip(point.shares) {
            let i = end.particle;
            bar.fields[field][i] += own * value;
            let to = &mut bar.derivatives.0[field][i];
            to[0] += own * by_x + by * value * x;
            to[1] += own * by_y + by * value * y;
            to[2] += by * by_x * x;
            to[3] += by * (by_x * y + by_y * x);
            to[4] += by * by_y * y;
            let d = &at.d.0[field][i];
            along[0] += by * (value * d[0] + by_x * d[2] + by_y * d[3]);
            along[1] += by * (value * d[1] + by_x * d[3] + by_y * d[4]);
        }
        along
    }

    /// What pushes at a point of a piece.
    fn patch(at: &At<'_>, piece: [Corner; 2], point: &Point) -> Patch<2> {
        let [u, v, p] = [0, 1, 2].map(|field| Self::read(at, piece, point, field));
        Patch { velocity: [u[0], v[0]], gradient: [[u[1], u[2]], [v[1], v[2]]], pressure: p[0], area: point.normal }
    }

    /// The change of velocity in time at a corner.
    fn acceleration(at: &At<'_>, corner: Corner, body_force: [f64; 2]) -> [f64; 2] {
        let (i, nu) = (corner.particle, at.equations.viscosity);
        // Walls on which lines end are at rest.
        if i >= at.equations.inside {
            return [0.0; 2];
        }
        let ([u, v], dp, lift) = (at.velocity(i), &at.d.0[2][i], Self::buoyancy(at, i));
        std::array::from_fn(|e| {
            let d = &at.d.0[e][i];
            let lacks = at.defect.map_or(0.0, |defect| defect.flow[3 * i + e]);
            body_force[e] + lift[e] - u * d[0] - v * d[1] - dp[e] + nu * (d[2] + d[4]) - lacks
        })
    }

    fn buoyancy(at: &At<'_>, i: usize) -> [f64; 2] {
        let of = |e: usize| at.equations.buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, at.state.fields[3][i]));
        [of(0), of(1)]
    }

    fn buoyancy_back(at: &At<'_>, i: usize, of: [f64; 2], bar: &mut Bar) {
        if let Some(buoyancy) = at.equations.buoyancy {
            bar.fields[3][i] += of[0] * buoyancy.by[0] + of[1] * buoyancy.by[1];
        }
    }

    /// What acts on the fluid within besides the body force, at a particle there: buoyancy, less what the fluid keeps where it has sound.
    fn more(&self, at: &At<'_>, i: usize, body_force: [f64; 2]) -> [f64; 2] {
        let lift = Self::buoyancy(at, i);
        if self.balanced != Balanced::WithSound {
            return lift;
        }
        let (u, divergence) = (at.velocity(i), at.d.0[0][i][0] + at.d.0[1][i][1]);
        let change = Self::acceleration(at, Corner { particle: i, shift: [0.0; 2] }, body_force);
        std::array::from_fn(|e| lift[e] - change[e] + u[e] * divergence)
    }

    fn more_back(&self, at: &At<'_>, i: usize, of: [f64; 2], bar: &mut Bar) {
        Self::buoyancy_back(at, i, of, bar);
        if self.balanced != Balanced::WithSound {
            return;
        }
        let (u, divergence) = (at.velocity(i), at.d.0[0][i][0] + at.d.0[1][i][1]);
        Self::acceleration_back(at, Corner { particle: i, shift: [0.0; 2] }, of.map(|x| -x), bar);
        let along = of[0] * u[0] + of[1] * u[1];
        for e in 0..2 {
            bar.fields[e][i] += of[e] * divergence;
            bar.derivatives.0[e][i][e] += along;
        }
    }

    /// The mean of [`Self::more`].
    fn mean_more(&self, at: &At<'_>, body_force: [f64; 2]) -> [f64; 2] {
        self.within.iter().fold([0.0; 2], |sum, &(i, share)| {
            let own = self.more(at, i, body_force);
            std::array::from_fn(|e| sum[e] + share * own[e])
        })
    }

    fn acceleration_back(at: &At<'_>, corner: Corner, of: [f64; 2], bar: &mut Bar) {
        let (i, nu) = (corner.particle, at.equations.viscosity);
        if i >= at.equations.inside {
            return;
        }
        let [u, v] = at.velocity(i);
        Self::buoyancy_back(at, i, of, bar);
        if at.defect.is_some() {
            bar.defect.resize(at.equations.inside, [0.0; 2]);
            if let Some(to) = bar.defect.get_mut(i) {
                (0..2).for_each(|e| to[e] -= of[e]);
            }
        }
        for e in 0..2 {
            let d = &at.d.0[e][i];
            bar.fields[0][i] -= of[e] * d[0];
            bar.fields[1][i] -= of[e] * d[1];
            bar.viscosity += of[e] * (d[2] + d[4]);
            bar.derivatives.0[2][i][e] -= of[e];
            let to = &mut bar.derivatives.0[e][i];
            to[0] -= of[e] * u;
            to[1] -= of[e] * v;
            to[2] += of[e] * nu;
            to[4] += of[e] * nu;
        }
    }

    /// The change of velocity in time at a point of a piece.
    fn change(at: &At<'_>, piece: [Corner; 2], point: &Point, body_force: [f64; 2]) -> [f64; 2] {
        let [a, b] = piece.map(|corner| Self::acceleration(at, corner, body_force));
        std::array::from_fn(|d| (1.0 - point.s) * a[d] + point.s * b[d])
    }

    /// Force on the body and, about a centre, its torque, as far as they come through the line.
    fn through(&self, at: &At<'_>, body_force: [f64; 2], centre: [f64; 2]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for &piece in &self.pieces {
            for point in Self::points(at, piece) {
                let patch = Self::patch(at, piece, &point);
                let [x, y] = [0, 1].map(|e| patch.push(at.equations.viscosity, e));
                let r = [point.place[0] - centre[0], point.place[1] - centre[1]];
                (sum[0], sum[1], sum[2]) = (sum[0] + x, sum[1] + y, sum[2] + r[0] * y - r[1] * x);
                if self.balanced == Balanced::InTime {
                    let (n, change) = (point.normal, Self::change(at, piece, &point, body_force));
                    let out = change[0] * n[0] + change[1] * n[1];
                    let r = self.relative(point.place);
                    (0..2).for_each(|d| sum[d] -= r[d] * out);
                }
            }
        }
        sum
    }

    /// A place from the origin. (Where corners are sharp the normals of a surface do not quite add up to nothing, so the origin counts.)
    fn relative(&self, p: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|d| p[d] - self.origin[d])
    }

    /// The points that close the line, on the shape and on walls, with their places from the origin and their shares.
    fn closing<'a>(&'a self, at: &'a At<'_>) -> impl Iterator<Item = (usize, [f64; 2], f64)> + 'a {
        let own = self.surface.iter().map(|&k| (k, self.relative(at.place_on(k)), 1.0));
        let feet = self.feet.iter().map(|foot| (foot.point, self.relative(foot.place(at)), foot.share));
        own.chain(feet)
    }

    /// Area and first moments of the fluid within the line, from the origin.
    fn moments(&self, at: &At<'_>) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for &[a, b] in &self.pieces {
            let [a, b] = [a, b].map(|corner| self.relative(place(at, corner)));
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            sum[0] += 0.5 * (a[0] * b[1] - a[1] * b[0]);
            sum[1] += (a[0] * a[0] + a[0] * b[0] + b[0] * b[0]) / 6.0 * dy;
            sum[2] -= (a[1] * a[1] + a[1] * b[1] + b[1] * b[1]) / 6.0 * dx;
        }
        sum = sum.map(|x| SHARE * x);
        for (k, p, share) in self.closing(at) {
            let n = at.shaped.area[k].map(|one| share * one);
            sum[0] -= 0.5 * (p[0] * n[0] + p[1] * n[1]);
            sum[1] -= 0.5 * p[0] * p[0] * n[0];
            sum[2] -= 0.5 * p[1] * p[1] * n[1];
        }
        sum
    }

    /// Force on all within the line along x and y, on the shape and on its [`feet`](Self::feet), and their torque about a centre, given the
    /// body force. (The torque is that of a steady flow without buoyancy.)
    pub fn force(&self, at: &At<'_>, body_force: [f64; 2], centre: [f64; 2]) -> [f64; 3] {
        let [x, y, torque] = self.through(at, body_force, centre);
        let ([fx, fy], more) = (body_force, self.mean_more(at, body_force));
        if body_force == [0.0; 2] && self.within.is_empty() {
            return [x, y, torque];
        }
        let ([area, mx, my], centre) = (self.moments(at), self.relative(centre));
        let torque = torque + (mx - centre[0] * area) * fy - (my - centre[1] * area) * fx;
        [x + (fx + more[0]) * area, y + (fy + more[1]) * area, torque]
    }

    /// Adds the cotangents of [`Self::force`], given those of its three numbers; returns those of body force and centre.
    pub fn force_back(
        &self,
        at: &At<'_>,
        body_force: [f64; 2],
        centre: [f64; 2],
        weight: [f64; 3],
        bar: &mut Bar,
    ) -> [[f64; 2]; 2] {
        let nu = at.equations.viscosity;
        let (mut of_force, mut of_centre) = ([0.0; 2], [0.0; 2]);
        for &piece in &self.pieces {
            for point in Self::points(at, piece) {
                let (n, patch) = (point.normal, Self::patch(at, piece, &point));
                let [x, y] = [0, 1].map(|e| patch.push(nu, e));
                let r = [point.place[0] - centre[0], point.place[1] - centre[1]];
                let w = [weight[0] - weight[2] * r[1], weight[1] + weight[2] * r[0]];
                let mut of_place = [weight[2] * y, -weight[2] * x];
                (0..2).for_each(|d| of_centre[d] -= of_place[d]);
                let (back, viscosity) = patch.push_back(nu, w);
                bar.viscosity += viscosity;
                let velocity = |e: usize| [back.velocity[e], back.gradient[e][0], back.gradient[e][1]];
                let mut of_along = [0.0; 2];
                for (field, of) in [(0, velocity(0)), (1, velocity(1)), (2, [back.pressure, 0.0, 0.0])] {
                    let more = Self::read_back(at, piece, &point, field, of, bar);
                    (0..2).for_each(|d| of_along[d] += more[d]);
                }
                let mut of_normal = back.area;
                if self.balanced == Balanced::InTime {
                    let change = Self::change(at, piece, &point, body_force);
                    let out = change[0] * n[0] + change[1] * n[1];
                    let r = self.relative(point.place);
                    let by = -weight[0] * r[0] - weight[1] * r[1];
                    for d in 0..2 {
                        of_place[d] -= weight[d] * out;
                        of_normal[d] += by * change[d];
                        of_force[d] += by * n[d];
                    }
                    for (corner, share) in piece.into_iter().zip([1.0 - point.s, point.s]) {
                        Self::acceleration_back(at, corner, n.map(|one| share * by * one), bar);
                    }
                }
                Self::piece_back(piece, &point, of_along, of_normal, of_place, bar);
            }
        }
        if body_force == [0.0; 2] && self.within.is_empty() {
            return [of_force, of_centre];
        }
        let ([fx, fy], [area, mx, my], centre) = (body_force, self.moments(at), self.relative(centre));
        let more = self.mean_more(at, body_force);
        for &(i, share) in &self.within {
            self.more_back(at, i, [0, 1].map(|e| weight[e] * area * share), bar);
            if self.balanced == Balanced::WithSound && i < at.equations.inside {
                (0..2).for_each(|e| of_force[e] -= weight[e] * area * share);
            }
        }
        let of_moments = [
            weight[0] * (fx + more[0]) + weight[1] * (fy + more[1]) + weight[2] * (centre[1] * fx - centre[0] * fy),
            weight[2] * fy,
            -weight[2] * fx,
        ];
        self.moments_back(at, of_moments, bar);
        of_centre[0] -= weight[2] * area * fy;
        of_centre[1] += weight[2] * area * fx;
        of_force[0] += weight[0] * area - weight[2] * (my - centre[1] * area);
        of_force[1] += weight[1] * area + weight[2] * (mx - centre[0] * area);
        [of_force, of_centre]
    }

    /// Adds the cotangents of the ends of a piece, given those of the vector along it, of a point's normal, and of its place.
    fn piece_back(
        piece: [Corner; 2],
        point: &Point,
        along: [f64; 2],
        normal: [f64; 2],
        place: [f64; 2],
        bar: &mut Bar,
    ) {
        let along = [along[0] - 0.5 * SHARE * normal[1], along[1] + 0.5 * SHARE * normal[0]];
        let [a, b] = piece.map(|corner| corner.particle);
        for d in 0..2 {
            bar.position[d][a] += (1.0 - point.s) * place[d] - along[d];
            bar.position[d][b] += point.s * place[d] + along[d];
        }
    }

    fn moments_back(&self, at: &At<'_>, of: [f64; 3], bar: &mut Bar) {
        let weight = of.map(|x| SHARE * x);
        for &[from, to] in &self.pieces {
            let [a, b] = [from, to].map(|corner| self.relative(place(at, corner)));
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            let square = |d: usize| (a[d] * a[d] + a[d] * b[d] + b[d] * b[d]) / 6.0;
            let (i, j) = (from.particle, to.particle);
            bar.position[0][i] +=
                0.5 * weight[0] * b[1] + weight[1] * (2.0 * a[0] + b[0]) / 6.0 * dy + weight[2] * square(1);
            bar.position[0][j] +=
                -0.5 * weight[0] * a[1] + weight[1] * (a[0] + 2.0 * b[0]) / 6.0 * dy - weight[2] * square(1);
            bar.position[1][i] +=
                -0.5 * weight[0] * b[0] - weight[1] * square(0) - weight[2] * (2.0 * a[1] + b[1]) / 6.0 * dx;
            bar.position[1][j] +=
                0.5 * weight[0] * a[0] + weight[1] * square(0) - weight[2] * (a[1] + 2.0 * b[1]) / 6.0 * dx;
        }
        for (k, p, share) in self.closing(at) {
            for d in 0..2 {
                let n = at.shaped.area[k][d];
                bar.position[d][at.on(k)] -= share * (0.5 * of[0] + of[1 + d] * p[d]) * n;
                bar.boundary[k].area[d] -= share * (0.5 * of[0] * p[d] + 0.5 * of[1 + d] * p[d] * p[d]);
            }
        }
    }

    /// The change of temperature in time at a particle; with sound less T div u.
    fn warming(&self, at: &At<'_>, i: usize) -> f64 {
        if i >= at.equations.inside {
            return 0.0;
        }
        let ([u, v], d) = (at.velocity(i), &at.d.0[3][i]);
        let lacks = at.defect.map_or(0.0, |defect| defect.heat[i]);
        let change = at.equations.diffusivity.unwrap_or(0.0) * (d[2] + d[4]) - u * d[0] - v * d[1] - lacks;
        match self.balanced {
            Balanced::WithSound => change - at.state.fields[3][i] * (at.d.0[0][i][0] + at.d.0[1][i][1]),
            _ => change,
        }
    }

    fn warming_back(&self, at: &At<'_>, i: usize, of: f64, bar: &mut Bar) {
        if i >= at.equations.inside {
            return;
        }
        let ([u, v], d, alpha) = (at.velocity(i), &at.d.0[3][i], at.equations.diffusivity.unwrap_or(0.0));
        if at.defect.is_some() {
            bar.heat_defect.resize(at.equations.inside, 0.0);
            bar.heat_defect[i] -= of;
        }
        bar.fields[0][i] -= of * d[0];
        bar.fields[1][i] -= of * d[1];
        let to = &mut bar.derivatives.0[3][i];
        to[0] -= of * u;
        to[1] -= of * v;
        to[2] += of * alpha;
        to[4] += of * alpha;
        if self.balanced == Balanced::WithSound {
            let t = at.state.fields[3][i];
            bar.fields[3][i] -= of * (at.d.0[0][i][0] + at.d.0[1][i][1]);
            (0..2).for_each(|e| bar.derivatives.0[e][i][e] -= of * t);
        }
    }

    /// The mean of [`Self::warming`] within the lines.
    fn mean_warming(&self, at: &At<'_>) -> f64 {
        self.within.iter().map(|&(i, share)| share * self.warming(at, i)).sum()
    }

    /// The heat that all within the line gives to the fluid, the shape and its [`feet`](Self::feet), per density and heat capacity.
    pub fn heat(&self, at: &At<'_>) -> f64 {
        let kept = if self.is_steady() { 0.0 } else { self.moments(at)[0] * self.mean_warming(at) };
        kept + self.heat_through(at)
    }

    fn heat_through(&self, at: &At<'_>) -> f64 {
        let alpha = at.equations.diffusivity.unwrap_or(0.0);
        let of = |piece: &[Corner; 2]| -> f64 {
            let at_point = |point: Point| {
                let [u, v, t] = [0, 1, 3].map(|field| Self::read(at, *piece, &point, field));
                let n = point.normal;
                t[0] * (u[0] * n[0] + v[0] * n[1]) - alpha * (t[1] * n[0] + t[2] * n[1])
            };
            Self::points(at, *piece).into_iter().map(at_point).sum()
        };
        self.pieces.iter().map(of).sum()
    }

    /// Adds the cotangents of the heat.
    pub fn heat_back(&self, at: &At<'_>, weight: f64, bar: &mut Bar) {
        let alpha = at.equations.diffusivity.unwrap_or(0.0);
        if !self.is_steady() {
            let [area, ..] = self.moments(at);
            self.moments_back(at, [weight * self.mean_warming(at), 0.0, 0.0], bar);
            self.within.iter().for_each(|&(i, share)| self.warming_back(at, i, weight * area * share, bar));
        }
        for &piece in &self.pieces {
            for point in Self::points(at, piece) {
                let [u, v, t] = [0, 1, 3].map(|field| Self::read(at, piece, &point, field));
                let n = point.normal;
                let of_t = [u[0] * n[0] + v[0] * n[1], -alpha * n[0], -alpha * n[1]];
                let mut of_along = [0.0; 2];
                for (field, of) in [(0, [t[0] * n[0], 0.0, 0.0]), (1, [t[0] * n[1], 0.0, 0.0]), (3, of_t)] {
                    let more = Self::read_back(at, piece, &point, field, of.map(|one| weight * one), bar);
                    (0..2).for_each(|d| of_along[d] += more[d]);
                }
                let of_normal = [weight * (t[0] * u[0] - alpha * t[1]), weight * (t[0] * v[0] - alpha * t[2])];
                Self::piece_back(piece, &point, of_along, of_normal, [0.0; 2], bar);
            }
        }
    }
}
