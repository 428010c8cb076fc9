//! Implements [`Dynamics`] for the SPH solver, and estimates the memory of its gradient.

use super::method::{Model, Shown};
use super::pace::Pace;
use super::solver::{Snapshot, Solver, TensorSolver};
use super::sweeps::Sweeps;
use crate::adjoint::dynamics::{Bytes, Dynamics, Fields, RunError};
use crate::adjoint::schedule::Costs;
use crate::config::device::Compute;
use crate::config::scene::Kernels;
use crate::numerics::blocks::Block;
use crate::numerics::sweep::{copied, copy};
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::neighbourhood::Neighbourhood;
use crate::particles::NeighbourList;
use candle_core::{Device, Tensor, Var};
use std::sync::Arc;

/// An SPH method as [`Dynamics`].
#[derive(Clone)]
pub struct Sph<R> {
    pub model: Model<R>,
    /// Kernels and device of the steps. States and everything derived from them stay on the CPU.
    pub compute: Compute,
    /// Sees each step on the graph.
    pub tap: Option<Arc<Tap<R>>>,
    pub(super) tags: Arc<Vec<u8>>,
}

/// Maps the state after a step to the same state, through an operator of its own on the graph. It is given the tape
/// after the step, and the state before it.
pub type Tap<R> = dyn Fn(&TensorSolver<R>, &Tensor, Tensor) -> candle_core::Result<Tensor> + Send + Sync;

impl<R: 'static> Sph<R> {
    pub fn new(model: impl Into<Model<R>>, compute: impl Into<Compute>) -> Self {
        let model = model.into();
        let tags = Arc::new(model.tags.clone());
        Self { model, compute: compute.into(), tap: None, tags }
    }
}

/// A state that a checkpointing schedule keeps.
#[derive(Debug)]
pub struct KeptState<R> {
    step: usize,
    /// Number of parts of the step before, see [`super::division`].
    parts: usize,
    /// The state in R or in f32, followed by room for the results of the step from it, see [`Method::remembered`].
    ///
    /// [`Method::remembered`]: super::method::Method::remembered
    numbers: Block,
    rounded: bool,
    /// Whether these results have been stored.
    remembers: bool,
    /// Positions from which the neighbour list of the step after this state is built. States of the same list share
    /// them. They are never rounded, so that the list is the same.
    reference: Arc<Vec<R>>,
}

impl<R: Sweeps> Dynamics for Sph<R> {
    type Start = Snapshot<R>;
    type Kept = KeptState<R>;
    type Run = Solver<R>;
    type Tape = TensorSolver<R>;

    fn start(&self, snapshot: &Snapshot<R>) -> Result<Solver<R>, RunError> {
        Ok(Solver::restore(self.model.clone(), snapshot)?.on(self.compute.device()))
    }
    fn advance(&self, run: &mut Solver<R>) -> Result<(), RunError> {
        if self.compute.kernels() == Kernels::Fused {
            return run.advance();
        }
        run.advance_composed()
    }
    fn step(&self, run: &Solver<R>) -> usize {
        run.step
    }
    fn check(&self, run: &Solver<R>) -> Result<(), RunError> {
        run.check()
    }
    fn moving(&self) -> candle_core::Result<Option<Tensor>> {
        let mask: Vec<R> =
            (0..self.model.particles()).map(|i| R::of(f64::from(u8::from(self.model.is_fluid(i))))).collect();
        let count = mask.len();
        Ok(Some(Tensor::from_vec(mask, (1, count), &candle_core::Device::Cpu)?))
    }
    fn look(&self, run: &mut Solver<R>) -> Result<Fields, RunError> {
        run.look()?;
        let wall_heat = self.model.wall_heat_until.map(|until| run.wall_heat_flux(until)).transpose()?;
        let carried_heat = run.carried_heat()?;
        let scalar = |heat: f64| Tensor::new(heat, &Device::Cpu)?.to_dtype(R::DTYPE);
        let (model, n, looked) = (&*self.model, self.model.particles(), &run.looked);
        let tensor = |values: &[R]| Tensor::from_slice(values, (values.len() / n, n), &Device::Cpu);
        let go = || {
            let shown = Shown {
                position: tensor(&looked.position)?,
                velocity: tensor(&looked.velocity)?,
                density: match model.counted_density() {
                    Some(density) => tensor(&vec![R::of(density); n])?,
                    None => tensor(&looked.density)?,
                },
                mass: match looked.mass.is_empty() {
                    true => tensor(&vec![R::of(model.mass); n])?,
                    false => tensor(&looked.mass)?,
                },
                temperature: match looked.temperature.is_empty() {
                    true => None,
                    false => Some(tensor(&looked.temperature)?),
                },
                wall_heat: wall_heat.map(scalar).transpose()?,
                carried_heat: carried_heat.map(scalar).transpose()?,
            };
            candle_core::Result::Ok(self.fields_of(run.step, shown, &run.neighbourhood.list))
        };
        go().map_err(RunError::tensor(run.step))
    }
    fn tensor(&self, snapshot: &Snapshot<R>) -> Result<Tensor, RunError> {
        Ok(self.variable(snapshot.step, copied(&snapshot.state))?.as_detached_tensor())
    }
    fn advance_taped(
        &self,
        tape: &mut TensorSolver<R>,
        state: &Tensor,
        after: Option<&Tensor>,
    ) -> Result<Tensor, RunError> {
        let next = tape.advance_to(state, after)?;
        match &self.tap {
            Some(tap) => tap(tape, state, next).map_err(RunError::tensor(tape.step)),
            None => Ok(next),
        }
    }
    fn pull_back(
        &self,
        tape: &mut TensorSolver<R>,
        state: &Tensor,
        after: Option<&Tensor>,
        cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        match &self.tap {
            Some(_) => Ok(None),
            None => tape.pull_back(state, after, cotangent),
        }
    }

    fn fields(&self, tape: &mut TensorSolver<R>, state: &Tensor) -> Result<Fields, RunError> {
        let shown = tape.look(state)?;
        Ok(self.fields_of(tape.step, shown, &tape.neighbourhood.list))
    }

    fn keep(&self, run: &Solver<R>, rounded: bool) -> Result<KeptState<R>, RunError> {
        let (scratch, state) = (&self.model.scratch, &run.state);
        let numbers = if rounded {
            let round = |(to, from): (&mut f32, &R)| *to = from.f64() as f32;
            scratch.rounded_states.keep(state.len(), |kept: &mut [f32]| kept.iter_mut().zip(state).for_each(round))
        } else {
            scratch.states.keep(state.len() + self.remembered(), |kept: &mut [R]| copy(state, &mut kept[..state.len()]))
        };
        let numbers = numbers.map_err(|e| RunError::Tensor { step: run.step, source: candle_core::Error::Io(e) })?;
        Ok(KeptState {
            step: run.step,
            parts: run.pace.parts,
            numbers,
            rounded,
            remembers: false,
            reference: run.neighbourhood.reference.clone(),
        })
    }
    fn settle(&self, kept: &mut KeptState<R>, run: &Solver<R>) {
        // If the step built a new list, a replay first builds the old one and then finds that it is outdated.
        kept.reference = run.began_with().clone();
        kept.remembers = self.remembered() > 0 && !kept.rounded && run.pace.parts == 1;
        if kept.remembers {
            kept.numbers.write(|kept: &mut [R]| run.remember(&mut kept[run.state.len()..]));
        }
    }
    fn resume(&self, run: &mut Solver<R>, kept: &KeptState<R>) -> Result<(), RunError> {
        if kept.rounded {
            let widen = |(to, from): (&mut R, &f32)| *to = R::of(*from as f64);
            kept.numbers.read(|state: &[f32]| run.state.iter_mut().zip(state).for_each(widen));
        } else {
            let count = run.state.len();
            kept.numbers.read(|state: &[R]| copy(&state[..count], &mut run.state));
        }
        run.step = kept.step;
        run.pace = Pace::after(kept.parts);
        if !Arc::ptr_eq(&run.neighbourhood.reference, &kept.reference) {
            run.neighbourhood
                .rebuild_at(&self.model.reach(), &kept.reference)
                .map_err(|source| RunError::Neighbours { step: kept.step, source })?;
        }
        Ok(())
    }
    fn tape(
        &self,
        kept: &KeptState<R>,
        last: Option<TensorSolver<R>>,
        run: &Solver<R>,
    ) -> Result<(TensorSolver<R>, Var), RunError> {
        let neighbourhood = self.neighbourhood(kept, last, run)?;
        let mut tape =
            TensorSolver::new(self.model.clone(), neighbourhood, kept.step, kept.parts, self.compute.clone());
        let count = run.state.len();
        if kept.remembers {
            kept.numbers.read(|kept: &[R]| tape.recall(&kept[count..]));
        }
        let variable = if kept.rounded {
            let state: Vec<R> = kept.numbers.read(|state: &[f32]| state.iter().map(|&x| R::of(x as f64)).collect());
            self.variable(kept.step, state)?
        } else {
            let state = kept.numbers.read(|kept: &[R]| copied(&kept[..count]));
            self.variable(kept.step, state)?
        };
        Ok((tape, variable))
    }

    fn kept_bytes(&self, kept: &KeptState<R>) -> Bytes {
        let own = kept.numbers.bytes();
        let shared = std::mem::size_of_val(kept.reference.as_slice());
        Bytes { own, shared, identity: Arc::as_ptr(&kept.reference) as usize }
    }
    fn taped_bytes(&self, tape: &TensorSolver<R>) -> Bytes {
        let list = &tape.neighbourhood.list;
        let memory = self.model.memory(list);
        let shared = list.bytes() + memory.tables;
        Bytes { own: tape.pace.parts * memory.tape, shared, identity: Arc::as_ptr(list) as usize }
    }
}

impl<R: Sweeps> Sph<R> {
    /// The fields of a steady state, on the graph if the state is. They have step and time 0.
    pub fn fields_of_steady(&self, shown: Shown) -> Fields {
        let list = NeighbourList { count: vec![1; self.model.particles()], ..NeighbourList::default() };
        self.fields_of(0, shown, &list)
    }

    fn fields_of(&self, step: usize, shown: Shown, list: &NeighbourList) -> Fields {
        let model = &*self.model;
        let Shown { position, velocity, density, mass, temperature, wall_heat, carried_heat } = shown;
        Fields {
            step,
            time: step as f64 * model.dt,
            position,
            velocity,
            density,
            mass,
            temperature,
            wall_heat,
            carried_heat,
            tags: self.tags.clone(),
            active: Arc::new((0..model.particles()).map(|i| model.is_fluid(i) || list.count[i] > 0).collect()),
        }
    }

    fn variable(&self, step: usize, state: Vec<R>) -> Result<Var, RunError> {
        let shape = (self.model.rows.count(), self.model.particles());
        Var::from_vec(state, shape, &Device::Cpu).map_err(RunError::tensor(step))
    }

    /// The neighbour list of a kept state: one of the lists at hand if it is the same, else a new one in the memory of
    /// `last`.
    fn neighbourhood(
        &self,
        kept: &KeptState<R>,
        last: Option<TensorSolver<R>>,
        run: &Solver<R>,
    ) -> Result<Neighbourhood<R>, RunError> {
        let is_its = |one: &Neighbourhood<R>| Arc::ptr_eq(&one.reference, &kept.reference);
        let mut last = last.map_or_else(Neighbourhood::empty, |tape| tape.neighbourhood);
        if is_its(&last) {
            return Ok(last);
        }
        if is_its(&run.neighbourhood) {
            return Ok(run.neighbourhood.clone());
        }
        last.rebuild_at(&self.model.reach(), &kept.reference)
            .map_err(|source| RunError::Neighbours { step: kept.step, source })?;
        Ok(last)
    }

    /// How many numbers a kept state has beyond the state itself. Composed steps use none.
    fn remembered(&self) -> usize {
        match self.compute.kernels() {
            Kernels::Fused => self.model.remembered(),
            Kernels::Composed => 0,
        }
    }

    /// Bytes of a field `[rows, N]`.
    fn field(&self, rows: usize) -> usize {
        rows * self.model.particles() * std::mem::size_of::<R>()
    }

    /// Bytes of a kept state and of a taped step in a run that begins with `state`, by the neighbour list of `state`,
    /// and its speed if that is above a tenth of the speed of sound (which is chosen as ten times the fastest flow).
    pub fn costs_from(&self, state: &[R]) -> Result<Costs, NeighbourError> {
        let (l, n) = (self.model.rows, self.model.particles());
        let list = Neighbourhood::build(&self.model.reach(), state)?.list;
        let component = |i: usize, d: usize| state[(l.velocity() + d) * n + i].f64();
        let speed = |i: usize| (0..l.dimension).map(|d| component(i, d).powi(2)).sum::<f64>().sqrt();
        let fastest = (0..n).map(speed).fold(0.0, f64::max);
        Ok(self.costs_at(&list, fastest))
    }

    fn costs_at(&self, list: &NeighbourList, fastest: f64) -> Costs {
        let model = &*self.model;
        // A list is valid until a particle has moved by half the skin.
        let speed = fastest.max(0.1 * model.sound_speed());
        let steps_per_list = ((0.5 * model.skin / (speed * model.dt)).ceil() as usize).max(1);
        let (state, n, memory) = (model.rows.count(), model.particles(), model.memory(list));
        let reference = self.field(model.dimension());
        Costs {
            state: self.field(state) + self.remembered() * std::mem::size_of::<R>(),
            rounded_state: state * n * std::mem::size_of::<f32>(),
            shared: reference,
            shared_steps: steps_per_list,
            tape_step: memory.tape,
            tape_shared: list.bytes() + memory.tables,
            // The run's buffers, its list and one being built, cotangents, and what the objective puts on the tape for
            // a step.
            working: memory.run + reference + 2 * list.bytes() + memory.cotangents + memory.look,
        }
    }
}
