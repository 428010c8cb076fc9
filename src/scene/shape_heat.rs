//! The heat that shapes with a given temperature give to moving particles in two dimensions.
//!
//! The surface of every shape is cut into pieces of about a spacing. In the middle of each the gradient of the temperature is that of a
//! fit of third order through the wall's temperature there, those of other pieces, and the fluid's particles ([`WallFit`]), so
//!
//! ```text
//!   heat = - sum over pieces of length k n . grad T,   n into the fluid.
//! ```
//!
//! It does not ask the method, whose own exchange with walls has an error of first order in the spacing beside them.

use super::custom::{shapes, surroundings};
use crate::adjoint::run::Observer;
use crate::config::custom::{Fill, ShapeEntry};
use crate::config::scene::{Config, Method};
use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::sph::cloud::nearest::{Nearest, Plane};
use crate::sph::cloud::outline::Outline;
use crate::sph::cloud::wall_fit::{WallFit, NEIGHBOURS};
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::{Model, Sweeps};
use std::collections::BTreeSet;

/// With the standard method the temperature of the particles nearest to a wall contains the error of the wall condition: beside a wall with
/// a linear temperature they make the flux 1.3 % too large at any spacing. In spacings.
const SKIPPED: f64 = 1.0;
/// Neighbours may be this far behind a wall's tangent, in spacings: those are on the other side of a thin wall.
const BEHIND: f64 = 0.5;

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
}

/// The surfaces of a configuration's shapes.
#[derive(Debug)]
pub struct ShapeHeat {
    plane: Plane,
    spacing: f64,
    conductivity: f64,
    shapes: usize,
    /// Fluid nearer to a surface is left out. Length.
    skipped: f64,
    pieces: Vec<Piece>,
}

impl ShapeHeat {
    /// None where no shape with a temperature and an outline touches the fluid, and in three dimensions.
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
        let mut pieces = vec![];
        for (k, shape) in all.iter().enumerate().filter(|(_, shape)| shape.entry.fill == Fill::Wall) {
            let Some(temperature) = &shape.on_wall.temperature else { continue };
            for [from, to] in edges(&once(shape.entry, &plane)) {
                let Some([from, to]) = within(&plane, from, to) else { continue };
                let along = [to[0] - from[0], to[1] - from[1]];
                let length = along[0].hypot(along[1]);
                let count = (length / spacing).ceil().max(1.0);
                let normal = [along[1] / length, -along[0] / length];
                for part in 0..count as usize {
                    let share = (part as f64 + 0.5) / count;
                    let middle = [from[0] + share * along[0], from[1] + share * along[1]];
                    let beside = |by: f64| [middle[0] + by * normal[0], middle[1] + by * normal[1], 0.0];
                    // Not in another wall or behind a side, and not covered by a later shape.
                    if walls.distance(beside(0.25 * spacing)) > 0.0
                        && walls.shape_at(beside(-1e-3 * spacing)) == Some(k)
                    {
                        let place = plane.wrapped(middle);
                        let temperature = temperature.at([place[0], place[1], 0.0]) - reference;
                        pieces.push(Piece { shape: k, place, normal, length: length / count, temperature });
                    }
                }
            }
        }
        let conductivity = config.fluid.conductivity;
        let skipped = if matches!(config.method, Method::Standard(_)) { SKIPPED * spacing } else { 0.0 };
        let found = Self { plane, spacing, conductivity, shapes: all.len(), skipped, pieces };
        Ok(Some(found).filter(|found| !found.pieces.is_empty()))
    }

    /// The heat of each shape per time and depth, given places and temperatures (relative to the reference) of fluid; 0 of shapes
    /// without a temperature. None with too few particles beside a surface.
    pub fn of_fluid(&self, fluid: &[([f64; 2], f64)]) -> Option<Vec<f64>> {
        let (walls, warmth): (Vec<[f64; 2]>, Vec<f64>) =
            self.pieces.iter().map(|piece| (piece.place, piece.temperature)).unzip();
        let surface = Nearest::new(self.plane, self.spacing, &walls);
        let counts = |place: [f64; 2]| self.skipped == 0.0 || surface.one(place, self.skipped).is_none();
        let fluid = fluid.iter().copied().filter(|(place, _)| counts(*place));
        let (places, field): (Vec<[f64; 2]>, Vec<f64>) = walls.iter().copied().zip(warmth).chain(fluid).unzip();
        let near = Nearest::new(self.plane, self.spacing, &places);
        let position = [0, 1].map(|d| places.iter().map(|place| place[d]).collect::<Vec<f64>>());
        let mut heat = vec![0.0; self.shapes];
        for (i, piece) in self.pieces.iter().enumerate() {
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

/// The shape; of a box that is longer than a period one period, since it touches its own images.
fn once(entry: &ShapeEntry, plane: &Plane) -> ShapeEntry {
    let mut once = entry.clone();
    if let (Some(lower), Some(upper)) = (&mut once.lower, &mut once.upper) {
        for d in 0..2 {
            if plane.periodic[d] && upper[d] - lower[d] > plane.size[d] {
                (lower[d], upper[d]) = (0.0, plane.size[d]);
            }
        }
    }
    once
}

/// The edges of a shape's outline, counter-clockwise; none of one without an outline.
fn edges(entry: &ShapeEntry) -> Vec<[[f64; 2]; 2]> {
    let Some(outline) = Outline::new(entry, 0.0) else { return vec![] };
    let points: Vec<[f64; 2]> =
        outline.points(&outline.samples(24), &outline.numbers).iter().map(|p| p.place).collect();
    (0..points.len()).map(|k| [points[k], points[(k + 1) % points.len()]]).filter(|[a, b]| a != b).collect()
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
        (0..self.of.shapes).map(|k| self.samples.iter().map(|(_, heat)| heat[k]).sum::<f64>() / count).collect()
    }
}
