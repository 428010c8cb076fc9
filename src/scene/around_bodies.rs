//! Custom scenes of fixed particles in three dimensions: the bodies of a configuration, and what holds on them.

use super::around_shapes::{held, measure_settings, not_in_fluid, probes, sides, unusable, Wall};
use super::custom_shape::OnWall;
use super::particle_fields::ParticleFields;
use crate::config::custom::{Kind, Part, ShapeEntry, ShapeNumber, SideKind};
use crate::config::scene::Config;
use crate::error::{BadInput, Error};
use crate::io::stl;
use crate::numerics::memory::give_back_freed;
use crate::numerics::threads;
use crate::particles::tag;
use crate::sph::cloud::equations::Warmth;
use crate::sph::cloud::nearest::Region;
use crate::sph::cloud::outline::Outline;
use crate::sph::cloud::particles::Fluid;
use crate::sph::cloud::space::equations::{Motion, PRESSURE, TEMPERATURE};
use crate::sph::cloud::space::facets::Facets;
use crate::sph::cloud::space::particles::{Cloud, Surroundings};
use crate::sph::cloud::space::placing::{BoundaryPoint, Ground};
use crate::sph::cloud::space::problem::{Solution, SteadyFlow};
use crate::sph::cloud::space::surface::{across, Form, Standing, Surface};
use crate::sph::laws::buoyancy::Buoyancy;
use std::path::Path;
use std::sync::Arc;

/// Spacing on surfaces, in dx, if `resolution.surface` does not say it. (In the plane it is a third; here twice the points a
/// length are four times as many.)
const SURFACE: f64 = 0.5;
/// Corners of outlines are rounded to this radius, in spacings of the surface.
const ROUNDED: f64 = 1.0;

/// The flow of a configuration.
pub struct AroundBodies {
    pub flow: SteadyFlow,
    config: Config,
    /// The points of probes.
    pub(super) probes: Vec<[f64; 3]>,
    /// Shape and number in its surface of each of `variables`.
    pub wanted: Vec<(usize, usize)>,
    /// Whether the derivative of a flow in time is wanted by the viscosity, too.
    pub by_viscosity: bool,
}

/// Conditions on walls, by formulas.
#[derive(Debug)]
struct Conditions {
    shapes: Vec<OnWall>,
    sides: [Option<(SideKind, OnWall)>; 6],
    /// How many numbers of each shape are its surface's.
    geometry: Vec<usize>,
    wall: Wall,
}

impl Conditions {
    fn on(&self, wall: &OnWall, place: [f64; 3], time: f64, parameters: &[f64]) -> (Motion, Warmth) {
        let (velocity, warmth) = self.wall.at(wall, place, time, parameters);
        (Motion::Given(velocity), warmth)
    }
}

impl Surroundings for Conditions {
    fn condition(&self, point: &BoundaryPoint, place: [f64; 3], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth) {
        if let Some((shape, _)) = point.on {
            return self.on(&self.shapes[shape], place, time, &numbers[shape][self.geometry[shape]..]);
        }
        let adiabatic = Warmth::Flux(0.0);
        let of = |&side: &usize| match &self.sides[side] {
            None => (Motion::Given([0.0; 3]), adiabatic),
            Some((SideKind::Outflow, _)) => (Motion::Outflow(side / 2), adiabatic),
            Some((SideKind::Symmetry, _)) => (Motion::Symmetry(side / 2), adiabatic),
            Some((_, wall)) => self.on(wall, place, time, &[]),
        };
        let all = || point.sides.iter().map(of);
        // On an edge: what is given counts more than what follows, and an inflow or moving wall more than a wall at rest.
        let rank = |motion: &Motion| match motion {
            Motion::Given(u) => {
                if u.iter().any(|u| *u != 0.0) {
                    2
                } else {
                    3
                }
            }
            Motion::Symmetry(_) => 1,
            Motion::Outflow(_) => 0,
        };
        let motion = all().map(|found| found.0).max_by_key(rank).unwrap_or(Motion::Given([0.0; 3]));
        let given = all().map(|found| found.1).find(|warmth| matches!(warmth, Warmth::Given(_)));
        (motion, given.or_else(|| all().map(|found| found.1).next()).unwrap_or(adiabatic))
    }

    fn varies(&self, shape: usize) -> bool {
        self.shapes[shape].varies()
    }

    fn has_time(&self) -> bool {
        let sides = self.sides.iter().flatten().map(|(_, wall)| wall);
        self.shapes.iter().chain(sides).any(OnWall::has_time)
    }
}

fn values(numbers: &[(Part, f64)]) -> Vec<f64> {
    numbers.iter().map(|(_, x)| *x).collect()
}

/// The surface of a checked shape.
fn surface(entry: &ShapeEntry, region: &Region<3>, rounded: f64) -> Option<Surface> {
    let vector = |of: fn(usize) -> Part, numbers: &Option<Vec<f64>>| -> Vec<(Part, f64)> {
        numbers.iter().flatten().enumerate().map(|(k, x)| (of(k), *x)).collect()
    };
    let whole = |form: Form, all: Vec<(Part, f64)>| with_parameters(entry, form, all);
    match entry.kind {
        Kind::Disc => {
            let mut all = vector(Part::Centre, &entry.centre);
            all.push((Part::Radius, entry.radius?));
            Some(whole(Form::Ball(Standing::of_ball(region, &values(&all))), all))
        }
        Kind::Box => {
            let all = [vector(Part::Lower, &entry.lower), vector(Part::Upper, &entry.upper)].concat();
            Some(whole(Form::Box(Standing::of_box(region, &values(&all))), all))
        }
        Kind::Cylinder => {
            let (axis, centre) = (entry.axis.unwrap_or_default().direction(), entry.centre.as_ref()?);
            let [a, b] = across(axis);
            let disc = ShapeEntry { kind: Kind::Disc, centre: Some(vec![centre[a], centre[b]]), ..entry.clone() };
            let mut column = Surface::column(Outline::new(&disc, rounded)?, axis, entry.ends.as_deref(), region);
            for part in &mut column.parts {
                if let Part::Centre(d) = part {
                    *part = Part::Centre([a, b][*d]);
                }
            }
            Some(column)
        }
        _ => Some(Surface::column(Outline::new(entry, rounded)?, 2, entry.ends.as_deref(), region)),
    }
}

/// The surface of a checked shape whose triangles are in a file.
fn of_triangles(entry: &ShapeEntry, key: &str, file: &str, region: &Region<3>) -> Result<Surface, BadInput> {
    let triangles = stl::read(Path::new(file)).map_err(|error| BadInput::at(key, error.to_string()))?;
    let centre = entry.centre.iter().flatten().enumerate().map(|(d, x)| (Part::Centre(d), *x));
    let own = [(Part::Scale, entry.scale.unwrap_or(1.0)), (Part::Angle, entry.angle.unwrap_or(0.0))];
    let all: Vec<(Part, f64)> = centre.chain(own).collect();
    let facets = Facets::new(triangles);
    let standing = Standing::of_facets(region, &facets, &values(&all));
    Ok(with_parameters(entry, Form::Facets(Box::new(facets), standing), all))
}

/// A surface with its own numbers and those of the formulas on it.
fn with_parameters(entry: &ShapeEntry, form: Form, mut all: Vec<(Part, f64)>) -> Surface {
    let geometry = all.len();
    all.extend(entry.parameters.iter().enumerate().map(|(k, x)| (Part::Parameter(k), *x)));
    let (parts, numbers) = all.into_iter().unzip();
    Surface { form, parts, numbers, geometry }
}

/// What a surface cannot be, or cannot become by its variables, where it stands.
fn check_surfaces(config: &Config, surfaces: &[Surface]) -> Result<(), BadInput> {
    if let Some(shape) = surfaces.iter().position(|surface| !surface.has_seen_ends()) {
        let key = format!("shapes[{shape}].ends");
        return Err(BadInput::at(
            &key,
            format!("{key}: not all of its outline is seen from the centroid of its section"),
        )
        .allowed("outlines that are; any shape that goes through the whole box, without ends"));
    }
    if let Some(shape) = surfaces.iter().position(Surface::is_ball_in_edge) {
        return Err(BadInput::at(
            format!("shapes[{shape}]"),
            format!("shapes[{shape}] is a ball that goes through sides of the region which are not opposite"),
        )
        .allowed("balls through one side, or two opposite ones; any others as triangles, with kind = \"file\""));
    }
    for (k, number) in config.shape_numbers().iter().enumerate() {
        let surface = surfaces.get(number.shape);
        let is_held = |d: usize| surface.is_some_and(|surface| surface.is_held_along(d));
        let is_behind = match number.part {
            Part::Centre(d) => is_held(d),
            Part::Angle => is_held(0) || is_held(1),
            Part::Scale => (0..3).any(is_held),
            _ => false,
        };
        if is_behind {
            let key = format!("variables[{k}].number");
            return Err(BadInput::at(
                &key,
                format!("{key} = \"{number}\" moves what of the shape is behind the sides that it stands on"),
            )
            .allowed("of such shapes from files the centre along the sides, and the angle if these are across z"));
        }
    }
    Ok(())
}

impl AroundBodies {
    /// The flow of a checked configuration, see [`Config::is_around_bodies`].
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(config: &Config) -> Result<Self, Error> {
        give_back_freed();
        let (given, fluid, dx) = (&config.region, &config.fluid, config.resolution.dx);
        let region = Region {
            size: std::array::from_fn(|d| given.size[d]),
            periodic: std::array::from_fn(|d| given.periodic[d]),
        };
        let spacing = config.resolution.surface.unwrap_or(SURFACE * dx).min(dx);
        let mut surfaces = vec![];
        for (k, entry) in config.shapes.iter().enumerate() {
            surfaces.extend(match (entry.kind, &entry.file) {
                (Kind::File, Some(file)) => Some(of_triangles(entry, &format!("shapes[{k}].file"), file, &region)?),
                _ => surface(entry, &region, ROUNDED * spacing),
            });
        }
        check_surfaces(config, &surfaces)?;
        let read = config.wall_formula();
        let shapes = config.shapes.iter().enumerate().map(|(k, entry)| OnWall::of_shape(k, entry, 3, read));
        let conditions = Conditions {
            shapes: shapes.collect::<Result<_, BadInput>>()?,
            sides: sides(config, 3)?,
            geometry: surfaces.iter().map(|surface| surface.geometry).collect(),
            wall: Wall::of_config(config),
        };
        let materials = Fluid {
            viscosity: config.kinematic_viscosity(),
            diffusivity: config.initial.temperature.as_ref().map(|_| config.thermal_diffusivity()),
            force: std::array::from_fn(|d| given.acceleration[d]),
            buoyancy: Buoyancy::new(fluid.expansion, &given.acceleration, config.neutral_temperature()),
            velocity: fluid.reference_velocity,
        };
        let held = held(config);
        let ground = Ground { region, dx, surface: spacing, surfaces };
        let threads = threads::count();
        let cloud =
            Cloud::new(ground, materials, Arc::new(conditions), threads).map_err(|why| unusable(config, &why))?;
        let mut wanted = vec![];
        for (k, number) in config.shape_numbers().iter().enumerate() {
            let found = place_of(&cloud, number).ok_or_else(|| {
                let key = format!("variables[{k}].number");
                BadInput::at(&key, format!("{key} = \"{number}\" does not change the shape"))
                    .allowed("numbers that the surface depends on; of a cylinder not its centre along its axis")
            })?;
            wanted.push(found);
        }
        let probes = probes(config);
        // A point on a round wall is inside of it by rounding.
        if let Some(probe) = probes.iter().find(|probe| cloud.ground.distance(**probe, None) < -0.5 * spacing) {
            return Err(not_in_fluid(probe).into());
        }
        let settings = measure_settings(config, &probes);
        let flow = SteadyFlow::new(cloud, held, settings, threads).map_err(|why| unusable(config, &why))?;
        Ok(Self { flow, config: config.clone(), probes, wanted, by_viscosity: false })
    }

    pub fn config(&self) -> &Config {
        &self.config
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

    /// The particles with their fields, for files and pictures.
    pub(super) fn particle_fields(&self, solution: &Solution) -> ParticleFields {
        let cloud = &self.flow.cloud;
        let (n, inside, fluid) = (cloud.particles(), cloud.places.inside, &self.config.fluid);
        let (state, position) = (&solution.state.fields, &solution.shaped.position);
        let place = |i: usize| cloud.ground.region.wrapped(std::array::from_fn(|d| position[d][i]));
        let places: Vec<[f64; 3]> = (0..n).map(place).collect();
        let has_heat = self.config.initial.temperature.is_some();
        let tag_of = |i: usize| match i.checked_sub(inside).map(|k| solution.shaped.conditions[k]) {
            None => tag::FLUID,
            Some(condition) => match (condition.motion, condition.warmth) {
                (_, Warmth::Given(_)) if has_heat => tag::HOT_WALL,
                (Motion::Given(u), _) if u != [0.0; 3] => tag::MOVING_WALL,
                _ => tag::WALL,
            },
        };
        ParticleFields {
            dimension: 3,
            box_size: self.config.region.size.clone(),
            position: (0..3).flat_map(|d| places.iter().map(move |p| p[d])).collect(),
            velocity: state[..3].concat(),
            temperature: has_heat.then(|| state[TEMPERATURE].iter().map(|t| t + fluid.inlet_temperature).collect()),
            density: vec![fluid.density; n],
            pressure: state[PRESSURE].iter().map(|p| fluid.density * p).collect(),
            mass: cloud.places.spacing.iter().map(|h| fluid.density * h.powi(3)).collect(),
            tag: (0..n).map(tag_of).collect(),
            time: 0.0,
            step: 0,
        }
    }
}

fn place_of(cloud: &Cloud, number: &ShapeNumber) -> Option<(usize, usize)> {
    let parts = &cloud.ground.surfaces.get(number.shape)?.parts;
    Some((number.shape, parts.iter().position(|part| *part == number.part)?))
}
