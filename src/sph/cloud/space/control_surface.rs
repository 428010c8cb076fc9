//! Closed surfaces around shapes in space, through particles, and what flows through them: forces and heat.
//!
//! As lines do in the plane ([`super::super::contour`]): with the traction t = -p n + nu (grad u + grad u^T) n, the normal n out of a closed
//! surface C around a body that encloses nothing else, and the volume V of the fluid in between,
//!
//! ```text
//!   force = int_C (t - u u.n) + V mean(f + b (T - T0) - du/dt + u div u)
//!   heat  = int_C (T u.n - alpha n . grad T) + V mean(dT/dt - T div u).
//! ```
//!
//! (In a steady flow nothing changes in time, and div u is nothing but in a fluid with sound.) Means are those of the particles within, each
//! with the share of the volume that is nearest to it. Around bodies of few spacings this is more accurate by far than sums over their
//! points, where pressure and flux vary fast.
//!
//! C is the mean of three surfaces, 3 to 7 dx away and no farther than half of the way to what is next: faces of cells of the lattice, with
//! corners moved to the nearest particles. Each face is bilinear between its corners. At Gauss's four points of it fields are those of the
//! Taylor polynomials of second order of its corners, with bilinear shares.
//!
//! The surface around a shape that stands on sides of the region ends there; what these have in between closes it.

use super::super::conditions::Conditions;
use super::super::contour::{shift_to, CELLS, NEARER, REACHES, SHARE};
use super::super::nearest::Nearest;
use super::super::particles::Balanced;
use super::super::traction::{unit, Patch};
use super::equations::{laplacian, Bar, PRESSURE, TEMPERATURE};
use super::particles::{At, Cloud};
use super::placing::inward;
use super::surface::{across, part_of_volume, OnSurface};
use crate::io::stl::{cross, dot};
use crate::sph::consistent::stencil::quadratic;
use std::cell::OnceCell;
use std::collections::{BTreeMap, HashMap};

/// The narrowest passage, in dx, in which there is a surface. (With 2 it is a spacing from a ball in a duct, whose heat is then 23 and drag 30 % off;
/// with 2.4 they are 1 and 3 %, with 3 0.5 and 0.3 %.)
const WIDE: f64 = 2.25;
/// The most parts of a cell along each direction, where there are few cells to what is next.
const REFINED: f64 = 2.0;
/// Corners go to particles that are nearest to places so far from the corners of cells, in cells. (Rounding shall not decide between particles
/// that are equally near.)
const ASIDE: [f64; 3] = [0.023, 0.017, 0.013];
/// Parts of a cell along each direction, whose volumes or areas go to the nearest particles.
const PARTS: usize = 2;
const PARTS_OF_SIDES: usize = 4;
/// The same of cells that the shape's own border goes through.
const PARTS_CUT: usize = 16;

/// A corner of a face: a particle, or an image of it.
#[derive(Debug, Clone, Copy)]
struct Corner {
    particle: usize,
    shift: [f64; 3],
}

type Face = [Corner; 4];

/// Where surfaces end on sides of the region: how far corners are from the nodes of the lattice, by the surface and the node.
type Edge = HashMap<(usize, [usize; 3]), [f64; 3]>;

/// A point of a side of the region, within surfaces around a shape that stands there.
#[derive(Debug, Clone)]
pub struct Foot {
    /// Index of the boundary.
    pub point: usize,
    normal: [f64; 3],
    /// The area that it stands for, times the share of the surfaces that it is within: this number and a sum over places of points of the
    /// shape, which covers more of the side or less where its border moves.
    area: f64,
    by: BTreeMap<usize, [f64; 3]>,
}

impl Foot {
    /// Normal into the fluid times area.
    pub fn area(&self, at: &At<'_>) -> [f64; 3] {
        let of = |(i, by): (&usize, &[f64; 3])| (0..3).map(|d| by[d] * at.shaped.position[d][*i]).sum::<f64>();
        let area = self.area + self.by.iter().map(of).sum::<f64>();
        self.normal.map(|one| area * one)
    }

    /// Adds the cotangents of places, given that of the area.
    pub fn area_back(&self, of: [f64; 3], bar: &mut Bar) {
        let weight = dot(self.normal, of);
        for (i, by) in &self.by {
            (0..3).for_each(|d| bar.position[d][*i] += weight * by[d]);
        }
    }
}

/// The surface around a shape.
#[derive(Debug, Clone)]
pub struct ControlSurface {
    /// With corners against the clock, seen from outside.
    faces: Vec<Face>,
    /// Points of the shape, as indices of the boundary.
    own: Vec<usize>,
    /// What closes it on sides of the region.
    pub feet: Vec<Foot>,
    /// The particles within with their shares of the volume, where their means are needed.
    within: Vec<(usize, f64)>,
    /// Where places are measured from, along directions in which the surface is closed.
    from: [Option<f64>; 3],
    /// The same of the shape itself.
    own_from: [Option<f64>; 3],
    balanced: Balanced,
}

/// The cells of the lattice, or finer ones.
struct Grid {
    count: [usize; 3],
    step: [f64; 3],
    periodic: [bool; 3],
    /// The shape that a cell is nearest to and the first of the surfaces that it is within, if it is.
    cells: Vec<Option<(u16, u8)>>,
}

impl Grid {
    fn new(cloud: &Cloud, widths: &[f64]) -> Self {
        let (ground, region) = (&cloud.ground, cloud.ground.region);
        let narrowest = widths.iter().copied().fold(f64::INFINITY, f64::min);
        let refined = (CELLS * ground.dx / narrowest).ceil().clamp(1.0, REFINED);
        let count = ground.cells().map(|count| count * refined as usize);
        let step = std::array::from_fn(|d| region.size[d] / count[d] as f64);
        let mut grid = Self { count, step, periodic: region.periodic, cells: vec![] };
        let of = |k: usize| {
            let p = grid.centre(grid.index(k));
            let distances = ground.surfaces.iter().map(|surface| surface.distance(&region, p));
            let (mut nearest, mut next) = ((0, f64::INFINITY), f64::INFINITY);
            for (shape, distance) in distances.enumerate() {
                if distance < nearest.1 {
                    (nearest, next) = ((shape, distance), nearest.1);
                } else {
                    next = next.min(distance);
                }
            }
            let (shape, distance) = nearest;
            let line = REACHES.iter().position(|&reach| distance < reach * ground.dx)?;
            let next = next.min(ground.to_sides(shape, p));
            (distance < NEARER * next).then_some((shape as u16, line as u8))
        };
        grid.cells = (0..count.iter().product()).map(of).collect();
        grid
    }

    fn index(&self, k: usize) -> [usize; 3] {
        let [_, m, n] = self.count;
        [k / (m * n), k / n % m, k % n]
    }

    fn centre(&self, index: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|d| (index[d] as f64 + 0.5) * self.step[d])
    }

    /// The place of a node, of which a cell has its index as the first one.
    fn node(&self, node: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|d| node[d] as f64 * self.step[d])
    }

    /// A node within the first period.
    fn wrapped(&self, node: [usize; 3]) -> [usize; 3] {
        std::array::from_fn(|d| if self.periodic[d] { node[d] % self.count[d] } else { node[d] })
    }

    fn at(&self, index: [usize; 3]) -> Option<(u16, u8)> {
        let [_, m, n] = self.count;
        self.cells[(index[0] * m + index[1]) * n + index[2]]
    }

    /// The cell next to one along a direction; none behind a side.
    fn next(&self, mut index: [usize; 3], along: usize) -> Option<[usize; 3]> {
        index[along] += 1;
        if index[along] == self.count[along] {
            index[along] = 0;
            return self.periodic[along].then_some(index);
        }
        Some(index)
    }

    /// Whether a shape's surfaces go along a whole period.
    fn wraps(&self, shape: usize, along: usize) -> bool {
        let mut is_met = vec![false; self.count[along]];
        for (k, cell) in self.cells.iter().enumerate() {
            if cell.is_some_and(|(own, _)| own as usize == shape) {
                is_met[self.index(k)[along]] = true;
            }
        }
        self.periodic[along] && is_met.into_iter().all(|met| met)
    }
}

/// Finds particles of a cloud that are next to a place.
struct Particles<'a> {
    cloud: &'a Cloud,
    inside: Nearest<3>,
    /// Where means are needed.
    all: OnceCell<Nearest<3>>,
    /// Points of the boundary on given sides, as particles.
    on_sides: HashMap<Vec<usize>, (Vec<usize>, Nearest<3>)>,
}

impl<'a> Particles<'a> {
    fn new(cloud: &'a Cloud) -> Self {
        let (region, dx, places) = (cloud.ground.region, cloud.ground.dx, &cloud.places);
        let inside = Nearest::new(region, dx, &places.place[..places.inside]);
        Self { cloud, inside, all: OnceCell::new(), on_sides: HashMap::new() }
    }

    /// The particle that is nearest to a place.
    fn any(&self, p: [f64; 3]) -> Option<usize> {
        let (ground, places) = (&self.cloud.ground, &self.cloud.places);
        let all = self.all.get_or_init(|| Nearest::new(ground.region, ground.dx, &places.place));
        Some(all.one(ground.region.wrapped(p), f64::INFINITY)?.1)
    }

    /// The particle inside that is nearest to a place, or that on all of some sides.
    fn near(&mut self, p: [f64; 3], sides: &[usize]) -> Option<usize> {
        let (ground, places) = (&self.cloud.ground, &self.cloud.places);
        let p = ground.region.wrapped(p);
        if sides.is_empty() {
            return Some(self.inside.one(p, f64::INFINITY)?.1);
        }
        let make = || {
            let is_on = |k: &usize| sides.iter().all(|side| places.boundary[*k].sides.contains(side));
            let found: Vec<usize> = (0..places.boundary.len()).filter(is_on).map(|k| places.inside + k).collect();
            let at: Vec<[f64; 3]> = found.iter().map(|&i| places.place[i]).collect();
            (found, Nearest::new(ground.region, ground.dx, &at))
        };
        let (found, nearest) = self.on_sides.entry(sides.to_vec()).or_insert_with(make);
        Some(found[nearest.one(p, f64::INFINITY)?.1])
    }
}

/// The surfaces around all shapes; none of a shape that is too near to what is next to it, or from which fluid flows.
pub fn around_all(cloud: &Cloud, points: &[Vec<usize>], balanced: Balanced) -> Vec<Option<ControlSurface>> {
    let (ground, places) = (&cloud.ground, &cloud.places);
    let width = |shape: usize| {
        let to_next = |&k: &usize| {
            let p = places.place[places.inside + k];
            ground.distance(p, Some(shape)).min(ground.to_sides(shape, p))
        };
        points[shape].iter().map(to_next).fold(f64::INFINITY, f64::min)
    };
    let widths: Vec<f64> = (0..points.len()).map(width).collect();
    if points.is_empty() {
        return vec![];
    }
    let (grid, mut particles) = (Grid::new(cloud, &widths), Particles::new(cloud));
    let one = |shape: usize| {
        let is_wide = widths[shape] >= WIDE * ground.dx;
        is_wide.then(|| ControlSurface::around(shape, &points[shape], &grid, &mut particles, balanced)).flatten()
    };
    (0..points.len()).map(one).collect()
}

/// At a place of a face, from 0 to 1 along both of its edges: shares of the corners, and their derivatives along both.
fn bilinear([s, t]: [f64; 2]) -> [[f64; 4]; 3] {
    [[(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t], [t - 1.0, 1.0 - t, t, -t], [s - 1.0, -s, s, 1.0 - s]]
}

/// The same at Gauss's points.
fn gauss() -> [[[f64; 4]; 3]; 4] {
    let off = 0.5 / 3f64.sqrt();
    std::array::from_fn(|k| bilinear([k / 2, k % 2].map(|end| if end == 0 { 0.5 - off } else { 0.5 + off })))
}

/// A sum of the corners' places with weights.
fn weighted(corners: &[[f64; 3]; 4], weights: &[f64; 4]) -> [f64; 3] {
    std::array::from_fn(|d| (0..4).map(|c| weights[c] * corners[c][d]).sum())
}

/// A point of a face: place, normal out of the surface times area times the share of the surface, and the way there from each corner.
struct Point {
    place: [f64; 3],
    area: [f64; 3],
    way: [[f64; 3]; 4],
}

/// Value and slopes of a field, or their cotangents.
type Read = (f64, [f64; 3]);

/// Of the places of the corners of a face.
type Moved = [[f64; 3]; 4];

fn corners(at: &At<'_>, face: &Face) -> [[f64; 3]; 4] {
    face.map(|corner| std::array::from_fn(|d| at.shaped.position[d][corner.particle] + corner.shift[d]))
}

const QUARTER: f64 = 0.25 * SHARE;

fn point(corners: &[[f64; 3]; 4], [shares, by_s, by_t]: &[[f64; 4]; 3]) -> Point {
    let place = weighted(corners, shares);
    let area = cross(weighted(corners, by_s), weighted(corners, by_t)).map(|x| QUARTER * x);
    Point { place, area, way: corners.map(|corner| std::array::from_fn(|d| place[d] - corner[d])) }
}

/// Adds the cotangents of the corners, given those of a point's place and area.
fn point_back(
    corners: &[[f64; 3]; 4],
    [shares, by_s, by_t]: &[[f64; 4]; 3],
    place: [f64; 3],
    area: [f64; 3],
    moved: &mut Moved,
) {
    let area = area.map(|x| QUARTER * x);
    let of_s = cross(weighted(corners, by_t), area);
    let of_t = cross(area, weighted(corners, by_s));
    for (c, to) in moved.iter_mut().enumerate() {
        (0..3).for_each(|d| to[d] += shares[c] * place[d] + by_s[c] * of_s[d] + by_t[c] * of_t[d]);
    }
}

/// The second derivative of a field at a particle, by its coefficients.
fn second(d: &[f64], a: usize, b: usize) -> f64 {
    d[quadratic(3, a.min(b), a.max(b))]
}

/// A field and its slopes at a point of a face.
fn read(at: &At<'_>, face: &Face, shares: &[f64; 4], point: &Point, field: usize) -> Read {
    let (mut value, mut slopes) = (0.0, [0.0; 3]);
    for ((corner, share), way) in face.iter().zip(shares).zip(&point.way) {
        let d = &at.d.0[field][corner.particle];
        let bent: [f64; 3] = std::array::from_fn(|a| (0..3).map(|b| second(d, a, b) * way[b]).sum());
        let along: f64 = (0..3).map(|a| (d[a] + 0.5 * bent[a]) * way[a]).sum();
        value += share * (at.state.fields[field][corner.particle] + along);
        (0..3).for_each(|a| slopes[a] += share * (d[a] + bent[a]));
    }
    (value, slopes)
}

/// Adds the cotangents of what [`read`] gives.
fn read_back(
    at: &At<'_>,
    face: &Face,
    shares: &[f64; 4],
    point: &Point,
    field: usize,
    (value, slopes): Read,
    (bar, of_place, moved): (&mut Bar, &mut [f64; 3], &mut Moved),
) {
    for (c, (corner, way)) in face.iter().zip(&point.way).enumerate() {
        let (i, value, slopes) = (corner.particle, shares[c] * value, slopes.map(|x| shares[c] * x));
        bar.fields[field][i] += value;
        let to = &mut bar.derivatives.0[field][i];
        for a in 0..3 {
            to[a] += value * way[a] + slopes[a];
            for b in a..3 {
                to[quadratic(3, a, b)] += match a == b {
                    true => 0.5 * value * way[a] * way[a] + slopes[a] * way[a],
                    false => value * way[a] * way[b] + slopes[a] * way[b] + slopes[b] * way[a],
                };
            }
        }
        let d = &at.d.0[field][i];
        for a in 0..3 {
            let by_way = value * d[a] + (0..3).map(|b| second(d, a, b) * (value * way[b] + slopes[b])).sum::<f64>();
            of_place[a] += by_way;
            moved[c][a] -= by_way;
        }
    }
}

fn divergence(at: &At<'_>, i: usize) -> f64 {
    (0..3).map(|e| at.d.0[e][i][e]).sum()
}

impl ControlSurface {
    fn around(
        shape: usize,
        points: &[usize],
        grid: &Grid,
        particles: &mut Particles<'_>,
        balanced: Balanced,
    ) -> Option<Self> {
        let cloud = particles.cloud;
        let (region, surface, centre) = (cloud.ground.region, &cloud.ground.surfaces[shape], cloud.centre[shape]);
        let within = |cell: Option<(u16, u8)>, line: usize| {
            cell.is_some_and(|(own, least)| own as usize == shape && least as usize <= line)
        };
        let stands = |side: usize| surface.stands_on(side);
        let (mut faces, mut edge) = (vec![], Edge::new());
        for index in (0..grid.cells.len()).map(|k| grid.index(k)) {
            let own = grid.at(index);
            for along in 0..3 {
                let Some(next) = grid.next(index, along) else { continue };
                let beyond = grid.at(next);
                for line in 0..REACHES.len() {
                    let is_out = match (within(own, line), within(beyond, line)) {
                        (true, false) => true,
                        (false, true) => false,
                        _ => continue,
                    };
                    // Against the clock as seen from larger values along the direction.
                    let [a, b] = across(along);
                    let mut around = [[0, 0], [1, 0], [1, 1], [0, 1]];
                    if !is_out {
                        around.reverse();
                    }
                    let mut middle = grid.centre(index);
                    middle[along] += 0.5 * grid.step[along];
                    let to_middle = region.between(centre, middle);
                    let middle: [f64; 3] = std::array::from_fn(|d| centre[d] + to_middle[d]);
                    let mut corner = |[x, y]: [usize; 2]| {
                        let mut node = index;
                        node[along] += 1;
                        (node[a], node[b]) = (node[a] + x, node[b] + y);
                        let is_end = |d: usize, end: usize| node[d] == end * grid.count[d] && stands(2 * d + end);
                        let sides: Vec<usize> = (0..6).filter(|side| is_end(side / 2, side % 2)).collect();
                        let p = std::array::from_fn(|d| (node[d] as f64 + ASIDE[d]) * grid.step[d]);
                        let particle = particles.near(p, &sides)?;
                        let place = cloud.places.place[particle];
                        if !sides.is_empty() {
                            edge.insert((line, grid.wrapped(node)), region.between(grid.node(node), place));
                        }
                        Some(Corner { particle, shift: shift_to(&region, place, middle) })
                    };
                    let [p, q, r, s] = around;
                    faces.push([corner(p)?, corner(q)?, corner(r)?, corner(s)?]);
                }
            }
        }
        let own_from = surface.from(centre);
        let from = std::array::from_fn(|d| if grid.wraps(shape, d) { None } else { own_from[d] });
        if faces.is_empty() || from == [None; 3] || own_from == [None; 3] {
            return None;
        }
        let needs_within = balanced != Balanced::Steady || cloud.fluid.buoyancy.is_some();
        let within = if needs_within { grid.shares(cloud, shape, particles) } else { vec![] };
        let feet = grid.feet(cloud, (shape, points), &edge, particles);
        Some(Self { faces, own: points.to_vec(), feet, within, from, own_from, balanced })
    }

    /// The particles at which derivatives are read.
    pub fn particles(&self) -> impl Iterator<Item = usize> + '_ {
        let corners = self.faces.iter().flatten().map(|corner| corner.particle);
        corners.chain(self.within.iter().map(|(particle, _)| *particle))
    }

    fn is_steady(&self) -> bool {
        self.balanced == Balanced::Steady
    }

    /// The cotangents of place and area, given that of [`part_of_volume`].
    fn part_back(from: &[Option<f64>; 3], place: [f64; 3], area: [f64; 3], weight: f64) -> [[f64; 3]; 2] {
        let each = weight / from.iter().flatten().count() as f64;
        let of = |d: usize| from[d].map_or([0.0; 2], |from| [each * area[d], each * (place[d] - from)]);
        [std::array::from_fn(|d| of(d)[0]), std::array::from_fn(|d| of(d)[1])]
    }

    /// Where a point of the shape is.
    fn on_shape(at: &At<'_>, k: usize) -> [f64; 3] {
        std::array::from_fn(|d| at.shaped.position[d][at.equations.inside + k])
    }

    /// The volume of the fluid within.
    fn volume(&self, at: &At<'_>) -> f64 {
        let (gauss, mut sum) = (gauss(), 0.0);
        for face in &self.faces {
            let corners = corners(at, face);
            for shares in &gauss {
                let point = point(&corners, shares);
                sum += part_of_volume(&self.from, &OnSurface { place: point.place, area: point.area });
            }
        }
        let own = |&k: &usize| {
            part_of_volume(&self.own_from, &OnSurface { place: Self::on_shape(at, k), area: at.shaped.area[k] })
        };
        sum - self.own.iter().map(own).sum::<f64>()
    }

    fn volume_back(&self, at: &At<'_>, weight: f64, bar: &mut Bar) {
        let gauss = gauss();
        for face in &self.faces {
            let (corners, mut moved) = (corners(at, face), Moved::default());
            for shares in &gauss {
                let point = point(&corners, shares);
                let [place, area] = Self::part_back(&self.from, point.place, point.area, weight);
                point_back(&corners, shares, place, area, &mut moved);
            }
            Self::move_corners(face, &moved, bar);
        }
        for &k in &self.own {
            let [place, area] = Self::part_back(&self.own_from, Self::on_shape(at, k), at.shaped.area[k], -weight);
            for d in 0..3 {
                bar.position[d][at.equations.inside + k] += place[d];
                bar.boundary[k].area[d] += area[d];
            }
        }
    }

    fn move_corners(face: &Face, moved: &Moved, bar: &mut Bar) {
        for (corner, moved) in face.iter().zip(moved) {
            (0..3).for_each(|d| bar.position[d][corner.particle] += moved[d]);
        }
    }

    /// What acts on a particle within besides what comes through the surface, along e.
    fn acts(&self, at: &At<'_>, i: usize, e: usize) -> f64 {
        let lift = at.equations.buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, at.state.fields[TEMPERATURE][i]));
        if self.is_steady() || i >= at.equations.inside {
            return lift;
        }
        let (u, d) = (at.state.velocity(i), &at.d.0[e][i]);
        let push = at.equations.push(at.state, e);
        let carried: f64 = (0..3).map(|b| u[b] * d[b]).sum();
        let change = push + lift - carried - at.d.0[PRESSURE][i][e] + at.equations.viscosity * laplacian(d);
        lift - change + u[e] * divergence(at, i)
    }

    fn acts_back(&self, at: &At<'_>, i: usize, e: usize, weight: f64, bar: &mut Bar) {
        let is_kept = !(self.is_steady() || i >= at.equations.inside);
        if let Some(buoyancy) = at.equations.buoyancy.filter(|_| !is_kept) {
            bar.fields[TEMPERATURE][i] += weight * buoyancy.by[e];
        }
        if !is_kept {
            return;
        }
        let (u, nu) = (at.state.velocity(i), at.equations.viscosity);
        if e == 0 {
            bar.drive -= weight;
        }
        bar.viscosity -= weight * laplacian(&at.d.0[e][i]);
        bar.derivatives.0[PRESSURE][i][e] += weight;
        bar.fields[e][i] += weight * divergence(at, i);
        for b in 0..3 {
            bar.fields[b][i] += weight * at.d.0[e][i][b];
            bar.derivatives.0[e][i][b] += weight * u[b];
            bar.derivatives.0[e][i][quadratic(3, b, b)] -= weight * nu;
            bar.derivatives.0[b][i][b] += weight * u[e];
        }
    }

    /// The mean of [`Self::acts`].
    fn mean_acts(&self, at: &At<'_>, e: usize) -> f64 {
        self.within.iter().map(|&(i, share)| share * self.acts(at, i, e)).sum()
    }

    /// The force on all within, on the shape and on what closes the surface, along e.
    pub fn force(&self, at: &At<'_>, e: usize) -> f64 {
        let (gauss, mut sum) = (gauss(), 0.0);
        for face in &self.faces {
            let corners = corners(at, face);
            for shares in &gauss {
                let point = point(&corners, shares);
                sum += Self::patch(at, face, &shares[0], &point).push(at.equations.viscosity, e);
            }
        }
        let push = at.equations.push(at.state, e);
        if push == 0.0 && self.within.is_empty() {
            return sum;
        }
        sum + self.volume(at) * (push + self.mean_acts(at, e))
    }

    fn patch(at: &At<'_>, face: &Face, shares: &[f64; 4], point: &Point) -> Patch<3> {
        let [u, v, w, p] = [0, 1, 2, PRESSURE].map(|field| read(at, face, shares, point, field));
        Patch { velocity: [u.0, v.0, w.0], gradient: [u.1, v.1, w.1], pressure: p.0, area: point.area }
    }

    /// Adds the cotangents of [`Self::force`].
    pub fn force_back(&self, at: &At<'_>, e: usize, weight: f64, bar: &mut Bar) {
        let gauss = gauss();
        for face in &self.faces {
            let (corners, mut moved) = (corners(at, face), Moved::default());
            for shares in &gauss {
                let point = point(&corners, shares);
                let patch = Self::patch(at, face, &shares[0], &point);
                let (back, viscosity) = patch.push_back(at.equations.viscosity, unit(e, weight));
                bar.viscosity += viscosity;
                let mut place = [0.0; 3];
                for field in 0..=PRESSURE {
                    let of = match field {
                        PRESSURE => (back.pressure, [0.0; 3]),
                        _ => (back.velocity[field], back.gradient[field]),
                    };
                    read_back(at, face, &shares[0], &point, field, of, (bar, &mut place, &mut moved));
                }
                point_back(&corners, shares, place, back.area, &mut moved);
            }
            Self::move_corners(face, &moved, bar);
        }
        let push = at.equations.push(at.state, e);
        if push == 0.0 && self.within.is_empty() {
            return;
        }
        let volume = self.volume(at);
        self.volume_back(at, weight * (push + self.mean_acts(at, e)), bar);
        if e == 0 {
            bar.drive += weight * volume;
        }
        self.within.iter().for_each(|&(i, share)| self.acts_back(at, i, e, weight * volume * share, bar));
    }

    /// The change of temperature in time at a particle within, less T div u.
    fn warming(at: &At<'_>, i: usize) -> f64 {
        if i >= at.equations.inside {
            return 0.0;
        }
        let (u, d) = (at.state.velocity(i), &at.d.0[TEMPERATURE][i]);
        let carried: f64 = (0..3).map(|b| u[b] * d[b]).sum();
        let conducted = at.equations.diffusivity.unwrap_or(0.0) * laplacian(d);
        conducted - carried - at.state.fields[TEMPERATURE][i] * divergence(at, i)
    }

    fn warming_back(at: &At<'_>, i: usize, weight: f64, bar: &mut Bar) {
        if i >= at.equations.inside {
            return;
        }
        let (u, alpha) = (at.state.velocity(i), at.equations.diffusivity.unwrap_or(0.0));
        let (t, d) = (at.state.fields[TEMPERATURE][i], &at.d.0[TEMPERATURE][i]);
        bar.fields[TEMPERATURE][i] -= weight * divergence(at, i);
        for b in 0..3 {
            bar.fields[b][i] -= weight * d[b];
            bar.derivatives.0[TEMPERATURE][i][b] -= weight * u[b];
            bar.derivatives.0[TEMPERATURE][i][quadratic(3, b, b)] += weight * alpha;
            bar.derivatives.0[b][i][b] -= weight * t;
        }
    }

    fn mean_warming(&self, at: &At<'_>) -> f64 {
        self.within.iter().map(|&(i, share)| share * Self::warming(at, i)).sum()
    }

    /// The heat that all within gives to the fluid, the shape and what closes the surface, per density and heat capacity.
    pub fn heat(&self, at: &At<'_>) -> f64 {
        let (gauss, alpha, mut sum) = (gauss(), at.equations.diffusivity.unwrap_or(0.0), 0.0);
        for face in &self.faces {
            let corners = corners(at, face);
            for shares in &gauss {
                let point = point(&corners, shares);
                let velocity = [0, 1, 2].map(|field| read(at, face, &shares[0], &point, field).0);
                let (t, slope) = read(at, face, &shares[0], &point, TEMPERATURE);
                sum += t * dot(velocity, point.area) - alpha * dot(slope, point.area);
            }
        }
        if self.is_steady() {
            return sum;
        }
        sum + self.volume(at) * self.mean_warming(at)
    }

    /// Adds the cotangents of [`Self::heat`].
    pub fn heat_back(&self, at: &At<'_>, weight: f64, bar: &mut Bar) {
        let (gauss, alpha) = (gauss(), at.equations.diffusivity.unwrap_or(0.0));
        for face in &self.faces {
            let (corners, mut moved) = (corners(at, face), Moved::default());
            for shares in &gauss {
                let point = point(&corners, shares);
                let u = [0, 1, 2].map(|field| read(at, face, &shares[0], &point, field).0);
                let (t, slope) = read(at, face, &shares[0], &point, TEMPERATURE);
                let mut place = [0.0; 3];
                for field in [0, 1, 2, TEMPERATURE] {
                    let of = match field {
                        TEMPERATURE => (weight * dot(u, point.area), point.area.map(|a| -weight * alpha * a)),
                        _ => (weight * t * point.area[field], [0.0; 3]),
                    };
                    read_back(at, face, &shares[0], &point, field, of, (bar, &mut place, &mut moved));
                }
                let area = std::array::from_fn(|d| weight * (t * u[d] - alpha * slope[d]));
                point_back(&corners, shares, place, area, &mut moved);
            }
            Self::move_corners(face, &moved, bar);
        }
        if self.is_steady() {
            return;
        }
        let volume = self.volume(at);
        self.volume_back(at, weight * self.mean_warming(at), bar);
        self.within.iter().for_each(|&(i, share)| Self::warming_back(at, i, weight * volume * share, bar));
    }
}

impl Grid {
    /// The surfaces that a cell is within, of a shape.
    fn lines(&self, shape: usize, cell: Option<(u16, u8)>) -> usize {
        cell.filter(|(own, _)| *own as usize == shape).map_or(0, |(_, least)| REACHES.len() - least as usize)
    }

    /// The particles within surfaces around a shape, with their shares of the fluid's volume there. (A point of a wall has its own if what is
    /// there does not change; otherwise the next particle inside has it.)
    fn shares(&self, cloud: &Cloud, shape: usize, particles: &mut Particles<'_>) -> Vec<(usize, f64)> {
        let (places, numbers) = (&cloud.places, cloud.numbers());
        let mut found = BTreeMap::new();
        let part = |k: usize| ((k % PARTS) as f64 + 0.5) / PARTS as f64;
        for (k, cell) in self.cells.iter().enumerate() {
            let lines = self.lines(shape, *cell);
            for sub in 0..if lines > 0 { PARTS * PARTS * PARTS } else { 0 } {
                let (index, of) = (self.index(k), [part(sub), part(sub / PARTS), part(sub / PARTS / PARTS)]);
                let p: [f64; 3] = std::array::from_fn(|d| (index[d] as f64 + of[d]) * self.step[d]);
                if cloud.ground.distance(p, None) <= 0.0 {
                    continue;
                }
                let own = particles.any(p);
                let own = own.filter(|i| {
                    i.checked_sub(places.inside)
                        .is_none_or(|k| cloud.stays(k, places.place[places.inside + k], &numbers))
                });
                if let Some(particle) = own.or_else(|| particles.near(p, &[])) {
                    *found.entry(particle).or_insert(0.0) += lines as f64;
                }
            }
        }
        let total: f64 = found.values().sum();
        found.into_iter().map(|(particle, share)| (particle, share / total)).collect()
    }

    /// The corners of a cell on a side: nodes of the lattice, and where the edge of a surface goes through them, particles.
    fn corners_on(&self, side: usize, index: [usize; 3], line: usize, edge: &Edge) -> [[f64; 3]; 4] {
        let (along, [a, b]) = (side / 2, across(side / 2));
        [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[x, y]| {
            let mut node = index;
            (node[along], node[a], node[b]) = (side % 2 * self.count[along], node[a] + x, node[b] + y);
            let (place, moved) = (self.node(node), edge.get(&(line, self.wrapped(node))));
            moved.map_or(place, |moved| std::array::from_fn(|d| place[d] + moved[d]))
        })
    }

    /// What closes surfaces around a shape, with points on it, on the sides that it stands on.
    fn feet(
        &self,
        cloud: &Cloud,
        (shape, points): (usize, &[usize]),
        edge: &Edge,
        particles: &mut Particles<'_>,
    ) -> Vec<Foot> {
        let (region, places, surface) = (&cloud.ground.region, &cloud.places, &cloud.ground.surfaces[shape]);
        let sides: Vec<usize> = (0..6).filter(|&side| surface.stands_on(side)).collect();
        if sides.is_empty() {
            return vec![];
        }
        let own: Vec<[f64; 3]> = points.iter().map(|k| region.wrapped(places.place[places.inside + k])).collect();
        let to_own = Nearest::new(*region, cloud.ground.dx, &own);
        let mut found: BTreeMap<(usize, usize), Foot> = BTreeMap::new();
        for side in sides {
            let (along, [a, b], end) = (side / 2, across(side / 2), side % 2);
            for k in 0..self.count[a] * self.count[b] {
                let mut index = [end * (self.count[along] - 1); 3];
                (index[a], index[b]) = (k / self.count[b], k % self.count[b]);
                let lines = self.lines(shape, self.at(index));
                if lines == 0 {
                    continue;
                }
                let mut middle = self.centre(index);
                middle[along] = region.size[along] * end as f64;
                let is_cut = surface.distance(region, middle).abs() < self.step[a].hypot(self.step[b]);
                let parts = if is_cut { PARTS_CUT } else { PARTS_OF_SIDES };
                let ways: &[(usize, usize, f64)] =
                    if is_cut { &[(a, b, -1.0), (a, b, 1.0), (b, a, -1.0), (b, a, 1.0)] } else { &[] };
                let quads = (REACHES.len() - lines..REACHES.len()).map(|line| self.corners_on(side, index, line, edge));
                for (corners, sub) in quads.flat_map(|corners| (0..parts * parts).map(move |sub| (corners, sub))) {
                    let of = |k: usize| ((k % parts) as f64 + 0.5) / parts as f64;
                    let [p, s, t] = bilinear([of(sub), of(sub / parts)]).map(|shares| weighted(&corners, &shares));
                    if cloud.ground.distance(p, None) <= 0.0 {
                        continue;
                    }
                    let Some(particle) = particles.near(p, &[side]) else { continue };
                    let (point, normal) = (particle - places.inside, inward(side));
                    let new = || Foot { point, normal, area: 0.0, by: BTreeMap::new() };
                    let foot = found.entry((side, particle)).or_insert_with(new);
                    foot.area += SHARE * ((s[a] * t[b] - s[b] * t[a]) / (parts * parts) as f64);
                    // Where the shape begins beside this part of the cell, it covers more of the side when it moves that way.
                    for &(d, other, way) in ways {
                        let mut beside = p;
                        beside[d] += way * self.step[d] / parts as f64;
                        if surface.distance(region, beside) > 0.0 {
                            continue;
                        }
                        let Some((_, k)) = to_own.one(region.wrapped(beside), f64::INFINITY) else { continue };
                        let (i, by) = (places.inside + points[k], SHARE * way * (self.step[other] / parts as f64));
                        foot.by.entry(i).or_default()[d] += by;
                        // So that the sum is the area where nothing has moved.
                        foot.area -= by * places.place[i][d];
                    }
                }
            }
        }
        found.into_values().collect()
    }
}
