//! The heated channel: a periodic channel driven by a body force, with a hot section in its bottom wall.
//!
//! Coordinates: x along the channel, y = 0 on the surface of the undeformed bottom wall, fluid in 0 < y < H, three
//! rows of dummy particles below and above. Particles stand on a lattice in rows from the bottom, x fastest.

use super::assembly::{Assembled, Lattice, Numerics, Parts};
use super::{Exact, Scene};
use crate::config::scene::{BodyForceRegion, Config, HotIsotherm, Interpolation as Mode, MassConvention, Start};
use crate::design::objectives::{self, Figure, Outlet, Samples};
use crate::design::shape::Shape;
use crate::design::{parametrisations, Deformation, Problem};
use crate::error::Error;
use crate::numerics::lanes::Real;
use crate::particles::tag;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::model::{Heat, Model};
use crate::sph::operators::interpolation::Interpolation;
use std::sync::Arc;

/// The channel of a checked configuration, with its start shape.
///
/// # Errors
/// A wall shape that its file or its numbers do not allow.
pub(super) fn build<R: Real>(config: &Config) -> Result<Scene<R>, Error> {
    let shape = Shape::from_config(config)?;
    let lattice = lattice(config);
    let share = shape.hot_share(config.resolution.dx, config.channel.length);
    let hot = |i: usize| if lattice.is_below(i, 1) { share[lattice.rows(i)[0]] } else { 0.0 };
    let hot: Vec<f64> = (0..lattice.particles()).map(hot).collect();
    let mut parts = Parts {
        name: config.scene.name(),
        lattice,
        numerics: Numerics { wall_rows: config.channel.wall_rows, ..Numerics::from_config(config) },
        density: config.fluid.density,
        velocity: config.fluid.reference_velocity,
        viscosity: config.fluid.viscosity,
        body_force: body_force(config),
        lid: 0.0,
        own_mass: config.wall.mass == MassConvention::ColumnArea,
        heat: Some(heat(config, &hot)),
        exact: Exact::Unknown,
    };
    let Assembled { mut model, mut base } = parts.assemble(|place| start_velocity(config, place));
    let (n, l) = (model.particles(), model.layout);
    for i in (0..n).filter(|&i| hot[i] > 0.0) {
        model.tags[i] = tag::HOT_WALL;
        base[l.temperature() * n + i] = config.wall.hot_temperature - config.fluid.inlet_temperature;
    }
    if l.mass {
        base[l.state_mass() * n..][..n].fill(model.mass);
    }
    let deformation = Arc::new(deformation(config, &parts.lattice, &model, base));
    let (parametrisation, first) = parametrisations::of_config(config, &shape)?;
    let (outlet, window, steps) = (outlet(config, &model), window(config), parts.numerics.steps);
    let samples = Samples::window(steps, window, config.objective.samples);
    let design = Problem {
        model: Arc::new(model),
        kernels: config.run.kernels,
        deformation,
        parametrisation,
        objective: objectives::of_config(config, outlet.clone(), samples),
        figure: Figure::of_config(config),
        smoothing: config.optimise.smoothing,
        steps,
        first,
        outlet,
        window,
    };
    let (model, start) = (design.model.clone(), design.start(&design.first));
    Ok(Scene { design: Some(design), ..parts.scene(model, start) })
}

fn lattice(config: &Config) -> Lattice {
    let (dx, walls) = (config.resolution.dx, config.channel.wall_rows);
    let height = config.channel.height + 2.0 * walls as f64 * dx;
    Lattice {
        wall_rows: [0, walls, 0],
        periodic: [true, false, false],
        size: Some([config.channel.length, height, 1.0]),
        before: [0.0, walls as f64, 0.0],
        ..Lattice::new(2, dx, [config.columns(), config.rows() + 2 * walls, 1])
    }
}

fn body_force(config: &Config) -> BodyForce {
    let force = config.fluid.body_force;
    match config.fluid.body_force_region {
        BodyForceRegion::Fluid => BodyForce::Uniform(force),
        BodyForceRegion::OriginalChannel => BodyForce::Band { strength: force, from: 0.0, to: config.channel.height },
    }
}

/// At rest, or the steady parabola F/(2 nu) y (H - y).
fn start_velocity(config: &Config, [_, y, _]: [f64; 3]) -> [f64; 3] {
    if config.time.start == Start::Rest {
        return [0.0; 3];
    }
    let kinematic = config.fluid.viscosity / config.fluid.density;
    [(0.5 * config.fluid.body_force / kinematic * y * (config.channel.height - y)).max(0.0), 0.0, 0.0]
}

/// Conduction, and walls of a share `hot` of the hot temperature: T_wall = constant + factor <T>, adiabatic for the share of
/// a column outside the hot section.
fn heat<R: Real>(config: &Config, hot: &[f64]) -> Heat<R> {
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
    }
}

/// How the heights of columns move the particles of `base`: see [`Deformation`].
fn deformation<R: Real>(config: &Config, lattice: &Lattice, model: &Model<R>, base: Vec<f64>) -> Deformation {
    let (n, l, height) = (model.particles(), model.layout, config.channel.height);
    let by_height = |i: usize| match model.is_fluid(i) {
        true => 1.0 - base[n + i] / height,
        false => lattice.is_below(i, 1) as usize as f64,
    };
    let by_mass = |i: usize| if model.is_fluid(i) { -model.mass / height } else { 0.0 };
    Deformation {
        columns: config.columns(),
        particles: n,
        column: (0..n).map(|i| lattice.rows(i)[0] as u32).collect(),
        by_height: (0..n).map(by_height).collect(),
        by_mass: l.mass.then(|| (l.state_mass(), (0..n).map(by_mass).collect())),
        base,
    }
}

/// Steps of the objective's window.
fn window(config: &Config) -> usize {
    ((config.objective.window / config.time_step()).round() as usize).clamp(1, config.steps())
}

/// A column of targets across the flow.
fn outlet<R>(config: &Config, model: &Model<R>) -> Outlet {
    let dx = config.resolution.dx;
    // Fluxes: more targets beyond each wall, so that every particle counts with its whole kernel.
    let beyond = if config.objective.interpolation == Mode::Flux { config.least_wall_rows().max(3) } else { 0 };
    let height_of = |k: usize| (k as f64 - beyond as f64 + 0.5) * dx;
    let targets = (0..config.rows() + 2 * beyond).map(|k| [config.objective.target_x, height_of(k), 0.0]).collect();
    let (kernel, domain, kernels) = (model.kernel, model.domain, config.run.kernels);
    let interpolation = Interpolation { kernel, domain, targets: Arc::new(targets), kernels };
    Outlet { interpolation, mode: config.objective.interpolation, spacing: dx }
}
