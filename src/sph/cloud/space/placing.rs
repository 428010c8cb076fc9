//! Places of fixed particles in space: on surfaces and sides of the box, in layers around bodies, and on a lattice.
//!
//! As in the plane ([`super::super::placing`]): the spacing is h0 on a surface and grows by a quarter of the distance to dx; layers
//! follow the surface at distances of 0.95 h; where h has reached dx a lattice goes on. Gaps that layers leave (at edges of boxes, between
//! bodies) are filled from a fine lattice, and steps of repulsion spread the points near bodies evenly.

use super::super::nearest::{Nearest, Region};
use super::super::placing::{Growing, Unplaceable, GROWTH};
use super::surface::{Spot, Surface};

/// What a cloud is made of: surfaces of bodies in a box.
#[derive(Debug)]
pub struct Ground {
    pub region: Region<3>,
    pub dx: f64,
    /// Spacing on surfaces.
    pub surface: f64,
    pub surfaces: Vec<Surface>,
}

/// A particle on the boundary: on a shape, or on sides of the box (2 d + (0 low, 1 high)), of which an edge has two.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundaryPoint {
    pub on: Option<(usize, Spot)>,
    pub sides: Vec<usize>,
    /// Unit normal into the fluid; of the first side.
    pub normal: [f64; 3],
}

/// A part of a side of the box: the particle on the boundary that stands for it, and its area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tile {
    pub point: usize,
    pub side: usize,
    pub area: f64,
}

/// Fixed particles: those inside first, then those on the boundary.
#[derive(Debug, Clone)]
pub struct Places {
    pub place: Vec<[f64; 3]>,
    pub spacing: Vec<f64>,
    pub inside: usize,
    pub boundary: Vec<BoundaryPoint>,
    pub tiles: Vec<Tile>,
}

const RELAXATIONS: usize = 20;
/// Steps of repulsion between searches for neighbours.
const LISTS: usize = 5;
const REPELLING: usize = 24;

/// Unit normal into the fluid of a side.
pub(super) fn inward(side: usize) -> [f64; 3] {
    let mut normal = [0.0; 3];
    normal[side / 2] = if side.is_multiple_of(2) { 1.0 } else { -1.0 };
    normal
}

impl Ground {
    /// Lattice spacings along each direction.
    pub fn cells(&self) -> [usize; 3] {
        self.region.size.map(|size| ((size / self.dx).round() as usize).max(1))
    }

    /// The spacing at a distance from surfaces.
    fn spacing(&self, distance: f64) -> f64 {
        (self.surface + GROWTH * distance).clamp(self.surface, self.dx)
    }

    /// The distance from the nearest surface, negative inside of one; that of `except` is left out.
    pub fn distance(&self, p: [f64; 3], except: Option<usize>) -> f64 {
        let of = |(k, surface): (usize, &Surface)| match Some(k) == except {
            true => f64::INFINITY,
            false => surface.distance(&self.region, p),
        };
        self.surfaces.iter().enumerate().map(of).fold(f64::INFINITY, f64::min)
    }

    /// How far a place is from sides of the region on which a shape does not stand.
    pub fn to_sides(&self, shape: usize, p: [f64; 3]) -> f64 {
        let (Region { size, periodic }, surface) = (&self.region, &self.surfaces[shape]);
        let to = |side: usize| if side.is_multiple_of(2) { p[side / 2] } else { size[side / 2] - p[side / 2] };
        let counts = |side: &usize| !periodic[side / 2] && !surface.stands_on(*side);
        (0..6).filter(counts).map(to).fold(f64::INFINITY, f64::min)
    }

    fn is_in_box(&self, p: [f64; 3], margin: f64) -> bool {
        let Region { size, periodic } = self.region;
        (0..3).all(|d| periodic[d] || (p[d] > margin && p[d] < size[d] - margin))
    }

    /// The distances of layers from a surface.
    fn layers(&self) -> Vec<f64> {
        let (mut found, mut distance) = (vec![], 0.95 * self.surface);
        while self.spacing(distance) < 0.999 * self.dx {
            found.push(distance);
            distance += 0.95 * self.spacing(distance);
        }
        found.push(distance);
        found
    }

    /// Fills the fluid with particles.
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn fill(&self) -> Result<Places, Unplaceable> {
        let Self { region, dx, surface: h0, .. } = self;
        let (region, dx, h0) = (*region, *dx, *h0);
        for (shape, surface) in self.surfaces.iter().enumerate() {
            if surface.size() <= 0.0 || surface.is_larger(&region) {
                return Err(Unplaceable::Narrow { shape, width: 0.0 });
            }
            if surface.size() < h0 {
                return Err(Unplaceable::Thin { shape, width: 2.0 * surface.size() });
            }
        }
        // A few points tell that a shape (other than a box) is larger than the region, such as one in other units, which would have any number
        // of points.
        for (shape, surface) in self.surfaces.iter().enumerate() {
            let few = surface.spread(&region, h0.max(surface.size()), 0.0);
            let places: Vec<[f64; 3]> = few.iter().map(|spot| surface.at(spot, &surface.numbers).place).collect();
            let extent = |d: usize| {
                let bounds = |[low, high]: [f64; 2], p: &[f64; 3]| [low.min(p[d]), high.max(p[d])];
                let [low, high] = places.iter().fold([f64::INFINITY, f64::NEG_INFINITY], bounds);
                high - low
            };
            let is_out = places.is_empty() || places.iter().any(|p| !self.is_in_box(*p, 0.0));
            if is_out || (0..3).any(|d| extent(d) > region.size[d]) {
                return Err(Unplaceable::Narrow { shape, width: 0.0 });
            }
        }
        let mut boundary: Vec<BoundaryPoint> = vec![];
        // Place and spacing of points on the boundary, and inside.
        let mut walls: Vec<([f64; 3], f64)> = vec![];
        let mut kept: Vec<([f64; 3], f64)> = vec![];
        let mut cells = Growing::new(region, dx);
        for (shape, surface) in self.surfaces.iter().enumerate() {
            let (mut width, mut to_sides) = (f64::INFINITY, f64::INFINITY);
            for spot in surface.spread(&region, h0, 0.0) {
                let on = surface.at(&spot, &surface.numbers);
                let is_out = !self.is_in_box(on.place, 0.0);
                to_sides = to_sides.min(self.to_sides(shape, on.place));
                width = width.min(if is_out { 0.0 } else { self.distance(on.place, Some(shape)).max(0.0) });
                let length = on.area.iter().map(|x| x * x).sum::<f64>().sqrt();
                let normal = on.area.map(|x| x / length);
                boundary.push(BoundaryPoint { on: Some((shape, spot)), sides: vec![], normal });
                // A surface stays whole where a period cuts it: arms of torques and formulas of x, y, z need its own places.
                cells.add(on.place);
                walls.push((on.place, h0));
            }
            if width < 2.0 * h0 {
                return Err(Unplaceable::Narrow { shape, width });
            }
            if to_sides < h0 {
                return Err(Unplaceable::Narrow { shape, width: to_sides });
            }
        }
        let tiles = self.sides(&mut boundary, &mut walls, &mut cells);
        let layers = self.layers();
        let reach = if self.surfaces.is_empty() { 0.0 } else { layers[layers.len() - 1] };
        for (shape, surface) in self.surfaces.iter().enumerate() {
            for &distance in &layers {
                let h = self.spacing(distance);
                for spot in surface.spread(&region, h, distance) {
                    let on = surface.at(&spot, &surface.numbers);
                    let length = on.area.iter().map(|x| x * x).sum::<f64>().sqrt();
                    let p = region.wrapped(std::array::from_fn(|d| on.place[d] + distance * on.area[d] / length));
                    let own = surface.distance(&region, p) > 0.9 * distance;
                    if own
                        && self.is_in_box(p, 0.6 * h)
                        && self.distance(p, Some(shape)) > 0.7 * distance
                        && !cells.has_within(p, 0.6 * h)
                    {
                        cells.add(p);
                        kept.push((p, h));
                    }
                }
            }
        }
        let first_of_lattice = kept.len();
        for p in self.lattice(dx) {
            let distance = self.distance(p, None);
            if distance > reach + 0.5 * dx || (distance > 0.75 * self.spacing(distance) && distance > reach - 0.5 * dx)
            {
                let near_wall = !self.is_in_box(p, 0.5 * dx);
                if !near_wall && !cells.has_within(p, 0.75 * dx) {
                    cells.add(p);
                    kept.push((p, dx));
                }
            }
        }
        let lattice = first_of_lattice..kept.len();
        if reach > 0.0 {
            for p in self.lattice(0.7 * h0) {
                let distance = self.distance(p, None);
                let h = self.spacing(distance);
                if distance > 0.7 * h
                    && distance < reach + dx
                    && self.is_in_box(p, 0.7 * h)
                    && !cells.has_within(p, 0.9 * h)
                {
                    cells.add(p);
                    kept.push((p, h));
                }
            }
        }
        if kept.len() < 20 {
            return Err(Unplaceable::Full);
        }
        let inside = kept.len();
        let all: Vec<([f64; 3], f64)> = kept.into_iter().chain(walls).collect();
        let mut places = Places {
            place: all.iter().map(|(p, _)| *p).collect(),
            spacing: all.iter().map(|(_, h)| *h).collect(),
            inside,
            boundary,
            tiles,
        };
        let moves = |i: usize| !lattice.contains(&i) || self.distance(places.place[i], None) < reach + 1.5 * dx;
        let movers: Vec<usize> = if reach > 0.0 { (0..inside).filter(|&i| moves(i)).collect() } else { vec![] };
        self.relax(&mut places, &movers);
        Ok(places)
    }

    /// Points of a lattice of about a spacing that are inside of the box.
    fn lattice(&self, spacing: f64) -> impl Iterator<Item = [f64; 3]> {
        let Region { size, periodic } = self.region;
        let counts = size.map(|size| ((size / spacing).round() as usize).max(1));
        let own = |d: usize| if periodic[d] { counts[d] } else { counts[d] - 1 };
        let (m, n) = (own(1), own(2));
        let place =
            move |d: usize, k: usize| size[d] * (k as f64 + if periodic[d] { 0.0 } else { 1.0 }) / counts[d] as f64;
        (0..own(0) * m * n).map(move |k| [place(0, k / (m * n)), place(1, k / n % m), place(2, k % n)])
    }

    /// Points on the sides of the box: those of the lattice, and finer ones around shapes that stand on a side.
    fn sides(
        &self,
        boundary: &mut Vec<BoundaryPoint>,
        walls: &mut Vec<([f64; 3], f64)>,
        cells: &mut Growing<3>,
    ) -> Vec<Tile> {
        let Region { size, periodic } = self.region;
        let counts = self.cells();
        let mut tiles = vec![];
        let mut known: std::collections::HashMap<[usize; 3], usize> = std::collections::HashMap::new();
        for side in (0..6).filter(|side| !periodic[side / 2]) {
            let along = side / 2;
            let [a, b] = super::surface::across(along);
            let ends = |d: usize| if periodic[d] { counts[d] } else { counts[d] + 1 };
            let step = |d: usize| size[d] / counts[d] as f64;
            let level = if side % 2 == 0 { 0 } else { counts[along] };
            // Points of this side, as places in the boundary.
            let mut own: Vec<usize> = vec![];
            for k in 0..ends(a) * ends(b) {
                let mut index = [0; 3];
                (index[along], index[a], index[b]) = (level, k / ends(b), k % ends(b));
                let place: [f64; 3] = std::array::from_fn(|d| index[d] as f64 * step(d));
                let distance = self.distance(place, None);
                if distance < 0.6 * self.spacing(distance) {
                    continue;
                }
                let point = *known.entry(index).or_insert_with(|| {
                    boundary.push(BoundaryPoint { on: None, sides: vec![], normal: inward(side) });
                    walls.push((place, self.spacing(distance)));
                    cells.add(self.region.wrapped(place));
                    boundary.len() - 1
                });
                boundary[point].sides.push(side);
                own.push(point);
            }
            let is_near = |distance: f64| distance < 4.0 * self.dx;
            let touches = own.iter().any(|&point| is_near(self.distance(walls[point].0, None)));
            if !touches {
                for &point in &own {
                    let p = walls[point].0;
                    let width = |d: usize| {
                        let is_end = !periodic[d] && (p[d] < 0.5 * step(d) || p[d] > size[d] - 0.5 * step(d));
                        if is_end {
                            0.5 * step(d)
                        } else {
                            step(d)
                        }
                    };
                    tiles.push(Tile { point, side, area: width(a) * width(b) });
                }
                continue;
            }
            // Samples of the side: they fill gaps around shapes, and each is of the nearest point's tile.
            let fine = (0.5 * self.surface).min(0.25 * self.dx);
            let count = [a, b].map(|d| (size[d] / fine).ceil() as usize);
            let sample = |k: usize| {
                let mut p = [0.0; 3];
                p[along] = size[along] * (side % 2) as f64;
                p[a] = size[a] * ((k / count[1]) as f64 + 0.5) / count[0] as f64;
                p[b] = size[b] * ((k % count[1]) as f64 + 0.5) / count[1] as f64;
                p
            };
            let samples: Vec<([f64; 3], f64)> = (0..count[0] * count[1])
                .map(sample)
                .map(|p| (p, self.distance(p, None)))
                .filter(|s| s.1 > 0.0)
                .collect();
            for &(p, distance) in samples.iter().filter(|(_, distance)| is_near(*distance)) {
                let h = self.spacing(distance);
                if distance > 0.7 * h && !cells.has_within(self.region.wrapped(p), 0.85 * h) {
                    boundary.push(BoundaryPoint { on: None, sides: vec![side], normal: inward(side) });
                    walls.push((p, h));
                    cells.add(self.region.wrapped(p));
                    own.push(boundary.len() - 1);
                }
            }
            let places: Vec<[f64; 3]> = own.iter().map(|&point| walls[point].0).collect();
            let near = Nearest::new(self.region, self.dx, &places);
            let mut area = vec![0.0; own.len()];
            let each = size[a] * size[b] / (count[0] * count[1]) as f64;
            for (p, _) in &samples {
                if let Some((_, k)) = near.one(*p, f64::INFINITY) {
                    area[k] += each;
                }
            }
            tiles.extend(own.iter().zip(area).map(|(&point, area)| Tile { point, side, area }));
        }
        tiles
    }

    /// Spreads particles by repulsion; none comes nearer to a surface than a part of its spacing.
    fn relax(&self, places: &mut Places, movers: &[usize]) {
        let mut lists: Vec<Vec<(f64, u32)>> = vec![];
        for step in 0..RELAXATIONS {
            if step % LISTS == 0 {
                let near = Nearest::new(self.region, self.dx, &places.place);
                lists = movers.iter().map(|&i| near.of(places.place[i], REPELLING, |j, _| j != i)).collect();
            }
            let shift = |(&i, list): (&usize, &Vec<(f64, u32)>)| {
                let (p, h) = (places.place[i], places.spacing[i]);
                let mut shift = [0.0; 3];
                for &(_, j) in list {
                    let away = self.region.between(places.place[j as usize], p);
                    let distance = away.iter().map(|x| x * x).sum::<f64>().sqrt();
                    let reach = 0.75 * (h + places.spacing[j as usize]);
                    if distance < reach && distance > 0.0 {
                        let strength = 0.2 * h * (1.0 - distance / reach).powi(2) / distance;
                        (0..3).for_each(|d| shift[d] += strength * away[d]);
                    }
                }
                shift
            };
            let shifts: Vec<[f64; 3]> = movers.iter().zip(&lists).map(shift).collect();
            for (&i, shift) in movers.iter().zip(&shifts) {
                let p = places.place[i];
                let to: [f64; 3] = std::array::from_fn(|d| p[d] + shift[d]);
                let h = places.spacing[i];
                if self.is_in_box(to, 0.5 * h) && self.distance(to, None) > 0.5 * h {
                    places.place[i] = self.region.wrapped(to);
                }
            }
        }
    }
}
