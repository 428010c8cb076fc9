//! Advances a state in time, either without a graph in reused buffers ([`Solver`]), or as candle tensors with a graph
//! for each step ([`TensorSolver`]). The equations are those of the method.

use super::division::Divided;
use super::flow::Flow;
use super::method::{Looked, Model, Place, Recorder, Shown, Worker};
use super::pace::Pace;
use super::rows::Quantity;
use super::sweeps::Sweeps;
use crate::adjoint::RunError;
use crate::config::device::Compute;
use crate::config::scene::Kernels;
use crate::numerics::candle::read;
use crate::numerics::lanes::Real;
use crate::particles::neighbourhood::Copied;
use crate::particles::{NeighbourList, Neighbourhood};
use candle_core::{Device, Tensor};
use std::sync::Arc;

/// A state from which a run can be continued, with everything that later steps depend on.
#[derive(Debug, Clone)]
pub struct Snapshot<R> {
    pub step: usize,
    /// Number of parts of the step before, see [`super::division`].
    pub parts: usize,
    /// The smallest number of parts of a step: 1, or more in a run that has recovered from a divergence.
    pub least_parts: usize,
    /// State, `[F, N]`.
    pub state: Vec<R>,
    /// Positions from which the neighbour list was built. Restoring rebuilds the list from them, with its rows in the
    /// same order. Snapshots of the same list share them.
    pub reference: Arc<Vec<R>>,
}

impl<R: Real> Snapshot<R> {
    /// The snapshot at the start of a run.
    pub fn first(flow: &Flow<R>, state: Vec<R>) -> Self {
        let reference = Arc::new(state[..flow.dimension() * flow.particles()].to_vec());
        Self { step: 0, parts: 1, least_parts: 1, state, reference }
    }
}

/// Advances a state without a graph.
#[derive(Debug)]
pub struct Solver<R> {
    pub model: Model<R>,
    /// State, `[F, N]`, see [`crate::sph::flow::Flow::rows`].
    pub state: Vec<R>,
    pub step: usize,
    /// The part of a step that is being made; between steps, the last part of the last step.
    pub pace: Pace,
    /// See [`Snapshot::least_parts`].
    pub least_parts: usize,
    /// Positions from which the list of the last step's first part was built, if further parts may have rebuilt it.
    began_with: Option<Arc<Vec<R>>>,
    /// Counts the steps of this run that were made in parts.
    pub divided: Divided,
    pub neighbourhood: Neighbourhood<R>,
    /// The fields of the last [`Self::look`].
    pub looked: Looked<R>,
    /// The acceleration that held the flow rate or the power in the last step, where other ranks have made it.
    pub drove: Option<f64>,
    /// Whether the list is not that of its reference.
    list_is_old: bool,
    /// Whether [`Self::looked`] has the fields of the present state already, because several ranks have found them.
    is_looked: bool,
    worker: Box<dyn Worker<R>>,
    /// Device of composed steps.
    device: Device,
}

impl<R: Sweeps> Solver<R> {
    /// # Errors
    /// A state for which there is no neighbour list.
    pub fn new(model: impl Into<Model<R>>, state: Vec<R>) -> Result<Self, RunError> {
        let model = model.into();
        let first = Snapshot::first(&model, state);
        Self::restore(model, &first)
    }

    /// # Errors
    /// As for [`Self::new`].
    pub fn restore(model: impl Into<Model<R>>, snapshot: &Snapshot<R>) -> Result<Self, RunError> {
        let mut new = Self::unlisted(model, snapshot);
        new.build_list()?;
        Ok(new)
    }

    /// [`Self::restore`], but for the neighbour list, which is built when somebody needs it.
    pub(super) fn unlisted(model: impl Into<Model<R>>, snapshot: &Snapshot<R>) -> Self {
        let model = model.into();
        let mut neighbourhood = Neighbourhood::empty();
        neighbourhood.reference = snapshot.reference.clone();
        Self {
            worker: model.worker(),
            model,
            state: snapshot.state.clone(),
            step: snapshot.step,
            pace: Pace::after(snapshot.parts),
            least_parts: snapshot.least_parts,
            began_with: None,
            divided: Divided::default(),
            neighbourhood,
            looked: Looked::default(),
            drove: None,
            list_is_old: true,
            is_looked: false,
            device: Device::Cpu,
        }
    }

    /// Goes on with other particles, in the memory of these. Their list is built in the next part of a step.
    pub(super) fn reseat(&mut self, model: Model<R>, state: Vec<R>, copied: Copied<R>) {
        self.drove = Some(self.driving_force());
        if !self.worker.reseat(&model) {
            self.worker = model.worker();
        }
        (self.model, self.state) = (model, state);
        (self.began_with, self.list_is_old, self.is_looked) = (None, false, false);
        self.neighbourhood.take_others(copied);
    }

    /// The same solver with its composed steps on a device.
    pub fn on(self, device: &Device) -> Self {
        Self { device: device.clone(), ..self }
    }

    pub fn snapshot(&self) -> Snapshot<R> {
        Snapshot {
            step: self.step,
            parts: self.pace.parts,
            least_parts: self.least_parts,
            state: self.state.clone(),
            reference: self.neighbourhood.reference.clone(),
        }
    }

    /// Makes one time step, in as many parts as the flow requires.
    ///
    /// # Errors
    /// Particles that are lost or too fast.
    pub fn advance(&mut self) -> Result<(), RunError> {
        self.advance_by(if self.model.is_fused() { Self::advance_part } else { Self::advance_part_composed })
    }

    /// Makes one time step with candle's operators. The graph that they record is dropped.
    ///
    /// # Errors
    /// As for [`Self::advance`]; tensor errors.
    pub fn advance_composed(&mut self) -> Result<(), RunError> {
        self.advance_by(Self::advance_part_composed)
    }

    fn advance_by(&mut self, make_part: fn(&mut Self) -> Result<(), RunError>) -> Result<(), RunError> {
        self.build_list()?;
        self.is_looked = false;
        let parts = self.model.parts(&self.state).max(self.least_parts);
        for part in 0..parts {
            self.go_to_part(part, parts, make_part)?;
        }
        self.step += 1;
        Ok(())
    }

    /// Makes part number `part` of a step of `parts` parts.
    pub(super) fn make_part(&mut self, part: usize, parts: usize) -> Result<(), RunError> {
        self.go_to_part(part, parts, Self::advance_part)
    }

    fn go_to_part(
        &mut self,
        part: usize,
        parts: usize,
        make_part: fn(&mut Self) -> Result<(), RunError>,
    ) -> Result<(), RunError> {
        let before = self.pace;
        self.pace = before.next(part, parts);
        if let Err(error) = make_part(self) {
            self.pace = before;
            return Err(error);
        }
        if part == 0 {
            self.began_with = (self.pace.parts > 1).then(|| self.neighbourhood.reference.clone());
            self.divided.count(self.pace.parts);
        }
        Ok(())
    }

    /// Takes other positions for the neighbour list. It is built when somebody needs it.
    pub(super) fn forget_list(&mut self, reference: Arc<Vec<R>>) {
        self.neighbourhood.reference = reference;
        self.list_is_old = true;
        self.is_looked = false;
    }

    /// Takes the fields of the present state, and the number of neighbours of each particle, from those who have found them.
    pub(super) fn take_looked(&mut self, looked: Looked<R>, count: Vec<u32>) {
        self.looked = looked;
        self.neighbourhood.list = Arc::new(NeighbourList { count, ..NeighbourList::default() });
        (self.list_is_old, self.is_looked) = (true, true);
    }

    /// Builds the neighbour list of [`Self::forget_list`].
    fn build_list(&mut self) -> Result<(), RunError> {
        if std::mem::take(&mut self.list_is_old) {
            let (step, reference) = (self.step, self.neighbourhood.reference.clone());
            let built = self.neighbourhood.rebuild_at(&self.model.reach(), &reference);
            built.map_err(|source| RunError::Neighbours { step, source })?;
        }
        Ok(())
    }

    /// Positions from which the list of the last step's first part was built.
    pub fn began_with(&self) -> &Arc<Vec<R>> {
        self.began_with.as_ref().unwrap_or(&self.neighbourhood.reference)
    }

    fn advance_part(&mut self) -> Result<(), RunError> {
        let Self { model, state, step, pace, neighbourhood, worker, device, .. } = self;
        let times = pace.times(model.dt, *step);
        worker.advance(&mut Place { neighbourhood, times, step: *step, parts: pace.parts, device }, state)
    }

    fn advance_part_composed(&mut self) -> Result<(), RunError> {
        let failed = RunError::tensor(self.step);
        let shape = (self.model.rows.count(), self.model.particles());
        let state = Tensor::from_slice(&self.state, shape, &Device::Cpu).map_err(&failed)?;
        let compute = Compute::new(Kernels::Composed, self.device.clone());
        let neighbourhood = self.neighbourhood.clone();
        let mut tape = TensorSolver::new(self.model.clone(), neighbourhood, self.step, self.pace.parts, compute);
        tape.pace = self.pace;
        let there = tape.there(&state)?;
        let next = tape.advance_part(&there, None)?;
        let next = tape.back(&next, &state)?;
        read(&next.contiguous().map_err(&failed)?, |s: &[R]| {
            self.state.copy_from_slice(s);
            Ok(())
        })
        .map_err(&failed)?;
        self.neighbourhood = tape.neighbourhood;
        Ok(())
    }

    /// Computes the fields of the present state in [`Self::looked`] without advancing it.
    ///
    /// # Errors
    /// Tensor errors, of a method that is composed of candle's operators.
    pub fn look(&mut self) -> Result<(), RunError> {
        if self.is_looked {
            return Ok(());
        }
        self.build_list()?;
        let Self { model, state, step, pace, neighbourhood, worker, device, looked, .. } = self;
        let times = pace.times(model.dt, *step);
        worker.look(&mut Place { neighbourhood, times, step: *step, parts: pace.parts, device }, state, looked)
    }

    /// Heat that walls give to the conducting fluid with x < `until`, for the state of the last [`Self::look`], in
    /// units of density * temperature * volume / time (times the heat capacity: power). With fits it is what conduction
    /// brings to that fluid, because the flux at the walls themselves is infinite at both ends of the hot section.
    pub fn wall_heat_flux(&mut self, until: f64) -> Result<f64, RunError> {
        // It needs more than the fields.
        if std::mem::take(&mut self.is_looked) {
            self.look()?;
        }
        let Self { model, state, step, pace, neighbourhood, worker, device, .. } = self;
        let times = pace.times(model.dt, *step);
        worker.wall_heat(&Place { neighbourhood, times, step: *step, parts: pace.parts, device }, state, until)
    }

    /// Heat that the method's own fluxes carry through the section, see [`Fields::carried_heat`](crate::adjoint::Fields).
    ///
    /// # Errors
    /// Tensor errors of composed operators.
    pub fn carried_heat(&mut self) -> Result<Option<f64>, RunError> {
        let Self { model, state, step, pace, neighbourhood, worker, device, .. } = self;
        let times = pace.times(model.dt, *step);
        worker.carried_heat(&Place { neighbourhood, times, step: *step, parts: pace.parts, device }, state)
    }

    /// Mass of a particle in sums over a cross-section, as of the last [`Self::look`].
    pub fn mass(&self, i: usize) -> f64 {
        self.looked.mass.get(i).map_or(self.model.mass, |mass| mass.f64())
    }

    /// The acceleration along x in the last step: the body force, or what held the flow rate or the power.
    pub fn driving_force(&self) -> f64 {
        let found = self.worker.drive().or(self.drove);
        found.unwrap_or_else(|| self.model.body_force.strength())
    }

    /// Copies those results of the last step that its adjoint would recompute, see
    /// [`super::method::Method::remembered`].
    pub fn remember(&self, to: &mut [R]) {
        self.worker.remember(to);
    }

    /// Row `row` of the state, `[N]`.
    pub fn row(&self, row: usize) -> &[R] {
        let n = self.model.particles();
        &self.state[row * n..(row + 1) * n]
    }

    /// Checks that all numbers of the state are finite and that no fluid particle is faster than sound, which no weakly
    /// compressible flow is, or has a temperature far beyond the walls'.
    ///
    /// # Errors
    /// The first number that violates this.
    pub fn check(&self) -> Result<(), RunError> {
        let (n, rows) = (self.model.particles(), self.model.rows);
        let name = |row: usize| rows.quantity(row).map_or("state", Quantity::name);
        for (place, value) in self.state.iter().enumerate() {
            if !value.f64().is_finite() {
                let (field, particle) = (name(place / n), place % n);
                return Err(RunError::NotFinite { step: self.step, field, particle, value: value.f64() });
            }
        }
        let speed = self.model.sound_speed();
        let velocity = (rows.velocity()..rows.velocity() + rows.dimension).map(|row| (row, speed));
        let limits = velocity.chain(rows.temperature().zip(self.largest_temperature()));
        for (row, limit) in limits {
            let mut fluid = (0..n).filter(|&i| self.model.is_fluid(i));
            if let Some(particle) = fluid.find(|&i| self.state[row * n + i].f64().abs() > limit) {
                let value = self.state[row * n + particle].f64();
                return Err(RunError::Impossible { step: self.step, field: name(row), particle, value, limit });
            }
        }
        Ok(())
    }

    /// Three times the largest magnitude of a wall temperature above the reference; none if it is 0. (Conduction and
    /// convection keep temperatures between the walls' and the initial ones; discrete sums do so only nearly.)
    fn largest_temperature(&self) -> Option<f64> {
        self.model.heat.as_ref()?;
        let most = self.model.wall_temperature(&self.state);
        (most > 0.0).then_some(3.0 * most)
    }
}

/// Advances a state as candle tensors.
pub struct TensorSolver<R> {
    pub model: Model<R>,
    pub neighbourhood: Neighbourhood<R>,
    pub step: usize,
    /// See [`Solver::pace`].
    pub pace: Pace,
    recorder: Box<dyn Recorder<R>>,
    /// Device of the steps. States come from the CPU and return to it, because the neighbour list is there.
    device: Device,
}

impl<R: Sweeps> TensorSolver<R> {
    /// A solver at a step, with the number of parts of the step before it and a neighbour list.
    pub fn new(
        model: impl Into<Model<R>>,
        neighbourhood: Neighbourhood<R>,
        step: usize,
        parts: usize,
        compute: impl Into<Compute>,
    ) -> Self {
        let (model, compute) = (model.into(), compute.into());
        let (recorder, device) = (model.recorder(compute.kernels()), compute.device().clone());
        Self { model, neighbourhood, step, pace: Pace::after(parts), recorder, device }
    }

    /// A solver at the step of a snapshot, with its neighbour list.
    ///
    /// # Errors
    /// A state for which there is no neighbour list.
    pub fn restore(
        model: impl Into<Model<R>>,
        snapshot: &Snapshot<R>,
        compute: impl Into<Compute>,
    ) -> Result<Self, RunError> {
        let model = model.into();
        let neighbourhood = Neighbourhood::build(&model.reach(), &snapshot.reference)
            .map_err(|source| RunError::Neighbours { step: snapshot.step, source })?;
        Ok(Self::new(model, neighbourhood, snapshot.step, snapshot.parts, compute))
    }

    /// One time step: state `[F, N]` -> state `[F, N]`, on the graph.
    ///
    /// # Errors
    /// Particles that are lost or too fast; tensor errors.
    pub fn advance(&mut self, state: &Tensor) -> Result<Tensor, RunError> {
        self.advance_to(state, None)
    }

    /// Makes one time step as [`Self::advance`]. `after` is the resulting state, if it is already known to the bit: the
    /// fused operators then leave out what the adjoint does not read.
    ///
    /// # Errors
    /// As for [`Self::advance`].
    pub fn advance_to(&mut self, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, RunError> {
        let parts = self.parts_from(state)?;
        let mut next = self.there(state)?;
        for part in 0..parts {
            self.pace = self.pace.next(part, parts);
            next = self.advance_part(&next, after.filter(|_| part + 1 == parts))?;
        }
        let next = self.back(&next, state)?;
        self.step += 1;
        Ok(next)
    }

    /// Maps the cotangent of the state after the next step to that of the state before it, see [`Dynamics::pull_back`].
    /// Returns none for steps that are made in parts and for methods that need a graph.
    ///
    /// [`Dynamics::pull_back`]: crate::adjoint::Dynamics::pull_back
    ///
    /// # Errors
    /// As for [`Self::advance`].
    pub fn pull_back(
        &mut self,
        state: &Tensor,
        after: Option<&Tensor>,
        cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        if !self.recorder.pulls_back() || self.parts_from(state)? > 1 {
            return Ok(None);
        }
        self.pace = self.pace.next(0, 1);
        let found = self.with(|recorder, place| recorder.pull_back(place, state, after, cotangent))?;
        self.step += usize::from(found.is_some());
        Ok(found)
    }

    /// Moves a tensor to the device of the steps.
    fn there(&self, tensor: &Tensor) -> Result<Tensor, RunError> {
        tensor.to_device(&self.device).map_err(RunError::tensor(self.step))
    }

    /// Moves a tensor to the device of `like`.
    fn back(&self, tensor: &Tensor, like: &Tensor) -> Result<Tensor, RunError> {
        tensor.to_device(like.device()).map_err(RunError::tensor(self.step))
    }

    /// Number of parts that the step from a state is divided into.
    fn parts_from(&self, state: &Tensor) -> Result<usize, RunError> {
        if self.model.division.is_none() {
            return Ok(1);
        }
        let failed = RunError::tensor(self.step);
        let state = state.detach().to_device(&Device::Cpu).and_then(|state| state.to_dtype(R::DTYPE)?.contiguous());
        let mut parts = 1;
        read(&state.map_err(&failed)?, |state: &[R]| {
            parts = self.model.parts(state);
            Ok(())
        })
        .map_err(&failed)?;
        Ok(parts)
    }

    fn advance_part(&mut self, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, RunError> {
        self.with(|recorder, place| recorder.advance(place, state, after))
    }

    fn with<T>(&mut self, go: impl FnOnce(&mut dyn Recorder<R>, &mut Place<'_, R>) -> T) -> T {
        let Self { model, neighbourhood, step, pace, recorder, device } = self;
        let times = pace.times(model.dt, *step);
        go(&mut **recorder, &mut Place { neighbourhood, times, step: *step, parts: pace.parts, device })
    }

    /// Takes the numbers that [`Solver::remember`] copied for the next step.
    pub fn recall(&mut self, numbers: &[R]) {
        self.recorder.recall(numbers);
    }

    /// The fields of a state, on the graph if the state is.
    pub fn look(&mut self, state: &Tensor) -> Result<Shown, RunError> {
        let there = self.there(state)?;
        let shown = self.with(|recorder, place| recorder.look(place, &there))?;
        let back = |tensor: &Tensor| self.back(tensor, state);
        Ok(Shown {
            position: back(&shown.position)?,
            velocity: back(&shown.velocity)?,
            density: back(&shown.density)?,
            mass: back(&shown.mass)?,
            temperature: shown.temperature.as_ref().map(back).transpose()?,
            wall_heat: shown.wall_heat.as_ref().map(back).transpose()?,
            carried_heat: shown.carried_heat.as_ref().map(back).transpose()?,
        })
    }
}
