//! Fluxes, walls and densities of the standard formulation beyond the usual ones: each law against its formula, summed pair by pair,
//! and its gradient against central differences. (Fused against composed: operators.rs.)

use crate::support::differences::smallest_gap;
use crate::support::final_sum::{FinalSum, Summed};
use crate::support::random_scene::{Options, RandomScene, DX};
use candle_core::{Device, Tensor};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::config::scene::Kernels;
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::laws::{DensityDiffusion, DensityGradient, Flux, Riemann, Slip, VelocityDiffusion};
use hydrograd::sph::solver::{Snapshot, Solver};
use hydrograd::sph::standard::chain::Step;
use hydrograd::sph::standard::Standard;
use hydrograd::sph::standard::{drift, evolution, rates, renormalisation, wall_condition};
use std::sync::Arc;

const SOUND_SPEED: f64 = 5.0;

fn delta(gradient: DensityGradient) -> Flux {
    let (sound_speed, smoothing_length) = (SOUND_SPEED, DX);
    Flux::Delta(DensityDiffusion { strength: 0.3, sound_speed, smoothing_length, gradient })
}

fn riemann() -> Flux {
    Flux::Riemann(Riemann { sound_speed: SOUND_SPEED, limiter: 3.0 })
}

/// A random scene's model with other methods; plane walls below and above, if it has any.
fn model(scene: &RandomScene, flux: Flux, slip: Slip, renormalises: bool) -> Arc<Standard<f64>> {
    let mut model = Arc::try_unwrap(scene.model::<f64>()).expect("a new model is nobody else's");
    let (n, middle) = (model.particles(), 0.5 * scene.size[1]);
    let mut normals = vec![0.0; model.dimension() * n];
    for i in (0..n).filter(|&i| !model.is_fluid(i)) {
        normals[n + i] = if scene.state[n + i] < middle { 1.0 } else { -1.0 };
    }
    model.laws.flux = flux;
    model.laws.further.1 = matches!(flux, Flux::Delta(_)).then_some(VelocityDiffusion {
        strength: 0.4,
        sound_speed: SOUND_SPEED,
        smoothing_length: DX,
        reference_density: 1.2,
    });
    model.laws.slip = slip;
    model.laws.renormalises = renormalises;
    model.laws.normals = Some(normals);
    Arc::new(model)
}

/// Evolved densities, gravity, walls.
fn wet(dimension: usize) -> Options {
    Options { density: true, walls: true, periodic: [true, false, true], gamma: 7, ..Options::plain(dimension) }
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// The state after the drift, and the operators' context there.
fn moved(scene: &RandomScene, model: &Arc<Standard<f64>>) -> (Tensor, Arc<Step<f64>>) {
    let state = Tensor::from_slice(&scene.state, (model.layout.state_rows(), scene.particles()), &Device::Cpu).unwrap();
    let moved = drift::composed(model, model.dt, &state).unwrap();
    let step = scene.step(model, &numbers(&moved));
    (moved, step)
}

/// Everything that the sums below are made of, as plain numbers.
struct Plain {
    model: Arc<Standard<f64>>,
    n: usize,
    moved: Vec<f64>,
}

impl Plain {
    fn row(&self, row: usize, i: usize) -> f64 {
        self.moved[row * self.n + i]
    }
    fn density(&self, i: usize) -> f64 {
        self.row(self.model.layout.moved_density(), i)
    }
    fn volume(&self, i: usize) -> f64 {
        let l = self.model.layout;
        let mass = if l.mass { self.row(l.moved_mass(), i) } else { self.model.mass };
        mass / self.density(i)
    }
    /// r_i - r_j of nearest images.
    fn difference(&self, i: usize, j: usize) -> [f64; 3] {
        std::array::from_fn(|d| {
            if d >= self.model.dimension() {
                return 0.0;
            }
            let raw = self.row(d, i) - self.row(d, j);
            let size = self.model.domain.size[d];
            if self.model.domain.periodic[d] {
                raw - size * (raw / size).round()
            } else {
                raw
            }
        })
    }
    fn velocity(&self, i: usize) -> [f64; 3] {
        let d = self.model.dimension();
        std::array::from_fn(|k| if k < d { self.row(d + k, i) } else { 0.0 })
    }
    /// Sums f(j, r_ij, W, F) over all others in reach, wall pairs left out as everywhere.
    fn sum<const C: usize>(&self, i: usize, f: impl Fn(usize, [f64; 3], f64, f64) -> [f64; C]) -> [f64; C] {
        let mut sum = [0.0; C];
        for j in (0..self.n).filter(|&j| j != i && (self.model.is_fluid(i) || self.model.is_fluid(j))) {
            let r = self.difference(i, j);
            let r2 = dot(r, r);
            if r2 < self.model.kernel.cutoff().powi(2) {
                let (w, slope) = self.model.kernel.pair(r2);
                f(j, r, w, slope).iter().zip(&mut sum).for_each(|(x, sum)| *sum += x);
            }
        }
        sum
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| a[d] - b[d])
}

fn agree(what: &str, found: &[f64], expected: &[f64], take: impl Fn(usize) -> bool) {
    let scale = expected.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    assert!(scale > 0.0, "{what}: nothing to compare");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate().filter(|(i, _)| take(*i)) {
        assert!((found - expected).abs() < 1e-11 * scale, "{what} of {i}: {found} is not {expected}");
    }
}

#[test]
fn densities_evolve_by_their_formulas() {
    for dimension in [2, 3] {
        let scene = RandomScene::new(Options { mass: true, ..wet(dimension) });
        let fluid = |plain: &Plain, i: usize| plain.model.is_fluid(i);
        let rate = |flux: Flux| {
            let model = model(&scene, flux, Slip::None, false);
            let (moved, step) = moved(&scene, &model);
            let rate = numbers(&evolution::rate(&step, &step.pairs(&moved).unwrap(), &moved).unwrap());
            (rate, Plain { n: scene.particles(), moved: numbers(&moved), model })
        };
        let continuity = |plain: &Plain, i: usize| {
            let [sum] =
                plain.sum(i, |j, r, _, f| [plain.volume(j) * f * dot(minus(plain.velocity(i), plain.velocity(j)), r)]);
            plain.density(i) * sum
        };
        let (found, plain) = rate(Flux::Pair);
        let expected: Vec<f64> = (0..plain.n).map(|i| continuity(&plain, i)).collect();
        agree("continuity", &found, &expected, |_| true);

        // delta-SPH in 2D, where the inverse of A is easily written down.
        if dimension == 2 {
            let (found, plain) = rate(delta(DensityGradient::Renormalised));
            let gradient = |i: usize| {
                let [a, b, c, x, y] = plain.sum(i, |j, r, _, f| {
                    let (v, rise) = (plain.volume(j) * f, plain.density(j) - plain.density(i));
                    [-v * r[0] * r[0], -v * r[0] * r[1], -v * r[1] * r[1], v * rise * r[0], v * rise * r[1]]
                });
                let determinant = a * c - b * b;
                [(c * x - b * y) / determinant, (a * y - b * x) / determinant, 0.0]
            };
            let gradients: Vec<[f64; 3]> = (0..plain.n).map(gradient).collect();
            let expected: Vec<f64> = (0..plain.n)
                .map(|i| {
                    let [sum] = plain.sum(i, |j, r, _, f| {
                        let means: [f64; 3] = std::array::from_fn(|d| gradients[i][d] + gradients[j][d]);
                        let psi = -2.0 * (plain.density(j) - plain.density(i)) - dot(means, r);
                        [if fluid(&plain, j) { plain.volume(j) * psi * f } else { 0.0 }]
                    });
                    continuity(&plain, i) + if fluid(&plain, i) { 0.3 * DX * SOUND_SPEED * sum } else { 0.0 }
                })
                .collect();
            agree("diffusion", &found, &expected, |_| true);
        }

        let (found, plain) = rate(riemann());
        let state = plain.model.equation_of_state;
        let expected: Vec<f64> = (0..plain.n)
            .map(|i| {
                let (rho, p) = (plain.density(i), state.pressure(plain.density(i)));
                let [sum] = plain.sum(i, |j, r, _, f| {
                    let distance = dot(r, r).sqrt();
                    let (mut p_right, mut rho_right) = (state.pressure(plain.density(j)), plain.density(j));
                    if !fluid(&plain, j) {
                        p_right = p - rho * dot([0.7, -2.3, if dimension == 3 { 1.1 } else { 0.0 }], r);
                        rho_right = state.density(p_right);
                    }
                    // v* = U* (-e) + (v - U (-e)), as Zhang, Hu and Adams write it.
                    let e = r.map(|x| x / distance);
                    let (u_i, u_j) = (plain.velocity(i), plain.velocity(j));
                    let mean: [f64; 3] = std::array::from_fn(|d| 0.5 * (u_i[d] + u_j[d]));
                    let along = -dot(mean, e);
                    let star = along + (p - p_right) / ((rho + rho_right) * SOUND_SPEED);
                    let v_star: [f64; 3] = std::array::from_fn(|d| -star * e[d] + mean[d] + along * e[d]);
                    [2.0 * rho * plain.volume(j) * f * dot(minus(u_i, v_star), r)]
                });
                if fluid(&plain, i) {
                    sum
                } else {
                    0.0
                }
            })
            .collect();
        agree("Riemann problems", &found, &expected, |_| true);
    }
}

#[test]
fn renormalised_densities_are_averages_where_there_is_little() {
    let scene = RandomScene::new(Options { mass: true, ..wet(2) });
    let model = model(&scene, Flux::Pair, Slip::None, true);
    let (moved, step) = moved(&scene, &model);
    let plain = Plain { n: scene.particles(), moved: numbers(&moved), model };
    let (mass, pairs) = (plain.model.layout.moved_mass(), step.pairs(&moved).unwrap());
    let tensor = |row: usize| moved.narrow(0, row, 1).unwrap();
    let density = tensor(plain.model.layout.moved_density());
    let found = numbers(&renormalisation::composed(&step, &pairs, &tensor(mass), &density).unwrap());
    let own = plain.model.kernel.at_zero();
    let sums = |i: usize| {
        let [m, v] = plain.sum(i, |j, _, w, _| [plain.row(mass, j) * w, plain.volume(j) * w]);
        [m + plain.row(mass, i) * own, v + plain.volume(i) * own]
    };
    let all: Vec<[f64; 2]> = (0..plain.n).map(sums).collect();
    let expected: Vec<f64> = all.iter().map(|[m, v]| m / v.min(1.0)).collect();
    agree("renormalisation", &found, &expected, |_| true);
    let (full, open) = (all.iter().filter(|s| s[1] > 1.0).count(), all.iter().filter(|s| s[1] < 1.0).count());
    assert!(full > 20 && open > 20, "{full} with and {open} without all their neighbours");
}

/// What keeps still water still: nothing is diffused where the density is linear, however the particles are arranged.
#[test]
fn linear_densities_are_not_diffused() {
    for dimension in [2, 3] {
        let mut scene = RandomScene::new(wet(dimension));
        let (n, l) = (scene.particles(), scene.options.layout());
        for i in 0..n {
            for d in 0..dimension {
                scene.state[(l.velocity() + d) * n + i] = 0.0;
                scene.state[(l.acceleration() + d) * n + i] = 0.0;
            }
            scene.state[l.state_density() * n + i] = 1.2 + 0.3 * scene.state[n + i];
        }
        let rate = |flux: Flux| {
            let model = model(&scene, flux, Slip::None, false);
            let (moved, step) = moved(&scene, &model);
            let rate = numbers(&evolution::rate(&step, &step.pairs(&moved).unwrap(), &moved).unwrap());
            rate.iter().fold(0.0f64, |m, x| m.max(x.abs()))
        };
        assert!(rate(delta(DensityGradient::Renormalised)) < 1e-12);
        // JAX-SPH's gradients do not do that.
        assert!(rate(delta(DensityGradient::JaxSph)) > 1e-3);
    }
}

/// Accelerations of fluid, `[D, N]`, and the primitives' velocities.
fn accelerations(scene: &RandomScene, model: &Arc<Standard<f64>>) -> (Vec<f64>, Vec<f64>) {
    let (moved, step) = moved(scene, model);
    let pairs = step.pairs(&moved).unwrap();
    let density = evolution::composed(&step, &pairs, 0.0, &moved).unwrap();
    let primitives = wall_condition::composed(&step, &pairs, &moved, &density).unwrap();
    let rates = rates::composed(&step, &pairs, &moved, &primitives).unwrap();
    let (l, d) = (model.layout, model.dimension());
    let velocity = primitives.narrow(0, l.primitive_velocity(), d).unwrap().contiguous().unwrap();
    (numbers(&rates.narrow(0, 0, d).unwrap().contiguous().unwrap()), numbers(&velocity))
}

#[test]
fn riemann_problems_conserve_momentum() {
    let options = Options { density: true, gamma: 7, mass: true, ..Options::plain(3) };
    let scene = RandomScene::new(options);
    let model = model(&scene, riemann(), Slip::None, false);
    let (found, n) = (accelerations(&scene, &model).0, scene.particles());
    let gravity = [0.7, -2.3, 1.1];
    for (d, gravity) in gravity.into_iter().enumerate() {
        let force = |i: usize| scene.state[model.layout.state_mass() * n + i] * (found[d * n + i] - gravity);
        let (sum, size): (f64, f64) =
            (0..n).map(|i| (force(i), force(i).abs())).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        assert!(size > 1e-3 && sum.abs() < 1e-12 * size, "{sum} of {size}");
    }
}

/// A flow that is the same everywhere: walls show it mirrored about their own velocity, or only what crosses them.
#[test]
fn walls_slip_or_hold() {
    let mut scene = RandomScene::new(wet(2));
    let (n, l) = (scene.particles(), scene.options.layout());
    for i in 0..n {
        let fluid = scene.tags[i] == hydrograd::particles::tag::FLUID;
        let u = if fluid { [0.7, 0.2] } else { [0.1, 0.0] };
        for (d, u) in u.into_iter().enumerate() {
            scene.state[(l.velocity() + d) * n + i] = u;
            scene.state[(l.acceleration() + d) * n + i] = 0.0;
        }
    }
    for (slip, along) in [(Slip::None, 2.0 * 0.1 - 0.7), (Slip::Free, 0.7)] {
        let model = model(&scene, Flux::Pair, slip, false);
        let (_, step) = moved(&scene, &model);
        let (_, velocity) = accelerations(&scene, &model);
        assert!(!step.list.wall_rows.is_empty());
        for &i in &step.list.wall_rows {
            let i = i as usize;
            let pairs = (0..n).filter(|&j| model.is_fluid(j)).map(|j| {
                let r: [f64; 2] = std::array::from_fn(|d| {
                    let raw = scene.state[d * n + i] - scene.state[d * n + j];
                    if d == 0 {
                        raw - scene.size[0] * (raw / scene.size[0]).round()
                    } else {
                        raw
                    }
                });
                r[0] * r[0] + r[1] * r[1]
            });
            // The guard of the averages shows where only the skin or the support's edge holds fluid.
            if pairs.fold(f64::INFINITY, f64::min) > (2.5 * DX).powi(2) {
                continue;
            }
            assert!((velocity[i] - along).abs() < 1e-9, "{slip:?}: {} is not {along}", velocity[i]);
            assert!((velocity[n + i] + 0.2).abs() < 1e-9, "{slip:?}: {}", velocity[n + i]);
        }
    }
}

/// The gradient of the kinetic energy after some steps, by the first state, along random directions.
#[test]
fn gradients_are_derivatives() {
    let cases: [(&str, Options, Flux, Slip, bool); 8] = [
        ("renormalisation", wet(2), Flux::Pair, Slip::None, true),
        ("delta", wet(2), delta(DensityGradient::Renormalised), Slip::None, false),
        ("delta 3D", wet(3), delta(DensityGradient::Renormalised), Slip::Free, false),
        ("delta as JAX-SPH", wet(2), delta(DensityGradient::JaxSph), Slip::None, false),
        (
            "delta, summed",
            Options { density: false, ..wet(2) },
            delta(DensityGradient::Renormalised),
            Slip::None,
            false,
        ),
        ("Riemann", Options { gamma: 1, ..wet(2) }, riemann(), Slip::None, true),
        ("Riemann, summed, 3D", Options { density: false, ..wet(3) }, riemann(), Slip::Free, false),
        ("free slip, transport", Options { transport: true, heat: true, ..wet(2) }, Flux::Pair, Slip::Free, false),
    ];
    for (name, options, flux, slip, renormalises) in cases {
        // Three steps: what the first makes of the density, the third's velocities have seen. In 3D one fewer, to be quick.
        let steps = 5 - options.dimension;
        let scene = RandomScene::new(options);
        let model = model(&scene, flux, slip, renormalises);
        // JAX-SPH's gradients of the density alone are always composed of candle's operators.
        assert_eq!(model.is_fused(), !name.contains("JAX-SPH"), "{name}");
        let (n, dynamics) = (scene.particles(), Sph::new(model.clone(), Kernels::Fused));
        let objective = FinalSum { steps, of: Summed::KineticEnergy };
        let start = Snapshot::first(&model, scene.state.clone());
        let found = gradient(&dynamics, &start, &Schedule::segments(steps, 2), &objective, &mut |_| ()).unwrap();
        let bar = numbers(&found.state);
        let energy = |state: &[f64]| {
            let mut solver = Solver::new(model.clone(), state.to_vec()).unwrap();
            (0..steps).for_each(|_| solver.advance().unwrap());
            let fluid = |k: &usize| model.is_fluid(k % n);
            let velocity = solver.state[model.layout.velocity() * n..].iter().take(options.dimension * n);
            velocity.enumerate().filter(|(k, _)| fluid(k)).map(|(_, u)| 0.5 * u * u).sum::<f64>()
        };
        assert!((energy(&scene.state) / found.value - 1.0).abs() < 1e-13, "{name}");
        let mut normal = Normal::new(stream(7, "directions"));
        // One direction for each row of the state: no row's error hides behind another's.
        for (row, bar) in bar.chunks(n).enumerate() {
            let values = &scene.state[row * n..(row + 1) * n];
            let size = values.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let scale = if row < options.dimension { DX } else { 0.1 * size };
            let direction: Vec<f64> = (0..n).map(|_| scale * normal.next()).collect();
            let slope: f64 = bar.iter().zip(&direction).map(|(g, v)| g * v).sum();
            let terms: f64 = bar.iter().zip(&direction).map(|(g, v)| (g * v).powi(2)).sum();
            let at = |t: f64| {
                let mut state = scene.state.clone();
                state[row * n..(row + 1) * n].iter_mut().zip(&direction).for_each(|(x, v)| *x += t * v);
                energy(&state)
            };
            let quotient = |h: f64| (at(-2.0 * h) - 8.0 * at(-h) + 8.0 * at(h) - at(2.0 * h)) / (12.0 * h);
            // (A row that the energy does not depend on, such as the temperature, has no terms; then rounding is what there is.)
            // Limiter, renormalisation and guards have kinks, which a smaller step rarely meets; accelerations of the start
            // change little, which only a larger one resolves.
            let gap = |h: f64| (slope - quotient(h)).abs() / terms.sqrt().max(1e-6 * found.value);
            let gap = smallest_gap(&[1e-4, 1e-3, 1e-5, 1e-6], 5e-7, gap);
            assert!(gap < 1e-6, "{name}, row {row}: {slope} differs by {gap:e} of its terms");
        }
    }
}
