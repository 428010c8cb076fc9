//! Advancing a state: without a graph (buffers reused), or as candle tensors (a graph per step).

use super::chain::{Chain, Step};
use super::consistent::operators::{self, Buffers, Shown};
use super::consistent::{composed, Blocks, Geometry, TimeSteps};
use super::division::{self, Divided};
use super::fixed::{Fixed, FixedStep, Work};
use super::laws::conduction;
use super::model::{Layout, Model};
use super::operators::composed::Pairs;
use super::operators::pairs::PairCache;
use super::operators::{assemble, density, drift, evolution, rates, wall_condition, whole_step};
use super::step::{self, Execution};
use super::sweeps::Sweeps;
use crate::adjoint::RunError;
use crate::config::device::Compute;
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply1, apply2, apply3, read};
use crate::numerics::lanes::Real;
use crate::numerics::pool::Buffer;
use crate::particles::Neighbourhood;
use candle_core::{DType, Device, Tensor};
use std::sync::Arc;

/// A state to come back to: everything that the steps behind it depend on.
#[derive(Debug, Clone)]
pub struct Snapshot<R> {
    pub step: usize,
    /// In how many parts the step before was made, see [`super::division`].
    pub parts: usize,
    /// The fewest parts that steps are made in from here on: 1, but in a run that has recovered from a divergence.
    pub least_parts: usize,
    /// `[F, N]`.
    pub state: Vec<R>,
    /// Positions that the neighbour list was built from: the list is rebuilt from them on restoring, the same to
    /// the order of its rows. Shared between snapshots of the same list.
    pub reference: Arc<Vec<R>>,
}

impl<R: Real> Snapshot<R> {
    /// A run's first state.
    pub fn first(model: &Model<R>, state: Vec<R>) -> Self {
        let reference = Arc::new(state[..model.layout.dimension * model.particles()].to_vec());
        Self { step: 0, parts: 1, least_parts: 1, state, reference }
    }
}

/// The part of a step that is being made, and the one before it. Between steps: the last step's last part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Parts of this step.
    pub parts: usize,
    /// Of the step that the part before this one belongs to.
    before: usize,
    /// Whether this part is a step's first.
    first: bool,
}

impl Pace {
    /// Behind a step of some parts.
    pub fn after(parts: usize) -> Self {
        Self { parts, before: parts, first: true }
    }

    /// At part number `part` of a step of `parts`.
    fn next(self, part: usize, parts: usize) -> Self {
        Self { parts, before: self.parts, first: part == 0 }
    }

    /// The time of this part of step number `step`, and of the part before it.
    fn times(self, dt: f64, step: usize) -> TimeSteps {
        let has_before = step > 0 || !self.first;
        TimeSteps { now: dt / self.parts as f64, before: if has_before { dt / self.before as f64 } else { 0.0 } }
    }
}

/// Advances a state without a graph.
#[derive(Debug)]
pub struct Solver<R> {
    pub model: Arc<Model<R>>,
    /// `[F, N]`, see [`crate::sph::model::Layout`].
    pub state: Vec<R>,
    pub step: usize,
    /// The part of a step that is being made; between steps, in how many the last one was made.
    pub pace: Pace,
    /// See [`Snapshot::least_parts`].
    pub least_parts: usize,
    /// What the list of the last step's first part was built from, where it had others: their list may be another one.
    began_with: Option<Arc<Vec<R>>>,
    /// Of the steps since the run's start.
    pub divided: Divided,
    pub neighbourhood: Neighbourhood<R>,
    moved: Vec<R>,
    density: Vec<R>,
    kept: PairCache<R>,
    /// Of the last [`Self::look`], walls included, `[C, N]`.
    pub primitives: Vec<R>,
    rates: Vec<R>,
    /// Whether somebody reads the primitives: the step itself needs the records only.
    shows_primitives: bool,
    /// Of the consistent formulation, and none of the others then.
    consistent: Option<Consistent<R>>,
    /// Of fixed particles, likewise.
    lattice: Option<Lattice<R>>,
    /// The acceleration of the last step by what holds the flow rate or the power; none where that is given.
    drive: Option<f64>,
    /// Where composed steps are made.
    device: Device,
}

/// Fixed particles' run.
#[derive(Debug)]
struct Lattice<R> {
    fixed: Arc<Fixed<R>>,
    next: Vec<R>,
    work: Work<R>,
    masses: Vec<R>,
}

/// The consistent formulation's run.
#[derive(Debug)]
struct Consistent<R> {
    tables: Tables,
    buffers: Buffers<R>,
    /// rho V of the fluid, as sections count it, `[N]`.
    masses: Vec<R>,
}

/// The tables of the present list.
#[derive(Debug, Default)]
struct Tables {
    blocks: Arc<Blocks>,
    /// The list that they were made of.
    identity: u64,
}

impl Tables {
    /// Makes sure that they are those of a list.
    fn update<R: Sweeps>(&mut self, model: &Model<R>, neighbourhood: &Neighbourhood<R>) {
        let Some(consistent) = &model.consistent else { return };
        if self.identity == neighbourhood.identity {
            return;
        }
        self.identity = neighbourhood.identity;
        if Arc::get_mut(&mut self.blocks).is_none() {
            self.blocks = Arc::default();
        }
        if let Some(blocks) = Arc::get_mut(&mut self.blocks) {
            R::tables(blocks, &neighbourhood.list, &consistent.surface);
        }
    }
}

impl<R: Sweeps> Solver<R> {
    /// # Errors
    /// A state for which there is no neighbour list.
    pub fn new(model: Arc<Model<R>>, state: Vec<R>) -> Result<Self, RunError> {
        let first = Snapshot::first(&model, state);
        Self::restore(model, &first)
    }

    /// # Errors
    /// As for [`Self::new`].
    pub fn restore(model: Arc<Model<R>>, snapshot: &Snapshot<R>) -> Result<Self, RunError> {
        let neighbourhood = Neighbourhood::build(&model.reach(), &snapshot.reference)
            .map_err(|source| RunError::Neighbours { step: snapshot.step, source })?;
        let (n, l) = (model.particles(), model.layout);
        let standard = model.consistent.is_none() && model.fixed.is_none();
        let consistent = model.consistent.is_some();
        let lattice = model.fixed.clone().map(|fixed| Lattice {
            next: vec![R::default(); snapshot.state.len()],
            work: fixed.work(),
            masses: vec![R::default(); n],
            fixed,
        });
        let rows = |rows: usize| vec![R::default(); if standard { rows * n } else { 0 }];
        Ok(Self {
            moved: rows(l.moved_rows()),
            density: rows(1),
            kept: PairCache::default(),
            primitives: rows(if l.density { l.primitive_rows() } else { 0 }),
            rates: rows(l.rate_rows()),
            model,
            state: snapshot.state.clone(),
            step: snapshot.step,
            pace: Pace::after(snapshot.parts),
            least_parts: snapshot.least_parts,
            began_with: None,
            divided: Divided::default(),
            neighbourhood,
            shows_primitives: false,
            lattice,
            drive: None,
            device: Device::Cpu,
            consistent: consistent.then(|| Consistent {
                tables: Tables::default(),
                buffers: Buffers::default(),
                masses: vec![R::default(); n],
            }),
        })
    }

    /// The same, with its composed steps made on a device.
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

    /// One time step, in as many parts as the flow asks for.
    ///
    /// # Errors
    /// Particles that are lost or too fast.
    pub fn advance(&mut self) -> Result<(), RunError> {
        self.advance_by(Self::advance_part)
    }

    fn advance_by(&mut self, make_part: fn(&mut Self) -> Result<(), RunError>) -> Result<(), RunError> {
        let parts = division::parts(&self.model, &self.state).max(self.least_parts);
        for part in 0..parts {
            self.pace = self.pace.next(part, parts);
            make_part(self)?;
            self.finish_part(part);
        }
        self.step += 1;
        Ok(())
    }

    /// What outlives a part of a step.
    fn finish_part(&mut self, part: usize) {
        if part == 0 {
            self.began_with = (self.pace.parts > 1).then(|| self.neighbourhood.reference.clone());
            self.divided.count(self.pace.parts);
        }
    }

    /// Densities of the fluid after the drift of the last step's last part, `[N]`, where they are summed.
    pub fn density(&self) -> &[R] {
        &self.density
    }

    /// Positions that the list of the last step's first part was built from.
    pub fn began_with(&self) -> &Arc<Vec<R>> {
        self.began_with.as_ref().unwrap_or(&self.neighbourhood.reference)
    }

    fn advance_part(&mut self) -> Result<(), RunError> {
        if let Some(lattice) = &mut self.lattice {
            let force = lattice.fixed.forward(&self.state, &mut lattice.next, &mut lattice.work);
            self.drive = lattice.fixed.channel.drive.map(|_| force.f64());
            std::mem::swap(&mut self.state, &mut lattice.next);
        } else if self.consistent.is_some() {
            let updated = self.neighbourhood.update(&self.model.reach(), &self.state);
            updated.map_err(|source| RunError::Neighbours { step: self.step, source })?;
            let mut force = None;
            self.with_geometry(|run, geometry, state| force = run.buffers.advance(geometry, state));
            self.drive = force;
        } else if !self.model.is_fused() {
            return self.advance_part_composed();
        } else {
            let dt = self.pace.times(self.model.dt, self.step).now;
            step::advance(self, dt, &())?;
        }
        Ok(())
    }

    /// One time step by candle's operators: they exist on the graph only, which is dropped.
    ///
    /// # Errors
    /// As for [`Self::advance`]; tensor errors.
    pub fn advance_composed(&mut self) -> Result<(), RunError> {
        self.advance_by(Self::advance_part_composed)
    }

    fn advance_part_composed(&mut self) -> Result<(), RunError> {
        let failed = RunError::tensor(self.step);
        let (mut tape, state) = self.composed()?;
        tape.pace = self.pace;
        let state = tape.advance_part_there(&state)?;
        read(&state.contiguous().map_err(&failed)?, |s: &[R]| {
            self.state.copy_from_slice(s);
            Ok(())
        })
        .map_err(&failed)?;
        self.neighbourhood = tape.neighbourhood;
        Ok(())
    }

    /// This state for candle's operators.
    fn composed(&self) -> Result<(TensorSolver<R>, Tensor), RunError> {
        let shape = (self.model.layout.state_rows(), self.model.particles());
        let state = Tensor::from_slice(&self.state, shape, &Device::Cpu).map_err(RunError::tensor(self.step))?;
        let neighbourhood = self.neighbourhood.clone();
        let compute = Compute::new(Kernels::Composed, self.device.clone());
        Ok((TensorSolver::new(self.model.clone(), neighbourhood, self.step, self.pace.parts, compute), state))
    }

    /// [`Self::look`] by candle's operators.
    fn look_composed(&mut self) -> Result<(), RunError> {
        let failed = RunError::tensor(self.step);
        let (tape, state) = self.composed()?;
        let (moved, primitives) = tape.look(&state)?;
        for (to, from) in [(&mut self.moved, moved), (&mut self.primitives, primitives)] {
            read(&from.contiguous().map_err(&failed)?, |from: &[R]| {
                to.copy_from_slice(from);
                Ok(())
            })
            .map_err(&failed)?;
        }
        Ok(())
    }

    /// Runs something of the consistent formulation at the present list.
    fn with_geometry(&mut self, go: impl FnOnce(&mut Consistent<R>, &Geometry<'_, R>, &mut [R])) {
        let Self { model, neighbourhood, state, consistent, step, pace, .. } = self;
        if let (Some(run), Some(consistent)) = (consistent, &model.consistent) {
            run.tables.update(model, neighbourhood);
            let blocks = run.tables.blocks.clone();
            let times = pace.times(model.dt, *step);
            go(run, &Geometry { model, consistent, blocks: &blocks, times }, state);
        }
    }

    /// The operators' context at the present list.
    pub fn step_now(&self) -> Step<R> {
        Step { model: self.model.clone(), list: self.neighbourhood.list.clone() }
    }

    /// Fills [`Self::primitives`] for the present state without advancing it.
    pub fn look(&mut self) {
        if self.consistent.is_some() {
            return self.look_consistent();
        }
        if self.lattice.is_some() {
            return self.look_fixed();
        }
        self.primitives.resize(self.model.layout.primitive_rows() * self.model.particles(), R::default());
        if !self.model.is_fused() {
            // Tensors of these shapes were there in the step before: this fails no more than that.
            let _ = self.look_composed();
            return;
        }
        self.shows_primitives = true;
        // On buffers nothing fails but the list, which stays as it is.
        let _ = step::look(self, &());
        self.shows_primitives = false;
    }

    /// [`Self::look`] in the consistent formulation: the same rows of primitives.
    fn look_consistent(&mut self) {
        let (n, l) = (self.model.particles(), self.model.layout);
        let mut primitives = std::mem::take(&mut self.primitives);
        primitives.resize(l.primitive_rows() * n, R::default());
        self.with_geometry(|run, geometry, state| {
            run.buffers.look(geometry, state);
            let known = &run.buffers.known;
            operators::masses(geometry, &run.buffers.derivatives, &mut run.masses);
            let (density, sound_speed) =
                (geometry.model.equation_of_state.reference_density, geometry.consistent.sound_speed);
            let density = |p: R| R::of(density) + p * R::of(1.0 / sound_speed.powi(2));
            show(l, known, density, &mut primitives);
            // Their rows of velocity hold something else.
            for i in (0..n).filter(|&i| geometry.consistent.holds_no_velocity(i)) {
                for d in 0..l.dimension {
                    primitives[(l.primitive_velocity() + d) * n + i] = R::default();
                }
            }
        });
        self.primitives = primitives;
    }

    /// [`Self::look`] for fixed particles: the same rows of primitives.
    fn look_fixed(&mut self) {
        let (n, l) = (self.model.particles(), self.model.layout);
        self.primitives.resize(l.primitive_rows() * n, R::default());
        let Some(lattice) = &mut self.lattice else { return };
        let (state, primitives) = (&self.state, &mut self.primitives);
        show(l, state, |p| lattice.fixed.density(p), primitives);
        let weights = lattice.fixed.section_weights();
        for (i, (volume, weight)) in lattice.fixed.volumes(state).into_iter().zip(weights).enumerate() {
            lattice.masses[i] = R::of(volume * weight) * primitives[i];
        }
    }

    /// Masses of the fluid's particles as of the last [`Self::look`], as sections count them; `None` where masses are the
    /// state's or the scene's.
    pub fn masses(&self) -> Option<&[R]> {
        let lattice = self.lattice.as_ref().map(|run| run.masses.as_slice());
        self.consistent.as_ref().map(|run| run.masses.as_slice()).or(lattice)
    }

    /// Heat that walls give to conducting fluid with x < `until`, as of the last [`Self::look`]; in units of density *
    /// temperature * volume per time (times the heat capacity: power). In the consistent formulation: what conduction brings
    /// to that fluid (at the walls themselves the flux is infinite where the hot section begins and ends).
    pub fn wall_heat_flux(&self, until: f64) -> f64 {
        if let Some(lattice) = &self.lattice {
            let shape = (self.model.layout.state_rows(), self.model.particles());
            let state = Tensor::from_slice(&self.state, shape, &Device::Cpu);
            let heating = state.and_then(|state| lattice.fixed.heating(&state, until)?.to_dtype(DType::F64));
            return heating.and_then(|heat| heat.to_scalar::<f64>()).unwrap_or(f64::NAN);
        }
        match (&self.consistent, &self.model.consistent) {
            (Some(run), Some(consistent)) => {
                let times = self.pace.times(self.model.dt, self.step);
                let geometry = Geometry { model: &self.model, consistent, blocks: &run.tables.blocks, times };
                operators::heating(&geometry, &run.buffers.known, &run.buffers.derivatives, &run.masses, until)
            }
            _ => conduction::wall_flux(&self.step_now(), &self.moved, &self.primitives, until),
        }
    }

    /// Mass of a particle as of the last [`Self::look`].
    pub fn mass(&self, i: usize) -> f64 {
        let (n, l) = (self.model.particles(), self.model.layout);
        match self.masses() {
            Some(masses) => masses[i].f64(),
            None if l.mass => self.state[l.state_mass() * n + i].f64(),
            None => self.model.mass,
        }
    }

    /// The acceleration along x that drove the last step: the scene's body force, or what held the flow rate or the power.
    pub fn driving_force(&self) -> f64 {
        match (self.drive, &self.model.fixed) {
            (Some(force), _) => force,
            (None, Some(fixed)) => fixed.channel.body_force,
            (None, None) => self.model.body_force.strength(),
        }
    }

    /// The moved state of the last [`Self::advance`] or [`Self::look`], `[M, N]`.
    pub fn moved(&self) -> &[R] {
        &self.moved
    }

    /// Row `row` of the state.
    pub fn row(&self, row: usize) -> &[R] {
        let n = self.model.particles();
        &self.state[row * n..(row + 1) * n]
    }

    /// An error if a number of the state is not finite, or larger than it can be: a velocity above the speed of sound, which
    /// no weakly compressible flow has, or a temperature far beyond the walls'.
    ///
    /// # Errors
    /// That one.
    pub fn check(&self) -> Result<(), RunError> {
        let (n, l) = (self.model.particles(), self.model.layout);
        for (place, value) in self.state.iter().enumerate() {
            if !value.f64().is_finite() {
                let row = place / n;
                let field = match row {
                    _ if row < l.velocity() => "position",
                    _ if row < 2 * l.dimension => "velocity",
                    _ if l.consistent && row == l.pressure() => "pressure",
                    _ if l.consistent && row >= l.last_rates() => match row - l.last_rates() == l.dimension {
                        true => "rate of temperature",
                        false => "acceleration",
                    },
                    _ if l.density && row == l.state_density() => "density",
                    _ if row < l.temperature() => "acceleration",
                    _ => "temperature",
                };
                return Err(RunError::NotFinite { step: self.step, field, particle: place % n, value: value.f64() });
            }
        }
        let speed = super::plan::sound_speed(&self.model.equation_of_state);
        let velocity = (l.velocity()..l.velocity() + l.dimension).map(|row| (row, "velocity", speed));
        let limits = velocity.chain(self.largest_temperature().map(|most| (l.temperature(), "temperature", most)));
        for (row, field, limit) in limits {
            let fluid = (0..n).filter(|&i| self.model.is_fluid(i));
            if let Some(particle) = fluid.into_iter().find(|&i| self.state[row * n + i].f64().abs() > limit) {
                let value = self.state[row * n + particle].f64();
                return Err(RunError::Impossible { step: self.step, field, particle, value, limit });
            }
        }
        Ok(())
    }

    /// Three times the largest temperature of a wall, above the reference; none without a warm or a cold one. (Conduction and
    /// convection keep temperatures between the walls' and the first ones; discrete sums only nearly do.)
    fn largest_temperature(&self) -> Option<f64> {
        let (model, n, l) = (&self.model, self.model.particles(), self.model.layout);
        let heat = model.heat.as_ref()?;
        let given = heat.wall_constant.iter().map(|t| t.f64().abs());
        let most = match (&model.fixed, &model.consistent) {
            (Some(fixed), _) => fixed.channel.hot_excess.abs(),
            (None, Some(consistent)) => {
                let known = (0..n).filter(|&i| !model.is_fluid(i) && !consistent.holds_no_temperature(i));
                known.map(|i| self.state[l.temperature() * n + i].f64().abs()).fold(0.0, f64::max)
            }
            (None, None) => given.fold(0.0, f64::max),
        };
        (most > 0.0).then_some(3.0 * most)
    }
}

/// Rows of primitives `[C, N]` from a state with a pressure, `[F, N]`.
fn show<R: Real>(l: Layout, known: &[R], density: impl Fn(R) -> R, primitives: &mut [R]) {
    let n = known.len() / l.state_rows();
    let mut copy = |from: usize, to: usize, rows: usize| {
        primitives[to * n..(to + rows) * n].copy_from_slice(&known[from * n..(from + rows) * n]);
    };
    copy(l.velocity(), l.primitive_velocity(), l.dimension);
    if l.heat {
        copy(l.temperature(), l.primitive_temperature(), 1);
    }
    for (primitive, &p) in primitives[..n].iter_mut().zip(&known[l.pressure() * n..]) {
        *primitive = density(p);
    }
}

/// On the solver's own buffers: each field has its place, so none is handed around.
impl<R: Sweeps> Execution for Solver<R> {
    type Field = ();

    fn drift(&mut self, dt: f64, _: &()) -> Result<(), RunError> {
        R::drift(&self.model, dt, &self.state, &mut self.moved);
        Ok(())
    }
    fn neighbours(&mut self, _: &()) -> Result<(), RunError> {
        let step = self.step;
        let updated = self.neighbourhood.update(&self.model.reach(), &self.moved);
        updated.map_err(|source| RunError::Neighbours { step, source })
    }
    fn density(&mut self, dt: f64, _: &()) -> Result<(), RunError> {
        let step = self.step_now();
        match self.model.layout.density {
            true => R::evolution(&step, dt, &self.moved, &mut self.kept, &mut self.density),
            false => R::density(&step, &self.moved, &mut self.kept, &mut self.density),
        }
        Ok(())
    }
    fn wall_condition(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        let step = self.step_now();
        let shows = self.shows_primitives || self.model.layout.density;
        let primitives = shows.then_some(self.primitives.as_mut_slice());
        R::primitives(&step, &self.moved, &self.density, &mut self.kept, primitives);
        Ok(())
    }
    fn rates(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        R::rates(&self.step_now(), &self.moved, &self.kept, &mut self.rates);
        Ok(())
    }
    fn assemble(&mut self, _: &(), _: &(), _: &()) -> Result<(), RunError> {
        R::assemble(&self.step_now(), &self.moved, &self.primitives, &self.rates, &mut self.state);
        Ok(())
    }
}

/// Advances a state as candle tensors.
pub struct TensorSolver<R: Real> {
    pub model: Arc<Model<R>>,
    pub neighbourhood: Neighbourhood<R>,
    pub step: usize,
    /// As [`Solver::pace`].
    pub pace: Pace,
    pub kernels: Kernels,
    /// [`Solver::density`] of the next step, if somebody knows it.
    pub density: Option<Buffer<R>>,
    /// Where steps are made. States come from the CPU and go back there: the neighbour list and who reads a state are on it.
    device: Device,
    tables: Tables,
}

impl<R: Sweeps> TensorSolver<R> {
    /// At a step, the one before it made in some parts, with a list.
    pub fn new(
        model: Arc<Model<R>>,
        neighbourhood: Neighbourhood<R>,
        step: usize,
        parts: usize,
        compute: impl Into<Compute>,
    ) -> Self {
        let compute = compute.into();
        let kernels = if model.is_fused() { compute.kernels() } else { Kernels::Composed };
        let (device, tables) = (compute.device().clone(), Tables::default());
        Self { model, neighbourhood, step, pace: Pace::after(parts), kernels, density: None, device, tables }
    }

    /// Starts at a snapshot's step and neighbour list.
    ///
    /// # Errors
    /// A state for which there is no neighbour list.
    pub fn restore(
        model: Arc<Model<R>>,
        snapshot: &Snapshot<R>,
        compute: impl Into<Compute>,
    ) -> Result<Self, RunError> {
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

    /// The same; `after` is the state that it leads to, if that is known to the bit: the fused operators then leave out
    /// what the adjoint does not read.
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

    /// The cotangent of a state from that of the one that the next step leads to, see [`Dynamics::pull_back`]: of fused steps of the
    /// standard formulation that are made at once.
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
        if !self.is_whole() || self.parts_from(state)? > 1 {
            return Ok(None);
        }
        self.pace = self.pace.next(0, 1);
        let found = whole_step::pull_back(self, self.times().now, state, after, cotangent)?;
        self.step += 1;
        Ok(Some(found))
    }

    /// Whether a step is one operator, [`whole_step`].
    fn is_whole(&self) -> bool {
        self.model.fixed.is_none() && self.model.consistent.is_none() && self.kernels == Kernels::Fused
    }

    /// A tensor where steps are made.
    fn there(&self, tensor: &Tensor) -> Result<Tensor, RunError> {
        tensor.to_device(&self.device).map_err(RunError::tensor(self.step))
    }

    /// A tensor where another one is.
    fn back(&self, tensor: &Tensor, like: &Tensor) -> Result<Tensor, RunError> {
        tensor.to_device(like.device()).map_err(RunError::tensor(self.step))
    }

    /// A part of a step, there and back.
    fn advance_part_there(&mut self, state: &Tensor) -> Result<Tensor, RunError> {
        let next = self.advance_part(&self.there(state)?, None)?;
        self.back(&next, state)
    }

    /// In how many parts the step from a state is made.
    fn parts_from(&self, state: &Tensor) -> Result<usize, RunError> {
        if self.model.division.is_none() {
            return Ok(1);
        }
        let failed = RunError::tensor(self.step);
        let state = state.detach().to_device(&Device::Cpu).and_then(|state| state.to_dtype(R::DTYPE)?.contiguous());
        let mut parts = 1;
        read(&state.map_err(&failed)?, |state: &[R]| {
            parts = division::parts(&self.model, state);
            Ok(())
        })
        .map_err(&failed)?;
        Ok(parts)
    }

    fn advance_part(&mut self, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, RunError> {
        if self.is_whole() {
            return whole_step::advance(self, self.times().now, state, after);
        }
        if let Some(fixed) = &self.model.fixed {
            let next = match self.kernels {
                Kernels::Fused => apply1(FixedStep(fixed.clone()), state),
                Kernels::Composed => fixed.composed(state),
            };
            return next.map_err(RunError::tensor(self.step));
        }
        if self.model.consistent.is_some() {
            self.update_list(state)?;
            self.tables.update(&self.model, &self.neighbourhood);
            let next = match self.kernels {
                Kernels::Fused => operators::advance(&self.chain(), state),
                Kernels::Composed => composed::advance(&self.model, &self.neighbourhood.list, self.times(), state),
            };
            return next.map_err(RunError::tensor(self.step));
        }
        let dt = self.times().now;
        step::advance(&mut Composed { run: self, pairs: None }, dt, state)
    }

    fn chain(&self) -> Arc<operators::Chain<R>> {
        operators::Chain::new(self.model.clone(), self.tables.blocks.clone(), self.times())
    }

    fn times(&self) -> TimeSteps {
        self.pace.times(self.model.dt, self.step)
    }

    /// A state of the consistent formulation, or of fixed particles, as it is, on the graph.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn look_consistent(&mut self, state: &Tensor) -> Result<Shown, RunError> {
        let there = self.there(state)?;
        let found = match &self.model.fixed {
            Some(fixed) => fixed.shown(&self.model, &there),
            None => {
                self.tables.update(&self.model, &self.neighbourhood);
                match self.kernels {
                    Kernels::Fused => operators::look(&self.chain(), &there),
                    Kernels::Composed => composed::look(&self.model, &self.neighbourhood.list, &there),
                }
            }
        };
        let Shown { known, masses, wall_heat } = found.map_err(RunError::tensor(self.step))?;
        let wall_heat = wall_heat.map(|heat| self.back(&heat, state)).transpose()?;
        Ok(Shown { known: self.back(&known, state)?, masses: self.back(&masses, state)?, wall_heat })
    }

    /// Moved state `[M, N]` and primitives `[C, N]` of a state as it is, on the graph.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn look(&self, state: &Tensor) -> Result<(Tensor, Tensor), RunError> {
        // Nothing of the run changes: the list is looked at as it is.
        let mut run = Self {
            model: self.model.clone(),
            neighbourhood: self.neighbourhood.shared(),
            step: self.step,
            pace: self.pace,
            kernels: self.kernels,
            density: None,
            device: self.device.clone(),
            tables: Tables::default(),
        };
        let there = self.there(state)?;
        let (moved, primitives) = match self.kernels {
            Kernels::Fused => step::look(&mut Fused { run: &mut run, chain: None }, &there),
            Kernels::Composed => step::look(&mut Composed { run: &mut run, pairs: None }, &there),
        }?;
        Ok((self.back(&moved, state)?, self.back(&primitives, state)?))
    }

    /// The operators' context at the present list.
    pub fn step_now(&self) -> Arc<Step<R>> {
        Arc::new(Step { model: self.model.clone(), list: self.neighbourhood.list.clone() })
    }

    /// Makes sure that the list holds for a moved state on any device.
    fn update_list(&mut self, moved: &Tensor) -> Result<(), RunError> {
        let (step, l) = (self.step, self.model.layout);
        let failed = RunError::tensor(step);
        let position = moved.detach().narrow(0, 0, l.dimension);
        let position = position.and_then(|position| position.to_device(&Device::Cpu)?.to_dtype(R::DTYPE));
        let mut updated = Ok(());
        read(&position.map_err(&failed)?, |position: &[R]| {
            updated = self.neighbourhood.update(&self.model.reach(), position);
            Ok(())
        })
        .map_err(&failed)?;
        updated.map_err(|source| RunError::Neighbours { step, source })
    }
}

/// Fused operators, each a node of candle's graph: what looks at a state, and has no step of its own.
struct Fused<'a, R: Sweeps> {
    run: &'a mut TensorSolver<R>,
    chain: Option<Arc<Chain<R>>>,
}

impl<R: Sweeps> Fused<'_, R> {
    fn failed(&self) -> impl Fn(candle_core::Error) -> RunError {
        RunError::tensor(self.run.step)
    }

    /// The operators of this step: begun by the first that asks.
    fn chain(&mut self) -> Arc<Chain<R>> {
        let run = &*self.run;
        self.chain.get_or_insert_with(|| Chain::new(run.step_now())).clone()
    }
}

impl<R: Sweeps> Execution for Fused<'_, R> {
    type Field = Tensor;

    fn drift(&mut self, dt: f64, state: &Tensor) -> Result<Tensor, RunError> {
        apply1(drift::Drift(self.run.model.clone(), dt), state).map_err(self.failed())
    }
    fn neighbours(&mut self, moved: &Tensor) -> Result<(), RunError> {
        self.run.update_list(moved)
    }
    fn density(&mut self, dt: f64, moved: &Tensor) -> Result<Tensor, RunError> {
        let chain = self.chain();
        match chain.step.model.layout.density {
            true => apply1(evolution::Evolution(chain, dt), moved),
            false => apply1(density::Density(chain), moved),
        }
        .map_err(self.failed())
    }
    fn wall_condition(&mut self, moved: &Tensor, density: &Tensor) -> Result<Tensor, RunError> {
        apply2(wall_condition::WallCondition(self.chain()), moved, density).map_err(self.failed())
    }
    fn rates(&mut self, moved: &Tensor, primitives: &Tensor) -> Result<Tensor, RunError> {
        apply2(rates::Rates(self.chain()), moved, primitives).map_err(self.failed())
    }
    fn assemble(&mut self, moved: &Tensor, primitives: &Tensor, rates: &Tensor) -> Result<Tensor, RunError> {
        let chain = self.chain();
        match chain.step.model.layout.density {
            true => apply3(assemble::AssembleEvolved(chain), moved, primitives, rates),
            false => apply2(assemble::Assemble(chain), moved, rates),
        }
        .map_err(self.failed())
    }
}

/// The same from ordinary candle operators, on any device. Only the neighbour list is built on the CPU.
struct Composed<'a, R: Sweeps> {
    run: &'a mut TensorSolver<R>,
    pairs: Option<(Arc<Step<R>>, Pairs)>,
}

impl<R: Sweeps> Composed<'_, R> {
    fn failed(&self) -> impl Fn(candle_core::Error) -> RunError {
        RunError::tensor(self.run.step)
    }

    fn pairs(&mut self, moved: &Tensor) -> Result<&(Arc<Step<R>>, Pairs), RunError> {
        let failed = self.failed();
        let found = match self.pairs.take() {
            Some(pairs) => pairs,
            None => {
                let step = self.run.step_now();
                let pairs = Pairs::new(&step, moved).map_err(failed)?;
                (step, pairs)
            }
        };
        Ok(self.pairs.insert(found))
    }
}

impl<R: Sweeps> Execution for Composed<'_, R> {
    type Field = Tensor;

    fn drift(&mut self, dt: f64, state: &Tensor) -> Result<Tensor, RunError> {
        drift::composed(&self.run.model, dt, state).map_err(self.failed())
    }
    fn neighbours(&mut self, moved: &Tensor) -> Result<(), RunError> {
        self.run.update_list(moved)
    }
    fn density(&mut self, dt: f64, moved: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, pairs) = self.pairs(moved)?;
        match step.model.layout.density {
            true => evolution::composed(step, pairs, dt, moved),
            false => density::composed(step, pairs, moved),
        }
        .map_err(failed)
    }
    fn wall_condition(&mut self, moved: &Tensor, density: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, pairs) = self.pairs(moved)?;
        wall_condition::composed(step, pairs, moved, density).map_err(failed)
    }
    fn rates(&mut self, moved: &Tensor, primitives: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, pairs) = self.pairs(moved)?;
        rates::composed(step, pairs, moved, primitives).map_err(failed)
    }
    fn assemble(&mut self, moved: &Tensor, primitives: &Tensor, rates: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, _) = self.pairs(moved)?;
        assemble::composed(step, moved, primitives, rates).map_err(failed)
    }
}
