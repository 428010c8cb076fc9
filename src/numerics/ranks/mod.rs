//! Processes that work on the same thing, side by side on one machine or many: MPI's ranks.
//!
//! Without the feature `mpi`, or where nobody started several processes, there is one rank, and nothing is ever exchanged.

#[cfg(feature = "mpi")]
mod mpi;
#[cfg(feature = "mpi")]
use mpi as engine;

#[cfg(not(feature = "mpi"))]
mod none;
#[cfg(not(feature = "mpi"))]
use none as engine;

mod how;

pub use engine::Exchange;
pub use how::How;

use super::threads;
use crate::error::BadInput;
use std::fmt;
use std::sync::Arc;

/// The processes, seen from one of them. When the last clone is dropped, it waits until all others are done too.
#[derive(Clone)]
pub struct Ranks(Option<Arc<engine::World>>);

/// What starts several processes tells each of them how many there are: Open MPI's and MPICH's mpirun, Slurm's srun.
const SIZES: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"];

/// How many processes somebody started together.
pub fn started(variable: impl Fn(&str) -> Option<String>) -> usize {
    let sizes = SIZES.iter().filter_map(|name| variable(name)?.parse().ok());
    sizes.max().unwrap_or(1)
}

/// Numbers on their way between ranks.
pub struct Swap(Option<engine::Swap>);

impl Swap {
    /// Gives them time: MPI moves numbers only while somebody asks it something.
    pub fn go_on(&mut self) {
        if let Some(swap) = &mut self.0 {
            swap.go_on();
        }
    }

    /// Waits for them. They come in the order in which the ranks were named.
    pub fn wait(self) -> Vec<Vec<f64>> {
        self.0.map_or(vec![], engine::Swap::wait)
    }
}

impl fmt::Debug for Ranks {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "rank {} of {}", self.rank(), self.size())
    }
}

impl Ranks {
    /// One process, on its own.
    pub const ALONE: Self = Self(None);

    /// Those that this process was started with.
    ///
    /// # Errors
    /// [`BadInput`]: there are several, and this program cannot talk to the others.
    pub fn of_environment() -> Result<Self, BadInput> {
        match started(|name| std::env::var(name).ok()) {
            0 | 1 => Ok(Self::ALONE),
            several => engine::World::begin(several).map(|world| Self(Some(Arc::new(world)))),
        }
    }

    /// Which of them this one is, from 0.
    pub fn rank(&self) -> usize {
        self.0.as_ref().map_or(0, |world| world.rank())
    }

    /// How many there are.
    pub fn size(&self) -> usize {
        self.0.as_ref().map_or(1, |world| world.size())
    }

    /// Threads of each, so that those on one machine share its cores.
    pub fn threads(&self) -> Option<usize> {
        let here = self.0.as_ref()?.on_this_machine();
        // Ranks that are bound to some cores are not given all.
        let own = threads::available();
        // SAFETY: asks for a number.
        let all = usize::try_from(unsafe { libc::sysconf(libc::_SC_NPROCESSORS_ONLN) }).unwrap_or(own);
        Some((all / here).clamp(1, own))
    }

    /// The numbers of every rank, behind each other in their order. All ranks must ask for it, with as many numbers.
    pub fn all(&self, own: &[f64]) -> Vec<f64> {
        match &self.0 {
            Some(world) => world.all(own),
            None => own.to_vec(),
        }
    }

    /// Begins to exchange numbers and does not wait for it; none if there is nobody to exchange them with. All ranks must
    /// begin the same exchanges in the same order.
    pub fn begin(&self, numbers: Vec<f64>, how: How) -> Option<Exchange> {
        self.0.as_ref().map(|world| world.begin_exchange(numbers, how))
    }

    /// The sum of each number over the ranks, added in their order: the same bits on all of them, and every time.
    pub fn sum(&self, own: &[f64]) -> Vec<f64> {
        let all = self.all(own);
        (0..own.len()).map(|k| all.iter().skip(k).step_by(own.len()).sum()).collect()
    }

    /// Waits until all ranks have come here.
    pub fn wait(&self) {
        self.all(&[0.0]);
    }

    /// The largest of the numbers of all ranks.
    pub fn most(&self, own: f64) -> f64 {
        self.all(&[own]).into_iter().fold(own, f64::max)
    }

    /// Begins to send numbers to other ranks and to get theirs, where both sides know how many: `to` and `from` name ranks, each at most
    /// once.
    pub fn begin_swap(&self, to: Vec<(usize, Vec<f64>)>, from: &[(usize, usize)]) -> Swap {
        Swap(self.0.as_ref().map(|world| world.begin_swap(to, from)))
    }

    /// Sends numbers to every rank, and returns those that each of them sent; those for this one stay. All ranks must ask for it.
    pub fn deal(&self, mut to: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let Some(world) = &self.0 else { return to };
        let counts: Vec<f64> = to.iter().map(|numbers| numbers.len() as f64).collect();
        let own = world.rank();
        let others = |counts: &[f64]| -> Vec<(usize, usize)> {
            let counts = counts.iter().enumerate().map(|(rank, &count)| (rank, count as usize));
            counts.filter(|&(rank, count)| rank != own && count > 0).collect()
        };
        let from = others(&world.counts(&counts));
        let kept = std::mem::take(&mut to[own]);
        let to: Vec<_> = others(&counts).into_iter().map(|(rank, _)| (rank, std::mem::take(&mut to[rank]))).collect();
        let mut dealt = vec![Vec::new(); world.size()];
        for (&(rank, _), numbers) in from.iter().zip(self.begin_swap(to, &from).wait()) {
            dealt[rank] = numbers;
        }
        dealt[own] = kept;
        dealt
    }

    /// The numbers of the first rank, on all of them.
    pub fn told(&self, known: Vec<f64>) -> Vec<f64> {
        let to = match self.rank() {
            0 => vec![known; self.size()],
            _ => vec![vec![]; self.size()],
        };
        self.deal(to).swap_remove(0)
    }

    /// Ends all ranks at once, with this exit code; returns only where there is one.
    pub fn abort(&self, code: u8) {
        if let Some(world) = &self.0 {
            world.abort(code);
        }
    }
}
