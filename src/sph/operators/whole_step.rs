//! A step as one node of candle's graph.
//!
//! The sweeps of the step's operators ([`crate::sph::step`]) one after the other, and in the backward pass their adjoints in
//! the opposite order, on buffers that come back. Were each operator a node of its own, as they are in
//! [`TensorSolver::look`], candle would allocate, clear and add up a cotangent of full size for each of their inputs, on one
//! thread: more than a third of the gradient of 10^6 particles. Steps and objectives are chained by candle.

use crate::adjoint::RunError;
use crate::numerics::candle::{apply1, read, Operator};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{clear, copied, zeros};
use crate::sph::chain::{Chain, Step};
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
    let mut step = Err(RunError::Tensor { step: run.step, source: candle_core::Error::Msg("no state".into()) });
    read(&state, |from: &[R]| match after {
        Some(after) => read(after, |after: &[R]| {
            step = Recording::of_step(run, dt, from, Some(after));
            Ok(())
        }),
        None => {
            step = Recording::of_step(run, dt, from, None);
            Ok(())
        }
    })
    .map_err(&failed)?;
    apply1(step?, &state).map_err(&failed)
}

/// Makes a step and keeps what its adjoint reads.
struct Recording<'a, R: Sweeps> {
    run: &'a mut TensorSolver<R>,
    from: &'a [R],
    after: Option<&'a [R]>,
    chain: Option<Arc<Chain<R>>>,
    moved: Buffer<R>,
    density: Buffer<R>,
    primitives: Buffer<R>,
    rates: Option<Buffer<R>>,
    state: Vec<R>,
}

impl<'a, R: Sweeps> Recording<'a, R> {
    fn of_step(
        run: &'a mut TensorSolver<R>,
        dt: f64,
        from: &'a [R],
        after: Option<&'a [R]>,
    ) -> std::result::Result<WholeStep<R>, RunError> {
        let (n, l) = (run.model.particles(), run.model.layout);
        let buffers = run.model.scratch.buffers.clone();
        // Of rates that are known only those by the mass are asked for.
        let reads_rates = after.is_none() || l.mass;
        let mut recording = Self {
            moved: buffers.buffer(l.moved_rows() * n),
            density: buffers.buffer(n),
            // Only an evolved density is read behind the walls' values.
            primitives: buffers.buffer(if l.density { l.primitive_rows() * n } else { 0 }),
            rates: reads_rates.then(|| buffers.buffer(l.rate_rows() * n)),
            state: Vec::new(),
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
        clear_walls(&step, &mut self.density);
        match step.model.layout.density {
            true => R::evolution(&step, dt, &self.moved, &mut chain.kept(), true, &mut self.density),
            false => R::density(&step, &self.moved, &mut chain.kept(), true, &mut self.density),
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
        let step = &*self.chain.step;
        let (model, l, n) = (&*step.model, step.model.layout, step.model.particles());
        let buffers = &model.scratch.buffers;
        let (mut moved_bar, mut rates_bar) = (buffers.buffer(l.moved_rows() * n), buffers.buffer(l.rate_rows() * n));
        let (mut primitives_bar, mut density_bar) = (buffers.buffer(l.primitive_rows() * n), buffers.buffer(n));
        for bar in [&mut moved_bar, &mut primitives_bar, &mut density_bar] {
            clear(bar);
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
            true => R::evolution_bar(step, self.dt, moved, &kept, &self.density, &density_bar, &mut moved_bar),
            false => R::density_bar(step, moved, &kept, &self.density, &density_bar, &mut moved_bar),
        }
        let mut state_bar = zeros(state.len());
        R::drift_bar(model, self.dt, &moved_bar, &mut state_bar);
        Ok([Some(state_bar)])
    }
}
