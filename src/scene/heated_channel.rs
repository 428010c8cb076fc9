//! The heated channel: a periodic channel driven by a body force, with a hot section in its bottom wall.
//!
//! Coordinates: x along the channel, y = 0 on the surface of the undeformed bottom wall, fluid in 0 < y < H, three
//! rows of dummy particles below and above. Particles stand on a lattice in rows from the bottom, x fastest.

use crate::config::scene::{
    BodyForceRegion, Config, HotIsotherm, Interpolation as Mode, MassConvention, Start,
};
use crate::design::objectives::{self, Figure, Outlet, Samples};
use crate::design::parametrisations;
use crate::design::{Deformation, Problem};
use crate::design::shape::Shape;
use crate::error::BadInput;
use crate::numerics::lanes::Real;
use crate::numerics::random::{stream, Normal};
use crate::particles::{tag, Domain};
use crate::sph::dynamics::Sph;
use crate::sph::kernels::{Kernel, KernelName};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::model::{Heat, Layout, Model, Scratch};
use crate::sph::operators::interpolation::Interpolation;
use std::sync::Arc;

/// A scene ready to run.
pub struct HeatedChannel<R> {
    pub model: Arc<Model<R>>,
    pub problem: Problem<R>,
    /// Where the outflow is measured.
    pub outlet: Outlet,
    pub steps: usize,
    /// Steps of the objective's window.
    pub window: usize,
    /// Spacing of the targets.
    pub spacing: f64,
}

impl<R: Real> HeatedChannel<R> {
    /// Builds the scene of a checked configuration, with `shape` as the wall to begin with.
    ///
    /// # Errors
    /// A design with too few variables.
    pub fn new(config: &Config, shape: &Shape) -> Result<Self, BadInput> {
        let dx = config.resolution.dx;
        let (length, height) = (config.channel.length, config.channel.height);
        let (columns, rows, wall_rows) = (config.columns(), config.rows(), config.channel.wall_rows);
        let n = columns * (rows + 2 * wall_rows);
        let share = shape.hot_share(dx, length);

        let mut tags = vec![tag::FLUID; n];
        let mut hot = vec![0.0; n];
        for i in 0..n {
            let (row, column) = (i / columns, i % columns);
            if row < wall_rows {
                hot[i] = share[column];
                tags[i] = if share[column] > 0.0 { tag::HOT_WALL } else { tag::WALL };
            } else if row >= wall_rows + rows {
                tags[i] = tag::WALL;
            }
        }
        let layout = Layout {
            dimension: 2,
            transport: config.fluid.transport_velocity > 0.0,
            heat: true,
            mass: config.wall.mass == MassConvention::ColumnArea,
        };
        let excess = config.wall.hot_temperature - config.fluid.inlet_temperature;
        // T_wall = constant + factor <T>: adiabatic for the share of a column outside the hot section.
        let (constant, factor) = match config.wall.hot_isotherm {
            HotIsotherm::Surface => (2.0 * excess, -1.0),
            HotIsotherm::Dummy => (excess, 0.0),
        };
        let sound_speed = config.sound_speed();
        let pressure = config.fluid.density * sound_speed * sound_speed;
        let force = config.fluid.body_force;
        let model = Model {
            domain: Domain {
                dimension: 2,
                size: [length, height + 2.0 * wall_rows as f64 * dx, 1.0],
                periodic: [true, false, false],
            },
            layout,
            kernel: Kernel::new(KernelName::QuinticSpline, 2, dx),
            skin: config.time.skin * dx,
            dt: config.time_step(),
            mass: config.fluid.density * dx * dx,
            equation_of_state: EquationOfState {
                reference_density: config.fluid.density,
                reference_pressure: pressure,
                background_pressure: config.fluid.background_pressure_factor * pressure,
                gamma: 1,
            },
            viscosity: config.fluid.viscosity,
            artificial_viscosity: None,
            transport: config.fluid.transport_velocity * 0.25 * dx
                / (sound_speed + config.fluid.reference_velocity)
                / config.time_step(),
            body_force: match config.fluid.body_force_region {
                BodyForceRegion::Fluid => BodyForce::Uniform(force),
                BodyForceRegion::OriginalChannel => BodyForce::Band { strength: force, from: 0.0, to: height },
            },
            heat: Some(Heat {
                conductivity: config.fluid.conductivity,
                capacity: config.fluid.heat_capacity,
                reference: config.fluid.inlet_temperature,
                inlet_below: config.channel.inlet_length,
                outlet_above: length - config.channel.outlet_length,
                wall_constant: hot.iter().map(|s| R::of(s * constant)).collect(),
                wall_factor: hot.iter().map(|s| R::of(1.0 - s + s * factor)).collect(),
            }),
            scratch: Scratch::default(),
            tags,
        };

        let mut base = vec![0.0; layout.state_rows() * n];
        let mut by_height = vec![0.0; n];
        let mut by_mass = vec![0.0; n];
        let mut normal = Normal::new(stream(config.run.seed, "jitter"));
        for i in 0..n {
            let (row, column) = (i / columns, i % columns);
            let mut x = (column as f64 + 0.5) * dx;
            let mut y = (row as f64 + 0.5 - wall_rows as f64) * dx;
            if model.is_fluid(i) {
                x += config.time.jitter * dx * normal.next();
                y += config.time.jitter * dx * normal.next();
                if config.time.start == Start::Developed {
                    let kinematic = config.fluid.viscosity / config.fluid.density;
                    base[2 * n + i] = (0.5 * force / kinematic * y * (height - y)).max(0.0);
                }
                by_height[i] = 1.0 - y / height;
                by_mass[i] = -model.mass / height;
            } else if row < wall_rows {
                by_height[i] = 1.0;
            }
            base[i] = x.rem_euclid(length);
            base[n + i] = y;
            if model.tags[i] == tag::HOT_WALL {
                base[layout.temperature() * n + i] = excess;
            }
            if layout.mass {
                base[layout.state_mass() * n + i] = model.mass;
            }
        }
        let deformation = Deformation {
            columns,
            base,
            particles: n,
            column: (0..n).map(|i| (i % columns) as u32).collect(),
            by_height,
            by_mass: layout.mass.then_some((layout.state_mass(), by_mass)),
        };

        let steps = config.steps();
        let window = ((config.objective.window / model.dt).round() as usize).clamp(1, steps);
        // Fluxes: three more targets beyond each wall, so that every particle counts with its whole kernel.
        let beyond = if config.objective.interpolation == Mode::Flux { 3 } else { 0 };
        let height_of = |k: usize| (k as f64 - beyond as f64 + 0.5) * dx;
        let targets = (0..rows + 2 * beyond).map(|k| [config.objective.target_x, height_of(k), 0.0]).collect();
        let outlet = Outlet {
            interpolation: Interpolation {
                kernel: model.kernel,
                domain: model.domain,
                targets: Arc::new(targets),
                kernels: config.run.kernels,
            },
            mode: config.objective.interpolation,
        };
        let samples = Samples::window(steps, window, config.objective.samples);
        let objective = objectives::of_config(config, outlet.clone(), samples);
        let (parametrisation, first) = parametrisations::of_config(config, shape)?;
        let model = Arc::new(model);
        let problem = Problem {
            dynamics: Sph::new(model.clone(), config.run.kernels),
            deformation: Arc::new(deformation),
            parametrisation,
            objective,
            figure: Figure::of_config(config),
            smoothing: config.optimise.smoothing,
            steps,
            first,
        };
        Ok(Self { model, problem, outlet, steps, window, spacing: dx })
    }
}
