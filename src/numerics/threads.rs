//! How many threads compute.

use std::thread::available_parallelism;

/// Environment variables with the number of threads of candle's pools and of ours.
const POOLS: [&str; 2] = ["CANDLE_NUM_THREADS", "RAYON_NUM_THREADS"];
/// Environment variables by which a user or a batch system gives a process a number of cores.
const GIVEN: [&str; 2] = ["SLURM_CPUS_PER_TASK", "OMP_NUM_THREADS"];

fn number(variable: &str) -> Option<usize> {
    std::env::var(variable).ok()?.parse().ok().filter(|&number| number > 0)
}

/// The number of cores of this process's affinity and its control group's quota.
pub fn available() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// The number of cores that this process may use: [`available`] ones, and no more than
/// Slurm or `OMP_NUM_THREADS` gives it.
pub fn cores() -> usize {
    GIVEN.into_iter().filter_map(number).fold(available(), usize::min)
}

/// The number of threads that compute: `CANDLE_NUM_THREADS` if it is set, as [`use_threads`] does, or [`cores`].
pub fn count() -> usize {
    number(POOLS[0]).unwrap_or_else(cores)
}

/// A number of threads in words.
pub fn in_words(threads: usize) -> String {
    if threads == 1 {
        "1 thread".into()
    } else {
        format!("{threads} threads")
    }
}

/// Sets the number of threads; 0 takes [`cores`], or what the environment variables of the pools say, others take at most
/// [`available`]. Must come before the first operator, because the pools read it once.
pub fn use_threads(threads: usize) {
    for pool in POOLS {
        // Threads without a core spin away the time of the others (1.3 times on one core); results do not depend on them.
        let threads = match (threads, number(pool)) {
            (0, Some(given)) => given,
            (0, None) => cores(),
            (wanted, _) => wanted.min(available()),
        };
        std::env::set_var(pool, threads.to_string());
    }
}
