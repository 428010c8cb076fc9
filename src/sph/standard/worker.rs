//! Steps of the standard method without a graph, in reused buffers.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use super::step::{self, Execution};
use super::sweeps::Sweeps;
use super::tape::Tape;
use super::wall_heat::wall_flux;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::numerics::candle::read;
use crate::numerics::sweep::copy;
use crate::sph::method::{Looked, Place, Worker};
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
        let (n, l) = (model.particles(), model.layout);
        let rows = |rows: usize| vec![R::default(); rows * n];
        Self {
            moved: rows(l.moved_rows()),
            density: rows(1),
            primitives: rows(if l.density { l.primitive_rows() } else { 0 }),
            rates: rows(l.rate_rows()),
            kept: PairCache::default(),
            model,
        }
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
        step::advance(&mut Run { buffers: self, place, state: Some(state), from: None }, dt, &())
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError> {
        let (n, l) = (self.model.particles(), self.model.layout);
        self.primitives.resize(l.primitive_rows() * n, R::default());
        match self.model.is_fused() {
            true => step::look(&mut Run { buffers: self, place, state: None, from: Some(state) }, &()).map(|_| ())?,
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
        let step = Step { model: self.model.clone(), list: place.neighbourhood.list.clone() };
        Ok(wall_flux(&step, &self.moved, &self.primitives, until))
    }
    fn remember(&self, to: &mut [R]) {
        copy(&self.density, to);
    }
}

/// A step, or the evaluation of a state, on the buffers. Each field has its own buffer, so none is passed on.
struct Run<'a, 'b, R: Sweeps> {
    buffers: &'a mut Buffers<R>,
    place: &'a mut Place<'b, R>,
    /// The state that a step advances.
    state: Option<&'a mut Vec<R>>,
    /// The state that is evaluated. Only then are the primitives needed; a step needs only the records.
    from: Option<&'a [R]>,
}

impl<R: Sweeps> Run<'_, '_, R> {
    fn step_now(&self) -> Step<R> {
        Step { model: self.buffers.model.clone(), list: self.place.neighbourhood.list.clone() }
    }
}

impl<R: Sweeps> Execution for Run<'_, '_, R> {
    type Field = ();

    fn drift(&mut self, dt: f64, _: &()) -> Result<(), RunError> {
        let state = self.from.or(self.state.as_deref().map(Vec::as_slice)).unwrap_or_default();
        R::drift(&self.buffers.model, dt, state, &mut self.buffers.moved);
        Ok(())
    }
    fn neighbours(&mut self, _: &()) -> Result<(), RunError> {
        let step = self.place.step;
        let updated = self.place.neighbourhood.update(&self.buffers.model.reach(), &self.buffers.moved);
        updated.map_err(|source| RunError::Neighbours { step, source })
    }
    fn density(&mut self, dt: f64, _: &()) -> Result<(), RunError> {
        let (step, b) = (self.step_now(), &mut *self.buffers);
        match b.model.layout.density {
            true => R::evolution(&step, dt, &b.moved, &mut b.kept, &mut b.density),
            false => R::density(&step, &b.moved, &mut b.kept, &mut b.density),
        }
        Ok(())
    }
    fn wall_condition(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        let (step, b) = (self.step_now(), &mut *self.buffers);
        let shows = self.from.is_some() || b.model.layout.density;
        let primitives = shows.then_some(b.primitives.as_mut_slice());
        R::primitives(&step, &b.moved, &b.density, &mut b.kept, primitives);
        Ok(())
    }
    fn rates(&mut self, _: &(), _: &()) -> Result<(), RunError> {
        let (step, b) = (self.step_now(), &mut *self.buffers);
        R::rates(&step, &b.moved, &b.kept, &mut b.rates);
        Ok(())
    }
    fn assemble(&mut self, _: &(), _: &(), _: &()) -> Result<(), RunError> {
        let (step, b) = (self.step_now(), &*self.buffers);
        if let Some(state) = &mut self.state {
            R::assemble(&step, &b.moved, &b.primitives, &b.rates, state);
        }
        Ok(())
    }
}
