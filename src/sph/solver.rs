//! Advancing a state: without a graph (buffers reused), or as candle tensors (a graph per step).

use crate::config::scene::Kernels;
use crate::numerics::lanes::Real;
use crate::particles::neighbour_list::NeighbourError;
use crate::sph::model::Model;
use crate::sph::operators::pairs::Kept;
use crate::sph::step;
use crate::sph::step::{Neighbourhood, Step};
use candle_core::Tensor;
use std::sync::Arc;

/// A run that could not go on.
#[derive(Debug, thiserror::Error)]
pub enum SolverError {
    #[error("step {step}: {source}")]
    Neighbours { step: usize, source: NeighbourError },
    #[error("step {step}: {source}")]
    Tensor { step: usize, source: candle_core::Error },
    #[error("step {step}: {field} of particle {particle} is {value}: the run has diverged; try a smaller time.cfl")]
    NotFinite { step: usize, field: &'static str, particle: usize, value: f64 },
}

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
    kept: Kept<R>,
    /// Of the last [`Self::look`], walls included, `[C, N]`.
    pub primitives: Vec<R>,
    rates: Vec<R>,
}

impl<R: Real> Solver<R> {
    pub fn new(model: Arc<Model<R>>, state: Vec<R>) -> Result<Self, SolverError> {
        let neighbourhood =
            Neighbourhood::build(&model, &state, 0).map_err(|source| SolverError::Neighbours { step: 0, source })?;
        Ok(Self::with_list(model, state, 0, neighbourhood))
    }

    fn with_list(model: Arc<Model<R>>, state: Vec<R>, step: usize, neighbourhood: Neighbourhood<R>) -> Self {
        let (n, l) = (model.particles(), model.layout);
        let rows = |rows: usize| vec![R::default(); rows * n];
        Self {
            moved: rows(l.moved_rows()),
            density: rows(1),
            kept: Kept::default(),
            primitives: Vec::new(),
            rates: rows(l.rate_rows()),
            model,
            state,
            step,
            neighbourhood,
        }
    }

    pub fn restore(model: Arc<Model<R>>, snapshot: &Snapshot<R>) -> Result<Self, SolverError> {
        let neighbourhood = Neighbourhood::build(&model, &snapshot.reference, 0)
            .map_err(|source| SolverError::Neighbours { step: snapshot.step, source })?;
        Ok(Self::with_list(model, snapshot.state.clone(), snapshot.step, neighbourhood))
    }

    pub fn snapshot(&self) -> Snapshot<R> {
        Snapshot { step: self.step, state: self.state.clone(), reference: self.neighbourhood.reference.clone() }
    }

    /// One time step.
    pub fn advance(&mut self) -> Result<(), SolverError> {
        let dt = self.model.dt;
        R::drift(&self.model, dt, &self.state, &mut self.moved);
        self.neighbourhood
            .update(&self.model, &self.moved)
            .map_err(|source| SolverError::Neighbours { step: self.step, source })?;
        let step = self.step_now();
        R::density(&step, &self.moved, &mut self.kept, false, &mut self.density);
        R::primitives(&step, &self.moved, &self.density, &mut self.kept, None);
        R::rates(&step, &self.moved, &self.kept, &mut self.rates);
        R::advance(&step, &self.moved, &self.rates, &mut self.state);
        self.step += 1;
        Ok(())
    }

    /// The operators' context at the present list.
    pub fn step_now(&self) -> Step<R> {
        Step { model: self.model.clone(), list: self.neighbourhood.list.clone() }
    }

    /// Fills [`Self::primitives`] for the present state without advancing it.
    pub fn look(&mut self) {
        R::drift(&self.model, 0.0, &self.state, &mut self.moved);
        let step = self.step_now();
        R::density(&step, &self.moved, &mut self.kept, false, &mut self.density);
        self.primitives.resize(self.model.layout.primitive_rows() * self.model.particles(), R::default());
        R::primitives(&step, &self.moved, &self.density, &mut self.kept, Some(&mut self.primitives));
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
    pub fn check_finite(&self) -> Result<(), SolverError> {
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
                return Err(SolverError::NotFinite { step: self.step, field, particle: place % n, value: value.f64() });
            }
        }
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

impl<R: Real> TensorSolver<R> {
    /// Starts at a snapshot's step and neighbour list.
    pub fn restore(model: Arc<Model<R>>, snapshot: &Snapshot<R>, kernels: Kernels) -> Result<Self, SolverError> {
        let neighbourhood = Neighbourhood::build(&model, &snapshot.reference, 0)
            .map_err(|source| SolverError::Neighbours { step: snapshot.step, source })?;
        Ok(Self { model, neighbourhood, step: snapshot.step, kernels })
    }

    /// One time step: state `[F, N]` -> state `[F, N]`, on the graph.
    pub fn advance(&mut self, state: &Tensor) -> Result<Tensor, SolverError> {
        self.advance_to(state, None)
    }

    /// The same; `after` is the state that it leads to, if that is known to the bit: the fused operators then leave out
    /// what the adjoint does not read.
    pub fn advance_to(&mut self, state: &Tensor, after: Option<&Tensor>) -> Result<Tensor, SolverError> {
        let at = self.step;
        let failed = |source| SolverError::Tensor { step: at, source };
        let fused = self.kernels == Kernels::Fused;
        let dt = self.model.dt;
        let moved = Step::drift(&self.model, dt, state, fused).map_err(failed)?;
        let mut updated = Ok(());
        step::read(&moved.contiguous().map_err(failed)?, |position: &[R]| {
            updated = self.neighbourhood.update(&self.model, position);
            Ok(())
        })
        .map_err(failed)?;
        updated.map_err(|source| SolverError::Neighbours { step: at, source })?;
        let step = self.step_now();
        self.step += 1;
        if fused { step.fused(&moved, after) } else { step.composed(&moved) }.map_err(failed)
    }

    /// The operators' context at the present list.
    pub fn step_now(&self) -> Arc<Step<R>> {
        Arc::new(Step { model: self.model.clone(), list: self.neighbourhood.list.clone() })
    }
}
