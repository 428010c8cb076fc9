//! One time step as a chain of operators, and the tools to write an operator as a candle custom op.
//!
//! ```text
//! state --drift--> moved --density--> rho --primitives--> (walls extrapolated) --rates--> rates
//!                    |                                                                      |
//!                    +------------------------------ advance -------------------------------+--> state
//! ```

use super::{advance, density, primitives, rates};
use crate::lanes::Real;
use crate::neighbours::list::{NeighbourError, Workspace};
use crate::neighbours::NeighbourList;
use crate::sph::model::Model;
use candle_core::{CpuStorage, Layout, Result, Shape, Storage, Tensor};
use std::sync::Arc;

/// What an operator knows besides its tensors: the scene's constants and the list of this step.
#[derive(Debug, Clone)]
pub struct Step<R> {
    pub model: Arc<Model<R>>,
    pub list: Arc<NeighbourList>,
}

/// An operator's input, as plain numbers.
pub fn input<'a, R: Real>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [R]> {
    let slice = R::cpu_storage_as_slice(storage)?;
    match layout.contiguous_offsets() {
        Some((from, to)) => Ok(&slice[from..to]),
        None => candle_core::bail!("an SPH operator needs contiguous tensors"),
    }
}

/// An operator's output.
pub fn output<R: Real>(values: Vec<R>, shape: impl Into<Shape>) -> (CpuStorage, Shape) {
    (R::to_cpu_storage_owned(values), shape.into())
}

/// Reads a tensor's numbers in place.
pub fn read<R: Real, T>(tensor: &Tensor, f: impl FnOnce(&[R]) -> Result<T>) -> Result<T> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(cpu) => f(input::<R>(cpu, layout)?),
        _ => candle_core::bail!("the fused SPH operators run on the CPU; use --kernels composed elsewhere"),
    }
}

/// A new tensor `[rows, n]` from numbers, on the CPU.
pub fn tensor<R: Real>(values: Vec<R>, rows: usize, n: usize) -> Result<Tensor> {
    Tensor::from_vec(values, (rows, n), &candle_core::Device::Cpu)
}

impl<R: Real> Step<R> {
    /// Advances a state `[F, N]` by one step: the fused operators, chained by candle.
    pub fn fused(self: &Arc<Self>, moved: &Tensor) -> Result<Tensor> {
        let density = moved.apply_op1(density::Density(self.clone()))?;
        let primitives = moved.apply_op2(&density, primitives::Primitives(self.clone()))?;
        let rates = moved.apply_op2(&primitives, rates::Rates(self.clone()))?;
        moved.apply_op2(&rates, advance::Advance(self.clone()))
    }
}

/// The neighbour list of a run and the positions it was built from.
#[derive(Debug, Clone)]
pub struct Neighbourhood<R> {
    pub list: Arc<NeighbourList>,
    /// `[D, N]`.
    pub reference: Arc<Vec<R>>,
    workspace: Workspace<R>,
}

impl<R: Real> Neighbourhood<R> {
    /// Builds the list from positions `[D.., N]` (the leading rows of a state will do).
    pub fn build(model: &Model<R>, position: &[R], capacity_hint: usize) -> std::result::Result<Self, NeighbourError> {
        let list = NeighbourList { capacity: capacity_hint, ..NeighbourList::default() };
        let mut new = Self { list: Arc::new(list), reference: Arc::new(Vec::new()), workspace: Workspace::default() };
        new.rebuild(model, position)?;
        Ok(new)
    }

    /// Builds the list anew, in the old one's memory unless somebody else still holds it.
    fn rebuild(&mut self, model: &Model<R>, position: &[R]) -> std::result::Result<(), NeighbourError> {
        let position = &position[..model.layout.dimension * model.particles()];
        match Arc::get_mut(&mut self.reference) {
            Some(reference) => {
                reference.clear();
                reference.extend_from_slice(position);
            }
            None => self.reference = Arc::new(position.to_vec()),
        }
        if Arc::get_mut(&mut self.list).is_none() {
            let list = NeighbourList { capacity: self.list.capacity, ..NeighbourList::default() };
            self.list = Arc::new(list);
        }
        let list = Arc::get_mut(&mut self.list).expect("just made, or nobody else's");
        list.rebuild(&self.reference, &model.tags, &model.domain, model.reach(), &mut self.workspace)
    }

    /// Rebuilds the list if somebody has moved half the skin since it was built. Whether it does depends on the
    /// positions and the reference only, so a replay does the same.
    pub fn update(&mut self, model: &Model<R>, position: &[R]) -> std::result::Result<(), NeighbourError> {
        let moved = largest_move(model, position, &self.reference)?;
        // One step never moves a particle that far unless the run has diverged.
        if moved > 0.5 * model.kernel.cutoff() {
            return Err(NeighbourError::TooFast { distance: moved, spacing: model.kernel.smoothing_length });
        }
        if 2.0 * moved >= model.skin {
            self.rebuild(model, position)?;
        }
        Ok(())
    }
}

/// Distance that the fastest particle has moved since the list was built; an error if a position is not a number.
pub fn largest_move<R: Real>(
    model: &Model<R>,
    position: &[R],
    reference: &[R],
) -> std::result::Result<f64, NeighbourError> {
    let n = model.particles();
    let dimension = model.domain.dimension;
    let size = model.domain.size.map(R::of);
    let inverse = model.domain.inverse_period().map(R::of);
    let half = R::of(0.5);
    let mut most = R::default();
    let mut sane = true;
    for i in 0..n {
        let mut d2 = R::default();
        for d in 0..dimension {
            let mut dr = position[d * n + i] - reference[d * n + i];
            dr -= size[d] * (dr * inverse[d] + half).floor();
            d2 += dr * dr;
        }
        sane &= d2 < R::of(1e30);
        most = if d2 > most { d2 } else { most };
    }
    if !sane {
        for i in 0..n {
            for d in 0..dimension {
                let value = position[d * n + i].f64();
                if !value.is_finite() || value.abs() > 1e10 {
                    return Err(NeighbourError::LostParticle { particle: i, component: d, value });
                }
            }
        }
    }
    Ok(most.f64().sqrt())
}
