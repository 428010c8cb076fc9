//! Fixed particles on the lattice of a periodic box.

use hydrograd::config::method::fixed::Derivatives;
use hydrograd::numerics::random::{stream, uniform};
use hydrograd::sph::lattice::adjoint::{pull_back, MEMORY};
use hydrograd::sph::lattice::equations::{Equations, Materials, State};
use hydrograd::sph::lattice::march::{run, Control, Diverged};
use hydrograd::sph::lattice::symbols::Weights;
use hydrograd::sph::lattice::transform::Transform;
use hydrograd::sph::laws::buoyancy::Buoyancy;
use std::f64::consts::{PI, TAU};

const BOTH: [Derivatives; 2] = [Derivatives::Fits, Derivatives::Spectral];

fn materials(d: usize, viscosity: f64) -> Materials {
    Materials { viscosity, diffusivity: None, force: vec![0.0; d], buoyancy: None }
}

/// A box whose sides are 2 pi times the first ones over the number of particles of the first.
fn equations(shape: &[usize], materials: Materials, derivatives: Derivatives) -> Equations {
    let dx = TAU / shape[0] as f64;
    let size: Vec<f64> = shape.iter().map(|&n| n as f64 * dx).collect();
    Equations::new(shape, &size, materials, derivatives)
}

/// The places of all particles.
fn places(shape: &[usize], dx: f64) -> Vec<Vec<f64>> {
    let count: usize = shape.iter().product();
    (0..count)
        .map(|i| {
            let mut rest = i;
            let mut place: Vec<f64> = shape.iter().rev().map(|n| (rest % n, rest /= n).0 as f64 * dx).collect();
            place.reverse();
            place
        })
        .collect()
}

fn field(shape: &[usize], dx: f64, of: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    places(shape, dx).iter().map(|place| of(place)).collect()
}

/// A smooth flow of several modes that is no exact solution, with a mean.
fn swirl(shape: &[usize], dx: f64) -> Vec<Vec<f64>> {
    let stretch: Vec<f64> = shape.iter().map(|&n| TAU / (n as f64 * dx)).collect();
    let z = |p: &[f64]| p.get(2).map_or(0.0, |z| z * stretch[2]);
    let u = |p: &[f64]| {
        let (x, y, z) = (p[0] * stretch[0], p[1] * stretch[1], z(p));
        [
            0.3 + x.sin() * y.cos() + 0.4 * (2.0 * y + z).cos(),
            -0.1 - x.cos() * y.sin() * z.cos() + 0.3 * (2.0 * x - z).sin(),
            0.5 * (x + y).sin() - 0.2 * z.sin() * x.cos(),
        ]
    };
    (0..shape.len()).map(|a| field(shape, dx, |p| u(p)[a])).collect()
}

fn control(tolerance: f64) -> Control {
    Control { tolerance, velocity: 1.0, temperature: 1.0, fixed: None }
}

fn to_end(equations: &Equations, first: &State, end: f64, control: &Control) -> (State, Vec<f64>) {
    let mut last = first.clone();
    let sizes = run::<Diverged>(equations, first.clone(), &[end], control, &mut |_, state| {
        last.clone_from(state);
        Ok(())
    });
    (last, sizes.unwrap())
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

fn largest(a: &[f64]) -> f64 {
    a.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

fn taylor_green(equations: &Equations) -> Vec<Vec<f64>> {
    let (shape, dx) = (&equations.transform.shape, equations.dx);
    let z = |p: &[f64]| p.get(2).map_or(1.0, |z| z.cos());
    let mut all = vec![
        field(shape, dx, |p| p[0].sin() * p[1].cos() * z(p)),
        field(shape, dx, |p| -p[0].cos() * p[1].sin() * z(p)),
    ];
    all.resize(shape.len(), vec![0.0; all[0].len()]);
    all
}

#[test]
fn transforms_are_sums_over_all_particles() {
    for shape in [vec![6, 5], vec![5, 8], vec![4, 3, 6]] {
        let transform = Transform::new(&shape);
        let mut random = stream(3, "lattice");
        let values: Vec<f64> = (0..transform.points()).map(|_| uniform(&mut random)).collect();
        let other: Vec<f64> = (0..transform.points()).map(|_| uniform(&mut random)).collect();
        let spectrum = transform.forwards(values.clone());
        // A mode as a plain sum.
        let m: Vec<usize> = shape.iter().map(|n| n / 2).collect();
        let mode = m
            .iter()
            .zip(&shape)
            .enumerate()
            .fold(0, |at, (a, (m, n))| at * if a + 1 == shape.len() { n / 2 + 1 } else { *n } + m);
        let (mut re, mut im) = (0.0, 0.0);
        for (place, value) in places(&shape, 1.0).iter().zip(&values) {
            let phase: f64 = (0..shape.len()).map(|a| -TAU * m[a] as f64 * place[a] / shape[a] as f64).sum();
            re += value * phase.cos();
            im += value * phase.sin();
        }
        assert!((spectrum[mode].re - re).abs() + (spectrum[mode].im - im).abs() < 1e-12, "{shape:?}");
        assert!(rms(&transform.back(spectrum.clone()), &values) < 1e-15);
        let product: f64 = values.iter().zip(&other).map(|(a, b)| a * b).sum();
        let found = transform.product(&spectrum, &transform.forwards(other), |_| 1.0);
        assert!((found / product - 1.0).abs() < 1e-13);
    }
}

#[test]
fn fits_on_a_lattice_are_central_differences() {
    // In one dimension the fit goes through all five points. In more, sums over the other directions do the same, as fields are
    // that change along one direction only.
    let first = [1.0 / 12.0, -8.0 / 12.0, 0.0, 8.0 / 12.0, -1.0 / 12.0];
    let second = [-1.0 / 12.0, 16.0 / 12.0, 0.0, 16.0 / 12.0, -1.0 / 12.0];
    for d in 1..=3 {
        let weights = Weights::of_fits(d);
        assert_eq!(weights.places.len(), 5usize.pow(d as u32) - 1);
        for a in 0..d {
            let sum = |of: &[f64], at: isize| -> f64 {
                let places = of.iter().zip(&weights.places);
                places.filter(|(_, r)| r[a] == at).map(|(w, _)| w).sum()
            };
            for at in [-2, -1, 1, 2isize] {
                let k = (at + 2) as usize;
                assert!((sum(&weights.first[a], at) - first[k]).abs() < 1e-12, "d = {d}, {at}");
                // Sums of the Laplacian's weights have those of the other directions in them, which are of other places.
                if d == 1 {
                    assert!((sum(&weights.laplacian, at) - second[k]).abs() < 1e-12, "{at}");
                }
            }
        }
    }
}

#[test]
fn derivatives_of_fits_are_of_fourth_order() {
    for shape in [[16, 16], [32, 32], [24, 40]] {
        let of = |kind| equations(&shape, materials(2, 1.0), kind).symbols;
        let (fits, exact) = (of(Derivatives::Fits), of(Derivatives::Spectral));
        let half = shape[1] / 2 + 1;
        // Of a mode with few particles in a wave the error is 2^-4 as large with twice as many.
        for (m, limit) in [([1, 2], 1.0), ([3, 1], 1.0)] {
            let mode = m[0] * half + m[1];
            let h = TAU / shape[0] as f64;
            let k = [exact.first[0][mode], exact.first[1][mode]];
            let order = (h * k[0].abs().max(k[1].abs())).powi(4);
            for a in 0..2 {
                let error = (fits.first[a][mode] / k[a] - 1.0).abs();
                assert!(error < 0.2 * limit * order, "{shape:?} {m:?}: {error} of {order}");
            }
            let error = (fits.laplacian[mode] / exact.laplacian[mode] - 1.0).abs();
            assert!(error < 0.1 * order && error > 0.0, "{shape:?} {m:?}: {error} of {order}");
        }
    }
}

#[test]
fn taylor_green_decays_as_it_should() {
    // The exact solution is reached to rounding by exact derivatives, and with fourth order by fits.
    let mut errors = vec![];
    for (n, kind) in [(16, Derivatives::Fits), (32, Derivatives::Fits), (16, Derivatives::Spectral)] {
        let flow = equations(&[n, n], materials(2, 0.05), kind);
        let start = taylor_green(&flow);
        let (end, _) = to_end(&flow, &flow.state(&start), 2.0, &control(1e-6));
        let found = flow.at_particles(&end);
        let decay = (-2.0 * 0.05 * 2.0f64).exp();
        errors.push(rms(&found[0], &start[0].iter().map(|u| u * decay).collect::<Vec<f64>>()));
        // The pressure of the flow: (cos 2x + cos 2y) / 4.
        if kind == Derivatives::Spectral {
            let exact = field(&[n, n], flow.dx, |p| 0.25 * decay * decay * ((2.0 * p[0]).cos() + (2.0 * p[1]).cos()));
            assert!(rms(&flow.pressure(&end), &exact) < 1e-12);
        }
    }
    let order = (errors[0] / errors[1]).log2();
    assert!(order > 3.5, "{errors:?}: order {order}");
    assert!(errors[1] < 2e-5 && errors[2] < 1e-13, "{errors:?}");
}

#[test]
fn fields_converge_with_the_spacing() {
    // Against exact derivatives on a finer lattice: fits with fourth order, and far better on the same lattice without them.
    let end = 0.5;
    let run = |n: usize, kind| {
        let flow = equations(&[n, n], materials(2, 0.01), kind);
        let (state, _) = to_end(&flow, &flow.state(&swirl(&[n, n], flow.dx)), end, &control(1e-8));
        let fields = flow.at_particles(&state);
        // At the particles of the coarsest lattice.
        let every = n / 16;
        (0..256).map(|i| fields[0][(i / 16 * every) * n + i % 16 * every]).collect::<Vec<f64>>()
    };
    let exact = run(96, Derivatives::Spectral);
    let fits = [16, 32, 48].map(|n| rms(&run(n, Derivatives::Fits), &exact));
    let order = (fits[1] / fits[2]).ln() / 1.5f64.ln();
    assert!(order > 3.5 && fits[0] / fits[1] > 9.0, "{fits:?}: order {order}");
    let spectral = [16, 32].map(|n| rms(&run(n, Derivatives::Spectral), &exact));
    assert!(spectral[0] < 0.05 * fits[0] && spectral[1] < 1e-4 * fits[1], "{spectral:?} against {fits:?}");
}

#[test]
fn steps_are_of_fourth_order_and_keep_to_their_tolerance() {
    let flow = equations(&[24, 24], materials(2, 0.02), Derivatives::Spectral);
    let first = flow.state(&swirl(&[24, 24], flow.dx));
    let with = |size: f64| {
        let fixed = Control { fixed: Some(size), ..control(1.0) };
        flow.at_particles(&to_end(&flow, &first, 1.0, &fixed).0)[0].clone()
    };
    let exact = with(0.005);
    let errors = [0.1, 0.05, 0.025].map(|size| rms(&with(size), &exact));
    let order = (errors[1] / errors[2]).log2();
    assert!(order > 3.8, "{errors:?}");
    for tolerance in [1e-4, 1e-6, 1e-8] {
        let (end, sizes) = to_end(&flow, &first, 1.0, &control(tolerance));
        let error = rms(&flow.at_particles(&end)[0], &exact);
        // The estimate is that of a result of third order.
        assert!(error < tolerance * sizes.len() as f64, "{error} with {tolerance}, {} steps", sizes.len());
        assert!((sizes.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn without_viscosity_energy_and_momentum_stay() {
    for (shape, kind) in
        [(vec![16, 16], BOTH[0]), (vec![15, 18], BOTH[1]), (vec![8, 9, 8], BOTH[0]), (vec![8, 8, 8], BOTH[1])]
    {
        let mut own = materials(shape.len(), 0.0);
        own.diffusivity = Some(0.0);
        let flow = equations(&shape, own, kind);
        let mut random = stream(5, "lattice");
        // Rough: every mode has something.
        let count: usize = shape.iter().product();
        let mut rough = |_| (0..count).map(|_| uniform(&mut random) - 0.5).collect::<Vec<f64>>();
        let start: Vec<Vec<f64>> = (0..=shape.len()).map(&mut rough).collect();
        let first = flow.state(&start);
        let (rates, _) = flow.rates(&first);
        let work = |part: std::ops::Range<usize>| {
            let each = part.map(|a| flow.transform.product(&first[a], &rates[a], |_| 1.0));
            each.sum::<f64>() / count as f64
        };
        let d = shape.len();
        let scale = flow.mean_square(&rates[..d], |_| 1.0).sqrt();
        assert!(scale > 0.05, "{shape:?}: nothing moves");
        assert!(work(0..d).abs() < 1e-14 * scale.max(1.0), "{shape:?} {kind:?}: work {}", work(0..d));
        assert!(work(d..d + 1).abs() < 1e-14 * scale.max(1.0), "{shape:?} {kind:?}: of heat {}", work(d..d + 1));
        for rate in &rates {
            assert!((rate[0].re / count as f64).abs() < 1e-15 * scale.max(1.0), "{shape:?} {kind:?}: momentum");
        }
        // So a long run does not grow without bounds.
        let (end, sizes) = to_end(&flow, &first, 4.0, &control(1e-5));
        let change = flow.energy(&end) / flow.energy(&first) - 1.0;
        assert!(change.abs() < 1e-3 && sizes.len() > 4, "{shape:?} {kind:?}: energy {change}");
        // Divergence, in the same derivatives.
        let divergence: f64 = (0..flow.transform.modes())
            .map(|k| (0..d).map(|a| end[a][k] * flow.symbols.first[a][k]).sum::<num_complex::Complex64>().norm())
            .fold(0.0, f64::max);
        assert!(divergence / (count as f64) < 1e-13, "{shape:?}: divergence {divergence}");
    }
}

#[test]
fn a_force_and_warm_fluid_accelerate_the_box() {
    let own = Materials {
        viscosity: 0.1,
        diffusivity: Some(0.05),
        force: vec![0.3, 0.0],
        buoyancy: Some(Buoyancy { by: [0.0, 2.0, 0.0], at: 0.25 }),
    };
    let flow = equations(&[12, 12], own, Derivatives::Spectral);
    let fields = [vec![0.0; 144], vec![0.0; 144], vec![0.75; 144]];
    let (end, _) = to_end(&flow, &flow.state(&fields), 2.0, &control(1e-6));
    let found = flow.at_particles(&end);
    for (u, exact) in found.iter().zip([0.3 * 2.0, 2.0 * 0.5 * 2.0, 0.75]) {
        assert!(largest(&u.iter().map(|u| u - exact).collect::<Vec<f64>>()) < 1e-12);
    }
    // A wave of temperature decays by conduction, and pushes a wave of velocity: v' = -nu v + 2 T, T = cos x exp(-alpha t).
    let wave = [vec![0.0; 144], vec![0.0; 144], field(&[12, 12], flow.dx, |p| p[0].cos() + 0.25)];
    let flow = Equations { materials: Materials { force: vec![0.0; 2], ..flow.materials.clone() }, ..flow };
    let (end, _) = to_end(&flow, &flow.state(&wave), 2.0, &control(1e-8));
    let found = flow.at_particles(&end);
    let exact = 2.0 * ((-0.05 * 2.0f64).exp() - (-0.1 * 2.0f64).exp()) / (0.1 - 0.05);
    assert!((found[1][0] - exact).abs() < 1e-7, "{} instead of {exact}", found[1][0]);
}

/// The sum of the fields at the end and half way times random numbers, and its derivative by all that it depends on.
struct Weighed<'a> {
    shape: &'a [usize],
    kind: Derivatives,
    weights: Vec<Vec<f64>>,
}

impl Weighed<'_> {
    fn value(&self, start: &[Vec<f64>], materials: &Materials, sizes: &[f64]) -> f64 {
        let flow = equations(self.shape, materials.clone(), self.kind);
        let mut state = flow.state(start);
        let mut value = 0.0;
        for (k, &size) in sizes.iter().enumerate() {
            let fixed = Control { fixed: Some(size), ..control(1.0) };
            state = to_end(&flow, &state, size, &fixed).0;
            if k + 1 == sizes.len() || k == 1 {
                let fields = flow.at_particles(&state);
                for (field, weights) in fields.iter().zip(&self.weights) {
                    value += field.iter().zip(weights).map(|(x, w)| x * w).sum::<f64>();
                }
            }
        }
        value
    }
}

#[test]
fn gradients_are_exact() {
    for (shape, kind) in [(vec![10, 12], BOTH[0]), (vec![9, 8], BOTH[1]), (vec![6, 5, 6], BOTH[1])] {
        let d = shape.len();
        let own = Materials {
            viscosity: 0.03,
            diffusivity: Some(0.02),
            force: (0..d).map(|a| 0.1 * a as f64 - 0.2).collect(),
            buoyancy: Some(Buoyancy { by: [0.5, -0.5, if d == 3 { -1.5 } else { 0.0 }], at: 0.2 }),
        };
        let flow = equations(&shape, own.clone(), kind);
        let count: usize = shape.iter().product();
        let mut random = stream(11, "lattice");
        let mut numbers = || (0..count).map(|_| uniform(&mut random) - 0.5).collect::<Vec<f64>>();
        let mut start = swirl(&shape, flow.dx);
        // Rough ones, which the projection and each derivative see.
        start.iter_mut().for_each(|field| field.iter_mut().zip(numbers()).for_each(|(x, y)| *x += 0.2 * y));
        start.push(numbers());
        let weighed = Weighed { shape: &shape, kind, weights: (0..=d).map(|_| numbers()).collect() };
        let direction: Vec<Vec<f64>> = (0..=d).map(|_| numbers()).collect();
        let sizes = [0.05, 0.08, 0.06, 0.06, 0.03];
        let of = |memory: usize| {
            pull_back::<()>(&flow, &flow.state(&start), &sizes, memory, &mut |k, _, bar| {
                if k + 1 == sizes.len() || k == 1 {
                    for (bar, weights) in bar.iter_mut().zip(&weighed.weights) {
                        bar.iter_mut().zip(flow.transform.forwards(weights.clone())).for_each(|(b, w)| *b += w);
                    }
                }
                Ok(())
            })
            .unwrap()
        };
        let found = of(MEMORY);
        // Segments change nothing.
        assert_eq!(found, of(0), "{shape:?}");
        let along: f64 = flow
            .at_particles(&found.start)
            .iter()
            .zip(&direction)
            .map(|(bar, way)| bar.iter().zip(way).map(|(b, w)| b * w).sum::<f64>())
            .sum();
        let difference = |value: &dyn Fn(f64) -> f64| {
            let step = 1e-3;
            let at = |h: f64| (value(h) - value(-h)) / (2.0 * h);
            // Of fourth order.
            (4.0 * at(step) - at(2.0 * step)) / 3.0
        };
        let moved = |h: f64| -> Vec<Vec<f64>> {
            let of = |(x, way): (&Vec<f64>, &Vec<f64>)| x.iter().zip(way).map(|(x, w)| x + h * w).collect();
            start.iter().zip(&direction).map(of).collect()
        };
        let mut checks = vec![
            ("start", along, difference(&|h| weighed.value(&moved(h), &own, &sizes))),
            (
                "viscosity",
                found.materials.viscosity,
                difference(&|h| {
                    weighed.value(&start, &Materials { viscosity: own.viscosity + h, ..own.clone() }, &sizes)
                }),
            ),
            (
                "diffusivity",
                found.materials.diffusivity,
                difference(&|h| {
                    weighed.value(
                        &start,
                        &Materials { diffusivity: own.diffusivity.map(|x| x + h), ..own.clone() },
                        &sizes,
                    )
                }),
            ),
        ];
        for a in 0..d {
            checks.push((
                "force",
                found.materials.force[a],
                difference(&|h| {
                    let mut force = own.force.clone();
                    force[a] += h;
                    weighed.value(&start, &Materials { force, ..own.clone() }, &sizes)
                }),
            ));
        }
        for k in [0, 2, 4] {
            checks.push((
                "size",
                found.sizes[k],
                difference(&|h| {
                    let mut sizes = sizes;
                    sizes[k] += h;
                    weighed.value(&start, &own, &sizes)
                }),
            ));
        }
        for (name, exact, difference) in checks {
            let error = (exact / difference - 1.0).abs();
            assert!(error < 1e-7, "{shape:?} {kind:?} by {name}: {exact} and {difference} ({error:e})");
        }
    }
}

#[test]
fn modes_that_alternate_are_left_alone() {
    // Such a field has no derivatives along its axis, so it is free of divergence, and decays by its viscosity.
    let flow = equations(&[8, 8], materials(2, 0.01), Derivatives::Spectral);
    let start = vec![field(&[8, 8], 1.0, |p| (PI * p[0]).cos()), vec![0.0; 64]];
    let (end, _) = to_end(&flow, &flow.state(&start), 1.0, &control(1e-6));
    let decay = (-0.01 * 16.0f64).exp();
    assert!(rms(&flow.at_particles(&end)[0], &start[0].iter().map(|u| u * decay).collect::<Vec<f64>>()) < 1e-14);
}
