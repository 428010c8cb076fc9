//! Implements the interface [`crate::sph::method::Method`] for fixed particles.

use super::lattice::{row, Fixed};
use super::operator::FixedStep;
use super::steady::SteadyOptions;
use super::work::Work;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::config::stability::{self, CflLimit};
use crate::numerics::candle::apply1;
use crate::numerics::lanes::Real;
use crate::particles::{tag, NeighbourList};
use crate::sph::flow::Flow;
use crate::sph::inventory::Operator;
use crate::sph::masks::per_particle;
use crate::sph::method::{
    Looked, Memory, Method, Model, Parts, Place, Recorder, Shown, Steady, SteadyGradient, Worker,
};
use crate::sph::pairs::stride;
use crate::sph::rows::{Quantity, Rows};
use candle_core::{DType, Device, Tensor};
use std::sync::Arc;

/// Steps per block of the Anderson acceleration that finds the steady state.
const BLOCK: usize = 20;
/// Number of blocks that the acceleration uses.
const DEPTH: usize = 20;
/// The residual to which Newton's method goes in double precision, if no smaller one is asked for: it costs an iteration or two.
const CLOSE: f64 = 1e-9;
/// Number of steps after which the search stops.
const MOST_STEPS: usize = 100_000;

/// Particles that stay on a lattice between two walls, while the flow passes through.
#[derive(Debug, Clone)]
pub struct FixedParticles<R> {
    flow: Flow<R>,
    lattice: Arc<Fixed<R>>,
}

impl<R: Real> FixedParticles<R> {
    /// A flow on a lattice, whose rows, particles and body force replace those of `flow`.
    pub fn new(flow: Flow<R>, lattice: Fixed<R>) -> Self {
        let rows = Rows::new(2, &[Quantity::Pressure, Quantity::Temperature]);
        let mut tags = vec![tag::FLUID; lattice.fluid_particles()];
        let (columns, share) = (lattice.channel.columns, lattice.channel.hot_share());
        tags.extend((0..2 * columns).map(|k| match share[k % columns] {
            share if k < columns && share > 0.5 => tag::HOT_SURFACE,
            _ => tag::SURFACE,
        }));
        let mut equation_of_state = flow.equation_of_state;
        equation_of_state.background_pressure = 0.0;
        Self { flow: Flow { rows, tags, equation_of_state, ..flow }, lattice: Arc::new(lattice) }
    }

    fn tensor(&self, state: &[R]) -> candle_core::Result<Tensor> {
        Tensor::from_slice(state, (row::COUNT, self.flow.particles()), &Device::Cpu)
    }

    /// A figure of a state that is composed of tensor operators.
    fn number(
        &self,
        place: &Place<'_, R>,
        state: &[R],
        of: impl Fn(&Fixed<R>, &Tensor) -> candle_core::Result<Tensor>,
    ) -> Result<f64, RunError> {
        let figure = self.tensor(state).and_then(|state| of(&self.lattice, &state));
        figure.and_then(|figure| figure.to_dtype(DType::F64)?.to_scalar()).map_err(RunError::tensor(place.step))
    }
}

impl<R: Real> Method<R> for FixedParticles<R> {
    fn name(&self) -> &'static str {
        "fixed"
    }
    fn flow(&self) -> &Flow<R> {
        &self.flow
    }
    fn with_flow(&self, flow: Flow<R>) -> Model<R> {
        Model::new(Self { flow, lattice: self.lattice.clone() })
    }
    fn worker(self: Arc<Self>) -> Box<dyn Worker<R>> {
        let next = vec![R::default(); self.lattice.state_length()];
        Box::new(Run { work: self.lattice.work(), next, drive: None, model: self })
    }
    fn recorder(self: Arc<Self>, kernels: Kernels) -> Box<dyn Recorder<R>> {
        Box::new(Tape { model: self, kernels })
    }
    fn steady(&self) -> Option<&dyn Steady<R>> {
        Some(self)
    }
    fn counted_density(&self) -> Option<f64> {
        Some(self.flow.equation_of_state.reference_density)
    }
    fn wall_temperature(&self, _: &[R]) -> f64 {
        self.lattice.channel.hot_excess.abs()
    }
    fn memory(&self, list: &NeighbourList) -> Memory {
        // About as much as for moving particles, whose neighbour list is as long.
        let parts = Parts { moved: 6, primitives: 4, rates: 3 };
        let kept = ((4 + stride(8)) * self.flow.particles() + list.index.len()) * std::mem::size_of::<R>();
        let bars = stride(parts.rates) + stride(parts.primitives + 1);
        Memory::of::<R>(self.flow.particles(), row::COUNT, parts, kept, bars)
    }
    fn limits(&self) -> (CflLimit, f64) {
        (stability::FIXED, 0.25)
    }
    fn advice(&self) -> &'static str {
        "time.cfl=0.6 or time.diffusion_number=0.06 (a smaller time step), or a gentler wall (a smaller design.amplitude or \
         design.bound)"
    }
    fn operators(&self, _: &NeighbourList) -> Vec<Operator> {
        let fluid = self.lattice.fluid_particles();
        let bytes = row::COUNT * self.flow.particles() * std::mem::size_of::<R>();
        // The stencil is 5 x 5 without its corners and its centre.
        let operator =
            |name, does: &str| Operator::new(name, vec![does.to_string()], [fluid, 20 * fluid], [bytes, bytes, 0]);
        vec![
            operator("flux", "mass flux of every pair, with diffusion"),
            operator("kick", "velocity: pressure, viscosity, what the flux carries, body force"),
            operator("flux again", "of the new velocity"),
            operator("advance", "density and temperature by the same flux; inlet and outlet"),
        ]
    }
}

/// Makes steps without a graph, in reused buffers.
#[derive(Debug)]
struct Run<R> {
    model: Arc<FixedParticles<R>>,
    next: Vec<R>,
    work: Work<R>,
    drive: Option<f64>,
}

impl<R: Real> Worker<R> for Run<R> {
    fn advance(&mut self, _: &mut Place<'_, R>, state: &mut Vec<R>) -> Result<(), RunError> {
        let lattice = &self.model.lattice;
        let force = lattice.forward(state, &mut self.next, &mut self.work);
        self.drive = lattice.channel.drive.map(|_| force.f64());
        std::mem::swap(state, &mut self.next);
        Ok(())
    }
    fn look(&mut self, _: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError> {
        let (lattice, n) = (&self.model.lattice, self.model.flow.particles());
        let rows = |row: usize, rows: usize| state[row * n..(row + rows) * n].to_vec();
        to.position = rows(row::X, 2);
        to.velocity = rows(row::U, 2);
        to.temperature = rows(row::T, 1);
        to.density = state[row::P * n..][..n].iter().map(|&p| lattice.density(p)).collect();
        to.mass = vec![R::default(); n];
        let weights = lattice.section_weights();
        for (i, (volume, weight)) in lattice.volumes(state).into_iter().zip(weights).enumerate() {
            to.mass[i] = R::of(volume * weight) * to.density[i];
        }
        Ok(())
    }
    fn wall_heat(&self, place: &Place<'_, R>, state: &[R], until: f64) -> Result<f64, RunError> {
        self.model.number(place, state, |lattice, state| lattice.heating(state, until))
    }
    fn carried_heat(&self, place: &Place<'_, R>, state: &[R]) -> Result<Option<f64>, RunError> {
        let section = self.model.flow.section;
        section.map(|x| self.model.number(place, state, |lattice, state| lattice.carried(state, x))).transpose()
    }
    fn drive(&self) -> Option<f64> {
        self.drive
    }
}

struct Tape<R> {
    model: Arc<FixedParticles<R>>,
    kernels: Kernels,
}

impl<R: Real> Recorder<R> for Tape<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &Tensor, _: Option<&Tensor>) -> Result<Tensor, RunError> {
        let next = match self.kernels {
            Kernels::Fused => apply1(FixedStep(self.model.lattice.clone()), state),
            Kernels::Composed => self.model.lattice.composed(state),
        };
        next.map_err(RunError::tensor(place.step))
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &Tensor) -> Result<Shown, RunError> {
        self.model.shown(state).map_err(RunError::tensor(place.step))
    }
}

impl<R: Real> Steady<R> for FixedParticles<R> {
    fn settle(&self, state: &mut Vec<R>, tolerance: f64) -> (usize, f64) {
        let first = state.clone();
        let close = if R::DTYPE == DType::F64 { tolerance.min(CLOSE) } else { tolerance };
        self.lattice.settle_by_newton(state, close).unwrap_or_else(|| {
            *state = first;
            self.lattice.settle(state, BLOCK, DEPTH, tolerance, MOST_STEPS)
        })
    }
    fn gradient(&self, state: &[R], bar: &[R]) -> SteadyGradient<R> {
        let found = self.lattice.steady_gradient(state, bar, &SteadyOptions::default());
        // The remaining rows are the derivatives by positions, including those of the walls.
        let (n, inner) = (self.flow.particles(), self.lattice.fluid_particles());
        let mut by_state = bar.to_vec();
        by_state[2 * n..].fill(R::default());
        for (k, wall) in found.walls.iter().enumerate() {
            by_state[n + inner + k] = R::of(*wall);
        }
        SteadyGradient { state: by_state, steps: found.steps, residual: found.residual }
    }
    fn shown(&self, state: &Tensor) -> candle_core::Result<Shown> {
        let n = self.flow.particles();
        let wall_heat = self.flow.wall_heat_until.map(|until| self.lattice.heating(state, until)).transpose()?;
        let carried_heat = self.flow.section.map(|x| self.lattice.carried(state, x)).transpose()?;
        let mass = self.lattice.masses(state)?;
        let density = vec![R::of(self.flow.equation_of_state.reference_density); n];
        Ok(Shown {
            position: state.narrow(0, row::X, 2)?,
            velocity: state.narrow(0, row::U, 2)?,
            density: per_particle(density, &mass)?,
            mass,
            temperature: Some(state.narrow(0, row::T, 1)?),
            wall_heat,
            carried_heat,
        })
    }
}
