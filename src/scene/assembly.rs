//! The one place where models and start states are put together, from what a scene family says.

use super::surface::{Settings, Surface};
use super::{Exact, Scene};
use crate::config::scene::{
    Config, DensityEquation, DensityGradientName, FluxName, KernelName, SlipName, ViscousPairs,
};
use crate::numerics::lanes::Real;
use crate::numerics::random::{stream, Normal};
use crate::particles::{tag, Domain};
use crate::sph::division::Division;
use crate::sph::kernels::Kernel;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::drive::Drive;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::laws::{
    ArtificialViscosity, DensityDiffusion, DensityGradient, Flux, Riemann, Slip, VelocityDiffusion,
};
use crate::sph::model::{Heat, Layout, Materials, Model, Scratch, Standard};
use crate::sph::solver::Snapshot;
use std::sync::Arc;

/// Numbers of the method rather than of the flow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numerics {
    pub kernel: KernelName,
    /// In spacings.
    pub smoothing_length: f64,
    /// Rows of dummy particles per wall: at least the kernel's support.
    pub wall_rows: usize,
    /// Acoustic limit of the time step: dt <= cfl dx / (c + U).
    pub cfl: f64,
    /// Whether steps are divided where the flow is faster than that.
    pub adaptive: bool,
    /// Diffusive limit: dt <= diffusion_number dx^2 / nu.
    pub diffusion_number: f64,
    /// The time step itself, instead of the limits.
    pub time_step: Option<f64>,
    /// Of the run.
    pub steps: usize,
    /// Sound speed c over reference velocity U.
    pub sound_speed_factor: f64,
    /// Background pressure over density c^2.
    pub background_pressure_factor: f64,
    /// 0 (off) ... 1 (Adami, Hu and Adams 2013, at the strength that it has at CFL 0.25).
    pub transport_velocity: f64,
    /// alpha of [`ArtificialViscosity`]; 0 switches it off.
    pub artificial_viscosity: f64,
    /// Of the standard formulation.
    pub method: Method,
    /// Of the consistent formulation; none: the standard one.
    pub consistent: Option<Settings>,
    /// Random displacement of the fluid particles at the start, standard deviation in spacings.
    pub jitter: f64,
    /// Extra reach of the neighbour list, in spacings.
    pub skin: f64,
    pub seed: u64,
}

/// Choices of the standard formulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Method {
    pub density: DensityEquation,
    pub renormalises: bool,
    pub flux: FluxName,
    /// delta and alpha of delta-SPH.
    pub diffusion: [f64; 2],
    pub gradient: DensityGradientName,
    /// eta of the Riemann problem's limiter.
    pub limiter: f64,
    pub slip: SlipName,
    /// Tait's.
    pub exponent: i32,
    pub viscous: ViscousPairs,
}

impl Default for Method {
    fn default() -> Self {
        Self::from_config(&Config::default())
    }
}

impl Method {
    fn from_config(config: &Config) -> Self {
        let fluid = &config.fluid;
        Self {
            density: fluid.density_equation,
            renormalises: fluid.density_renormalisation,
            flux: fluid.flux,
            diffusion: [fluid.density_diffusion, fluid.velocity_diffusion],
            gradient: fluid.density_gradient,
            limiter: fluid.riemann_limiter,
            slip: config.wall.slip,
            exponent: fluid.equation_of_state_exponent as i32,
            viscous: fluid.artificial_viscosity_pairs,
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
    /// Those of a configuration, for a family whose walls are as thick as the kernel needs.
    pub fn from_config(config: &Config) -> Self {
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
            background_pressure_factor: config.fluid.background_pressure_factor,
            transport_velocity: config.fluid.transport_velocity,
            artificial_viscosity: config.fluid.artificial_viscosity,
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

/// Particles along a side of a box of this size, as counted by the configuration's check: the spacing that divides the box
/// exactly.
pub(super) fn count(config: &Config, size: f64) -> usize {
    (size / config.resolution.dx).round() as usize
}

/// A lattice of particles in a box, x fastest, with walls of dummy particles at its ends.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    pub dimension: usize,
    pub spacing: f64,
    /// Particles along each direction, walls included.
    pub cells: [usize; 3],
    /// Rows of dummy particles at both ends of each direction.
    pub wall_rows: [usize; 3],
    pub periodic: [bool; 3],
    /// The box, if it is not cells times the spacing to the bit.
    pub size: Option<[f64; 3]>,
    /// Cells that have a particle, where not all do: numbered as if all had.
    pub occupied: Option<Vec<usize>>,
    /// Coordinate of a row's first particle: (row + 1/2 - before) spacing + corner.
    pub before: [f64; 3],
    pub corner: [f64; 3],
}

impl Lattice {
    /// Without walls, periodic everywhere, its corner at 0.
    pub fn new(dimension: usize, spacing: f64, cells: [usize; 3]) -> Self {
        let (wall_rows, periodic, before, corner) = ([0; 3], [true; 3], [0.0; 3], [0.0; 3]);
        Self { dimension, spacing, cells, wall_rows, periodic, size: None, occupied: None, before, corner }
    }

    /// A plane channel of height 1: periodic in x, the lower wall's surface at y = 0.
    pub fn channel(columns: usize, rows: usize, walls: usize) -> Self {
        Self {
            wall_rows: [0, walls, 0],
            periodic: [true, false, false],
            corner: [0.0, -(walls as f64) / rows as f64, 0.0],
            ..Self::new(2, 1.0 / rows as f64, [columns, rows + 2 * walls, 1])
        }
    }

    pub fn particles(&self) -> usize {
        let cells = || self.cells[..self.dimension].iter().product();
        self.occupied.as_ref().map_or_else(cells, Vec::len)
    }

    /// Leaves only the particles of walls, and of fluid whose cell's first row behind the walls is in a block.
    pub fn with_block(mut self, first: [usize; 3], behind: [usize; 3]) -> Self {
        let is_in = |rows: [usize; 3]| {
            (0..self.dimension).all(|d| (first[d]..behind[d]).contains(&rows[d].wrapping_sub(self.wall_rows[d])))
        };
        let occupied = (0..self.particles()).filter(|&i| self.is_wall(i) || is_in(self.rows(i))).collect();
        self.occupied = Some(occupied);
        self
    }

    /// Unit normals of the walls at their particles, into the fluid, `[D, N]`, 0 for fluid: from a particle to the nearest
    /// place of the box between the walls. A `lid`'s are its plane's, wherever it has moved.
    fn normals(&self, lid: bool) -> Vec<f64> {
        let (n, half) = (self.particles(), 0.5);
        let mut normals = vec![0.0; self.dimension * n];
        for i in (0..n).filter(|&i| self.is_wall(i)) {
            let rows = self.rows(i);
            let mut normal: [f64; 3] = std::array::from_fn(|d| {
                if d >= self.dimension || self.wall_rows[d] == 0 {
                    return 0.0;
                }
                let (low, high) = (self.wall_rows[d] as f64, (self.cells[d] - self.wall_rows[d]) as f64);
                let at = rows[d] as f64 + half;
                at.clamp(low, high) - at
            });
            if lid && self.is_above(i, 1) {
                normal = [0.0, -1.0, 0.0];
            }
            let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
            (0..self.dimension).for_each(|d| normals[d * n + i] = normal[d] / length);
        }
        normals
    }

    /// Its row along each direction.
    pub fn rows(&self, i: usize) -> [usize; 3] {
        let cells = self.cells;
        let i = self.occupied.as_ref().map_or(i, |occupied| occupied[i]);
        [i % cells[0], i / cells[0] % cells[1], i / (cells[0] * cells[1])]
    }

    /// Whether a particle is in the wall at the lower or at the upper end of direction `d`.
    pub fn is_below(&self, i: usize, d: usize) -> bool {
        self.rows(i)[d] < self.wall_rows[d]
    }
    pub fn is_above(&self, i: usize, d: usize) -> bool {
        self.rows(i)[d] + self.wall_rows[d] >= self.cells[d]
    }

    pub fn is_wall(&self, i: usize) -> bool {
        (0..self.dimension).any(|d| self.is_below(i, d) || self.is_above(i, d))
    }

    /// Where a particle of the lattice stands.
    pub fn place(&self, i: usize) -> [f64; 3] {
        let rows = self.rows(i);
        let place = |d: usize| (rows[d] as f64 + 0.5 - self.before[d]) * self.spacing + self.corner[d];
        std::array::from_fn(|d| if d < self.dimension { place(d) } else { 0.0 })
    }

    /// The box; lengths of directions that there are not are 1.
    fn domain(&self) -> Domain {
        let dimension = self.dimension;
        let of_cells =
            || std::array::from_fn(|d| if d < dimension { self.cells[d] as f64 * self.spacing } else { 1.0 });
        let periodic = std::array::from_fn(|d| d < dimension && self.periodic[d]);
        Domain { dimension, size: self.size.unwrap_or_else(of_cells), periodic }
    }

    /// Positions `[D, N]`, the fluid's moved at random with a standard deviation of `jitter` spacings.
    fn positions(&self, domain: &Domain, jitter: f64, seed: u64) -> Vec<f64> {
        let n = self.particles();
        let mut positions = vec![0.0; self.dimension * n];
        let mut normal = Normal::new(stream(seed, "jitter"));
        for i in 0..n {
            let place = self.place(i);
            for d in 0..self.dimension {
                let mut x = place[d];
                if !self.is_wall(i) {
                    x += jitter * self.spacing * normal.next();
                }
                positions[d * n + i] = if domain.periodic[d] { x.rem_euclid(domain.size[d]) } else { x };
            }
        }
        positions
    }
}

/// What a plane wall is to heat: it has a temperature (above the reference) where from < x < to, and lets no heat through
/// elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WallHeat {
    pub temperature: f64,
    pub from: f64,
    pub to: f64,
}

impl WallHeat {
    pub const ADIABATIC: Self = Self { temperature: 0.0, from: 0.0, to: 0.0 };

    pub fn isothermal(temperature: f64) -> Self {
        Self { temperature, from: f64::NEG_INFINITY, to: f64::INFINITY }
    }

    /// The temperature at a place, where it has one.
    pub fn at(&self, x: f64) -> Option<f64> {
        (x > self.from && x < self.to).then_some(self.temperature)
    }
}

/// What a scene is made of: what a family says of it.
pub(super) struct Parts<R> {
    pub name: &'static str,
    pub lattice: Lattice,
    pub numerics: Numerics,
    pub density: f64,
    /// Reference velocity U.
    pub velocity: f64,
    /// Dynamic.
    pub viscosity: f64,
    pub body_force: BodyForce,
    /// What drives the flow besides.
    pub drive: Option<Drive>,
    /// Velocity along x of the wall above; 0: it is like the others.
    pub lid: f64,
    /// Whether each particle has a mass of its own.
    pub own_mass: bool,
    pub heat: Option<Heat<R>>,
    /// The lower and the upper wall, where lattice and heat are those of [`Self::warm`].
    pub heat_walls: Option<[WallHeat; 2]>,
    pub exact: Exact,
}

/// A model, and the start's positions and velocities in f64: the other rows of the state are 0.
pub(super) struct Assembled<R> {
    pub model: Model<R>,
    /// `[F, N]`, see [`Layout`].
    pub base: Vec<f64>,
}

impl<R: Real> Parts<R> {
    /// The same with heat of unit capacity, conducting where `ends[0]` < x < `ends[1]` (fluid before that has the reference
    /// temperature 0), between two walls whose surfaces have their temperatures.
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
            // T = 2 T_wall - <T>: the surface half way between has T_wall.
            wall_constant: given.iter().map(|t| R::of(t.map_or(0.0, |t| 2.0 * t))).collect(),
            wall_factor: given.iter().map(|t| R::of(if t.is_some() { -1.0 } else { 1.0 })).collect(),
            materials,
        });
        self.heat_walls = Some(walls);
        self
    }

    /// The model, and the start with the fluid's velocity as a function of the place.
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

    fn model(&mut self) -> Model<R> {
        let Self { lattice, numerics, density, .. } = self;
        let (dx, density) = (lattice.spacing, *density);
        let layout = Layout {
            dimension: lattice.dimension,
            transport: numerics.transport_velocity > 0.0,
            heat: self.heat.is_some(),
            mass: self.own_mass,
            density: numerics.method.density == DensityEquation::Evolution,
            consistent: false,
            rates: false,
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
            Standard::<R>::asks_for_normals(&flux, slip).then(|| lattice.normals(lid).into_iter().map(R::of).collect());
        Model {
            domain: lattice.domain(),
            layout,
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
            artificial_viscosity: (alpha > 0.0).then_some(artificial),
            // Independent of the time step: the strength that dt at CFL 0.25 gives.
            transport: numerics.transport_velocity * 0.25 * dx / (sound_speed + self.velocity) / dt,
            body_force: self.body_force,
            walls_slide: false,
            drive: self.drive,
            heat: self.heat.take(),
            wall_heat_until: None,
            consistent: None,
            fixed: None,
            standard: Standard { renormalises: method.renormalises, flux, slip, normals },
            scratch: Scratch::default(),
        }
    }

    /// The scene without a design.
    pub fn build(self, velocity: impl Fn([f64; 3]) -> [f64; 3]) -> Scene<R> {
        self.build_with_pressure(velocity, |_| 0.0)
    }

    /// The same with a pressure at the start, which the standard formulation has no use for.
    pub fn build_with_pressure(
        mut self,
        velocity: impl Fn([f64; 3]) -> [f64; 3],
        pressure: impl Fn([f64; 3]) -> f64,
    ) -> Scene<R> {
        let mut assembled = self.assemble(velocity);
        if let Some(settings) = self.numerics.consistent {
            let surface = Surface::of_lattice(&self.lattice, self.lid, self.heat_walls);
            assembled = assembled.with_surface(&surface, &self.numerics, self.lattice.spacing, self.velocity, settings);
            let Assembled { model, base } = &mut assembled;
            let (n, l) = (model.particles(), model.layout);
            for i in (0..n).filter(|&i| model.is_fluid(i)) {
                let place = std::array::from_fn(|d| if d < l.dimension { base[d * n + i] } else { 0.0 });
                base[l.pressure() * n + i] = pressure(place);
            }
        }
        let Assembled { model, base } = assembled;
        let start = Snapshot::first(&model, rounded(&model, &base));
        self.scene(Arc::new(model), start)
    }

    pub fn scene(self, model: Arc<Model<R>>, start: Snapshot<R>) -> Scene<R> {
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

/// A state in R. Rounded to f32, a place just below the box's end is the end itself: it becomes the beginning.
pub(super) fn rounded<R: Real>(model: &Model<R>, base: &[f64]) -> Vec<R> {
    let (n, domain) = (model.particles(), &model.domain);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::builtin::SCENES;

    fn scene(name: &str, sets: &[&str]) -> Scene<f64> {
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let loaded = Config::load(Some(name), None, &sets).unwrap_or_else(|error| panic!("{name}: {error}"));
        Scene::from_config(&loaded.config).unwrap()
    }

    /// Other formulations have no artificial viscosity.
    const STANDARD: &str = "fluid.formulation=standard";

    #[test]
    fn configured_kernels_and_laws_reach_every_scene() {
        // What is at rest has no artificial viscosity, and one scene is not solved with the standard formulation.
        for built_in in SCENES.iter().filter(|built_in| !["slab", "heated-channel-3d"].contains(&built_in.name)) {
            let usual = scene(built_in.name, &[STANDARD]);
            assert_eq!(usual.name, built_in.name);
            assert_eq!(usual.model.artificial_viscosity.is_some(), built_in.name.starts_with("dam-break"));
            assert_eq!(usual.model.kernel.smoothing_length, usual.spacing);
            let sets = ["resolution.kernel=\"wendland-c2\"", "resolution.smoothing_length=1.5"];
            let other = scene(built_in.name, &[STANDARD, sets[0], sets[1], "fluid.artificial_viscosity=0.1"]);
            let kernel = Kernel::new(KernelName::WendlandC2, other.model.layout.dimension, 1.5 * other.spacing);
            assert_eq!(other.model.kernel, kernel);
            let artificial = other.model.artificial_viscosity.unwrap();
            assert_eq!((artificial.alpha, artificial.smoothing_length), (0.1, 1.5 * other.spacing));
            assert!((artificial.sound_speed - other.sound_speed()).abs() < 1e-12 * artificial.sound_speed);
            assert_eq!(other.model.tags, usual.model.tags);
        }
    }

    #[test]
    fn walls_are_as_thick_as_the_kernel_needs() {
        let wide = ["resolution.smoothing_length=1.3"];
        let particles = |name: &str| scene(name, &wide).model.particles();
        assert_eq!(
            (particles("poiseuille"), particles("lid-driven-cavity")),
            (12 * (40 + 8) + 2 * 12, 58 * 58 + 4 * 50)
        );
        assert_eq!(scene("heated-channel", &[STANDARD, wide[0]]).model.particles(), 50 * (10 + 8));
        // A particle half a spacing from the wall sees four rows too; and there are 250 points on the walls' surfaces.
        assert_eq!(particles("heated-channel"), 50 * (10 + 8) + 250);
        assert_eq!(scene("poiseuille", &wide).corner, [0.0, -0.1, 0.0]);
    }
}
