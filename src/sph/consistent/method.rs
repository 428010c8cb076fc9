//! Implements the interface [`crate::sph::method::Method`] for the consistent method.

use super::arrangement::Shift;
use super::blocks::width;
use super::kinds::{rows, KINDS};
use super::model::Consistent;
use super::plan;
use super::stencil::{monomials, packed};
use super::sweeps::Sweeps;
use super::worker::{Run, Tape};
use crate::config::scene::Kernels;
use crate::config::stability::{self, CflLimit};
use crate::particles::NeighbourList;
use crate::sph::flow::Flow;
use crate::sph::inventory::Operator;
use crate::sph::method::{Memory, Method, Model, Parts, Recorder, Sharing, Worker};
use crate::sph::pairs::stride;
use crate::sph::part::Part;
use std::sync::Arc;

impl<R: Sweeps> Method<R> for Consistent<R> {
    fn name(&self) -> &'static str {
        "consistent"
    }
    fn flow(&self) -> &Flow<R> {
        &self.flow
    }
    fn with_flow(&self, flow: Flow<R>) -> Model<R> {
        Model::new(Self { flow, ..self.clone() })
    }
    fn worker(self: Arc<Self>) -> Box<dyn Worker<R>> {
        Box::new(Run::new(self))
    }
    fn recorder(self: Arc<Self>, kernels: Kernels) -> Box<dyn Recorder<R>> {
        Box::new(Tape::new(self, kernels))
    }
    fn of(&self, some: &[u32], part: Arc<Part>) -> Option<Model<R>> {
        Some(Model::new(Self::new(self.flow.of(some, part), self.layout, self.fits.of(some))))
    }
    fn sharing(&self) -> Option<Sharing> {
        // Dummy particles have the values of fluid around the point of the surface that they belong to. Rows of a chain run along x: each
        // rank has a part of every one.
        let only = matches!(self.fits.shift, Shift::Chain(_)).then_some(0);
        Some(Sharing { reaches: if self.has_walls() { 2 } else { 1 }, only })
    }
    fn has_wall_values(&self) -> bool {
        false
    }
    fn knows_velocity(&self, i: usize) -> bool {
        self.is_fluid(i) || (self.tags[i] == crate::particles::tag::SURFACE && !self.holds_no_velocity(i))
    }
    fn counted_density(&self) -> Option<f64> {
        Some(self.equation_of_state.reference_density)
    }
    fn wall_temperature(&self, state: &[R]) -> f64 {
        let n = self.particles();
        let known = (0..n).filter(|&i| !self.is_fluid(i) && !self.holds_no_temperature(i));
        known.map(|i| state[self.layout.temperature() * n + i].f64().abs()).fold(0.0, f64::max)
    }
    fn memory(&self, list: &NeighbourList) -> Memory {
        let (l, n, size) = (self.layout, self.particles(), std::mem::size_of::<R>());
        let (d, heat, fits) = (l.dimension, l.heat as usize, monomials(l.dimension));
        // What an objective looks at is about as much as in the standard method.
        let parts = Parts { moved: 2 * d + 2 * heat, primitives: 1 + d + heat, rates: d + heat };
        let kept = ((4 + stride(2 * d + 2 + 2 * heat)) * n + list.index.len()) * size;
        let bars = stride(parts.rates) + stride(parts.primitives + 1);
        let memory = Memory::of::<R>(n, l.state_rows(), parts, kept, bars);
        // For all particles: the known state, twice the new pressure, the next state, and records. For the fluid: the
        // derivatives of all fields and of the pressure, factorised matrices, W and F of pairs. For the surface: fits.
        let all = 2 * l.state_rows() + 2 + stride(d + l.fields()) + stride(d + 1);
        let fluid = rows(d, l.fields()) + rows(d, 1) + KINDS * packed(fits) + 2 * room(list, true);
        let surface = packed(d + 1) + (l.fields() - d + 1) * (d + 1);
        let width = width::<R>();
        let numbers = list.fluid_rows.len().next_multiple_of(width) * fluid
            + self.fits.surface.len().next_multiple_of(width) * surface;
        let tape = (all * n + numbers) * size;
        let near = list.wall_rows.iter().map(|&i| list.fluid_count[i as usize]).max().unwrap_or(0);
        let walls = (self.fits.surface.len() + list.wall_rows.len()) * near.next_multiple_of(4) as usize;
        let tables = walls + list.fluid_rows.len() * (room(list, true) + room(list, false));
        // A run without a graph has the same in its buffers.
        Memory { tape, run: tape, tables: tables * std::mem::size_of::<u32>(), look: memory.look + tape, ..memory }
    }
    fn limits(&self) -> (CflLimit, f64) {
        match self.layout.rates {
            true => (stability::VERLET, 0.125),
            false => (stability::SYMPLECTIC_EULER, 0.25),
        }
    }
    fn advice(&self) -> &'static str {
        match (&self.fits.shift, self.layout.rates) {
            // Over a rough wall smaller steps do not help, but more neighbours do (src/sph/README.md has the figures).
            (Shift::Chain(_), _) => {
                "method.name=fixed or resolution.smoothing_length=1.1 (over a rough wall), time.cfl=0.5 (over a flat one), or a \
                 gentler wall (a smaller design.amplitude or design.bound)"
            }
            // A disordered start beside walls: src/validation/README.md has the figures.
            (_, true) => "resolution.smoothing_length=0.9 (more neighbours), a smaller time.jitter, or time.cfl=0.5",
            (_, false) => {
                "time.cfl=0.5 or time.diffusion_number=0.125 (a smaller time step), or a gentler wall, where one is shaped (a \
                 smaller design.amplitude or design.bound)"
            }
        }
    }
    fn operators(&self, list: &NeighbourList) -> Vec<Operator> {
        plan::operators(self, list)
    }
}

/// The largest number of fluid or wall neighbours of a fluid particle, rounded up to the capacity of the tables.
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
