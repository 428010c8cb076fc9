//! The heated channel: a periodic channel driven by a body force, with a hot section in its bottom wall.
//!
//! Coordinates: x along the channel, y = 0 on the surface of the undeformed bottom wall, fluid in 0 < y < H, three rows
//! of dummy particles below and above; in three dimensions z across the flow, with periodicity. Particles are on a
//! lattice in rows from the bottom, x fastest, and in layers along z.

use super::assembly::Parts;
use super::lattice::Lattice;
use super::over_relief;
use super::surface::{self, Dummy, Knows, Point, Rows};
use super::Scene;
use crate::config::scene::{
    self, BodyForceRegion, Config, DesignWalls, DriveName, GradientMode, HotIsotherm, Interpolation as Mode,
    KernelName, MassConvention, Method, ObjectiveKind, Start,
};
use crate::design::deformation::{self, Columns, Map};
use crate::design::objectives::{self, Figure, Outlet, Samples};
use crate::design::parametrisations::{first_column, SplineSurface};
use crate::design::relief::Relief;
use crate::design::shape::{HotSection, Shape};
use crate::design::{parametrisations, start_shape, Deformation, Parametrisation, Problem};
use crate::error::{BadInput, Error};
use crate::particles::tag;
use crate::sph::consistent::Consistent;
use crate::sph::fixed::{Channel, Fixed, FixedParticles};
use crate::sph::flow::Heat;
use crate::sph::interpolation::Interpolation;
use crate::sph::kernels::Kernel;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::drive::Drive;
use crate::sph::standard::Standard;
use crate::sph::{Model, Sweeps};
use std::ops::Range;
use std::sync::Arc;

/// The channel of a checked configuration, with its initial shape.
pub(super) fn build<R: Sweeps>(config: &Config) -> Result<Scene<R>, Error> {
    let lattice = lattice(config);
    let share = HotSection::of(config).share();
    let hot = |i: usize| if lattice.is_below(i, 1) { share[lattice.rows(i)[0]] } else { 0.0 };
    let hot: Vec<f64> = (0..lattice.particles()).map(hot).collect();
    let mut parts = Parts {
        body_force: body_force(config),
        drive: drive(config),
        own_mass: config.wall.mass == MassConvention::ColumnArea && config.method.facts().wall_cells,
        heat: Some(heat(config, &hot)),
        ..Parts::new(config, lattice)
    };
    let (mut model, mut base) = parts.assemble(|place| start_velocity(config, place));
    model.flow.section = Some(config.objective.target_x);
    if config.objective.kind == ObjectiveKind::WallHeat {
        model.flow.wall_heat_until = Some(config.objective.target_x);
    }
    let (n, l) = (model.particles(), model.layout);
    for i in (0..n).filter(|&i| hot[i] > 0.0) {
        model.flow.tags[i] = tag::HOT_WALL;
        base[l.temperature() * n + i] = config.wall.hot_temperature - config.fluid.inlet_temperature;
    }
    if l.mass {
        base[l.state_mass() * n..][..n].fill(model.mass);
    }
    let (model, deformation) = match config.method {
        Method::Standard(_) => {
            let deformation = deformation(config, &parts.lattice, &model, base);
            (Model::new(model), deformation)
        }
        Method::Fixed(_) if config.dimension() == 3 => {
            let (model, deformation) = over_relief::fixed(config, &parts, model, |place| start_velocity(config, place));
            (Model::new(model), deformation)
        }
        Method::Fixed(own) => {
            let (model, deformation) = fixed(config, &parts, model, own.pressure_diffusion)?;
            (Model::new(model), deformation)
        }
        Method::Consistent(own) => {
            let (model, deformation) = consistent(config, &parts, model, base, own);
            (Model::new(model), deformation)
        }
    };
    let deformation = Arc::new(deformation);
    let (parametrisation, first): (Arc<dyn Parametrisation>, _) = match &deformation.map {
        Map::Relief(relief) => {
            let surface = SplineSurface::of_config(config, &relief.places);
            let first = start_shape::control_points(config, &surface)?;
            (Arc::new(surface), first)
        }
        _ => parametrisations::of_config(config, &Shape::from_config(config)?)?,
    };
    let outlet = outlet(config, &model);
    let design = problem(config, model, deformation, parametrisation, first, outlet)?;
    let (model, start) = (design.model.clone(), design.start(&design.first));
    Ok(Scene { design: Some(design), ..parts.scene(model, start) })
}

/// Number of steps in the objective's window, at most those of the run.
pub(super) fn window(config: &Config) -> usize {
    ((config.objective.window / config.time_step()).round() as usize).clamp(1, config.steps())
}

/// The design problem of a model and its deformation.
pub(super) fn problem<R: Sweeps>(
    config: &Config,
    model: Model<R>,
    deformation: Arc<Deformation>,
    parametrisation: Arc<dyn Parametrisation>,
    first: Vec<f64>,
    outlet: Outlet,
) -> Result<Problem<R>, BadInput> {
    let (steps, gradient) = (config.steps(), config.optimise.gradient);
    let window = window(config);
    let samples = Samples::window(steps, window, config.objective.samples);
    Ok(Problem {
        model,
        compute: config.run.compute()?,
        deformation,
        parametrisation,
        objective: objectives::of_config(config, outlet.clone(), samples),
        figure: Figure::of_config(config),
        smoothing: config.optimise.smoothing,
        steps,
        first,
        outlet,
        depth: config.depth(),
        window,
        is_steady: gradient == GradientMode::Steady,
        differences: gradient.is_of_runs().then_some(config.optimise.difference),
        members: vec![],
        team: None,
    })
}

fn lattice(config: &Config) -> Lattice {
    let (dx, walls) = (config.resolution.dx, config.channel.wall_rows);
    let height = config.channel.height + 2.0 * walls as f64 * dx;
    let dimension = config.dimension();
    Lattice {
        wall_rows: [0, walls, 0],
        periodic: [true, false, dimension == 3],
        size: Some([config.channel.length, height, config.depth()]),
        before: [0.0, walls as f64, 0.0],
        ..Lattice::new(dimension, dx, [config.columns(), config.rows() + 2 * walls, config.layers()])
    }
}

/// The drive that holds the flow rate or the power, for the whole depth.
fn drive(config: &Config) -> Option<Drive> {
    let depth = config.depth();
    match config.fluid.drive {
        DriveName::BodyForce => None,
        DriveName::FlowRate => {
            Some(Drive::Momentum(depth * (config.fluid.density * config.channel.length * config.plane_flow_rate())))
        }
        DriveName::PumpingPower => Some(Drive::Power(depth * config.plane_power())),
    }
}

fn body_force(config: &Config) -> BodyForce {
    if config.fluid.drive != DriveName::BodyForce {
        return BodyForce::None;
    }
    let force = config.fluid.body_force;
    match config.fluid.body_force_region {
        BodyForceRegion::Fluid => BodyForce::Uniform(force),
        BodyForceRegion::OriginalChannel => BodyForce::Band { strength: force, from: 0.0, to: config.channel.height },
    }
}

/// Zero, or the steady parabola of the plane channel with its flow rate.
fn start_velocity(config: &Config, [_, y, _]: [f64; 3]) -> [f64; 3] {
    if config.time.start == Start::Rest {
        return [0.0; 3];
    }
    let kinematic = config.kinematic_viscosity();
    [(0.5 * config.plane_force() / kinematic * y * (config.channel.height - y)).max(0.0), 0.0, 0.0]
}

/// Heat conduction with T_wall = constant + factor <T>. The fraction `hot` of a wall cell has the hot temperature; the
/// rest is adiabatic.
fn heat<R: Sweeps>(config: &Config, hot: &[f64]) -> Heat<R> {
    let excess = config.wall.hot_temperature - config.fluid.inlet_temperature;
    let (constant, factor) = match config.wall.hot_isotherm {
        HotIsotherm::Surface => (2.0 * excess, -1.0),
        HotIsotherm::Dummy => (excess, 0.0),
    };
    Heat {
        conductivity: config.fluid.conductivity,
        capacity: config.fluid.heat_capacity,
        reference: config.fluid.inlet_temperature,
        inlet_below: config.channel.inlet_length,
        outlet_above: config.channel.length - config.channel.outlet_length,
        wall_constant: hot.iter().map(|s| R::of(s * constant)).collect(),
        wall_factor: hot.iter().map(|s| R::of(1.0 - s + s * factor)).collect(),
        materials: None,
    }
}

/// The [`Deformation`] of `base` by the heights of columns.
fn deformation<R: Sweeps>(config: &Config, lattice: &Lattice, model: &Standard<R>, base: Vec<f64>) -> Deformation {
    let (n, l, height) = (model.particles(), model.layout, config.channel.height);
    let by_height = |i: usize| match model.is_fluid(i) {
        true => 1.0 - base[n + i] / height,
        false => lattice.is_below(i, 1) as usize as f64,
    };
    let by_mass = |i: usize| if model.is_fluid(i) { -model.mass / height } else { 0.0 };
    let map = Map::Columns(Columns {
        column: (0..n).map(|i| lattice.rows(i)[0] as u32).collect(),
        by_height: (0..n).map(by_height).collect(),
        by_mass: l.mass.then(|| (l.state_mass(), (0..n).map(by_mass).collect())),
    });
    Deformation { columns: config.columns(), particles: n, map, base }
}

/// The channel in the consistent method, and its deformation by the heights of its shaped walls. Each layer of particles
/// along z has two points per spacing on the lower wall and one or two on the upper one with the wall's velocity, and
/// those with thermal conditions.
fn consistent<R: Sweeps>(
    config: &Config,
    parts: &Parts<R>,
    mut model: Standard<R>,
    mut base: Vec<f64>,
    own: scene::Consistent,
) -> (Consistent<R>, Deformation) {
    let (channel, lattice, dimension) = (&config.channel, &parts.lattice, config.dimension());
    let (dx, length, height, columns) = (config.resolution.dx, channel.length, channel.height, config.columns());
    let section = HotSection::of(config);
    let vertices = section.vertices();
    let (hot, cold) = section.heat_points();
    let n = model.particles();
    let excess = config.wall.hot_temperature - config.fluid.inlet_temperature;
    let still = Knows::Velocity([0.0; 3]);
    // A flat top wall needs a point for each column; a shaped one has the points of the bottom wall.
    let shaped = config.design.walls == DesignWalls::Both;
    let centres: Vec<f64> = (0..columns).map(|c| (c as f64 + 0.5) * dx).collect();
    let above = if shaped { vertices.clone() } else { centres.clone() };
    let stride = above.len() / columns;
    // Points along x at one height, which are repeated in each layer.
    let lines = [
        (&vertices, 0.0, still),
        (&hot, 0.0, Knows::Temperature(excess)),
        (&cold, 0.0, Knows::NoHeatFlux),
        (&above, height, still),
        (&centres, height, Knows::NoHeatFlux),
    ];
    let mut points = Vec::new();
    let [on_lower, on_hot, on_cold, on_upper, on_upper_cold] = lines.map(|(x, y, knows)| {
        let (first, up) = (points.len(), if y > 0.0 { -1.0 } else { 1.0 });
        for layer in 0..config.layers() {
            let z = if dimension == 3 { (layer as f64 + 0.5) * dx } else { 0.0 };
            points.extend(x.iter().map(|&x| Point { position: [x, y, z], normal: [0.0, up, 0.0], knows }));
        }
        first..points.len()
    });
    let (mut dummies, mut below, mut behind_top) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..n {
        let [column, _, layer] = lattice.rows(i);
        let (y, z) = (base[n + i], if dimension == 3 { base[2 * n + i] } else { 0.0 });
        if lattice.is_below(i, 1) {
            // Dummy particles are behind every second vertex, not in the columns of fluid.
            let (x, point) = (vertices[2 * column], layer * vertices.len() + 2 * column);
            base[i] = x;
            dummies.push(Dummy { particle: i, point, mirror: [x, -y, z] });
            below.push((i, point));
            let is_hot = x > channel.hot_from && x < channel.hot_to;
            model.flow.tags[i] = if is_hot { tag::HOT_WALL } else { tag::WALL };
        } else if lattice.is_above(i, 1) {
            let point = layer * above.len() + stride * column;
            if shaped {
                base[i] = above[stride * column];
                behind_top.push((i, point));
            }
            let mirror = [base[i], 2.0 * height - y, z];
            dummies.push(Dummy { particle: i, point: on_upper.start + point, mirror });
        }
    }
    let fluid: Vec<usize> = (0..n).filter(|&i| model.is_fluid(i)).collect();
    let rows = (dimension == 2).then(|| Rows {
        lower: on_lower.clone().collect(),
        upper: on_upper.clone().collect(),
        fluid: fluid.chunks(columns).map(|row| row.iter().map(|&i| i as u32).collect()).collect(),
    });
    let (model, base) = parts.with_surface(model, &base, &surface::Surface { points, dummies, rows }, own);
    let (particles, vector) = (model.particles(), model.rows.velocity());
    if dimension == 3 {
        let mut relief = Relief::new(0.5 * dx, vector);
        let place = |i: usize| [base[i], base[2 * particles + i]];
        for i in n..n + on_upper.start {
            relief.moves(i, place(i), 1.0);
        }
        for i in n + on_cold.start..n + on_cold.end {
            relief.leans(i, place(i), None);
        }
        for i in fluid {
            relief.moves(i, place(i), 1.0 - base[particles + i] / height);
        }
        for (i, _) in below {
            relief.moves(i, place(i), 1.0);
            relief.leans(i, place(i), Some(-base[particles + i]));
        }
        let columns = relief.places.len();
        return (model, Deformation { columns, particles, map: Map::Relief(relief), base });
    }
    let particles_of = |points: Range<usize>| points.map(|point| n + point).collect::<Vec<usize>>();
    let bottom = deformation::Surface {
        points: particles_of(on_lower),
        hot: particles_of(on_hot),
        cold: particles_of(on_cold),
        x: vertices,
        length,
        height,
        is_top: false,
        slope_over: 0.5 * dx,
        fluid,
        dummies: below,
        vector,
    };
    let mut walls = vec![bottom];
    if shaped {
        walls.push(deformation::Surface {
            points: particles_of(on_upper),
            hot: vec![],
            cold: particles_of(on_upper_cold),
            x: above,
            is_top: true,
            dummies: behind_top,
            ..walls[0].clone()
        });
    }
    let columns = walls.iter().map(|wall| wall.x.len()).sum();
    (model, Deformation { columns, particles, map: Map::Surfaces(walls), base })
}

/// Above this spacing, in channel heights, the flux along an adiabatic wall is left out; it smears the hot edge.
const CONORMAL_UP_TO: f64 = 1.0 / 16.0;

/// The channel with fixed particles, and its deformation by the heights of the lower wall's points.
fn fixed<R: Sweeps>(
    config: &Config,
    parts: &Parts<R>,
    model: Standard<R>,
    delta: f64,
) -> Result<(FixedParticles<R>, Deformation), Error> {
    let (channel, fluid) = (&config.channel, &config.fluid);
    let (dx, columns) = (config.resolution.dx, config.columns());
    let dt = model.dt;
    let lattice = Channel {
        columns,
        rows: config.rows(),
        spacing: dx,
        first_column_x: first_column(config),
        // The stencil of the lattice has two neighbours in each direction.
        kernel: Kernel::new(KernelName::QuinticSpline, 2, dx),
        density: fluid.density,
        sound_speed: config.sound_speed(),
        viscosity: config.kinematic_viscosity(),
        diffusivity: config.thermal_diffusivity(),
        body_force: model.body_force.strength(),
        drive: model.drive,
        delta,
        dt,
        hot: [channel.hot_from, channel.hot_to],
        hot_excess: config.wall.hot_temperature - fluid.inlet_temperature,
        inlet_below: channel.inlet_length,
        outlet_above: channel.length - channel.outlet_length,
        conormal: if dx > CONORMAL_UP_TO * channel.height { 0.0 } else { 1.0 },
    };
    let x: Vec<f64> = (0..columns).map(|column| lattice.x(column)).collect();
    let fixed = Fixed::<R>::new(lattice)?;
    let (n, inner) = (fixed.particles(), fixed.fluid_particles());
    let flat = vec![0.0; columns];
    let base = fixed.state(&flat, &flat, &|y| start_velocity(config, [0.0, y, 0.0])[0]);
    let bottom = deformation::Surface {
        points: (inner..inner + columns).collect(),
        hot: vec![],
        cold: vec![],
        x,
        length: channel.length,
        height: parts.lattice.spacing * config.rows() as f64,
        is_top: false,
        slope_over: dx,
        fluid: (0..inner).collect(),
        dummies: vec![],
        vector: 2,
    };
    let mut walls = vec![bottom];
    if config.design.walls == DesignWalls::Both {
        let points = (inner + columns..inner + 2 * columns).collect();
        walls.push(deformation::Surface { points, is_top: true, ..walls[0].clone() });
    }
    let base = base.iter().map(|x| x.f64()).collect();
    let columns = walls.len() * columns;
    let deformation = Deformation { columns, particles: n, map: Map::Surfaces(walls), base };
    Ok((FixedParticles::new(model.flow, fixed), deformation))
}

/// A column of targets across the flow; in three dimensions one in each layer.
fn outlet<R: Sweeps>(config: &Config, model: &Model<R>) -> Outlet {
    let dx = config.resolution.dx;
    // Fluxes need targets beyond each wall, so that every particle counts with its whole kernel.
    let beyond = if config.objective.interpolation == Mode::Flux { config.least_wall_rows().max(3) } else { 0 };
    let height_of = |k: usize| (k as f64 - beyond as f64 + 0.5) * dx;
    let rows = config.rows() + 2 * beyond;
    let depth_of = |layer: usize| if model.dimension() == 3 { (layer as f64 + 0.5) * dx } else { 0.0 };
    let places = (0..config.layers()).flat_map(|layer| (0..rows).map(move |k| (layer, k)));
    let targets = places.map(|(layer, k)| [config.objective.target_x, height_of(k), depth_of(layer)]).collect();
    let (kernel, domain, kernels) = (model.kernel, model.domain, config.run.kernels);
    let interpolation = Interpolation { kernel, domain, targets: Arc::new(targets), kernels };
    let mut outlet = Outlet { interpolation, mode: config.objective.interpolation, spacing: dx };
    if model.dimension() == 3 {
        outlet.spacing *= dx / config.channel.span;
    }
    if !config.method.facts().moves && config.objective.interpolation == Mode::Flux {
        // Fixed particles sample the kernel at few points, so its sum differs slightly from its integral.
        outlet.spacing /= section_sum(config, &outlet);
    }
    outlet
}

/// The sum of the kernel over targets and columns times dx^D: the value that the targets give for a flux of 1.
fn section_sum(config: &Config, outlet: &Outlet) -> f64 {
    let (dx, kernel) = (config.resolution.dx, outlet.interpolation.kernel);
    let first = if config.dimension() == 3 { over_relief::first_x(config) } else { first_column(config) };
    let x = |column: usize| first + column as f64 * dx;
    // Rows and targets are dx apart, so every row counts the same. Over a relief rows are half a spacing beside targets.
    let beside = if config.is_over_relief() { 0.5 } else { 0.0 };
    let rows = (kernel.cutoff() / dx).ceil() as i64;
    let layers = if config.dimension() == 3 { rows } else { 0 };
    let mut sum = 0.0;
    for column in 0..config.columns() {
        for (row, layer) in (-rows..=rows).flat_map(|row| (-layers..=layers).map(move |layer| (row, layer))) {
            let [row, layer] = [row as f64 + beside, layer as f64].map(|cells| cells * dx);
            let square = (x(column) - outlet.place()).powi(2) + row.powi(2) + layer.powi(2);
            if square < kernel.cutoff().powi(2) {
                sum += kernel.pair::<f64>(square).0 * dx.powi(config.dimension() as i32);
            }
        }
    }
    sum
}
