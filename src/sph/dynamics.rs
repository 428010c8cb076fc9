//! The SPH solver as [`Dynamics`], and the memory that its gradient takes.

use super::consistent::blocks::width;
use super::consistent::derivatives::{rows, KINDS};
use super::consistent::operators::Shown;
use super::consistent::stencil::{monomials, packed};
use super::fixed::Fixed;
use super::model::Model;
use super::operators::composed::per_particle;
use super::operators::pairs::stride;
use super::operators::rates::record_fields;
use super::solver::{Pace, Snapshot, Solver, TensorSolver};
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

/// The SPH solver as dynamics.
#[derive(Clone)]
pub struct Sph<R> {
    pub model: Arc<Model<R>>,
    /// What steps are made with. States, and all that is made of them, stay on the CPU.
    pub compute: Compute,
    tags: Arc<Vec<u8>>,
}

impl<R> Sph<R> {
    pub fn new(model: Arc<Model<R>>, compute: impl Into<Compute>) -> Self {
        let tags = Arc::new(model.tags.clone());
        Self { model, compute: compute.into(), tags }
    }
}

/// A state that a schedule keeps.
#[derive(Debug)]
pub struct KeptState<R> {
    step: usize,
    /// Of the step before, see [`super::division`].
    parts: usize,
    /// In R, or in f32. Behind those of the state, where densities are summed, that of the step behind it.
    numbers: Block,
    rounded: bool,
    /// Whether the density has been found.
    has_density: bool,
    /// Positions that the neighbour list of the step behind this state is built from; shared between states of the
    /// same list. Never rounded: the list must be the same one.
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
        run.look();
        let n = self.model.particles();
        if let Some(masses) = run.masses() {
            let tensor = |values: &[R]| Tensor::from_slice(values, (values.len() / n, n), &Device::Cpu);
            let l = self.model.layout;
            let velocity = &run.primitives[l.primitive_velocity() * n..][..l.dimension * n];
            let go = || {
                let temperature = match l.heat {
                    true => Some(tensor(&run.primitives[l.primitive_temperature() * n..][..n])?),
                    false => None,
                };
                let (position, velocity) = (tensor(&run.state[..l.dimension * n])?, tensor(velocity)?);
                let list = &run.neighbourhood.list;
                let fields =
                    self.fields_with_masses(run.step, position, velocity, tensor(masses)?, temperature, list)?;
                let heat = |until| Tensor::new(run.wall_heat_flux(until), &Device::Cpu)?.to_dtype(R::DTYPE);
                Ok(Fields { wall_heat: self.model.wall_heat_until.map(heat).transpose()?, ..fields })
            };
            return go().map_err(RunError::tensor(run.step));
        }
        let tensor = |values: &[R]| Tensor::from_slice(values, (values.len() / n, n), &Device::Cpu);
        let go = || self.fields_of(run.step, &tensor(run.moved())?, &tensor(&run.primitives)?, &run.neighbourhood.list);
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
        tape.advance_to(state, after)
    }
    fn pull_back(
        &self,
        tape: &mut TensorSolver<R>,
        state: &Tensor,
        after: Option<&Tensor>,
        cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        tape.pull_back(state, after, cotangent)
    }

    fn fields(&self, tape: &mut TensorSolver<R>, state: &Tensor) -> Result<Fields, RunError> {
        if self.model.layout.consistent {
            let shown = tape.look_consistent(state)?;
            let fields = self.fields_of_known(tape.step, shown, &tape.neighbourhood.list);
            return fields.map_err(RunError::tensor(tape.step));
        }
        let (moved, primitives) = tape.look(state)?;
        let fields = self.fields_of(tape.step, &moved, &primitives, &tape.neighbourhood.list);
        fields.map_err(RunError::tensor(tape.step))
    }

    fn keep(&self, run: &Solver<R>, rounded: bool) -> Result<KeptState<R>, RunError> {
        let (scratch, state) = (&self.model.scratch, &run.state);
        let numbers = if rounded {
            let round = |(to, from): (&mut f32, &R)| *to = from.f64() as f32;
            scratch.rounded_states.keep(state.len(), |kept: &mut [f32]| kept.iter_mut().zip(state).for_each(round))
        } else {
            let density = if self.keeps_density() { self.model.particles() } else { 0 };
            scratch.states.keep(state.len() + density, |kept: &mut [R]| copy(state, &mut kept[..state.len()]))
        };
        let numbers = numbers.map_err(|e| RunError::Tensor { step: run.step, source: candle_core::Error::Io(e) })?;
        Ok(KeptState {
            step: run.step,
            parts: run.pace.parts,
            numbers,
            rounded,
            has_density: false,
            reference: run.neighbourhood.reference.clone(),
        })
    }
    fn settle(&self, kept: &mut KeptState<R>, run: &Solver<R>) {
        // If the step built a new list, a replay would build the old one first and then find that it is outdated.
        kept.reference = run.began_with().clone();
        kept.has_density = self.keeps_density() && !kept.rounded && run.pace.parts == 1;
        if kept.has_density {
            kept.numbers.write(|kept: &mut [R]| copy(run.density(), &mut kept[run.state.len()..]));
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
        let (count, n) = (run.state.len(), self.model.particles());
        tape.density = kept.has_density.then(|| {
            let mut density = self.model.scratch.buffers.buffer(n);
            kept.numbers.read(|kept: &[R]| copy(&kept[count..], &mut density));
            density
        });
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
        let shared = list.bytes() + self.table_bytes(list);
        Bytes { own: tape.pace.parts * self.tape_bytes(list), shared, identity: Arc::as_ptr(list) as usize }
    }
}

impl<R: Sweeps> Sph<R> {
    /// 0 for walls' particles that hold something else than a velocity, else 1, `[N]`.
    fn moving(&self) -> Vec<R> {
        let holds = |i: usize| self.model.consistent.as_ref().is_some_and(|consistent| consistent.holds_no_velocity(i));
        (0..self.model.particles()).map(|i| if holds(i) { R::default() } else { R::of(1.0) }).collect()
    }

    /// Fields of a state of fixed particles, on the graph if it is, at no particular time.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn fields_of_fixed(&self, fixed: &Fixed<R>, state: &Tensor) -> candle_core::Result<Fields> {
        let list = NeighbourList { count: vec![1; self.model.particles()], ..NeighbourList::default() };
        self.fields_of_known(0, fixed.shown(&self.model, state)?, &list)
    }

    /// Fields of the consistent formulation's known state `[F, N]`, or of one of fixed particles.
    fn fields_of_known(
        &self,
        step: usize,
        Shown { known, masses, wall_heat }: Shown,
        list: &NeighbourList,
    ) -> candle_core::Result<Fields> {
        let l = self.model.layout;
        let (position, mut velocity) = (known.narrow(0, 0, l.dimension)?, known.narrow(0, l.velocity(), l.dimension)?);
        if self.model.consistent.is_some() {
            // Some of the walls' particles hold something else.
            velocity = velocity.broadcast_mul(&per_particle(self.moving(), &velocity)?)?;
        }
        let temperature = if l.heat { Some(known.narrow(0, l.temperature(), 1)?) } else { None };
        let fields = self.fields_with_masses(step, position, velocity, masses, temperature, list)?;
        Ok(Fields { wall_heat, ..fields })
    }

    /// Fields of the consistent formulation.
    fn fields_with_masses(
        &self,
        step: usize,
        position: Tensor,
        velocity: Tensor,
        mass: Tensor,
        temperature: Option<Tensor>,
        list: &NeighbourList,
    ) -> candle_core::Result<Fields> {
        let model = &*self.model;
        let n = model.particles();
        let density = per_particle(vec![R::of(model.equation_of_state.reference_density); n], &mass)?;
        Ok(Fields {
            step,
            time: step as f64 * model.dt,
            position,
            velocity,
            density,
            mass,
            temperature,
            wall_heat: None,
            tags: self.tags.clone(),
            active: Arc::new((0..n).map(|i| model.is_fluid(i) || list.count[i] > 0).collect()),
        })
    }

    /// Fields from the moved state `[M, N]` and the primitives `[C, N]` of a state.
    fn fields_of(
        &self,
        step: usize,
        moved: &Tensor,
        primitives: &Tensor,
        list: &NeighbourList,
    ) -> candle_core::Result<Fields> {
        let (model, l) = (&*self.model, self.model.layout);
        let n = model.particles();
        let temperature = match l.heat {
            true => Some(primitives.narrow(0, l.primitive_temperature(), 1)?),
            false => None,
        };
        let mass = match l.mass {
            true => moved.narrow(0, l.moved_mass(), 1)?,
            false => per_particle(vec![R::of(model.mass); n], moved)?,
        };
        Ok(Fields {
            step,
            time: step as f64 * model.dt,
            position: moved.narrow(0, 0, l.dimension)?,
            velocity: primitives.narrow(0, l.primitive_velocity(), l.dimension)?,
            density: primitives.narrow(0, 0, 1)?,
            mass,
            temperature,
            wall_heat: None,
            tags: self.tags.clone(),
            active: Arc::new((0..n).map(|i| model.is_fluid(i) || list.count[i] > 0).collect()),
        })
    }

    fn variable(&self, step: usize, state: Vec<R>) -> Result<Var, RunError> {
        let shape = (self.model.layout.state_rows(), self.model.particles());
        Var::from_vec(state, shape, &Device::Cpu).map_err(RunError::tensor(step))
    }

    /// The list of a kept state: one of the known ones if it is theirs, else built anew, in the last run's memory.
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

    /// Whether a kept state is followed by the density that the step behind it finds: its adjoint then need not find it again.
    fn keeps_density(&self) -> bool {
        let sums = self.model.consistent.is_none() && self.model.fixed.is_none() && !self.model.layout.density;
        sums && self.compute.kernels() == Kernels::Fused && self.model.is_fused()
    }

    /// Bytes of a number in every row of a field with `rows` rows.
    fn field(&self, rows: usize) -> usize {
        rows * self.model.particles() * std::mem::size_of::<R>()
    }

    /// What the operators of a step keep for each other, see [`super::operators::pairs::Kept`]: positions and records, and a
    /// number for each place of the neighbour list.
    fn operators_bytes(&self, places: usize) -> usize {
        let l = self.model.layout;
        let records = stride(record_fields(l.dimension, l.transport, l.heat));
        self.field(4 + records) + places * std::mem::size_of::<R>()
    }

    /// Neighbours, fluid ones or walls', that the consistent formulation's tables have room for at each fluid particle.
    fn room(list: &NeighbourList, fluid: bool) -> usize {
        let of = |&i: &u32| {
            let (all, near) = (list.count[i as usize], list.fluid_count[i as usize]);
            if fluid {
                near
            } else {
                all - near
            }
        };
        list.fluid_rows.iter().map(of).max().unwrap_or(0).next_multiple_of(4) as usize
    }

    /// The consistent formulation's tables of a list.
    fn table_bytes(&self, list: &NeighbourList) -> usize {
        let Some(consistent) = &self.model.consistent else { return 0 };
        let near = list.wall_rows.iter().map(|&i| list.fluid_count[i as usize]).max().unwrap_or(0);
        let walls = (consistent.surface.len() + list.wall_rows.len()) * near.next_multiple_of(4) as usize;
        let fluid = list.fluid_rows.len() * (Self::room(list, true) + Self::room(list, false));
        (walls + fluid) * std::mem::size_of::<u32>()
    }

    /// What a fused step leaves on the tape: the tensors moved state, density, primitives, rates and state, and what its
    /// operators keep.
    fn tape_bytes(&self, list: &NeighbourList) -> usize {
        let l = self.model.layout;
        if let Some(consistent) = &self.model.consistent {
            // Of all particles the tensors known, new pressure twice and state, and records; of the fluid the derivatives of
            // all fields and of the pressure, factorised matrices, W and F of pairs; of the surface fits.
            let (d, fits) = (l.dimension, monomials(l.dimension));
            let all = 2 * l.state_rows() + 2 + stride(d + l.fields()) + stride(d + 1);
            let fluid = rows(d, l.fields()) + rows(d, 1) + KINDS * packed(fits) + 2 * Self::room(list, true);
            let surface = packed(d + 1) + (l.fields() - d + 1) * (d + 1);
            let width = width::<R>();
            let numbers = list.fluid_rows.len().next_multiple_of(width) * fluid
                + consistent.surface.len().next_multiple_of(width) * surface;
            return self.field(all) + numbers * std::mem::size_of::<R>();
        }
        let places = list.index.len();
        let rows = l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows() + l.state_rows();
        self.field(rows) + self.operators_bytes(places)
    }

    /// What a kept state and a taped step take, in bytes, in a run that begins with `state`: its list, and its speed
    /// if that is above a tenth of the sound speed (which is chosen as ten times the fastest flow).
    pub fn costs_from(&self, state: &[R]) -> Result<Costs, NeighbourError> {
        let (l, n) = (self.model.layout, self.model.particles());
        let list = Neighbourhood::build(&self.model.reach(), state)?.list;
        let component = |i: usize, d: usize| state[(l.velocity() + d) * n + i].f64();
        let speed = |i: usize| (0..l.dimension).map(|d| component(i, d).powi(2)).sum::<f64>().sqrt();
        let fastest = (0..n).map(speed).fold(0.0, f64::max);
        Ok(self.costs_at(&list, fastest))
    }

    fn costs_at(&self, list: &NeighbourList, fastest: f64) -> Costs {
        // A list serves until a particle has moved half the skin.
        let speed = fastest.max(0.1 * super::plan::sound_speed(&self.model.equation_of_state));
        let steps_per_list = ((0.5 * self.model.skin / (speed * self.model.dt)).ceil() as usize).max(1);
        let (l, n, places) = (self.model.layout, self.model.particles(), list.index.len());
        let reference = self.field(l.dimension);
        // The plain run's fields and list, and a list in the making.
        let fields = l.state_rows() + l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows();
        let run = self.field(fields) + self.operators_bytes(places) + reference + 2 * list.bytes();
        // The variable, the cotangents of a state and of its parts, and the records of those of rates and primitives that
        // pair passes read.
        let records = stride(l.rate_rows()) + stride(l.primitive_rows() + 1);
        let parts = 2 * l.moved_rows() + 1 + l.primitive_rows() + l.rate_rows();
        let cotangents = self.field(3 * l.state_rows() + parts + records);
        // What the objective tapes of a step: the operators behind its fields, and fields of its own.
        let looked = if self.model.consistent.is_some() { self.tape_bytes(list) } else { 0 };
        let objective = self.field(l.moved_rows() + 1 + l.primitive_rows() + 8) + self.operators_bytes(places) + looked;
        Costs {
            state: self.field(l.state_rows() + usize::from(self.keeps_density())),
            rounded_state: l.state_rows() * n * std::mem::size_of::<f32>(),
            shared: reference,
            shared_steps: steps_per_list,
            tape_step: self.tape_bytes(list),
            tape_shared: list.bytes() + self.table_bytes(list),
            working: run + cotangents + objective,
        }
    }
}
