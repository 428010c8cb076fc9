//! What a scene needs and nothing else: the plan of its fields and all its constants.

use crate::numerics::blocks::Blocks;
use crate::numerics::lanes::Real;
use crate::numerics::pool::{Buffers, Pool};
use crate::particles::{Domain, Reach};
use crate::sph::consistent::{Consistent, Kept};
use crate::sph::division::Division;
use crate::sph::fixed::Fixed;
use crate::sph::kernels::Kernel;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::drive::Drive;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::laws::{ArtificialViscosity, Flux, Slip};
use crate::sph::operators::pairs::PairCache;
use std::sync::Arc;

/// Which fields exist in a scene, and where they stand in the packed tensors `[fields, N]`.
///
/// No heat: no temperature row anywhere. No transport velocity: no second acceleration. Equal and constant
/// mass: no mass row. D = dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    pub dimension: usize,
    pub transport: bool,
    pub heat: bool,
    pub mass: bool,
    /// Whether the density evolves: then it is a row of the state; else it is summed anew in each step.
    pub density: bool,
    /// The state of the consistent formulation, and of fixed particles: position D, velocity D, pressure, (temperature).
    pub consistent: bool,
    /// Of the consistent formulation, behind these: the last step's acceleration D, (rate of temperature).
    pub rates: bool,
}

impl Layout {
    fn d(&self) -> usize {
        self.dimension
    }
    fn w(&self) -> usize {
        if self.transport {
            self.dimension
        } else {
            0
        }
    }

    /// State: position D, velocity D, acceleration D, (transport acceleration D), (temperature, its rate), (mass), (density).
    pub fn state_rows(&self) -> usize {
        match self.consistent {
            true => self.last_rates() + self.rates as usize * (self.d() + self.heat as usize),
            false => self.state_density() + self.density as usize,
        }
    }
    /// Fields of the consistent formulation: velocity D, pressure, (temperature).
    pub fn fields(&self) -> usize {
        self.d() + 1 + self.heat as usize
    }
    /// Of the consistent formulation's state: where the last step's rates begin.
    pub fn last_rates(&self) -> usize {
        self.d() + self.fields()
    }
    /// Likewise.
    pub fn pressure(&self) -> usize {
        2 * self.d()
    }
    pub fn velocity(&self) -> usize {
        self.d()
    }
    pub fn acceleration(&self) -> usize {
        2 * self.d()
    }
    pub fn transport_acceleration(&self) -> usize {
        3 * self.d()
    }
    pub fn temperature(&self) -> usize {
        match self.consistent {
            true => 2 * self.d() + 1,
            false => 3 * self.d() + self.w(),
        }
    }
    pub fn temperature_rate(&self) -> usize {
        self.temperature() + 1
    }
    pub fn state_mass(&self) -> usize {
        self.temperature() + 2 * self.heat as usize
    }
    pub fn state_density(&self) -> usize {
        self.state_mass() + self.mass as usize
    }

    /// Moved state, after the drift: position D, velocity D, (transport velocity - velocity D),
    /// (temperature before, temperature after), (mass), (density before).
    pub fn moved_rows(&self) -> usize {
        self.moved_density() + self.density as usize
    }
    pub fn moved_shift(&self) -> usize {
        2 * self.d()
    }
    pub fn moved_old_temperature(&self) -> usize {
        2 * self.d() + self.w()
    }
    pub fn moved_temperature(&self) -> usize {
        self.moved_old_temperature() + 1
    }
    pub fn moved_mass(&self) -> usize {
        self.moved_old_temperature() + 2 * self.heat as usize
    }
    pub fn moved_density(&self) -> usize {
        self.moved_mass() + self.mass as usize
    }

    /// Primitives, walls included: density, velocity D, (transport velocity - velocity D), (temperature).
    pub fn primitive_rows(&self) -> usize {
        self.primitive_temperature() + self.heat as usize
    }
    pub fn primitive_velocity(&self) -> usize {
        1
    }
    pub fn primitive_shift(&self) -> usize {
        1 + self.d()
    }
    pub fn primitive_temperature(&self) -> usize {
        1 + self.d() + self.w()
    }

    /// Rates: acceleration D, (transport acceleration D), (temperature rate).
    pub fn rate_rows(&self) -> usize {
        self.rate_temperature() + self.heat as usize
    }
    pub fn rate_transport(&self) -> usize {
        self.d()
    }
    pub fn rate_temperature(&self) -> usize {
        self.d() + self.w()
    }
}

/// Heat conduction and its boundary conditions. Temperatures are kept as T - `reference`, because f32 has
/// no digits to spare for the constant (its gradient error falls from 0.56 to 2e-4 over 20 steps of the
/// heated channel).
#[derive(Debug, Clone, PartialEq)]
pub struct Heat<R> {
    pub conductivity: f64,
    pub capacity: f64,
    /// The temperature subtracted from every stored one; also that of the inlet.
    pub reference: f64,
    /// Fluid with x below this is reset to `reference` and does not conduct.
    pub inlet_below: f64,
    /// Fluid with x above this does not conduct.
    pub outlet_above: f64,
    /// Wall particles: T = wall_constant + wall_factor * (Shepard average of the fluid), `[N]`.
    pub wall_constant: Vec<R>,
    pub wall_factor: Vec<R>,
    /// None where all is of one material. In the standard formulation only, without a transport velocity.
    pub materials: Option<Materials<R>>,
}

/// What particles are made of, where not all are of the same material; walls have that of what is in front of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Materials<R> {
    /// Over [`Heat::conductivity`], `[N]`.
    pub conductivity: Vec<R>,
    /// Over [`Heat::capacity`], `[N]`.
    pub capacity: Vec<R>,
}

impl<R: Real> Heat<R> {
    /// The largest conductivity over heat capacity.
    pub fn largest_diffusivity(&self) -> f64 {
        let ratio = |of: &Materials<R>| {
            let all = of.conductivity.iter().zip(&of.capacity);
            all.map(|(conductivity, capacity)| conductivity.f64() / capacity.f64()).fold(0.0, f64::max)
        };
        self.materials.as_ref().map_or(1.0, ratio) * self.conductivity / self.capacity
    }

    /// The conductivities of particles, over that of the scene, where there are materials.
    pub fn conductivities(&self) -> Option<&[R]> {
        self.materials.as_ref().map(|materials| materials.conductivity.as_slice())
    }
}

/// Which of the standard formulation's methods a scene takes, besides the rows that its [`Layout`] has. The default: pair
/// forces between walls that nothing slips along.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Standard<R> {
    /// Whether an evolved density is renormalised in each step, see [`crate::sph::operators::renormalisation`].
    pub renormalises: bool,
    pub flux: Flux,
    pub slip: Slip,
    /// Unit normals of the walls, from the wall into the fluid, `[D, N]`, 0 for fluid; none where nothing asks for them.
    pub normals: Option<Vec<R>>,
}

impl<R> Standard<R> {
    /// Whether a flux or a boundary condition reads the walls' normals.
    pub fn asks_for_normals(flux: &Flux, slip: Slip) -> bool {
        slip == Slip::Free || matches!(flux, Flux::Riemann(_))
    }
}

/// Everything about a scene that does not change while it runs.
#[derive(Debug)]
pub struct Model<R> {
    pub domain: Domain,
    pub layout: Layout,
    pub kernel: Kernel,
    pub tags: Vec<u8>,
    /// Extra reach of the neighbour list.
    pub skin: f64,
    pub dt: f64,
    /// By what a step is divided; none where all are whole.
    pub division: Option<Division>,
    /// Mass of every particle where the layout has no mass row.
    pub mass: f64,
    pub equation_of_state: EquationOfState,
    /// Dynamic viscosity.
    pub viscosity: f64,
    /// None where the scene has none.
    pub artificial_viscosity: Option<ArtificialViscosity>,
    /// Strength of the transport velocity (0: off).
    pub transport: f64,
    pub body_force: BodyForce,
    /// Walls with a velocity stay where they are, like a belt or a turning roll; else their particles move with it.
    pub walls_slide: bool,
    /// What drives the flow besides, in the consistent formulation; fixed particles have their own.
    pub drive: Option<Drive>,
    pub heat: Option<Heat<R>>,
    /// Up to which x the walls' heat is summed for an objective, where one asks for it.
    pub wall_heat_until: Option<f64>,
    /// The methods of the standard formulation.
    pub standard: Standard<R>,
    /// What the consistent formulation needs; none in the standard one.
    pub consistent: Option<Consistent<R>>,
    /// Particles that do not move; then nothing else of the model's laws is asked.
    pub fixed: Option<Arc<Fixed<R>>>,
    /// Buffers that operators borrow, so that a step does not allocate.
    pub scratch: Scratch<R>,
}

impl<R: Real> Model<R> {
    pub fn particles(&self) -> usize {
        self.tags.len()
    }
    /// Who the particles are, and how far they see.
    pub fn reach(&self) -> Reach<'_> {
        Reach { tags: &self.tags, domain: &self.domain, cutoff: self.kernel.cutoff(), skin: self.skin }
    }
    /// Whether every operator of its step has a fused kernel. The others run from candle's operators, whatever kernels are
    /// asked for.
    pub fn is_fused(&self) -> bool {
        let Standard { renormalises, flux, slip, .. } = &self.standard;
        let standard = !renormalises && *flux == Flux::Pair && *slip == Slip::None;
        standard || self.consistent.is_some() || self.fixed.is_some()
    }
    pub fn is_fluid(&self, i: usize) -> bool {
        self.tags[i] == crate::particles::tag::FLUID
    }
    pub fn has_walls(&self) -> bool {
        self.tags.iter().any(|&t| t != crate::particles::tag::FLUID)
    }
}

/// What operators borrow, so that a step does not allocate.
#[derive(Debug)]
pub struct Scratch<R> {
    pub buffers: Buffers<R>,
    /// What the operators of a step keep for each other.
    pub caches: Pool<PairCache<R>>,
    pub fits: Pool<Kept<R>>,
    /// States that a gradient keeps, and such rounded to single precision.
    pub states: Blocks,
    pub rounded_states: Blocks,
}

impl<R> Default for Scratch<R> {
    fn default() -> Self {
        Self {
            buffers: Pool::default(),
            caches: Pool::default(),
            fits: Pool::default(),
            states: Blocks::default(),
            rounded_states: Blocks::default(),
        }
    }
}
