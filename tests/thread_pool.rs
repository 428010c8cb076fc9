//! The pool of threads: all work is done once, whoever comes, and a panic reaches the caller.

use hydrograd::numerics::thread_pool::ThreadPool;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Takes pieces until none is left, as sweeps do; returns how often each was taken.
fn take_pieces(pool: &ThreadPool, pieces: usize) -> Vec<usize> {
    let (next, taken) = (AtomicUsize::new(0), (0..pieces).map(|_| AtomicUsize::new(0)).collect::<Vec<_>>());
    pool.run(&|_| loop {
        let piece = next.fetch_add(1, Ordering::Relaxed);
        let Some(taken) = taken.get(piece) else { break };
        taken.fetch_add(1, Ordering::Relaxed);
    });
    taken.into_iter().map(AtomicUsize::into_inner).collect()
}

#[test]
fn every_piece_is_done_once() {
    // One thread, as many as cores, and far more than cores, which can not all come.
    for threads in [1, 2, 16] {
        let pool = ThreadPool::start(threads);
        assert_eq!(pool.threads(), threads);
        for sweep in 0..2000 {
            let pieces = sweep % 37;
            assert_eq!(take_pieces(pool, pieces), vec![1; pieces], "{threads} threads, sweep {sweep}");
        }
    }
}

#[test]
fn several_callers_and_work_inside_of_work() {
    let pool = ThreadPool::start(2);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| (0..500).for_each(|_| assert_eq!(take_pieces(pool, 20), [1; 20])));
        }
    });
    pool.run(&|_| assert_eq!(take_pieces(pool, 5), [1; 5]));
}

#[test]
fn threads_help_and_numbers_are_those_of_threads() {
    let pool = ThreadPool::start(3);
    // Sweeps that are long enough for a sleeping thread to wake up in.
    let helped = (0..200).any(|_| {
        let seen = AtomicUsize::new(0);
        pool.run(&|thread| {
            assert!(thread < 3);
            seen.fetch_or(1 << thread, Ordering::Relaxed);
            std::thread::sleep(std::time::Duration::from_millis(2));
        });
        assert_eq!(seen.load(Ordering::Relaxed) & 1, 1, "the caller works too");
        seen.load(Ordering::Relaxed) > 1
    });
    assert!(helped, "no other thread came in 200 sweeps");
}

#[test]
fn a_panic_reaches_the_caller_and_the_pool_goes_on() {
    let pool = ThreadPool::start(2);
    for thrower in [0, 1] {
        let thrown = (0..200).any(|_| {
            let run = || {
                pool.run(&|thread| {
                    std::thread::sleep(std::time::Duration::from_millis(1));
                    assert_ne!(thread, thrower, "as planned");
                })
            };
            catch_unwind(AssertUnwindSafe(run)).is_err()
        });
        assert!(thrown, "thread {thrower}");
        assert_eq!(take_pieces(pool, 10), [1; 10]);
    }
}
