//! Steps of the standard method on candle's graph: as one fused node, or composed of candle's operators.

use super::chain::{Chain, Step};
use super::model::Standard;
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
            let Composed { moved, primitives, .. } = composed(&self.model, place, 0.0, state, false)?;
            return Ok((moved, primitives));
        }
        let chain = Chain::new(Step::now(&self.model, place));
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
        if self.kernels == Kernels::Fused {
            let density = self.density.take();
            return whole_step::advance(whole_step::At { model: &self.model, place, density }, state, after);
        }
        let Composed { step, pairs, moved, primitives } = composed(&self.model, place, place.times.now, state, true)?;
        let rates = rates::composed(&step, &pairs, &moved, &primitives);
        let next = rates.and_then(|rates| assemble::composed(&step, &moved, &primitives, &rates));
        next.map_err(RunError::tensor(place.step))
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
        let at = whole_step::At { model: &self.model, place, density: self.density.take() };
        whole_step::pull_back(at, state, after, cotangent).map(Some)
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
                carried_heat: None,
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

/// What ordinary candle operators make of a state after a time, on any device.
struct Composed<R> {
    step: Arc<Step<R>>,
    pairs: Pairs,
    moved: Tensor,
    primitives: Tensor,
}

/// `moves` asks for a neighbour list of the moved state, which is built on the CPU.
fn composed<R: Sweeps>(
    model: &Arc<Standard<R>>,
    place: &mut Place<'_, R>,
    dt: f64,
    state: &Tensor,
    moves: bool,
) -> Result<Composed<R>, RunError> {
    let failed = RunError::tensor(place.step);
    let moved = drift::composed(model, dt, state).map_err(&failed)?;
    if moves {
        place.update_list(model, &moved)?;
    }
    let step = Step::now(model, place);
    let go = || {
        let pairs = step.pairs(&moved)?;
        let density = match model.layout.density {
            true => evolution::composed(&step, &pairs, dt, &moved),
            false => density::composed(&step, &pairs, &moved),
        }?;
        let primitives = wall_condition::composed(&step, &pairs, &moved, &density)?;
        Ok(Composed { step, pairs, moved, primitives })
    };
    go().map_err(failed)
}
