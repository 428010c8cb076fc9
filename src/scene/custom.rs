//! Custom scenes: a box, shapes in it, and forces and temperatures, all from the configuration.
//!
//! The fluid's box has its corner at 0. Sides that are not periodic are closed by as many rows of dummy particles as
//! the kernel reaches. Every particle is in the centre of a lattice cell, and is fluid or wall by the last shape that
//! contains it. Moving walls stay in place ([`crate::sph::flow::Flow::walls_slide`]).

use super::assembly::Parts;
use super::custom_shape::Shape;
use super::distance::{images, Foot, Walls};
use super::exact::Stated;
use super::heated_channel;
use super::lattice::Lattice;
use super::surface::{Dummy, Knows, Point, Surface};
use super::{Exact, Scene};
use crate::config::custom::Fill;
use crate::config::formula::Function;
use crate::config::scene::{Config, GradientMode, HotIsotherm, Interpolation as Mode, Method, ObjectiveKind};
use crate::design::deformation::Map;
use crate::design::diagnostics::Section;
use crate::design::objectives::{Outlet, Samples};
use crate::design::parametrisations::Numbers;
use crate::design::shapes::{self, Shapes};
use crate::design::{Deformation, Problem};
use crate::error::BadInput;
use crate::particles::placer::keep_apart;
use crate::particles::{tag, Domain};
use crate::sph::flow::Heat;
use crate::sph::interpolation::Interpolation;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::buoyancy::Buoyancy;
use crate::sph::{Model, Sweeps};
use std::collections::HashSet;
use std::sync::Arc;

/// The value of a formula at a position, which must be finite.
fn value(function: &Function, key: impl Fn() -> String, p: [f64; 3]) -> Result<f64, BadInput> {
    let value = function.at(p);
    if value.is_finite() {
        return Ok(value);
    }
    let key = key();
    Err(BadInput::at(&key, format!("{key} is {value} at x = {}, y = {}, z = {}", p[0], p[1], p[2]))
        .allowed("a formula that is a finite number at every particle that it is for"))
}

/// The kind of each particle of the lattice.
pub(super) struct Geometry {
    pub lattice: Lattice,
    /// Index of the shape to which each particle belongs, if any.
    pub shape: Vec<Option<usize>>,
    pub is_wall: Vec<bool>,
    /// Indices of the shapes that hold no particle, because they lie outside of the box or behind later shapes.
    pub idle: Vec<usize>,
}

/// Largest number of particles of a finer lattice in which a shape is looked for.
const MOST_TRIED: usize = 2_000_000;
/// A larger shape is suggested before a finer lattice with more particles than this, in two and in three dimensions.
const MANY: [usize; 2] = [50_000, 15_000];

impl Geometry {
    /// The geometry of a checked configuration.
    ///
    /// # Errors
    /// Shapes that leave no fluid, and shapes that are too small for the spacing.
    pub fn of(config: &Config) -> Result<Self, BadInput> {
        let shapes = shapes(config)?;
        let lattice = lattice(config);
        let surroundings = surroundings(config, &shapes);
        let n = lattice.particles();
        let mut shape = vec![None; n];
        let mut is_wall = vec![false; n];
        for i in 0..n {
            let p = lattice.place(i);
            shape[i] = surroundings.shape_at(p);
            is_wall[i] = match shape[i] {
                Some(k) if !lattice.is_wall(i) => shapes[k].entry.fill == Fill::Wall,
                _ => lattice.is_wall(i),
            };
        }
        let idle: Vec<usize> = (0..shapes.len()).filter(|k| !shape.contains(&Some(*k))).collect();
        too_small(config, &surroundings, &idle)?;
        if !is_wall.contains(&false) {
            return Err(BadInput::at("shapes", "the shapes leave no fluid").allowed("some fluid in the box"));
        }
        Ok(Self { lattice, shape, is_wall, idle })
    }
}

/// Refuses those shapes without a particle that a finer lattice would have particles in.
fn too_small(config: &Config, walls: &Walls, idle: &[usize]) -> Result<(), BadInput> {
    let (dx, mut left, mut small) = (config.resolution.dx, idle.to_vec(), vec![]);
    let (mut finest, mut particles) = (dx, 0);
    for parts in [2.0, 4.0, 8.0, 16.0] {
        let mut fine = config.clone();
        fine.resolution.dx = dx / parts;
        let fine = lattice(&fine);
        if left.is_empty() || fine.particles() > MOST_TRIED {
            break;
        }
        let found: HashSet<usize> =
            (0..fine.particles()).filter_map(|i| walls.shape_at(fine.place(i))).filter(|k| left.contains(k)).collect();
        left.retain(|k| !found.contains(k));
        if !found.is_empty() {
            (finest, particles) = (dx / parts, fine.particles());
        }
        small.extend(found);
    }
    small.sort_unstable();
    let Some(first) = small.first() else { return Ok(()) };
    let size = config.support() * dx;
    let sizes = small.iter().map(|&k| Some(format!("shapes[{k}].{}", walls.shapes[k].entry.at_least(k, size)?)));
    let sizes = sizes.collect::<Option<Vec<String>>>().map(|sizes| sizes.join(" "));
    let bears = match config.method {
        Method::Consistent(_) => " with method.name=standard (it bears thin walls)",
        _ => "",
    };
    let finer = format!("resolution.dx={finest}{bears}");
    Err(BadInput::at(
        format!("shapes[{first}]"),
        format!("shapes[{first}] is too small or too thin: it holds no particle"),
    )
    .allowed("shapes that hold the middle of at least one cell")
    .advice(match sizes {
        Some(sizes) if particles > MANY[config.dimension() - 2] => format!("{sizes}, or {finer}"),
        Some(sizes) => format!("{finer}, or {sizes}"),
        None => finer,
    }))
}

pub(super) fn shapes(config: &Config) -> Result<Vec<Shape<'_>>, BadInput> {
    let d = config.dimension();
    config.shapes.iter().enumerate().map(|(k, entry)| Shape::new(entry, k, d)).collect()
}

pub(super) fn lattice(config: &Config) -> Lattice {
    let (d, dx, region) = (config.dimension(), config.resolution.dx, &config.region);
    let rows = config.wall_rows();
    let walls: [usize; 3] = std::array::from_fn(|e| if e < d && !region.periodic[e] { rows } else { 0 });
    let count = |e: usize| if e < d { (region.size[e] / dx).round() as usize } else { 1 };
    let periodic = std::array::from_fn(|e| e < d && region.periodic[e]);
    Lattice::between(walls, d, dx, std::array::from_fn(count), periodic)
}

/// The scene of a checked configuration.
///
/// # Errors
/// Formulas that are not finite somewhere, and shapes that contain nothing.
pub(super) fn build<R: Sweeps>(config: &Config) -> Result<Scene<R>, BadInput> {
    let Built { parts, model, base, .. } = assemble(config)?;
    let section = section(config, &model);
    Ok(Scene { section, ..parts.started(model, &base) })
}

/// Where and when the flow is measured: as the objective is, or over the last quarter of a run that is shorter than the
/// objective's window.
fn section<R: Sweeps>(config: &Config, model: &Model<R>) -> Option<Section> {
    let steps = config.steps();
    let outlet = config.flows_through().then(|| outlet(config, model));
    let window = match config.objective.window > config.duration() {
        true => steps.div_ceil(4),
        false => heated_channel::window(config),
    };
    let samples = Samples::window(steps, window, config.objective.samples);
    let steps = samples.0.into_keys().collect();
    (outlet.is_some() || config.has_heat()).then(|| Section { outlet, depth: config.depth(), steps })
}

/// The design problem of a checked configuration with `variables`.
pub(super) fn problem<R: Sweeps>(config: &Config) -> Result<Problem<R>, BadInput> {
    // Only optimised runs use the window, so others may be shorter.
    config.check_window()?;
    let Built { mut model, base, points, dummies, .. } = assemble::<R>(config)?;
    if config.objective.kind == ObjectiveKind::WallHeat {
        model = model.with(|flow| flow.wall_heat_until = Some(config.objective.target_x));
    }
    let parametrisation = Numbers::of_config(config);
    let shapes = Shapes {
        entries: config.shapes.clone(),
        domain: model.domain,
        vector: model.rows.velocity(),
        points,
        dummies,
        fluid: (0..model.particles()).filter(|&i| model.is_fluid(i)).collect(),
        numbers: config.shape_numbers(),
    };
    let (columns, particles) = (shapes.numbers.len(), model.particles());
    let base = super::assembly::rounded(&model, &base).into_iter().map(R::f64).collect();
    let deformation = Arc::new(Deformation { columns, base, particles, map: Map::Shapes(shapes) });
    let (outlet, first) = (outlet(config, &model), parametrisation.start());
    let problem = heated_channel::problem(config, model, deformation, Arc::new(parametrisation), first, outlet)?;
    let members = match config.optimise.gradient {
        GradientMode::Ensemble => members(config)?,
        _ => vec![],
    };
    Ok(Problem { smoothing: 0.0, members, ..problem })
}

/// The further members of an ensemble: the same problem from other starts, which no other seed of a few digits has.
fn members<R: Sweeps>(config: &Config) -> Result<Vec<Problem<R>>, BadInput> {
    let mut config = config.clone();
    config.optimise.gradient = GradientMode::Differences;
    let count = config.optimise.members;
    let another = |_| {
        config.run.seed = config.run.seed.wrapping_add(1 << 32);
        problem(&config)
    };
    (1..count).map(another).collect()
}

/// Targets across the box and three spacings beyond its walls, so that each particle counts with its whole kernel.
fn outlet<R: Sweeps>(config: &Config, model: &Model<R>) -> Outlet {
    let (d, dx, region) = (config.dimension(), config.resolution.dx, &config.region);
    let across = |e: usize| -> Vec<f64> {
        if e >= d {
            return vec![0.0];
        }
        let (count, beyond) = ((region.size[e] / dx).round() as i64, if region.periodic[e] { 0 } else { 3 });
        (-beyond..count + beyond).map(|k| (k as f64 + 0.5) * dx).collect()
    };
    let places = across(2).into_iter().flat_map(|z| across(1).into_iter().map(move |y| (y, z)));
    let targets = places.map(|(y, z)| [config.objective.target_x, y, z]).collect();
    let (kernel, domain, kernels) = (model.kernel, model.domain, config.run.kernels);
    let interpolation = Interpolation { kernel, domain, targets: Arc::new(targets), kernels };
    let spacing = if d == 3 { dx * dx / config.depth() } else { dx };
    Outlet { interpolation, mode: Mode::Flux, spacing }
}

/// The particles of a configuration, and those that move with its shapes.
struct Built<R> {
    parts: Parts<R>,
    model: Model<R>,
    base: Vec<f64>,
    points: Vec<shapes::Point>,
    dummies: Vec<shapes::Dummy>,
}

fn assemble<R: Sweeps>(config: &Config) -> Result<Built<R>, BadInput> {
    if config.is_around_shapes() {
        return Err(BadInput::at(
            "method.name",
            "fixed particles around shapes have a steady flow and no steps in time",
        )
        .allowed("simulate, check-gradient and optimize with them; for other commands a method whose particles move")
        .advice("method.name=consistent"));
    }
    let (d, fluid, region) = (config.dimension(), &config.fluid, &config.region);
    let Geometry { lattice, shape, is_wall, .. } = Geometry::of(config)?;
    let (shapes, n) = (shapes(config)?, lattice.particles());
    let (initial, warmth) = config.initial.at_start(d)?;
    let reference = fluid.inlet_temperature;
    let consistent = match config.method {
        Method::Consistent(own) => Some(own),
        _ => None,
    };
    let surroundings = surroundings(config, &shapes);
    // Walls have a velocity, and T_wall = constant + factor <T>.
    let mut of_wall = vec![[0.0; 3]; n];
    let (mut constant, mut factor) = (vec![R::default(); n], vec![R::of(1.0); n]);
    let mut tags = vec![tag::FLUID; n];
    for i in (0..n).filter(|&i| is_wall[i]) {
        tags[i] = tag::WALL;
        let Some(k) = shape[i] else { continue };
        let p = lattice.place(i);
        if let Some(temperature) = &shapes[k].on_wall.temperature {
            let excess = value(temperature, || format!("shapes[{k}].temperature"), p)? - reference;
            let (a, b) = match config.wall.hot_isotherm {
                HotIsotherm::Surface => (2.0 * excess, -1.0),
                HotIsotherm::Dummy => (excess, 0.0),
            };
            (constant[i], factor[i], tags[i]) = (R::of(a), R::of(b), tag::HOT_WALL);
        }
        for (e, velocity) in shapes[k].on_wall.velocity.iter().enumerate() {
            of_wall[i][e] = value(velocity, || format!("shapes[{k}].velocity[{e}]"), p)?;
        }
        if of_wall[i] != [0.0; 3] {
            tags[i] = tag::MOVING_WALL;
        }
    }
    let heat = warmth.as_ref().map(|_| Heat {
        conductivity: fluid.conductivity,
        capacity: fluid.heat_capacity,
        reference,
        // No particle is outside of the box, so these limits switch inlet and outlet off.
        inlet_below: region.inlet_until.unwrap_or(-region.size[0]),
        outlet_above: region.outlet_from.unwrap_or(2.0 * region.size[0]),
        wall_constant: constant,
        wall_factor: factor,
        materials: None,
    });
    let mut acceleration = [0.0; 3];
    acceleration[..d].copy_from_slice(&region.acceleration);
    let mut parts = Parts {
        body_force: if acceleration == [0.0; 3] { BodyForce::None } else { BodyForce::Gravity(acceleration) },
        buoyancy: Buoyancy::new(fluid.expansion, &region.acceleration, config.neutral_temperature()),
        heat,
        exact: stated(config)?,
        ..Parts::new(config, lattice)
    };
    let (mut model, mut base) = parts.assemble(|_| [0.0; 3]);
    (model.flow.tags, model.flow.walls_slide) = (tags, true);
    let l = model.layout;
    if consistent.is_some() {
        let fluid: Vec<usize> = (0..n).filter(|&i| !is_wall[i]).collect();
        let mut places: Vec<f64> =
            (0..d).flat_map(|e| fluid.iter().map(move |&i| (e, i))).map(|(e, i)| base[e * n + i]).collect();
        let (distance, normal) = (|p| surroundings.distance(p), |p| surroundings.normal(p));
        keep_apart(&mut places, &surroundings.domain, config.resolution.dx, distance, normal)
            .map_err(|error| BadInput::at("shapes", format!("particles cannot be placed: {error}")))?;
        for (k, &i) in fluid.iter().enumerate() {
            (0..d).for_each(|e| base[e * n + i] = places[e * fluid.len() + k]);
        }
    }
    for i in 0..n {
        let place = parts.lattice.place(i);
        if is_wall[i] {
            // Restores a wall particle's position, whose cell may have been displaced as fluid.
            for e in 0..d {
                base[e * n + i] = place[e];
                base[(l.velocity() + e) * n + i] = of_wall[i][e];
            }
            continue;
        }
        let p = std::array::from_fn(|e| if e < d { base[e * n + i] } else { 0.0 });
        for (e, velocity) in initial.iter().enumerate() {
            base[(l.velocity() + e) * n + i] = value(velocity, || format!("initial.velocity[{e}]"), p)?;
        }
        if let Some(warmth) = &warmth {
            base[l.temperature() * n + i] = value(warmth, || "initial.temperature".into(), p)? - reference;
        }
    }
    let (mut points, mut dummies) = (vec![], vec![]);
    if let Some(own) = consistent {
        let (surface, feet) = surface_of(&surroundings, &parts.lattice, &is_wall, |foot| {
            knows_at(config, &surroundings, foot, warmth.is_some())
        })?;
        let old = base;
        let (fitted, mut base) = parts.with_surface(model, &old, &surface, own);
        if warmth.is_some() {
            let more = fitted.particles();
            let fluid = (0..n).filter(|&i| !is_wall[i]);
            fluid.for_each(|i| base[fitted.layout.temperature() * more + i] = old[l.temperature() * n + i]);
        }
        // A scene without variables does not need the feet.
        let [of_points, of_dummies] = if config.variables.is_empty() { [vec![], vec![]] } else { feet };
        for (k, (point, foot)) in surface.points.iter().zip(&of_points).enumerate() {
            let (leans, leads) = (point.knows == Knows::NoHeatFlux, matches!(point.knows, Knows::Velocity(_)));
            points.push(shapes::Point { particle: n + k, on: surroundings.on(foot), leans, leads });
        }
        for (dummy, foot) in surface.dummies.iter().zip(&of_dummies) {
            let on = surroundings.on(foot);
            let depth = -surroundings.distance(parts.lattice.place(dummy.particle));
            dummies.extend(on.map(|foot| shapes::Dummy { particle: dummy.particle, foot, depth }));
        }
        return Ok(Built { parts, model: Model::new(fitted), base, points, dummies });
    }
    Ok(Built { parts, model: Model::new(model), base, points, dummies })
}

/// The exact solution that a configuration states, if it states one.
fn stated(config: &Config) -> Result<Exact, BadInput> {
    let (velocity, temperature) = config.exact.of_time(config.dimension())?;
    if velocity.is_empty() && temperature.is_none() {
        return Ok(Exact::Unknown);
    }
    let temperature = temperature.map(|of| (of, config.fluid.inlet_temperature));
    Ok(Exact::Stated(Arc::new(Stated { velocity, temperature, reference_velocity: config.fluid.reference_velocity })))
}

/// The walls as surfaces, in the box without the rows that close it.
pub(super) fn surroundings<'a>(config: &Config, shapes: &'a [Shape<'a>]) -> Walls<'a> {
    let (dimension, region) = (config.dimension(), &config.region);
    let domain = Domain {
        dimension,
        size: std::array::from_fn(|d| if d < dimension { region.size[d] } else { 1.0 }),
        periodic: std::array::from_fn(|d| d < dimension && region.periodic[d]),
    };
    Walls { shapes, images: images(&domain), domain, spacing: config.resolution.dx }
}

/// The conditions at a surface point by the wall behind it.
fn knows_at(config: &Config, walls: &Walls, foot: &Foot, has_heat: bool) -> Result<Vec<Knows>, BadInput> {
    let (moves, wall) = wall_at(walls, foot)?;
    let formula = wall.and_then(|k| Some((k, walls.shapes[k].on_wall.temperature.as_ref()?)));
    let temperature =
        formula.map(|(k, formula)| value(formula, || format!("shapes[{k}].temperature"), foot.place)).transpose()?;
    let warmth = temperature.map_or(Knows::NoHeatFlux, |t| Knows::Temperature(t - config.fluid.inlet_temperature));
    Ok([Knows::Velocity(moves)].into_iter().chain(has_heat.then_some(warmth)).collect())
}

/// The velocity of the wall at a foot and the shape that the wall is, if it is one.
pub(super) fn wall_at(walls: &Walls, foot: &Foot) -> Result<([f64; 3], Option<usize>), BadInput> {
    let behind = walls.beside(foot, -0.25 * walls.spacing);
    let wall = walls.shape_at(behind).filter(|&k| walls.shapes[k].entry.fill == Fill::Wall);
    let mut moves = [0.0; 3];
    for (e, velocity) in wall.iter().flat_map(|&k| &walls.shapes[k].on_wall.velocity).enumerate() {
        moves[e] = value(velocity, || format!("shapes[{}].velocity[{e}]", wall.unwrap_or_default()), foot.place)?;
    }
    Ok((moves, wall))
}

/// Points on the walls' surface and the dummy particles behind it, and the feet of both.
fn surface_of(
    walls: &Walls,
    lattice: &Lattice,
    is_wall: &[bool],
    knows: impl Fn(&Foot) -> Result<Vec<Knows>, BadInput>,
) -> Result<(Surface, [Vec<Foot>; 2]), BadInput> {
    let dx = walls.spacing;
    let near = |i: usize| walls.distance(lattice.place(i)).abs() <= dx;
    let all = 0..lattice.particles();
    // Points of fluid particles come first; along a plane wall they leave no room for points of wall particles.
    let beside = all.clone().filter(|&i| !is_wall[i] && near(i)).chain(all.clone().filter(|&i| is_wall[i] && near(i)));
    let feet = walls.points(beside.map(|i| lattice.place(i)));
    let (mut surface, mut of_points, mut of_dummies) = (Surface::default(), vec![], vec![]);
    let mut first = Vec::with_capacity(feet.len());
    for foot in &feet {
        first.push(surface.points.len());
        for knows in knows(foot)? {
            surface.points.push(Point { position: foot.place, normal: foot.normal, knows });
            of_points.push(*foot);
        }
    }
    let nearest = walls.finder(&feet);
    for i in all.filter(|&i| is_wall[i]) {
        let p = lattice.place(i);
        let Some(foot) = walls.foot(p) else { continue };
        let Some(point) = nearest(foot.place) else { continue };
        let mirror = std::array::from_fn(|e| 2.0 * foot.place[e] - p[e]);
        surface.dummies.push(Dummy { particle: i, point: first[point], mirror });
        of_dummies.push(foot);
    }
    Ok((surface, [of_points, of_dummies]))
}
