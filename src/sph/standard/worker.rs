//! Steps of the standard method without a graph, in reused buffers.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use super::sweeps::Sweeps;
use super::tape::Tape;
use super::wall_heat::wall_flux;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::numerics::candle::read;
use crate::numerics::pool::fit;
use crate::numerics::sweep::copy;
use crate::sph::method::{Looked, Model, Place, Worker};
use candle_core::{Device, Tensor};
use std::sync::Arc;

/// The fields of a run, which walls have too.
#[derive(Debug)]
pub struct Buffers<R> {
    model: Arc<Standard<R>>,
    moved: Vec<R>,
    density: Vec<R>,
    primitives: Vec<R>,
    rates: Vec<R>,
    kept: PairCache<R>,
}

impl<R: Sweeps> Buffers<R> {
    pub fn new(model: Arc<Standard<R>>) -> Self {
        let (moved, density, primitives, rates) = Default::default();
        let mut new = Self { moved, density, primitives, rates, kept: PairCache::default(), model };
        new.make_room();
        new
    }

    fn make_room(&mut self) {
        let (n, l) = (self.model.particles(), self.model.layout);
        let (changes, primitives) = (self.model.part.is_some(), if l.density { l.primitive_rows() } else { 0 });
        fit(&mut self.moved, l.moved_rows() * n, changes);
        fit(&mut self.density, n, changes);
        fit(&mut self.primitives, primitives * n, changes);
        fit(&mut self.rates, l.rate_rows() * n, changes);
    }

    /// Density and, where the walls' are read, primitives of the moved state. (A step needs only the records.)
    fn evaluate(&mut self, step: &Step<R>, dt: f64, shows: bool) {
        match self.model.layout.density {
            true => R::evolution(step, dt, &self.moved, &mut self.kept, &mut self.density),
            false => R::density(step, &self.moved, &mut self.kept, &mut self.density),
        }
        let primitives = shows.then_some(self.primitives.as_mut_slice());
        R::primitives(step, &self.moved, &self.density, &mut self.kept, primitives);
    }

    /// Moved state and primitives of a state that is not advanced, by candle's operators.
    fn look_composed(&mut self, place: &mut Place<'_, R>, state: &[R]) -> Result<(), RunError> {
        let failed = RunError::tensor(place.step);
        let shape = (self.model.rows.count(), self.model.particles());
        let state = Tensor::from_slice(state, shape, &Device::Cpu).and_then(|state| state.to_device(place.device));
        let tape = Tape::new(self.model.clone(), Kernels::Composed);
        let (moved, primitives) = tape.fields(place, &state.map_err(&failed)?)?;
        for (to, from) in [(&mut self.moved, moved), (&mut self.primitives, primitives)] {
            let from = from.to_device(&Device::Cpu).and_then(|from| from.contiguous()).map_err(&failed)?;
            read(&from, |from: &[R]| {
                to.copy_from_slice(from);
                Ok(())
            })
            .map_err(&failed)?;
        }
        Ok(())
    }
}

impl<R: Sweeps> Worker<R> for Buffers<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &mut Vec<R>) -> Result<(), RunError> {
        let dt = place.times.now;
        R::drift(&self.model, dt, state, &mut self.moved);
        place.update(&self.model, &self.moved)?;
        let step = Step::now(&self.model, place);
        self.evaluate(&step, dt, self.model.layout.density);
        R::rates(&step, &self.moved, &self.kept, &mut self.rates);
        R::assemble(&step, &self.moved, &self.primitives, &self.rates, state);
        Ok(())
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError> {
        let (n, l) = (self.model.particles(), self.model.layout);
        self.primitives.resize(l.primitive_rows() * n, R::default());
        match self.model.is_fused() {
            true => {
                R::drift(&self.model, 0.0, state, &mut self.moved);
                self.evaluate(&Step::now(&self.model, place), 0.0, true);
            }
            false => self.look_composed(place, state)?,
        }
        let rows = |of: &[R], row: usize, rows: usize| of[row * n..(row + rows) * n].to_vec();
        to.position = rows(&self.moved, 0, l.dimension);
        to.density = rows(&self.primitives, 0, 1);
        to.velocity = rows(&self.primitives, l.primitive_velocity(), l.dimension);
        to.mass = match l.mass {
            true => rows(state, l.state_mass(), 1),
            false => Vec::new(),
        };
        to.temperature = match l.heat {
            true => rows(&self.primitives, l.primitive_temperature(), 1),
            false => Vec::new(),
        };
        Ok(())
    }
    fn wall_heat(&self, place: &Place<'_, R>, _: &[R], until: f64) -> Result<f64, RunError> {
        Ok(wall_flux(&Step::now(&self.model, place), &self.moved, &self.primitives, until))
    }
    fn remember(&self, to: &mut [R]) {
        copy(&self.density, to);
    }
    fn reseat(&mut self, model: &Model<R>) -> bool {
        let Some(model) = model.shared() else { return false };
        self.kept.clear();
        [&mut self.moved, &mut self.density, &mut self.primitives, &mut self.rates].into_iter().for_each(Vec::clear);
        self.model = model;
        self.make_room();
        true
    }
}
