//! Converts a scene of the standard method to the consistent one: adds points on the walls' surface in front of the
//! dummy particles, and a pressure to the state.

use super::lattice::{Lattice, WallHeat};
use crate::config::scene::{self, IntegratorName, ShiftName};
use crate::numerics::lanes::Real;
use crate::particles::tag;
use crate::sph::consistent::arrangement::{Chain, Isotropic, Shift};
use crate::sph::consistent::kinds::{NO_FLUX, PRESSURE, TEMPERATURE, VELOCITY};
use crate::sph::consistent::layout::Layout;
use crate::sph::consistent::{Consistent, Fits};
use crate::sph::flow::Flow;
use crate::sph::standard::Standard;
use std::collections::BTreeMap;

/// A point on a wall's surface, and its condition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub position: [f64; 3],
    /// Unit normal into the fluid.
    pub normal: [f64; 3],
    pub knows: Knows,
}

/// The condition at a surface point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Knows {
    Velocity([f64; 3]),
    /// Temperature relative to the reference.
    Temperature(f64),
    NoHeatFlux,
}

/// Weight of the no-flux condition in a fit, relative to values.
const NO_HEAT_FLUX: f64 = 0.25;

/// Distances in spacings of the last points of a moving lid and of a wall at rest from the edge between them, where the
/// velocity jumps. With them a fit sees the jump in the right place; half a spacing each would make the lid's drag too
/// small. They were fitted to the cavity's extrema at dx = 1/25, and hold at others (src/sph/README.md).
const END_OF_LID: f64 = 0.125;
const BESIDE_LID: f64 = 0.3;

/// A dummy particle behind the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dummy {
    pub particle: usize,
    /// Index of the point whose fit determines the values of the dummy particle.
    pub point: usize,
    /// Position of its mirror image.
    pub mirror: [f64; 3],
}

/// The walls of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Surface {
    pub points: Vec<Point>,
    pub dummies: Vec<Dummy>,
    /// Rows of fluid particles from the lower to the upper wall with the points of both, if there is such an order.
    pub rows: Option<Rows>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Rows {
    /// Indices of points.
    pub lower: Vec<usize>,
    pub upper: Vec<usize>,
    /// Indices of the particles of each row, sorted by x.
    pub fluid: Vec<Vec<u32>>,
}

impl Surface {
    /// The plane walls of a lattice. The upper one moves along x with velocity `lid`; `heat` is for those across y.
    pub(super) fn of_lattice(lattice: &Lattice, lid: f64, heat: Option<[WallHeat; 2]>) -> Self {
        let (dimension, dx) = (lattice.dimension, lattice.spacing);
        let walled = |d: usize| lattice.wall_rows[d] > 0;
        let inner = |d: usize| lattice.wall_rows[d]..lattice.cells[d] - lattice.wall_rows[d];
        let plane = |d: usize, upper: bool| {
            let row = if upper { inner(d).end } else { inner(d).start };
            (row as f64 - lattice.before[d]) * dx + lattice.corner[d]
        };
        let mut surface = Self::default();
        let mut numbers = BTreeMap::new();
        for d in (0..dimension).filter(|&d| walled(d)) {
            // Points are in front of each fluid particle next to a wall.
            for i in (0..lattice.particles()).filter(|&i| !lattice.is_wall(i)) {
                let rows = lattice.rows(i);
                for upper in [false, true] {
                    let beside = if upper { inner(d).end - 1 } else { inner(d).start };
                    if rows[d] != beside {
                        continue;
                    }
                    let mut position = lattice.place(i);
                    position[d] = plane(d, upper);
                    let moves = d == 1 && upper;
                    let mut normal = [0.0; 3];
                    normal[d] = if upper { -1.0 } else { 1.0 };
                    numbers.insert((d, upper, i), surface.points.len());
                    let knows = Knows::Velocity([if moves { lid } else { 0.0 }, 0.0, 0.0]);
                    let mut point = Point { position, normal, knows };
                    let moved = |rows: usize, to: f64| if rows == 0 { to - 0.5 } else { 0.0 };
                    if lid != 0.0 && moves {
                        for e in (0..dimension).filter(|&e| e != 1 && walled(e)) {
                            let (before, behind) = (rows[e] - inner(e).start, inner(e).end - 1 - rows[e]);
                            point.position[e] += dx * (moved(before, END_OF_LID) - moved(behind, END_OF_LID));
                        }
                    } else if lid != 0.0 && d != 1 {
                        point.position[1] -= dx * moved(inner(1).end - 1 - rows[1], BESIDE_LID);
                    }
                    surface.points.push(point);
                    if let Some(walls) = heat.filter(|_| d == 1) {
                        let wall = walls[upper as usize];
                        let knows = wall.at(point.position[0]).map_or(Knows::NoHeatFlux, Knows::Temperature);
                        surface.points.push(Point { knows, ..point });
                    }
                }
            }
        }
        for i in 0..lattice.particles() {
            let rows = lattice.rows(i);
            let outside: Vec<usize> = (0..dimension).filter(|&d| !inner(d).contains(&rows[d])).collect();
            let Some(&d) = outside.first() else { continue };
            let is_above = |d: usize| rows[d] >= inner(d).end;
            // The nearest fluid particle of the lattice.
            let nearest: [usize; 3] = std::array::from_fn(|e| match e < dimension {
                true => rows[e].clamp(inner(e).start, inner(e).end - 1),
                false => 0,
            });
            let cells = lattice.cells;
            let fluid = nearest[0] + cells[0] * (nearest[1] + cells[1] * nearest[2]);
            let mut mirror = lattice.place(i);
            outside.iter().for_each(|&e| mirror[e] = 2.0 * plane(e, is_above(e)) - mirror[e]);
            surface.dummies.push(Dummy { particle: i, point: numbers[&(d, is_above(d), fluid)], mirror });
        }
        surface
    }
}

/// Largest velocity of the isotropic shift, in units of the reference velocity.
const LIMIT: f64 = 1.0;

impl Surface {
    /// Converts a model and initial state of the standard method to the consistent one, with the points of these walls.
    pub(super) fn added<R: Real>(
        &self,
        mut model: Standard<R>,
        base: &[f64],
        spacing: f64,
        [velocity, sound_speed]: [f64; 2],
        own: scene::Consistent,
    ) -> (Consistent<R>, Vec<f64>) {
        let (old, l) = (model.particles(), model.layout);
        let d = l.dimension;
        let rates = own.integrator == IntegratorName::Verlet;
        let layout = Layout { dimension: d, heat: l.heat, rates };
        let n = old + self.points.len();
        let mut state = vec![0.0; layout.state_rows() * n];
        for i in 0..old {
            for k in 0..d {
                state[k * n + i] = base[k * old + i];
                state[(layout.velocity() + k) * n + i] =
                    if model.is_fluid(i) { base[(l.velocity() + k) * old + i] } else { 0.0 };
            }
        }
        let mut weights = vec![R::default(); 4 * n];
        let one = R::of(1.0);
        for i in (0..old).filter(|&i| model.is_fluid(i)) {
            weights[4 * i..4 * i + 3].fill(one);
        }
        for dummy in &self.dummies {
            let i = dummy.particle;
            weights[4 * i + PRESSURE] = one;
            (0..d).for_each(|k| state[(layout.velocity() + k) * n + i] = dummy.mirror[k]);
        }
        for (k, point) in self.points.iter().enumerate() {
            let i = old + k;
            (0..d).for_each(|k| state[k * n + i] = point.position[k]);
            let mut vector = |vector: [f64; 3]| {
                (0..d).for_each(|k| state[(layout.velocity() + k) * n + i] = vector[k]);
            };
            match point.knows {
                Knows::Velocity(velocity) => {
                    vector(velocity);
                    weights[4 * i + VELOCITY] = one;
                }
                Knows::NoHeatFlux => {
                    vector(point.normal);
                    weights[4 * i + NO_FLUX] = R::of(NO_HEAT_FLUX);
                }
                Knows::Temperature(temperature) => {
                    state[layout.temperature() * n + i] = temperature;
                    weights[4 * i + TEMPERATURE] = one;
                }
            }
            let hot = matches!(point.knows, Knows::Temperature(_));
            model.flow.tags.push(if hot { tag::HOT_SURFACE } else { tag::SURFACE });
        }
        let numbers: Vec<u32> = (old..n).map(|i| i as u32).collect();
        // Only points with dummy particles behind them have a fit.
        let mut fitted: Vec<usize> = self.dummies.iter().map(|dummy| dummy.point).collect();
        fitted.sort_unstable();
        fitted.dedup();
        let place = |point: usize| fitted.partition_point(|&k| k < point) as u32;
        let mut quadrature = vec![one; n];
        let shift = match (own.shift, &self.rows) {
            (ShiftName::None, _) => Shift::None,
            (ShiftName::Chain | ShiftName::Rows, Some(rows)) => {
                let points = |points: &[usize]| points.iter().map(|&k| numbers[k]).collect::<Vec<u32>>();
                let all = [vec![points(&rows.lower)], rows.fluid.clone(), vec![points(&rows.upper)]].concat();
                let is_still = own.shift == ShiftName::Rows;
                Shift::Chain(Chain::new(own.shift_strength, is_still, all, n))
            }
            _ => Shift::Isotropic(Isotropic {
                strength: own.shift_strength,
                limit: LIMIT,
                normals: fitted.iter().map(|&k| (numbers[k], self.points[k].normal)).collect(),
            }),
        };
        if let (Some(rows), Shift::Chain(_)) = (&self.rows, &shift) {
            let beside = [rows.fluid.first(), rows.fluid.last()].into_iter().flatten().flatten();
            beside.for_each(|&i| quadrature[i as usize] = R::of(11.0 / 12.0));
        }
        let density = model.equation_of_state.reference_density;
        let diffusivity = model.heat.as_ref().map_or(0.0, |heat| heat.conductivity / (density * heat.capacity));
        let fits = Fits {
            spacing,
            sound_speed,
            velocity,
            viscosity: model.viscosity / density,
            diffusivity,
            delta: own.pressure_diffusion,
            shift,
            weights,
            surface: fitted.iter().map(|&k| numbers[k]).collect(),
            dummies: self.dummies.iter().map(|dummy| (dummy.particle as u32, place(dummy.point))).collect(),
            quadrature,
        };
        let mut flow: Flow<R> = model.flow;
        flow.equation_of_state.background_pressure = 0.0;
        (Consistent::new(flow, layout, fits), state)
    }
}
