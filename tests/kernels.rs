//! Every smoothing kernel in every kind of lanes: against JAX-SPH, against central differences, at its knots.

use crate::support::jax_sph::{number, reference_file};
use crate::support::lanes::{each_lane_type, Visit};
use candle_core::{Device, Tensor};
use hydrograd::numerics::exponential::exponential;
use hydrograd::numerics::lanes::{Lanes, PortableF64, Real};
use hydrograd::sph::kernels::{Kernel, KernelName};
use hydrograd::surrogate::network::row::{activate, add_rows, each, sum};
use std::sync::Mutex;

/// W, F and G at distances, through one lane type.
struct Values {
    w: Vec<f64>,
    f: Vec<f64>,
    g: Vec<f64>,
}

fn values<L: Lanes>(kernel: &Kernel, distances: &[f64]) -> Values {
    let lanes = kernel.lanes::<L>();
    let mut all = Values { w: vec![], f: vec![], g: vec![] };
    for chunk in distances.chunks(L::COUNT) {
        // A short last chunk repeats its last distance.
        let padded: Vec<L::Real> =
            (0..L::COUNT).map(|k| L::Real::of(chunk[k.min(chunk.len() - 1)])).map(|r| r * r).collect();
        // SAFETY: `padded` holds COUNT numbers.
        let r2 = unsafe { L::load(padded.as_ptr()) };
        let (w, f, g) = lanes.all(r2);
        for (to, from) in [(&mut all.w, w), (&mut all.f, f), (&mut all.g, g)] {
            to.extend(read(from).into_iter().take(chunk.len()));
        }
        assert!(read(lanes.value(r2)) == read(w) && read(lanes.slope(r2)) == read(f), "alone and together");
    }
    all
}

fn read<L: Lanes>(lanes: L) -> Vec<f64> {
    let mut numbers = vec![L::Real::default(); L::COUNT];
    // SAFETY: `numbers` has room for COUNT numbers.
    unsafe { lanes.store(numbers.as_mut_ptr()) };
    numbers.into_iter().map(|x| x.f64()).collect()
}

/// How a lane type computes a kernel.
struct Type {
    name: String,
    /// Rounding error of its numbers.
    epsilon: f64,
    values: Vec<Values>,
}

/// The values of a kernel at lists of distances, by every lane type that this processor can run.
fn by_every_type(kernel: &Kernel, distances: &[&[f64]]) -> Vec<Type> {
    struct Evaluate<'a>(&'a Kernel, &'a [&'a [f64]], Mutex<Vec<Type>>);
    impl Visit for Evaluate<'_> {
        fn visit<L: Lanes>(&self, name: &str, epsilon: f64) {
            let values = self.1.iter().map(|distances| values::<L>(self.0, distances)).collect();
            self.2.lock().unwrap().push(Type { name: name.into(), epsilon, values });
        }
    }
    let evaluate = Evaluate(kernel, distances, Mutex::new(vec![]));
    each_lane_type(&evaluate);
    evaluate.2.into_inner().unwrap()
}

/// The shapes, JAX-SPH's name of each, where their formulas change (the support last), and whether they are cut off there:
/// the others go to zero.
const SHAPES: [(KernelName, &str, &[f64], bool); 7] = [
    (KernelName::QuinticSpline, "QuinticKernel", &[1.0, 2.0, 3.0], false),
    (KernelName::CubicSpline, "CubicKernel", &[1.0, 2.0], false),
    (KernelName::WendlandC2, "WendlandC2Kernel", &[2.0], false),
    (KernelName::WendlandC4, "WendlandC4Kernel", &[2.0], false),
    (KernelName::WendlandC6, "WendlandC6Kernel", &[2.0], false),
    (KernelName::Gaussian, "GaussianKernel", &[3.0], true),
    (KernelName::SuperGaussian, "SuperGaussianKernel", &[3.0], true),
];

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, x| m.max(x.abs()))
}

/// Asserts |a - b| <= tolerance * max |b|, place by place.
fn close(what: &str, a: &[f64], b: &[f64], tolerance: f64) {
    let allowed = tolerance * largest(b);
    assert_eq!(a.len(), b.len());
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= allowed, "{what}, place {k}: {a:e} is not {b:e} (allowed {allowed:e})");
    }
}

#[test]
fn agrees_with_jax_sph() {
    let path = reference_file("HYDROGRAD_JAX_SPH_KERNELS", "jax-sph-kernels.h5");
    let file = hdf5::File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut compared = 0;
    for group in ["h1", "h002"] {
        let group = file.group(group).unwrap();
        let h = number(&group, "h");
        let q = group.dataset("q").unwrap().read_raw::<f64>().unwrap();
        for (shape, theirs, dimension) in SHAPES.iter().flat_map(|s| (1..=3).map(move |d| (s.0, s.1, d))) {
            // In one dimension Wendland's are other functions of the same smoothness (src/sph/kernels/wendland.rs).
            if dimension == 1 && theirs.starts_with("Wendland") {
                continue;
            }
            let cut = SHAPES.iter().any(|s| s.0 == shape && s.3);
            // What is cut off at 3 h still counts there in JAX-SPH and no longer here; h q / h may be to either side.
            let kept: Vec<usize> = (0..q.len()).filter(|&k| !cut || (q[k] - 3.0).abs() > 1e-12).collect();
            let select = |all: Vec<f64>| -> Vec<f64> { kept.iter().map(|&k| all[k]).collect() };
            let distance = select(q.iter().map(|q| q * h).collect());
            let theirs = group.group(&format!("{theirs}_{dimension}d")).unwrap();
            let kernel = Kernel::new(shape, dimension, h);
            assert!((kernel.cutoff() - number(&theirs, "cutoff")).abs() < 1e-15);
            assert_eq!(kernel.cutoff(), shape.support() * h);
            let w = select(theirs.dataset("w").unwrap().read_raw::<f64>().unwrap());
            let slope = select(theirs.dataset("grad_w").unwrap().read_raw::<f64>().unwrap());
            assert!((kernel.at_zero() / w[0] - 1.0).abs() < 1e-14);
            for Type { name, epsilon, values } in by_every_type(&kernel, &[&distance]) {
                let ours = &values[0];
                // Their w' loses digits near 0 (a difference of numbers of size 100), so it is compared as w' = F d.
                let ours_slope: Vec<f64> = ours.f.iter().zip(&distance).map(|(f, d)| f * d).collect();
                let name = format!("{shape:?}, {name}, {dimension}D, h = {h}");
                close(&format!("W, {name}"), &ours.w, &w, 20.0 * epsilon);
                close(&format!("W', {name}"), &ours_slope, &slope, 50.0 * epsilon);
                compared += 1;
            }
        }
    }
    assert!(compared >= 72, "only {compared} comparisons");
}

/// Distances in spacings that avoid the knots, where one-sided formulas change.
fn sweep() -> Vec<f64> {
    (1..320).map(|k| k as f64 * 0.01 + 0.0037).collect()
}

#[test]
fn slopes_are_derivatives() {
    for (shape, dimension) in SHAPES.iter().flat_map(|s| (1..=3).map(move |d| (s.0, d))) {
        let h = 0.02;
        let kernel = Kernel::new(shape, dimension, h);
        let step = 1e-4 * h;
        let distance: Vec<f64> = sweep().iter().map(|q| q * h).collect();
        // Fourth-order central differences.
        let derivative = |of: fn(&Values) -> &Vec<f64>| -> Vec<f64> {
            let at = |offset: f64| {
                let moved: Vec<f64> = distance.iter().map(|d| d + offset * step).collect();
                of(&values::<PortableF64>(&kernel, &moved)).clone()
            };
            let (a, b, c, d) = (at(-2.0), at(-1.0), at(1.0), at(2.0));
            (0..distance.len()).map(|k| (a[k] - 8.0 * b[k] + 8.0 * c[k] - d[k]) / (12.0 * step)).collect()
        };
        let (w_slope, f_slope) = (derivative(|v| &v.w), derivative(|v| &v.f));
        for Type { name, epsilon, values } in by_every_type(&kernel, &[&distance]) {
            let ours = &values[0];
            let times_distance = |x: &[f64]| -> Vec<f64> { x.iter().zip(&distance).map(|(x, d)| x * d).collect() };
            let name = format!("{shape:?}, {name}, {dimension}D");
            close(&format!("F d, {name}"), &times_distance(&ours.f), &w_slope, (100.0 * epsilon).max(1e-10));
            close(&format!("G d, {name}"), &times_distance(&ours.g), &f_slope, (300.0 * epsilon).max(1e-10));
        }
    }
}

#[test]
fn no_jump_at_the_knots_and_nothing_behind_the_cutoff() {
    for (shape, knots, cut) in SHAPES.map(|s| (s.0, s.2, s.3)) {
        let kernel = Kernel::new(shape, 2, 1.0);
        let outside = [1.00004, 1.1, 2.0, 10.0].map(|x| x * shape.support());
        // A distance to either side of a knot, by the rounding of each type.
        let sides = |epsilon: f64| {
            knots.iter().flat_map(move |&k| [1.0 - 4.0 * epsilon, 1.0, 1.0 + 4.0 * epsilon].map(|x| k * x))
        };
        let (double, single): (Vec<f64>, Vec<f64>) =
            (sides(f64::EPSILON).collect(), sides(f32::EPSILON as f64).collect());
        for Type { name, epsilon, values } in by_every_type(&kernel, &[&[0.0], &outside, &double, &single]) {
            let name = format!("{shape:?}, {name}");
            // F and G are finite at distance 0: the self pair and the padding have it.
            let (w, f, g) = (values[0].w[0], values[0].f[0].abs(), values[0].g[0].abs());
            assert!(w > 0.0 && f > 0.0 && g > 0.0 && (w + f + g).is_finite(), "{name}: {w} {f} {g} at 0");
            let sides = &values[if epsilon == f64::EPSILON { 2 } else { 3 }];
            for (k, &knot) in knots.iter().enumerate() {
                let [w_side, f_side, g_side] = [&sides.w, &sides.f, &sides.g].map(|all| &all[3 * k..3 * k + 3]);
                // A Gaussian that is cut off jumps to zero from exp(-9), the super-Gaussian from that times 2 - 9.
                let cut_off =
                    kernel.sigma * (-9.0f64).exp() * if shape == KernelName::SuperGaussian { -7.0 } else { 1.0 };
                if cut {
                    let jump = w_side[0] - cut_off;
                    assert!(jump.abs() <= 200.0 * epsilon * cut_off.abs(), "{name}: {} before the cut-off", w_side[0]);
                    assert_eq!((w_side[2], f_side[2], g_side[2]), (0.0, 0.0, 0.0), "{name}");
                    continue;
                }
                for (what, side, scale) in [("W", w_side, w), ("F", f_side, f), ("G", g_side, g)] {
                    let jump = (side[0] - side[1]).abs().max((side[2] - side[1]).abs());
                    assert!(jump <= 100.0 * epsilon * scale, "{name}: {what} jumps by {jump:e} at q = {knot}");
                }
            }
            for x in values[1].w.iter().chain(&values[1].f).chain(&values[1].g) {
                assert_eq!(x.abs(), 0.0, "{name}: {x:e} behind the cut-off");
            }
        }
    }
}

/// In 3D the constant in use of the quintic spline, 3/(359 pi), is JAX-SPH's and most papers', and 360/359 of the exact
/// 1/(120 pi): kept, so that results can be compared. The Gaussians lack what is cut off: with erf(3) in one dimension,
/// and by parts in the others; the super-Gaussian's surplus is the derivative of q^D exp(-q^2)/2.
#[test]
fn integrates_to_one() {
    let h = 0.02;
    for shape in SHAPES.map(|s| s.0) {
        let step = shape.support() * h / 3000.0;
        let distance: Vec<f64> = (0..3000).map(|k| (k as f64 + 0.5) * step).collect();
        for dimension in 1..=3 {
            let w = values::<PortableF64>(&Kernel::new(shape, dimension, h), &distance).w;
            let shell = |r: f64| match dimension {
                1 => 2.0,
                2 => std::f64::consts::TAU * r,
                _ => 2.0 * std::f64::consts::TAU * r * r,
            };
            let sum: f64 = w.iter().zip(&distance).map(|(w, r)| w * shell(*r) * step).sum();
            let (erf_3, tail, pi) = (0.999_977_909_503_001_4, (-9.0f64).exp(), std::f64::consts::PI);
            let bell = [erf_3, 1.0 - tail, erf_3 - 6.0 / pi.sqrt() * tail][dimension - 1];
            let expected = match shape {
                KernelName::QuinticSpline if dimension == 3 => 360.0 / 359.0,
                KernelName::Gaussian => bell,
                KernelName::SuperGaussian => {
                    bell + 0.5 * shell(1.0) * 3f64.powi(dimension as i32) * tail / pi.powf(0.5 * dimension as f64)
                }
                _ => 1.0,
            };
            assert!((sum - expected).abs() < 1e-6, "{shape:?}, {dimension}D: {sum} is not {expected}");
        }
    }
}

/// The composed form, and one pair at a time, against the lanes.
#[test]
fn all_forms_agree() {
    let h = 0.02;
    let distance: Vec<f64> = sweep().iter().map(|q| q * h).collect();
    let tensor = Tensor::new(distance.clone(), &Device::Cpu).unwrap();
    for (shape, dimension) in SHAPES.iter().flat_map(|s| (2..=3).map(move |d| (s.0, d))) {
        let kernel = Kernel::new(shape, dimension, h);
        let lanes = values::<PortableF64>(&kernel, &distance);
        let (w, f) = kernel.composed(&tensor).unwrap();
        close(&format!("composed W, {shape:?}"), &w.to_vec1::<f64>().unwrap(), &lanes.w, 1e-14);
        close(&format!("composed F, {shape:?}"), &f.to_vec1::<f64>().unwrap(), &lanes.f, 1e-13);
        let (w, f): (Vec<f64>, Vec<f64>) = distance.iter().map(|d| kernel.pair(d * d)).unzip();
        close(&format!("W of a pair, {shape:?}"), &w, &lanes.w, 1e-15);
        close(&format!("F of a pair, {shape:?}"), &f, &lanes.f, 1e-15);
    }
}

#[test]
fn instruction_sets_agree() {
    let distance: Vec<f64> = sweep().iter().map(|q| q * 0.02).collect();
    for shape in SHAPES.map(|s| s.0) {
        let kernel = Kernel::new(shape, 2, 0.02);
        let exact = values::<PortableF64>(&kernel, &distance);
        for Type { name, epsilon, values } in by_every_type(&kernel, &[&distance]) {
            let (ours, name) = (&values[0], format!("{shape:?}, {name}"));
            close(&format!("W, {name}"), &ours.w, &exact.w, 20.0 * epsilon);
            close(&format!("F, {name}"), &ours.f, &exact.f, 20.0 * epsilon);
            close(&format!("G, {name}"), &ours.g, &exact.g, 60.0 * epsilon);
        }
    }
}

/// e^x in every kind of lanes against the standard library's, over all that it promises.
#[test]
fn exponential_is_exact_to_rounding() {
    fn worst<L: Lanes>(end: f64) -> f64 {
        let mut worst: f64 = 0.0;
        for k in 0..40_000 {
            // A dense sweep around the Gaussians' range, a wide one to the ends.
            let x = if k < 20_000 { -9.5 + 5e-4 * k as f64 } else { end * (1e-4 * (k - 30_000) as f64) };
            let x = L::Real::of(x);
            let found = read(exponential(L::splat(x)))[0];
            worst = worst.max((found / x.f64().exp() - 1.0).abs());
        }
        // Beyond the ends nothing but their values; whole powers exactly.
        for (far, near) in [(-2.0, -1.0), (-1e30, -1.0), (2.0, 1.0), (1e30, 1.0)] {
            let of = |x: f64| read(exponential(L::splat(L::Real::of(x * end))))[0];
            assert_eq!(of(far), of(near));
        }
        for n in [-126.0, -13.0, -1.0, 0.0, 1.0, 7.0, 127.0] {
            assert_eq!(read(L::splat(L::Real::of(n)).power_of_two())[0], 2f64.powf(n));
        }
        worst
    }
    struct Exponential;
    impl Visit for Exponential {
        fn visit<L: Lanes>(&self, name: &str, epsilon: f64) {
            // An f32's exponential in f64 is exact beside it.
            let (end, allowed) = if epsilon == f64::EPSILON { (700.0, 1e-15) } else { (87.0, 1e-7) };
            let worst = worst::<L>(end);
            println!("{name}: {worst:.1e}");
            assert!(worst <= allowed, "{name}: {worst:e}");
        }
    }
    each_lane_type(&Exponential);
}

/// The lanes' own arithmetic, against plain numbers.
#[test]
fn lanes_compute_what_numbers_compute() {
    fn check<L: Lanes>(name: &str) {
        let number = |x: f64| L::Real::of(x);
        let a: Vec<L::Real> = (0..L::COUNT).map(|k| number(k as f64 * 0.75 - 2.0)).collect();
        let b: Vec<L::Real> = (0..L::COUNT).map(|k| number(1.5 - k as f64 * 0.25)).collect();
        // SAFETY: both hold COUNT numbers.
        let (x, y) = unsafe { (L::load(a.as_ptr()), L::load(b.as_ptr())) };
        let expect = |what: &str, lanes: L, f: &dyn Fn(f64, f64) -> f64| {
            let plain: Vec<f64> = a.iter().zip(&b).map(|(a, b)| number(f(a.f64(), b.f64())).f64()).collect();
            assert_eq!(read(lanes), plain, "{name}: {what}");
        };
        expect("add", x + y, &|a, b| a + b);
        expect("sub", x - y, &|a, b| a - b);
        expect("mul", x * y, &|a, b| a * b);
        expect("div", x / (y * y + L::splat(number(1.0))), &|a, b| a / (b * b + 1.0));
        expect("neg", -x, &|a, _| 0.0 - a);
        expect("mul_add", x.mul_add(y, x), &|a, b| a * b + a);
        expect("sqrt", (x * x).sqrt(), &|a, _| a.abs());
        expect("positive", x.positive(), &|a, _| a.max(0.0));
        expect("round", x.round(), &|a, _| a.round_ties_even());
        expect("select_less", x.select_less(y, x, y), &|a, b| if a < b { a } else { b });
        assert_eq!(read(L::ramp()), (0..L::COUNT).map(|k| k as f64).collect::<Vec<f64>>(), "{name}: ramp");
        let sum: f64 = a.iter().map(|a| a.f64()).sum();
        assert_eq!(x.sum().f64(), sum, "{name}: sum");
        // Records of 8, entered at 2: field q of record r is 100 r + q.
        let records: Vec<L::Real> = (0..8 * 20).map(|k| number((k / 8 * 100 + k % 8) as f64)).collect();
        let index: Vec<u32> = (0..L::COUNT as u32).map(|k| (k * 7 + 3) % 20).collect();
        // SAFETY: every index is below the 20 records.
        let (four, one) = unsafe {
            (L::gather4(records.as_ptr().add(2), 8, index.as_ptr()), L::gather(records.as_ptr(), index.as_ptr()))
        };
        for (q, lanes) in four.into_iter().enumerate() {
            let plain: Vec<f64> = index.iter().map(|&r| (100 * r) as f64 + 2.0 + q as f64).collect();
            assert_eq!(read(lanes), plain, "{name}: gather4, field {q}");
        }
        let plain: Vec<f64> = index.iter().map(|&r| records[r as usize].f64()).collect();
        assert_eq!(read(one), plain, "{name}: gather");
    }
    struct Arithmetic;
    impl Visit for Arithmetic {
        fn visit<L: Lanes>(&self, name: &str, _: f64) {
            check::<L>(name);
        }
    }
    each_lane_type(&Arithmetic);
}

/// Loops over rows of numbers, of every length around the widths of the lanes, against plain loops.
#[test]
fn rows_of_every_length() {
    struct Rows;
    impl Visit for Rows {
        fn visit<L: Lanes>(&self, _: &str, _: f64) {
            check_rows::<L>();
        }
    }
    each_lane_type(&Rows);
}

fn check_rows<L: Lanes>() {
    for length in [1, 2, 3, 4, 7, 8, 9, 15, 16, 17, 31, 32, 33, 64, 100, 128] {
        let numbers = |shift: f64| -> Vec<L::Real> {
            (0..length).map(|c| L::Real::of(((c as f64 * 0.7 + shift).sin() * 64.0).round() / 8.0)).collect()
        };
        let (mut x, a, b) = (numbers(0.1), numbers(1.3), numbers(2.9));
        let product: f64 = a.iter().zip(&b).map(|(a, b)| (a.f64() + 1.0) * (b.f64() - 2.0)).sum();
        let one = L::splat(L::Real::of(1.0));
        // Multiples of 1/8 below 10: both are exact.
        assert_eq!(sum::<L>(&a, &b, |a, b| (a + one) * (b - one - one)).f64(), product, "{length}");
        let wanted: Vec<f64> = (0..length).map(|c| x[c].f64() + a[c].f64() * b[c].f64()).collect();
        each::<L, 2>(&mut x, [&a, &b], |x, [a, b]| x + a * b);
        assert_eq!(x.iter().map(|x| x.f64()).collect::<Vec<_>>(), wanted);
        let mut rows = [a.clone(), b.clone()].concat();
        activate::<L>(&mut rows, &a);
        let wanted: Vec<f64> =
            [&a, &b].iter().flat_map(|r| r.iter().zip(&a)).map(|(x, b)| (x.f64() + b.f64()).max(0.0)).collect();
        assert_eq!(rows.iter().map(|x| x.f64()).collect::<Vec<_>>(), wanted);
        let mut total = a.clone();
        add_rows::<L, 2>(&mut total, [&rows, &[b.clone(), a.clone()].concat()], |[x, y]| x * y);
        for c in 0..length {
            let products = rows[c].f64() * b[c].f64() + rows[length + c].f64() * a[c].f64();
            assert_eq!(total[c].f64(), a[c].f64() + products);
        }
    }
}
