//! Verification flows: scenes without a design whose solution is known.

use super::lid_driven_cavity::LidDrivenCavity;
use super::poiseuille::Poiseuille;
use super::reverse_poiseuille::ReversePoiseuille;
use super::taylor_green::TaylorGreen;
use crate::config::scene::{Config, Scene};
use crate::numerics::lanes::Real;
use crate::numerics::random::{stream, Normal};
use crate::particles::{tag, Domain};
use crate::sph::kernels::{Kernel, KernelName};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::model::{Layout, Model, Scratch};
use std::f64::consts::PI;
use std::sync::Arc;

/// A scene ready to run that has no design: model, initial state, and what is known about its exact solution.
#[derive(Debug, Clone)]
pub struct Flow<R> {
    pub name: &'static str,
    pub model: Arc<Model<R>>,
    /// `[F, N]` rows, see [`Layout`].
    pub state: Vec<R>,
    /// Particle spacing.
    pub spacing: f64,
    /// The lower corner of the box, in front of the walls.
    pub corner: [f64; 3],
    pub reference_velocity: f64,
    pub exact: Exact,
}

/// The exact solution of the incompressible Navier-Stokes equations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Exact {
    /// The plane vortices of Taylor and Green (1937) in the unit box:
    /// u = -U exp(-8 pi^2 nu t) cos(2 pi x) sin(2 pi y), v = U exp(-8 pi^2 nu t) sin(2 pi x) cos(2 pi y).
    TaylorGreen { velocity: f64, kinematic_viscosity: f64 },
    /// Flow between plane walls at y = 0 and y = height, started from rest by a constant force
    /// (Morris, Fox and Zhu 1997, eq. 19). `velocity` is that of the steady centre line, F height^2/(8 nu).
    Poiseuille { velocity: f64, kinematic_viscosity: f64, height: f64 },
    /// Two such channels, at 0 < y < height and with the opposite sign at height < y < 2 height.
    ReversePoiseuille { velocity: f64, kinematic_viscosity: f64, height: f64 },
    /// No closed form.
    Unknown,
}

impl Exact {
    /// The velocity at a point, if it is known.
    pub fn velocity(&self, position: [f64; 3], time: f64) -> Option<[f64; 3]> {
        let [x, y, _] = position;
        match *self {
            Self::TaylorGreen { .. } => {
                let amplitude = self.amplitude(time)?;
                let ((sin_x, cos_x), (sin_y, cos_y)) = ((2.0 * PI * x).sin_cos(), (2.0 * PI * y).sin_cos());
                Some([-amplitude * cos_x * sin_y, amplitude * sin_x * cos_y, 0.0])
            }
            Self::Poiseuille { velocity, kinematic_viscosity, height } => {
                // In terms of the steady centre line U: 4 U y (H - y)/H^2 - sum over odd k of 32 U/(pi k)^3 ...
                let s = y / height;
                let mut u = 4.0 * velocity * s * (1.0 - s);
                for k in (1..200).step_by(2).map(|k| PI * k as f64) {
                    let decay = (-k * k * kinematic_viscosity * time / (height * height)).exp();
                    u -= 32.0 * velocity / (k * k * k) * (k * s).sin() * decay;
                }
                Some([u, 0.0, 0.0])
            }
            Self::ReversePoiseuille { velocity, kinematic_viscosity, height } => {
                let half = Self::Poiseuille { velocity, kinematic_viscosity, height };
                if y < height {
                    half.velocity(position, time)
                } else {
                    half.velocity([x, y - height, 0.0], time).map(|u| u.map(|u| -u))
                }
            }
            Self::Unknown => None,
        }
    }

    /// The height of the profile, if the velocity depends on y alone.
    pub fn profile_height(&self) -> Option<f64> {
        match *self {
            Self::Poiseuille { height, .. } => Some(height),
            Self::ReversePoiseuille { height, .. } => Some(2.0 * height),
            Self::TaylorGreen { .. } | Self::Unknown => None,
        }
    }

    /// What velocity errors are measured against: the vortices' present amplitude, or the channel's steady centre line
    /// (the flow there begins with zero).
    pub fn amplitude(&self, time: f64) -> Option<f64> {
        match *self {
            Self::TaylorGreen { velocity, kinematic_viscosity } => {
                Some(velocity * (-8.0 * PI * PI * kinematic_viscosity * time).exp())
            }
            Self::Poiseuille { velocity, .. } | Self::ReversePoiseuille { velocity, .. } => Some(velocity),
            Self::Unknown => None,
        }
    }
}

impl<R: Real> Flow<R> {
    /// The flow of a checked configuration; none if its scene is one with a design.
    pub fn from_config(config: &Config) -> Option<Self> {
        // As counted by the check: the spacing that divides the box exactly.
        let count = |size: f64| (size / config.resolution.dx).round() as usize;
        let numerics = Numerics {
            cfl: config.time.cfl,
            diffusion_number: config.time.diffusion_number,
            time_step: Some(config.time_step()),
            sound_speed_factor: config.fluid.sound_speed_factor,
            background_pressure_factor: config.fluid.background_pressure_factor,
            transport_velocity: config.fluid.transport_velocity,
            jitter: config.time.jitter,
            skin: config.time.skin,
            seed: config.run.seed,
        };
        let reynolds = config.flow.reynolds;
        let vortices = |dimension: usize| {
            let scene = TaylorGreen { dimension, reynolds, numerics, ..Default::default() };
            TaylorGreen { per_side: count(scene.size()), ..scene }.build()
        };
        match config.scene {
            Scene::HeatedChannel => None,
            Scene::TaylorGreen => Some(vortices(2)),
            Scene::TaylorGreen3d => Some(vortices(3)),
            Scene::Poiseuille => {
                Some(Poiseuille { rows: count(1.0), reynolds, numerics, ..Default::default() }.build())
            }
            Scene::ReversePoiseuille => {
                let force = config.fluid.body_force;
                Some(ReversePoiseuille { per_height: count(1.0), reynolds, force, numerics }.build())
            }
            Scene::LidDrivenCavity => Some(LidDrivenCavity { per_side: count(1.0), reynolds, numerics }.build()),
        }
    }
}

impl<R: Real> Flow<R> {
    /// The same particles with nothing that moves them but their disorder.
    pub fn at_rest(config: &Config) -> Option<Self> {
        let mut flow = Self::from_config(config)?;
        let (n, d) = (flow.model.particles(), flow.model.layout.dimension);
        flow.state[d * n..2 * d * n].fill(R::default());
        Arc::get_mut(&mut flow.model).expect("a new flow has one owner").body_force = BodyForce::None;
        Some(flow)
    }
}

/// What the flow is like after a number of steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowFigures {
    pub time: f64,
    /// Of all fluid particles, sum m u^2 / 2.
    pub kinetic_energy: f64,
    /// The same sum with the exact velocity at the particles' places.
    pub exact_kinetic_energy: Option<f64>,
    /// Of the fastest fluid particle.
    pub largest_velocity: f64,
    /// Root mean square over the fluid particles of |u - u_exact| at their places, over [`Exact::amplitude`].
    pub velocity_error: Option<f64>,
}

impl<R: Real> Flow<R> {
    /// c = sqrt(dp/drho).
    pub fn sound_speed(&self) -> f64 {
        let state = &self.model.equation_of_state;
        state.slope(state.reference_density).sqrt()
    }

    /// Figures of a state of this flow at a time.
    pub fn figures(&self, state: &[R], time: f64) -> FlowFigures {
        let (model, n) = (&self.model, self.model.particles());
        let vector = |row: usize, i: usize| -> [f64; 3] {
            std::array::from_fn(|d| if d < model.layout.dimension { state[(row + d) * n + i].f64() } else { 0.0 })
        };
        let square = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
        let (mut fluid, mut energy, mut exact_energy, mut error, mut largest) = (0, 0.0, 0.0, 0.0, 0.0_f64);
        let mut known = true;
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let u = vector(model.layout.velocity(), i);
            let r = vector(0, i);
            fluid += 1;
            energy += 0.5 * model.mass * square(u);
            // Not `max`: it would hide what is not a number.
            largest = if square(u).sqrt() <= largest { largest } else { square(u).sqrt() };
            match self.exact.velocity(r, time) {
                Some(exact) => {
                    exact_energy += 0.5 * model.mass * square(exact);
                    error += square(std::array::from_fn(|d| u[d] - exact[d]));
                }
                None => known = false,
            }
        }
        let amplitude = self.exact.amplitude(time).filter(|_| known);
        FlowFigures {
            time,
            kinetic_energy: energy,
            exact_kinetic_energy: known.then_some(exact_energy),
            largest_velocity: largest,
            velocity_error: amplitude.map(|amplitude| (error / fluid as f64).sqrt() / amplitude),
        }
    }
}

/// What a flow is built from: the lattice and the numbers of the fluid.
pub(super) struct Parts {
    pub name: &'static str,
    pub dimension: usize,
    /// Particles along each direction, walls included.
    pub cells: [usize; 3],
    /// Rows of dummy particles at both ends of each direction.
    pub wall_rows: [usize; 3],
    pub periodic: [bool; 3],
    /// The lower corner of the box, in front of the walls.
    pub corner: [f64; 3],
    /// Velocity along x of the walls above the fluid.
    pub lid: f64,
    pub spacing: f64,
    pub velocity: f64,
    pub kinematic_viscosity: f64,
    pub numerics: Numerics,
    pub body_force: BodyForce,
    pub exact: Exact,
}

/// Numbers of the method rather than of the flow. The flows' density is 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numerics {
    /// Acoustic limit of the time step: dt <= cfl dx / (c + U).
    pub cfl: f64,
    /// Diffusive limit: dt <= diffusion_number dx^2 / nu.
    pub diffusion_number: f64,
    /// The time step itself, instead of the limits.
    pub time_step: Option<f64>,
    /// Sound speed c over reference velocity U.
    pub sound_speed_factor: f64,
    /// Background pressure over density c^2.
    pub background_pressure_factor: f64,
    /// 0 (off) ... 1 (Adami, Hu and Adams 2013, at the strength that it has at CFL 0.25).
    pub transport_velocity: f64,
    /// Random displacement of the fluid particles at the start, standard deviation in spacings.
    pub jitter: f64,
    /// Extra reach of the neighbour list, in spacings.
    pub skin: f64,
    pub seed: u64,
}

impl Default for Numerics {
    fn default() -> Self {
        Self {
            cfl: 0.25,
            diffusion_number: 0.25,
            time_step: None,
            sound_speed_factor: 10.0,
            background_pressure_factor: 0.0,
            transport_velocity: 1.0,
            jitter: 0.0,
            skin: 0.2,
            seed: 0,
        }
    }
}

impl Numerics {
    /// The largest time step, or the given one.
    pub fn step(&self, spacing: f64, velocity: f64, kinematic_viscosity: f64) -> f64 {
        let acoustic = self.cfl * spacing / ((self.sound_speed_factor + 1.0) * velocity);
        let diffusive = self.diffusion_number * spacing * spacing / kinematic_viscosity;
        self.time_step.unwrap_or(acoustic.min(diffusive))
    }
}

impl Parts {
    /// Fills the model and the state: a lattice with the first particle half a spacing from the box's corner, x fastest,
    /// and velocities from `velocity`.
    pub fn build<R: Real>(self, velocity: impl Fn([f64; 3]) -> [f64; 3]) -> Flow<R> {
        let Self { dimension, cells, wall_rows, spacing, numerics, corner, lid, .. } = self;
        let n: usize = cells[..dimension].iter().product();
        let layout = Layout { dimension, transport: numerics.transport_velocity > 0.0, heat: false, mass: false };
        let dt = numerics.step(spacing, self.velocity, self.kinematic_viscosity);
        let sound_speed = numerics.sound_speed_factor * self.velocity;
        let pressure = sound_speed * sound_speed;
        let place = |i: usize| [i % cells[0], i / cells[0] % cells[1], i / (cells[0] * cells[1])];
        let behind = |i: usize, d: usize| place(i)[d] + wall_rows[d] >= cells[d];
        let is_wall = |i: usize| (0..dimension).any(|d| place(i)[d] < wall_rows[d] || behind(i, d));
        let is_lid = |i: usize| lid != 0.0 && behind(i, 1);
        let tag_of = |i: usize| match is_wall(i) {
            true if is_lid(i) => tag::MOVING_WALL,
            true => tag::WALL,
            false => tag::FLUID,
        };
        let tags: Vec<u8> = (0..n).map(tag_of).collect();
        let size = std::array::from_fn(|d| if d < dimension { cells[d] as f64 * spacing } else { 1.0 });
        let periodic = std::array::from_fn(|d| d < dimension && self.periodic[d]);

        let mut state = vec![R::default(); layout.state_rows() * n];
        let mut normal = Normal::new(stream(numerics.seed, "jitter"));
        for i in 0..n {
            let mut position = [0.0; 3];
            for d in 0..dimension {
                position[d] = (place(i)[d] as f64 + 0.5) * spacing + corner[d];
                if !is_wall(i) {
                    position[d] += numerics.jitter * spacing * normal.next();
                }
                if periodic[d] {
                    position[d] = position[d].rem_euclid(size[d]);
                }
            }
            let u = match is_wall(i) {
                true if is_lid(i) => [lid, 0.0, 0.0],
                true => [0.0; 3],
                false => velocity(position),
            };
            for d in 0..dimension {
                let mut x = R::of(position[d]);
                // Rounded to f32, a place just below the box's end is the end itself.
                if periodic[d] && x >= R::of(size[d]) {
                    x = R::default();
                }
                state[d * n + i] = x;
                state[(layout.velocity() + d) * n + i] = R::of(u[d]);
            }
        }
        let model = Model {
            domain: Domain { dimension, size, periodic },
            layout,
            kernel: Kernel::new(KernelName::QuinticSpline, dimension, spacing),
            tags,
            skin: numerics.skin * spacing,
            dt,
            mass: spacing.powi(dimension as i32),
            equation_of_state: EquationOfState {
                reference_density: 1.0,
                reference_pressure: pressure,
                background_pressure: numerics.background_pressure_factor * pressure,
                gamma: 1,
            },
            viscosity: self.kinematic_viscosity,
            artificial_viscosity: None,
            // Independent of the time step: the strength that dt at CFL 0.25 gives.
            transport: numerics.transport_velocity * 0.25 * spacing / (sound_speed + self.velocity) / dt,
            body_force: self.body_force,
            heat: None,
            scratch: Scratch::default(),
        };
        Flow {
            name: self.name,
            model: Arc::new(model),
            state,
            spacing,
            corner,
            reference_velocity: self.velocity,
            exact: self.exact,
        }
    }
}
