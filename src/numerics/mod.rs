//! What computing needs and physics does not know: lanes, memory, random numbers.
pub mod blocks;
pub mod candle;
pub mod lanes;
pub mod pool;
pub mod random;
