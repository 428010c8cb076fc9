//! The heat that shapes with a given temperature give to moving particles in two dimensions.
//!
//! The surface of every shape is cut into pieces of about a spacing. In the middle of each the gradient of the temperature is that of a
//! fit of third order through the wall's temperature there, those of other pieces, and the fluid's particles ([`WallFit`]), so
//!
//! ```text
//!   heat = - sum over pieces of length k n . grad T,   n into the fluid.
//! ```
//!
//! Pieces beside a corner that points into the fluid have the heat of its own [fit](crate::sph::cloud::corner_fit). It does not ask the
//! method, whose own exchange with walls has an error of first order in the spacing beside them.

use super::custom::{shapes, surroundings};
use super::custom_shape::{right_of, Shape};
use crate::adjoint::run::Observer;
use crate::config::custom::{Fill, Kind};
use crate::config::scene::{Config, Method};
use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::sph::cloud::corner_fit::{self, Corner};
use crate::sph::cloud::nearest::{Nearest, Plane};
use crate::sph::cloud::wall_fit::{WallFit, NEIGHBOURS};
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::{Model, Sweeps};
use std::collections::BTreeSet;

/// With the standard method the temperature of the particles nearest to a wall contains the error of the wall condition: beside a wall with
/// a linear temperature they make the flux 1.3 % too large at any spacing. In spacings. (Beside a disc of five spacings, or a box, they are up to
/// 3 % off, and the heat is 16 % too small or 26 % too large: only plane walls along the axes are told.)
const SKIPPED: f64 = 1.0;
/// Neighbours may be this far behind a wall's tangent, in spacings: those are on the other side of a thin wall.
const BEHIND: f64 = 0.5;

/// Edges that turn by more are two surfaces that meet in a corner. Radians.
const SMOOTH: f64 = 0.3;
/// Shorter edges than this do not cut a corner off. In spacings.
const CUT: f64 = 1e-2;

/// The middle of a piece of a surface.
#[derive(Debug, Clone, Copy)]
struct Piece {
    shape: usize,
    place: [f64; 2],
    /// Unit normal into the fluid.
    normal: [f64; 2],
    length: f64,
    /// Relative to the reference temperature.
    temperature: f64,
    /// The corner at one of its ends, if it points into the fluid, and its temperature.
    corner: Option<(Corner, f64)>,
}

/// The surfaces of a configuration's shapes.
#[derive(Debug)]
pub struct ShapeHeat {
    plane: Plane,
    spacing: f64,
    conductivity: f64,
    /// Of each shape 0, or NaN if it has a temperature but its heat is not known.
    without: Vec<f64>,
    /// Fluid nearer to a surface is left out. Length.
    skipped: f64,
    pieces: Vec<Piece>,
}

impl ShapeHeat {
    /// None where no shape with a temperature touches the fluid, and in three dimensions.
    ///
    /// # Errors
    /// Formulas that cannot be read.
    pub fn of_config(config: &Config) -> Result<Option<Self>, BadInput> {
        if config.dimension() != 2 || !config.has_heat() {
            return Ok(None);
        }
        let (region, spacing) = (&config.region, config.resolution.dx);
        let size = [region.size[0], region.size[1]];
        let plane = Plane { size, periodic: [region.periodic[0], region.periodic[1]] };
        let all = shapes(config)?;
        let walls = surroundings(config, &all);
        let reference = config.fluid.inlet_temperature;
        let is_known = |shape: &Shape| shape.on_wall.temperature.is_none() || shape.entry.kind != Kind::Where;
        let mut without: Vec<f64> = all.iter().map(|shape| if is_known(shape) { 0.0 } else { f64::NAN }).collect();
        let is_standard = matches!(config.method, Method::Standard(_));
        let mut pieces = vec![];
        for (k, shape) in all.iter().enumerate() {
            // The wall is behind the outline of a shape, or around one that cuts an opening into walls.
            let is_wall = shape.entry.fill == Fill::Wall;
            let wall_at = |edge: &Edge| {
                let beside = |by: f64| {
                    let ([x, y], [nx, ny]) = (middle(edge), normal(edge));
                    [x + by * spacing * nx, y + by * spacing * ny, 0.0]
                };
                // Where another shape covers the surface, that one's outline counts.
                let wall = walls.shape_at(beside(-1e-2)).filter(|&wall| all[wall].entry.fill == Fill::Wall);
                wall.filter(|&wall| walls.distance(beside(0.25)) > 0.0 && (wall == k) == is_wall)
            };
            let mut outline = shape.outline(&plane);
            if !is_wall {
                outline.reverse();
            }
            let mut runs = runs(edges(&outline, &plane, spacing), wall_at);
            runs.retain(|(_, run)| length(run) > CUT * spacing);
            for (k, (wall, run)) in runs.iter().enumerate() {
                let Some(temperature) = &all[*wall].on_wall.temperature else { continue };
                let at = |[x, y]: [f64; 2]| temperature.at([x, y, 0.0]) - reference;
                let count = runs.len();
                let ends = [[(k + count - 1) % count, k], [k, (k + 1) % count]].map(|[k, next]| {
                    let corner = corner_between(&plane, &runs[k], &runs[next], spacing)?;
                    Some((corner, at(corner.place)))
                });
                let parts = parts(run, spacing, ends.iter().flatten().count().max(1));
                let last = parts.len() - 1;
                for (k, (place, normal, length)) in parts.into_iter().enumerate() {
                    let corner = ends[0].filter(|_| k == 0).or(ends[1].filter(|_| k == last));
                    if is_standard && (corner.is_some() || normal[0].abs().max(normal[1].abs()) < 1.0 - 1e-9) {
                        without[*wall] = f64::NAN;
                    }
                    let place = plane.wrapped(place);
                    pieces.push(Piece { shape: *wall, place, normal, length, temperature: at(place), corner });
                }
            }
        }
        let conductivity = config.fluid.conductivity;
        let skipped = if is_standard { SKIPPED * spacing } else { 0.0 };
        let found = Self { plane, spacing, conductivity, without, skipped, pieces };
        // Where nothing is known that is said, too.
        let has_any = !found.pieces.is_empty() || found.without.iter().any(|heat| heat.is_nan());
        Ok(has_any.then_some(found))
    }

    /// The heat of each shape per time and depth, given places and temperatures (relative to the reference) of fluid; 0 of shapes
    /// without a temperature, NaN of those with one whose outline is not known (`where`), and with the standard method of those that are not
    /// plane. None with too few particles beside a surface.
    pub fn of_fluid(&self, fluid: &[([f64; 2], f64)]) -> Option<Vec<f64>> {
        let (walls, warmth): (Vec<[f64; 2]>, Vec<f64>) =
            self.pieces.iter().map(|piece| (piece.place, piece.temperature)).unzip();
        let surface = Nearest::new(self.plane, self.spacing, &walls);
        let counts = |place: [f64; 2]| self.skipped == 0.0 || surface.one(place, self.skipped).is_none();
        let fluid = fluid.iter().copied().filter(|(place, _)| counts(*place));
        let (places, field): (Vec<[f64; 2]>, Vec<f64>) = walls.iter().copied().zip(warmth).chain(fluid).unzip();
        let near = Nearest::new(self.plane, self.spacing, &places);
        let position = [0, 1].map(|d| places.iter().map(|place| place[d]).collect::<Vec<f64>>());
        let mut heat = self.without.clone();
        for (i, piece) in self.pieces.iter().enumerate() {
            if let Some((corner, temperature)) = piece.corner {
                let r = |j: usize| self.plane.between(corner.place, places[j]);
                let found = near.of(corner.place, corner_fit::NEIGHBOURS + 1, |j, _| corner.angle_of(r(j)).is_some());
                let of = |&(_, j): &(f64, u32)| (r(j as usize), field[j as usize] - temperature);
                let fit = corner.fit(&found.iter().map(of).collect::<Vec<_>>())?;
                heat[piece.shape] -= self.conductivity * fit.slope(piece.normal, piece.length);
                continue;
            }
            let is_before = |j: usize| {
                let r = self.plane.between(piece.place, places[j]);
                r[0] * piece.normal[0] + r[1] * piece.normal[1] > -BEHIND * self.spacing
            };
            let found = near.of(piece.place, NEIGHBOURS + 1, |j, _| j != i && is_before(j));
            let slope = WallFit::new(self.plane, &places, i, &found)?.gradient(&position, &field);
            let along = slope[0] * piece.normal[0] + slope[1] * piece.normal[1];
            heat[piece.shape] -= self.conductivity * piece.length * along;
        }
        Some(heat)
    }

    /// The same of a state `[F, N]`.
    pub fn of_state<R: Real>(&self, model: &Model<R>, state: &[R]) -> Option<Vec<f64>> {
        let (n, row) = (model.particles(), model.rows.temperature()?);
        let of = |i: usize| ([state[i].f64(), state[n + i].f64()], state[row * n + i].f64());
        self.of_fluid(&(0..n).filter(|&i| model.is_fluid(i)).map(of).collect::<Vec<_>>())
    }
}

type Edge = [[f64; 2]; 2];
/// A wall, and the points of a smooth part of its surface.
type Run = (usize, Vec<[f64; 2]>);

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

fn length(run: &[[f64; 2]]) -> f64 {
    run.windows(2).map(|pair| distance(pair[0], pair[1])).sum()
}

fn middle([from, to]: &Edge) -> [f64; 2] {
    [0, 1].map(|d| 0.5 * (from[d] + to[d]))
}

/// The unit normal on the right.
fn normal([from, to]: &Edge) -> [f64; 2] {
    right_of(*from, *to)
}

/// Edges of no more than a spacing between points around a shape, within the box.
fn edges(points: &[[f64; 2]], plane: &Plane, spacing: f64) -> Vec<Edge> {
    let mut found = vec![];
    for k in 0..points.len() {
        let Some([from, to]) = within(plane, points[k], points[(k + 1) % points.len()]) else { continue };
        let count = (distance(from, to) / spacing).ceil() as usize;
        let at = |part: usize| [0, 1].map(|d| from[d] + part as f64 / count as f64 * (to[d] - from[d]));
        found.extend((0..count).map(|part| [at(part), at(part + 1)]));
    }
    found
}

/// The smooth runs of edges that are the same wall's. A run ends at corners and at edges of none.
fn runs(edges: Vec<Edge>, wall_at: impl Fn(&Edge) -> Option<usize>) -> Vec<Run> {
    let goes_on = |(own, run): &Run, wall: usize, edge: &Edge| {
        let [.., before, end] = run[..] else { return false };
        let ([ax, ay], [bx, by]) = (normal(&[before, end]), normal(edge));
        *own == wall && ax * bx + ay * by > SMOOTH.cos() && distance(end, edge[0]) < 1e-6 * distance(edge[0], edge[1])
    };
    let mut found: Vec<Run> = vec![];
    for edge in edges {
        let Some(wall) = wall_at(&edge) else { continue };
        match found.last_mut() {
            Some(run) if goes_on(run, wall, &edge) => run.1.push(edge[1]),
            _ => found.push((wall, edge.to_vec())),
        }
    }
    // The outline is closed: its last run may go on in the first one.
    if let [(wall, first), .., last] = &found[..] {
        if goes_on(last, *wall, &[first[0], first[1]]) {
            let first = found.remove(0).1;
            found.last_mut().into_iter().for_each(|(_, run)| run.extend_from_slice(&first[1..]));
        }
    }
    found
}

/// The corner between the end of a run and the beginning of the next one, if they are one wall's, meet there, and point into the fluid.
fn corner_between(plane: &Plane, (wall, to): &Run, (next, from): &Run, spacing: f64) -> Option<Corner> {
    let ([.., before, end], [begin, after, ..]) = (&to[..], &from[..]) else { return None };
    if wall != next || distance(*end, *begin) >= 2.0 * CUT * spacing {
        return None;
    }
    let along = |a: &[f64; 2], b: &[f64; 2]| [b[0] - a[0], b[1] - a[1]];
    Corner::new(plane.wrapped(*end), along(before, end), along(begin, after), SMOOTH)
}

/// Equal parts of about a spacing of a run, at least so many: their middle, normal and length.
fn parts(run: &[[f64; 2]], spacing: f64, least: usize) -> Vec<([f64; 2], [f64; 2], f64)> {
    let mut until = vec![0.0];
    for pair in run.windows(2) {
        until.push(until[until.len() - 1] + distance(pair[0], pair[1]));
    }
    let whole = until[until.len() - 1];
    let at = |length: f64| {
        let k = until.partition_point(|&until| until < length).clamp(1, run.len() - 1);
        let share = ((length - until[k - 1]) / (until[k] - until[k - 1])).min(1.0);
        [0, 1].map(|d| run[k - 1][d] + share * (run[k][d] - run[k - 1][d]))
    };
    let count = ((whole / spacing - 1e-9).ceil() as usize).max(least);
    let part = |k: usize| {
        let at = |share: f64| at((k as f64 + share) / count as f64 * whole);
        (at(0.5), normal(&[at(0.0), at(1.0)]), whole / count as f64)
    };
    (0..count).map(part).collect()
}

/// The part of a segment within those sides of the box that are not periodic.
fn within(plane: &Plane, from: [f64; 2], to: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for d in (0..2).filter(|&d| !plane.periodic[d]) {
        let along = to[d] - from[d];
        let (low, high) = (-from[d] / along, (plane.size[d] - from[d]) / along);
        if along == 0.0 {
            // A wall on a side of the box is one of the fluid.
            let slack = 1e-9 * plane.size[d];
            if from[d] < -slack || from[d] > plane.size[d] + slack {
                return None;
            }
        } else {
            first = first.max(low.min(high));
            last = last.min(low.max(high));
        }
    }
    let at = |share: f64| [0, 1].map(|d| from[d] + share * (to[d] - from[d]));
    (last - first > 1e-12).then(|| [at(first), at(last)])
}

/// Takes the heat of shapes after some steps of a run.
pub struct ShapeHeats<'a, R> {
    pub of: ShapeHeat,
    pub model: &'a Model<R>,
    pub steps: BTreeSet<usize>,
    pub samples: Vec<(usize, Vec<f64>)>,
}

impl<R: Sweeps> Observer<Sph<R>> for ShapeHeats<'_, R> {
    fn wants(&self, step: usize) -> bool {
        self.steps.contains(&step)
    }
    fn see(&mut self, _: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if self.steps.contains(&solver.step) {
            self.samples.extend(self.of.of_state(self.model, &solver.state).map(|heat| (solver.step, heat)));
        }
        Ok(())
    }
}

impl<R> ShapeHeats<'_, R> {
    /// Discards the samples from `step` on.
    pub fn go_back(&mut self, step: usize) {
        self.samples.retain(|sample| sample.0 < step);
    }

    /// The mean of each shape.
    pub fn mean(&self) -> Vec<f64> {
        let count = self.samples.len() as f64;
        (0..self.of.without.len()).map(|k| self.samples.iter().map(|(_, heat)| heat[k]).sum::<f64>() / count).collect()
    }
}
