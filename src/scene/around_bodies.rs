//! Custom scenes of fixed particles in three dimensions: the steady flow around the bodies of a configuration, its figures and objective.

use super::around_shapes::{check_finite, has_objective, held, no_solution, sides, unusable, Judged, Wall};
use super::custom_shape::OnWall;
use super::particle_fields::ParticleFields;
use crate::config::custom::{Kind, Part, ShapeEntry, ShapeNumber, SideKind};
use crate::config::scene::{Asked, Config, ObjectiveKind};
use crate::error::{BadInput, Error};
use crate::io::stl;
use crate::numerics::threads;
use crate::particles::tag;
use crate::sph::cloud::equations::Warmth;
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::nearest::Region;
use crate::sph::cloud::outline::Outline;
use crate::sph::cloud::space::equations::{Motion, PRESSURE, TEMPERATURE};
use crate::sph::cloud::space::facets::Facets;
use crate::sph::cloud::space::particles::{Cloud, Fluid, Surroundings};
use crate::sph::cloud::space::placing::{BoundaryPoint, Ground};
use crate::sph::cloud::space::problem::{Solution, SteadyFlow};
use crate::sph::cloud::space::surface::{across, Form, Surface};
use serde_json::{json, Value};
use std::path::Path;
use std::sync::Arc;

/// Spacing on surfaces, in dx, if `resolution.surface` does not say it. (In the plane it is a third; here twice the points a
/// length are four times as many.)
const SURFACE: f64 = 0.5;
/// Corners of outlines are rounded to this radius, in spacings of the surface.
const ROUNDED: f64 = 1.0;

/// The steady flow of a configuration.
pub struct AroundBodies {
    pub flow: SteadyFlow,
    config: Config,
    /// Shape and number in its surface of each of `variables`.
    pub wanted: Vec<(usize, usize)>,
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
    fn on(&self, wall: &OnWall, place: [f64; 3], parameters: &[f64]) -> (Motion, Warmth) {
        let (velocity, warmth) = self.wall.at(wall, place, 0.0, parameters);
        (Motion::Given(velocity), warmth)
    }
}

impl Surroundings for Conditions {
    fn condition(&self, point: &BoundaryPoint, place: [f64; 3], numbers: &[Vec<f64>]) -> (Motion, Warmth) {
        if let Some((shape, _)) = point.on {
            return self.on(&self.shapes[shape], place, &numbers[shape][self.geometry[shape]..]);
        }
        let adiabatic = Warmth::Flux(0.0);
        let of = |&side: &usize| match &self.sides[side] {
            None => (Motion::Given([0.0; 3]), adiabatic),
            Some((SideKind::Outflow, _)) => (Motion::Outflow(side / 2), adiabatic),
            Some((SideKind::Symmetry, _)) => (Motion::Symmetry(side / 2), adiabatic),
            Some((_, wall)) => self.on(wall, place, &[]),
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
            Some(whole(Form::Ball, all))
        }
        Kind::Box => {
            Some(whole(Form::Box, [vector(Part::Lower, &entry.lower), vector(Part::Upper, &entry.upper)].concat()))
        }
        Kind::Cylinder => {
            let (axis, centre) = (entry.axis.unwrap_or_default().direction(), entry.centre.as_ref()?);
            let [a, b] = across(axis);
            let disc = ShapeEntry { kind: Kind::Disc, centre: Some(vec![centre[a], centre[b]]), ..entry.clone() };
            let mut column = Surface::column(Outline::new(&disc, rounded)?, axis, region);
            for part in &mut column.parts {
                if let Part::Centre(d) = part {
                    *part = Part::Centre([a, b][*d]);
                }
            }
            Some(column)
        }
        _ => Some(Surface::column(Outline::new(entry, rounded)?, 2, region)),
    }
}

/// The surface of a checked shape whose triangles are in a file.
fn of_triangles(entry: &ShapeEntry, key: &str, file: &str) -> Result<Surface, BadInput> {
    let triangles = stl::read(Path::new(file)).map_err(|error| BadInput::at(key, error.to_string()))?;
    let centre = entry.centre.iter().flatten().enumerate().map(|(d, x)| (Part::Centre(d), *x));
    let own = [(Part::Scale, entry.scale.unwrap_or(1.0)), (Part::Angle, entry.angle.unwrap_or(0.0))];
    let all: Vec<(Part, f64)> = centre.chain(own).collect();
    Ok(with_parameters(entry, Form::Facets(Box::new(Facets::new(triangles))), all))
}

/// A surface with its own numbers and those of the formulas on it.
fn with_parameters(entry: &ShapeEntry, form: Form, mut all: Vec<(Part, f64)>) -> Surface {
    let geometry = all.len();
    all.extend(entry.parameters.iter().enumerate().map(|(k, x)| (Part::Parameter(k), *x)));
    let (parts, numbers) = all.into_iter().unzip();
    Surface { form, parts, numbers, geometry }
}

impl AroundBodies {
    /// The steady flow of a checked configuration, see [`Config::is_around_bodies`].
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(config: &Config) -> Result<Self, Error> {
        let (given, fluid, dx) = (&config.region, &config.fluid, config.resolution.dx);
        let region = Region {
            size: std::array::from_fn(|d| given.size[d]),
            periodic: std::array::from_fn(|d| given.periodic[d]),
        };
        let spacing = config.resolution.surface.unwrap_or(SURFACE * dx).min(dx);
        let mut surfaces = vec![];
        for (k, entry) in config.shapes.iter().enumerate() {
            surfaces.extend(match (entry.kind, &entry.file) {
                (Kind::File, Some(file)) => Some(of_triangles(entry, &format!("shapes[{k}].file"), file)?),
                _ => surface(entry, &region, ROUNDED * spacing),
            });
        }
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
        let flow = SteadyFlow::new(cloud, held, &[], threads).map_err(|why| unusable(config, &why))?;
        Ok(Self { flow, config: config.clone(), wanted })
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The variables of the configuration.
    pub fn first(&self) -> Vec<f64> {
        let numbers = self.flow.cloud.numbers();
        self.wanted.iter().map(|&(shape, k)| numbers[shape][k]).collect()
    }

    fn numbers(&self, variables: &[f64]) -> Vec<Vec<f64>> {
        let mut numbers = self.flow.cloud.numbers();
        self.wanted.iter().zip(variables).for_each(|(&(shape, k), x)| numbers[shape][k] = *x);
        numbers
    }

    /// The steady flow for these variables.
    ///
    /// # Errors
    /// A cloud that folds, and a flow that does not become steady.
    pub fn solve(&mut self, variables: &[f64]) -> Result<Solution, Error> {
        let numbers = self.numbers(variables);
        self.flow.solve(&numbers).map_err(|why| no_solution(&self.config, &why))
    }

    fn unit(&self, figure: Figure) -> f64 {
        let fluid = &self.config.fluid;
        match figure {
            Figure::FlowRate => 1.0,
            Figure::Heat { .. } | Figure::HeatOutflow => fluid.density * fluid.heat_capacity,
            _ => fluid.density,
        }
    }

    fn value(&self, solution: &Solution, figure: Figure) -> f64 {
        self.unit(figure) * self.flow.measures.value(figure, &self.flow.at(solution))
    }

    /// The figures whose sum a kind of objective is.
    fn figures(&self, asked: &Asked) -> Vec<Figure> {
        let all: Vec<usize> = match asked.shapes.as_slice() {
            [] => (0..self.config.shapes.len()).collect(),
            given => given.to_vec(),
        };
        let each = |of: &dyn Fn(usize) -> Figure| all.iter().map(|&shape| of(shape)).collect();
        match asked.kind {
            ObjectiveKind::Drag => each(&|shape| Figure::Force { shape, along: 0 }),
            ObjectiveKind::Lift => each(&|shape| Figure::Force { shape, along: 1 }),
            ObjectiveKind::ShapeHeat => each(&|shape| Figure::Heat { shape }),
            ObjectiveKind::HeatOutflow => vec![Figure::HeatOutflow],
            ObjectiveKind::PressureDrop => vec![Figure::PressureDrop],
            _ => vec![Figure::FlowRate],
        }
    }

    /// The value of a kind of objective, and figures with the derivative of the value by each.
    fn terms(&self, solution: &Solution, asked: &Asked) -> (f64, Vec<(Figure, f64)>) {
        let sum = |kind: ObjectiveKind| -> f64 {
            let asked = Asked { kind, ..asked.clone() };
            self.figures(&asked).iter().map(|&figure| self.value(solution, figure)).sum()
        };
        let part = |kind: ObjectiveKind, weight: f64| -> Vec<(Figure, f64)> {
            let asked = Asked { kind, ..asked.clone() };
            self.figures(&asked).into_iter().map(|figure| (figure, weight * self.unit(figure))).collect()
        };
        match asked.kind {
            ObjectiveKind::LiftOverDrag => {
                let (lift, drag) = (sum(ObjectiveKind::Lift), sum(ObjectiveKind::Drag));
                let by = [part(ObjectiveKind::Lift, 1.0 / drag), part(ObjectiveKind::Drag, -lift / (drag * drag))];
                (lift / drag, by.concat())
            }
            kind => (sum(kind), part(kind, 1.0)),
        }
    }

    /// The objective's value and terms.
    pub fn objective(&self, solution: &Solution) -> (f64, Vec<(Figure, f64)>) {
        let objective = &self.config.objective;
        if objective.terms.is_empty() {
            return self.terms(solution, &objective.asked());
        }
        let mut all = (0.0, vec![]);
        for term in &objective.terms {
            let (value, terms) = self.terms(solution, &term.asked());
            all.0 += term.weight * value;
            all.1.extend(terms.into_iter().map(|(figure, weight)| (figure, term.weight * weight)));
        }
        all
    }

    /// The derivative of weighted figures by the variables.
    ///
    /// # Errors
    /// A transposed system that cannot be solved, and a derivative that is not finite.
    pub fn gradient(&mut self, solution: &Solution, terms: &[(Figure, f64)]) -> Result<Vec<f64>, Error> {
        let wanted = self.wanted.clone();
        let found = self.flow.gradient(solution, terms, &wanted).map_err(|why| no_solution(&self.config, &why))?;
        check_finite(&self.config, &found)?;
        Ok(found)
    }

    /// The objective of a flow, with its derivative by the variables.
    ///
    /// # Errors
    /// Those of [`Self::gradient`].
    pub fn judged(&mut self, solution: &Solution) -> Result<Judged, Error> {
        let (value, terms) = self.objective(solution);
        Ok(Judged { value, by_variables: self.gradient(solution, &terms)? })
    }

    /// The quantity of a limit, with its derivative by the variables.
    ///
    /// # Errors
    /// Those of [`Self::gradient`].
    pub fn judged_limit(&mut self, solution: &Solution, variables: &[f64], limit: usize) -> Result<Judged, Error> {
        let asked = self.config.limits[limit].asked();
        if asked.kind != ObjectiveKind::Volume {
            let (value, terms) = self.terms(solution, &asked);
            return Ok(Judged { value, by_variables: self.gradient(solution, &terms)? });
        }
        let numbers = self.numbers(variables);
        let chosen =
            if asked.shapes.is_empty() { (0..self.config.shapes.len()).collect() } else { asked.shapes.clone() };
        let by_variables = self
            .wanted
            .iter()
            .map(|&(shape, number)| match chosen.contains(&shape) {
                true => self.flow.cloud.volume_of(shape, &numbers[shape], Some(number)).slope,
                false => 0.0,
            })
            .collect();
        let value = chosen.iter().map(|&shape| self.flow.cloud.volume_of(shape, &numbers[shape], None).value).sum();
        Ok(Judged { value, by_variables })
    }

    /// The figures of a flow by name, for its summary.
    pub fn summary(&self, solution: &Solution) -> Vec<(&'static str, Value)> {
        let has_heat = self.config.initial.temperature.is_some();
        let (at, measures, fluid) = (self.flow.at(solution), &self.flow.measures, &self.config.fluid);
        let value = |figure: Figure| self.value(solution, figure);
        let capacity = fluid.density * fluid.heat_capacity;
        let shapes = (0..self.config.shapes.len()).map(|shape| {
            let mut record = serde_json::Map::new();
            let force: Vec<f64> = (0..3).map(|along| value(Figure::Force { shape, along })).collect();
            let of_surface: Vec<f64> =
                (0..3).map(|along| fluid.density * measures.surface_force(&at, shape, along)).collect();
            record.insert("force".into(), json!(force));
            record.insert("force_by_surface".into(), json!(of_surface));
            if has_heat {
                record.insert("heat".into(), json!(value(Figure::Heat { shape })));
                record.insert("heat_by_surface".into(), json!(capacity * measures.surface_heat(&at, shape)));
            }
            Value::Object(record)
        });
        let mut all = vec![
            ("particles", json!(self.flow.cloud.particles())),
            ("flow_rate", json!(value(Figure::FlowRate))),
            ("shapes", shapes.collect::<Value>()),
            ("pressure_drop", json!(value(Figure::PressureDrop))),
            ("body_force", json!(self.config.region.acceleration[0] + solution.state.drive)),
            ("volume", json!(solution.shaped.volume)),
        ];
        if has_heat {
            all.push(("heat_outflow", json!(value(Figure::HeatOutflow))));
        }
        if has_objective(&self.config) {
            all.push(("objective_kind", json!(self.config.objective.kind)));
            all.push(("objective", json!(self.objective(solution).0)));
        }
        let counts = self.flow.solver.counts;
        all.push(("newton_steps", json!(counts.steps)));
        all.push(("iterations", json!(counts.iterations)));
        all.push(("volume_rest", json!(solution.state.lambda)));
        all
    }

    /// The fastest particle.
    pub fn fastest(&self, solution: &Solution) -> f64 {
        let speed = |i: usize| solution.state.velocity(i).iter().map(|u| u * u).sum::<f64>().sqrt();
        (0..self.flow.cloud.particles()).map(speed).fold(0.0, f64::max)
    }

    /// What of the flow rate continuity has left over.
    pub fn rest(&self, solution: &Solution) -> f64 {
        let rate = self.flow.measures.value(Figure::FlowRate, &self.flow.at(solution)).abs();
        let [_, width, depth] = self.flow.cloud.ground.region.size;
        let through = rate.max(0.02 * self.fastest(solution) * width * depth).max(f64::MIN_POSITIVE);
        (solution.state.lambda * solution.shaped.volume / through).abs()
    }

    /// The particles with their fields, for files and pictures.
    pub fn fields(&self, solution: &Solution) -> ParticleFields {
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
