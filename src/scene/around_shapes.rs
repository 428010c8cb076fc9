//! Custom scenes of fixed particles: the steady flow around the shapes of a configuration, its figures and objective.

use super::custom_shape::OnWall;
use super::particle_fields::ParticleFields;
use super::start_field;
use crate::config::custom::{Kind, Part, ShapeEntry, ShapeNumber, Side, SideKind};
use crate::config::formula::Function;
use crate::config::scene::{Config, DriveName, LimitEntry, ObjectiveKind, Term};
use crate::error::{BadInput, Error};
use crate::numerics::grid_field::GridVelocity;
use crate::numerics::threads;
use crate::particles::tag;
use crate::sph::cloud::conditions::Conditions as _;
use crate::sph::cloud::contour::Walls;
use crate::sph::cloud::equations::{Motion, Warmth};
use crate::sph::cloud::figures::MeasureSettings;
use crate::sph::cloud::nearest::{Nearest, Plane};
use crate::sph::cloud::outline::{area, Outline};
use crate::sph::cloud::particles::{Balanced, Cloud, Fluid, Surroundings, Unusable};
use crate::sph::cloud::placing::{behind, BoundaryPoint, Ground, Polygon, Unplaceable};
use crate::sph::cloud::problem::{NoSolution, Solution, SteadyFlow};
use crate::sph::cloud::sliding::Footing;
use crate::sph::cloud::steady::{Held, NoSteadyState};
use crate::sph::laws::buoyancy::Buoyancy;
use std::sync::Arc;

/// Growth of the spacing far from bodies, per distance.
const GROWTH: f64 = 0.15;
/// Differences of parameters of outlines that are none.
const ROUNDING: f64 = 1e-9;
/// Corners are rounded to this radius, in spacings of the surface. (Around a triangle with dx = 0.02 the flow rate is 2.5, 1.2, 0.5 and 0.3 %
/// off with 1, 1/2, 1/4 and 1/8.)
const ROUNDED: f64 = 0.125;
/// The same where forces are sums over surfaces, to which the pressure at a sharp corner is not known well: by its surface the drag of a box is
/// 2.8 % off with 1 and 4.8 % with 1/8.
const ROUNDED_WITH_SOUND: f64 = 1.0;

/// The steady flow of a configuration.
pub struct AroundShapes {
    pub flow: SteadyFlow,
    config: Config,
    /// The points of probes.
    pub(super) probes: Vec<[f64; 2]>,
    /// Shape and number in its outline of each of `variables`.
    pub wanted: Vec<(usize, usize)>,
    /// Whether the derivative of a flow in time is wanted by the viscosity, too.
    pub by_viscosity: bool,
    /// The velocity at the start of a flow in time, where a grid gives it instead of formulas.
    pub start: Option<GridVelocity>,
}

/// Conditions on walls, by formulas.
#[derive(Debug)]
struct Conditions {
    plane: Plane,
    dx: f64,
    shapes: Vec<OnWall>,
    sides: [Option<(SideKind, OnWall)>; 6],
    polygons: Vec<Polygon>,
    /// How many numbers of each shape are its outline's.
    geometry: Vec<usize>,
    wall: Wall,
}

impl Conditions {
    fn on(&self, wall: &OnWall, [x, y]: [f64; 2], time: f64, parameters: &[f64]) -> (Motion, Warmth) {
        let ([u, v, _], warmth) = self.wall.at(wall, [x, y, 0.0], time, parameters);
        (Motion::Given([u, v]), warmth)
    }
}

impl Surroundings for Conditions {
    fn condition(&self, point: &BoundaryPoint, place: [f64; 2], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth) {
        let parameters = |shape: usize| &numbers[shape][self.geometry[shape]..];
        let adiabatic = Warmth::Flux(0.0);
        if let Some((shape, _)) = point.on {
            return self.on(&self.shapes[shape], place, time, parameters(shape));
        }
        if let Some((kind, wall)) = point.side.and_then(|side| self.sides[side].as_ref()) {
            let along = point.side.unwrap_or_default() / 2;
            return match kind {
                SideKind::Outflow => (Motion::Outflow(along), adiabatic),
                SideKind::Symmetry => (Motion::Symmetry(along), adiabatic),
                _ => self.on(wall, place, time, &[]),
            };
        }
        match self.shape_behind(point, place) {
            Some(shape) => self.on(&self.shapes[shape], place, time, parameters(shape)),
            None => (Motion::Given([0.0; 2]), adiabatic),
        }
    }

    fn shape_behind(&self, point: &BoundaryPoint, place: [f64; 2]) -> Option<usize> {
        if point.on.is_some() || point.side.is_some_and(|side| self.sides[side].is_some()) {
            return None;
        }
        behind(&self.plane, self.dx, &self.polygons, place, point.normal)
    }

    fn varies(&self, point: &BoundaryPoint, place: [f64; 2]) -> bool {
        let on_side = point.side.and_then(|side| self.sides[side].as_ref()).map(|(_, wall)| wall);
        let shape = point.on.map(|on| on.0).or_else(|| self.shape_behind(point, place));
        shape.map(|shape| &self.shapes[shape]).or(on_side).is_some_and(OnWall::varies)
    }

    fn has_time(&self) -> bool {
        let sides = self.sides.iter().flatten().map(|(_, wall)| wall);
        self.shapes.iter().chain(sides).any(OnWall::has_time)
    }
}

/// The value of an objective or limit with its derivative by the variables.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    pub value: f64,
    pub by_variables: Vec<f64>,
}

/// What the drive of a configuration holds.
pub(super) fn held(config: &Config) -> Option<Held> {
    let fluid = &config.fluid;
    match fluid.drive {
        DriveName::BodyForce => None,
        DriveName::FlowRate => fluid.flow_rate.map(Held::FlowRate),
        DriveName::PumpingPower => {
            fluid.pumping_power.map(|power| Held::Power { power: power / fluid.density, length: config.region.size[0] })
        }
    }
}

/// The conditions on the sides of a box in some dimensions, in the order of [`Sides::all`].
pub(super) fn sides(config: &Config, dimension: usize) -> Result<[Option<(SideKind, OnWall)>; 6], BadInput> {
    let mut found: [Option<(SideKind, OnWall)>; 6] = Default::default();
    for (to, (name, side)) in found.iter_mut().zip(config.region.sides.all()) {
        let Some(Side { kind, velocity, temperature, heat_flux }) = side else { continue };
        let (key, read) = (format!("region.sides.{name}"), config.wall_formula());
        let wall = OnWall::new(&key, dimension, velocity.as_ref(), temperature.as_ref(), heat_flux.as_ref(), read)?;
        *to = Some((*kind, wall));
    }
    Ok(found)
}

/// Velocity and temperature that formulas give on a wall.
#[derive(Debug)]
pub(super) struct Wall {
    pub reference: f64,
    /// Density times heat capacity.
    pub capacity: f64,
}

impl Wall {
    pub fn of_config(config: &Config) -> Self {
        let fluid = &config.fluid;
        Self { reference: fluid.inlet_temperature, capacity: fluid.density * fluid.heat_capacity }
    }

    pub fn at(&self, wall: &OnWall, place: [f64; 3], time: f64, parameters: &[f64]) -> ([f64; 3], Warmth) {
        let at = |function: &Function| function.with_parameters(place, time, parameters);
        let mut velocity = [0.0; 3];
        wall.velocity.iter().enumerate().for_each(|(e, function)| velocity[e] = at(function));
        let warmth = match (&wall.temperature, &wall.heat_flux) {
            (Some(temperature), _) => Warmth::Given(at(temperature) - self.reference),
            (None, flux) => Warmth::Flux(flux.as_ref().map_or(0.0, at) / self.capacity),
        };
        (velocity, warmth)
    }
}

/// An error for a derivative by a variable that is not finite.
pub(super) fn check_finite(config: &Config, gradient: &[f64]) -> Result<(), Error> {
    match gradient.iter().position(|g| !g.is_finite()) {
        Some(k) => Err(Error::diverged(
            format!("the gradient by {} is {}", config.variables[k].number, gradient[k]),
            finer(config),
        )),
        None => Ok(()),
    }
}

/// Whether the objective can be told: a scene without variables may have another scene's, which is about heat.
pub(super) fn has_objective(config: &Config) -> bool {
    let objective = &config.objective;
    let is_told = objective.kind != ObjectiveKind::HeatOutflow || !objective.terms.is_empty();
    is_told || config.initial.temperature.is_some()
}

fn outlines(entries: &[ShapeEntry], radius: f64) -> Vec<Outline> {
    entries.iter().filter_map(|entry| Outline::new(entry, radius)).collect()
}

impl AroundShapes {
    /// The steady flow of a checked configuration, see [`Config::is_around_shapes`].
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(config: &Config) -> Result<Self, Error> {
        let (region, fluid, dx) = (&config.region, &config.fluid, config.resolution.dx);
        let surface = config.resolution.surface.unwrap_or(dx / 3.0).min(dx);
        let plane =
            Plane { size: [region.size[0], region.size[1]], periodic: [region.periodic[0], region.periodic[1]] };
        let rounded = if config.has_sound() { ROUNDED_WITH_SOUND } else { ROUNDED };
        let outlines = outlines(&config.shapes, rounded * surface);
        let read = config.wall_formula();
        let shapes = config.shapes.iter().enumerate().map(|(k, entry)| OnWall::of_shape(k, entry, 2, read));
        let polygon = |outline: &Outline| Polygon::of(&outline.points(&outline.samples(8), &outline.numbers));
        let conditions = Conditions {
            plane,
            dx,
            shapes: shapes.collect::<Result<_, BadInput>>()?,
            sides: sides(config, 2)?,
            polygons: outlines.iter().map(polygon).collect(),
            geometry: outlines.iter().map(|outline| outline.geometry).collect(),
            wall: Wall::of_config(config),
        };
        let materials = Fluid {
            viscosity: config.kinematic_viscosity(),
            diffusivity: config.initial.temperature.as_ref().map(|_| config.thermal_diffusivity()),
            force: [region.acceleration[0], region.acceleration[1]],
            buoyancy: Buoyancy::new(fluid.expansion, &region.acceleration, config.neutral_temperature()),
            velocity: fluid.reference_velocity,
        };
        let held = held(config);
        let ground = Ground {
            plane,
            dx,
            surface,
            far: config.resolution.far.unwrap_or(1.0),
            growth: config.resolution.growth.unwrap_or(GROWTH),
            outlines,
        };
        let threads = threads::count();
        let cloud = Cloud::new(ground, materials, Arc::new(conditions), config.is_corrected(), threads)
            .map_err(|why| unusable(config, &why))?;
        let numbers = config.shape_numbers();
        let wanted =
            numbers.iter().map(|number| place_of(&cloud, number)).collect::<Option<Vec<_>>>().unwrap_or_default();
        for (k, &(shape, _)) in wanted.iter().enumerate() {
            if !cloud.is_parameter(wanted[k]) && !cloud.places.bodies.contains(&shape) && !holds_ends(&cloud, wanted[k])
            {
                let key = format!("variables[{k}].number");
                let problem = format!(
                    "{key} = \"{}\": the shape meets a wall at a small angle, and this number moves its surface there",
                    config.variables[k].number
                );
                return Err(BadInput::at(&key, problem)
                    .allowed("numbers of shapes that stand in the fluid, or go into walls at larger angles, and those that leave such ends in place (points of a b-spline far from these)")
                    .advice("method.name=consistent")
                    .into());
            }
        }
        let probes = probes(config);
        check_probes(&cloud, &probes)?;
        let settings = measure_settings(config, &probes);
        let flow = SteadyFlow::new(cloud, held, settings, threads).map_err(|why| unusable(config, &why))?;
        if let Some(k) = (0..config.shapes.len()).find(|&k| !flow.measures.is_seen(k)) {
            let problem =
                format!("shapes[{k}] has no surface in the fluid: it is outside of the box, or inside of other shapes");
            return Err(BadInput::at(format!("shapes[{k}]"), problem)
                .allowed(
                    "shapes in the box, and shapes behind its sides, which give these their temperature or velocity",
                )
                .into());
        }
        let start = start_field::of_config(config)?;
        Ok(Self { flow, config: config.clone(), probes, wanted, by_viscosity: false, start })
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Advice for a spacing that is too coarse.
    pub fn finer_advice(&self) -> String {
        finer(&self.config)
    }

    /// The variables of the configuration.
    pub fn first(&self) -> Vec<f64> {
        let numbers = self.flow.cloud.numbers();
        self.wanted.iter().map(|&(shape, k)| numbers[shape][k]).collect()
    }

    pub(super) fn numbers(&self, variables: &[f64]) -> Vec<Vec<f64>> {
        let mut numbers = self.flow.cloud.numbers();
        self.wanted.iter().zip(variables).for_each(|(&(shape, k), x)| numbers[shape][k] = *x);
        numbers
    }

    /// Value and derivative of area or distance; none for other kinds.
    pub(super) fn of_outlines(&self, kind: ObjectiveKind, shapes: &[usize], variables: &[f64]) -> Option<Judged> {
        let numbers = self.numbers(variables);
        let outlines = &self.flow.cloud.ground.outlines;
        let chosen: Vec<usize> =
            if shapes.is_empty() { self.flow.cloud.places.bodies.clone() } else { shapes.to_vec() };
        let mut by_variables = vec![0.0; self.wanted.len()];
        // Walls may be longer by far than the box.
        let samples = |k: usize| {
            let polygon = &self.flow.cloud.places.polygons[k];
            let is_body = self.flow.cloud.places.bodies.contains(&k);
            let most = if is_body { 24.0 } else { polygon.perimeter() / self.flow.cloud.ground.dx };
            outlines[k].samples((most as usize).clamp(24, 400))
        };
        let fine: Vec<Vec<f64>> = (0..outlines.len()).map(samples).collect();
        let points: Vec<_> = (0..outlines.len()).map(|k| outlines[k].points(&fine[k], &numbers[k])).collect();
        match kind {
            ObjectiveKind::Area => {
                for (by, &(shape, number)) in by_variables.iter_mut().zip(&self.wanted) {
                    if chosen.contains(&shape) {
                        *by = area(&outlines[shape].slopes(&fine[shape], &numbers[shape], number)).slope;
                    }
                }
                Some(Judged { value: chosen.iter().map(|&k| area(&points[k]).abs()).sum(), by_variables })
            }
            ObjectiveKind::Distance => {
                let Cloud { ground, places, .. } = &self.flow.cloud;
                let (plane, corners) = (ground.plane, places.corners);
                let chosen = if shapes.is_empty() { &places.touching } else { &chosen };
                // What stands on walls is there as far as it is in the fluid.
                let is_there = |shape: usize, p: [f64; 2]| {
                    places.bodies.contains(&shape) || !ground.is_solid(&places.polygons, p, Some(shape))
                };
                // The nearest pair: (distance, direction from a to b, a, b or none for a side).
                type Nearest = (f64, [f64; 2], (usize, usize), Option<(usize, usize)>);
                let mut nearest: Nearest = (f64::INFINITY, [0.0; 2], (0, 0), None);
                for &a in chosen {
                    let walls = Walls::of(&self.flow.cloud, a);
                    for (i, p) in points[a].iter().enumerate().filter(|(_, p)| is_there(a, p.place)) {
                        for d in (0..2).filter(|&d| !plane.periodic[d]) {
                            let sides = [(0, -1.0), (1, 1.0)].into_iter();
                            for (end, sign) in sides.filter(|(end, _)| !walls.sides.contains(&(2 * d + end))) {
                                let distance = sign * (corners[end][d] - p.place[d]);
                                if distance < nearest.0 {
                                    let direction = std::array::from_fn(|e| if e == d { sign } else { 0.0 });
                                    nearest = (distance, direction, (a, i), None);
                                }
                            }
                        }
                        let others = places.touching.iter().filter(|&b| *b != a && !walls.shapes.contains(b));
                        for &b in others {
                            for (j, q) in points[b].iter().enumerate().step_by(2) {
                                let r = plane.between(p.place, q.place);
                                let distance = r[0].hypot(r[1]);
                                if distance < nearest.0 && is_there(b, q.place) {
                                    nearest = (distance, r.map(|x| x / distance), (a, i), Some((b, j)));
                                }
                            }
                        }
                    }
                }
                let (value, direction, (a, i), other) = nearest;
                for (by, &(shape, number)) in by_variables.iter_mut().zip(&self.wanted) {
                    for (at, sign) in std::iter::once(((a, i), -1.0)).chain(other.map(|other| (other, 1.0))) {
                        if at.0 == shape {
                            let slope = outlines[shape].slopes(&[fine[shape][at.1]], &numbers[shape], number)[0].place;
                            *by += sign * (direction[0] * slope[0].slope + direction[1] * slope[1].slope);
                        }
                    }
                }
                Some(Judged { value, by_variables })
            }
            _ => None,
        }
    }

    /// The particles with their fields, for files and pictures.
    pub(super) fn particle_fields(&self, solution: &Solution) -> ParticleFields {
        let cloud = &self.flow.cloud;
        let (n, inside, fluid) = (cloud.particles(), cloud.places.inside, &self.config.fluid);
        let state = &solution.state.fields;
        let plane = cloud.ground.plane;
        let wrapped: Vec<[f64; 2]> =
            (0..n).map(|i| plane.wrapped([solution.shaped.position[0][i], solution.shaped.position[1][i]])).collect();
        let tag_of = |i: usize| {
            if i < inside {
                return tag::FLUID;
            }
            let condition = solution.shaped.conditions[i - inside];
            match (condition.motion, condition.warmth) {
                (_, Warmth::Given(_)) if self.config.initial.temperature.is_some() => tag::HOT_WALL,
                (Motion::Given([u, v]), _) if u != 0.0 || v != 0.0 => tag::MOVING_WALL,
                _ => tag::WALL,
            }
        };
        ParticleFields {
            dimension: 2,
            box_size: self.config.region.size.clone(),
            position: (0..2).flat_map(|d| wrapped.iter().map(move |p| p[d])).collect(),
            velocity: [state[0].clone(), state[1].clone()].concat(),
            temperature: self
                .config
                .initial
                .temperature
                .is_some()
                .then(|| state[3].iter().map(|t| t + fluid.inlet_temperature).collect()),
            density: vec![fluid.density; n],
            pressure: state[2].iter().map(|p| fluid.density * p).collect(),
            mass: cloud.places.spacing.iter().map(|h| fluid.density * h * h).collect(),
            tag: (0..n).map(tag_of).collect(),
            time: 0.0,
            step: 0,
        }
    }
}

/// The shape and the place among the numbers of its outline of a number.
fn place_of(cloud: &Cloud, number: &ShapeNumber) -> Option<(usize, usize)> {
    let parts: &[Part] = &cloud.ground.outlines.get(number.shape)?.parts;
    Some((number.shape, parts.iter().position(|part| *part == number.part)?))
}

/// Whether a number leaves a surface in place where it comes out of another wall or out of the box.
fn holds_ends(cloud: &Cloud, (shape, number): (usize, usize)) -> bool {
    let Cloud { ground, places, .. } = cloud;
    let outline = &ground.outlines[shape];
    let samples = outline.samples(24);
    let slopes = outline.slopes(&samples, &outline.numbers, number);
    let is_free = |p: [f64; 2]| {
        let is_in = (0..2).all(|d| ground.plane.periodic[d] || (0.0..=ground.plane.size[d]).contains(&p[d]));
        is_in && ground.is_in_wall(&places.polygons, p, Some(shape)).is_none()
    };
    let free: Vec<bool> = slopes.iter().map(|on| is_free(on.place.map(|x| x.value))).collect();
    let stays = |k: usize| slopes[k].place.iter().all(|x| x.slope.abs() < 1e-12);
    let next = |k: usize| (k + 1) % free.len();
    // An end on a wall slides along it.
    let ends = places.stretches.iter().filter(|stretch| stretch.shape == shape).flat_map(|stretch| stretch.ends);
    let sliding: Vec<f64> =
        ends.filter(|end| end.footing != Footing::Nothing).map(|end| end.t.rem_euclid(1.0)).collect();
    let slides = |k: usize| {
        // A sample may be just where the end is.
        let way = |t: f64| (t - samples[k] + ROUNDING).rem_euclid(1.0);
        sliding.iter().any(|&t| way(t) <= way(samples[next(k)]) + ROUNDING)
    };
    let holds = |k: usize| slides(k) || stays(k) && stays(next(k));
    (0..free.len()).filter(|&k| free[k] != free[next(k)]).all(holds)
}

/// What a configuration asks of figures.
pub(super) fn measure_settings<'a, const D: usize>(config: &Config, probes: &'a [[f64; D]]) -> MeasureSettings<'a, D> {
    let balanced = match config.unsteady() {
        None => Balanced::Steady,
        Some(_) if config.has_sound() => Balanced::WithSound,
        Some(_) => Balanced::InTime,
    };
    MeasureSettings { probes, target: config.objective.target_x, balanced }
}

/// The points of all probes of a checked configuration in D dimensions.
pub(super) fn probes<const D: usize>(config: &Config) -> Vec<[f64; D]> {
    let objective = &config.objective;
    let of_terms = objective.terms.iter().map(Term::asked);
    let asked = of_terms.chain([objective.asked()]).chain(config.limits.iter().map(LimitEntry::asked));
    let mut found: Vec<[f64; D]> = vec![];
    for place in asked.filter_map(|asked| asked.at?.try_into().ok()) {
        if !found.contains(&place) {
            found.push(place);
        }
    }
    found
}

/// Probes must be in the fluid or on a wall of it.
fn check_probes(cloud: &Cloud, probes: &[[f64; 2]]) -> Result<(), BadInput> {
    let Ground { plane, dx, surface, far, .. } = cloud.ground;
    if probes.is_empty() {
        return Ok(());
    }
    let places = Nearest::new(plane, dx, &cloud.places.place);
    for probe in probes {
        let near = places.one(*probe, 2.0 * far * dx);
        let is_hidden = cloud.ground.is_in_wall(&cloud.places.polygons, *probe, None).is_some();
        // A point on a round wall is inside of it by rounding.
        if !near.is_some_and(|(distance, _)| !is_hidden || distance < surface) {
            return Err(not_in_fluid(probe));
        }
    }
    Ok(())
}

pub(super) fn not_in_fluid(probe: &[f64]) -> BadInput {
    let problem = format!("the probe at {probe:?} is not in the fluid");
    BadInput::at("objective.at", problem).allowed("points in the fluid or on its walls")
}

/// Two thirds of the spacing, in three digits.
pub fn finer(config: &Config) -> String {
    let dx = config.resolution.dx / 1.5;
    let digits = 10f64.powi(2 - dx.log10().floor() as i32);
    format!("resolution.dx={}", (dx * digits).floor() / digits)
}

pub(super) fn unusable<const D: usize>(config: &Config, why: &Unusable<D>) -> Error {
    let bad = match why {
        Unusable::Placing(Unplaceable::Narrow { shape, width }) if D == 3 => BadInput::at(
            format!("shapes[{shape}]"),
            match *width > 0.0 {
                true => format!("shapes[{shape}] is only {width:.2e} from another shape or a side of the region"),
                false => format!("shapes[{shape}] cuts another shape or a side of the region, or is not in it"),
            },
        )
        .allowed(
            "shapes in the region that are at least a spacing apart, and half of one from its sides; they may stand on sides and reach through them, cylinders and extruded shapes along their axis",
        ),
        Unusable::Placing(Unplaceable::Narrow { shape, width: 0.0 }) => BadInput::at(
            format!("shapes[{shape}]"),
            format!("shapes[{shape}] is as long as the period, so that its ends meet"),
        )
        .allowed("a shorter shape, or a longer one, which is a wall along the whole period"),
        Unusable::Placing(Unplaceable::Narrow { shape, width }) => BadInput::at(
            format!("shapes[{shape}]"),
            format!("shapes[{shape}] is {width:.2e} from another wall, too near for particles in between"),
        )
        .allowed("walls that overlap, or that are at least about a spacing apart"),
        Unusable::Placing(Unplaceable::Thin { shape, width }) => BadInput::at(
            format!("shapes[{shape}]"),
            format!("shapes[{shape}] is about {width:.2e} thick, which is too thin"),
        )
        .allowed(if D == 3 {
            "shapes thicker than resolution.dx"
        } else {
            "shapes that are thicker than a third of resolution.dx"
        }),
        Unusable::Placing(Unplaceable::Full) => {
            BadInput::at("shapes", "the shapes leave hardly any fluid").allowed("a box that is mostly fluid")
        }
        Unusable::Lonely(place) => BadInput::at(
            "shapes",
            format!("the particle at {} has too few neighbours that no wall hides", shown(place)),
        )
        .allowed("shapes that leave room for a few spacings of fluid"),
        Unusable::Parts(place) => BadInput::at(
            "shapes",
            format!("the shapes cut off the fluid around {}, where nothing gives the pressure", shown(place)),
        )
        .allowed("fluid in one piece, or with an outflow in each; inside of hollow shapes other shapes that fill them"),
        Unusable::Folded(place) => BadInput::at(
            "variables",
            format!(
                "the particles around the shapes fold at {}: a shape moved too far, or into another wall",
                shown(place)
            ),
        )
        .allowed("shapes that stay apart, in the box"),
        Unusable::Singular => BadInput::at("shapes", "the particles around the shapes have no map")
            .allowed("shapes that are apart from each other"),
    };
    match why {
        // No spacing helps.
        Unusable::Placing(Unplaceable::Narrow { width: 0.0, shape }) if D == 3 => {
            match config.shapes.get(*shape).is_some_and(|entry| entry.kind == Kind::File) {
                true => bad.advice(format!(
                    "shapes[{shape}].scale=0.001 if its file is in millimetres and the scene in metres"
                )),
                false => bad,
            }
            .into()
        }
        Unusable::Placing(Unplaceable::Narrow { width: 0.0, .. }) | Unusable::Parts(_) => bad.into(),
        _ => bad.advice(finer(config)).into(),
    }
}

/// A place in a message.
fn shown(place: &[f64]) -> String {
    format!("({})", place.iter().map(|x| format!("{x:.4}")).collect::<Vec<String>>().join(", "))
}

/// Error of a step of a flow in time.
pub(super) fn tolerance(config: &Config) -> f64 {
    config.unsteady().map_or(1e-3, |fixed| fixed.tolerance)
}

pub(super) fn no_solution<const D: usize>(config: &Config, why: &NoSolution<D>) -> Error {
    match why {
        NoSolution::Cloud(Unusable::Folded(place)) => Error::diverged(
            format!("the particles fold at {}: a shape moved too far from where they were placed", shown(place)),
            finer(config),
        ),
        NoSolution::Cloud(why) => unusable(config, why),
        NoSolution::Flow(why) => no_flow(config, why),
    }
}

/// Why a flow has no steady state, or left all bounds.
pub(super) fn no_flow(config: &Config, why: &NoSteadyState) -> Error {
    match why {
        NoSteadyState::Singular => {
            Error::diverged("the linearised flow or its temperature has no solution: what drives or holds the fluid, and is a temperature given in each part of it?".to_string(), finer(config))
        }
        NoSteadyState::Diverged { residual } => Error::diverged(
            format!("no steady flow was found: Newton's method ends with a residual of {residual:.1e}, also from a flow of 8 times the viscosity"),
            format!("{}, or fluid.viscosity={}", finer(config), 2.0 * config.fluid.viscosity),
        ),
        NoSteadyState::Unbounded { time } => {
            let advice = if config.has_sound() {
                format!(
                    "method.pressure=incompressible, {}, or fluid.sound_speed_factor={} for a flow as fast as its sound",
                    finer(config),
                    2.0 * config.fluid.sound_speed_factor
                )
            } else if config.time.step.is_some() {
                format!("no time.step, so that steps follow from the flow, or {}", finer(config))
            } else {
                format!("{}, or method.tolerance={:e}", finer(config), 0.1 * tolerance(config))
            };
            Error::diverged(format!("the flow is not finite after t = {time:.4}"), advice)
        }
        NoSteadyState::Unsolved => Error::diverged(
            "the iterations for a step in time did not converge".to_string(),
            format!("{}, or method.tolerance={:e}", finer(config), 0.1 * tolerance(config)),
        ),
        NoSteadyState::Adjoint => {
            Error::diverged("the gradient's equations were not solved".to_string(), finer(config))
        }
    }
}
