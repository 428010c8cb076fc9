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
use super::part::{Part, Traffic};
use super::solver::{Snapshot, Solver};
use super::sweeps::Sweeps;
use crate::adjoint::run::{Observer, CHECK_EVERY};
use crate::adjoint::{Dynamics, RunError};
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

/// A rank's share of a run.
struct Share<R> {
    ranks: Ranks,
    whole: Model<R>,
    /// See [`Sharing::only`] and [`reach`].
    only: Option<usize>,
    reach: f64,
    decomposition: Decomposition,
    /// Number in the whole flow of each particle here, ascending.
    numbers: Vec<u32>,
    solver: Solver<R>,
    traffic: Arc<Traffic>,
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
            .allowed(
                "consistent, or standard with flux = pair, density_renormalisation = false and wall.slip = no-slip",
            )
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

impl<R: Sweeps> Share<R> {
    /// The share of the whole flow, which every rank has.
    fn new(whole: Model<R>, start: &Snapshot<R>, sharing: Sharing, ranks: &Ranks) -> Result<Self, RunError> {
        let (n, d) = (whole.particles(), whole.dimension());
        let reference = &start.reference;
        let bounds = bounds(reference, d);
        let alone = |numbers: &[f64]| numbers.to_vec();
        let decomposition = Decomposition::new(&whole.domain, bounds, ranks.size(), sharing.only, reference, &alone);
        let reach = reach(&whole, sharing);
        let near = |&i: &u32| decomposition.is_near(ranks.rank(), place(reference, n, i as usize), reach);
        let numbers: Vec<u32> = (0..n as u32).filter(near).collect();
        let of = |rows: &[R]| rows.chunks_exact(n).flat_map(|row| picked(row, &numbers)).collect();
        let at = Snapshot { state: of(&start.state), reference: Arc::new(of(reference)), ..*start };
        let traffic = Arc::default();
        let solver = seated(&whole, reach, &decomposition, ranks, &traffic, &numbers, &at)?;
        let (ranks, only) = (ranks.clone(), sharing.only);
        let (handed_over, cut, began) = (0, 1, start.step);
        Ok(Self { ranks, whole, only, reach, decomposition, numbers, solver, traffic, handed_over, cut, began })
    }

    fn part(&self) -> &Part {
        self.solver.model.part.as_deref().expect("a share's model is a part")
    }

    fn own(&self) -> Vec<usize> {
        (0..self.numbers.len()).filter(|&i| self.part().own[i]).collect()
    }

    /// What the first rank wants before the next step, and in how many parts that is made.
    fn agree(&self, wanted: f64) -> (f64, usize) {
        let parts = self.solver.model.parts(&self.solver.state).max(self.solver.least_parts);
        let all = self.ranks.all(&[wanted, parts as f64]);
        let most = all.chunks_exact(2).map(|of| of[1]).fold(1.0, f64::max);
        (all[0], most as usize)
    }

    /// Makes a step. All ranks fail in the same one, with the state as it was.
    fn advance(&mut self, parts: usize) -> Result<(), RunError> {
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

    /// The record of a particle here, which another rank reads.
    fn record(&self, i: usize, to: &mut Vec<f64>) {
        let n = self.numbers.len();
        to.push(f64::from(self.numbers[i]));
        to.extend(self.solver.state.iter().skip(i).step_by(n).map(|x| x.f64()));
        to.extend(self.solver.neighbourhood.reference.iter().skip(i).step_by(n).map(|x| x.f64()));
    }

    /// Numbers of a record.
    fn width(&self) -> usize {
        1 + self.whole.rows.count() + self.whole.dimension()
    }

    /// Gives every particle to the rank in whose block it is, and copies of it to those near it.
    fn hand_over(&mut self) -> Result<(), RunError> {
        let own = self.own();
        let counts = self.ranks.all(&[own.len() as f64]);
        let mean = counts.iter().sum::<f64>() / counts.len() as f64;
        let reference = self.solver.neighbourhood.reference.clone();
        let n = self.numbers.len();
        if counts.iter().any(|&count| count > UNEVEN * mean) {
            let chosen: Vec<u32> = own.iter().map(|&i| i as u32).collect();
            let positions: Vec<R> = reference.chunks_exact(n).flat_map(|row| picked(row, &chosen)).collect();
            let d = self.whole.dimension();
            let ends = bounds(&positions, d).map(|[low, high]| [-self.ranks.most(-low), self.ranks.most(high)]);
            let sum = |numbers: &[f64]| self.ranks.sum(numbers);
            let (domain, size) = (&self.whole.domain, self.ranks.size());
            self.decomposition = Decomposition::new(domain, ends, size, self.only, &positions, &sum);
            self.cut += 1;
        }
        let mut to = vec![Vec::new(); self.ranks.size()];
        for &i in &own {
            let place = place(&reference, n, i);
            for (rank, to) in to.iter_mut().enumerate() {
                if self.decomposition.is_near(rank, place, self.reach) {
                    self.record(i, to);
                }
            }
        }
        let found = self.ranks.deal(to).concat();
        let mut records: Vec<&[f64]> = found.chunks_exact(self.width()).collect();
        records.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let rows = |from: usize, to: usize| -> Vec<R> {
            (from..to).flat_map(|row| records.iter().map(move |record| R::of(record[row]))).collect()
        };
        let state_end = 1 + self.whole.rows.count();
        let numbers: Vec<u32> = records.iter().map(|record| record[0] as u32).collect();
        let old = &self.solver;
        let at = Snapshot {
            step: old.step,
            parts: old.pace.parts,
            least_parts: old.least_parts,
            state: rows(1, state_end),
            reference: Arc::new(rows(state_end, self.width())),
        };
        let Self { ranks, whole, decomposition, traffic, .. } = &*self;
        let mut solver = seated(whole, self.reach, decomposition, ranks, traffic, &numbers, &at)?;
        (solver.pace, solver.divided, solver.drove) = (old.pace, old.divided, Some(old.driving_force()));
        (self.solver, self.numbers) = (solver, numbers);
        self.handed_over += 1;
        Ok(())
    }

    /// Brings the whole flow up to date, which the first rank has.
    fn show(&self, whole: Option<&mut Solver<R>>) {
        let mut to = vec![Vec::new(); self.ranks.size()];
        self.own().into_iter().for_each(|i| self.record(i, &mut to[0]));
        let found = self.ranks.deal(to);
        let Some(whole) = whole else { return };
        let n = whole.model.particles();
        let rows = self.whole.rows.count();
        let mut reference = vec![R::default(); self.whole.dimension() * n];
        for record in found.iter().flat_map(|of| of.chunks_exact(self.width())) {
            let i = record[0] as usize;
            for (row, &value) in record[1..].iter().enumerate() {
                match row < rows {
                    true => whole.state[row * n + i] = R::of(value),
                    false => reference[(row - rows) * n + i] = R::of(value),
                }
            }
        }
        let own = &self.solver;
        (whole.step, whole.pace, whole.least_parts) = (own.step, own.pace, own.least_parts);
        (whole.divided, whole.drove) = (own.divided, Some(own.driving_force()));
        if *whole.neighbourhood.reference != reference {
            whole.forget_list(Arc::new(reference));
        }
    }

    fn shares(&self) -> Shares {
        let (own, steps) = (self.own().len(), (self.solver.step - self.began).max(1) as f64);
        let sent = [&self.traffic.messages, &self.traffic.bytes].map(|of| of.load(Ordering::Relaxed) as f64 / steps);
        let taken = peak_memory_bytes() as f64;
        let copies = self.numbers.len() - own;
        let all = self.ranks.all(&[own as f64, copies as f64, sent[0], sent[1], taken]);
        let each = |k: usize| all.iter().skip(k).step_by(5).copied();
        let mean = |k: usize| each(k).sum::<f64>() / self.ranks.size() as f64;
        Shares {
            ranks: self.ranks.size(),
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

/// A solver of the particles that a rank has, own ones and copies, at their snapshot.
fn seated<R: Sweeps>(
    whole: &Model<R>,
    reach: f64,
    decomposition: &Decomposition,
    ranks: &Ranks,
    traffic: &Arc<Traffic>,
    numbers: &[u32],
    at: &Snapshot<R>,
) -> Result<Solver<R>, RunError> {
    let (n, here) = (numbers.len(), ranks.rank());
    let places: Vec<[f64; 3]> = (0..n).map(|i| place(&at.reference, n, i)).collect();
    let owners: Vec<usize> = places.iter().map(|&place| decomposition.owner(place)).collect();
    let others = || (0..ranks.size()).filter(|&rank| rank != here);
    let chosen = |is: &dyn Fn(usize) -> bool| (0..n as u32).filter(|&i| is(i as usize)).collect::<Vec<u32>>();
    let lent = |rank| (rank, chosen(&|i| owners[i] == here && decomposition.is_near(rank, places[i], reach)));
    let copies = |rank| (rank, chosen(&|i| owners[i] == rank));
    let part = Part {
        ranks: ranks.clone(),
        lent: others().map(lent).filter(|(_, of)| !of.is_empty()).collect(),
        copies: others().map(copies).filter(|(_, of)| !of.is_empty()).collect(),
        own: owners.iter().map(|&owner| owner == here).collect(),
        has_walls: whole.has_walls(),
        traffic: traffic.clone(),
    };
    let model = whole.of(numbers, Arc::new(part)).expect("a model that can be shared out");
    Solver::restore(model, at)
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
    let mut share = Share::new(dynamics.model.clone(), start, sharing, ranks)?;
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
    let mut share = Share::new(model, &start, sharing, ranks)?;
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
