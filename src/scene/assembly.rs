//! Assembles models and initial states from the description of a scene family.

use super::lattice::{Lattice, WallHeat};
use super::surface::{Settings, Surface};
use super::{Exact, Scene};
use crate::config::method;
use crate::config::scene::{
    Config, DensityEquation, DensityGradientName, FluxName, KernelName, SlipName, ViscousPairs,
};
use crate::particles::tag;
use crate::sph::consistent::Consistent;
use crate::sph::division::Division;
use crate::sph::flow::{Flow, Heat, Materials, Scratch};
use crate::sph::kernels::Kernel;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::drive::Drive;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::laws::{
    ArtificialViscosity, DensityDiffusion, DensityGradient, Flux, Riemann, Slip, VelocityDiffusion,
};
use crate::sph::solver::Snapshot;
use crate::sph::standard::{Laws, Layout, Standard};
use crate::sph::{Model, Sweeps};

/// Numerical parameters of the method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numerics {
    pub kernel: KernelName,
    /// Smoothing length in spacings.
    pub smoothing_length: f64,
    /// Number of rows of dummy particles per wall, which cover the kernel's support.
    pub wall_rows: usize,
    /// Acoustic limit of the time step: dt <= cfl dx / (c + U).
    pub cfl: f64,
    /// Whether a step is divided where the flow requires it.
    pub adaptive: bool,
    /// Diffusive limit: dt <= diffusion_number dx^2 / nu.
    pub diffusion_number: f64,
    /// A given time step, which replaces the limits.
    pub time_step: Option<f64>,
    /// Number of steps of the run.
    pub steps: usize,
    /// Sound speed c over reference velocity U.
    pub sound_speed_factor: f64,
    /// Background pressure over density c^2.
    pub background_pressure_factor: f64,
    /// Strength of the transport velocity, 0 (off) ... 1 (Adami, Hu and Adams 2013, as at CFL 0.25).
    pub transport_velocity: f64,
    /// alpha of [`ArtificialViscosity`]; 0 switches it off.
    pub artificial_viscosity: f64,
    /// Choices of the standard method.
    pub method: Method,
    /// Settings of the consistent method; none for the standard one.
    pub consistent: Option<Settings>,
    /// Random displacement of the fluid particles at the start, as a standard deviation in spacings.
    pub jitter: f64,
    /// Extra reach of the neighbour list, in spacings.
    pub skin: f64,
    pub seed: u64,
}

/// Choices of the standard method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Method {
    pub density: DensityEquation,
    pub renormalises: bool,
    pub flux: FluxName,
    /// delta and alpha of delta-SPH.
    pub diffusion: [f64; 2],
    pub gradient: DensityGradientName,
    /// eta of the limiter of the Riemann problem.
    pub limiter: f64,
    pub slip: SlipName,
    /// Exponent of Tait's equation of state.
    pub exponent: i32,
    pub viscous: ViscousPairs,
}

/// The keys of the standard method; for other methods, values without an effect on them.
fn standard(config: &Config) -> method::standard::Standard {
    match config.method {
        method::Method::Standard(own) => own,
        _ => method::standard::Standard { background_pressure_factor: 0.0, ..Default::default() },
    }
}

impl Default for Method {
    fn default() -> Self {
        Self::from_config(&Config::default())
    }
}

impl Method {
    fn from_config(config: &Config) -> Self {
        let own = standard(config);
        Self {
            density: own.density_equation,
            renormalises: own.density_renormalisation,
            flux: own.flux,
            diffusion: [own.density_diffusion, own.velocity_diffusion],
            gradient: own.density_gradient,
            limiter: own.riemann_limiter,
            slip: config.wall.slip,
            exponent: own.equation_of_state_exponent as i32,
            viscous: own.artificial_viscosity_pairs,
        }
    }

    fn flux(&self, sound_speed: f64, smoothing_length: f64, reference_density: f64) -> Flux {
        let gradient = match self.gradient {
            DensityGradientName::Renormalised => DensityGradient::Renormalised,
            DensityGradientName::JaxSph => DensityGradient::JaxSph,
        };
        let [delta, alpha] = self.diffusion;
        match self.flux {
            FluxName::Pair => Flux::Pair,
            FluxName::Delta => Flux::Delta(
                DensityDiffusion { strength: delta, sound_speed, smoothing_length, gradient },
                VelocityDiffusion { strength: alpha, sound_speed, smoothing_length, reference_density },
            ),
            FluxName::Riemann => Flux::Riemann(Riemann { sound_speed, limiter: self.limiter }),
        }
    }
}

impl Default for Numerics {
    fn default() -> Self {
        Self {
            kernel: KernelName::QuinticSpline,
            smoothing_length: 1.0,
            wall_rows: 3,
            cfl: 0.25,
            adaptive: false,
            diffusion_number: 0.25,
            time_step: None,
            steps: 1,
            sound_speed_factor: 10.0,
            background_pressure_factor: 0.0,
            transport_velocity: 1.0,
            artificial_viscosity: 0.0,
            method: Method::default(),
            consistent: None,
            jitter: 0.0,
            skin: 0.2,
            seed: 0,
        }
    }
}

impl Numerics {
    /// The parameters of a configuration, with walls as thick as the kernel needs.
    pub fn from_config(config: &Config) -> Self {
        let own = standard(config);
        Self {
            kernel: config.resolution.kernel,
            smoothing_length: config.resolution.smoothing_length,
            wall_rows: config.least_wall_rows().max(3),
            cfl: config.time.cfl,
            adaptive: config.time.adaptive,
            diffusion_number: config.time.diffusion_number,
            time_step: Some(config.time_step()),
            steps: config.steps(),
            sound_speed_factor: config.fluid.sound_speed_factor,
            background_pressure_factor: own.background_pressure_factor,
            transport_velocity: own.transport_velocity,
            artificial_viscosity: own.artificial_viscosity,
            method: Method::from_config(config),
            consistent: Settings::from_config(config),
            jitter: config.time.jitter,
            skin: config.time.skin,
            seed: config.run.seed,
        }
    }

    /// The largest time step, or the given one.
    pub fn step(&self, spacing: f64, velocity: f64, kinematic_viscosity: f64) -> f64 {
        let acoustic = self.cfl * spacing / ((self.sound_speed_factor + 1.0) * velocity);
        let diffusive = self.diffusion_number * spacing * spacing / kinematic_viscosity;
        self.time_step.unwrap_or(acoustic.min(diffusive))
    }
}

/// Number of particles along a side of the box, as in the configuration's check; the spacing divides the box exactly.
pub(super) fn count(config: &Config, size: f64) -> usize {
    (size / config.resolution.dx).round() as usize
}

/// The parts of a scene, as described by its family.
pub(super) struct Parts<R> {
    pub name: &'static str,
    pub lattice: Lattice,
    pub numerics: Numerics,
    pub density: f64,
    /// Reference velocity U.
    pub velocity: f64,
    /// Dynamic viscosity.
    pub viscosity: f64,
    pub body_force: BodyForce,
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

/// A scene in the standard method. Its initial state has positions and velocities in f64; the other rows are 0.
pub(super) struct Assembled<R> {
    pub model: Standard<R>,
    /// Initial state, `[F, N]`, see [`Layout`].
    pub base: Vec<f64>,
}

impl<R: Sweeps> Assembled<R> {
    /// The same scene in the consistent method, and its initial state, `[F, N]`.
    pub fn with_surface(
        self,
        surface: &Surface,
        numerics: &Numerics,
        spacing: f64,
        velocity: f64,
        settings: Settings,
    ) -> (Consistent<R>, Vec<f64>) {
        let speeds = [velocity, numerics.sound_speed_factor * velocity];
        surface.added(self.model, &self.base, spacing, speeds, settings)
    }
}

impl<R: Sweeps> Parts<R> {
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

    /// The model and the initial state; `velocity` gives the fluid's velocity by position.
    pub fn assemble(&mut self, velocity: impl Fn([f64; 3]) -> [f64; 3]) -> Assembled<R> {
        let model = self.model();
        let (n, l) = (model.particles(), model.layout);
        let mut base = self.lattice.positions(&model.domain, self.numerics.jitter, self.numerics.seed);
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
        Assembled { model, base }
    }

    fn model(&mut self) -> Standard<R> {
        let Self { lattice, numerics, density, .. } = self;
        let (dx, density) = (lattice.spacing, *density);
        let layout = Layout {
            dimension: lattice.dimension,
            transport: numerics.transport_velocity > 0.0,
            heat: self.heat.is_some(),
            mass: self.own_mass,
            density: numerics.method.density == DensityEquation::Evolution,
        };
        let lid = self.lid != 0.0;
        let tag_of = |i: usize| match lattice.is_wall(i) {
            true if lid && lattice.is_above(i, 1) => tag::MOVING_WALL,
            true => tag::WALL,
            false => tag::FLUID,
        };
        let sound_speed = numerics.sound_speed_factor * self.velocity;
        let pressure = density * sound_speed * sound_speed;
        let dt = numerics.step(dx, self.velocity, self.viscosity / density);
        let smoothing_length = numerics.smoothing_length * dx;
        let alpha = numerics.artificial_viscosity;
        let artificial = ArtificialViscosity {
            alpha,
            beta: 0.0,
            sound_speed,
            smoothing_length,
            every_pair: numerics.method.viscous == ViscousPairs::All,
        };
        let method = numerics.method;
        let slip = match method.slip {
            SlipName::NoSlip => Slip::None,
            SlipName::FreeSlip => Slip::Free,
        };
        let flux = method.flux(sound_speed, smoothing_length, density);
        let normals =
            Laws::<R>::asks_for_normals(&flux, slip).then(|| lattice.normals(lid).into_iter().map(R::of).collect());
        let laws = Laws {
            // The strength at CFL 0.25, whatever the time step.
            transport: numerics.transport_velocity * 0.25 * dx / (sound_speed + self.velocity) / dt,
            artificial_viscosity: (alpha > 0.0).then_some(artificial),
            renormalises: method.renormalises,
            flux,
            slip,
            normals,
        };
        let flow = Flow {
            domain: lattice.domain(),
            rows: layout.rows(),
            kernel: Kernel::new(numerics.kernel, lattice.dimension, smoothing_length),
            tags: (0..lattice.particles()).map(tag_of).collect(),
            skin: numerics.skin * dx,
            dt,
            division: numerics.adaptive.then_some(Division { spacing: dx, sound_speed, courant_number: numerics.cfl }),
            mass: (0..lattice.dimension).fold(density, |mass, _| mass * dx),
            equation_of_state: EquationOfState {
                reference_density: density,
                reference_pressure: pressure / method.exponent as f64,
                background_pressure: numerics.background_pressure_factor * pressure,
                gamma: method.exponent,
            },
            viscosity: self.viscosity,
            body_force: self.body_force,
            drive: self.drive,
            walls_slide: false,
            heat: self.heat.take(),
            wall_heat_until: None,
            scratch: Scratch::default(),
        };
        Standard::new(flow, layout, laws)
    }

    /// The scene, without a design.
    pub fn build(self, velocity: impl Fn([f64; 3]) -> [f64; 3]) -> Scene<R> {
        self.build_with_pressure(velocity, |_| 0.0)
    }

    /// As [`Self::build`], with an initial pressure, which the standard method does not use.
    pub fn build_with_pressure(
        mut self,
        velocity: impl Fn([f64; 3]) -> [f64; 3],
        pressure: impl Fn([f64; 3]) -> f64,
    ) -> Scene<R> {
        let assembled = self.assemble(velocity);
        if let Some(settings) = self.numerics.consistent {
            let surface = Surface::of_lattice(&self.lattice, self.lid, self.heat_walls);
            let (model, mut base) =
                assembled.with_surface(&surface, &self.numerics, self.lattice.spacing, self.velocity, settings);
            let (n, l) = (model.particles(), model.layout);
            for i in (0..n).filter(|&i| model.is_fluid(i)) {
                let place = std::array::from_fn(|d| if d < l.dimension { base[d * n + i] } else { 0.0 });
                base[l.pressure() * n + i] = pressure(place);
            }
            return self.started(Model::new(model), &base);
        }
        let Assembled { model, base } = assembled;
        self.started(Model::new(model), &base)
    }

    fn started(self, model: Model<R>, base: &[f64]) -> Scene<R> {
        let start = Snapshot::first(&model, rounded(&model, base));
        self.scene(model, start)
    }

    pub fn scene(self, model: Model<R>, start: Snapshot<R>) -> Scene<R> {
        let lattice = &self.lattice;
        let behind = |d: usize| lattice.corner[d] - lattice.before[d] * lattice.spacing;
        let row = |d: usize, rows: usize| behind(d) + rows as f64 * lattice.spacing;
        Scene {
            name: self.name,
            model,
            start,
            steps: self.numerics.steps,
            spacing: self.lattice.spacing,
            corner: std::array::from_fn(behind),
            inside: std::array::from_fn(|d| {
                let walls = lattice.wall_rows[d];
                [row(d, walls), row(d, lattice.cells[d] - walls)]
            }),
            reference_velocity: self.velocity,
            exact: self.exact,
            design: None,
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
