//! The flow that a method solves: particles and their tags, the box, the material and the driving forces.

use super::division::Division;
use super::part::Part;
use super::rows::{Quantity, Rows};
use crate::numerics::blocks::Blocks;
use crate::numerics::lanes::Real;
use crate::numerics::pool::Buffers;
use crate::numerics::sweep::{run_rows, run_some_rows, RowKernel};
use crate::numerics::total::Total;
use crate::particles::{tag, Domain, NeighbourList, Reach};
use crate::sph::kernels::{Kernel, KernelName};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::buoyancy::Buoyancy;
use crate::sph::laws::drive::Drive;
use crate::sph::laws::equation_of_state::EquationOfState;
use crate::sph::own::Own;
use candle_core::{Result, Tensor};
use std::sync::Arc;

/// Into how many pieces a sweep is cut, between which messages get time.
const PIECES: usize = 8;

/// Heat conduction and its boundary conditions. Temperatures are stored as T - `reference`, because f32 has no digits
/// to spare for the constant (over 20 steps of the heated channel this lowers the error of the f32 gradient from 0.56
/// to 2e-4).
#[derive(Debug, Clone, PartialEq)]
pub struct Heat<R> {
    pub conductivity: f64,
    pub capacity: f64,
    /// The temperature that is subtracted from every stored one; also the inlet's temperature.
    pub reference: f64,
    /// Fluid with x below this is reset to `reference` and does not conduct.
    pub inlet_below: f64,
    /// Fluid with x above this does not conduct.
    pub outlet_above: f64,
    /// Wall particles: T = wall_constant + wall_factor * (Shepard average of the fluid), `[N]`.
    pub wall_constant: Vec<R>,
    pub wall_factor: Vec<R>,
    /// Several materials, or none where there is one. Only the standard method without transport velocity has them.
    pub materials: Option<Materials<R>>,
}

/// The material of each particle, where there are several. Wall particles have that of the fluid in front of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Materials<R> {
    /// Conductivity relative to [`Heat::conductivity`], `[N]`.
    pub conductivity: Vec<R>,
    /// Heat capacity relative to [`Heat::capacity`], `[N]`.
    pub capacity: Vec<R>,
}

impl<R: Real> Heat<R> {
    /// The largest ratio of conductivity to heat capacity.
    pub fn largest_diffusivity(&self) -> f64 {
        let ratio = |of: &Materials<R>| {
            let all = of.conductivity.iter().zip(&of.capacity);
            all.map(|(conductivity, capacity)| conductivity.f64() / capacity.f64()).fold(0.0, f64::max)
        };
        self.materials.as_ref().map_or(1.0, ratio) * self.conductivity / self.capacity
    }

    /// Conductivity of each particle relative to [`Heat::conductivity`], `[N]`; none where all are of one material.
    pub fn conductivities(&self) -> Option<&[R]> {
        self.materials.as_ref().map(|materials| materials.conductivity.as_slice())
    }
}

/// Everything about a scene that does not change during a run, for any method.
#[derive(Debug, Clone)]
pub struct Flow<R> {
    pub domain: Domain,
    /// The rows of a state `[F, N]`.
    pub rows: Rows,
    pub kernel: Kernel,
    /// Kind of each particle, `[N]`, see [`tag`].
    pub tags: Vec<u8>,
    /// Extra reach of the neighbour list beyond the cut-off. Length.
    pub skin: f64,
    /// Time step.
    pub dt: f64,
    /// The rule that divides a step; none where steps are never divided.
    pub division: Option<Division>,
    /// Mass of a fluid particle, density * dx^D.
    pub mass: f64,
    pub equation_of_state: EquationOfState,
    /// Dynamic viscosity.
    pub viscosity: f64,
    pub body_force: BodyForce,
    /// Only with heat.
    pub buoyancy: Option<Buoyancy>,
    /// Drive that holds the flow rate or the power, if one is given.
    pub drive: Option<Drive>,
    /// Whether particles of a moving wall stay in place, as for a belt or a turning roll; otherwise they move with it.
    pub walls_slide: bool,
    pub heat: Option<Heat<R>>,
    /// The heat of the walls is summed over fluid with x below this, if an objective needs it.
    pub wall_heat_until: Option<f64>,
    /// x of the section through which heat flows out, if there is one.
    pub section: Option<f64>,
    /// Where this is the part of a flow that one of several ranks computes.
    pub part: Option<Arc<Part>>,
    /// Buffers that steps and gradients reuse, so that they do not allocate.
    pub scratch: Scratch<R>,
}

impl<R> Flow<R> {
    /// A flow of particles with a spacing, by the quintic spline with that smoothing length, without viscosity, forces
    /// and heat. Other values are set by struct update, as in `Flow { viscosity: 0.01, ..Flow::new(...) }`.
    pub fn new(domain: Domain, tags: Vec<u8>, spacing: f64, equation_of_state: EquationOfState, dt: f64) -> Self {
        let dimension = domain.dimension;
        Self {
            domain,
            rows: Rows::new(dimension, &[]),
            kernel: Kernel::new(KernelName::QuinticSpline, dimension, spacing),
            tags,
            skin: 0.2 * spacing,
            dt,
            division: None,
            mass: equation_of_state.reference_density * spacing.powi(dimension as i32),
            equation_of_state,
            viscosity: 0.0,
            body_force: BodyForce::None,
            buoyancy: None,
            drive: None,
            walls_slide: false,
            heat: None,
            wall_heat_until: None,
            section: None,
            part: None,
            scratch: Scratch::default(),
        }
    }

    /// The number of particles, N.
    pub fn particles(&self) -> usize {
        self.tags.len()
    }
    /// The number of dimensions, D.
    pub fn dimension(&self) -> usize {
        self.domain.dimension
    }
    /// What a neighbour search needs: tags, domain, cut-off and skin.
    pub fn reach(&self) -> Reach<'_> {
        let (own, lent) = self.part.as_ref().map_or((&[][..], &[][..]), |part| (&part.own, &part.lent_to_any));
        let ranks = self.part.as_ref().map(|part| &part.ranks);
        Reach {
            tags: &self.tags,
            own,
            lent,
            domain: &self.domain,
            cutoff: self.kernel.cutoff(),
            skin: self.skin,
            ranks,
        }
    }
    pub fn is_fluid(&self, i: usize) -> bool {
        self.tags[i] == tag::FLUID
    }
    /// Whether sums over all particles count particle i here, and not on another rank.
    pub fn is_own(&self, i: usize) -> bool {
        self.part.as_ref().is_none_or(|part| part.own[i])
    }
    /// Sums over own particles, added up over the ranks.
    pub fn over_ranks<const K: usize>(&self, sums: [Total; K]) -> [f64; K] {
        let Some(part) = &self.part else { return sums.map(Total::value) };
        let own: Vec<f64> = sums.iter().flat_map(|total| [total.sum, total.lost]).collect();
        let all = part.ranks.all(&own);
        let of = |rank: &[f64], k: usize| Total { sum: rank[2 * k], lost: rank[2 * k + 1] };
        std::array::from_fn(|k| {
            all.chunks_exact(2 * K).map(|rank| of(rank, k)).fold(Total::default(), Total::plus).value()
        })
    }
    pub fn has_walls(&self) -> bool {
        self.tags.iter().any(|&t| t != tag::FLUID)
    }
    /// Component `d` of the acceleration of fluid at height y by body force and buoyancy. `temperature` is asked for with buoyancy only.
    #[inline(always)]
    pub fn given(&self, d: usize, y: f64, temperature: impl FnOnce() -> f64) -> f64 {
        let given = self.body_force.along(d, y);
        match &self.buoyancy {
            Some(buoyancy) => given + buoyancy.along(d, temperature()),
            None => given,
        }
    }
    /// The same at positions `[D, N]`, `[D, N]`; `fields` has the temperature in `row`.
    pub fn given_composed(&self, position: &Tensor, fields: &Tensor, row: usize) -> Result<Tensor> {
        let given = self.body_force.vector(position)?;
        match &self.buoyancy {
            Some(buoyancy) => given + buoyancy.composed(self.dimension(), &fields.narrow(0, row, 1)?)?,
            None => Ok(given),
        }
    }
    /// The speed of sound, c = sqrt(gamma p_ref / rho_ref).
    pub fn sound_speed(&self) -> f64 {
        let state = &self.equation_of_state;
        (state.gamma as f64 * state.reference_pressure / state.reference_density).sqrt()
    }
}

impl<R: Real> Flow<R> {
    /// The flow of some of the particles, in this order.
    pub fn of(&self, some: &[u32], part: Arc<Part>) -> Self {
        let heat = self.heat.as_ref().map(|heat| Heat {
            wall_constant: picked(&heat.wall_constant, some),
            wall_factor: picked(&heat.wall_factor, some),
            materials: heat.materials.as_ref().map(|of| Materials {
                conductivity: picked(&of.conductivity, some),
                capacity: picked(&of.capacity, some),
            }),
            ..*heat
        });
        let tags = picked(&self.tags, some);
        Self { tags, heat, part: Some(part), scratch: Scratch::default(), ..self.clone() }
    }

    /// Replaces a field's `[rows, N]` values of copies by those of the ranks that own them.
    pub fn refresh(&self, field: &mut [R]) {
        if let Some(part) = &self.part {
            part.refresh(field);
        }
    }

    /// Runs a sweep over the fluid's rows that writes a field `[rows, N]`. Where ranks share the flow, it begins with those of particles that
    /// others have copies of; their values are sent, and those of copies come, while the rest is computed.
    pub fn sweep<K: RowKernel<R>>(&self, list: &NeighbourList, kernel: &K, field: &Own<'_, R>, rows: usize) {
        let (all, n) = (list.fluid_rows.len(), self.particles());
        let Some(part) = &self.part else { return run_rows(kernel, all) };
        run_some_rows(kernel, 0..list.lent_rows);
        let mut exchange = part.begin(rows, |row, i| field.get(row * n + i));
        let piece = (all - list.lent_rows).div_ceil(PIECES).max(1);
        for from in (list.lent_rows..all).step_by(piece) {
            run_some_rows(kernel, from..all.min(from + piece));
            exchange.go_on();
        }
        part.finish(exchange, rows, |row, i, value| field.set(row * n + i, value));
    }

    /// [`Self::refresh`] for numbers `from .. from + count` of records `[N, width]`.
    pub fn refresh_records(&self, records: &mut [R], width: usize, from: usize, count: usize) {
        if let Some(part) = &self.part {
            part.exchange(records, count, |k, i| i * width + from + k);
        }
    }

    /// [`Self::refresh`] of a field that is computed at walls only.
    pub fn refresh_walls(&self, field: &mut [R]) {
        if let Some(part) = self.part.as_ref().filter(|part| part.has_walls) {
            part.refresh(field);
        }
    }

    /// Number of parts that the step from a state `[F, N]` is divided into; 1 where steps are never divided.
    pub fn parts(&self, state: &[R]) -> usize {
        let Some(division) = &self.division else { return 1 };
        let speed = self.largest(state, self.rows.velocity());
        let acceleration = self.rows.row(Quantity::Acceleration).map_or(0.0, |row| self.largest(state, row));
        division.parts(self.dt, speed, acceleration)
    }

    /// The largest magnitude of a vector field over the fluid particles. The field begins at row `row` of the state.
    fn largest(&self, state: &[R], row: usize) -> f64 {
        let n = self.particles();
        let fluid = (0..n).filter(|&i| self.is_fluid(i));
        let square = |i: usize| (0..self.dimension()).map(|d| state[(row + d) * n + i].f64().powi(2)).sum::<f64>();
        fluid.map(square).fold(0.0, f64::max).sqrt()
    }
}

/// The numbers of some particles.
pub fn picked<T: Copy>(all: &[T], some: &[u32]) -> Vec<T> {
    some.iter().filter_map(|&i| all.get(i as usize).copied()).collect()
}

/// Buffers that return here when they are no longer used.
#[derive(Debug, Clone)]
pub struct Scratch<R> {
    pub buffers: Buffers<R>,
    /// States that a gradient keeps in full precision.
    pub states: Blocks,
    /// States that a gradient keeps in single precision.
    pub rounded_states: Blocks,
}

impl<R> Default for Scratch<R> {
    fn default() -> Self {
        Self { buffers: Buffers::default(), states: Blocks::default(), rounded_states: Blocks::default() }
    }
}
