//! Steps of the consistent method, without a graph and on candle's graph.

use super::blocks::Blocks;
use super::composed::{self, Known};
use super::geometry::Geometry;
use super::model::Consistent;
use super::operators::{self, Buffers};
use super::sweeps::Sweeps;
use crate::adjoint::RunError;
use crate::config::scene::Kernels;
use crate::numerics::lanes::Real;
use crate::particles::Neighbourhood;
use crate::sph::masks::per_particle;
use crate::sph::method::{Looked, Model, Place, Recorder, Shown, Worker};
use candle_core::Tensor;
use std::sync::Arc;

/// The tables of the present neighbour list.
#[derive(Debug, Default)]
struct Tables {
    blocks: Arc<Blocks>,
    /// Identity of the neighbour list from which the tables were made.
    identity: u64,
}

impl Tables {
    /// The tables of a neighbour list, which are remade if the list has changed.
    fn update<R: Sweeps>(&mut self, model: &Consistent<R>, neighbourhood: &Neighbourhood<R>) -> Arc<Blocks> {
        if self.identity != neighbourhood.identity {
            self.identity = neighbourhood.identity;
            if Arc::get_mut(&mut self.blocks).is_none() {
                self.blocks = Arc::default();
            }
            if let Some(blocks) = Arc::get_mut(&mut self.blocks) {
                R::tables(blocks, &neighbourhood.list, &model.fits.surface);
            }
        }
        self.blocks.clone()
    }
}

/// Makes steps without a graph, in reused buffers.
#[derive(Debug)]
pub struct Run<R> {
    model: Arc<Consistent<R>>,
    tables: Tables,
    buffers: Buffers<R>,
    /// Masses of fluid particles in sums over a cross-section, for the last evaluated state, `[N]`.
    masses: Vec<R>,
    drive: Option<f64>,
}

impl<R: Sweeps> Run<R> {
    pub fn new(model: Arc<Consistent<R>>) -> Self {
        let masses = vec![R::default(); model.particles()];
        Self { model, tables: Tables::default(), buffers: Buffers::default(), masses, drive: None }
    }
}

impl<R: Sweeps> Worker<R> for Run<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &mut Vec<R>) -> Result<(), RunError> {
        place.update(&self.model, state)?;
        let blocks = self.tables.update(&self.model, place.neighbourhood);
        let geometry = Geometry { model: &self.model, blocks: &blocks, times: place.times };
        self.drive = self.buffers.advance(&geometry, state);
        self.model.refresh(state);
        Ok(())
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &[R], to: &mut Looked<R>) -> Result<(), RunError> {
        let blocks = self.tables.update(&self.model, place.neighbourhood);
        let geometry = Geometry { model: &self.model, blocks: &blocks, times: place.times };
        self.buffers.look(&geometry, state);
        operators::masses(&geometry, &self.buffers.derivatives, &mut self.masses);
        let (model, l, n) = (&*self.model, self.model.layout, self.model.particles());
        let known = &self.buffers.known;
        let rows = |row: usize, rows: usize| known[row * n..(row + rows) * n].to_vec();
        to.position = state[..l.dimension * n].to_vec();
        to.velocity = rows(l.velocity(), l.dimension);
        // The velocity rows of some wall particles hold something else.
        for i in (0..n).filter(|&i| model.holds_no_velocity(i)) {
            (0..l.dimension).for_each(|d| to.velocity[d * n + i] = R::default());
        }
        let density = model.equation_of_state.reference_density;
        let by_pressure = R::of(1.0 / model.fits.sound_speed.powi(2));
        to.density = known[l.pressure() * n..][..n].iter().map(|&p| R::of(density) + p * by_pressure).collect();
        to.mass = self.masses.clone();
        to.temperature = if l.heat { rows(l.temperature(), 1) } else { Vec::new() };
        Ok(())
    }
    fn wall_heat(&self, place: &Place<'_, R>, _: &[R], until: f64) -> Result<f64, RunError> {
        let geometry = Geometry { model: &self.model, blocks: &self.tables.blocks, times: place.times };
        let Buffers { known, derivatives, .. } = &self.buffers;
        Ok(operators::heating(&geometry, known, derivatives, &self.masses, until))
    }
    fn drive(&self) -> Option<f64> {
        self.drive
    }
    fn reseat(&mut self, model: &Model<R>) -> bool {
        let Some(model) = model.shared() else { return false };
        self.model = model;
        self.buffers.clear();
        self.masses.clear();
        self.masses.resize(self.model.particles(), R::default());
        true
    }
}

pub struct Tape<R> {
    model: Arc<Consistent<R>>,
    kernels: Kernels,
    tables: Tables,
}

impl<R: Sweeps> Tape<R> {
    pub fn new(model: Arc<Consistent<R>>, kernels: Kernels) -> Self {
        Self { model, kernels, tables: Tables::default() }
    }

    fn chain(&mut self, place: &Place<'_, R>) -> Arc<operators::Chain<R>> {
        let blocks = self.tables.update(&self.model, place.neighbourhood);
        operators::Chain::new(self.model.clone(), blocks, place.times)
    }
}

impl<R: Sweeps> Recorder<R> for Tape<R> {
    fn advance(&mut self, place: &mut Place<'_, R>, state: &Tensor, _: Option<&Tensor>) -> Result<Tensor, RunError> {
        place.update_list(&self.model, state)?;
        let next = match self.kernels {
            Kernels::Fused => operators::advance(&self.chain(place), state),
            Kernels::Composed => composed::advance(&self.model, &place.neighbourhood.list, place.times, state),
        };
        next.map_err(RunError::tensor(place.step))
    }
    fn look(&mut self, place: &mut Place<'_, R>, state: &Tensor) -> Result<Shown, RunError> {
        let found = match self.kernels {
            Kernels::Fused => operators::look(&self.chain(place), state),
            Kernels::Composed => composed::look(&self.model, &place.neighbourhood.list, state),
        };
        found.and_then(|known| shown(&self.model, known)).map_err(RunError::tensor(place.step))
    }
}

/// The fields of a state for objectives.
fn shown<R: Real>(model: &Consistent<R>, Known { known, masses, wall_heat }: Known) -> candle_core::Result<Shown> {
    let (l, n) = (model.layout, model.particles());
    let velocity = known.narrow(0, l.velocity(), l.dimension)?;
    // The velocity rows of some wall particles hold something else.
    let moves = (0..n).map(|i| if model.holds_no_velocity(i) { R::default() } else { R::of(1.0) }).collect();
    let density = vec![R::of(model.equation_of_state.reference_density); n];
    Ok(Shown {
        position: known.narrow(0, 0, l.dimension)?,
        velocity: velocity.broadcast_mul(&per_particle::<R>(moves, &velocity)?)?,
        density: per_particle(density, &masses)?,
        mass: masses,
        temperature: if l.heat { Some(known.narrow(0, l.temperature(), 1)?) } else { None },
        wall_heat,
        carried_heat: None,
    })
}
