//! One flow over several ranks: each has the particles in its block, and copies of those near it.
//!
//! A step on a rank is that of [`Solver`] on its part of the particles ([`super::part`]). Copies get their owners' state, or the rates that
//! it follows from, in every step, and what operators found for them before another operator reads that. All ranks build the neighbour
//! list anew in the same step, as soon as anywhere a particle has moved half the skin. Copies serve for `LISTS` lists. Before the next one
//! is built, particles that have left a block ([`Decomposition`]) are handed over with the state before the step, which then begins again.
//! Where a rank has come to have `UNEVEN` times as many particles as the mean, the box is cut anew.
//!
//! On every rank particles are in the order of the whole flow, so sums over neighbours run in the same order as on one rank, but for
//! rounding where cells of the neighbour search begin elsewhere. Sums over all particles are added in the order of the ranks.
//!
//! The first rank also has the whole flow. It is gathered for the steps at which somebody looks at it.

use super::dynamics::Sph;
use super::flow::picked;
use super::method::{Looked, Model, Sharing};
use super::pace::Pace;
use super::part::{Part, Traffic};
use super::solver::{Snapshot, Solver};
use super::sweeps::Sweeps;
use crate::adjoint::run::{Observer, CHECK_EVERY};
use crate::adjoint::{Dynamics, RunError};
use crate::config::scene::Kernels;
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::particles::decomposition::Decomposition;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::neighbourhood::Copied;
use crate::particles::reach::bounds;
use crate::report::memory::peak_memory_bytes;
use crate::report::text::bytes;
use serde::Serialize;
use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::time::Instant;

/// The box is cut anew where a rank has more particles than the mean by this factor.
const UNEVEN: f64 = 1.05;

/// For how many neighbour lists copies serve: each needs those half a skin further on both sides, and handing over takes a part of a step.
const LISTS: f64 = 4.0;

/// Particles that a rank sends to the first one at a time: these numbers take memory once more.
const AT_A_TIME: usize = 1 << 15;

/// What the first rank tells the others before a step.
const GO_ON: f64 = 0.0;
const SHOW: f64 = 1.0;
const END: f64 = 2.0;
/// The end, because somebody asked to stop by a signal, whose number is added.
const STOP: f64 = 3.0;

/// How a run was shared out, over all ranks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Shares {
    pub ranks: usize,
    /// Particles of the ranks with the fewest and the most, at the end.
    pub fewest_particles: usize,
    pub most_particles: usize,
    /// Copies that a rank has besides, on average.
    pub mean_copies: f64,
    /// Messages and bytes that a rank sends a step for them, on average.
    pub messages_per_step: f64,
    pub bytes_per_step: f64,
    /// How often particles were handed over, and how often the box was cut.
    pub handed_over: usize,
    pub cut: usize,
    /// Most memory of the first rank, which also has the whole flow, and of the others.
    pub first_rank_bytes: f64,
    pub other_rank_bytes: f64,
    /// Time of a step, of the slowest rank: computing, and waiting for what others send.
    pub seconds_per_step: f64,
    /// What copies take of it, on average: packing, sending and waiting.
    pub exchange_seconds_per_step: f64,
}

impl fmt::Display for Shares {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let memory = |of: f64| bytes(of as usize);
        writeln!(
            out,
            "a rank has {} to {} particles and {:.0} copies, and sends {:.1} messages with {} a step",
            self.fewest_particles,
            self.most_particles,
            self.mean_copies,
            self.messages_per_step,
            memory(self.bytes_per_step)
        )?;
        write!(
            out,
            "a step took {:.3} ms, {:.3} of them for copies; particles were handed over {} times, the box was cut {} times; \
             the first rank took {}, others at most {}",
            1e3 * self.seconds_per_step,
            1e3 * self.exchange_seconds_per_step,
            self.handed_over,
            self.cut,
            memory(self.first_rank_bytes),
            memory(self.other_rank_bytes)
        )
    }
}

/// What a flow is shared out by.
#[derive(Debug, Clone)]
pub(super) struct Terms<R> {
    pub ranks: Ranks,
    pub whole: Model<R>,
    /// See [`Sharing::only`].
    only: Option<usize>,
    /// Distance from its block within which a rank gets copies, and [`Copied::serves`].
    reach: f64,
    serves: f64,
    traffic: Arc<Traffic>,
}

/// The particles that a rank has between two hand-overs.
pub(super) struct Seat<R> {
    decomposition: Decomposition,
    /// Number in the whole flow of each particle here, ascending.
    pub numbers: Vec<u32>,
    /// Where they were, `[D, n]`.
    reference: Arc<Vec<R>>,
    serves: f64,
    /// The flow of these particles.
    pub flow: Sph<R>,
}

/// What a rank has after particles were handed over.
pub(super) struct Dealt<R> {
    pub seat: Arc<Seat<R>>,
    /// The rank that each particle here came from.
    pub came_from: Vec<usize>,
    pub state: Vec<R>,
    /// Whether the box was cut anew.
    is_cut: bool,
}

/// Files of which every rank writes the piece of its own particles.
pub trait Pieces<R> {
    /// Whether they are written before step number `step`: all ranks say the same.
    fn wants(&self, step: usize) -> bool;
    /// Writes the piece of the particles `own` of a solver that also has copies; they have these numbers in the whole flow.
    ///
    /// # Errors
    /// Files that cannot be written.
    fn write(&mut self, solver: &mut Solver<R>, own: &[usize], numbers: Vec<u32>, ranks: &Ranks) -> anyhow::Result<()>;
}

/// A rank's share of a run.
pub struct Share<R> {
    pub(super) terms: Arc<Terms<R>>,
    pub(super) seat: Arc<Seat<R>>,
    pub(super) solver: Solver<R>,
    handed_over: usize,
    cut: usize,
    /// The step at which the run began, and the time that steps have taken since.
    began: usize,
    seconds: f64,
}

/// How the particles of a model can be shared out.
///
/// # Errors
/// A method that one rank alone can solve; fewer particles than ranks could use.
pub fn sharing<R: Sweeps>(model: &Model<R>, ranks: &Ranks) -> Result<Sharing, BadInput> {
    let name = model.name();
    let Some(sharing) = model.sharing() else {
        return Err(BadInput::new(format!("method.name = {name} with these keys is not computed by several ranks"))
            .allowed("consistent, or standard with laws that are fused, see its page")
            .advice("start it without mpirun"));
    };
    let (n, least) = (model.particles(), 100 * ranks.size());
    match n >= least {
        true => Ok(sharing),
        false => Err(BadInput::new(format!("{n} particles for {} ranks", ranks.size()))
            .allowed(format!("at least 100 a rank: {least}"))
            .advice("fewer ranks, or a smaller resolution.dx")),
    }
}

/// A place in three directions; 0 in the third of two.
fn place<R: Sweeps>(positions: &[R], n: usize, i: usize) -> [f64; 3] {
    [0, 1, 2].map(|d| positions.get(d * n + i).map_or(0.0, |x| x.f64()))
}

/// Where a particle is found that a rank has after particles were handed over: at a place here, or in a record of another rank.
enum Source {
    Here(usize),
    Record(usize),
}

/// The particles that stay and those of the records, by ascending number.
fn merged(numbers: &[u32], stay: &[usize], records: &[(usize, &[f64])]) -> Vec<Source> {
    let mut sources = Vec::with_capacity(stay.len() + records.len());
    let mut next = 0;
    for &i in stay {
        while next < records.len() && records[next].1[0] < f64::from(numbers[i]) {
            sources.push(Source::Record(next));
            next += 1;
        }
        sources.push(Source::Here(i));
    }
    sources.extend((next..records.len()).map(Source::Record));
    sources
}

impl<R: 'static> Seat<R> {
    fn part(&self) -> &Part {
        self.flow.model.part.as_deref().expect("the flow of a rank is a part")
    }

    pub fn copied(&self) -> Copied<R> {
        Copied { at: self.reference.clone(), serves: self.serves }
    }

    /// Own particles, by their place here.
    pub fn own(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.numbers.len()).filter(|&i| self.part().own[i])
    }
}

impl<R: Sweeps> Seat<R> {
    /// A run from a state of these particles.
    fn solver(&self, at: &Snapshot<R>) -> Result<Solver<R>, RunError> {
        let mut solver = Solver::restore(self.flow.model.clone(), at)?;
        solver.neighbourhood.copied = Some(self.copied());
        Ok(solver)
    }
}

impl<R: Sweeps> Terms<R> {
    pub fn new(whole: Model<R>, sharing: Sharing, ranks: &Ranks) -> Self {
        let reach = whole.reach();
        // And twice the longest way of a particle in the step that builds a list: a quarter of a spacing. (Kernels reach about three.)
        let serves = LISTS * reach.skin + reach.cutoff / 6.0;
        let reach = sharing.reaches as f64 * reach.distance() + serves;
        Self { ranks: ranks.clone(), whole, only: sharing.only, reach, serves, traffic: Arc::default() }
    }

    /// This rank's part of a state of the whole flow, which every rank has.
    fn part_of(&self, start: &Snapshot<R>) -> (Arc<Seat<R>>, Snapshot<R>) {
        let seat = self.first(&start.reference);
        let rows = start.state.chunks_exact(self.whole.particles());
        let state = rows.flat_map(|row| picked(row, &seat.numbers)).collect();
        let at = Snapshot { state, reference: seat.reference.clone(), ..*start };
        (seat, at)
    }

    /// The particles of this rank in the whole flow.
    pub fn first(&self, reference: &[R]) -> Arc<Seat<R>> {
        let n = self.whole.particles();
        let within = bounds(reference, n, 0..n);
        let alone = |numbers: &[f64]| numbers.to_vec();
        let (domain, ranks) = (&self.whole.domain, &self.ranks);
        let decomposition = Decomposition::new(domain, within, ranks.size(), self.only, reference, &alone);
        let near = |&i: &u32| decomposition.is_near(ranks.rank(), place(reference, n, i as usize), self.reach);
        let numbers: Vec<u32> = (0..n as u32).filter(near).collect();
        let reference: Vec<R> = reference.chunks_exact(n).flat_map(|row| picked(row, &numbers)).collect();
        self.seat(decomposition, numbers, reference)
    }

    /// Own particles and copies of this rank, which are at `reference`.
    fn seat(&self, decomposition: Decomposition, numbers: Vec<u32>, reference: Vec<R>) -> Arc<Seat<R>> {
        let (n, here, size) = (numbers.len(), self.ranks.rank(), self.ranks.size());
        let places: Vec<[f64; 3]> = (0..n).map(|i| place(&reference, n, i)).collect();
        let owners: Vec<usize> = places.iter().map(|&place| decomposition.owner(place)).collect();
        let others = || (0..size).filter(|&rank| rank != here);
        let chosen = |is: &dyn Fn(usize) -> bool| (0..n as u32).filter(|&i| is(i as usize)).collect::<Vec<u32>>();
        let is_lent = |rank, i: usize| owners[i] == here && decomposition.is_near(rank, places[i], self.reach);
        let lent = |rank| (rank, chosen(&|i| is_lent(rank, i)));
        let copies = |rank| (rank, chosen(&|i| owners[i] == rank));
        let lent: Vec<(usize, Vec<u32>)> = others().map(lent).filter(|(_, of)| !of.is_empty()).collect();
        let mut lent_to_any: Vec<u32> = lent.iter().flat_map(|(_, of)| of.iter().copied()).collect();
        lent_to_any.sort_unstable();
        lent_to_any.dedup();
        let part = Part {
            ranks: self.ranks.clone(),
            lent,
            lent_to_any,
            copies: others().map(copies).filter(|(_, of)| !of.is_empty()).collect(),
            own: owners.iter().map(|&owner| owner == here).collect(),
            has_walls: self.whole.has_walls(),
            traffic: self.traffic.clone(),
        };
        let model = self.whole.of(&numbers, Arc::new(part)).expect("a model that can be shared out");
        let flow = Sph::new(model, Kernels::Fused);
        Arc::new(Seat { decomposition, numbers, reference: Arc::new(reference), serves: self.serves, flow })
    }

    /// The record of a particle, which another rank reads.
    fn record(&self, seat: &Seat<R>, state: &[R], i: usize, to: &mut Vec<f64>) {
        to.push(f64::from(seat.numbers[i]));
        to.extend(state.iter().skip(i).step_by(seat.numbers.len()).map(|x| x.f64()));
    }

    /// Sends rows `[n]` to the first rank, or to all, who write the values of own particles to rows `[N]` of the whole flow.
    fn gather(&self, seat: &Seat<R>, rows: &[&[R]], by_all: bool, mut whole: Option<&mut [&mut [R]]>) {
        let own: Vec<usize> = seat.own().collect();
        let (size, most) = (self.ranks.size(), self.ranks.most(own.len() as f64) as usize);
        for from in (0..most).step_by(AT_A_TIME) {
            let some = &own[from.min(own.len())..own.len().min(from + AT_A_TIME)];
            let mut piece = Vec::with_capacity((1 + rows.len()) * some.len());
            for &i in some {
                piece.push(f64::from(seat.numbers[i]));
                piece.extend(rows.iter().map(|row| row[i].f64()));
            }
            let to = (0..size).map(|rank| if by_all || rank == 0 { piece.clone() } else { vec![] }).collect();
            let found = self.ranks.deal(to);
            let Some(whole) = &mut whole else { continue };
            for record in found.iter().flat_map(|of| of.chunks_exact(1 + rows.len())) {
                let values = whole.iter_mut().zip(&record[1..]);
                values.for_each(|(row, &value)| row[record[0] as usize] = R::of(value));
            }
        }
    }

    /// A field `[rows, N]` of the whole flow, on every rank, from its values `[rows, n]` of own particles.
    pub fn gathered(&self, seat: &Seat<R>, field: &[R]) -> Vec<R> {
        let rows: Vec<&[R]> = field.chunks_exact(seat.numbers.len()).collect();
        let all = self.whole.particles();
        let mut whole = vec![R::default(); rows.len() * all];
        let mut to: Vec<&mut [R]> = whole.chunks_exact_mut(all).collect();
        self.gather(seat, &rows, true, Some(&mut to));
        whole
    }

    /// Gives every particle to the rank in whose block it is, and copies of it to those near it.
    pub fn hand_over(&self, seat: &Seat<R>, state: &[R]) -> Dealt<R> {
        let (n, ranks) = (seat.numbers.len(), &self.ranks);
        let positions = &state[..self.whole.dimension() * n];
        let own: Vec<usize> = seat.own().collect();
        let counts = ranks.all(&[own.len() as f64]);
        let mean = counts.iter().sum::<f64>() / counts.len() as f64;
        let is_cut = counts.iter().any(|&count| count > UNEVEN * mean);
        let decomposition = if is_cut {
            let chosen: Vec<u32> = own.iter().map(|&i| i as u32).collect();
            let within = seat.flow.model.reach().bounds_of_all(positions).expect("a part of a flow");
            let positions: Vec<R> = positions.chunks_exact(n).flat_map(|row| picked(row, &chosen)).collect();
            let sum = |numbers: &[f64]| ranks.sum(numbers);
            Decomposition::new(&self.whole.domain, within, ranks.size(), self.only, &positions, &sum)
        } else {
            seat.decomposition.clone()
        };
        let here = ranks.rank();
        let (mut to, mut stay) = (vec![Vec::new(); ranks.size()], Vec::with_capacity(own.len()));
        for &i in &own {
            let place = place(positions, n, i);
            for (rank, to) in to.iter_mut().enumerate() {
                match decomposition.is_near(rank, place, self.reach) {
                    true if rank == here => stay.push(i),
                    true => self.record(seat, state, i, to),
                    false => {}
                }
            }
        }
        let (found, width) = (ranks.deal(to), 1 + self.whole.rows.count());
        let mut records: Vec<(usize, &[f64])> = Vec::new();
        for (from, found) in found.iter().enumerate() {
            records.extend(found.chunks_exact(width).map(|record| (from, record)));
        }
        records.sort_unstable_by(|(_, a), (_, b)| a[0].total_cmp(&b[0]));
        let sources = merged(&seat.numbers, &stay, &records);
        let mut dealt = Vec::with_capacity(self.whole.rows.count() * sources.len());
        for (row, values) in state.chunks_exact(n).enumerate() {
            dealt.extend(sources.iter().map(|source| match *source {
                Source::Here(i) => values[i],
                Source::Record(k) => R::of(records[k].1[1 + row]),
            }));
        }
        let reference = dealt[..self.whole.dimension() * sources.len()].to_vec();
        let number = |source: &Source| match *source {
            Source::Here(i) => (seat.numbers[i], here),
            Source::Record(k) => (records[k].1[0] as u32, records[k].0),
        };
        let (numbers, came_from) = sources.iter().map(number).unzip();
        let seat = self.seat(decomposition, numbers, reference);
        Dealt { seat, came_from, state: dealt, is_cut }
    }
}

impl<R: Sweeps> Share<R> {
    /// The share of the whole flow, which every rank has.
    pub(super) fn new(terms: Arc<Terms<R>>, start: &Snapshot<R>) -> Result<Self, RunError> {
        let (seat, at) = terms.part_of(start);
        Self::begun(terms, seat, &at)
    }

    fn begun(terms: Arc<Terms<R>>, seat: Arc<Seat<R>>, at: &Snapshot<R>) -> Result<Self, RunError> {
        let solver = seat.solver(at)?;
        Ok(Self { terms, seat, solver, handed_over: 0, cut: 1, began: at.step, seconds: 0.0 })
    }

    /// What the first rank wants before the next step, and in how many parts that is made. The others tell by which signal they were
    /// asked to stop, which the first one then does after this step.
    fn agree(&self, wanted: f64) -> (f64, usize) {
        let parts = self.solver.model.parts(&self.solver.state).max(self.solver.least_parts);
        let all = self.terms.ranks.all(&[wanted, parts as f64]);
        let signal = all.chunks_exact(2).skip(1).map(|of| of[0] as i32).find(|&signal| signal > 0);
        if let Some(signal) = signal.filter(|_| self.terms.ranks.rank() == 0) {
            interrupt::ask(signal);
        }
        let most = all.chunks_exact(2).map(|of| of[1]).fold(1.0, f64::max);
        (all[0], most as usize)
    }

    /// Makes a step. All ranks fail in the same one, with the state as it was.
    pub(super) fn advance(&mut self, parts: usize) -> Result<(), RunError> {
        let clock = Instant::now();
        for part in 0..parts {
            let mut made = self.solver.make_part(part, parts);
            if is_used_up(&made) {
                self.hand_over();
                made = self.solver.make_part(part, parts);
            }
            made?;
        }
        self.solver.step += 1;
        self.seconds += clock.elapsed().as_secs_f64();
        Ok(())
    }

    fn hand_over(&mut self) {
        let dealt = self.terms.hand_over(&self.seat, &self.solver.state);
        self.solver.reseat(dealt.seat.flow.model.clone(), dealt.state, dealt.seat.copied());
        self.seat = dealt.seat;
        self.handed_over += 1;
        self.cut += usize::from(dealt.is_cut);
    }

    /// Goes back to a state that this rank had.
    pub(super) fn go_back(&mut self, seat: &Arc<Seat<R>>, at: &Snapshot<R>) -> Result<(), RunError> {
        self.seat = seat.clone();
        match Arc::ptr_eq(&self.solver.neighbourhood.reference, &at.reference) {
            true => {
                self.solver.state.clone_from(&at.state);
                self.solver.step = at.step;
                self.solver.pace = Pace::after(at.parts);
            }
            false => self.solver = seat.solver(at)?,
        }
        Ok(())
    }

    /// Brings the whole flow up to date, which the first rank has; with its fields, which every rank finds for its particles,
    /// if somebody looks at them.
    fn show(&mut self, whole: Option<&mut Solver<R>>, looks: bool) -> Result<(), RunError> {
        if looks {
            self.solver.look()?;
        }
        let (terms, own, n_own) = (&self.terms, &self.solver, self.seat.numbers.len());
        let fields = if looks { own.looked.fields() } else { Default::default() };
        let count: Vec<R> = own.neighbourhood.list.count.iter().map(|&count| R::of(f64::from(count))).collect();
        let mut rows: Vec<&[R]> = own.state.chunks_exact(n_own).collect();
        rows.extend(own.neighbourhood.reference.chunks_exact(n_own));
        if looks {
            rows.push(&count);
            rows.extend(fields.iter().flat_map(|field| field.chunks_exact(n_own)));
        }
        let Some(whole) = whole else {
            terms.gather(&self.seat, &rows, false, None);
            return Ok(());
        };
        let n = whole.model.particles();
        let mut reference = vec![R::default(); terms.whole.dimension() * n];
        let mut counts = vec![R::default(); if looks { n } else { 0 }];
        let mut looked = Looked::default();
        let mut to: Vec<&mut [R]> = whole.state.chunks_exact_mut(n).chain(reference.chunks_exact_mut(n)).collect();
        to.extend(counts.chunks_exact_mut(n));
        for (field, from) in looked.fields_mut().into_iter().zip(fields) {
            field.resize(from.len() / n_own * n, R::default());
            to.extend(field.chunks_exact_mut(n));
        }
        terms.gather(&self.seat, &rows, false, Some(&mut to));
        (whole.step, whole.pace, whole.least_parts) = (own.step, own.pace, own.least_parts);
        (whole.divided, whole.drove) = (own.divided, Some(own.driving_force()));
        whole.forget_list(Arc::new(reference));
        if looks {
            whole.take_looked(looked, counts.iter().map(|count| count.f64() as u32).collect());
        }
        Ok(())
    }

    /// Writes this rank's piece, if that is due.
    fn write(&mut self, pieces: &mut Option<&mut dyn Pieces<R>>) -> anyhow::Result<()> {
        let Some(pieces) = pieces.as_mut().filter(|pieces| pieces.wants(self.solver.step)) else { return Ok(()) };
        let own: Vec<usize> = self.seat.own().collect();
        let numbers = own.iter().map(|&i| self.seat.numbers[i]).collect();
        pieces.write(&mut self.solver, &own, numbers, &self.terms.ranks)
    }

    fn shares(&self) -> Shares {
        let (own, steps) = (self.seat.own().count(), (self.solver.step - self.began).max(1) as f64);
        let Terms { ranks, traffic, .. } = &*self.terms;
        let sent = [&traffic.messages, &traffic.bytes].map(|of| of.load(Ordering::Relaxed) as f64 / steps);
        let taken = peak_memory_bytes() as f64;
        let copies = self.seat.numbers.len() - own;
        let exchanging = 1e-9 * traffic.nanoseconds.load(Ordering::Relaxed) as f64 / steps;
        let all = ranks.all(&[own as f64, copies as f64, sent[0], sent[1], taken, self.seconds / steps, exchanging]);
        let each = |k: usize| all.iter().skip(k).step_by(7).copied();
        let mean = |k: usize| each(k).sum::<f64>() / ranks.size() as f64;
        Shares {
            ranks: ranks.size(),
            fewest_particles: each(0).fold(f64::INFINITY, f64::min) as usize,
            most_particles: each(0).fold(0.0, f64::max) as usize,
            mean_copies: mean(1),
            messages_per_step: mean(2),
            bytes_per_step: mean(3),
            handed_over: self.handed_over,
            cut: self.cut,
            first_rank_bytes: all[4],
            other_rank_bytes: each(4).skip(1).fold(0.0, f64::max),
            seconds_per_step: each(5).fold(0.0, f64::max),
            exchange_seconds_per_step: mean(6),
        }
    }
}

/// Whether a step needs other copies than a rank has: on all ranks, which have their state as it was.
pub(super) fn is_used_up<T>(made: &Result<T, RunError>) -> bool {
    matches!(made, Err(RunError::Neighbours { source: NeighbourError::UsedUp, .. }))
}

/// [`crate::adjoint::run::run`] on the first of several ranks; the others [`follow`].
///
/// # Errors
/// As there.
pub fn lead<R: Sweeps>(
    dynamics: &Sph<R>,
    start: &Snapshot<R>,
    steps: usize,
    observers: &mut [&mut dyn Observer<Sph<R>>],
    mut pieces: Option<&mut dyn Pieces<R>>,
    (sharing, ranks): (Sharing, &Ranks),
) -> anyhow::Result<(Solver<R>, Shares)> {
    let mut whole = Solver::unlisted(dynamics.model.clone(), start);
    let mut share = Share::new(Arc::new(Terms::new(dynamics.model.clone(), sharing, ranks)), start)?;
    interrupt::needs_others();
    loop {
        let stop = interrupt::check();
        let step = share.solver.step;
        let ends = step >= steps || stop.is_err();
        let is_checked = step.is_multiple_of(CHECK_EVERY) || ends;
        let is_seen = is_checked || observers.iter().any(|observer| observer.wants(step));
        let wanted = match (ends, is_seen) {
            _ if stop.is_err() => STOP + f64::from(interrupt::asked().unwrap_or_default()),
            (true, _) => END,
            (_, true) => SHOW,
            _ => GO_ON,
        };
        let (_, parts) = share.agree(wanted);
        if stop.is_err() {
            interrupt::others_answered();
        }
        share.write(&mut pieces)?;
        if is_seen {
            share.show(Some(&mut whole), true)?;
            let shares = ends.then(|| share.shares());
            if is_checked {
                dynamics.check(&whole)?;
            }
            for observer in observers.iter_mut() {
                observer.see(dynamics, &mut whole)?;
            }
            stop?;
            if let Some(shares) = shares {
                return Ok((whole, shares));
            }
            // The time of a look is no time of a step.
            ranks.wait();
        }
        if let Err(error) = share.advance(parts) {
            // One rank knows why, of a particle that has another number there: the same step of the whole flow tells.
            share.show(Some(&mut whole), false)?;
            whole.advance()?;
            return Err(error.into());
        }
    }
}

/// The other ranks' part of [`lead`].
///
/// # Errors
/// No neighbour list for its share of the particles; [`Error::Stopped`]. A [`RunError`], which all ranks have and the first one tells.
pub fn follow<R: Sweeps>(
    model: Model<R>,
    start: Snapshot<R>,
    mut pieces: Option<&mut dyn Pieces<R>>,
    (sharing, ranks): (Sharing, &Ranks),
) -> anyhow::Result<()> {
    let terms = Arc::new(Terms::new(model, sharing, ranks));
    let (seat, at) = terms.part_of(&start);
    // Before there is a list: the whole state takes as much memory.
    drop(start);
    let mut share = Share::begun(terms, seat, &at)?;
    drop(at);
    loop {
        let (wanted, parts) = share.agree(f64::from(interrupt::asked().unwrap_or_default()));
        share.write(&mut pieces)?;
        if wanted != GO_ON {
            share.show(None, true)?;
        }
        if wanted >= END {
            share.shares();
            if wanted == END {
                return Ok(());
            }
            // Only one of the ranks may have got it.
            interrupt::ask((wanted - STOP) as i32);
            return Err(Error::Stopped.into());
        }
        if wanted != GO_ON {
            ranks.wait();
        }
        if let Err(error) = share.advance(parts) {
            share.show(None, false)?;
            return Err(error.into());
        }
    }
}
