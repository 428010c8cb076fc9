//! Memory that is used again, sweeps, work that is stopped, ranks without MPI.

use hydrograd::error::Error;
use hydrograd::numerics::blocks::{Block, Blocks};
use hydrograd::numerics::incomplete_lu::{Half, IncompleteLu, Stored};
use hydrograd::numerics::interrupt::{check, check_own, is_asked_here, Stop};
use hydrograd::numerics::krylov::{gmres, idr};
use hydrograd::numerics::pool::Buffers;
use hydrograd::numerics::ranks::{started, How, Ranks};
use hydrograd::numerics::roofline::Roofline;
use hydrograd::numerics::sparse_lu::{dot, BlockMatrix};
use hydrograd::numerics::sweep::{clear, copied, copy, run_each, zeros, Shared, STRETCH};
use hydrograd::numerics::total::Total;
use hydrograd::numerics::two_level::TwoLevel;
use std::collections::BTreeSet;

fn keep<T: bytemuck::Pod>(blocks: &Blocks, values: &[T]) -> Block {
    blocks.keep(values.len(), |block| block.copy_from_slice(values)).unwrap()
}

/// Where a block is in memory.
fn place(block: &Block) -> usize {
    block.read(|bytes: &[u8]| bytes.as_ptr() as usize)
}

/// What a machine needs at least is what the slower of computing and memory needs.
#[test]
fn a_roofline_is_the_slower_of_two() {
    let machine = Roofline { operations: 10.0, bytes: 4.0 };
    assert_eq!((machine.seconds(20.0, 4.0), machine.seconds(1.0, 4.0)), (2.0, 1.0));
    let measured = Roofline::measure::<f32>(1 << 16);
    // Slower than a processor of 1990, or faster than all that there are.
    assert!((1e6..1e15).contains(&measured.operations) && (1e6..1e15).contains(&measured.bytes), "{measured:?}");
}

#[test]
fn blocks_keep_what_they_were_given_and_are_used_again() {
    let blocks = Blocks::default();
    let numbers = |k: usize| -> Vec<f64> { (0..5000).map(|i| (i * k) as f64).collect() };
    let mut kept: Vec<Option<Block>> = (0..300).map(|k| Some(keep(&blocks, &numbers(k)))).collect();
    let places = |kept: &[Option<Block>]| -> BTreeSet<usize> {
        kept.iter().map(|block| place(block.as_ref().unwrap())).collect()
    };
    let before = places(&kept);
    // More than the first map of 2 MiB has.
    assert!(before.len() == 300 && blocks.most() > 2 << 20);
    for round in 0..5 {
        for k in (round..300).step_by(3) {
            for number in [k + 1, k] {
                kept[k] = None;
                kept[k] = Some(keep(&blocks, &numbers(number)));
            }
        }
    }
    for (k, block) in kept.iter().enumerate() {
        block.as_ref().unwrap().read(|values: &[f64]| assert_eq!(values, numbers(k)));
    }
    assert_eq!(places(&kept), before);
}

#[test]
fn another_size_leaves_the_old_blocks_alone() {
    let blocks = Blocks::default();
    let small = keep(&blocks, &[1.0f32; 10]);
    let large = keep(&blocks, &[2.0f64; 1_000_000]);
    let shorter = keep(&blocks, &[3.0f64; 5]);
    small.read(|values: &[f32]| assert_eq!(values, [1.0; 10]));
    shorter.read(|values: &[f64]| assert_eq!(values, [3.0; 5]));
    let (too_small, free) = (place(&small), place(&shorter));
    drop((small, shorter));
    // The shorter one's place is used again, the small one's is too small.
    let again = keep(&blocks, &[4.0f64; 1_000_000]);
    assert!(place(&again) == free && free != too_small);
    large.read(|values: &[f64]| assert!(values.len() == 1_000_000 && values.iter().all(|&x| x == 2.0)));
    again.read(|values: &[f64]| assert!(values.iter().all(|&x| x == 4.0)));
}

#[test]
fn a_stop_ends_its_own_work_alone() {
    let (stop, other) = (Stop::default(), Stop::default());
    stop.ask();
    assert!(check().is_ok());
    Stop::ends(Some(stop.clone()), || {
        assert!(matches!(check(), Err(Error::Stopped)) && matches!(check_own(), Err(Error::Stopped)));
        Stop::ends(Some(other), || assert!(check().is_ok()));
        // Handed on to a thread that does a part of it.
        let own = Stop::of_this_thread();
        let stopped = std::thread::spawn(|| Stop::ends(own, is_asked_here)).join().unwrap();
        assert!(stopped && !std::thread::spawn(is_asked_here).join().unwrap());
    });
    assert!(check().is_ok());
}

#[test]
fn a_buffer_comes_back_to_who_had_it() {
    let pool = Buffers::<f64>::default();
    let place = |length: usize| pool.buffer(length).as_ptr() as usize;
    let (long, short) = (place(1000), place(100));
    assert_ne!(long, short);
    for _ in 0..3 {
        assert_eq!((place(1000), place(100)), (long, short));
    }
    // About as long.
    assert_eq!(place(950), long);
    // Two at a time are two.
    let (a, b) = (pool.buffer(100), pool.buffer(100));
    assert_ne!(a.as_ptr(), b.as_ptr());
    assert_eq!((a.len(), b.len()), (100, 100));
}

#[test]
fn lengths_that_change_a_little_do_not_pile_up() {
    let pool = Buffers::<f64>::default();
    for step in 0..500 {
        // Up and down by some per cent, with a stride that repeats late.
        let lengths = [1, 2, 3].map(|k| 1000 * k + 37 * step % 101);
        let held = lengths.map(|length| pool.buffer(length));
        assert_eq!(held.each_ref().map(|buffer| buffer.len()), lengths);
    }
    let count = std::iter::from_fn(|| pool.take()).count();
    assert!(count <= 4, "{count} buffers for three at a time");
}

#[test]
fn one_process_is_alone() {
    let ranks = Ranks::ALONE;
    assert_eq!((ranks.rank(), ranks.size(), ranks.threads()), (0, 1, None));
    assert_eq!(ranks.all(&[1.0, 2.0]), [1.0, 2.0]);
    assert!(ranks.begin(vec![3.0], How::Sum).is_none());
    ranks.abort(1);
}

#[test]
fn so_many_processes_were_started() {
    let size = |known: &'static [(&str, &str)]| {
        started(|name| known.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_string()))
    };
    assert_eq!(size(&[]), 1);
    assert_eq!(size(&[("OMPI_COMM_WORLD_SIZE", "4")]), 4);
    // mpirun inside of a step of Slurm's.
    assert_eq!(size(&[("SLURM_STEP_NUM_TASKS", "1"), ("OMPI_COMM_WORLD_SIZE", "2")]), 2);
    assert_eq!(size(&[("PMI_SIZE", "x")]), 1);
}

#[test]
fn numbers_are_filled_to_the_last() {
    for count in [0, 1, STRETCH - 1, STRETCH, 5 * STRETCH + 7] {
        let from: Vec<f64> = (0..count).map(|k| k as f64).collect();
        let mut to = vec![-1.0; count];
        copy(&from, &mut to);
        assert!(to == from && copied(&from) == from, "{count}");
        clear(&mut to);
        assert!(to == vec![0.0; count] && zeros::<f64>(count) == to, "{count}");
    }
}

/// Diffusion with a wind along x in a cube of `side`^3 nodes, 0 outside of it; values are given at its first plane.
fn wind(side: usize) -> BlockMatrix {
    let place = |i: usize| [i / side / side, i / side % side, i % side];
    let neighbour = |i: usize, d: usize, up: bool| {
        let at = place(i)[d];
        let step = side.pow(2 - d as u32);
        match up {
            true => (at + 1 < side).then(|| i + step),
            false => (at > 0).then(|| i - step),
        }
    };
    let ways = || (0..3).flat_map(|d| [(d, false), (d, true)]);
    let list = |i: usize| ways().filter_map(|(d, up)| neighbour(i, d, up)).map(|j| j as u32).collect();
    let mut matrix = BlockMatrix::of_lists(side.pow(3), 1, list);
    for i in 0..side.pow(3) {
        let own = matrix.entry(i, i as u32);
        matrix.values[own] = if place(i)[0] == 0 { 1.0 } else { 6.0 };
        for (d, up) in ways().filter(|_| place(i)[0] > 0) {
            if let Some(j) = neighbour(i, d, up) {
                let entry = matrix.entry(i, j as u32);
                matrix.values[entry] = if d > 0 {
                    -1.0
                } else if up {
                    -0.9
                } else {
                    -1.1
                };
            }
        }
    }
    matrix
}

/// Where every node is next to every other, incomplete factors are those of the whole matrix, up to their single precision; and blocks of
/// rows may come in parts.
#[test]
fn incomplete_factors_of_rows_in_parts() {
    const SIZE: usize = 2;
    let mut matrix = BlockMatrix::of_lists(5, SIZE, |_| (0..5).collect());
    for (k, value) in matrix.values.iter_mut().enumerate() {
        *value = (1.7 * k as f64).sin();
    }
    for i in 0..5 {
        let entry = matrix.entry(i, i as u32);
        matrix.block_mut(entry).copy_from_slice(&[9.0, 1.0, -2.0, 8.0 + i as f64]);
    }
    let known: Vec<f64> = (0..10).map(|k| 1.0 + (0.3 * k as f64).cos()).collect();
    let right = matrix.times(&known, false);
    let found = IncompleteLu::<SIZE>::new(&matrix).expect("factors").solve(&right);
    let error = found.iter().zip(&known).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < 1e-5, "{error:e}");
    let pattern = BlockMatrix::of_lists(5, 0, |_| (0..5).collect());
    let in_parts = IncompleteLu::<SIZE>::of_rows(&pattern, |i, add| {
        for part in [0.25, 0.75] {
            for &j in matrix.row(i) {
                let entry = matrix.entry(i, j);
                let block = &matrix.values[entry * SIZE * SIZE..(entry + 1) * SIZE * SIZE];
                add(j, &block.iter().map(|x| part * x).collect::<Vec<_>>());
            }
        }
    });
    let difference = in_parts.expect("factors").solve(&right);
    let difference = difference.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(difference < 1e-6, "{difference:e}");
}

/// With groups the products that a solution takes hardly grow with the size of the cube, and with the incomplete factors alone they
/// do; the solutions are those of the matrix and of its transpose.
#[test]
fn groups_of_nodes_save_iterations() {
    let products = |side: usize, transposed: bool, with_groups: bool| {
        let mut matrix = wind(side);
        if transposed {
            matrix.transpose();
        }
        let known: Vec<f64> = (0..side.pow(3)).map(|i| 1.0 + (0.1 * i as f64).sin()).collect();
        let right = matrix.times(&known, false);
        let factors = TwoLevel::new(&matrix, 1).expect("factors");
        let alone = IncompleteLu::<1>::new(&matrix).expect("factors");
        let count = std::cell::Cell::new(0);
        let times = |x: &[f64]| {
            count.set(count.get() + 1);
            matrix.times(x, false)
        };
        let precondition = |x: &[f64]| if with_groups { factors.solve(&matrix, x, 1) } else { alone.solve(x) };
        let found = gmres(&right, 1e-10, 200, &times, &precondition).expect("a solution");
        let error = found.iter().zip(&known).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-7, "{side} {transposed} {with_groups}: {error:e}");
        count.get()
    };
    for transposed in [false, true] {
        let [small, large] = [12, 30].map(|side| products(side, transposed, true));
        let [small_alone, large_alone] = [12, 30].map(|side| products(side, transposed, false));
        assert!(large < small + 8, "{small} {large}");
        assert!(large_alone > small_alone + 8 && 3 * large < 2 * large_alone, "{small_alone} {large_alone} {large}");
    }
}

/// Numbers in eight bits are the nearest ones, and factors in them are near those in single precision: where every node is next to every
/// other, a solution is as far off as they are.
#[test]
fn factors_in_eight_bits() {
    for (value, nearest) in
        [(1.0, 1.0), (-1.0 - 3.0 / 512.0, -1.0078125), (3.0f32.powi(-70), 3.0f32.powi(-70)), (1.0 + 1.0 / 256.0, 1.0)]
    {
        let found = Half::of(value).f32();
        assert!((found - nearest).abs() <= nearest.abs() / 256.0, "{value}: {found}");
    }
    assert_eq!(Half::of(1.0 + 1.0 / 256.0).f32(), 1.0, "of two that are as near the even one");
    assert_eq!(Half::of(1.0 + 3.0 / 256.0).f32(), 1.0 + 4.0 / 256.0, "of two that are as near the even one");
    assert_eq!(Half::of(f32::INFINITY).f32(), f32::INFINITY);
    let mut matrix = BlockMatrix::of_lists(4, 1, |_| (0..4).collect());
    for i in 0..4 {
        for j in 0..4u32 {
            let entry = matrix.entry(i, j);
            matrix.values[entry] =
                if i == j as usize { 4.0 + i as f64 } else { (1.3 * (i as f64 + 4.0 * f64::from(j))).sin() };
        }
    }
    let known = [1.0, -2.0, 0.5, 3.0];
    let right = matrix.times(&known, false);
    let error = |found: Vec<f64>| found.iter().zip(&known).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let single = error(IncompleteLu::<1>::new(&matrix).expect("factors").solve(&right));
    let half = error(IncompleteLu::<1, Half>::new(&matrix).expect("factors").solve(&right));
    assert!(single < 1e-6 && half < 0.03 && half > 1e-4, "{single:e} {half:e}");
}

/// Induced dimension reduction finds the solutions of a matrix that is not symmetric and of one that is indefinite, to the residual that
/// is asked for, in hardly more products than GMRES without a new beginning; and says where there is none.
#[test]
fn induced_dimension_reduction_solves() {
    for (side, shift) in [(12, 0.0), (20, 0.0), (8, 0.7)] {
        let mut matrix = wind(side);
        // Some eigenvalues on the other side of 0.
        for i in 0..side.pow(3) {
            let own = matrix.entry(i, i as u32);
            matrix.values[own] -= shift;
        }
        let known: Vec<f64> = (0..side.pow(3)).map(|i| 1.0 + (0.1 * i as f64).sin()).collect();
        let right = matrix.times(&known, false);
        let factors = IncompleteLu::<1>::new(&matrix).expect("factors");
        let count = std::cell::Cell::new(0);
        let times = |x: &[f64]| {
            count.set(count.get() + 1);
            matrix.times(x, false)
        };
        let precondition = |x: &[f64]| factors.solve(x);
        gmres(&right, 1e-11, 200, &times, &precondition).expect("a solution");
        let least = count.replace(0);
        let found = idr(&right, 1e-11, 400, &times, &precondition).expect("a solution");
        let rest: Vec<f64> = right.iter().zip(matrix.times(&found, false)).map(|(b, y)| b - y).collect();
        assert!(dot(&rest, &rest) <= 1e-22 * dot(&right, &right) * 1.0001, "a residual as small as asked for");
        println!("{side} {shift}: {least} products, {}", count.get());
        assert!(count.get() < 2 * least, "{least} {}", count.get());
        assert!(idr(&right, 1e-11, 5, &times, &precondition).is_none(), "five products are too few");
        assert!(idr(&right, 1e-11, 100, &|x| vec![0.0; x.len()], &precondition).is_none(), "0 x = b");
    }
    assert_eq!(idr(&[0.0; 3], 1e-10, 10, &|x| x.to_vec(), &|x| x.to_vec()), Some(vec![0.0; 3]));
}

/// Terms of both signs over thirty orders of magnitude: the sum is that of whole numbers, forwards, backwards and in parts.
#[test]
fn a_total_does_not_depend_on_the_order() {
    // Multiples of 2^-40 below 2^53 in size: i128 adds them without rounding.
    let whole = |k: i64| -> i128 { i128::from(k * 7_919 % 1_000_003 - 500_000) << (k * 31 % 61) };
    let scale = 0.5f64.powi(40);
    let terms: Vec<f64> = (0..10_000).map(|k| whole(k) as f64 * scale).collect();
    let exact = (0..10_000).map(whole).sum::<i128>() as f64 * scale;
    let forwards: Total = terms.iter().copied().collect();
    let backwards: Total = terms.iter().rev().copied().collect();
    let parts = terms.chunks(333).map(|part| part.iter().copied().collect()).fold(Total::default(), Total::plus);
    for total in [forwards, backwards, parts] {
        assert_eq!(total.value(), exact);
    }
    assert_ne!(terms.iter().sum::<f64>(), exact, "terms whose plain sum is rounded");
}

/// Rows that are made by all threads, each once.
#[test]
fn every_row_is_made_once() {
    let mut made = vec![0; 10_001];
    let shared = Shared::new(&mut made);
    // SAFETY: each row has its own place.
    run_each(10_001, |row| unsafe { shared.set(row, shared.get(row) + row + 1) });
    assert!(made.iter().enumerate().all(|(row, &made)| made == row + 1));
}
