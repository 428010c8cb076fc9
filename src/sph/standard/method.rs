//! Implements the interface [`crate::sph::method::Method`] for the standard method.

use super::model::{Laws, Standard};
use super::plan;
use super::records::record_fields;
use super::sweeps::Sweeps;
use super::tape::Tape;
use super::worker::Buffers;
use crate::config::scene::Kernels;
use crate::config::stability::{self, CflLimit};
use crate::particles::NeighbourList;
use crate::sph::flow::{picked, Flow};
use crate::sph::inventory::{Dropped, Field, Operator};
use crate::sph::method::{Memory, Method, Model, Parts, Recorder, Sharing, Worker};
use crate::sph::pairs::stride;
use crate::sph::part::Part;
use std::sync::Arc;

impl<R: Sweeps> Method<R> for Standard<R> {
    fn name(&self) -> &'static str {
        "standard"
    }
    fn flow(&self) -> &Flow<R> {
        &self.flow
    }
    fn with_flow(&self, flow: Flow<R>) -> Model<R> {
        Model::new(Self { flow, ..self.clone() })
    }
    fn worker(self: Arc<Self>) -> Box<dyn Worker<R>> {
        Box::new(Buffers::new(self))
    }
    fn recorder(self: Arc<Self>, kernels: Kernels) -> Box<dyn Recorder<R>> {
        Box::new(Tape::new(self, kernels))
    }
    fn is_fused(&self) -> bool {
        Standard::is_fused(self)
    }
    fn of(&self, some: &[u32], part: Arc<Part>) -> Option<Model<R>> {
        let n = self.particles();
        let normals =
            self.laws.normals.as_ref().map(|all| all.chunks_exact(n).flat_map(|row| picked(row, some)).collect());
        let laws = Laws { normals, ..self.laws.clone() };
        Some(Model::new(Self::new(self.flow.of(some, part), self.layout, laws)))
    }
    fn sharing(&self) -> Option<Sharing> {
        // Walls average the fluid around them.
        let reaches = if self.has_walls() { 2 } else { 1 };
        Standard::is_fused(self).then_some(Sharing { reaches, only: None })
    }
    fn has_velocity(&self, _: usize) -> bool {
        true
    }
    fn wall_temperature(&self, _: &[R]) -> f64 {
        let given = self.heat.iter().flat_map(|heat| &heat.wall_constant);
        given.map(|t| t.f64().abs()).fold(0.0, f64::max)
    }
    fn remembered(&self) -> usize {
        // Summed densities are remembered; an evolved density is in the state.
        if self.layout.density || !Standard::is_fused(self) {
            0
        } else {
            self.particles()
        }
    }
    fn memory(&self, list: &NeighbourList) -> Memory {
        let l = self.layout;
        let parts = Parts { moved: l.moved_rows(), primitives: l.primitive_rows(), rates: l.rate_rows() };
        // Positions and records, and a number for each place of the neighbour list.
        let records = stride(record_fields(l.dimension, l.transport, l.heat));
        let numbers = (4 + records) * self.particles() + list.index.len();
        let bars = stride(parts.rates) + stride(parts.primitives + 1);
        Memory::of::<R>(self.particles(), l.state_rows(), parts, numbers * std::mem::size_of::<R>(), bars)
    }
    fn artificial_viscosity(&self) -> f64 {
        // An artificial viscosity alpha is equivalent to alpha h c / (2 (d + 2)) (Monaghan 2005, eq. 8.8).
        self.laws.further.0.as_ref().map_or(0.0, |of| {
            of.alpha * of.smoothing_length * of.sound_speed / (2.0 * (self.layout.dimension as f64 + 2.0))
        })
    }
    fn limits(&self) -> (CflLimit, f64) {
        (if self.layout.density { stability::FREE_SURFACE } else { stability::STANDARD }, 0.25)
    }
    fn advice(&self) -> &'static str {
        "time.cfl=0.5 or time.diffusion_number=0.125 (a smaller time step); where a wall is shaped, a gentler one (a smaller \
         design.amplitude or design.bound)"
    }
    fn operators(&self, list: &NeighbourList) -> Vec<Operator> {
        plan::operators(self, list)
    }
    fn fields(&self) -> Vec<Field> {
        plan::fields(self)
    }
    fn dropped(&self) -> Vec<Dropped> {
        plan::left_out(self)
    }
}
