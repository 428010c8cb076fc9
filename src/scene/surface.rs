//! From a scene of the standard formulation to one of the consistent one: points on the walls' surface join the dummy
//! particles behind it, and the state gets a pressure.

use super::assembly::{Assembled, Lattice, Numerics, WallHeat};
use crate::config::scene::{Config, Formulation, IntegratorName, ShiftName};
use crate::numerics::lanes::Real;
use crate::particles::tag;
use crate::sph::consistent::derivatives::{NO_FLUX, PRESSURE, TEMPERATURE, VELOCITY};
use crate::sph::consistent::shift::{Chain, Isotropic};
use crate::sph::consistent::{Consistent, Shift};
use crate::sph::model::{Layout, Model};
use std::collections::BTreeMap;

/// A point on a wall's surface, and what is known there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub position: [f64; 3],
    /// Into the fluid.
    pub normal: [f64; 3],
    pub knows: Knows,
}

/// What a point of the surface tells the fluid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Knows {
    Velocity([f64; 3]),
    /// Above the reference.
    Temperature(f64),
    NoHeatFlux,
}

/// What the condition that no heat flows counts in a fit, beside values.
const NO_HEAT_FLUX: f64 = 0.25;

/// Where a lid that moves meets walls at rest the velocity jumps. A fit sees the jump where it is if the last points of both
/// stand this far from the edge, in spacings; half a spacing each would make the lid's pull too short by what is beside its ends.
/// Fitted to the cavity's extrema at dx = 1/25, and right at others too (src/sph/README.md).
const END_OF_LID: f64 = 0.125;
const BESIDE_LID: f64 = 0.3;

/// A dummy particle behind the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dummy {
    pub particle: usize,
    /// The point whose fit gives it its values.
    pub point: usize,
    /// Its mirror image.
    pub mirror: [f64; 3],
}

/// The walls of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Surface {
    pub points: Vec<Point>,
    pub dummies: Vec<Dummy>,
    /// Rows of fluid particles from the lower wall to the upper one, and the points of both, where there is such an order.
    pub rows: Option<Rows>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Rows {
    /// Numbers of points.
    pub lower: Vec<usize>,
    pub upper: Vec<usize>,
    /// Numbers of particles, each row in the order of x.
    pub fluid: Vec<Vec<u32>>,
}

/// What the consistent formulation is told besides the standard one's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Settings {
    pub shift: ShiftName,
    pub strength: f64,
    pub delta: f64,
    pub integrator: IntegratorName,
}

impl Settings {
    /// Those of a configuration; none in the standard formulation.
    pub(super) fn from_config(config: &Config) -> Option<Self> {
        (config.fluid.formulation == Formulation::Consistent).then_some(Self {
            shift: config.fluid.shift,
            strength: config.fluid.shift_strength,
            delta: config.fluid.pressure_diffusion,
            integrator: config.time.integrator,
        })
    }
}

impl Surface {
    /// The plane walls of a lattice, whose upper one moves along x with velocity `lid`; those across y as `heat` has them.
    pub(super) fn of_lattice(lattice: &Lattice, lid: f64, heat: Option<[WallHeat; 2]>) -> Self {
        let (dimension, dx) = (lattice.dimension, lattice.spacing);
        let walled = |d: usize| lattice.wall_rows[d] > 0;
        let coordinate = |d: usize, row: f64| (row - lattice.before[d]) * dx + lattice.corner[d];
        let inner = |d: usize| lattice.wall_rows[d]..lattice.cells[d] - lattice.wall_rows[d];
        let plane = |d: usize, upper: bool| {
            let row = if upper { inner(d).end } else { inner(d).start };
            coordinate(d, row as f64)
        };
        let mut surface = Self::default();
        let mut numbers = BTreeMap::new();
        for d in (0..dimension).filter(|&d| walled(d)) {
            for i in 0..lattice.particles() {
                let rows = lattice.rows(i);
                // Points in front of each particle next to a wall.
                if (0..dimension).any(|e| !inner(e).contains(&rows[e])) {
                    continue;
                }
                for upper in [false, true] {
                    let beside = if upper { inner(d).end - 1 } else { inner(d).start };
                    if rows[d] != beside {
                        continue;
                    }
                    let place = |e: usize| if e == d { plane(d, upper) } else { coordinate(e, rows[e] as f64 + 0.5) };
                    let moves = d == 1 && upper;
                    let mut normal = [0.0; 3];
                    normal[d] = if upper { -1.0 } else { 1.0 };
                    numbers.insert((d, upper, i), surface.points.len());
                    let point = Point {
                        position: std::array::from_fn(|e| if e < dimension { place(e) } else { 0.0 }),
                        normal,
                        knows: Knows::Velocity([if moves { lid } else { 0.0 }, 0.0, 0.0]),
                    };
                    let mut point = point;
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
            // The fluid particle of the lattice that is nearest.
            let nearest: [usize; 3] = std::array::from_fn(|e| match e < dimension {
                true => rows[e].clamp(inner(e).start, inner(e).end - 1),
                false => 0,
            });
            let cells = lattice.cells;
            let fluid = nearest[0] + cells[0] * (nearest[1] + cells[1] * nearest[2]);
            let mirror = std::array::from_fn(|e| {
                let x = if e < dimension { coordinate(e, rows[e] as f64 + 0.5) } else { 0.0 };
                if outside.contains(&e) {
                    2.0 * plane(e, is_above(e)) - x
                } else {
                    x
                }
            });
            surface.dummies.push(Dummy { particle: i, point: numbers[&(d, is_above(d), fluid)], mirror });
        }
        surface
    }
}

/// Most that the isotropic shift moves particles with, in units of the reference velocity.
const LIMIT: f64 = 1.0;

impl<R: Real> Assembled<R> {
    /// The same scene in the consistent formulation.
    pub fn with_surface(
        self,
        surface: &Surface,
        numerics: &Numerics,
        spacing: f64,
        velocity: f64,
        settings: Settings,
    ) -> Self {
        let Assembled { mut model, base } = self;
        let (old, l) = (model.particles(), model.layout);
        let d = l.dimension;
        let layout = Layout {
            transport: false,
            mass: false,
            consistent: true,
            rates: settings.integrator == IntegratorName::Verlet,
            ..l
        };
        let n = old + surface.points.len();
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
        for dummy in &surface.dummies {
            let i = dummy.particle;
            weights[4 * i + PRESSURE] = one;
            (0..d).for_each(|k| state[(layout.velocity() + k) * n + i] = dummy.mirror[k]);
        }
        for (k, point) in surface.points.iter().enumerate() {
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
            model.tags.push(if hot { tag::HOT_SURFACE } else { tag::SURFACE });
        }
        let numbers: Vec<u32> = (old..n).map(|i| i as u32).collect();
        // Only points with dummy particles behind them have a fit.
        let mut fitted: Vec<usize> = surface.dummies.iter().map(|dummy| dummy.point).collect();
        fitted.sort_unstable();
        fitted.dedup();
        let place = |point: usize| fitted.partition_point(|&k| k < point) as u32;
        let mut quadrature = vec![one; n];
        let shift = match (settings.shift, &surface.rows) {
            (ShiftName::None, _) => Shift::None,
            (ShiftName::Chain | ShiftName::Rows, Some(rows)) => {
                let points = |points: &[usize]| points.iter().map(|&k| numbers[k]).collect::<Vec<u32>>();
                let all = [vec![points(&rows.lower)], rows.fluid.clone(), vec![points(&rows.upper)]].concat();
                let is_still = settings.shift == ShiftName::Rows;
                Shift::Chain(Chain::new(settings.strength, is_still, all, n))
            }
            _ => Shift::Isotropic(Isotropic {
                strength: settings.strength,
                limit: LIMIT,
                normals: fitted.iter().map(|&k| (numbers[k], surface.points[k].normal)).collect(),
            }),
        };
        if let (Some(rows), Shift::Chain(_)) = (&surface.rows, &shift) {
            let beside = [rows.fluid.first(), rows.fluid.last()].into_iter().flatten().flatten();
            beside.for_each(|&i| quadrature[i as usize] = R::of(11.0 / 12.0));
        }
        let density = model.equation_of_state.reference_density;
        let diffusivity = model.heat.as_ref().map_or(0.0, |heat| heat.conductivity / (density * heat.capacity));
        let consistent = Consistent {
            spacing,
            sound_speed: numerics.sound_speed_factor * velocity,
            velocity,
            viscosity: model.viscosity / density,
            diffusivity,
            delta: settings.delta,
            shift,
            weights,
            surface: fitted.iter().map(|&k| numbers[k]).collect(),
            dummies: surface.dummies.iter().map(|dummy| (dummy.particle as u32, place(dummy.point))).collect(),
            quadrature,
        };
        let mut eos = model.equation_of_state;
        eos.background_pressure = 0.0;
        let model = Model { layout, consistent: Some(consistent), equation_of_state: eos, transport: 0.0, ..model };
        Assembled { model, base: state }
    }
}
