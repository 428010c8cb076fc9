//! A step as one node of candle's graph.
//!
//! The node runs the sweeps of the step's operators ([`super`]) in order, and their adjoints in reverse order in
//! the backward pass, on reused buffers. If each operator were a node, as in `Tape::fields`, candle would allocate,
//! clear and add a cotangent of full size for each input, on one thread: more than a third of the gradient's time for
//! 10^6 particles. Candle chains steps and objectives; where there is only one step, [`pull_back`] needs no graph.

use super::chain::{Chain, Step};
use super::model::Standard;
use super::rates::known as known_rates;
use super::sweeps::Sweeps;
use crate::adjoint::RunError;
use crate::numerics::candle::{apply1, read, Operator};
use crate::numerics::lanes::Real;
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{clear, copied, copy, zeros};
use crate::sph::method::Place;
use crate::sph::pairs;
use candle_core::{Result, Shape, Tensor};
use std::sync::{Arc, Mutex};

/// Where a step is made, and which of its results are already known.
pub struct At<'a, 'b, R: Real> {
    pub model: &'a Arc<Standard<R>>,
    pub place: &'a mut Place<'b, R>,
    /// Densities of this step that a run without a graph has computed.
    pub density: Option<Buffer<R>>,
}

/// The node of a step: state `[F, N]` -> state `[F, N]`.
struct WholeStep<R: Sweeps> {
    chain: Arc<Chain<R>>,
    dt: f64,
    /// The intermediate fields that the adjoints read.
    moved: Buffer<R>,
    density: Buffer<R>,
    rates: Option<Buffer<R>>,
    /// The resulting state, until candle has taken it.
    state: Mutex<Vec<R>>,
}

/// Makes one step on candle's graph; `after` is the resulting state, if it is known.
///
/// # Errors
/// Particles that are lost or too fast; tensor errors.
pub fn advance<R: Sweeps>(
    at: At<'_, '_, R>,
    state: &Tensor,
    after: Option<&Tensor>,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(at.place.step);
    let state = state.contiguous().map_err(&failed)?;
    apply1(WholeStep::of(at, &state, after, true)?, &state).map_err(&failed)
}

/// Maps the cotangent of the state after a step to that of the state before it. The numbers are the same as by candle's
/// graph, which would clear, copy and add further tensors on one thread.
///
/// # Errors
/// As for [`advance`].
pub fn pull_back<R: Sweeps>(
    at: At<'_, '_, R>,
    state: &Tensor,
    after: Option<&Tensor>,
    cotangent: &Tensor,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(at.place.step);
    let step = WholeStep::of(at, state, after, false)?;
    let found = cotangent.contiguous().and_then(|bar| read(&bar, |bar| Ok(step.pull_back(state.elem_count(), bar))));
    found.and_then(|found| Tensor::from_vec(found, state.shape(), state.device())).map_err(&failed)
}

impl<R: Sweeps> WholeStep<R> {
    /// [`Self::make`] from tensors.
    fn of(
        at: At<'_, '_, R>,
        state: &Tensor,
        after: Option<&Tensor>,
        wants_state: bool,
    ) -> std::result::Result<Self, RunError> {
        let failed = RunError::tensor(at.place.step);
        let made = read(state, |state| match after {
            Some(after) => read(after, |after| Ok(Self::make(at, state, Some(after), wants_state))),
            None => Ok(Self::make(at, state, None, wants_state)),
        });
        made.map_err(&failed)?
    }

    /// Makes a step and keeps what its adjoint reads. `after` is the resulting state, if it is known; `wants_state` says
    /// whether the caller needs it.
    fn make(
        At { model, place, density }: At<'_, '_, R>,
        state: &[R],
        after: Option<&[R]>,
        wants_state: bool,
    ) -> std::result::Result<Self, RunError> {
        let (n, l, dt, buffers) = (model.particles(), model.layout, place.times.now, &model.scratch.buffers);
        let mut moved = buffers.buffer(l.moved_rows() * n);
        R::drift(model, dt, state, &mut moved);
        place.update(model, &moved)?;
        let step = Step::now(model, place);
        let chain = Chain::new(step.clone());
        let mut kept = chain.kept();
        // Rates give the next state, and the derivative with respect to masses reads them.
        let reads_rates = l.mass || (after.is_none() && wants_state);
        // The rates read the pair cache that the density pass fills.
        let finds_rates = reads_rates && after.is_none();
        let known = density.filter(|_| !finds_rates && place.parts == 1);
        let has_density = known.is_some();
        let mut density = known.unwrap_or_else(|| buffers.buffer(n));
        match after {
            // The wall particles have the density of the next state here, which nothing reads.
            Some(after) if l.density => copy(&after[l.state_density() * n..][..n], &mut density),
            _ if has_density => {}
            _ => {
                clear_walls(&step, &mut density);
                match l.density {
                    true => R::evolution(&step, dt, &moved, &mut kept, &mut density),
                    false => R::density(&step, &moved, &mut kept, &mut density),
                }
            }
        }
        // The adjoints read the primitives only for their evolved density.
        let mut primitives = buffers.buffer(if l.density { l.primitive_rows() * n } else { 0 });
        R::primitives(&step, &moved, &density, &mut kept, l.density.then_some(primitives.as_mut_slice()));
        let mut rates = reads_rates.then(|| buffers.buffer(l.rate_rows() * n));
        match (&mut rates, after) {
            (Some(rates), Some(after)) => known_rates(&step, after, rates),
            (Some(rates), None) => {
                clear_walls(&step, rates);
                R::rates(&step, &moved, &kept, rates);
            }
            (None, _) => {}
        }
        let mut state = Vec::new();
        match (after, &rates) {
            (Some(after), _) if wants_state => state = copied(after),
            (None, Some(rates)) if wants_state => {
                state = zeros(l.state_rows() * n);
                R::assemble(&step, &moved, &primitives, rates, &mut state);
            }
            _ => {}
        }
        drop(kept);
        Ok(Self { chain, dt, moved, density, rates, state: Mutex::new(state) })
    }
}

/// Sets the values of wall particles to 0 in some rows.
fn clear_walls<R: Sweeps>(step: &Step<R>, rows: &mut [R]) {
    let n = step.model.particles();
    if step.list.fluid_rows.len() < n {
        for row in rows.chunks_mut(n) {
            let walls = row.iter_mut().enumerate().filter(|(i, _)| !step.model.is_fluid(*i));
            walls.for_each(|(_, number)| *number = R::default());
        }
    }
}

impl<R: Sweeps> Operator<1> for WholeStep<R> {
    type Real = R;
    const NAME: &'static str = "step";

    fn forward(&self, _: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let state = std::mem::take(&mut *self.state.lock().unwrap_or_else(|broken| broken.into_inner()));
        Ok((state, shape.clone()))
    }

    fn adjoint(&self, [state]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        Ok([Some(self.pull_back(state.len(), bar))])
    }
}

impl<R: Sweeps> WholeStep<R> {
    /// Maps the cotangent `bar` of the resulting state to that of the initial state, which has `count` numbers.
    fn pull_back(&self, count: usize, bar: &[R]) -> Vec<R> {
        let step = &*self.chain.step;
        let (model, l, n) = (&*step.model, step.model.layout, step.model.particles());
        let buffers = &model.scratch.buffers;
        let (mut moved_bar, mut rates_bar) = (buffers.buffer(l.moved_rows() * n), buffers.buffer(l.rate_rows() * n));
        let (mut primitives_bar, mut density_bar) = (buffers.buffer(l.primitive_rows() * n), buffers.buffer(n));
        clear(&mut density_bar);
        if pairs::all_rows(&step.list) < n {
            clear(&mut primitives_bar);
        }
        let (moved, kept) = (&self.moved[..], self.chain.kept());
        // Sums over neighbours read the cotangents of copies, too.
        let known = model.part.is_some().then(|| {
            let mut known = copied(bar);
            model.refresh(&mut known);
            known
        });
        let bar = known.as_deref().unwrap_or(bar);
        R::assemble_bar(step, moved, bar, &mut moved_bar, &mut rates_bar);
        let rates = self.rates.as_ref().map_or(&[][..], |rates| &rates[..]);
        R::rates_bar(step, moved, &kept, rates, &rates_bar, &mut moved_bar, &mut primitives_bar);
        if l.density {
            let of_state = &bar[l.state_density() * n..][..n];
            primitives_bar[..n].iter_mut().zip(of_state).for_each(|(to, from)| *to += *from);
        }
        model.refresh(&mut primitives_bar);
        R::primitives_bar(step, &kept, &primitives_bar, &mut moved_bar, &mut density_bar);
        model.refresh(&mut density_bar);
        match l.density {
            true => R::evolution_bar(step, self.dt, moved, &self.density, &density_bar, &mut moved_bar),
            false => R::density_bar(step, moved, &self.density, &density_bar, &mut moved_bar),
        }
        let mut state_bar = zeros(count);
        R::drift_bar(model, self.dt, &moved_bar, &mut state_bar);
        state_bar
    }
}
