//! Implements the interface [`crate::sph::method::Method`] for fixed particles over a relief.

use super::lattice::{row, OverRelief};
use super::operator::{narrow, told, wide, Settled};
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::config::stability::{self, CflLimit};
use crate::numerics::candle::apply1;
use crate::numerics::lanes::Real;
use crate::particles::{tag, NeighbourList};
use crate::sph::flow::Flow;
use crate::sph::inventory::{dropped, Dropped, Operator};
use crate::sph::masks::per_particle;
use crate::sph::method::{
    Looked, Memory, Method, Model, Parts, Place, Recorder, Shown, Steady, SteadyGradient, Worker,
};
use crate::sph::rows::{Quantity, Rows};
use candle_core::Tensor;
use std::marker::PhantomData;
use std::sync::Arc;

/// Particles that stay on a lattice over a relief, while the flow passes through.
#[derive(Debug, Clone)]
pub struct ReliefParticles<R> {
    flow: Flow<R>,
    lattice: Arc<OverRelief>,
}

impl<R: Real> ReliefParticles<R> {
    /// A flow on a lattice, whose rows, particles and body force replace those of `flow`.
    pub fn new(flow: Flow<R>, lattice: OverRelief) -> Self {
        let channel = &lattice.channel;
        let tag_of = |i: usize| match i.checked_sub(channel.inside()) {
            None => tag::FLUID,
            Some(k) => {
                if k < channel.columns() && channel.hot_share(k) > 0.5 {
                    tag::HOT_SURFACE
                } else {
                    tag::SURFACE
                }
            }
        };
        let tags = (0..lattice.particles()).map(tag_of).collect();
        let rows = Rows::new(3, &[Quantity::Pressure, Quantity::Temperature]);
        let mut equation_of_state = flow.equation_of_state;
        equation_of_state.background_pressure = 0.0;
        Self { flow: Flow { rows, tags, equation_of_state, ..flow }, lattice: Arc::new(lattice) }
    }

    /// Masses in sums over a section, `[1, N]`, on the graph: density times volume over a flat wall times the opening of the column.
    fn masses(&self, state: &Tensor) -> candle_core::Result<Tensor> {
        let channel = &self.lattice.channel;
        let (inside, columns) = (channel.inside(), channel.columns());
        let y = state.narrow(0, row::Y, 1)?;
        let opening = (y.narrow(1, inside + columns, columns)? - y.narrow(1, inside, columns)?)?;
        let opening = Tensor::cat(&vec![opening; channel.cells[1] - 1], 1)?;
        let per_height = channel.density / channel.height();
        let weights: Vec<R> = self.lattice.flat_volumes().iter().map(|v| R::of(v * per_height)).collect();
        let weights = Tensor::from_vec(weights, (1, inside), state.device())?.to_dtype(state.dtype())?;
        let masses = opening.mul(&weights)?;
        Tensor::cat(&[masses, Tensor::zeros((1, 2 * columns), state.dtype(), state.device())?], 1)
    }

    fn settled(&self, state: &Tensor) -> candle_core::Result<Tensor> {
        apply1(Settled::<R> { lattice: self.lattice.clone(), of: PhantomData }, state)
    }
}

impl<R: Real> Method<R> for ReliefParticles<R> {
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
        Box::new(Run { model: self, drive: None })
    }
    fn recorder(self: Arc<Self>, _: Kernels) -> Box<dyn Recorder<R>> {
        Box::new(Tape { model: self })
    }
    fn steady(&self) -> Option<&dyn Steady<R>> {
        Some(self)
    }
    fn counted_density(&self) -> Option<f64> {
        Some(self.lattice.channel.density)
    }
    fn wall_temperature(&self, _: &[R]) -> f64 {
        self.lattice.channel.hot_excess.abs()
    }
    fn memory(&self, list: &NeighbourList) -> Memory {
        // Coefficients of the fits, the matrices of flow and heat and their incomplete factors, and directions of GMRES.
        let parts = Parts { moved: 6, primitives: 4, rates: 3 };
        let kept = self.flow.particles() * 40 * 40 * std::mem::size_of::<f64>() + list.index.len();
        Memory::of::<R>(self.flow.particles(), row::COUNT, parts, kept, 0)
    }
    fn limits(&self) -> (CflLimit, f64) {
        (stability::FIXED, 0.25)
    }
    fn advice(&self) -> &'static str {
        "a slower flow (a larger fluid.viscosity), a smaller resolution.dx, or a gentler wall (a smaller design.amplitude or \
         design.bound)"
    }
    fn operators(&self, _: &NeighbourList) -> Vec<Operator> {
        let n = self.flow.particles();
        let bytes = row::COUNT * n * std::mem::size_of::<R>();
        let does =
            "fits at the mapped lattice; Newton's method, whose systems GMRES solves; the temperature of that flow";
        vec![Operator::new("steady flow", vec![does.to_string()], [n, 40 * n], [bytes, bytes, 0])]
    }
    fn dropped(&self) -> Vec<Dropped> {
        vec![dropped("steps in time, sound", "the steady flow is found at once")]
    }
}

/// Goes to the steady state without a graph.
#[derive(Debug)]
struct Run<R> {
    model: Arc<ReliefParticles<R>>,
    drive: Option<f64>,
}

impl<R: Real> Worker<R> for Run<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &mut Vec<R>) -> Result<(), RunError> {
        let lattice = &self.model.lattice;
        let mut found = wide(state);
        let settled = lattice.settle(&mut found);
        let (_, force) = settled.map_err(|why| RunError::tensor(place.step)(candle_core::Error::Msg(told(&why))))?;
        self.drive = lattice.channel.held.as_ref().map(|_| force);
        *state = narrow(&found);
        Ok(())
    }
    fn look(&mut self, _: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError> {
        let channel = &self.model.lattice.channel;
        let (n, inside, columns) = (channel.particles(), channel.inside(), channel.columns());
        let rows = |row: usize, rows: usize| state[row * n..(row + rows) * n].to_vec();
        to.position = rows(row::X, 3);
        to.velocity = rows(row::U, 3);
        // The walls' rows hold normals.
        (0..3).for_each(|d| to.velocity[d * n + inside..(d + 1) * n].fill(R::default()));
        to.temperature = rows(row::T, 1);
        to.density = vec![R::of(channel.density); n];
        to.mass = vec![R::default(); n];
        let y = |i: usize| state[row::Y * n + i].f64();
        for (i, volume) in self.model.lattice.flat_volumes().into_iter().enumerate() {
            let column = inside + i % columns;
            let opening = (y(column + columns) - y(column)) / channel.height();
            to.mass[i] = R::of(channel.density * volume * opening);
        }
        Ok(())
    }
    fn wall_heat(&self, _: &Place<'_, R>, state: &[R], until: f64) -> Result<f64, RunError> {
        Ok(self.model.lattice.wall_heat(&wide(state), until))
    }
    fn drive(&self) -> Option<f64> {
        self.drive
    }
}

struct Tape<R> {
    model: Arc<ReliefParticles<R>>,
}

impl<R: Real> Recorder<R> for Tape<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &Tensor, _: Option<&Tensor>) -> Result<Tensor, RunError> {
        self.model.settled(state).map_err(RunError::tensor(place.step))
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &Tensor) -> Result<Shown, RunError> {
        self.model.shown(state).map_err(RunError::tensor(place.step))
    }
}

impl<R: Real> Steady<R> for ReliefParticles<R> {
    fn settle(&self, state: &mut Vec<R>, _: f64) -> (usize, f64) {
        let mut found = wide(state);
        match self.lattice.settle(&mut found) {
            Ok((steps, _)) => {
                *state = narrow(&found);
                (steps, 0.0)
            }
            Err(why) => {
                log::debug!("{}", told(&why));
                (0, f64::INFINITY)
            }
        }
    }
    fn gradient(&self, state: &[R], bar: &[R]) -> SteadyGradient<R> {
        match self.lattice.pull_back(&wide(state), &wide(bar)) {
            Ok(found) => SteadyGradient { state: narrow(&found), steps: 1, residual: 0.0 },
            Err(_) => SteadyGradient { state: bar.to_vec(), steps: 0, residual: f64::INFINITY },
        }
    }
    fn shown(&self, state: &Tensor) -> candle_core::Result<Shown> {
        let mass = self.masses(state)?;
        let density = vec![R::of(self.lattice.channel.density); self.flow.particles()];
        Ok(Shown {
            position: state.narrow(0, row::X, 3)?,
            velocity: state.narrow(0, row::U, 3)?,
            density: per_particle(density, &mass)?,
            mass,
            temperature: Some(state.narrow(0, row::T, 1)?),
            wall_heat: None,
            carried_heat: None,
        })
    }
}
