//! Advancing a state: without a graph (buffers reused), or as candle tensors (a graph per step).

use super::chain::{Chain, Step};
use super::model::Model;
use super::operators::composed::Pairs;
use super::operators::pairs::PairCache;
use super::operators::{assemble, density, drift, rates, wall_condition};
use super::step::{self, Execution};
use super::sweeps::Sweeps;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply1, apply2, read};
use crate::numerics::lanes::Real;
use crate::particles::Neighbourhood;
use candle_core::{Device, Tensor};
use std::sync::Arc;

/// A state to come back to: everything that the steps behind it depend on.
#[derive(Debug, Clone)]
pub struct Snapshot<R> {
    pub step: usize,
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
        Self { step: 0, state, reference }
    }
}

/// Advances a state without a graph.
#[derive(Debug)]
pub struct Solver<R> {
    pub model: Arc<Model<R>>,
    /// `[F, N]`, see [`crate::sph::model::Layout`].
    pub state: Vec<R>,
    pub step: usize,
    pub neighbourhood: Neighbourhood<R>,
    moved: Vec<R>,
    density: Vec<R>,
    kept: PairCache<R>,
    /// Of the last [`Self::look`], walls included, `[C, N]`.
    pub primitives: Vec<R>,
    rates: Vec<R>,
    /// Whether somebody reads the primitives: the step itself needs the records only.
    shows_primitives: bool,
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
        let rows = |rows: usize| vec![R::default(); rows * n];
        Ok(Self {
            moved: rows(l.moved_rows()),
            density: rows(1),
            kept: PairCache::default(),
            primitives: Vec::new(),
            rates: rows(l.rate_rows()),
            model,
            state: snapshot.state.clone(),
            step: snapshot.step,
            neighbourhood,
            shows_primitives: false,
        })
    }

    pub fn snapshot(&self) -> Snapshot<R> {
        Snapshot { step: self.step, state: self.state.clone(), reference: self.neighbourhood.reference.clone() }
    }

    /// One time step.
    ///
    /// # Errors
    /// Particles that are lost or too fast.
    pub fn advance(&mut self) -> Result<(), RunError> {
        let dt = self.model.dt;
        step::advance(self, dt, &())?;
        self.step += 1;
        Ok(())
    }

    /// The operators' context at the present list.
    pub fn step_now(&self) -> Step<R> {
        Step { model: self.model.clone(), list: self.neighbourhood.list.clone() }
    }

    /// Fills [`Self::primitives`] for the present state without advancing it.
    pub fn look(&mut self) {
        self.primitives.resize(self.model.layout.primitive_rows() * self.model.particles(), R::default());
        self.shows_primitives = true;
        // On buffers nothing fails but the list, which stays as it is.
        let _ = step::look(self, &());
        self.shows_primitives = false;
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

    /// An error if a number of the state is not finite.
    ///
    /// # Errors
    /// That one.
    pub fn check_finite(&self) -> Result<(), RunError> {
        let (n, l) = (self.model.particles(), self.model.layout);
        for (place, value) in self.state.iter().enumerate() {
            if !value.f64().is_finite() {
                let row = place / n;
                let field = match row {
                    _ if row < l.velocity() => "position",
                    _ if row < l.acceleration() => "velocity",
                    _ if row < l.temperature() => "acceleration",
                    _ => "temperature",
                };
                return Err(RunError::NotFinite { step: self.step, field, particle: place % n, value: value.f64() });
            }
        }
        Ok(())
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
    fn density(&mut self, _: &()) -> Result<(), RunError> {
        R::density(&self.step_now(), &self.moved, &mut self.kept, false, &mut self.density);
        Ok(())
    }
    fn wall_condition(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        let step = self.step_now();
        let primitives = self.shows_primitives.then_some(self.primitives.as_mut_slice());
        R::primitives(&step, &self.moved, &self.density, &mut self.kept, primitives);
        Ok(())
    }
    fn rates(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        R::rates(&self.step_now(), &self.moved, &self.kept, &mut self.rates);
        Ok(())
    }
    fn assemble(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        R::assemble(&self.step_now(), &self.moved, &self.rates, &mut self.state);
        Ok(())
    }
}

/// Advances a state as candle tensors.
pub struct TensorSolver<R> {
    pub model: Arc<Model<R>>,
    pub neighbourhood: Neighbourhood<R>,
    pub step: usize,
    pub kernels: Kernels,
}

impl<R: Sweeps> TensorSolver<R> {
    /// Starts at a snapshot's step and neighbour list.
    ///
    /// # Errors
    /// A state for which there is no neighbour list.
    pub fn restore(model: Arc<Model<R>>, snapshot: &Snapshot<R>, kernels: Kernels) -> Result<Self, RunError> {
        let neighbourhood = Neighbourhood::build(&model.reach(), &snapshot.reference)
            .map_err(|source| RunError::Neighbours { step: snapshot.step, source })?;
        Ok(Self { model, neighbourhood, step: snapshot.step, kernels })
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
        let dt = self.model.dt;
        let next = match self.kernels {
            Kernels::Fused => {
                let after = after.map(Tensor::detach);
                step::advance(&mut Fused { run: self, carries: true, after, chain: None }, dt, state)
            }
            Kernels::Composed => step::advance(&mut Composed { run: self, pairs: None }, dt, state),
        }?;
        self.step += 1;
        Ok(next)
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
            kernels: self.kernels,
        };
        match self.kernels {
            Kernels::Fused => step::look(&mut Fused { run: &mut run, carries: false, after: None, chain: None }, state),
            Kernels::Composed => step::look(&mut Composed { run: &mut run, pairs: None }, state),
        }
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

/// Fused operators, chained by candle.
struct Fused<'a, R: Sweeps> {
    run: &'a mut TensorSolver<R>,
    /// See [`Chain::carrying`].
    carries: bool,
    after: Option<Tensor>,
    chain: Option<Arc<Chain<R>>>,
}

impl<R: Sweeps> Fused<'_, R> {
    fn failed(&self) -> impl Fn(candle_core::Error) -> RunError {
        RunError::tensor(self.run.step)
    }

    /// The operators of this step: begun by the first that asks.
    fn chain(&mut self) -> Arc<Chain<R>> {
        let (run, carries, after) = (&*self.run, self.carries, &mut self.after);
        let begin = || match carries {
            true => Chain::carrying(run.step_now(), after.take()),
            false => Chain::new(run.step_now()),
        };
        self.chain.get_or_insert_with(begin).clone()
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
    fn density(&mut self, moved: &Tensor) -> Result<Tensor, RunError> {
        apply1(density::Density(self.chain()), moved).map_err(self.failed())
    }
    fn wall_condition(&mut self, moved: &Tensor, density: &Tensor) -> Result<Tensor, RunError> {
        let chain = self.chain();
        apply2(wall_condition::WallCondition(chain.clone()), &chain.shared(moved), density).map_err(self.failed())
    }
    fn rates(&mut self, moved: &Tensor, primitives: &Tensor) -> Result<Tensor, RunError> {
        let chain = self.chain();
        apply2(rates::Rates(chain.clone()), &chain.shared(moved), primitives).map_err(self.failed())
    }
    fn assemble(&mut self, moved: &Tensor, rates: &Tensor) -> Result<Tensor, RunError> {
        let chain = self.chain();
        apply2(assemble::Assemble(chain.clone()), &chain.shared(moved), rates).map_err(self.failed())
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
    fn density(&mut self, moved: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, pairs) = self.pairs(moved)?;
        density::composed(step, pairs, moved).map_err(failed)
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
    fn assemble(&mut self, moved: &Tensor, rates: &Tensor) -> Result<Tensor, RunError> {
        let failed = self.failed();
        let (step, _) = self.pairs(moved)?;
        assemble::composed(step, moved, rates).map_err(failed)
    }
}
