//! Tests that change something of the whole process: an allocator that counts, how sums are taken, the most memory there has been.

mod adjoint;
mod device;
mod support;

use hydrograd::report::memory::{peak_memory_bytes, reset_peak_memory};
use std::sync::{Mutex, MutexGuard};

/// Held by each of these tests: they run one at a time, so that one sees its own memory and its own settings only.
fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(|e| e.into_inner())
}

#[cfg(target_os = "linux")]
#[test]
fn peak_memory_follows_use() {
    let _turn = turn();
    let before = peak_memory_bytes();
    assert!(before > 1 << 20, "{before}");
    let block = vec![1_u8; 64 << 20];
    let with_block = peak_memory_bytes();
    assert!(block.iter().step_by(4096).all(|byte| *byte == 1));
    assert!(with_block >= 64 << 20, "{with_block}");
    drop(block);
    reset_peak_memory();
    // Best effort: where the reset is forbidden the peak must at least not grow.
    assert!(peak_memory_bytes() <= with_block);
}
