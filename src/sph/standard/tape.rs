//! Steps of the standard method on candle's graph: as one fused node, or composed of candle's operators.

use super::chain::{Chain, Step};
use super::model::Standard;
use super::step::{self, Execution};
use super::sweeps::Sweeps;
use super::{assemble, density, drift, evolution, rates, wall_condition, whole_step};
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply1, apply2};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::copy;
use crate::sph::composed::Pairs;
use crate::sph::masks::per_particle;
use crate::sph::method::{Place, Recorder, Shown};
use candle_core::Tensor;
use std::sync::Arc;

/// Makes steps on candle's graph.
pub struct Tape<R: Sweeps> {
    model: Arc<Standard<R>>,
    kernels: Kernels,
    /// Densities of the next step, if a run without a graph has already computed them.
    density: Option<Buffer<R>>,
}

impl<R: Sweeps> Tape<R> {
    /// Fused kernels are used only if every operator of the model has one.
    pub fn new(model: Arc<Standard<R>>, kernels: Kernels) -> Self {
        let kernels = if model.is_fused() { kernels } else { Kernels::Composed };
        Self { model, kernels, density: None }
    }

    /// Moved state `[M, N]` and primitives `[C, N]` of a state that is not advanced.
    pub fn fields(&self, place: &mut Place<'_, R>, state: &Tensor) -> Result<(Tensor, Tensor), RunError> {
        let failed = RunError::tensor(place.step);
        if self.kernels == Kernels::Composed {
            return step::look(&mut Composed { model: &self.model, place, pairs: None }, state);
        }
        let step = Step { model: self.model.clone(), list: place.neighbourhood.list.clone() };
        let chain = Chain::new(Arc::new(step));
        let go = || {
            let moved = apply1(drift::Drift(self.model.clone(), 0.0), state)?;
            let density = match self.model.layout.density {
                true => apply1(evolution::Evolution(chain.clone(), 0.0), &moved),
                false => apply1(density::Density(chain.clone()), &moved),
            }?;
            let primitives = apply2(wall_condition::WallCondition(chain.clone()), &moved, &density)?;
            Ok((moved, primitives))
        };
        go().map_err(failed)
    }
}

impl<R: Sweeps> Recorder<R> for Tape<R> {
    fn advance(
        &mut self,
        place: &mut Place<'_, R>,
        state: &Tensor,
        after: Option<&Tensor>,
    ) -> Result<Tensor, RunError> {
        let dt = place.times.now;
        match self.kernels {
            Kernels::Fused => {
                let density = self.density.take();
                whole_step::advance(whole_step::At { model: &self.model, place, density }, dt, state, after)
            }
            Kernels::Composed => step::advance(&mut Composed { model: &self.model, place, pairs: None }, dt, state),
        }
    }
    fn pulls_back(&self) -> bool {
        self.kernels == Kernels::Fused
    }
    fn pull_back(
        &mut self,
        place: &mut Place<'_, R>,
        state: &Tensor,
        after: Option<&Tensor>,
        cotangent: &Tensor,
    ) -> Result<Option<Tensor>, RunError> {
        if !self.pulls_back() {
            return Ok(None);
        }
        let (dt, density) = (place.times.now, self.density.take());
        let at = whole_step::At { model: &self.model, place, density };
        whole_step::pull_back(at, dt, state, after, cotangent).map(Some)
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &Tensor) -> Result<Shown, RunError> {
        let (moved, primitives) = self.fields(place, state)?;
        let (model, l) = (&*self.model, self.model.layout);
        let go = || -> candle_core::Result<Shown> {
            Ok(Shown {
                position: moved.narrow(0, 0, l.dimension)?,
                velocity: primitives.narrow(0, l.primitive_velocity(), l.dimension)?,
                density: primitives.narrow(0, 0, 1)?,
                mass: match l.mass {
                    true => moved.narrow(0, l.moved_mass(), 1)?,
                    false => per_particle(vec![R::of(model.mass); model.particles()], &moved)?,
                },
                temperature: match l.heat {
                    true => Some(primitives.narrow(0, l.primitive_temperature(), 1)?),
                    false => None,
                },
                wall_heat: None,
            })
        };
        go().map_err(RunError::tensor(place.step))
    }
    fn recall(&mut self, numbers: &[R]) {
        let mut density = self.model.scratch.buffers.buffer(numbers.len());
        copy(numbers, &mut density);
        self.density = Some(density);
    }
}

/// A step by ordinary candle operators, on any device. Only the neighbour list is built on the CPU.
struct Composed<'a, 'b, R: Sweeps> {
    model: &'a Arc<Standard<R>>,
    place: &'a mut Place<'b, R>,
    pairs: Option<(Arc<Step<R>>, Pairs)>,
}

impl<R: Sweeps> Composed<'_, '_, R> {
    fn failed(&self) -> impl Fn(candle_core::Error) -> RunError {
        RunError::tensor(self.place.step)
    }

    fn pairs(&mut self, moved: &Tensor) -> Result<&(Arc<Step<R>>, Pairs), RunError> {
        let failed = self.failed();
        let found = match self.pairs.take() {
            Some(pairs) => pairs,
            None => {
                let step = Arc::new(Step { model: self.model.clone(), list: self.place.neighbourhood.list.clone() });
                let pairs = step.pairs(moved).map_err(failed)?;
                (step, pairs)
            }
        };
        Ok(self.pairs.insert(found))
    }
}

impl<R: Sweeps> Execution for Composed<'_, '_, R> {
    type Field = Tensor;

    fn drift(&mut self, dt: f64, state: &Tensor) -> Result<Tensor, RunError> {
        drift::composed(self.model, dt, state).map_err(self.failed())
    }
    fn neighbours(&mut self, moved: &Tensor) -> Result<(), RunError> {
        self.place.update_list(self.model, moved)
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
