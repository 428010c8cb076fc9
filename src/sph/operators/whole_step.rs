//! A step as one node of candle's graph.
//!
//! The sweeps of the step's operators ([`crate::sph::step`]) one after the other, and in the backward pass their adjoints in
//! the opposite order, on buffers that come back. Were each operator a node of its own, as they are in
//! [`TensorSolver::look`], candle would allocate, clear and add up a cotangent of full size for each of their inputs, on one
//! thread: more than a third of the gradient of 10^6 particles. Steps and objectives are chained by candle; where there is but one step,
//! [`pull_back`] does without.

use crate::adjoint::RunError;
use crate::numerics::candle::{apply1, read, Operator};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{clear, copied, copy, zeros};
use crate::sph::chain::{Chain, Step};
use crate::sph::operators::pairs;
use crate::sph::operators::rates::known;
use crate::sph::solver::TensorSolver;
use crate::sph::step::{self, Execution};
use crate::sph::sweeps::Sweeps;
use candle_core::{Result, Shape, Tensor};
use std::sync::{Arc, Mutex};

/// state `[F, N]` -> state `[F, N]`.
struct WholeStep<R: Sweeps> {
    chain: Arc<Chain<R>>,
    dt: f64,
    /// What the adjoints read of the fields on the way.
    moved: Buffer<R>,
    density: Buffer<R>,
    rates: Option<Buffer<R>>,
    /// What comes out, until candle has taken it.
    state: Mutex<Vec<R>>,
}

/// One step of a run on candle's graph; `after` is the state that it leads to, if that is known.
///
/// # Errors
/// Particles that are lost or too fast; tensor errors.
pub fn advance<R: Sweeps>(
    run: &mut TensorSolver<R>,
    dt: f64,
    state: &Tensor,
    after: Option<&Tensor>,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(run.step);
    let state = state.contiguous().map_err(&failed)?;
    let step = with_numbers(&state, after, |from, after| Recording::of_step(run, dt, from, after, true));
    apply1(step.map_err(&failed)??, &state).map_err(&failed)
}

/// The cotangent of a state from that of the one that a step from it leads to. The same numbers as by way of candle's graph, which for
/// a step alone would clear, copy and add up some tensors more, on one thread.
///
/// # Errors
/// As for [`advance`].
pub fn pull_back<R: Sweeps>(
    run: &mut TensorSolver<R>,
    dt: f64,
    state: &Tensor,
    after: Option<&Tensor>,
    cotangent: &Tensor,
) -> std::result::Result<Tensor, RunError> {
    let failed = RunError::tensor(run.step);
    let step = with_numbers(state, after, |from, after| Recording::of_step(run, dt, from, after, false));
    let step = step.map_err(&failed)??;
    let found = cotangent.contiguous().and_then(|bar| read(&bar, |bar| Ok(step.pull_back(state.elem_count(), bar))));
    found.and_then(|found| Tensor::from_vec(found, state.shape(), state.device())).map_err(&failed)
}

/// What becomes of the numbers of a state and of the one behind it.
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
struct Recording<'a, R: Sweeps> {
    run: &'a mut TensorSolver<R>,
    from: &'a [R],
    after: Option<&'a [R]>,
    chain: Option<Arc<Chain<R>>>,
    moved: Buffer<R>,
    density: Buffer<R>,
    /// Whether the density is known from the run without a graph.
    has_density: bool,
    primitives: Buffer<R>,
    rates: Option<Buffer<R>>,
    state: Vec<R>,
    /// Whether somebody asks for the state that the step leads to.
    wants_state: bool,
}

impl<'a, R: Sweeps> Recording<'a, R> {
    fn of_step(
        run: &'a mut TensorSolver<R>,
        dt: f64,
        from: &'a [R],
        after: Option<&'a [R]>,
        wants_state: bool,
    ) -> std::result::Result<WholeStep<R>, RunError> {
        let (n, l) = (run.model.particles(), run.model.layout);
        let buffers = run.model.scratch.buffers.clone();
        // Rates lead to the next state, and the derivative by masses reads them.
        let reads_rates = l.mass || (after.is_none() && wants_state);
        // They read what the density pass keeps of pairs.
        let finds_rates = reads_rates && after.is_none();
        let known = run.density.take().filter(|_| !finds_rates && run.pace.parts == 1);
        let mut recording = Self {
            moved: buffers.buffer(l.moved_rows() * n),
            has_density: known.is_some(),
            density: known.unwrap_or_else(|| buffers.buffer(n)),
            // Only an evolved density is read behind the walls' values.
            primitives: buffers.buffer(if l.density { l.primitive_rows() * n } else { 0 }),
            rates: reads_rates.then(|| buffers.buffer(l.rate_rows() * n)),
            state: Vec::new(),
            wants_state,
            chain: None,
            run,
            from,
            after,
        };
        step::advance(&mut recording, dt, &())?;
        let Self { moved, density, rates, state, chain, run, .. } = recording;
        let chain = chain.unwrap_or_else(|| Chain::new(run.step_now()));
        Ok(WholeStep { chain, dt, moved, density, rates, state: Mutex::new(state) })
    }

    fn step_now(&mut self) -> (Arc<Chain<R>>, Arc<Step<R>>) {
        let run = &*self.run;
        let chain = self.chain.get_or_insert_with(|| Chain::new(run.step_now())).clone();
        let step = chain.step.clone();
        (chain, step)
    }
}

/// Zeroes the walls' numbers in some rows.
fn clear_walls<R: Sweeps>(step: &Step<R>, rows: &mut [R]) {
    let n = step.model.particles();
    if step.list.fluid_rows.len() < n {
        for row in rows.chunks_mut(n) {
            let walls = row.iter_mut().enumerate().filter(|(i, _)| !step.model.is_fluid(*i));
            walls.for_each(|(_, number)| *number = R::default());
        }
    }
}

impl<R: Sweeps> Execution for Recording<'_, R> {
    type Field = ();

    fn drift(&mut self, dt: f64, _: &()) -> std::result::Result<(), RunError> {
        R::drift(&self.run.model, dt, self.from, &mut self.moved);
        Ok(())
    }
    fn neighbours(&mut self, _: &()) -> std::result::Result<(), RunError> {
        let step = self.run.step;
        let updated = self.run.neighbourhood.update(&self.run.model.reach(), &self.moved);
        updated.map_err(|source| RunError::Neighbours { step, source })
    }
    fn density(&mut self, dt: f64, _: &()) -> std::result::Result<(), RunError> {
        let (chain, step) = self.step_now();
        let (l, n) = (step.model.layout, step.model.particles());
        match self.after {
            // (Of walls it is the next state's, which nobody reads.)
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
    /// The cotangent of the state, of so many numbers, from that of the state that the step leads to.
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
