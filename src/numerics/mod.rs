//! What computing needs and physics does not know: lanes, sweeps over rows, memory, random numbers, being asked to stop, other processes, the bridge to candle.
pub mod blocks;
pub mod candle;
pub mod curve;
pub mod eigenvalues;
pub mod exponential;
pub mod gather;
pub mod interrupt;
pub mod krylov;
pub mod lanes;
pub mod memory;
pub mod pool;
pub mod random;
pub mod ranks;
pub mod sparse_lu;
pub mod sweep;
pub mod thread_pool;
pub mod threads;
