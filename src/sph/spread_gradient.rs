//! The gradient of a flow over several ranks: [`Dynamics`] whose states are shared out as in [`super::spread`].
//!
//! Every rank runs the same schedule on its particles, and keeps its part of the states. Steps on the graph are those of
//! [`TensorSolver`]. A cotangent is right for a rank's own particles, and 0 for copies:
//!
//! * Adjoints of sums over neighbours are sums over neighbours, too. Before one reads a cotangent of copies, these get what their owners
//!   have found ([`Part::refresh`](super::part::Part::refresh)). Where a particle gives something to another one without a sum there,
//!   the owner gets it back ([`give_back`](super::part::Part::give_back)).
//! * Where particles were handed over in a step, their cotangents go back to the ranks that they came from.
//! * Objectives see the whole flow (`Whole`) on every rank, whose cotangent is taken by the owners.

use super::dynamics::Sph;
use super::method::Sharing;
use super::solver::{Snapshot, TensorSolver};
use super::spread::{is_used_up, Seat, Share, Terms};
use super::sweeps::Sweeps;
use crate::adjoint::dynamics::{Bytes, Dynamics, Fields, RunError};
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply1, Operator};
use crate::numerics::ranks::Ranks;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::Neighbourhood;
use candle_core::{Device, Result, Shape, Tensor, Var};
use std::sync::{Arc, Mutex, PoisonError};

/// A flow over several ranks as [`Dynamics`]. All ranks must do the same with it, in the same order.
pub struct Spread<R> {
    terms: Arc<Terms<R>>,
    whole: Sph<R>,
}

/// A rank's part of a state that a schedule keeps.
pub struct KeptShare<R> {
    seat: Arc<Seat<R>>,
    at: Snapshot<R>,
}

/// A rank's part of a run on the graph.
pub struct SharedTape<R> {
    seat: Arc<Seat<R>>,
    solver: TensorSolver<R>,
}

/// A field of a rank's particles `[rows, n]` -> the same of all particles `[rows, N]`, on every rank.
struct Whole<R> {
    terms: Arc<Terms<R>>,
    seat: Arc<Seat<R>>,
}

/// A scalar of own particles -> its sum over the ranks.
struct Total<R>(Arc<Terms<R>>);

/// A state -> itself, at the beginning of a step. Its cotangent is that of own particles only.
struct Begin<R>(Arc<Seat<R>>);

/// The state `[F, n]` of a seat -> that of the next one.
struct HandOver<R> {
    ranks: Ranks,
    before: Arc<Seat<R>>,
    after: Arc<Seat<R>>,
    came_from: Vec<usize>,
    /// The state after it, until candle has taken it.
    state: Mutex<Vec<R>>,
}

/// An error whose particle has its number in the whole flow.
fn named<R>(seat: &Seat<R>, error: RunError) -> RunError {
    let RunError::Neighbours { step, mut source } = error else { return error };
    if let NeighbourError::LostParticle { particle, .. }
    | NeighbourError::Clumped { particle, .. }
    | NeighbourError::TooFast { particle, .. } = &mut source
    {
        *particle = seat.numbers.get(*particle).map_or(*particle, |&number| number as usize);
    }
    RunError::Neighbours { step, source }
}

impl<R: Sweeps> Operator<1> for Whole<R> {
    type Real = R;
    const NAME: &'static str = "whole flow";

    fn forward(&self, [field]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let whole = self.terms.gathered(&self.seat, field);
        let n = self.terms.whole.particles();
        let rows = whole.len() / n;
        Ok((whole, (rows, n).into()))
    }

    fn adjoint(&self, [field]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let (n, all) = (self.seat.numbers.len(), self.terms.whole.particles());
        let mut own_bar = vec![R::default(); field.len()];
        for row in 0..bar.len() / all {
            let take = |i: usize| own_bar[row * n + i] = bar[row * all + self.seat.numbers[i] as usize];
            self.seat.own().for_each(take);
        }
        Ok([Some(own_bar)])
    }
}

impl<R: Sweeps> Operator<1> for Total<R> {
    type Real = R;
    const NAME: &'static str = "sum over ranks";

    fn forward(&self, [own]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let sums = self.0.ranks.sum(&own.iter().map(|x| x.f64()).collect::<Vec<_>>());
        Ok((sums.into_iter().map(R::of).collect(), shape.clone()))
    }

    fn adjoint(&self, _: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        // All ranks have the same cotangent of the sum.
        Ok([Some(bar.to_vec())])
    }
}

impl<R: Sweeps> Operator<1> for Begin<R> {
    type Real = R;
    const NAME: &'static str = "state of a part";

    fn forward(&self, [state]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        Ok((state.to_vec(), shape.clone()))
    }

    fn adjoint(&self, _: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let n = self.0.numbers.len();
        let mut own = vec![R::default(); bar.len()];
        for row in 0..bar.len() / n.max(1) {
            self.0.own().for_each(|i| own[row * n + i] = bar[row * n + i]);
        }
        Ok([Some(own)])
    }
}

impl<R: Sweeps> Operator<1> for HandOver<R> {
    type Real = R;
    const NAME: &'static str = "hand over";

    fn forward(&self, _: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let state = std::mem::take(&mut *self.state.lock().unwrap_or_else(PoisonError::into_inner));
        Ok((state, (shape.dims()[0], self.after.numbers.len()).into()))
    }

    fn adjoint(&self, [state]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let (before, after) = (&self.before, &self.after);
        let (n, n_after) = (before.numbers.len(), after.numbers.len());
        let rows = state.len() / n;
        let mut to = vec![Vec::new(); self.ranks.size()];
        for i in after.own() {
            let to = &mut to[self.came_from[i]];
            to.push(f64::from(after.numbers[i]));
            to.extend((0..rows).map(|row| bar[row * n_after + i].f64()));
        }
        let mut state_bar = vec![R::default(); state.len()];
        for record in self.ranks.deal(to).iter().flat_map(|of| of.chunks_exact(1 + rows)) {
            let i = before.numbers.binary_search(&(record[0] as u32)).expect("a particle that was handed over");
            (0..rows).for_each(|row| state_bar[row * n + i] = R::of(record[1 + row]));
        }
        Ok([Some(state_bar)])
    }
}

impl<R: Sweeps> Spread<R> {
    pub fn new(whole: Sph<R>, sharing: Sharing, ranks: &Ranks) -> Self {
        Self { terms: Arc::new(Terms::new(whole.model.clone(), sharing, ranks)), whole }
    }

    /// The derivative by the whole state `[F, N]` at a start, from that by this rank's part of it.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn whole(&self, start: &Snapshot<R>, part: &Tensor) -> Result<Tensor> {
        apply1(Whole { terms: self.terms.clone(), seat: self.terms.first(&start.reference) }, &part.detach())
    }

    /// The fields of the whole flow from those of this rank's particles. `count` has their numbers of neighbours.
    fn whole_fields(&self, seat: &Arc<Seat<R>>, fields: Fields, count: &[u32]) -> Result<Fields> {
        let gathered = |field: &Tensor| apply1(Whole { terms: self.terms.clone(), seat: seat.clone() }, field);
        let total = |sum: Option<Tensor>| sum.map(|sum| apply1(Total(self.terms.clone()), &sum)).transpose();
        let counts: Vec<R> = count.iter().map(|&count| R::of(f64::from(count))).collect();
        let counts = self.terms.gathered(seat, &counts);
        let is_active = |(i, count): (usize, &R)| self.whole.model.is_fluid(i) || count.f64() > 0.0;
        Ok(Fields {
            position: gathered(&fields.position)?,
            velocity: gathered(&fields.velocity)?,
            density: gathered(&fields.density)?,
            mass: gathered(&fields.mass)?,
            temperature: fields.temperature.as_ref().map(gathered).transpose()?,
            wall_heat: total(fields.wall_heat)?,
            carried_heat: total(fields.carried_heat)?,
            tags: self.whole.tags.clone(),
            active: Arc::new(counts.iter().enumerate().map(is_active).collect()),
            ..fields
        })
    }

    /// The first error of all ranks, told to all; particles by their number in the whole flow.
    fn agreed(
        &self,
        seat: &Seat<R>,
        step: usize,
        own: std::result::Result<(), RunError>,
    ) -> std::result::Result<(), RunError> {
        let number = |particle: usize| f64::from(seat.numbers[particle]);
        let told = match &own {
            Ok(()) => [0.0; 5],
            Err(RunError::NotFinite { field, particle, value, .. }) => {
                [1.0, self.row_of(field), number(*particle), *value, 0.0]
            }
            Err(RunError::Impossible { field, particle, value, limit, .. }) => {
                [2.0, self.row_of(field), number(*particle), *value, *limit]
            }
            Err(_) => [3.0, 0.0, 0.0, 0.0, 0.0],
        };
        let all = self.terms.ranks.all(&told);
        let Some(of) = all.chunks_exact(5).find(|of| of[0] > 0.0) else { return Ok(()) };
        let field = self.whole.model.rows.quantity(of[1] as usize).map_or("state", |quantity| quantity.name());
        let particle = of[2] as usize;
        Err(match of[0] as usize {
            1 => RunError::NotFinite { step, field, particle, value: of[3] },
            2 => RunError::Impossible { step, field, particle, value: of[3], limit: of[4] },
            _ => return own,
        })
    }

    fn row_of(&self, field: &str) -> f64 {
        let rows = self.whole.model.rows;
        let is_it = |row: &usize| rows.quantity(*row).is_some_and(|quantity| quantity.name() == field);
        (0..rows.count()).find(is_it).unwrap_or_default() as f64
    }
}

impl<R: Sweeps> Dynamics for Spread<R> {
    /// A state of the whole flow, which every rank has.
    type Start = Snapshot<R>;
    type Kept = KeptShare<R>;
    type Run = Share<R>;
    type Tape = SharedTape<R>;

    fn start(&self, start: &Snapshot<R>) -> std::result::Result<Share<R>, RunError> {
        Share::new(self.terms.clone(), start)
    }
    fn advance(&self, run: &mut Share<R>) -> std::result::Result<(), RunError> {
        let least = run.solver.least_parts;
        run.advance(least).map_err(|error| named(&run.seat, error))
    }
    fn step(&self, run: &Share<R>) -> usize {
        run.solver.step
    }
    fn check(&self, run: &Share<R>) -> std::result::Result<(), RunError> {
        self.agreed(&run.seat, run.solver.step, run.solver.check())
    }
    fn look(&self, run: &mut Share<R>) -> std::result::Result<Fields, RunError> {
        let step = run.solver.step;
        let fields = run.seat.flow.look(&mut run.solver)?;
        self.whole_fields(&run.seat, fields, &run.solver.neighbourhood.list.count).map_err(RunError::tensor(step))
    }
    fn over_all(&self, own: f64) -> f64 {
        self.terms.ranks.sum(&[own])[0]
    }
    fn tensor(&self, start: &Snapshot<R>) -> std::result::Result<Tensor, RunError> {
        let share = self.start(start)?;
        share.seat.flow.tensor(&share.solver.snapshot())
    }
    fn advance_taped(
        &self,
        tape: &mut SharedTape<R>,
        state: &Tensor,
        _: Option<&Tensor>,
    ) -> std::result::Result<Tensor, RunError> {
        let failed = RunError::tensor(tape.solver.step);
        let begun = apply1(Begin(tape.seat.clone()), state).map_err(&failed)?;
        let next = tape.solver.advance(&begun);
        if is_used_up(&next) {
            let values: Vec<R> = state.flatten_all().and_then(|state| state.to_vec1()).map_err(&failed)?;
            let dealt = self.terms.hand_over(&tape.seat, &values);
            let (after, step) = (dealt.seat, tape.solver.step);
            let list = Neighbourhood::due(after.copied());
            tape.solver = TensorSolver::new(after.flow.model.clone(), list, step, 1, Kernels::Fused);
            let before = std::mem::replace(&mut tape.seat, after.clone());
            let (ranks, came_from, dealt) = (self.terms.ranks.clone(), dealt.came_from, Mutex::new(dealt.state));
            let state = apply1(HandOver { ranks, before, after, came_from, state: dealt }, state).map_err(&failed)?;
            return tape.solver.advance(&state);
        }
        next
    }
    fn fields(&self, tape: &mut SharedTape<R>, state: &Tensor) -> std::result::Result<Fields, RunError> {
        let fields = tape.seat.flow.fields(&mut tape.solver, state)?;
        let count = &tape.solver.neighbourhood.list.count;
        self.whole_fields(&tape.seat, fields, count).map_err(RunError::tensor(tape.solver.step))
    }

    fn keep(&self, run: &Share<R>, _: bool) -> std::result::Result<KeptShare<R>, RunError> {
        Ok(KeptShare { seat: run.seat.clone(), at: run.solver.snapshot() })
    }
    fn settle(&self, _: &mut KeptShare<R>, _: &Share<R>) {}
    fn resume(&self, run: &mut Share<R>, kept: &KeptShare<R>) -> std::result::Result<(), RunError> {
        run.go_back(&kept.seat, &kept.at)
    }
    fn tape(
        &self,
        kept: &KeptShare<R>,
        last: Option<SharedTape<R>>,
        _: &Share<R>,
    ) -> std::result::Result<(SharedTape<R>, Var), RunError> {
        let (model, at) = (&kept.seat.flow.model, &kept.at);
        let has_list = |last: &SharedTape<R>| Arc::ptr_eq(&last.solver.neighbourhood.reference, &at.reference);
        let solver = match last.filter(has_list) {
            Some(last) => {
                let neighbourhood: Neighbourhood<R> = last.solver.neighbourhood;
                TensorSolver::new(model.clone(), neighbourhood, at.step, at.parts, Kernels::Fused)
            }
            None => {
                let mut solver = TensorSolver::restore(model.clone(), at, Kernels::Fused)?;
                solver.neighbourhood.copied = Some(kept.seat.copied());
                solver
            }
        };
        let shape = (model.rows.count(), model.particles());
        let variable = Var::from_slice(&at.state, shape, &Device::Cpu).map_err(RunError::tensor(at.step))?;
        Ok((SharedTape { seat: kept.seat.clone(), solver }, variable))
    }

    fn kept_bytes(&self, kept: &KeptShare<R>) -> Bytes {
        let at = &kept.at;
        let (own, shared) = (size_of_val(&at.state[..]), size_of_val(&at.reference[..]));
        Bytes { own, shared, identity: Arc::as_ptr(&at.reference) as usize }
    }
    fn taped_bytes(&self, tape: &SharedTape<R>) -> Bytes {
        tape.seat.flow.taped_bytes(&tape.solver)
    }
}
