//! One flow over several ranks: each has the particles in its block, and copies of those near it.
//!
//! A step on a rank is that of [`Solver`] on its part of the particles ([`super::part`]). Copies get their owners' state before every
//! step, and what operators found for them within it before another operator reads that. Blocks ([`Decomposition`]) are those of the
//! positions from which the neighbour list was built. All ranks build it anew in the same step, as soon as anywhere a particle has moved
//! half the skin, and then particles that have left a block are handed over. Where a rank has come to have `UNEVEN` times as many
//! particles as the mean, the box is cut anew.
//!
//! On every rank particles are in the order of the whole flow, so sums over neighbours run in the same order as on one rank, but for
//! rounding where cells of the neighbour search begin elsewhere. Sums over all particles are added in the order of the ranks.
//!
//! The first rank also has the whole flow. It is gathered for the steps at which somebody looks at it.

use super::dynamics::Sph;
use super::flow::picked;
use super::method::{Model, Sharing};
use super::pace::Pace;
use super::part::{Part, Traffic};
use super::solver::{Snapshot, Solver};
use super::sweeps::Sweeps;
use crate::adjoint::run::{Observer, CHECK_EVERY};
use crate::adjoint::{Dynamics, RunError};
use crate::config::scene::Kernels;
use crate::error::BadInput;
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::particles::decomposition::Decomposition;
use crate::report::memory::peak_memory_bytes;
use crate::report::text::bytes;
use serde::Serialize;
use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::Arc;

/// The box is cut anew where a rank has more particles than the mean by this factor.
const UNEVEN: f64 = 1.05;

/// What the first rank tells the others before a step.
const GO_ON: f64 = 0.0;
const SHOW: f64 = 1.0;
const END: f64 = 2.0;

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
    /// Most memory of a rank, and of the first one, which also has the whole flow.
    pub most_bytes: f64,
    pub first_rank_bytes: f64,
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
            "particles were handed over {} times, the box was cut {} times; the first rank took {}, a rank at most {}",
            self.handed_over,
            self.cut,
            memory(self.first_rank_bytes),
            memory(self.most_bytes)
        )
    }
}

/// What a flow is shared out by.
#[derive(Debug, Clone)]
pub(super) struct Terms<R> {
    pub ranks: Ranks,
    pub whole: Model<R>,
    /// See [`Sharing::only`] and [`reach`].
    only: Option<usize>,
    reach: f64,
    traffic: Arc<Traffic>,
}

/// The particles that a rank has between two hand-overs.
pub(super) struct Seat<R> {
    decomposition: Decomposition,
    /// Number in the whole flow of each particle here, ascending.
    pub numbers: Vec<u32>,
    /// The flow of these particles.
    pub flow: Sph<R>,
}

/// What a rank has after particles were handed over.
pub(super) struct Dealt<R> {
    pub seat: Arc<Seat<R>>,
    /// The rank that each particle here came from.
    pub came_from: Vec<usize>,
    pub state: Vec<R>,
    pub reference: Vec<R>,
    /// Whether the box was cut anew.
    is_cut: bool,
}

/// A rank's share of a run.
pub struct Share<R> {
    pub(super) terms: Arc<Terms<R>>,
    pub(super) seat: Arc<Seat<R>>,
    pub(super) solver: Solver<R>,
    handed_over: usize,
    cut: usize,
    /// The step at which the run began.
    began: usize,
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

/// Lowest and highest coordinates, of three directions.
fn bounds<R: Sweeps>(positions: &[R], dimension: usize) -> [[f64; 2]; 3] {
    let n = positions.len() / dimension;
    let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for (place, x) in positions.iter().enumerate() {
        let (of, x) = (&mut bounds[place / n], x.f64());
        *of = [of[0].min(x), of[1].max(x)];
    }
    bounds
}

impl<R: 'static> Seat<R> {
    fn part(&self) -> &Part {
        self.flow.model.part.as_deref().expect("the flow of a rank is a part")
    }

    /// Own particles, by their place here.
    pub fn own(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.numbers.len()).filter(|&i| self.part().own[i])
    }
}

impl<R: Sweeps> Terms<R> {
    pub fn new(whole: Model<R>, sharing: Sharing, ranks: &Ranks) -> Self {
        let reach = reach(&whole, sharing);
        Self { ranks: ranks.clone(), whole, only: sharing.only, reach, traffic: Arc::default() }
    }

    /// The particles of this rank in the whole flow, which every rank has.
    pub fn first(&self, reference: &[R]) -> Arc<Seat<R>> {
        let (n, d) = (self.whole.particles(), self.whole.dimension());
        let bounds = bounds(reference, d);
        let alone = |numbers: &[f64]| numbers.to_vec();
        let (domain, ranks) = (&self.whole.domain, &self.ranks);
        let decomposition = Decomposition::new(domain, bounds, ranks.size(), self.only, reference, &alone);
        let near = |&i: &u32| decomposition.is_near(ranks.rank(), place(reference, n, i as usize), self.reach);
        let numbers: Vec<u32> = (0..n as u32).filter(near).collect();
        let reference: Vec<R> = reference.chunks_exact(n).flat_map(|row| picked(row, &numbers)).collect();
        self.seat(decomposition, numbers, &reference)
    }

    /// Own particles and copies of this rank, whose list is built from `reference`.
    fn seat(&self, decomposition: Decomposition, numbers: Vec<u32>, reference: &[R]) -> Arc<Seat<R>> {
        let (n, here, size) = (numbers.len(), self.ranks.rank(), self.ranks.size());
        let places: Vec<[f64; 3]> = (0..n).map(|i| place(reference, n, i)).collect();
        let owners: Vec<usize> = places.iter().map(|&place| decomposition.owner(place)).collect();
        let others = || (0..size).filter(|&rank| rank != here);
        let chosen = |is: &dyn Fn(usize) -> bool| (0..n as u32).filter(|&i| is(i as usize)).collect::<Vec<u32>>();
        let is_lent = |rank, i: usize| owners[i] == here && decomposition.is_near(rank, places[i], self.reach);
        let lent = |rank| (rank, chosen(&|i| is_lent(rank, i)));
        let copies = |rank| (rank, chosen(&|i| owners[i] == rank));
        let part = Part {
            ranks: self.ranks.clone(),
            lent: others().map(lent).filter(|(_, of)| !of.is_empty()).collect(),
            copies: others().map(copies).filter(|(_, of)| !of.is_empty()).collect(),
            own: owners.iter().map(|&owner| owner == here).collect(),
            has_walls: self.whole.has_walls(),
            traffic: self.traffic.clone(),
        };
        let model = self.whole.of(&numbers, Arc::new(part)).expect("a model that can be shared out");
        Arc::new(Seat { decomposition, numbers, flow: Sph::new(model, Kernels::Fused) })
    }

    /// The record of a particle, which another rank reads.
    fn record(&self, seat: &Seat<R>, state: &[R], reference: &[R], i: usize, to: &mut Vec<f64>) {
        let n = seat.numbers.len();
        to.push(f64::from(seat.numbers[i]));
        to.extend(state.iter().skip(i).step_by(n).map(|x| x.f64()));
        to.extend(reference.iter().skip(i).step_by(n).map(|x| x.f64()));
    }

    /// A field `[rows, N]` of the whole flow, on every rank, from its values `[rows, n]` of own particles.
    pub fn gathered(&self, seat: &Seat<R>, field: &[R]) -> Vec<R> {
        let (n, all) = (seat.numbers.len(), self.whole.particles());
        let rows = field.len() / n;
        let mut own = Vec::new();
        for i in seat.own() {
            own.push(f64::from(seat.numbers[i]));
            own.extend((0..rows).map(|row| field[row * n + i].f64()));
        }
        let mut whole = vec![R::default(); rows * all];
        for record in self.ranks.deal(vec![own; self.ranks.size()]).iter().flat_map(|of| of.chunks_exact(1 + rows)) {
            (0..rows).for_each(|row| whole[row * all + record[0] as usize] = R::of(record[1 + row]));
        }
        whole
    }

    /// Numbers of a record.
    fn width(&self) -> usize {
        1 + self.whole.rows.count() + self.whole.dimension()
    }

    /// Gives every particle to the rank in whose block it is, and copies of it to those near it. `reference` has the positions
    /// of the new neighbour list.
    pub fn hand_over(&self, seat: &Seat<R>, state: &[R], reference: &[R]) -> Dealt<R> {
        let (n, ranks) = (seat.numbers.len(), &self.ranks);
        let own: Vec<usize> = seat.own().collect();
        let counts = ranks.all(&[own.len() as f64]);
        let mean = counts.iter().sum::<f64>() / counts.len() as f64;
        let is_cut = counts.iter().any(|&count| count > UNEVEN * mean);
        let decomposition = if is_cut {
            let chosen: Vec<u32> = own.iter().map(|&i| i as u32).collect();
            let positions: Vec<R> = reference.chunks_exact(n).flat_map(|row| picked(row, &chosen)).collect();
            let d = self.whole.dimension();
            let ends = bounds(&positions, d).map(|[low, high]| [-ranks.most(-low), ranks.most(high)]);
            let sum = |numbers: &[f64]| ranks.sum(numbers);
            Decomposition::new(&self.whole.domain, ends, ranks.size(), self.only, &positions, &sum)
        } else {
            seat.decomposition.clone()
        };
        let mut to = vec![Vec::new(); ranks.size()];
        for &i in &own {
            let place = place(reference, n, i);
            for (rank, to) in to.iter_mut().enumerate() {
                if decomposition.is_near(rank, place, self.reach) {
                    self.record(seat, state, reference, i, to);
                }
            }
        }
        let (found, width) = (ranks.deal(to), self.width());
        let mut records: Vec<(usize, &[f64])> = Vec::new();
        for (from, found) in found.iter().enumerate() {
            records.extend(found.chunks_exact(width).map(|record| (from, record)));
        }
        records.sort_unstable_by(|(_, a), (_, b)| a[0].total_cmp(&b[0]));
        let rows = |from: usize, to: usize| -> Vec<R> {
            (from..to).flat_map(|row| records.iter().map(move |(_, record)| R::of(record[row]))).collect()
        };
        let state_end = 1 + self.whole.rows.count();
        let numbers: Vec<u32> = records.iter().map(|(_, record)| record[0] as u32).collect();
        let (state, reference) = (rows(1, state_end), rows(state_end, width));
        let came_from = records.iter().map(|(from, _)| *from).collect();
        let seat = self.seat(decomposition, numbers, &reference);
        Dealt { seat, came_from, state, reference, is_cut }
    }
}

impl<R: Sweeps> Share<R> {
    /// The share of the whole flow, which every rank has.
    pub(super) fn new(terms: Arc<Terms<R>>, start: &Snapshot<R>) -> Result<Self, RunError> {
        let n = terms.whole.particles();
        let seat = terms.first(&start.reference);
        let of = |rows: &[R]| rows.chunks_exact(n).flat_map(|row| picked(row, &seat.numbers)).collect();
        let at = Snapshot { state: of(&start.state), reference: Arc::new(of(&start.reference)), ..*start };
        let solver = Solver::restore(seat.flow.model.clone(), &at)?;
        Ok(Self { terms, seat, solver, handed_over: 0, cut: 1, began: start.step })
    }

    /// What the first rank wants before the next step, and in how many parts that is made.
    fn agree(&self, wanted: f64) -> (f64, usize) {
        let parts = self.solver.model.parts(&self.solver.state).max(self.solver.least_parts);
        let all = self.terms.ranks.all(&[wanted, parts as f64]);
        let most = all.chunks_exact(2).map(|of| of[1]).fold(1.0, f64::max);
        (all[0], most as usize)
    }

    /// Makes a step. All ranks fail in the same one, with the state as it was.
    pub(super) fn advance(&mut self, parts: usize) -> Result<(), RunError> {
        for part in 0..parts {
            let list = self.solver.neighbourhood.identity;
            self.solver.make_part(part, parts)?;
            match list == self.solver.neighbourhood.identity {
                true => self.solver.model.clone().refresh(&mut self.solver.state),
                false => self.hand_over()?,
            }
        }
        self.solver.step += 1;
        Ok(())
    }

    fn hand_over(&mut self) -> Result<(), RunError> {
        let old = &self.solver;
        let dealt = self.terms.hand_over(&self.seat, &old.state, &old.neighbourhood.reference);
        let at = Snapshot {
            step: old.step,
            parts: old.pace.parts,
            least_parts: old.least_parts,
            state: dealt.state,
            reference: Arc::new(dealt.reference),
        };
        let mut solver = Solver::restore(dealt.seat.flow.model.clone(), &at)?;
        (solver.pace, solver.divided, solver.drove) = (old.pace, old.divided, Some(old.driving_force()));
        (self.solver, self.seat) = (solver, dealt.seat);
        self.handed_over += 1;
        self.cut += usize::from(dealt.is_cut);
        Ok(())
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
            false => self.solver = Solver::restore(seat.flow.model.clone(), at)?,
        }
        Ok(())
    }

    /// Brings the whole flow up to date, which the first rank has.
    fn show(&self, whole: Option<&mut Solver<R>>) {
        let (terms, own) = (&self.terms, &self.solver);
        let mut to = vec![Vec::new(); terms.ranks.size()];
        let reference = &own.neighbourhood.reference;
        self.seat.own().for_each(|i| terms.record(&self.seat, &own.state, reference, i, &mut to[0]));
        let found = terms.ranks.deal(to);
        let Some(whole) = whole else { return };
        let n = whole.model.particles();
        let rows = terms.whole.rows.count();
        let mut reference = vec![R::default(); terms.whole.dimension() * n];
        for record in found.iter().flat_map(|of| of.chunks_exact(terms.width())) {
            let i = record[0] as usize;
            for (row, &value) in record[1..].iter().enumerate() {
                match row < rows {
                    true => whole.state[row * n + i] = R::of(value),
                    false => reference[(row - rows) * n + i] = R::of(value),
                }
            }
        }
        (whole.step, whole.pace, whole.least_parts) = (own.step, own.pace, own.least_parts);
        (whole.divided, whole.drove) = (own.divided, Some(own.driving_force()));
        if *whole.neighbourhood.reference != reference {
            whole.forget_list(Arc::new(reference));
        }
    }

    fn shares(&self) -> Shares {
        let (own, steps) = (self.seat.own().count(), (self.solver.step - self.began).max(1) as f64);
        let Terms { ranks, traffic, .. } = &*self.terms;
        let sent = [&traffic.messages, &traffic.bytes].map(|of| of.load(Ordering::Relaxed) as f64 / steps);
        let taken = peak_memory_bytes() as f64;
        let copies = self.seat.numbers.len() - own;
        let all = ranks.all(&[own as f64, copies as f64, sent[0], sent[1], taken]);
        let each = |k: usize| all.iter().skip(k).step_by(5).copied();
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
            most_bytes: each(4).fold(0.0, f64::max),
            first_rank_bytes: all[4],
        }
    }
}

/// Distance within which a rank needs copies of particles, by the positions of the last neighbour list: those of the next one may have
/// moved half the skin, and a quarter of a spacing in the step that makes it, on both sides. (The kernel reaches about three spacings.)
fn reach<R: Sweeps>(whole: &Model<R>, sharing: Sharing) -> f64 {
    let reach = whole.reach();
    sharing.reaches as f64 * reach.distance() + reach.skin + reach.cutoff / 6.0
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
    (sharing, ranks): (Sharing, &Ranks),
) -> anyhow::Result<(Solver<R>, Shares)> {
    let mut whole = dynamics.start(start)?;
    let mut share = Share::new(Arc::new(Terms::new(dynamics.model.clone(), sharing, ranks)), start)?;
    loop {
        let stop = interrupt::check();
        let step = share.solver.step;
        let ends = step >= steps || stop.is_err();
        let is_checked = step.is_multiple_of(CHECK_EVERY) || ends;
        let is_seen = is_checked || observers.iter().any(|observer| observer.wants(step));
        let wanted = match (ends, is_seen) {
            (true, _) => END,
            (_, true) => SHOW,
            _ => GO_ON,
        };
        let (_, parts) = share.agree(wanted);
        if is_seen {
            share.show(Some(&mut whole));
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
        }
        if let Err(error) = share.advance(parts) {
            // One rank knows why, of a particle that has another number there: the same step of the whole flow tells.
            share.show(Some(&mut whole));
            whole.advance()?;
            return Err(error.into());
        }
    }
}

/// The other ranks' part of [`lead`].
///
/// # Errors
/// No neighbour list for its share of the particles. An error that all ranks have is told by the first one.
pub fn follow<R: Sweeps>(
    model: Model<R>,
    start: Snapshot<R>,
    (sharing, ranks): (Sharing, &Ranks),
) -> anyhow::Result<()> {
    let mut share = Share::new(Arc::new(Terms::new(model, sharing, ranks)), &start)?;
    drop(start);
    loop {
        let (wanted, parts) = share.agree(GO_ON);
        if wanted != GO_ON {
            share.show(None);
        }
        if wanted == END {
            share.shares();
            return Ok(());
        }
        if share.advance(parts).is_err() {
            share.show(None);
            return Ok(());
        }
    }
}
