//! Optimisers on functions whose minima are known; resuming between any two evaluations.

use hydrograd::design::cma_es;
use hydrograd::design::limits::Limits;
use hydrograd::design::optimisers::{Adam, BarzilaiBorwein, LBfgsB, Optimiser, Record, TrustRegion};
use hydrograd::design::problem::Evaluation;
use hydrograd::error::Error;
use hydrograd::io::tensor_file::{Data, TensorFile};
use hydrograd::numerics::random::{stream, uniform};

type Function<'a> = &'a dyn Fn(&[f64]) -> (f64, Vec<f64>);

fn rosenbrock(x: &[f64]) -> (f64, Vec<f64>) {
    let (mut value, mut gradient) = (0.0, vec![0.0; x.len()]);
    for k in 0..x.len() - 1 {
        let (a, b) = (x[k + 1] - x[k] * x[k], 1.0 - x[k]);
        value += 100.0 * a * a + b * b;
        gradient[k] += -400.0 * a * x[k] - 2.0 * b;
        gradient[k + 1] += 200.0 * a;
    }
    (value, gradient)
}

/// (x - c).A (x - c) / 2.
fn quadratic<'a>(a: &'a [Vec<f64>], c: &'a [f64]) -> impl Fn(&[f64]) -> (f64, Vec<f64>) + 'a {
    move |x| {
        let z: Vec<f64> = x.iter().zip(c).map(|(x, c)| x - c).collect();
        let gradient: Vec<f64> = a.iter().map(|row| row.iter().zip(&z).map(|(a, z)| a * z).sum()).collect();
        (0.5 * z.iter().zip(&gradient).map(|(z, g)| z * g).sum::<f64>(), gradient)
    }
}

/// A random symmetric matrix whose eigenvalues are at least one.
fn matrix(seed: u64, n: usize) -> Vec<Vec<f64>> {
    let mut random = stream(seed, "matrix");
    let l: Vec<Vec<f64>> = (0..n).map(|_| (0..n).map(|_| 2.0 * uniform(&mut random) - 1.0).collect()).collect();
    let entry = |i: usize, j: usize| (0..n).map(|k| l[i][k] * l[j][k]).sum::<f64>() + f64::from(u8::from(i == j));
    (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect()
}

fn free(n: usize) -> Limits {
    Limits::within(vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n])
}

/// How far a step down the gradient moves x within the limits: zero at a minimum.
fn stationarity(limits: &Limits, x: &[f64], gradient: &[f64]) -> f64 {
    let mut aim: Vec<f64> = x.iter().zip(gradient).map(|(x, g)| x - g).collect();
    limits.nearest(&mut aim);
    aim.iter().zip(x).map(|(a, x)| (a - x).abs()).fold(0.0, f64::max)
}

/// Evaluations until the first point that is stationary to `tolerance`, and that point.
fn minimise(optimiser: &mut LBfgsB, limits: &Limits, f: Function, tolerance: f64) -> (usize, Vec<f64>) {
    for evaluation in 1..=2000 {
        let x = optimiser.ask().to_vec();
        assert!(limits.contains(&x), "{x:?} is outside");
        let (value, gradient) = f(&x);
        if stationarity(limits, &x, &gradient) <= tolerance {
            return (evaluation, x);
        }
        assert!(!optimiser.is_done(), "gave up at {x:?} with {gradient:?} after {evaluation} evaluations");
        optimiser.tell(limits, value, &gradient);
    }
    panic!("no minimum: {optimiser:?}");
}

#[test]
fn rosenbrock_without_bounds() {
    // Measured 49 and 104.
    for (start, most) in [(vec![-1.2, 1.0], 60), ([-1.2, 1.0].repeat(5), 120)] {
        let n = start.len();
        let (evaluations, x) = minimise(&mut LBfgsB::new(0.1, &start), &free(n), &rosenbrock, 1e-8);
        println!("{n} variables: {evaluations} evaluations");
        assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-6), "{x:?}");
        assert!(evaluations <= most, "{evaluations}");
    }
}

#[test]
fn rosenbrock_with_bounds() {
    // x_0 <= 0.5: the minimum over x_1 is x_0^2, and over x_0 it is at the bound.
    let limits = Limits::within(vec![-2.0, -2.0], vec![0.5, 2.0]);
    let (evaluations, x) = minimise(&mut LBfgsB::new(0.1, &[-1.2, 1.0]), &limits, &rosenbrock, 1e-8);
    assert!(x[0] == 0.5 && (x[1] - 0.25).abs() < 1e-8, "{x:?}");
    assert!(evaluations <= 60, "{evaluations}");
}

/// The minimum of a quadratic within bounds by trying every set of active bounds.
fn enumerate(a: &[Vec<f64>], c: &[f64], bound: f64) -> Vec<f64> {
    let n = c.len();
    let f = quadratic(a, c);
    let mut best: Option<(f64, Vec<f64>)> = None;
    for code in 0..3usize.pow(n as u32) {
        // 0: free, 1: at the lower bound, 2: at the upper.
        let of: Vec<usize> = (0..n).map(|k| code / 3usize.pow(k as u32) % 3).collect();
        let mut x: Vec<f64> = of.iter().map(|o| [0.0, -bound, bound][*o]).collect();
        // Gauss-Seidel on the free ones.
        for _ in 0..400 {
            for k in (0..n).filter(|&k| of[k] == 0) {
                let rest: f64 = (0..n).filter(|&j| j != k).map(|j| a[k][j] * (x[j] - c[j])).sum();
                x[k] = c[k] - rest / a[k][k];
            }
        }
        if x.iter().all(|x| x.abs() <= bound) {
            let value = f(&x).0;
            if best.as_ref().is_none_or(|(least, _)| value < *least) {
                best = Some((value, x));
            }
        }
    }
    best.unwrap().1
}

#[test]
fn quadratics_with_bounds_have_the_enumerated_minimum() {
    for seed in 0..20 {
        let n = 5;
        let a = matrix(seed, n);
        let mut random = stream(seed, "centre");
        let c: Vec<f64> = (0..n).map(|_| 2.0 * (2.0 * uniform(&mut random) - 1.0)).collect();
        let exact = enumerate(&a, &c, 0.7);
        assert!(exact.iter().any(|x| x.abs() == 0.7) || seed > 0, "no bound is active");
        let limits = Limits::within(vec![-0.7; n], vec![0.7; n]);
        let (evaluations, x) = minimise(&mut LBfgsB::new(0.1, &vec![0.0; n]), &limits, &quadratic(&a, &c), 1e-9);
        let gap = x.iter().zip(&exact).map(|(x, e)| (x - e).abs()).fold(0.0, f64::max);
        assert!(gap < 1e-8, "seed {seed}: {x:?}, not {exact:?}");
        assert!(evaluations <= 30, "{evaluations}");
    }
}

/// With limits between neighbours: stationary within the whole set, also from a start at its edge.
#[test]
fn quadratics_with_limited_neighbours_are_minimised() {
    for seed in 0..10 {
        let n = 12;
        let a = matrix(seed, n);
        let mut random = stream(seed, "centre");
        let c: Vec<f64> = (0..n).map(|_| 2.0 * uniform(&mut random) - 1.0).collect();
        let positions: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
        let limits = Limits::symmetric(0.6, &positions, 2.0);
        let mut start: Vec<f64> = (0..n).map(|k| if k % 2 == 0 { 0.6 } else { -0.6 }).collect();
        limits.project(&mut start);
        let f = quadratic(&a, &c);
        let (evaluations, x) = minimise(&mut LBfgsB::new(0.1, &start), &limits, &f, 1e-6);
        println!("seed {seed}: {evaluations} evaluations");
        assert!(evaluations <= 60, "{evaluations}");
        // No point of the set near by is better.
        let least = f(&x).0;
        for _ in 0..500 {
            let mut other: Vec<f64> = x.iter().map(|x| x + 0.2 * (2.0 * uniform(&mut random) - 1.0)).collect();
            limits.nearest(&mut other);
            assert!(f(&other).0 >= least - 1e-9);
        }
    }
}

#[test]
fn a_badly_scaled_quadratic_takes_few_steps() {
    // Curvatures from 1 to 1e6; a step per variable would do with exact line searches.
    let n = 7;
    let diagonal = |i: usize| 10f64.powi(i as i32);
    let a: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| if i == j { diagonal(i) } else { 0.0 }).collect()).collect();
    let c = vec![1.0; n];
    let (evaluations, x) = minimise(&mut LBfgsB::new(0.1, &vec![0.0; n]), &free(n), &quadratic(&a, &c), 1e-8);
    println!("{evaluations} evaluations");
    assert!(evaluations <= 60, "{evaluations}");
    assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-7), "{x:?}");
}

/// Every point that is asked for does not depend on the function's unit, and not on the order of the variables.
#[test]
fn units_and_order_do_not_matter() {
    let (n, a) = (6, matrix(4, 6));
    let c: Vec<f64> = (0..n).map(|k| (k as f64).sin()).collect();
    let order = [3, 1, 5, 0, 4, 2];
    let limits = Limits::within(vec![-0.5; n], vec![0.5; n]);
    let f = quadratic(&a, &c);
    let mut plain = LBfgsB::new(0.1, &vec![0.1; n]);
    let mut scaled = plain.clone();
    let mut shuffled = plain.clone();
    for _ in 0..12 {
        let x = plain.ask().to_vec();
        // A power of two changes no digit.
        assert_eq!(x, scaled.ask());
        let theirs = shuffled.ask();
        assert!((0..n).all(|k| (theirs[k] - x[order[k]]).abs() < 1e-9), "{theirs:?}, {x:?}");
        let (value, gradient) = f(&x);
        plain.tell(&limits, value, &gradient);
        scaled.tell(&limits, 4.0 * value, &gradient.iter().map(|g| 4.0 * g).collect::<Vec<_>>());
        shuffled.tell(&limits, value, &order.map(|k| gradient[k]));
    }
}

#[test]
fn values_that_are_no_numbers_are_backed_away_from() {
    // The logarithm ends at 0; the first step goes there.
    let f = |x: &[f64]| (x[0] - x[0].ln(), vec![1.0 - 1.0 / x[0]]);
    let mut optimiser = LBfgsB::new(100.0, &[5.0]);
    let mut met = 0;
    while !optimiser.is_done() {
        let x = optimiser.ask().to_vec();
        let (value, gradient) = f(&x);
        met += usize::from(!value.is_finite());
        optimiser.tell(&free(1), value, &gradient);
    }
    assert!(met > 0, "the test does not test");
    assert!((optimiser.ask()[0] - 1.0).abs() < 1e-7, "{optimiser:?}");
    // Nowhere a number: nothing to do.
    let mut optimiser = LBfgsB::new(0.1, &[0.0]);
    optimiser.tell(&free(1), f64::NAN, &[0.0]);
    assert!(optimiser.is_done() && optimiser.ask() == [0.0]);
    // A number at the start alone: it ends there.
    let mut optimiser = LBfgsB::new(0.1, &[0.0]);
    optimiser.tell(&free(1), 1.0, &[1.0]);
    for _ in 0..200 {
        optimiser.tell(&free(1), f64::INFINITY, &[1.0]);
    }
    assert!(optimiser.is_done() && optimiser.ask() == [0.0]);
}

#[test]
fn small_jumps_do_not_stop_it() {
    // A millionth up and down, as particles that change their number make.
    let f = |x: &[f64]| {
        let (value, gradient) = rosenbrock(x);
        (value + 1e-6 * (1e4 * x[0]).sin().signum(), gradient)
    };
    let mut optimiser = LBfgsB::new(0.1, &[-1.2, 1.0]);
    let mut least = f64::INFINITY;
    for _ in 0..80 {
        let (value, gradient) = f(optimiser.ask());
        least = least.min(value);
        optimiser.tell(&free(2), value, &gradient);
    }
    assert!(least < 1e-4, "{least:e}");
}

/// Saved and restored, as a checkpoint does it.
fn file(optimiser: &dyn Optimiser) -> TensorFile {
    let mut record = Record::default();
    optimiser.save(&mut record);
    TensorFile { path: "checkpoint".into(), tensors: record.tensors, metadata: record.metadata }
}

#[test]
fn every_evaluation_can_be_resumed_from() {
    let positions: Vec<f64> = (0..6).map(|k| 0.5 * k as f64).collect();
    let limits = Limits::symmetric(1.1, &positions, 2.0);
    let f = |x: &[f64]| match x[0] > 0.9 {
        true => (f64::NAN, vec![0.0; x.len()]),
        false => rosenbrock(x),
    };
    let begin = [-1.0, 0.0, 1.0, 0.5, -0.5, 0.3];
    type New = fn(&[f64]) -> Box<dyn Optimiser>;
    let new: [New; 2] = [|x| Box::new(LBfgsB::new(0.3, x)), |x| Box::new(Adam::new(0.05, x))];
    for new in new {
        let (mut whole, mut parts) = (new(&begin), new(&begin));
        for evaluation in 0..60 {
            assert_eq!(whole.ask(), parts.ask(), "{} differs after {evaluation} evaluations", whole.name());
            let (value, gradient) = f(whole.ask());
            whole.tell(&limits, value, &gradient);
            parts.tell(&limits, value, &gradient);
            let mut restored = new(parts.ask());
            restored.restore(&file(&*parts)).unwrap();
            assert_eq!(format!("{restored:?}"), format!("{parts:?}"));
            assert_eq!(whole.is_done(), restored.is_done());
            parts = restored;
        }
    }
}

#[test]
fn broken_records_are_refused() {
    let mut optimiser = LBfgsB::new(0.1, &[0.0, 0.0]);
    for _ in 0..5 {
        let (value, gradient) = rosenbrock(optimiser.ask());
        optimiser.tell(&free(2), value, &gradient);
    }
    let whole = file(&optimiser);
    for name in whole.tensors.keys() {
        let mut broken = whole.clone();
        broken.tensors.remove(name);
        let error = optimiser.clone().restore(&broken).unwrap_err().to_string();
        assert!(error.contains(name.as_str()), "{error}");
    }
    for key in whole.metadata.keys() {
        let mut broken = whole.clone();
        broken.metadata.insert(key.clone(), "-1".into());
        let error = optimiser.clone().restore(&broken).unwrap_err().to_string();
        assert!(error.contains(key.as_str()), "{error}");
    }
    let mut other = LBfgsB::new(0.1, &[0.0; 3]);
    assert!(other.restore(&whole).is_err());
    assert!(Adam::new(0.1, &[0.0, 0.0]).restore(&whole).unwrap_err().to_string().contains("adam.first_moment"));
}

#[test]
fn cma_es_finds_a_minimum_within_limits_and_again() {
    // (x - 3)^2 + (y + 1)^2 over x <= 2: the minimum is at (2, -1).
    let limits = Limits::within(vec![-5.0, -5.0], vec![2.0, 5.0]);
    let mut loss = |x: &[f64]| Ok((x[0] - 3.0).powi(2) + (x[1] + 1.0).powi(2));
    let mut run = || cma_es::search(&[0.0, 0.0], 0.5, 300, 7, &limits, &mut loss).unwrap();
    let seen = run();
    assert!(seen.iter().all(|one| limits.contains(&one.variables)));
    let best = seen.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap();
    assert!((best.variables[0] - 2.0).abs() < 1e-3 && (best.variables[1] + 1.0).abs() < 1e-2, "{best:?}");
    assert_eq!(run(), seen, "the same seed, the same search");
}

#[test]
fn cma_es_follows_a_bent_valley() {
    // Rosenbrock's function in six dimensions: its minimum of 0 is at 1, 1, ...
    let limits = Limits::within(vec![-5.0; 6], vec![5.0; 6]);
    let mut loss =
        |x: &[f64]| Ok(x.windows(2).map(|x| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2)).sum::<f64>());
    let seen = cma_es::search(&[0.0; 6], 0.5, 6000, 3, &limits, &mut loss).unwrap();
    let best = seen.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap();
    assert!(best.loss < 1e-10, "{best:?}");
}

#[test]
fn the_axes_of_cma_es_are_those_of_the_matrix() {
    let matrix = vec![vec![4.0, 1.0, -2.0], vec![1.0, 3.0, 0.5], vec![-2.0, 0.5, 2.0]];
    let (values, vectors) = cma_es::axes(matrix.clone());
    for (value, vector) in values.iter().zip(&vectors) {
        for (row, x) in matrix.iter().zip(vector) {
            let product: f64 = row.iter().zip(vector).map(|(a, b)| a * b).sum();
            assert!((product - value * x).abs() < 1e-13, "{value} {vector:?}");
        }
    }
}

#[test]
fn an_error_ends_cma_es() {
    let limits = Limits::within(vec![-1.0], vec![1.0]);
    let mut calls = 0;
    let mut loss = |x: &[f64]| {
        calls += 1;
        match calls {
            4 => Err(Error::run("no", "nothing")),
            _ => Ok(x[0]),
        }
    };
    assert!(cma_es::search(&[0.5], 0.1, 50, 1, &limits, &mut loss).is_err());
    assert_eq!(calls, 4);
}

#[test]
fn projection_limits_slopes() {
    let limits = Limits::symmetric(0.04, &[0.0, 0.01, 0.02, 0.03], 2.0);
    let mut x = [0.05, -0.05, 0.05, 0.0];
    limits.project(&mut x);
    for k in 1..4 {
        assert!((x[k] - x[k - 1]).abs() <= 0.02, "{x:?}");
    }
    assert_eq!(x[2], 0.04);
    assert!(limits.contains(&x) && !limits.contains(&[0.0, 0.03, 0.0, 0.0]));
}

/// The nearest point p of a convex set is the one with (x - p).(z - p) <= 0 for every z of the set.
#[test]
fn the_nearest_point_is_nearest() {
    let mut random = stream(3, "limits");
    let mut number = |width: f64| width * (2.0 * uniform(&mut random) - 1.0);
    let positions: Vec<f64> = (0..9).map(|k| 0.1 * k as f64).collect();
    let limits = Limits::symmetric(0.5, &positions, 2.0);
    for _ in 0..40 {
        let x: Vec<f64> = (0..9).map(|_| number(1.0)).collect();
        let mut nearest = x.clone();
        limits.nearest(&mut nearest);
        assert!(limits.contains(&nearest));
        limits.check("x", &nearest).unwrap();
        for _ in 0..200 {
            let mut other: Vec<f64> = (0..9).map(|_| number(1.0)).collect();
            limits.project(&mut other);
            let product: f64 = (0..9).map(|k| (x[k] - nearest[k]) * (other[k] - nearest[k])).sum();
            assert!(product < 1e-10, "{product:e}");
        }
        let mut again = nearest.clone();
        limits.nearest(&mut again);
        assert_eq!(again, nearest);
    }
}

#[test]
fn what_is_out_of_the_limits_is_named() {
    let limits = Limits::symmetric(0.02, &[0.0, 0.005, 0.01], 2.0);
    for (values, expected) in [
        ([0.0, f64::NAN, 0.0], "offsets[1] = NaN is not a number"),
        ([0.0, 0.0, 0.03], "offsets[2] = 0.03 is out of bounds"),
        ([0.0, 0.0, 0.012], "too steep between [1] and [2]"),
    ] {
        let error = limits.check("offsets", &values).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    limits.check("offsets", &[0.0, 0.01, 0.02]).unwrap();
}

#[test]
fn the_first_steps_of_adam_by_hand() {
    // The first step is lr * sign(g); the second, with g = (1, -1) then (1, 3), follows from the formulas.
    let mut adam = Adam::new(0.1, &[0.0, 0.0]);
    let limits = free(2);
    adam.tell(&limits, 0.0, &[1.0, -1.0]);
    assert!((adam.ask()[0] + 0.1).abs() < 1e-9 && (adam.ask()[1] - 0.1).abs() < 1e-9);
    adam.tell(&limits, 0.0, &[1.0, 3.0]);
    let (m, v) = ((0.9 * -0.1 + 0.1 * 3.0) / 0.19, (0.999 * 0.001 + 0.001 * 9.0) / (1.0 - 0.999f64.powi(2)));
    assert!((adam.ask()[0] + 0.2).abs() < 1e-9);
    assert!((adam.ask()[1] - (0.1 - 0.1 * m / v.sqrt())).abs() < 1e-9);
}

#[test]
fn adam_finds_the_minimum_of_a_quadratic_within_bounds() {
    let target = [0.3, -5.0, 0.02];
    let limits = Limits::symmetric(1.0, &[0.0, 100.0, 200.0], 2.0);
    let mut adam = Adam::new(0.02, &[0.0; 3]);
    for _ in 0..400 {
        let gradient: Vec<f64> = adam.ask().iter().zip(target).map(|(x, t)| 2.0 * (x - t)).collect();
        adam.tell(&limits, 0.0, &gradient);
    }
    let x = adam.ask();
    assert!((x[0] - 0.3).abs() < 1e-2 && x[1] == -1.0 && (x[2] - 0.02).abs() < 1e-2, "{x:?}");
}

#[test]
fn adam_steps_back_from_where_there_is_no_value() {
    let limits = Limits::symmetric(10.0, &[0.0, 100.0], 2.0);
    let mut adam = Adam::new(0.1, &[1.0, 2.0]);
    adam.tell(&limits, 3.0, &[1.0, -1.0]);
    let away = adam.ask().to_vec();
    adam.tell(&limits, f64::INFINITY, &[0.0, 0.0]);
    assert!((adam.ask()[0] - 0.5 * (1.0 + away[0])).abs() < 1e-15);
    let mut record = Record::default();
    adam.save(&mut record);
    assert_eq!(record.tensors["adam.first_moment"], (vec![2], Data::F64(vec![0.0, 0.0])));
    for _ in 0..60 {
        adam.tell(&limits, f64::NAN, &[0.0, 0.0]);
    }
    assert!((adam.ask()[0] - 1.0).abs() < 1e-12 && (adam.ask()[1] - 2.0).abs() < 1e-12, "{adam:?}");
    adam.tell(&limits, 3.0, &[1.0, 1.0]);
    assert!(adam.ask()[0] < 1.0 && adam.ask()[1] < 2.0, "goes on from there");
}

#[test]
fn barzilai_borwein_finds_the_minimum_of_a_quadratic_of_many_variables() {
    let n = 200;
    let limits = free(n);
    let curvature = |k: usize| 1.0 + 30.0 * k as f64 / n as f64;
    let mut optimiser = BarzilaiBorwein::new(0.1, &vec![0.0; n]);
    for _ in 0..60 {
        let x = optimiser.ask().to_vec();
        let value = (0..n).map(|k| 0.5 * curvature(k) * (x[k] - 1.0).powi(2)).sum();
        let gradient: Vec<f64> = (0..n).map(|k| curvature(k) * (x[k] - 1.0)).collect();
        optimiser.tell(&limits, value, &gradient);
    }
    assert!(optimiser.ask().iter().all(|x| (x - 1.0).abs() < 1e-4), "{:?}", &optimiser.ask()[..3]);
}

#[test]
fn a_step_of_barzilai_borwein_that_is_too_long_is_taken_again() {
    let limits = Limits::within(vec![-9.0], vec![9.0]);
    let mut optimiser = BarzilaiBorwein::new(1.0, &[2.0]);
    optimiser.tell(&limits, 4.0, &[1.0]);
    assert_eq!(optimiser.ask(), [1.0]);
    optimiser.tell(&limits, f64::NAN, &[1.0]);
    assert_eq!(optimiser.ask(), [1.75]);
    optimiser.tell(&limits, 5.0, &[1.0]);
    assert_eq!(optimiser.ask(), [1.9375]);
}

/// f(x) = sum (x - a)^2 + 0.3 sin(3 x), and a model that has half the curvature and another minimum.
fn waves(x: &[f64]) -> Evaluation {
    let term = |x: f64, a: f64| (x - a).powi(2) + 0.3 * (3.0 * x).sin();
    let slope = |x: f64, a: f64| 2.0 * (x - a) + 0.9 * (3.0 * x).cos();
    let loss = term(x[0], 0.4) + term(x[1], -0.2);
    Evaluation { figure: -loss, loss, gradient: vec![slope(x[0], 0.4), slope(x[1], -0.2)], ..Default::default() }
}

fn bowl(x: &[f64]) -> Evaluation {
    let loss = 0.5 * ((x[0] - 1.0).powi(2) + (x[1] - 0.5).powi(2));
    Evaluation { figure: -loss, loss, gradient: vec![x[0] - 1.0, x[1] - 0.5], ..Default::default() }
}

#[test]
fn a_trust_region_finds_the_minimum_with_a_wrong_model() {
    let limits = Limits::within(vec![-1.0, -1.0], vec![1.0, 1.0]);
    let mut region = TrustRegion::new(0.3, 20, &[0.9, 0.9]);
    let mut evaluations = 0;
    for _ in 0..60 {
        region.propose(&limits, |x| Ok(bowl(x))).unwrap();
        if region.is_done() {
            break;
        }
        let found = waves(region.ask());
        evaluations += 1;
        region.tell(&limits, found.loss, &found.gradient);
    }
    let found = waves(region.ask());
    let norm = found.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    assert!(norm < 2e-3, "{evaluations} evaluations: {region:?}");
}

#[test]
fn a_trust_region_shrinks_where_prediction_and_truth_part() {
    let limits = Limits::within(vec![-1.0, -1.0], vec![1.0, 1.0]);
    let mut region = TrustRegion::new(0.3, 20, &[0.9, 0.9]);
    region.tell(&limits, 1.0, &[1.0, 0.0]);
    region.propose(&limits, |x| Ok(bowl(x))).unwrap();
    let asked = region.ask().to_vec();
    assert!(asked[0] < 0.9 && region.expectation().unwrap() < 1.0);
    let step = (0.9 - asked[0]).abs().max((0.9 - asked[1]).abs());
    region.tell(&limits, 2.0, &[1.0, 0.0]);
    assert!(region.ask() == [0.9, 0.9] && (region.radius() - 0.5 * step).abs() < 1e-12);
    // A point without a value is rejected.
    region.propose(&limits, |x| Ok(bowl(x))).unwrap();
    region.tell(&limits, f64::INFINITY, &[0.0, 0.0]);
    assert!(region.radius() < 0.5 * step);
    let mut record = Record::default();
    region.save(&mut record);
    assert_eq!(record.tensors["trust_region.numbers"], (vec![2], Data::F64(vec![1.0, region.radius()])));
}
