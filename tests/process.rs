//! What is counted and measured of a whole process: operations of kernels, the most memory there has been.

use hydrograd::numerics::lanes::{counted_operations, InstructionSet, Lanes, Real, RowKernel};
use hydrograd::report::memory::{peak_memory_bytes, reset_peak_memory};
use std::hint::black_box;
use std::ops::Range;

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
    crate::in_a_process_of_its_own!();
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
    crate::in_a_process_of_its_own!();
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
