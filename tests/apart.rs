//! Tests that change something of the whole process: an allocator that counts, how sums are taken, the most memory there has been.

mod adjoint;
mod device;
mod support;

use hydrograd::numerics::lanes::{counted_operations, InstructionSet, Lanes, Real, RowKernel};
use hydrograd::report::memory::{peak_memory_bytes, reset_peak_memory};
use std::hint::black_box;
use std::ops::Range;
use std::sync::{Mutex, MutexGuard};

/// Held by each of these tests: they run one at a time, so that one sees its own memory and its own settings only.
fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(|e| e.into_inner())
}

/// With one lane of f64 the operations of kernels are counted.
#[cfg(target_arch = "x86_64")]
#[test]
fn operations_are_counted() {
    struct Nine;
    impl RowKernel<f64> for Nine {
        #[inline(always)]
        fn rows<L: Lanes<Real = f64>>(&self, rows: Range<usize>) {
            for row in rows {
                let a = L::splat(2.0 + row as f64);
                let b = a.mul_add(a, a) / a + a * a - L::splat(1.0);
                black_box((b.sqrt().inverse_sqrt().positive()).sum());
            }
        }
    }
    let _turn = turn();
    let before = counted_operations();
    f64::run(&Nine, 0..1000, InstructionSet::available()[0]);
    assert_eq!(counted_operations() - before, 9000);
    // With other lanes nothing is.
    for set in InstructionSet::available().into_iter().skip(1) {
        f64::run(&Nine, 0..1000, set);
    }
    assert_eq!(counted_operations() - before, 9000);
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
