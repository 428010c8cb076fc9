//! A step as one node of candle's graph.
//!
//! The node runs the sweeps of the step's operators ([`super::step`]) in order, and their adjoints in reverse order in
//! the backward pass, on reused buffers. If each operator were a node, as in `Tape::fields`, candle would allocate,
//! clear and add a cotangent of full size for each input, on one thread: more than a third of the gradient's time for
//! 10^6 particles. Candle chains steps and objectives; where there is only one step, [`pull_back`] needs no graph.

use super::chain::{Chain, Step};
use super::model::Standard;
use super::rates::known;
use super::step::{self, Execution};
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

impl<R: Real> At<'_, '_, R> {
    /// The operators' context with the present neighbour list.
    fn step_now(&self) -> Arc<Step<R>> {
        Arc::new(Step { model: self.model.clone(), list: self.place.neighbourhood.list.clone() })
    }
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
    mut at: At<'_, '_, R>,
    dt: f64,
    state: &Tensor,
    after: Option<&Tensor>,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(at.place.step);
    let state = state.contiguous().map_err(&failed)?;
    let step = with_numbers(&state, after, |from, after| Recording::of_step(&mut at, dt, from, after, true));
    apply1(step.map_err(&failed)??, &state).map_err(&failed)
}

/// Maps the cotangent of the state after a step to that of the state before it. The numbers are the same as by candle's
/// graph, which would clear, copy and add further tensors on one thread.
///
/// # Errors
/// As for [`advance`].
pub fn pull_back<R: Sweeps>(
    mut at: At<'_, '_, R>,
    dt: f64,
    state: &Tensor,
    after: Option<&Tensor>,
    cotangent: &Tensor,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(at.place.step);
    let step = with_numbers(state, after, |from, after| Recording::of_step(&mut at, dt, from, after, false));
    let step = step.map_err(&failed)??;
    let found = cotangent.contiguous().and_then(|bar| read(&bar, |bar| Ok(step.pull_back(state.elem_count(), bar))));
    found.and_then(|found| Tensor::from_vec(found, state.shape(), state.device())).map_err(&failed)
}

/// Calls `make` with the numbers of a state and of the state after it.
fn with_numbers<R: Sweeps, T>(
    state: &Tensor,
    after: Option<&Tensor>,
    make: impl FnOnce(&[R], Option<&[R]>) -> T,
) -> Result<T> {
    read(state, |state| match after {
        Some(after) => read(after, |after| Ok(make(state, Some(after)))),
        None => Ok(make(state, None)),
    })
}

/// Makes a step and keeps what its adjoint reads.
struct Recording<'a, 'b, 'c, R: Sweeps> {
    at: &'a mut At<'b, 'c, R>,
    from: &'a [R],
    after: Option<&'a [R]>,
    chain: Option<Arc<Chain<R>>>,
    moved: Buffer<R>,
    density: Buffer<R>,
    /// Whether the density is known from a run without a graph.
    has_density: bool,
    primitives: Buffer<R>,
    rates: Option<Buffer<R>>,
    state: Vec<R>,
    /// Whether the caller needs the resulting state.
    wants_state: bool,
}

impl<'a, 'b, 'c, R: Sweeps> Recording<'a, 'b, 'c, R> {
    fn of_step(
        at: &'a mut At<'b, 'c, R>,
        dt: f64,
        from: &'a [R],
        after: Option<&'a [R]>,
        wants_state: bool,
    ) -> std::result::Result<WholeStep<R>, RunError> {
        let (n, l) = (at.model.particles(), at.model.layout);
        let buffers = at.model.scratch.buffers.clone();
        // Rates give the next state, and the derivative with respect to masses reads them.
        let reads_rates = l.mass || (after.is_none() && wants_state);
        // The rates read the pair cache that the density pass fills.
        let finds_rates = reads_rates && after.is_none();
        let known = at.density.take().filter(|_| !finds_rates && at.place.parts == 1);
        let mut recording = Self {
            moved: buffers.buffer(l.moved_rows() * n),
            has_density: known.is_some(),
            density: known.unwrap_or_else(|| buffers.buffer(n)),
            // The adjoints read the primitives only for their evolved density.
            primitives: buffers.buffer(if l.density { l.primitive_rows() * n } else { 0 }),
            rates: reads_rates.then(|| buffers.buffer(l.rate_rows() * n)),
            state: Vec::new(),
            wants_state,
            chain: None,
            at,
            from,
            after,
        };
        step::advance(&mut recording, dt, &())?;
        let Self { moved, density, rates, state, chain, at, .. } = recording;
        let chain = chain.unwrap_or_else(|| Chain::new(at.step_now()));
        Ok(WholeStep { chain, dt, moved, density, rates, state: Mutex::new(state) })
    }

    fn step_now(&mut self) -> (Arc<Chain<R>>, Arc<Step<R>>) {
        let at = &*self.at;
        let chain = self.chain.get_or_insert_with(|| Chain::new(at.step_now())).clone();
        let step = chain.step.clone();
        (chain, step)
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

impl<R: Sweeps> Execution for Recording<'_, '_, '_, R> {
    type Field = ();

    fn drift(&mut self, dt: f64, _: &()) -> std::result::Result<(), RunError> {
        R::drift(self.at.model, dt, self.from, &mut self.moved);
        Ok(())
    }
    fn neighbours(&mut self, _: &()) -> std::result::Result<(), RunError> {
        let step = self.at.place.step;
        let updated = self.at.place.neighbourhood.update(&self.at.model.reach(), &self.moved);
        updated.map_err(|source| RunError::Neighbours { step, source })
    }
    fn density(&mut self, dt: f64, _: &()) -> std::result::Result<(), RunError> {
        let (chain, step) = self.step_now();
        let (l, n) = (step.model.layout, step.model.particles());
        match self.after {
            // The wall particles have the density of the next state here, which nothing reads.
            Some(after) if l.density => copy(&after[l.state_density() * n..][..n], &mut self.density),
            _ if self.has_density => {}
            _ => {
                clear_walls(&step, &mut self.density);
                match l.density {
                    true => R::evolution(&step, dt, &self.moved, &mut chain.kept(), &mut self.density),
                    false => R::density(&step, &self.moved, &mut chain.kept(), &mut self.density),
                }
            }
        }
        Ok(())
    }
    fn wall_condition(&mut self, _: &(), _: &()) -> std::result::Result<(), RunError> {
        let (chain, step) = self.step_now();
        let primitives = step.model.layout.density.then_some(self.primitives.as_mut_slice());
        R::primitives(&step, &self.moved, &self.density, &mut chain.kept(), primitives);
        Ok(())
    }
    fn rates(&mut self, _: &(), _: &()) -> std::result::Result<(), RunError> {
        let (chain, step) = self.step_now();
        let Some(rates) = &mut self.rates else { return Ok(()) };
        match self.after {
            Some(after) => known(&step, after, rates),
            None => {
                clear_walls(&step, rates);
                R::rates(&step, &self.moved, &chain.kept(), rates);
            }
        }
        Ok(())
    }
    fn assemble(&mut self, _: &(), _: &(), _: &()) -> std::result::Result<(), RunError> {
        let (_, step) = self.step_now();
        match (self.after, &self.rates) {
            _ if !self.wants_state => {}
            (Some(after), _) => self.state = copied(after),
            (None, Some(rates)) => {
                self.state = zeros(step.model.layout.state_rows() * step.model.particles());
                R::assemble(&step, &self.moved, &self.primitives, rates, &mut self.state);
            }
            (None, None) => {}
        }
        Ok(())
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
        R::assemble_bar(step, moved, bar, &mut moved_bar, &mut rates_bar);
        let rates = self.rates.as_ref().map_or(&[][..], |rates| &rates[..]);
        R::rates_bar(step, moved, &kept, rates, &rates_bar, &mut moved_bar, &mut primitives_bar);
        if l.density {
            let of_state = &bar[l.state_density() * n..][..n];
            primitives_bar[..n].iter_mut().zip(of_state).for_each(|(to, from)| *to += *from);
        }
        R::primitives_bar(step, &kept, &primitives_bar, &mut moved_bar, &mut density_bar);
        match l.density {
            true => R::evolution_bar(step, self.dt, moved, &self.density, &density_bar, &mut moved_bar),
            false => R::density_bar(step, moved, &self.density, &density_bar, &mut moved_bar),
        }
        let mut state_bar = zeros(count);
        R::drift_bar(model, self.dt, &moved_bar, &mut state_bar);
        state_bar
    }
}
