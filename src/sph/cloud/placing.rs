//! Places of fixed particles: on walls and surfaces, in layers around bodies, and on a lattice.
//!
//! The spacing h is h0 on a body (dx / 3 by default, less where the surface turns sharply) and grows by a quarter of the
//! distance to dx. Points on the surface are h0 apart; layers follow it at distances of 0.95 h, their points h apart; where h
//! has reached dx a lattice goes on. A side of the box that a surface meets is as fine as the surface there. Points too near to
//! others are left out, and 30 steps of repulsion spread those near bodies evenly:
//!
//! ```text
//!   x_i += h_i / 4 sum_j (1 - r / R)^2 r_ij / r,   R = 0.8 (h_i + h_j).
//! ```

use super::nearest::{Cells, Nearest, Plane, Region};
use super::outline::{area, area_within, is_inside, OnOutline, Outline};
use super::sliding::{self, End, Footing, Mark, OnSide, Stretch};

/// What the cloud is made of: outlines of bodies and walls in a box.
#[derive(Debug, Clone)]
pub struct Ground {
    pub plane: Plane,
    pub dx: f64,
    /// Spacing on surfaces of bodies.
    pub surface: f64,
    /// The largest spacing far from bodies, in dx.
    pub far: f64,
    /// Growth of the spacing far from bodies, per distance.
    pub growth: f64,
    /// Outlines by shape.
    pub outlines: Vec<Outline>,
}

/// A point on a wall: its part of the boundary is normal times length, out of the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryPoint {
    pub particle: usize,
    /// The shape and parameter of its outline; none on a side of the box.
    pub on: Option<(usize, f64)>,
    /// Length per |dc/dt| of an outline; length on a side.
    pub weight: f64,
    /// Unit normal into the fluid.
    pub normal: [f64; 2],
    /// Index of the box's side: 2 d + (0 low, 1 high).
    pub side: Option<usize>,
}

/// Fixed particles: those inside first, then those on walls.
#[derive(Debug, Clone)]
pub struct Places {
    pub place: Vec<[f64; 2]>,
    /// Spacing of each particle.
    pub spacing: Vec<f64>,
    /// Number of particles inside.
    pub inside: usize,
    pub boundary: Vec<BoundaryPoint>,
    /// Shapes whose whole outline is in the fluid.
    pub bodies: Vec<usize>,
    /// Shapes of which a part of the outline is in the fluid.
    pub touching: Vec<usize>,
    /// The parts of their outlines that are in the fluid, of those that are not bodies.
    pub stretches: Vec<Stretch>,
    /// Points of sides that follow the ends of these.
    pub on_sides: Vec<OnSide>,
    /// Polygons of the outlines, fine, for tests of what is inside.
    pub polygons: Vec<Polygon>,
    /// Lower and upper corner of the fluid.
    pub corners: [[f64; 2]; 2],
}

/// What is wrong with shapes that cannot be placed.
#[derive(Debug, Clone, PartialEq)]
pub enum Unplaceable {
    /// Two bodies, or a body and a wall, are nearer than this, or cut each other (0).
    Narrow { shape: usize, width: f64 },
    /// A shape is thinner than can be resolved.
    Thin { shape: usize, width: f64 },
    /// No fluid is left.
    Full,
}

/// Growth of the spacing near a surface, per distance.
pub(super) const GROWTH: f64 = 0.25;
const LAYERS: usize = 2;
const RELAXATIONS: usize = 30;
/// The least distance of points where the spacing is coarser, in spacings, before they repel each other. (A lattice that is
/// coarser by whole factors of two is as accurate, but flows in time are not stable there.)
const APART: f64 = 0.85;
/// Farther from surfaces, in dx, there are neither layers nor displaced points.
const FAR: f64 = 12.0;
/// Smallest spacing on a surface, in the usual one.
const FINEST: f64 = 0.4;
/// Particles inside keep so far off the sides of the box, in spacings.
const OFF_SIDES: f64 = 0.5;
/// What is nearer to a side of the box touches it, in dx.
const TOUCH: f64 = 1e-9;
/// A shape may end so far behind the side that it is behind, in dx.
const BEHIND: f64 = 0.25;
/// Samples of the spacing along a side that a surface meets, per cell of the lattice.
const SAMPLES: usize = 4;
/// Places between two points of a side at which there may be a wall.
const BETWEEN: usize = 64;
/// Spacing on a surface in its radius of curvature.
const PER_RADIUS: f64 = 0.55;

/// Where a surface meets a side of the box, and the spacing there.
struct Contact {
    place: [f64; 2],
    spacing: f64,
}

/// The inside of a closed line of points, with the box around it.
#[derive(Debug, Clone)]
pub struct Polygon {
    points: Vec<[f64; 2]>,
    low: [f64; 2],
    high: [f64; 2],
}

/// The lower and upper corner of the box around points.
pub(super) fn bounds(points: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let of = |first: f64, choose: fn(f64, f64) -> f64| {
        std::array::from_fn(|d| points.iter().map(|p| p[d]).fold(first, choose))
    };
    [of(f64::INFINITY, f64::min), of(f64::NEG_INFINITY, f64::max)]
}

impl std::ops::Deref for Polygon {
    type Target = [[f64; 2]];

    fn deref(&self) -> &Self::Target {
        &self.points
    }
}

impl Polygon {
    /// An outline as points that are close to each other.
    pub fn of(points: &[OnOutline<f64>]) -> Self {
        let points: Vec<[f64; 2]> = points.iter().map(|point| point.place).collect();
        let [low, high] = bounds(&points);
        Self { points, low, high }
    }

    /// The lower and upper corner of the box around it.
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        [self.low, self.high]
    }

    pub fn perimeter(&self) -> f64 {
        let points = &self.points;
        let edge = |k: usize| {
            let (a, b) = (points[k], points[(k + 1) % points.len()]);
            (b[0] - a[0]).hypot(b[1] - a[1])
        };
        (0..points.len()).map(edge).sum()
    }

    pub fn area(&self) -> f64 {
        area_within(self.points.len(), |k| self.points[k]).abs()
    }

    /// Whether a point is inside.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        let may = (0..2).all(|d| p[d] >= self.low[d] && p[d] <= self.high[d]);
        may && is_inside(p, &self.points)
    }

    /// Whether a point or a periodic image of it is inside.
    pub fn covers(&self, plane: &Plane, p: [f64; 2]) -> bool {
        plane.images().any(|image| self.contains([p[0] + image[0], p[1] + image[1]]))
    }
}

/// The shape behind a point of a side of the box, the last one if there are several. It may end up to a quarter of a spacing behind the side, so that
/// no rounding decides. A shape that is no farther away along the side is not behind the point but beside it: it leans there, as a fin does.
pub fn behind(plane: &Plane, dx: f64, polygons: &[Polygon], place: [f64; 2], normal: [f64; 2]) -> Option<usize> {
    let covers = |shape: usize, out: f64, aside: f64| {
        let [x, y] = normal;
        polygons[shape].covers(plane, [place[0] + dx * (out * x - aside * y), place[1] + dx * (out * y + aside * x)])
    };
    let is_below = |shape: usize| {
        let is_nearer_beside = || {
            let is_beside = |far: f64| [far, -far].into_iter().any(|aside| covers(shape, -TOUCH, aside));
            let mut steps = (1..=BETWEEN).map(|step| BEHIND * step as f64 / BETWEEN as f64);
            steps.find(|&far| is_beside(far) || covers(shape, -far, 0.0)).is_some_and(is_beside)
        };
        covers(shape, -BEHIND, 0.0) && !is_nearer_beside()
    };
    let last = |is_behind: &dyn Fn(usize) -> bool| (0..polygons.len()).rev().find(|&shape| is_behind(shape));
    last(&|shape| covers(shape, -TOUCH, 0.0)).or_else(|| last(&is_below))
}

fn outward(along: [f64; 2]) -> [f64; 2] {
    let length = along[0].hypot(along[1]);
    [along[1] / length, -along[0] / length]
}

impl Ground {
    /// Whether a place, or an image of it, is inside any polygon but that of `except`.
    pub fn is_in_wall(&self, polygons: &[Polygon], p: [f64; 2], except: Option<usize>) -> Option<usize> {
        (0..polygons.len()).rev().filter(|&k| Some(k) != except).find(|&k| polygons[k].covers(&self.plane, p))
    }

    /// Whether a place is out of the box, or inside any polygon but that of `except`.
    pub fn is_solid(&self, polygons: &[Polygon], p: [f64; 2], except: Option<usize>) -> bool {
        self.depth(p) < 0.0 || self.is_in_wall(polygons, p, except).is_some()
    }

    /// How far a place is from the sides of the box; negative outside.
    fn depth(&self, p: [f64; 2]) -> f64 {
        let Plane { size, periodic } = self.plane;
        (0..2).filter(|&d| !periodic[d]).map(|d| p[d].min(size[d] - p[d])).fold(f64::INFINITY, f64::min)
    }

    fn is_in_box(&self, p: [f64; 2]) -> bool {
        self.depth(p) > TOUCH * self.dx
    }

    /// Fills the fluid with particles.
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn fill(&self) -> Result<Places, Unplaceable> {
        let Self { plane, dx, .. } = *self;
        let fine: Vec<(Vec<f64>, Vec<OnOutline<f64>>)> = self
            .outlines
            .iter()
            .map(|outline| {
                let samples = outline.samples(if outline.numbers.len() > 60 { 8 } else { 64 });
                let points = outline.points(&samples, &outline.numbers);
                (samples, points)
            })
            .collect();
        let polygons: Vec<Polygon> = fine.iter().map(|(_, points)| Polygon::of(points)).collect();
        let mut places = Places {
            place: vec![],
            spacing: vec![],
            inside: 0,
            boundary: vec![],
            bodies: vec![],
            touching: vec![],
            stretches: vec![],
            on_sides: vec![],
            polygons: polygons.clone(),
            corners: [[0.0; 2], plane.size],
        };
        let mut surface: Vec<(BoundaryPoint, [f64; 2], f64)> = vec![];
        let mut layers: Vec<([f64; 2], f64, f64)> = vec![];
        // Samples of surfaces with the distance at which their layers end, and the spacing there.
        let mut near: Vec<([f64; 2], f64, f64)> = vec![];
        let mut contacts: Vec<Contact> = vec![];
        for (k, (samples, points)) in fine.iter().enumerate() {
            let is_free = |p: [f64; 2]| self.is_in_box(p) && self.is_in_wall(&polygons, p, Some(k)).is_none();
            let [low, high] = polygons[k].bounds();
            let longer = |d: usize| if plane.periodic[d] { high[d] - low[d] - plane.size[d] } else { -plane.size[d] };
            // A wall as long as a period, or longer, is there once. Shorter ones may go through its ends.
            let in_period = |p: [f64; 2]| {
                let is_once = |d: usize| p[d] >= -TOUCH * dx && p[d] < plane.size[d] - TOUCH * dx;
                (0..2).all(|d| longer(d) < -TOUCH * dx || is_once(d))
            };
            let is_free_all = points.iter().all(|point| is_free(point.place));
            // Its ends would meet.
            if is_free_all && (0..2).any(|d| longer(d).abs() <= TOUCH * dx) {
                return Err(Unplaceable::Narrow { shape: k, width: 0.0 });
            }
            let is_short = (0..2).all(|d| longer(d) < -TOUCH * dx);
            let whole = is_free_all && is_short;
            let free: Vec<bool> =
                points.iter().map(|point| is_free(point.place) && (whole || in_period(point.place))).collect();
            if !free.iter().any(|&free| free) {
                continue;
            }
            places.touching.push(k);
            let outline = &self.outlines[k];
            let put = |chosen: Vec<(f64, f64, f64)>, surface: &mut Vec<(BoundaryPoint, [f64; 2], f64)>| {
                for (t, dt, h) in chosen {
                    let t = t.rem_euclid(1.0);
                    let on = outline.points(&[t], &outline.numbers)[0];
                    let normal = outward(on.along);
                    let point = BoundaryPoint { particle: 0, on: Some((k, t)), weight: dt, normal, side: None };
                    surface.push((point, if is_short { on.place } else { plane.wrapped(on.place) }, h));
                }
            };
            if whole {
                places.bodies.push(k);
                let lengths = lengths(points);
                let spacing = self.surface_spacing(points, &lengths);
                self.check_thickness(k, points, &spacing)?;
                put(spread(samples, &lengths, &spacing, true, 0.0, 1.0), &mut surface);
                self.layers(points, &lengths, &spacing, &mut layers, &mut near);
                continue;
            }
            let may = |t: f64| {
                let place = outline.points(&[t.rem_euclid(1.0)], &outline.numbers)[0].place;
                is_free(place) && in_period(place)
            };
            // Stretches of the outline that are in the fluid, from where it comes out of a wall to where it goes into one.
            for (from, to) in stretches(&free) {
                let n = samples.len();
                let at = |k: usize| samples[k % n] + (k / n) as f64;
                let mut parameters: Vec<f64> = (from..to).map(at).collect();
                parameters.insert(0, end_of(parameters[0], at(from + n - 1) - 1.0, &may));
                parameters.push(end_of(parameters[parameters.len() - 1], at(to), &may));
                let ends = [parameters[0], parameters[parameters.len() - 1]];
                let ends = ends.map(|t| End::new(&self.outlines, k, &plane, t, dx));
                places.stretches.push(Stretch { shape: k, ends });
                let wrapped: Vec<f64> = parameters.iter().map(|t| t.rem_euclid(1.0)).collect();
                let on = outline.points(&wrapped, &outline.numbers);
                let length = lengths(&on);
                let total: f64 = length[..length.len() - 1].iter().sum();
                let first = outward(on[1].along);
                let is_straight = on.iter().all(|point| {
                    let n = outward(point.along);
                    n[0] * first[0] + n[1] * first[1] > 1.0 - 1e-9
                });
                let spacing = if is_straight { vec![dx; on.len()] } else { self.surface_spacing(&on, &length) };
                // A wall along a period begins where the lattice does.
                let is_period = (0..2).any(|d| plane.periodic[d] && (total / plane.size[d] - 1.0).abs() < 1e-6);
                let offset = if is_period { 0.0 } else { 0.5 };
                put(spread(&parameters, &length, &spacing, false, offset, 1.0), &mut surface);
                if !is_straight {
                    self.layers(&on, &length, &spacing, &mut layers, &mut near);
                    let last = on.len() - 1;
                    let ends = [0, last].map(|end| Contact { place: on[end].place, spacing: spacing[end] });
                    contacts.extend(ends.into_iter().filter(|end| self.depth(end.place) < sliding::AT_SIDE * dx));
                }
            }
        }
        self.corners_of(&mut places);
        // A few points of each surface tell how far it is.
        let bodies: Vec<[f64; 2]> = near.iter().step_by(16).map(|(place, ..)| *place).collect();
        self.sides(&polygons, &places.corners, (&bodies, &contacts), &mut surface);
        if surface.is_empty() && places.touching.is_empty() && !plane.periodic.iter().all(|&p| p) {
            return Err(Unplaceable::Full);
        }
        let mut kept: Vec<([f64; 2], f64)> = vec![];
        let walls: Vec<[f64; 2]> = surface.iter().map(|(_, place, _)| *place).collect();
        let to_walls = Nearest::new(plane, dx, &walls);
        let samples: Vec<[f64; 2]> = near.iter().map(|(place, ..)| plane.wrapped(*place)).collect();
        let to_samples = Nearest::new(plane, dx, &samples);
        // Layers' points keep off walls and earlier layers' points.
        let mut cells = Growing::new(plane, dx);
        for &(p, h, distance) in &layers {
            if self.depth(p) < OFF_SIDES * h || self.is_in_wall(&polygons, p, None).is_some() {
                continue;
            }
            let p = plane.wrapped(p);
            let off_wall = match to_walls.one(p, dx) {
                Some((far, i)) if surface[i].0.side.is_some() || surface[i].2 > 0.99 * dx => far > 0.6 * h,
                _ => true,
            };
            if off_wall && to_samples.distance(p, distance) > 0.9 * distance && !cells.has_within(p, 0.6 * h) {
                cells.add(p);
                kept.push((p, h));
            }
        }
        let layered: Vec<[f64; 2]> = kept.iter().map(|(p, _)| *p).collect();
        let to_layers = Nearest::new(plane, dx, &layered);
        // Points of the lattice keep off walls and layers.
        let may = |p: [f64; 2], h: f64| {
            let is_in_fluid = self.is_in_box(p) && self.is_in_wall(&polygons, p, None).is_none();
            let beyond = || match to_samples.one(p, FAR * dx) {
                Some((distance, i)) => distance > near[i].1 - 0.95 * dx,
                None => true,
            };
            is_in_fluid && to_walls.distance(p, h) > 0.75 * h && beyond() && to_layers.distance(p, dx) > 0.75 * dx
        };
        kept.extend(self.lattice(&places.corners, &bodies, &may));
        if kept.len() < 20 {
            return Err(Unplaceable::Full);
        }
        places.inside = kept.len();
        places.spacing = kept.iter().map(|(_, h)| *h).chain(surface.iter().map(|(_, _, h)| *h)).collect();
        places.place = kept.iter().map(|(p, _)| *p).chain(walls.iter().copied()).collect();
        for (k, (point, ..)) in surface.iter().enumerate() {
            places.boundary.push(BoundaryPoint { particle: places.inside + k, ..*point });
        }
        places.on_sides = self.on_sides(&places);
        // Lattice points too, where the lattice does not fit to a wall.
        let moves: Vec<bool> = kept
            .iter()
            .map(|(p, h)| {
                let by_body = to_samples.one(*p, FAR * dx).is_some_and(|(distance, i)| distance < near[i].1 + 2.0 * dx);
                by_body
                    || (self.far > 1.0 && *h > dx)
                    || to_walls
                        .one(*p, 2.0 * dx)
                        .is_some_and(|(distance, _)| distance < 1.6 * dx && (distance / dx - 1.0).abs() > 0.01)
            })
            .collect();
        self.relax(&mut places, &moves);
        if let Some(bad) = self.narrow(&places) {
            return Err(bad);
        }
        Ok(places)
    }

    /// The spacing at samples of a surface: less where it is strongly curved, growing by a quarter of the way along it.
    fn surface_spacing(&self, points: &[OnOutline<f64>], lengths: &[f64]) -> Vec<f64> {
        let n = points.len();
        let mut spacing: Vec<f64> = (0..n)
            .map(|k| {
                // Turning over about one spacing.
                let (mut turn, mut way, mut i) = (0.0, 0.0, k);
                while way < self.surface {
                    let (a, b) = (points[i % n].along, points[(i + 1) % n].along);
                    turn += (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]);
                    way += lengths[i % n];
                    i += 1;
                    if i - k > n {
                        break;
                    }
                }
                let radius = way / turn.abs().max(1e-9);
                (PER_RADIUS * radius).clamp(FINEST * self.surface, self.surface)
            })
            .collect();
        for _ in 0..2 {
            for k in 0..2 * n {
                let (a, b) = (k % n, (k + 1) % n);
                spacing[b] = spacing[b].min(spacing[a] + GROWTH * lengths[a]);
            }
            for k in (0..2 * n).rev() {
                let (a, b) = (k % n, (k + 1) % n);
                spacing[a] = spacing[a].min(spacing[b] + GROWTH * lengths[a]);
            }
        }
        spacing
    }

    /// Checks that a body is thick enough for points on both of its sides, away from its tips.
    fn check_thickness(&self, shape: usize, points: &[OnOutline<f64>], spacing: &[f64]) -> Result<(), Unplaceable> {
        let perimeter: f64 = lengths(points).iter().sum();
        let thick = 2.0 * area(points).abs() / perimeter;
        let least = spacing.iter().fold(f64::MAX, |a, &b| a.min(b));
        if thick < 0.5 * least || perimeter < 6.0 * least {
            return Err(Unplaceable::Thin { shape, width: thick.min(perimeter / std::f64::consts::PI) });
        }
        Ok(())
    }

    /// Layers along a surface: place, spacing and distance of each point. `near` gets the samples with the distance of
    /// the last layer.
    fn layers(
        &self,
        points: &[OnOutline<f64>],
        lengths: &[f64],
        surface: &[f64],
        layers: &mut Vec<([f64; 2], f64, f64)>,
        near: &mut Vec<([f64; 2], f64, f64)>,
    ) {
        let (n, dx) = (points.len(), self.dx);
        let total: f64 = lengths.iter().sum();
        let is_closed = {
            let (a, b) = (points[0].place, points[n - 1].place);
            (a[0] - b[0]).hypot(a[1] - b[1]) < 3.0 * total / n as f64
        };
        let mut distance = vec![0.0; n];
        let mut end = vec![f64::NAN; n];
        for layer in 1.. {
            let spacing: Vec<f64> = (0..n).map(|k| dx.min(surface[k] + GROWTH * distance[k])).collect();
            for k in 0..n {
                distance[k] += 0.95 * spacing[k];
                if end[k].is_nan() && layer > LAYERS && spacing[k] > 0.9 * dx {
                    end[k] = distance[k];
                }
            }
            if end.iter().all(|end| !end.is_nan()) {
                break;
            }
            let curve: Vec<[f64; 2]> = (0..n)
                .map(|k| {
                    let out = outward(points[k].along);
                    [points[k].place[0] + distance[k] * out[0], points[k].place[1] + distance[k] * out[1]]
                })
                .collect();
            let step = |k: usize| {
                let (a, b) = (curve[k], curve[(k + 1) % n]);
                (b[0] - a[0]).hypot(b[1] - a[1])
            };
            let steps: Vec<f64> = (0..n).map(|k| if k + 1 == n && !is_closed { 0.0 } else { step(k) }).collect();
            let index: Vec<f64> = (0..n).map(|k| k as f64).collect();
            let offset = if layer % 2 == 1 { 0.5 } else { 0.0 };
            for (at, _, h) in spread(&index, &steps, &spacing, is_closed, offset, n as f64) {
                let (k, share) = (at as usize % n, at.fract());
                if !end[k].is_nan() {
                    continue;
                }
                let (a, b) = (curve[k], curve[(k + 1) % n]);
                layers.push(([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])], h, distance[k]));
            }
        }
        near.extend((0..n).map(|k| (points[k].place, end[k], surface[k])));
    }

    /// The lower and upper corner of the fluid: where walls cover whole sides of the box, it is smaller.
    fn corners_of(&self, places: &mut Places) {
        let Plane { size, periodic } = self.plane;
        for d in 0..2 {
            if periodic[d] {
                continue;
            }
            let covered = |x: f64| {
                let across = 40;
                (0..across).all(|k| {
                    let y = (k as f64 + 0.5) / across as f64 * size[1 - d];
                    let p = if d == 0 { [x, y] } else { [y, x] };
                    self.is_in_wall(&places.polygons, p, None).is_some()
                })
            };
            for (end, way) in [(0, 1.0), (1, -1.0)] {
                let at = |depth: f64| if way > 0.0 { depth } else { size[d] - depth };
                let most = (1..)
                    .map(|k| 0.25 * self.dx * f64::from(k))
                    .take_while(|&x| x < 0.5 * size[d])
                    .take_while(|&x| covered(at(x)))
                    .last();
                if let Some(inner) = most {
                    let (mut low, mut high) = (inner, inner + 0.25 * self.dx);
                    for _ in 0..40 {
                        let middle = 0.5 * (low + high);
                        if covered(at(middle)) {
                            low = middle;
                        } else {
                            high = middle;
                        }
                    }
                    places.corners[end][d] = at(0.5 * (low + high));
                }
            }
        }
    }

    /// Numbers of cells of the lattice.
    pub fn cells(&self, corners: &[[f64; 2]; 2]) -> [usize; 2] {
        std::array::from_fn(|d| (((corners[1][d] - corners[0][d]) / self.dx).round() as usize).max(1))
    }

    /// The spacing at a place far from surfaces, given points on the bodies: dx to 8 dx away from them, then growing to `far`.
    fn spacing(&self, p: [f64; 2], bodies: &[[f64; 2]]) -> f64 {
        if self.far <= 1.0 || bodies.is_empty() {
            return self.dx;
        }
        let distance = bodies.iter().map(|q| self.plane.distance(p, *q)).fold(f64::INFINITY, f64::min);
        self.dx * (1.0 + self.growth * (distance / self.dx - 8.0)).clamp(1.0, self.far)
    }

    /// Whether the spacing is that of the lattice.
    fn is_fine(&self, spacing: f64) -> bool {
        spacing < 1.02 * self.dx
    }

    /// The points of the lattice that `may` be there, with their spacing. Where it is coarser only some are left, no two of them nearer than
    /// 0.85 spacings, taken in an order without direction; repulsion will spread them. (Points that a wall then took away would leave gaps
    /// along it: of 60 slow flows past a disc with `far` = 2 six had no steady state.)
    fn lattice(
        &self,
        corners: &[[f64; 2]; 2],
        bodies: &[[f64; 2]],
        may: &impl Fn([f64; 2], f64) -> bool,
    ) -> Vec<([f64; 2], f64)> {
        let cells = self.cells(corners);
        let range = |d: usize| if self.plane.periodic[d] { 0..cells[d] } else { 1..cells[d] };
        let at = |d: usize, k: usize| corners[0][d] + (corners[1][d] - corners[0][d]) * k as f64 / cells[d] as f64;
        let (mut found, mut coarse) = (vec![], vec![]);
        for i in range(0) {
            for j in range(1) {
                let p = [at(0, i), at(1, j)];
                let h = self.spacing(p, bodies);
                if !may(p, h) {
                    continue;
                }
                if self.is_fine(h) {
                    found.push((p, h));
                } else {
                    let order = ((i * cells[1] + j) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32);
                    coarse.push((order.wrapping_mul(0xd6e8_feb8_6659_fd93), p, h));
                }
            }
        }
        coarse.sort_by_key(|(order, ..)| *order);
        let mut cells = Growing::new(self.plane, self.far * self.dx);
        found.iter().for_each(|(p, _)| cells.add(*p));
        for (_, p, h) in coarse {
            if !cells.has_within(p, APART * h) {
                cells.add(p);
                found.push((p, h));
            }
        }
        found
    }

    /// Points on those sides of the box that the fluid reaches.
    fn sides(
        &self,
        polygons: &[Polygon],
        corners: &[[f64; 2]; 2],
        (bodies, contacts): (&[[f64; 2]], &[Contact]),
        surface: &mut Vec<(BoundaryPoint, [f64; 2], f64)>,
    ) {
        let Plane { size, periodic } = self.plane;
        let cells = self.cells(corners);
        for (d, end) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let inside =
                if end == 0 { corners[0][d] > 1e-9 * self.dx } else { corners[1][d] < size[d] - 1e-9 * self.dx };
            if periodic[d] || inside {
                continue;
            }
            let (e, inner) = (1 - d, self.dx * 1e-6);
            let step = (corners[1][e] - corners[0][e]) / cells[e] as f64;
            let mut normal = [0.0; 2];
            normal[d] = if end == 0 { 1.0 } else { -1.0 };
            // A place by its number of steps along the side.
            let place = |k: f64| {
                let mut p = [0.0; 2];
                p[e] = corners[0][e] + step * k;
                p[d] = if end == 0 { 0.0 } else { size[d] };
                p
            };
            let all = cells[e] as f64;
            // Next to a surface it is as fine as that.
            let spacing_at = |k: f64| {
                let next_to = |end: &Contact| end.spacing + GROWTH * self.plane.distance(end.place, place(k));
                contacts.iter().map(next_to).fold(self.spacing(place(k), bodies), f64::min)
            };
            let in_cell = if contacts.is_empty() { 1 } else { SAMPLES };
            let numbers: Vec<f64> = (0..=in_cell * cells[e]).map(|k| k as f64 / in_cell as f64).collect();
            let spacing: Vec<f64> = numbers.iter().map(|k| spacing_at(*k)).collect();
            let is_lattice = |h: f64| self.is_fine(h) && h > 0.98 * self.dx;
            let mut on: Vec<(f64, f64)> = match spacing.iter().all(|h| is_lattice(*h)) {
                true => (0..cells[e]).map(|k| (k as f64, self.dx)).collect(),
                false => {
                    let lengths = vec![step / in_cell as f64; numbers.len()];
                    let found = spread(&numbers, &lengths, &spacing, false, 0.0, 1.0);
                    found.into_iter().map(|(k, _, h)| (k, h)).collect()
                }
            };
            // Corners of the box belong to the sides along x.
            match (periodic[e], d) {
                (true, _) => {}
                (false, 1) => on.push((all, spacing[spacing.len() - 1])),
                (false, _) => drop(on.remove(0)),
            }
            let is_wall = |k: f64| {
                let p = place(k);
                self.is_in_wall(polygons, [p[0] + inner * normal[0], p[1] + inner * normal[1]], None).is_some()
            };
            on.retain(|&(k, _)| {
                let is_end = !periodic[e] && (k == 0.0 || k == all);
                let near_wall = surface.iter().any(|(point, there, own)| {
                    point.on.is_some() && self.plane.distance(*there, place(k)) < 0.5 * own.min(self.dx)
                });
                !near_wall && (is_end || !is_wall(k))
            });
            // Half of the way to both neighbours; where there is a wall in between all of the way to it, as without a corner.
            let until = |from: f64, to: f64, share: f64| {
                let at = |step: usize| from + (to - from) * step as f64 / BETWEEN as f64;
                match (1..BETWEEN).find(|&step| is_wall(at(step))) {
                    Some(step) => end_of(at(step - 1), at(step), &|k| !is_wall(k)),
                    None => from + share * (to - from),
                }
            };
            for (n, &(k, h)) in on.iter().enumerate() {
                let p = place(k);
                let [first, last] = [on[0].0, on[on.len() - 1].0];
                let before = match n {
                    0 if periodic[e] => until(k, last - all, 0.5),
                    0 => until(k, 0.0, 1.0),
                    _ => until(k, on[n - 1].0, 0.5),
                };
                let after = match on.get(n + 1) {
                    Some(&(next, _)) => until(k, next, 0.5),
                    None if periodic[e] => until(k, first + all, 0.5),
                    None => until(k, all, 1.0),
                };
                let point = BoundaryPoint {
                    particle: 0,
                    on: None,
                    weight: step * (after - before),
                    normal,
                    side: Some(2 * d + end),
                };
                surface.push((point, p, h));
            }
        }
    }

    /// The points of sides that follow ends of outlines.
    fn on_sides(&self, places: &Places) -> Vec<OnSide> {
        let on_side = |side: usize, p: [f64; 2]| self.plane.wrapped(p)[1 - side / 2];
        let ends = places.stretches.iter().enumerate().flat_map(|(k, stretch)| {
            let of = move |end: usize| {
                let End { place, footing, .. } = stretch.ends[end];
                let Footing::Side(side) = footing else { return None };
                Some((side, Mark { at: on_side(side, place), end: Some((k, end)) }))
            };
            [0, 1].into_iter().filter_map(of)
        });
        let mut marks: Vec<(usize, Mark)> = ends.collect();
        if marks.is_empty() {
            return vec![];
        }
        let on = places.boundary.iter().enumerate().filter_map(|(k, point)| Some((k, point.side?, point)));
        let points: Vec<_> =
            on.clone().map(|(k, side, point)| (k, side, on_side(side, places.place[point.particle]))).collect();
        let behind = on.map(|(_, _, point)| {
            behind(&self.plane, self.dx, &places.polygons, places.place[point.particle], point.normal)
        });
        // What holds on a side may change where a shape behind it ends, which stays there.
        for (pair, is_behind) in points.windows(2).zip(behind.collect::<Vec<_>>().windows(2)) {
            if pair[0].1 == pair[1].1 && is_behind[0] != is_behind[1] {
                marks.push((pair[0].1, Mark { at: 0.5 * (pair[0].2 + pair[1].2), end: None }));
            }
        }
        sliding::beside(&self.plane, &points, &marks)
    }

    /// Spreads particles that `moves` names by repulsion.
    fn relax(&self, places: &mut Places, moves: &[bool]) {
        let movers: Vec<usize> = (0..places.inside).filter(|&i| moves[i]).collect();
        for _ in 0..RELAXATIONS {
            let near = Nearest::new(self.plane, self.dx, &places.place);
            let shifts: Vec<[f64; 2]> = movers
                .iter()
                .map(|&i| {
                    let (p, h) = (places.place[i], places.spacing[i]);
                    let mut shift = [0.0; 2];
                    for (distance, j) in near.of(p, 12, |_, distance| distance > 0.0) {
                        let reach = 0.8 * (h + places.spacing[j as usize]);
                        if distance < reach {
                            let away = self.plane.between(places.place[j as usize], p);
                            let strength = 0.25 * h * (1.0 - distance / reach).powi(2) / distance;
                            (0..2).for_each(|d| shift[d] += strength * away[d]);
                        }
                    }
                    shift
                })
                .collect();
            for (&i, shift) in movers.iter().zip(&shifts) {
                let p = places.place[i];
                let to = [p[0] + shift[0], p[1] + shift[1]];
                if self.depth(to) >= self.depth(p).min(OFF_SIDES * places.spacing[i]) {
                    places.place[i] = self.plane.wrapped(to);
                }
            }
        }
    }

    /// A body's surface point so near to another wall that no particle is between them.
    fn narrow(&self, places: &Places) -> Option<Unplaceable> {
        let walls: Vec<[f64; 2]> = places.boundary.iter().map(|b| places.place[b.particle]).collect();
        let near = Nearest::new(self.plane, self.dx, &walls);
        for (k, point) in places.boundary.iter().enumerate() {
            let Some((shape, _)) = point.on else { continue };
            if !places.bodies.contains(&shape) {
                continue;
            }
            let h = places.spacing[point.particle];
            let other = |i: usize| places.boundary[i].on.map(|on| on.0) != Some(shape);
            if let Some(&(width, _)) = near.of(walls[k], 1, |i, distance| other(i) || distance > 4.0 * h).first() {
                if width < 2.5 * h {
                    return Some(Unplaceable::Narrow { shape, width });
                }
            }
        }
        None
    }
}

/// Lengths of the steps between samples, the last one to the first.
pub(super) fn lengths(points: &[OnOutline<f64>]) -> Vec<f64> {
    let n = points.len();
    let step = |k: usize| {
        let (a, b) = (points[k].place, points[(k + 1) % n].place);
        (b[0] - a[0]).hypot(b[1] - a[1])
    };
    (0..n).map(step).collect()
}

/// The last parameter from `inside` towards `outside` for which `may` holds.
fn end_of(inside: f64, outside: f64, may: &impl Fn(f64) -> bool) -> f64 {
    let (mut good, mut bad) = (inside, outside);
    for _ in 0..48 {
        let middle = 0.5 * (good + bad);
        if may(middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

/// Ranges of samples that are true, on a closed line; a range may go on behind its end.
fn stretches(free: &[bool]) -> Vec<(usize, usize)> {
    let n = free.len();
    let Some(first) = (0..n).find(|&k| free[k] && !free[(k + n - 1) % n]) else { return vec![(0, n)] };
    let mut found = vec![];
    let mut k = first;
    while k < first + n {
        let from = k;
        while k < first + n && free[k % n] {
            k += 1;
        }
        if k > from + 1 {
            found.push((from, k));
        }
        while k < first + n && !free[k % n] {
            k += 1;
        }
    }
    found
}

/// Points along a line whose samples are `lengths` apart, each about `spacing` from the next: parameter, its change per
/// point, and the spacing there. `period`: of the parameter, on a closed line.
pub(super) fn spread(
    parameters: &[f64],
    lengths: &[f64],
    spacing: &[f64],
    closed: bool,
    offset: f64,
    period: f64,
) -> Vec<(f64, f64, f64)> {
    let n = parameters.len();
    let steps = if closed { n } else { n - 1 };
    // Number of spacings up to each sample.
    let mut number = vec![0.0];
    for k in 0..steps {
        let h = 0.5 * (spacing[k] + spacing[(k + 1) % n]);
        number.push(number[k] + lengths[k] / h);
    }
    let total = number[steps];
    let count = (total.round() as usize).max(1);
    let each = total / count as f64;
    let mut found = vec![];
    let mut k = 0;
    for i in 0..count {
        let wanted = (i as f64 + offset) * each;
        while k + 1 < steps && number[k + 1] <= wanted {
            k += 1;
        }
        let width = number[k + 1] - number[k];
        let share = if width > 0.0 { (wanted - number[k]) / width } else { 0.0 };
        let next = if k + 1 < n { parameters[k + 1] } else { parameters[0] + period };
        let step = next - parameters[k];
        let h = spacing[k] + share * (spacing[(k + 1) % n] - spacing[k]);
        found.push((parameters[k] + share * step, step / width * each, h * each));
    }
    found
}

/// Places that are added one by one, by cells.
pub(super) struct Growing<const D: usize = 2> {
    cells: Cells<D>,
    members: Vec<Vec<[f64; D]>>,
}

impl<const D: usize> Growing<D> {
    pub fn new(plane: Region<D>, width: f64) -> Self {
        let cells = Cells::new(plane, width);
        Self { cells, members: vec![vec![]; cells.count()] }
    }

    pub fn add(&mut self, p: [f64; D]) {
        self.members[self.cells.of(p)].push(p);
    }

    /// Whether a place is within a distance of at most the cells' width.
    pub fn has_within(&self, p: [f64; D], distance: f64) -> bool {
        let centre = self.cells.index(p);
        let step = |k: usize, d: usize| (k / 3usize.pow(d as u32) % 3) as i64 - 1;
        let around = (0..3usize.pow(D as u32)).map(|k| std::array::from_fn(|d| centre[d] + step(k, d)));
        let members = around.filter_map(|index| self.cells.at(index)).flat_map(|cell| &self.members[cell]);
        members.into_iter().any(|q| self.cells.plane.distance(p, *q) < distance)
    }
}
