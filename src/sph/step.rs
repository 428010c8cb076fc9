//! One time step as a chain of operators, and the tools to write an operator as a candle custom op.
//!
//! ```text
//! state --drift--> moved --density--> rho --primitives--> (walls extrapolated) --rates--> rates
//!                    |                                                                      |
//!                    +------------------------------ advance -------------------------------+--> state
//! ```

use crate::numerics::lanes::{run_rows, Lanes, Real, RowKernel};
use crate::particles::neighbour_list::{NeighbourError, Workspace};
use crate::particles::NeighbourList;
use crate::sph::model::Model;
use crate::sph::operators::pairs::Kept;
use crate::sph::operators::{assemble, density, rates, wall_condition};
use candle_core::{CpuStorage, Layout, Result, Shape, Storage, Tensor};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

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

/// The operators of one step at one moved state, and what they keep for each other.
#[derive(Debug)]
pub struct Chain<R: Real> {
    pub step: Arc<Step<R>>,
    kept: Mutex<Kept<R>>,
    /// The state behind this step, if it is known: a replay need not compute the rates again.
    after: Option<Tensor>,
    /// Whether the cotangent of the moved state is passed on from operator to operator.
    carries: bool,
    moved_bar: Mutex<Option<Vec<R>>>,
}

impl<R: Real> Chain<R> {
    /// For one chain of operators on one moved state: what the density pass keeps belongs to its positions.
    pub fn new(step: Arc<Step<R>>) -> Arc<Self> {
        Self::with(step, None, false)
    }

    /// [`Self::new`] for operators that stand in one line, [`crate::sph::operators::density`] first. All of them read the moved state,
    /// and for each candle would allocate, clear and add up a cotangent of its full size: a fifth of a gradient step
    /// of 950 particles. Here only the density's operator has the moved state as its variable, the others get it
    /// detached and add their shares to one cotangent, which that first (in the backward pass: last) one returns.
    pub fn carrying(step: Arc<Step<R>>, after: Option<Tensor>) -> Arc<Self> {
        Self::with(step, after, true)
    }

    /// The state behind this step `[F, N]`, if it is known.
    pub fn after(&self) -> Option<&Tensor> {
        self.after.as_ref()
    }

    fn with(step: Arc<Step<R>>, after: Option<Tensor>, carries: bool) -> Arc<Self> {
        let kept = Mutex::new(step.model.scratch.take_kept());
        Arc::new(Self { step, kept, after, carries, moved_bar: Mutex::new(None) })
    }

    /// The cotangent of the moved state so far: what operators behind this one have added, else zero.
    pub fn moved_bar(&self) -> Vec<R> {
        let so_far = self.moved_bar.lock().unwrap_or_else(|e| e.into_inner()).take();
        so_far.unwrap_or_else(|| {
            let model = &*self.step.model;
            vec![R::default(); model.layout.moved_rows() * model.particles()]
        })
    }

    /// That cotangent with an operator's share: passed on, or returned to candle.
    pub fn pass_on(&self, moved_bar: Vec<R>) -> Result<Option<Tensor>> {
        if self.carries {
            *self.moved_bar.lock().unwrap_or_else(|e| e.into_inner()) = Some(moved_bar);
            return Ok(None);
        }
        let model = &*self.step.model;
        tensor(moved_bar, model.layout.moved_rows(), model.particles()).map(Some)
    }

    pub fn kept(&self) -> MutexGuard<'_, Kept<R>> {
        self.kept.lock().unwrap_or_else(|e| e.into_inner())
    }
}

impl<R: Real> Drop for Chain<R> {
    fn drop(&mut self) {
        let kept = std::mem::take(self.kept.get_mut().unwrap_or_else(|e| e.into_inner()));
        self.step.model.scratch.give_back_kept(kept);
    }
}

impl<R: Real> Step<R> {
    /// Advances a moved state `[M, N]` to the state `[F, N]` at the step's end: the fused operators, chained by candle.
    /// `after`: that state, if it is known from a run without a graph, of which nothing need be computed then that the
    /// adjoint does not read.
    pub fn fused(self: &Arc<Self>, moved: &Tensor, after: Option<&Tensor>) -> Result<Tensor> {
        let chain = Chain::carrying(self.clone(), after.map(Tensor::detach));
        let density = moved.apply_op1(density::Density(chain.clone()))?;
        let moved = moved.detach();
        let primitives = moved.apply_op2(&density, wall_condition::Primitives(chain.clone()))?;
        let rates = moved.apply_op2(&primitives, rates::Rates(chain.clone()))?;
        moved.apply_op2(&rates, assemble::Advance(chain))
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
        let mut new = Self { list: Arc::new(list), ..Self::empty() };
        new.rebuild(model, position)?;
        Ok(new)
    }

    /// A list that [`Self::rebuild_at`] has still to build.
    pub fn empty() -> Self {
        let list = Arc::new(NeighbourList::default());
        Self { list, reference: Arc::new(Vec::new()), workspace: Workspace::default() }
    }

    /// Builds the list of another run's or an earlier reference, in the old list's memory unless somebody else still
    /// holds it.
    pub fn rebuild_at(&mut self, model: &Model<R>, reference: &Arc<Vec<R>>) -> std::result::Result<(), NeighbourError> {
        // The same place in memory: states of one list are known by it.
        self.reference = reference.clone();
        self.rebuild_list(model)
    }

    /// Builds the list anew, likewise.
    fn rebuild(&mut self, model: &Model<R>, position: &[R]) -> std::result::Result<(), NeighbourError> {
        let position = &position[..model.layout.dimension * model.particles()];
        match Arc::get_mut(&mut self.reference) {
            Some(reference) => {
                reference.clear();
                reference.extend_from_slice(position);
            }
            None => self.reference = Arc::new(position.to_vec()),
        }
        self.rebuild_list(model)
    }

    fn rebuild_list(&mut self, model: &Model<R>) -> std::result::Result<(), NeighbourError> {
        if Arc::get_mut(&mut self.list).is_none() {
            let list = NeighbourList { capacity: self.list.capacity, ..NeighbourList::default() };
            self.list = Arc::new(list);
        }
        let list = Arc::get_mut(&mut self.list).expect("just made, or nobody else's");
        R::rebuild(list, &self.reference, &model.tags, &model.domain, model.reach(), &mut self.workspace)
    }

    /// Rebuilds the list if somebody has moved half the skin since it was built. Whether it does depends on the
    /// positions and the reference only, so a replay does the same.
    pub fn update(&mut self, model: &Model<R>, position: &[R]) -> std::result::Result<(), NeighbourError> {
        let moved = R::largest_move(model, position, &self.reference)?;
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
    let largest = LargestMove { model, position, reference, square: AtomicU64::new(0), lost: AtomicBool::new(false) };
    run_rows(&largest, model.particles());
    if largest.lost.into_inner() {
        let n = model.particles();
        for i in 0..n {
            for d in 0..model.domain.dimension {
                let value = position[d * n + i].f64();
                if !value.is_finite() || value.abs() > 1e10 {
                    return Err(NeighbourError::LostParticle { particle: i, component: d, value });
                }
            }
        }
        return Ok(f64::INFINITY);
    }
    Ok(f64::from_bits(largest.square.into_inner()).sqrt())
}

struct LargestMove<'a, R> {
    model: &'a Model<R>,
    position: &'a [R],
    reference: &'a [R],
    /// Bits of the largest squared distance: those of numbers that are not negative compare like the numbers.
    square: AtomicU64,
    lost: AtomicBool,
}

impl<R: Real> RowKernel<R> for LargestMove<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (n, domain) = (self.model.particles(), &self.model.domain);
        let inverse = domain.inverse_period();
        let (mut most, mut sum) = (L::zero(), L::zero());
        for from in rows.clone().step_by(L::COUNT) {
            let mut r2 = L::zero();
            for d in 0..domain.dimension {
                let part = |values: &[R]| L::load_part(&values[d * n + from..d * n + rows.end.min(from + L::COUNT)]);
                let raw = part(self.position) - part(self.reference);
                let size = L::splat(R::of(domain.size[d]));
                let dr = raw - size * (raw * L::splat(R::of(inverse[d]))).round();
                r2 = dr.mul_add(dr, r2);
            }
            sum += r2;
            most = r2.select_less(most, most, r2);
        }
        // A sum is not a number, or huge, if one of its terms is.
        let sane = sum.sum() < R::of(1e30);
        if !sane {
            self.lost.store(true, Ordering::Relaxed);
        }
        self.square.fetch_max(most.largest().f64().to_bits(), Ordering::Relaxed);
    }
}
