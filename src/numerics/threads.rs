//! How many threads compute.

/// Sets the number of worker threads; 0 takes every core. Must come before the first operator: candle's pools read it once.
pub fn use_threads(threads: usize) {
    if threads > 0 {
        // More than that only wait for each other, and the results do not depend on their number.
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = threads.min(2 * cores);
        let threads = threads.to_string();
        std::env::set_var("CANDLE_NUM_THREADS", &threads);
        std::env::set_var("RAYON_NUM_THREADS", &threads);
    }
}
