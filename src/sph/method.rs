//! The interface of a method: how a state is advanced, differentiated and shown.
//!
//! Each method is a folder beside this file. [`super::solver`] runs a method, [`super::dynamics`] makes it available to
//! gradients and [`super::plan`] prints what it computes; none of them depends on which method it is.

use super::flow::Flow;
use super::inventory::{dropped, Dropped, Field, Operator};
use super::pace::TimeSteps;
use super::part::Part;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::config::stability::CflLimit;
use crate::numerics::candle::read;
use crate::numerics::lanes::Real;
use crate::particles::{NeighbourList, Neighbourhood};
use candle_core::{Device, Tensor};
use std::any::Any;
use std::fmt::Debug;
use std::ops::Deref;
use std::sync::Arc;

/// A scene together with the method that solves it. Clones share both.
#[derive(Debug)]
pub struct Model<R>(Arc<dyn Method<R>>);

impl<R: 'static> Model<R> {
    pub fn new(method: impl Method<R>) -> Self {
        Self(Arc::new(method))
    }

    /// The same method and particles with a changed flow. The change must keep the particles and the rows of the state.
    pub fn with(&self, change: impl FnOnce(&mut Flow<R>)) -> Self
    where
        R: Clone,
    {
        let mut flow = Flow::clone(self.flow());
        change(&mut flow);
        self.with_flow(flow)
    }

    /// A new [`Worker`], which makes steps without a graph.
    pub fn worker(&self) -> Box<dyn Worker<R>> {
        self.0.clone().worker()
    }

    /// A new [`Recorder`], which makes steps on candle's graph.
    pub fn recorder(&self, kernels: Kernels) -> Box<dyn Recorder<R>> {
        self.0.clone().recorder(kernels)
    }

    /// [`Self::of_type`], shared.
    pub fn shared<M: Method<R>>(&self) -> Option<Arc<M>> {
        let method: Arc<dyn Any + Send + Sync> = self.0.clone();
        method.downcast().ok()
    }

    /// The method as the concrete type `M`, or none if it is another method.
    pub fn of_type<M: Method<R>>(&self) -> Option<&M> {
        let method: &dyn Any = &*self.0;
        method.downcast_ref()
    }
}

impl<R: 'static, M: Method<R>> From<Arc<M>> for Model<R> {
    fn from(method: Arc<M>) -> Self {
        Self(method)
    }
}

impl<R> Clone for Model<R> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<R: 'static> Deref for Model<R> {
    type Target = dyn Method<R>;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

/// A method solves a flow: it has the equations, their adjoints and the memory that they need.
pub trait Method<R>: Any + Debug + Send + Sync {
    /// The method's name in a configuration.
    fn name(&self) -> &'static str;
    fn flow(&self) -> &Flow<R>;
    /// The same method for another flow of the same particles and rows, for example with another viscosity.
    fn with_flow(&self, flow: Flow<R>) -> Model<R>;

    /// A new [`Worker`], which makes steps without a graph.
    fn worker(self: Arc<Self>) -> Box<dyn Worker<R>>;
    /// A new [`Recorder`], which makes steps on candle's graph.
    fn recorder(self: Arc<Self>, kernels: Kernels) -> Box<dyn Recorder<R>>;
    /// Whether every operator of a step has a fused kernel. Otherwise steps are composed of candle's operators.
    fn is_fused(&self) -> bool {
        true
    }
    /// The solver of the steady state and its gradient, for methods whose particles do not move.
    fn steady(&self) -> Option<&dyn Steady<R>> {
        None
    }

    /// The same method for some of the particles, in this order, which one of several ranks computes; none for a method that only one
    /// can solve.
    fn of(&self, _some: &[u32], _part: Arc<Part>) -> Option<Model<R>> {
        None
    }
    /// How the particles can be shared out among ranks; none for a method that only one can solve.
    fn sharing(&self) -> Option<Sharing> {
        None
    }

    /// Whether a state holds the velocity and temperature of wall particles. Otherwise [`Worker::look`] computes them.
    fn has_wall_values(&self) -> bool {
        true
    }
    /// Whether the velocity rows of a state hold a velocity of particle i.
    fn has_velocity(&self, i: usize) -> bool {
        self.flow().is_fluid(i)
    }
    /// Whether particle i may be used to interpolate the velocity: fluid, and wall points whose velocity is known.
    fn knows_velocity(&self, i: usize) -> bool {
        self.flow().is_fluid(i)
    }
    /// The constant density that objectives use, or none if they use the density of each particle.
    fn counted_density(&self) -> Option<f64> {
        None
    }
    /// The largest magnitude of a wall temperature in a state, relative to the reference temperature.
    fn wall_temperature(&self, state: &[R]) -> f64;
    /// How many numbers a kept state has beyond the state itself, see [`Worker::remember`].
    fn remembered(&self) -> usize {
        0
    }
    /// Memory of a step and of its adjoint, in bytes, for a neighbour list.
    fn memory(&self, list: &NeighbourList) -> Memory;
    /// The kinematic viscosity that the artificial viscosity is equivalent to.
    fn artificial_viscosity(&self) -> f64 {
        0.0
    }
    /// The largest stable Courant number and diffusion number of a step.
    fn limits(&self) -> (CflLimit, f64);
    /// What to try when the particles become badly arranged, as text for the user.
    fn advice(&self) -> &'static str;

    /// The operators of a step, in order.
    fn operators(&self, list: &NeighbourList) -> Vec<Operator>;
    /// The packed tensors of a step.
    fn fields(&self) -> Vec<Field> {
        vec![Field::of::<R>("state", self.flow().rows.names(), self.flow().particles())]
    }
    /// What is left out of a step, and why.
    fn dropped(&self) -> Vec<Dropped> {
        vec![
            dropped("transport velocity and its acceleration", "the formulation has a shift"),
            dropped("density summation, mass, background pressure", "the pressure is a field of its own"),
        ]
    }
}

impl<R: 'static> Deref for dyn Method<R> {
    type Target = Flow<R>;

    fn deref(&self) -> &Flow<R> {
        self.flow()
    }
}

/// How the particles of a flow can be shared out among ranks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sharing {
    /// Copies that a rank needs: of everything nearer than so many times the reach of the neighbour list.
    pub reaches: usize,
    /// The one direction across which the box may be cut; none where it may be any.
    pub only: Option<usize>,
}

/// The context of a step: the neighbour list, the time steps and the device.
pub struct Place<'a, R> {
    pub neighbourhood: &'a mut Neighbourhood<R>,
    pub times: TimeSteps,
    /// Number of steps made before this one.
    pub step: usize,
    /// Number of parts that this step is divided into, see [`super::division`].
    pub parts: usize,
    /// Device of the composed operators.
    pub device: &'a Device,
}

impl<R: Real> Place<'_, R> {
    /// Makes the neighbour list valid for positions `[D, N]`.
    ///
    /// # Errors
    /// Particles that are lost or too fast.
    pub fn update(&mut self, flow: &Flow<R>, position: &[R]) -> Result<(), RunError> {
        let step = self.step;
        self.neighbourhood.update(&flow.reach(), position).map_err(|source| RunError::Neighbours { step, source })
    }

    /// [`Self::update`] for the positions of a state, which may be on any device.
    ///
    /// # Errors
    /// As there; tensor errors.
    pub fn update_list(&mut self, flow: &Flow<R>, state: &Tensor) -> Result<(), RunError> {
        let failed = RunError::tensor(self.step);
        let position = state.detach().narrow(0, 0, flow.dimension());
        let position = position.and_then(|position| position.to_device(&Device::Cpu)?.to_dtype(R::DTYPE));
        let mut updated = Ok(());
        read(&position.map_err(&failed)?, |position: &[R]| {
            updated = self.update(flow, position);
            Ok(())
        })
        .map_err(&failed)?;
        updated
    }
}

/// The fields of a state as plain numbers, including those of wall particles.
#[derive(Debug, Clone, Default)]
pub struct Looked<R> {
    /// Position, `[D, N]`.
    pub position: Vec<R>,
    /// Velocity, `[D, N]`.
    pub velocity: Vec<R>,
    /// Density, `[N]`.
    pub density: Vec<R>,
    /// Mass of a particle in sums over a cross-section, `[N]`; empty where all particles have the mass of the flow.
    pub mass: Vec<R>,
    /// Temperature relative to the reference, `[N]`; empty without heat.
    pub temperature: Vec<R>,
}

impl<R> Looked<R> {
    /// All fields, in their order.
    pub fn fields(&self) -> [&[R]; 5] {
        [&self.position, &self.velocity, &self.density, &self.mass, &self.temperature]
    }

    pub fn fields_mut(&mut self) -> [&mut Vec<R>; 5] {
        [&mut self.position, &mut self.velocity, &mut self.density, &mut self.mass, &mut self.temperature]
    }
}

/// The fields of a state as tensors, which are on candle's graph if the state is.
pub struct Shown {
    /// Position, `[D, N]`.
    pub position: Tensor,
    /// Velocity, `[D, N]`.
    pub velocity: Tensor,
    /// Density, `[1, N]`.
    pub density: Tensor,
    /// Mass of a particle in sums over a cross-section, `[1, N]`.
    pub mass: Tensor,
    /// Temperature relative to the reference, `[1, N]`.
    pub temperature: Option<Tensor>,
    /// Heat flux of the walls, see [`crate::adjoint::Fields::wall_heat`].
    pub wall_heat: Option<Tensor>,
    /// Heat through the section, see [`crate::adjoint::Fields::carried_heat`].
    pub carried_heat: Option<Tensor>,
}

/// Makes steps without a graph, in its own buffers.
pub trait Worker<R>: Debug + Send {
    /// Makes one part of a step in place. Copies of other ranks' particles have their owners' state afterwards.
    ///
    /// # Errors
    /// Particles that are lost or too fast, or for which there are other copies; tensor errors of composed operators.
    fn advance(&mut self, place: &mut Place<'_, R>, state: &mut Vec<R>) -> Result<(), RunError>;
    /// Computes the fields of a state without advancing it.
    ///
    /// # Errors
    /// Tensor errors of composed operators.
    fn look(&mut self, place: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError>;
    /// Heat that walls give to the conducting fluid with x < `until`, for the state of the last [`Self::look`]. Its
    /// unit is density * temperature * volume / time (times the heat capacity: power).
    fn wall_heat(&self, place: &Place<'_, R>, state: &[R], until: f64) -> Result<f64, RunError>;
    /// Heat that the method's own fluxes carry through [`Flow::section`], in the same unit; none for a method whose fluxes
    /// are products of the particles' fields.
    ///
    /// # Errors
    /// Tensor errors of composed operators.
    fn carried_heat(&self, _place: &Place<'_, R>, _state: &[R]) -> Result<Option<f64>, RunError> {
        Ok(None)
    }
    /// The acceleration along x that held the flow rate or the power in the last step; none where the force is given.
    fn drive(&self) -> Option<f64> {
        None
    }
    /// Copies those results of the last step that its adjoint would otherwise recompute, see [`Method::remembered`].
    fn remember(&self, _to: &mut [R]) {}
    /// Goes on with other particles as a new one of the same method, but in the memory that it has; false if it cannot.
    fn reseat(&mut self, _model: &Model<R>) -> bool {
        false
    }
}

/// Makes steps on candle's graph, in its own buffers.
pub trait Recorder<R>: Send {
    /// Makes one part of a step: state `[F, N]` -> state `[F, N]`. `after` is the resulting state, if it is already
    /// known to the bit: fused operators then leave out what the adjoint does not read.
    ///
    /// # Errors
    /// Particles that are lost or too fast; tensor errors.
    fn advance(&mut self, place: &mut Place<'_, R>, state: &Tensor, after: Option<&Tensor>)
        -> Result<Tensor, RunError>;
    /// Maps the cotangent of the state after a step to the cotangent of the state before it, without a graph. Returns
    /// none, and does nothing, if the method needs a graph for that.
    ///
    /// # Errors
    /// As for [`Self::advance`].
    fn pull_back(
        &mut self,
        _place: &mut Place<'_, R>,
        _state: &Tensor,
        _after: Option<&Tensor>,
        _cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        Ok(None)
    }
    /// Whether [`Self::pull_back`] works without a graph.
    fn pulls_back(&self) -> bool {
        false
    }
    /// The fields of a state, by the present neighbour list.
    fn look(&mut self, place: &mut Place<'_, R>, state: &Tensor) -> Result<Shown, RunError>;
    /// Takes the numbers that [`Worker::remember`] copied for the next step.
    fn recall(&mut self, _numbers: &[R]) {}
}

/// Solver of the steady state of a flow, and of the gradient of a quantity there.
pub trait Steady<R> {
    /// Advances a state until no field changes by more than `tolerance` per time. Returns the number of steps and the
    /// remaining change per time, relative to the flow's own scales.
    fn settle(&self, state: &mut Vec<R>, tolerance: f64) -> (usize, f64);
    /// The cotangent of the initial state, given that of the steady state, `bar`, both `[F, N]`; zero but for
    /// positions.
    fn gradient(&self, state: &[R], bar: &[R]) -> SteadyGradient<R>;
    /// The fields of a steady state, on the graph if the state is.
    fn shown(&self, state: &Tensor) -> candle_core::Result<Shown>;
}

/// The gradient of a quantity of a steady state.
pub struct SteadyGradient<R> {
    /// Cotangent of the initial state, `[F, N]`.
    pub state: Vec<R>,
    /// Number of adjoint steps.
    pub steps: usize,
    /// Residual of the adjoint equation, relative to its right-hand side.
    pub residual: f64,
}

/// Memory of a step and of its adjoint, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// What a step leaves on the tape.
    pub tape: usize,
    /// Tables that are derived from a neighbour list, without the list.
    pub tables: usize,
    /// Fields of a run without a graph, and buffers that its operators share.
    pub run: usize,
    /// Cotangents of a state and of its intermediate fields.
    pub cotangents: usize,
    /// What an objective puts on the tape for one step.
    pub look: usize,
}

impl Memory {
    /// The memory for `state` rows of the state and the intermediate rows of `parts`. `kept`: bytes that operators keep
    /// for each other; `records`: rows in which the cotangents of rates and primitives are packed.
    pub fn of<R>(particles: usize, state: usize, parts: Parts, kept: usize, records: usize) -> Self {
        let field = |rows: usize| rows * particles * std::mem::size_of::<R>();
        let Parts { moved, primitives, rates } = parts;
        Self {
            tape: field(moved + 1 + primitives + rates + state) + kept,
            tables: 0,
            run: field(state + moved + 1 + primitives + rates) + kept,
            cotangents: field(3 * state + 2 * moved + 1 + primitives + rates + records),
            look: field(moved + 1 + primitives + 8) + kept,
        }
    }
}

/// Numbers of rows of the fields that the operators of a step pass on to each other.
#[derive(Debug, Clone, Copy)]
pub struct Parts {
    pub moved: usize,
    pub primitives: usize,
    pub rates: usize,
}
