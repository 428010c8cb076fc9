//! Closed surfaces of triangles: distance from them, and even points on them.
//!
//! All is in the lengths of the file, with the centre of the volume at 0. The nearest triangle is found by a tree of boxes. Whether a
//! place is inside says the normal at the nearest point: that of a triangle; of an edge the sum of both triangles'; of a corner the
//! sum of all, weighted by their angles there (Baerentzen and Aanaes 2005).
//!
//! Edges along which normals turn by more than `SHARP` divide the surface into patches. Points are spread on each patch alone, so that
//! those beside a sharp edge are half a spacing from it and have the normal of their side, as on a box. Where a surface goes through sides of
//! the region, its triangles are cut there, and points are spread on what is left.

use super::super::nearest::{Nearest, Region};
use super::super::placing::Growing;
use crate::io::stl::{cross, dot, minus, Triangles};
use std::collections::HashMap;

/// Radians.
const SHARP: f64 = 0.7;
/// Edges of samples, in spacings of points.
const SAMPLE: f64 = 0.25;
/// No triangle is divided into more than the square of this.
const MOST: usize = 256;
/// First points keep this distance, in spacings; then about as many fit as the spacing asks for.
const APART: f64 = 0.8;
/// Steps towards the middle of the samples nearest to each point (Lloyd 1982).
const STEPS: usize = 8;
/// Points on a surface have this distance from sides of the region on which it stands, in spacings; what is nearer belongs to the next one. (Where a
/// surface meets a side at a small angle, points of both face each other with no particle in between, and flows are not found.)
pub const BESIDE: f64 = 0.35;
/// Triangles in a leaf of the tree.
const LEAF: usize = 4;

/// A point that stands for the surface around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facet {
    pub place: [f64; 3],
    /// Normal times area.
    pub area: [f64; 3],
}

/// Places x with normal . x >= at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalfSpace {
    pub normal: [f64; 3],
    pub at: f64,
}

impl HalfSpace {
    /// How far a place is in it.
    fn depth(&self, p: [f64; 3]) -> f64 {
        dot(self.normal, p) - self.at
    }

    /// What of a convex polygon is in it (Sutherland and Hodgman 1974).
    fn part_of(&self, polygon: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut kept = vec![];
        for (k, &p) in polygon.iter().enumerate() {
            let q = polygon[(k + 1) % polygon.len()];
            let (of_p, of_q) = (self.depth(p), self.depth(q));
            if of_p >= 0.0 {
                kept.push(p);
            }
            if (of_p >= 0.0) != (of_q >= 0.0) {
                kept.push(plus(p, times(minus(q, p), of_p / (of_p - of_q))));
            }
        }
        kept
    }
}

#[derive(Debug)]
struct Node {
    low: [f64; 3],
    high: [f64; 3],
    /// Triangles, as places in the order; of inner nodes the first is empty and these are the children.
    own: std::ops::Range<usize>,
    children: Option<[usize; 2]>,
}

/// A closed surface that can be asked for distances.
#[derive(Debug)]
pub struct Facets {
    mesh: Triangles,
    /// Where the file has the centre of the volume.
    pub centre: [f64; 3],
    pub volume: f64,
    /// Half of the shortest edge of the surface's box.
    pub half_width: f64,
    low: [f64; 3],
    high: [f64; 3],
    /// Unit normals of triangles.
    normal: Vec<[f64; 3]>,
    /// Directions outwards at the edges (a to b, b to c, c to a) of triangles, and at vertices.
    at_edge: Vec<[[f64; 3]; 3]>,
    at_vertex: Vec<[f64; 3]>,
    patch: Vec<usize>,
    nodes: Vec<Node>,
    order: Vec<usize>,
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| a[d] + b[d])
}

fn times(a: [f64; 3], x: f64) -> [f64; 3] {
    a.map(|a| a * x)
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// The lower and the upper corner of the box around some places.
fn corners(all: impl Iterator<Item = [f64; 3]> + Clone) -> [[f64; 3]; 2] {
    let end = |of: fn(f64, f64) -> f64, d: usize| all.clone().map(|v| v[d]).reduce(of).unwrap_or(0.0);
    [std::array::from_fn(|d| end(f64::min, d)), std::array::from_fn(|d| end(f64::max, d))]
}

/// What of a triangle is nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Feature {
    Face,
    Edge(usize),
    Corner(usize),
}

/// The nearest point of a triangle (Ericson 2005, section 5.1.5).
fn nearest_on([a, b, c]: [[f64; 3]; 3], p: [f64; 3]) -> ([f64; 3], Feature) {
    let (ab, ac) = (minus(b, a), minus(c, a));
    let to = |corner: [f64; 3]| {
        let r = minus(p, corner);
        (dot(ab, r), dot(ac, r))
    };
    let (d1, d2) = to(a);
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, Feature::Corner(0));
    }
    let (d3, d4) = to(b);
    if d3 >= 0.0 && d4 <= d3 {
        return (b, Feature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (plus(a, times(ab, d1 / (d1 - d3))), Feature::Edge(0));
    }
    let (d5, d6) = to(c);
    if d6 >= 0.0 && d5 <= d6 {
        return (c, Feature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (plus(a, times(ac, d2 / (d2 - d6))), Feature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let part = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (plus(b, times(minus(c, b), part)), Feature::Edge(1));
    }
    let whole = va + vb + vc;
    (plus(a, plus(times(ab, vb / whole), times(ac, vc / whole))), Feature::Face)
}

impl Facets {
    pub fn new(mut mesh: Triangles) -> Self {
        let (volume, centre) = mesh.volume();
        mesh.vertices.iter_mut().for_each(|v| *v = minus(*v, centre));
        let count = mesh.triangles.len();
        let normal: Vec<[f64; 3]> = (0..count)
            .map(|k| {
                let area = mesh.area(k);
                times(area, 1.0 / length(area))
            })
            .collect();
        let mut at_vertex = vec![[0.0; 3]; mesh.vertices.len()];
        let mut of_edge: HashMap<(u32, u32), usize> = HashMap::new();
        for (k, triangle) in mesh.triangles.iter().enumerate() {
            let corners = mesh.corners(k);
            for e in 0..3 {
                of_edge.insert((triangle[e], triangle[(e + 1) % 3]), k);
                let (one, other) = (minus(corners[(e + 1) % 3], corners[e]), minus(corners[(e + 2) % 3], corners[e]));
                let angle = length(cross(one, other)).atan2(dot(one, other));
                let at = &mut at_vertex[triangle[e] as usize];
                *at = plus(*at, times(normal[k], angle));
            }
        }
        // Of a closed surface each edge has a triangle on its other side.
        let across = |k: usize, e: usize| {
            let triangle = mesh.triangles[k];
            of_edge.get(&(triangle[(e + 1) % 3], triangle[e])).copied().unwrap_or(k)
        };
        let at_edge = (0..count).map(|k| std::array::from_fn(|e| plus(normal[k], normal[across(k, e)]))).collect();
        let mut patch = vec![usize::MAX; count];
        let mut patches = 0;
        for first in 0..count {
            if patch[first] != usize::MAX {
                continue;
            }
            patch[first] = patches;
            let mut waiting = vec![first];
            while let Some(k) = waiting.pop() {
                for e in 0..3 {
                    let other = across(k, e);
                    if patch[other] == usize::MAX && dot(normal[k], normal[other]) > SHARP.cos() {
                        patch[other] = patches;
                        waiting.push(other);
                    }
                }
            }
            patches += 1;
        }
        let [low, high] = corners(mesh.vertices.iter().copied());
        let half_width = (0..3).map(|d| 0.5 * (high[d] - low[d])).fold(f64::MAX, f64::min);
        let order = (0..count).collect();
        let mut all = Self {
            mesh,
            centre,
            volume,
            half_width,
            low,
            high,
            normal,
            at_edge,
            at_vertex,
            patch,
            nodes: vec![],
            order,
        };
        all.divide(0..count);
        all
    }

    /// Adds the node of some triangles and those below it. Returns its number.
    fn divide(&mut self, own: std::ops::Range<usize>) -> usize {
        let corners = |k: &usize| self.mesh.corners(*k);
        let all = || self.order[own.clone()].iter().flat_map(corners);
        let low: [f64; 3] = std::array::from_fn(|d| all().map(|p| p[d]).fold(f64::INFINITY, f64::min));
        let high: [f64; 3] = std::array::from_fn(|d| all().map(|p| p[d]).fold(f64::NEG_INFINITY, f64::max));
        let number = self.nodes.len();
        self.nodes.push(Node { low, high, own: own.clone(), children: None });
        if own.len() > LEAF {
            let along = (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0);
            let mesh = &self.mesh;
            let middle = |k: &usize| mesh.corners(*k).iter().map(|p| p[along]).sum::<f64>();
            self.order[own.clone()].sort_by(|a, b| middle(a).total_cmp(&middle(b)));
            let half = own.start + own.len() / 2;
            let children = [self.divide(own.start..half), self.divide(half..own.end)];
            self.nodes[number].children = Some(children);
        }
        number
    }

    /// The square of the distance from a node's box.
    fn beyond(&self, node: usize, p: [f64; 3]) -> f64 {
        let Node { low, high, .. } = &self.nodes[node];
        (0..3).map(|d| (low[d] - p[d]).max(p[d] - high[d]).max(0.0).powi(2)).sum()
    }

    /// The nearest point of the surface, its triangle and what of that it is.
    fn nearest(&self, p: [f64; 3]) -> ([f64; 3], usize, Feature) {
        let (mut least, mut found) = (f64::INFINITY, (p, 0, Feature::Face));
        let mut waiting = vec![(self.beyond(0, p), 0)];
        while let Some((beyond, number)) = waiting.pop() {
            if beyond >= least {
                continue;
            }
            let node = &self.nodes[number];
            match node.children {
                Some(children) => {
                    let [one, other] = children.map(|child| (self.beyond(child, p), child));
                    // The nearer one is looked at first.
                    let (first, last) = if one.0 < other.0 { (one, other) } else { (other, one) };
                    waiting.extend([last, first]);
                }
                None => {
                    for &k in &self.order[node.own.clone()] {
                        let (place, feature) = nearest_on(self.mesh.corners(k), p);
                        let r = minus(p, place);
                        if dot(r, r) < least {
                            (least, found) = (dot(r, r), (place, k, feature));
                        }
                    }
                }
            }
        }
        found
    }

    /// The distance of a place from the surface, negative inside.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        let (place, k, feature) = self.nearest(p);
        let outwards = match feature {
            Feature::Face => self.normal[k],
            Feature::Edge(e) => self.at_edge[k][e],
            Feature::Corner(corner) => self.at_vertex[self.mesh.triangles[k][corner] as usize],
        };
        let r = minus(p, place);
        length(r).copysign(dot(r, outwards))
    }

    /// The lower and the upper corner of the surface, turned.
    pub fn corners(&self, turned: impl Fn([f64; 3]) -> [f64; 3]) -> [[f64; 3]; 2] {
        corners(self.mesh.vertices.iter().map(|v| turned(*v)))
    }

    /// Points about `spacing` apart where the surface is moved outwards by a distance, and is then within all of some half spaces; their
    /// places are those on the surface itself.
    pub fn spread(&self, spacing: f64, distance: f64, within: &[HalfSpace]) -> Vec<Facet> {
        let patches = self.patch.iter().max().map_or(0, |last| last + 1);
        // Place, area and place moved outwards of samples, by patch.
        let mut samples: Vec<Vec<(Facet, [f64; 3])>> = vec![vec![]; patches];
        for (k, &patch) in self.patch.iter().enumerate() {
            let (normal, mut rest) = (self.normal[k], self.mesh.corners(k).to_vec());
            for half in within {
                let at = half.at - distance * dot(half.normal, normal);
                rest = HalfSpace { at, ..*half }.part_of(&rest);
            }
            for corner in 2..rest.len() {
                let [a, b, c] = [rest[0], rest[corner - 1], rest[corner]];
                let longest = [minus(b, a), minus(c, b), minus(a, c)].map(length).into_iter().fold(0.0, f64::max);
                let n = ((longest / (SAMPLE * spacing)).ceil() as usize).clamp(1, MOST);
                let area = times(times(cross(minus(b, a), minus(c, a)), 0.5), 1.0 / (n * n) as f64);
                let share = 1.0 / (3 * n) as f64;
                let mut add = |i: usize, j: usize, up: usize| {
                    // The middle of the small triangle at (i, j), which points up or down.
                    let (u, v) = ((3 * i + up) as f64 * share, (3 * j + up) as f64 * share);
                    let place = plus(a, plus(times(minus(b, a), u), times(minus(c, a), v)));
                    samples[patch].push((Facet { place, area }, plus(place, times(normal, distance))));
                };
                for i in 0..n {
                    for j in 0..n - i {
                        add(i, j, 1);
                        if i + j + 1 < n {
                            add(i, j, 2);
                        }
                    }
                }
            }
        }
        let is_there = |samples: &&Vec<(Facet, [f64; 3])>| !samples.is_empty();
        let beside =
            |facet: &Facet| distance == 0.0 && within.iter().any(|half| half.depth(facet.place) < BESIDE * spacing);
        let of_patch = |samples: &Vec<(Facet, [f64; 3])>| {
            let points = self.spread_on(samples, spacing, distance).into_iter();
            let (left, mut kept): (Vec<Facet>, Vec<Facet>) = points.partition(beside);
            for Facet { place, area } in left {
                let from = |facet: &Facet| length(minus(facet.place, place));
                if let Some(next) = kept.iter_mut().min_by(|a, b| from(a).total_cmp(&from(b))) {
                    next.area = plus(next.area, area);
                }
            }
            kept
        };
        samples.iter().filter(is_there).flat_map(of_patch).collect()
    }

    /// The points of a patch, given its samples.
    fn spread_on(&self, samples: &[(Facet, [f64; 3])], spacing: f64, distance: f64) -> Vec<Facet> {
        // A box around all, with its corner at 0.
        let margin = distance + spacing;
        let corner = self.low.map(|x| x - margin);
        let size = std::array::from_fn(|d| self.high[d] - self.low[d] + 2.0 * margin);
        let region = Region { size, periodic: [false; 3] };
        let moved: Vec<[f64; 3]> = samples.iter().map(|(_, moved)| minus(*moved, corner)).collect();
        // In steps of the golden section, so that first points are everywhere.
        let count = samples.len();
        let mut step = ((0.618_034 * count as f64) as usize).max(1);
        while step > 1 && (2..=step).any(|d| step.is_multiple_of(d) && count.is_multiple_of(d)) {
            step -= 1;
        }
        let mut taken = Growing::new(region, spacing);
        let mut points: Vec<[f64; 3]> = vec![];
        for k in 0..count {
            let p = moved[k * step % count];
            if !taken.has_within(p, APART * spacing) {
                taken.add(p);
                points.push(p);
            }
        }
        let mut own = vec![0; count];
        for round in 0..=STEPS {
            let near = Nearest::new(region, spacing, &points);
            let mut sums = vec![([0.0; 3], 0.0); points.len()];
            for (k, p) in moved.iter().enumerate() {
                own[k] = near.one(*p, f64::INFINITY).map_or(0, |found| found.1);
                let weight = length(samples[k].0.area);
                let sum = &mut sums[own[k]];
                *sum = (plus(sum.0, times(*p, weight)), sum.1 + weight);
            }
            if round < STEPS {
                let middle = |((sum, weight), before): (&([f64; 3], f64), &[f64; 3])| match *weight > 0.0 {
                    true => times(*sum, 1.0 / weight),
                    false => *before,
                };
                points = sums.iter().zip(&points).map(middle).collect();
            }
        }
        let mut found = vec![(Facet { place: [0.0; 3], area: [0.0; 3] }, 0.0); points.len()];
        for ((sample, _), &own) in samples.iter().zip(&own) {
            let (to, weight) = &mut found[own];
            let size = length(sample.area);
            to.place = plus(to.place, times(sample.place, size));
            to.area = plus(to.area, sample.area);
            *weight += size;
        }
        // The middle of a part of a curved surface is inside of it.
        let onto = |(facet, weight): (Facet, f64)| {
            let (place, ..) = self.nearest(times(facet.place, 1.0 / weight));
            Facet { place, area: facet.area }
        };
        found.into_iter().filter(|(facet, weight)| *weight > 0.0 && length(facet.area) > 0.0).map(onto).collect()
    }
}
