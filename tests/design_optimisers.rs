//! Optimisers on functions whose minima are known; resuming between any two evaluations.

use hydrograd::design::limits::Limits;
use hydrograd::design::optimisers::{Adam, LBfgsB, Optimiser, Record};
use hydrograd::io::tensor_file::TensorFile;
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
