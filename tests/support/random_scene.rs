//! Random particles for which every term of every operator counts: jittered lattices with random fields.

use hydrograd::config::scene::FluxName;
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::particles::Neighbourhood;
use hydrograd::particles::{tag, Domain};
use hydrograd::sph::flow::{Flow, Heat, Materials};
use hydrograd::sph::kernels::{Kernel, KernelName};
use hydrograd::sph::laws::body_force::BodyForce;
use hydrograd::sph::laws::buoyancy::Buoyancy;
use hydrograd::sph::laws::equation_of_state::EquationOfState;
use hydrograd::sph::laws::{
    ArtificialViscosity, DensityDiffusion, DensityGradient, Flux, Riemann, Slip, VelocityDiffusion,
};
use hydrograd::sph::standard::chain::Step;
use hydrograd::sph::standard::{Laws, Layout, Standard};
use hydrograd::sph::Sweeps;
use std::sync::Arc;

/// What a random scene has.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    pub dimension: usize,
    pub walls: bool,
    pub periodic: [bool; 3],
    pub transport: bool,
    pub heat: bool,
    pub mass: bool,
    pub gamma: i32,
    pub kernel: KernelName,
    /// Smoothing length in spacings.
    pub smoothing: f64,
    pub artificial_viscosity: bool,
    /// Conductivities and capacities of particles; needs heat, and no transport velocity.
    pub materials: bool,
    /// The density evolves, gravity pulls, and artificial viscosity acts on every pair.
    pub density: bool,
    pub flux: FluxName,
    /// The flow slips along the walls.
    pub slips: bool,
    /// An evolved density is renormalised.
    pub renormalises: bool,
    pub seed: u64,
}

impl Options {
    pub fn plain(dimension: usize) -> Self {
        Self {
            dimension,
            walls: false,
            periodic: [true; 3],
            transport: false,
            heat: false,
            mass: false,
            gamma: 1,
            kernel: KernelName::QuinticSpline,
            smoothing: 1.0,
            artificial_viscosity: false,
            materials: false,
            density: false,
            flux: FluxName::Pair,
            slips: false,
            renormalises: false,
            seed: 0,
        }
    }

    /// Everything on.
    pub fn rich(dimension: usize) -> Self {
        Self {
            walls: true,
            periodic: [true, false, true],
            transport: true,
            heat: true,
            mass: true,
            gamma: 7,
            ..Self::plain(dimension)
        }
    }
}

/// Particle spacing.
pub const DX: f64 = 0.05;
const REFERENCE_TEMPERATURE: f64 = 1.0;

/// A scene in f64: converted to the precision under test by [`RandomScene::model`] and [`RandomScene::state`].
pub struct RandomScene {
    pub options: Options,
    pub tags: Vec<u8>,
    pub state: Vec<f64>,
    pub wall_constant: Vec<f64>,
    pub wall_factor: Vec<f64>,
    /// Over those of the scene.
    pub conductivity: Vec<f64>,
    pub capacity: Vec<f64>,
    pub size: [f64; 3],
    /// Heat conduction everywhere: no inlet, no outlet.
    pub open_everywhere: bool,
    pub body_force: BodyForce,
    /// With heat.
    pub buoyancy: Option<Buoyancy>,
    pub walls_slide: bool,
}

impl RandomScene {
    pub fn new(options: Options) -> Self {
        let d = options.dimension;
        // Periodic boxes need 6.4 spacings. Four rows of walls: no fluid reaches the outermost one.
        let (wall_rows, cells) = match (d, options.walls) {
            (2, false) => (0, [14, 12, 1]),
            (2, true) => (4, [14, 18, 1]),
            (_, false) => (0, [7, 8, 7]),
            (_, true) => (4, [7, 13, 7]),
        };
        let n: usize = cells.iter().product();
        let mut normal = Normal::new(stream(options.seed, "scene"));
        let layout = options.layout();
        let mut state = vec![0.0; layout.state_rows() * n];
        let (mut tags, mut constant, mut factor) = (vec![tag::FLUID; n], vec![0.0; n], vec![1.0; n]);
        for i in 0..n {
            let place = [i % cells[0], i / cells[0] % cells[1], i / (cells[0] * cells[1])];
            let lower = place[1] < wall_rows;
            if options.walls && (lower || place[1] >= cells[1] - wall_rows) {
                // Kinds of walls in turn: at rest and adiabatic, moving, hot in the dummies, hot on the surface.
                tags[i] = [tag::WALL, tag::HOT_WALL, tag::MOVING_WALL][place[0] % 3];
                if tags[i] == tag::HOT_WALL {
                    (constant[i], factor[i]) = if lower { (0.23, 0.0) } else { (0.46, -1.0) };
                }
            }
            for k in 0..d {
                let x = (place[k] as f64 + 0.5 + 0.12 * normal.next()) * DX;
                let length = cells[k] as f64 * DX;
                state[k * n + i] = if options.periodic[k] { x.rem_euclid(length) } else { x };
                state[(layout.velocity() + k) * n + i] = 0.5 * normal.next();
                state[(layout.acceleration() + k) * n + i] = normal.next();
                if layout.transport {
                    state[(layout.transport_acceleration() + k) * n + i] = 20.0 * normal.next();
                }
            }
            if layout.heat {
                state[layout.temperature() * n + i] = 0.1 * normal.next();
                state[layout.temperature_rate() * n + i] = normal.next();
            }
            if layout.mass {
                state[layout.state_mass() * n + i] = options.typical_mass() * (1.0 + 0.1 * normal.next());
            }
            if layout.density {
                state[layout.state_density() * n + i] = 1.2 * (1.0 + 0.02 * normal.next());
            }
        }
        let size = std::array::from_fn(|k| cells[k] as f64 * DX);
        Self {
            options,
            tags,
            state,
            wall_constant: constant,
            wall_factor: factor,
            // Three materials in turn, 1 : 30 : 1000.
            conductivity: (0..n).map(|i| [1.0, 30.0, 1e-3][i % 3]).collect(),
            capacity: (0..n).map(|i| [1.0, 0.2, 3.0][i % 3]).collect(),
            size,
            open_everywhere: false,
            body_force: match options.density || options.seed % 5 == 2 {
                true => BodyForce::Gravity([0.7, -2.3, 1.1]),
                false => BodyForce::Band { strength: 2.3, from: 0.3 * size[1], to: 0.6 * size[1] },
            },
            buoyancy: Buoyancy::new(1.7, &[0.7, -2.3, 1.1], 0.04)
                .filter(|_| options.seed % 2 == 1 || options.seed % 5 == 2),
            walls_slide: options.seed % 3 == 1,
        }
    }

    pub fn particles(&self) -> usize {
        self.tags.len()
    }

    pub fn model<R: Sweeps>(&self) -> Arc<Standard<R>> {
        let options = self.options;
        let convert = |x: &[f64]| x.iter().map(|&x| R::of(x)).collect::<Vec<R>>();
        let (density, sound_speed) = (1.2, 5.0);
        let pressure = density * sound_speed * sound_speed / options.gamma as f64;
        let domain = Domain { dimension: options.dimension, size: self.size, periodic: options.periodic };
        let equation_of_state = EquationOfState {
            reference_density: density,
            reference_pressure: pressure,
            background_pressure: 0.05 * pressure,
            gamma: options.gamma,
        };
        let flow = Flow {
            kernel: Kernel::new(options.kernel, options.dimension, options.smoothing * DX),
            mass: options.typical_mass(),
            viscosity: 0.3,
            body_force: self.body_force,
            buoyancy: self.buoyancy.filter(|_| options.heat),
            walls_slide: self.walls_slide,
            heat: options.heat.then(|| Heat {
                conductivity: 7.313,
                capacity: 30.527,
                reference: REFERENCE_TEMPERATURE,
                inlet_below: if self.open_everywhere { f64::NEG_INFINITY } else { 0.15 * self.size[0] },
                outlet_above: if self.open_everywhere { f64::INFINITY } else { 0.85 * self.size[0] },
                wall_constant: convert(&self.wall_constant),
                wall_factor: convert(&self.wall_factor),
                materials: options.materials.then(|| Materials {
                    conductivity: convert(&self.conductivity),
                    capacity: convert(&self.capacity),
                }),
            }),
            ..Flow::new(domain, self.tags.clone(), DX, equation_of_state, 1e-3)
        };
        let smoothing_length = options.smoothing * DX;
        let artificial_viscosity = options.artificial_viscosity.then_some(ArtificialViscosity {
            alpha: 0.7,
            beta: 1.1,
            sound_speed,
            smoothing_length,
            every_pair: options.density,
        });
        let velocity_diffusion = (options.flux == FluxName::Delta).then_some(VelocityDiffusion {
            strength: 0.4,
            sound_speed,
            smoothing_length,
            reference_density: density,
        });
        let gradient = DensityGradient::Renormalised;
        let laws = Laws {
            transport: if options.transport { 0.7 } else { 0.0 },
            further: (artificial_viscosity, velocity_diffusion),
            renormalises: options.renormalises,
            flux: match options.flux {
                FluxName::Pair => Flux::Pair,
                FluxName::Delta => {
                    Flux::Delta(DensityDiffusion { strength: 0.3, sound_speed, smoothing_length, gradient })
                }
                FluxName::Riemann => Flux::Riemann(Riemann { sound_speed, limiter: 3.0 }),
            },
            slip: if options.slips { Slip::Free } else { Slip::None },
            normals: Some(convert(&self.normals())),
        };
        Arc::new(Standard::new(flow, options.layout(), laws))
    }

    /// Unit normals of the walls, leaning out of their planes; 0 for fluid.
    fn normals(&self) -> Vec<f64> {
        let (n, d) = (self.particles(), self.options.dimension);
        let leaning = if d == 2 { [0.6, 0.8, 0.0] } else { [0.48, 0.8, 0.36] };
        let mut normals = vec![0.0; d * n];
        for i in (0..n).filter(|&i| self.tags[i] != tag::FLUID) {
            let up = if self.state[n + i] < 0.5 * self.size[1] { 1.0 } else { -1.0 };
            (0..d).for_each(|k| normals[k * n + i] = if k == 1 { up * leaning[1] } else { leaning[k] });
        }
        normals
    }

    pub fn state<R: Sweeps>(&self) -> Vec<R> {
        self.state.iter().map(|&x| R::of(x)).collect()
    }

    /// The operators' context with the list of these positions.
    pub fn step<R: Sweeps>(&self, model: &Arc<Standard<R>>, position: &[R]) -> Arc<Step<R>> {
        let neighbourhood = Neighbourhood::build(&model.reach(), position).unwrap();
        Arc::new(Step { model: model.clone(), list: neighbourhood.list })
    }

    /// The same particles in another order: particle i of the result is particle `order[i]` of this scene.
    pub fn permuted(&self, order: &[usize]) -> Self {
        let n = self.particles();
        Self {
            tags: order.iter().map(|&i| self.tags[i]).collect(),
            state: permute(&self.state, n, order),
            wall_constant: permute(&self.wall_constant, n, order),
            wall_factor: permute(&self.wall_factor, n, order),
            conductivity: permute(&self.conductivity, n, order),
            capacity: permute(&self.capacity, n, order),
            ..*self
        }
    }
}

/// Rows `[F, N]` with their columns in another order.
pub fn permute<T: Copy>(rows: &[T], n: usize, order: &[usize]) -> Vec<T> {
    rows.chunks(n).flat_map(|row| order.iter().map(|&i| row[i])).collect()
}

impl Options {
    pub fn layout(&self) -> Layout {
        Layout {
            dimension: self.dimension,
            transport: self.transport,
            heat: self.heat,
            mass: self.mass,
            density: self.density,
        }
    }
    fn typical_mass(&self) -> f64 {
        1.2 * DX.powi(self.dimension as i32)
    }
}
