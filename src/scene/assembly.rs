//! Assembles models and initial states from the description of a scene family.

use super::lattice::{Lattice, WallHeat};
use super::surface::Surface;
use super::{Exact, Scene};
use crate::config::scene::{self, Config, DensityEquation, Method};
use crate::particles::tag;
use crate::sph::consistent::Consistent;
use crate::sph::division::Division;
use crate::sph::flow::{Flow, Heat, Materials, Scratch};
use crate::sph::kernels::Kernel;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::buoyancy::Buoyancy;
use crate::sph::laws::drive::Drive;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::laws::{further, Flux, Scales};
use crate::sph::solver::Snapshot;
use crate::sph::standard::{Laws, Layout, Standard};
use crate::sph::{Model, Sweeps};

/// The keys of the standard method; for other methods, values without an effect on them.
fn standard(config: &Config) -> scene::Standard {
    match config.method {
        Method::Standard(own) => own,
        _ => scene::Standard { background_pressure_factor: 0.0, ..Default::default() },
    }
}

/// Number of particles along a side of the box, as in the configuration's check; the spacing divides the box exactly.
pub(super) fn count(config: &Config, size: f64) -> usize {
    (size / config.resolution.dx).round() as usize
}

/// The parts of a scene, as described by its family.
pub(super) struct Parts<R> {
    pub config: Config,
    pub lattice: Lattice,
    pub density: f64,
    /// Reference velocity U.
    pub velocity: f64,
    pub viscosity: f64,
    pub body_force: BodyForce,
    pub buoyancy: Option<Buoyancy>,
    /// Drive that holds the flow rate or the power, if one is given.
    pub drive: Option<Drive>,
    /// Velocity along x of the upper wall; 0 if it does not move.
    pub lid: f64,
    /// Whether each particle has its own mass.
    pub own_mass: bool,
    pub heat: Option<Heat<R>>,
    /// The thermal conditions of the lower and the upper wall, set by [`Self::warm`].
    pub heat_walls: Option<[WallHeat; 2]>,
    pub exact: Exact,
}

impl<R: Sweeps> Parts<R> {
    /// A scene in the units of its configuration, without a force, moving walls and heat.
    pub fn new(config: &Config, lattice: Lattice) -> Self {
        Self {
            config: config.clone(),
            lattice,
            density: config.fluid.density,
            velocity: config.fluid.reference_velocity,
            viscosity: config.fluid.viscosity,
            body_force: BodyForce::None,
            buoyancy: None,
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Unknown,
        }
    }

    /// The same scene in the consistent method, and its initial state, `[F, N]`.
    pub fn with_surface(
        &self,
        model: Standard<R>,
        base: &[f64],
        surface: &Surface,
        own: scene::Consistent,
    ) -> (Consistent<R>, Vec<f64>) {
        let speeds = [self.velocity, self.config.fluid.sound_speed_factor * self.velocity];
        surface.added(model, base, self.lattice.spacing, speeds, own)
    }

    /// Adds heat of unit capacity, which is conducted where `ends[0]` < x < `ends[1]` (fluid before that has the
    /// reference temperature 0), between two walls with surface temperatures.
    pub fn warm(
        mut self,
        diffusivity: f64,
        ends: [f64; 2],
        walls: [WallHeat; 2],
        materials: Option<Materials<R>>,
    ) -> Self {
        let lattice = &self.lattice;
        let given = |i: usize| {
            let [x, ..] = lattice.place(i);
            match (lattice.is_below(i, 1), lattice.is_above(i, 1)) {
                (true, _) => walls[0].at(x),
                (_, true) => walls[1].at(x),
                _ => None,
            }
        };
        let given: Vec<Option<f64>> = (0..lattice.particles()).map(given).collect();
        self.heat = Some(Heat {
            conductivity: diffusivity,
            capacity: 1.0,
            reference: 0.0,
            inlet_below: ends[0],
            outlet_above: ends[1],
            // With T = 2 T_wall - <T>, the surface half way between has T_wall.
            wall_constant: given.iter().map(|t| R::of(t.map_or(0.0, |t| 2.0 * t))).collect(),
            wall_factor: given.iter().map(|t| R::of(if t.is_some() { -1.0 } else { 1.0 })).collect(),
            materials,
        });
        self.heat_walls = Some(walls);
        self
    }

    /// The model in the standard method, and its initial state in f64, `[F, N]` (see [`Layout`]), with positions and
    /// velocities; other rows are 0. `velocity` gives the fluid's velocity by position.
    pub fn assemble(&mut self, velocity: impl Fn([f64; 3]) -> [f64; 3]) -> (Standard<R>, Vec<f64>) {
        let model = self.model();
        let (n, l) = (model.particles(), model.layout);
        let mut base = self.lattice.positions(&model.domain, self.config.time.jitter, self.config.run.seed);
        base.resize(l.state_rows() * n, 0.0);
        for i in 0..n {
            let u = match model.tags[i] {
                tag::FLUID => velocity(std::array::from_fn(|d| if d < l.dimension { base[d * n + i] } else { 0.0 })),
                tag::MOVING_WALL => [self.lid, 0.0, 0.0],
                _ => [0.0; 3],
            };
            for d in 0..l.dimension {
                base[(l.velocity() + d) * n + i] = u[d];
            }
            if l.density {
                base[l.state_density() * n + i] = self.density;
            }
        }
        (model, base)
    }

    fn model(&mut self) -> Standard<R> {
        let Self { config, lattice, density, .. } = self;
        let (own, dx, dt, density) = (standard(config), lattice.spacing, config.time_step(), *density);
        let layout = Layout {
            dimension: lattice.dimension,
            transport: own.transport_velocity > 0.0,
            heat: self.heat.is_some(),
            mass: self.own_mass,
            density: own.density_equation == DensityEquation::Evolution,
        };
        let lid = self.lid != 0.0;
        let tag_of = |i: usize| match lattice.is_wall(i) {
            true if lid && lattice.is_above(i, 1) => tag::MOVING_WALL,
            true => tag::WALL,
            false => tag::FLUID,
        };
        let sound_speed = config.fluid.sound_speed_factor * self.velocity;
        let pressure = density * sound_speed * sound_speed;
        let smoothing_length = config.resolution.smoothing_length * dx;
        let scales = Scales { sound_speed, smoothing_length, reference_density: density };
        let slip = config.wall.slip;
        let flux = Flux::of(&own, &scales);
        let normals =
            Laws::<R>::asks_for_normals(&flux, slip).then(|| lattice.normals(lid).into_iter().map(R::of).collect());
        let laws = Laws {
            // The strength at CFL 0.25 (Adami, Hu and Adams 2013), whatever the time step.
            transport: own.transport_velocity * 0.25 * dx / (sound_speed + self.velocity) / dt,
            further: further(&own, &scales),
            renormalises: own.density_renormalisation,
            flux,
            slip,
            normals,
        };
        let (time, exponent) = (&config.time, own.equation_of_state_exponent as i32);
        let flow = Flow {
            domain: lattice.domain(),
            rows: layout.rows(),
            kernel: Kernel::new(config.resolution.kernel, lattice.dimension, smoothing_length),
            tags: (0..lattice.particles()).map(tag_of).collect(),
            skin: time.skin * dx,
            dt,
            division: time.adaptive.then_some(Division { spacing: dx, sound_speed, courant_number: time.cfl }),
            mass: (0..lattice.dimension).fold(density, |mass, _| mass * dx),
            equation_of_state: EquationOfState {
                reference_density: density,
                reference_pressure: pressure / exponent as f64,
                background_pressure: own.background_pressure_factor * pressure,
                gamma: exponent,
            },
            viscosity: self.viscosity,
            body_force: self.body_force,
            buoyancy: self.buoyancy,
            drive: self.drive,
            walls_slide: false,
            heat: self.heat.take(),
            wall_heat_until: None,
            section: None,
            part: None,
            scratch: Scratch::default(),
        };
        Standard::new(flow, layout, laws)
    }

    /// The scene, without a design. The standard method does not use the initial pressure.
    pub fn build(mut self, velocity: impl Fn([f64; 3]) -> [f64; 3], pressure: impl Fn([f64; 3]) -> f64) -> Scene<R> {
        let (model, base) = self.assemble(velocity);
        let Method::Consistent(own) = self.config.method else {
            return self.started(Model::new(model), &base);
        };
        let surface = Surface::of_lattice(&self.lattice, self.lid, self.heat_walls);
        let (model, mut base) = self.with_surface(model, &base, &surface, own);
        let (n, l) = (model.particles(), model.layout);
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let place = std::array::from_fn(|d| if d < l.dimension { base[d * n + i] } else { 0.0 });
            base[l.pressure() * n + i] = pressure(place);
        }
        self.started(Model::new(model), &base)
    }

    /// The scene with an initial state in f64.
    pub fn started(self, model: Model<R>, base: &[f64]) -> Scene<R> {
        let start = Snapshot::first(&model, rounded(&model, base));
        self.scene(model, start)
    }

    pub fn scene(self, model: Model<R>, start: Snapshot<R>) -> Scene<R> {
        let lattice = &self.lattice;
        let behind = |d: usize| lattice.corner[d] - lattice.before[d] * lattice.spacing;
        let row = |d: usize, rows: usize| behind(d) + rows as f64 * lattice.spacing;
        Scene {
            name: self.config.scene.name(),
            model,
            start,
            steps: self.config.steps(),
            spacing: self.lattice.spacing,
            corner: std::array::from_fn(behind),
            inside: std::array::from_fn(|d| {
                let walls = lattice.wall_rows[d];
                [row(d, walls), row(d, lattice.cells[d] - walls)]
            }),
            reference_velocity: self.velocity,
            exact: self.exact,
            design: None,
            section: None,
        }
    }
}

/// Converts a state to R. A position just below the end of the box may be rounded to the end; it then becomes 0.
pub(super) fn rounded<R: Sweeps>(flow: &Flow<R>, base: &[f64]) -> Vec<R> {
    let (n, domain) = (flow.particles(), &flow.domain);
    let place = |(k, &x): (usize, &f64)| {
        let (d, x) = (k / n, R::of(x));
        let at_end = d < domain.dimension && domain.periodic[d] && x >= R::of(domain.size[d]);
        if at_end {
            R::default()
        } else {
            x
        }
    };
    base.iter().enumerate().map(place).collect()
}
