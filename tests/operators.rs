//! Each operator of a step: fused against composed, adjoint against central differences, conservation, symmetry.

use crate::support::final_sum::{FinalSum, Summed};
use crate::support::random_scene::{permute, Options, RandomScene, DX};
use crate::support::standard::{Assemble, AssembleEvolved, Rates};
use candle_core::{DType, Device, Tensor, Var};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::config::scene::{Config, FluxName, Kernels};
use hydrograd::design::shape::Shape;
use hydrograd::numerics::candle::{apply1, apply2, apply3};
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::particles::tag;
use hydrograd::scene::Scene;
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::interpolation::Interpolation;
use hydrograd::sph::kernels::KernelName;
use hydrograd::sph::laws::body_force::BodyForce;
use hydrograd::sph::laws::buoyancy::Buoyancy;
use hydrograd::sph::laws::drive::Drive;
use hydrograd::sph::solver::{Snapshot, Solver, TensorSolver};
use hydrograd::sph::standard::chain::{Chain, Step};
use hydrograd::sph::standard::{assemble, density, drift, evolution, rates, wall_condition};
use hydrograd::sph::Model;
use hydrograd::sph::Sweeps;
use std::sync::Arc;

/// Fused against composed, relative to the largest value of the row.
const SAME: f64 = 1e-12;
/// Adjoint against central differences, relative.
const DERIVATIVE: f64 = 1e-7;

type Function = Box<dyn Fn(&[Tensor]) -> candle_core::Result<Tensor>>;

/// An operator in both forms with the inputs to try it on.
struct Operator {
    name: &'static str,
    inputs: Vec<Tensor>,
    fused: Function,
    composed: Function,
    /// 1 for the particles whose outputs have a cotangent, `[1, N]`.
    seen: Option<Tensor>,
    /// Whether values too are compared for those only: with gravity and an evolved density the others' are as
    /// ill-conditioned as their derivatives.
    hides: bool,
}

impl Operator {
    /// Values that are compared.
    fn shown(&self, output: &Tensor) -> Tensor {
        match &self.seen {
            Some(seen) if self.hides => output.broadcast_mul(&seen.to_dtype(output.dtype()).unwrap()).unwrap(),
            _ => output.clone(),
        }
    }

    /// A cotangent of the output whose share of each row counts equally, whatever the row's units.
    fn cotangent(&self, output: &Tensor, normal: &mut Normal) -> Tensor {
        let scale = output.abs().unwrap().max_keepdim(1).unwrap().affine(1.0, 1e-3).unwrap();
        let bar = random_like(output, normal).broadcast_div(&scale).unwrap();
        match &self.seen {
            Some(seen) => bar.broadcast_mul(seen).unwrap(),
            None => bar,
        }
    }
}

fn tensor<R: Sweeps>(values: &[R], n: usize) -> Tensor {
    Tensor::from_slice(values, (values.len() / n, n), &Device::Cpu).unwrap()
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    let tensor = tensor.flatten_all().unwrap().to_dtype(DType::F64).unwrap();
    tensor.to_vec1::<f64>().unwrap()
}

/// Every operator of a step on the states that a step of this scene gives it.
fn operators<R: Sweeps>(scene: &RandomScene) -> Vec<Operator> {
    let (model, n) = (scene.model::<R>(), scene.particles());
    let state = tensor(&scene.state::<R>(), n);
    let moved = apply1(drift::Drift(model.clone(), model.dt), &state).unwrap();
    let step = scene.step(&model, &moved.flatten_all().unwrap().to_vec1::<R>().unwrap());
    let (evolves, dt) = (model.layout.density, model.dt);
    let density = match evolves {
        true => apply1(evolution::Evolution(Chain::new(step.clone()), dt), &moved).unwrap(),
        false => apply1(density::Density(Chain::new(step.clone())), &moved).unwrap(),
    };
    let primitives = apply2(wall_condition::WallCondition(Chain::new(step.clone())), &moved, &density).unwrap();
    let rates = apply2(Rates(Chain::new(step.clone())), &moved, &primitives).unwrap();
    let targets = targets(&model.clone().into(), scene);
    let interpolation = Interpolation { kernel: model.kernel, domain: model.domain, targets, kernels: Kernels::Fused };
    let taken: Arc<Vec<bool>> = Arc::new((0..n).map(|i| i % 7 != 3).collect());
    let (position, fields) = (moved.narrow(0, 0, model.dimension()).unwrap(), primitives.clone());

    let supported = supported(&step, &moved);
    let mut all = Vec::new();
    let mut add = |name, inputs: &[&Tensor], fused: Function, composed: Function| {
        let inputs = inputs.iter().map(|t| (*t).clone()).collect();
        // A step ends with the density of walls where that is in the state.
        let shows_walls = name == "wall condition" || (evolves && ["assemble", "step"].contains(&name));
        let seen = shows_walls.then(|| supported.clone());
        all.push(Operator { name, inputs, fused, composed, seen, hides: evolves });
    };
    let m = model.clone();
    let m2 = model.clone();
    add(
        "drift",
        &[&state],
        Box::new(move |t| apply1(drift::Drift(m.clone(), dt), &t[0])),
        Box::new(move |t| drift::composed(&m2, dt, &t[0])),
    );
    let (s, s2) = (step.clone(), step.clone());
    match evolves {
        true => add(
            "evolution",
            &[&moved],
            Box::new(move |t| apply1(evolution::Evolution(Chain::new(s.clone()), dt), &t[0])),
            Box::new(move |t| evolution::composed(&s2, &s2.pairs(&t[0])?, dt, &t[0])),
        ),
        false => add(
            "density",
            &[&moved],
            Box::new(move |t| apply1(density::Density(Chain::new(s.clone())), &t[0])),
            Box::new(move |t| density::composed(&s2, &s2.pairs(&t[0])?, &t[0])),
        ),
    }
    let (s, s2) = (step.clone(), step.clone());
    add(
        "wall condition",
        &[&moved, &density],
        Box::new(move |t| apply2(wall_condition::WallCondition(Chain::new(s.clone())), &t[0], &t[1])),
        Box::new(move |t| wall_condition::composed(&s2, &s2.pairs(&t[0])?, &t[0], &t[1])),
    );
    let (s, s2) = (step.clone(), step.clone());
    add(
        "rates",
        &[&moved, &primitives],
        Box::new(move |t| apply2(Rates(Chain::new(s.clone())), &t[0], &t[1])),
        Box::new(move |t| rates::composed(&s2, &s2.pairs(&t[0])?, &t[0], &t[1])),
    );
    let (s, s2) = (step.clone(), step.clone());
    match evolves {
        true => add(
            "assemble",
            &[&moved, &primitives, &rates],
            Box::new(move |t| apply3(AssembleEvolved(Chain::new(s.clone())), &t[0], &t[1], &t[2])),
            Box::new(move |t| assemble::composed(&s2, &t[0], &t[1], &t[2])),
        ),
        false => {
            let primitives = primitives.clone();
            add(
                "assemble",
                &[&moved, &rates],
                Box::new(move |t| apply2(Assemble(Chain::new(s.clone())), &t[0], &t[1])),
                Box::new(move |t| assemble::composed(&s2, &t[0], &primitives, &t[1])),
            )
        }
    }
    let (of_fused, of_composed) = (interpolation.clone(), interpolation);
    let (t1, t2) = (taken.clone(), taken);
    add(
        "interpolation",
        &[&position, &fields],
        Box::new(move |t| of_fused.sums(&t[0], &t[1], &t1)),
        Box::new(move |t| of_composed.composed(&t[0], &t[1], &t2)),
    );
    let first = Snapshot::first(&model, scene.state::<R>());
    let run = move |kernels| {
        let (model, first) = (model.clone(), first.clone());
        let advance = move |t: &[Tensor]| {
            let mut run = TensorSolver::restore(model.clone(), &first, kernels).unwrap();
            run.advance(&t[0]).map_err(|e| candle_core::Error::Msg(e.to_string()))
        };
        Box::new(advance) as Function
    };
    add("step", &[&state], run(Kernels::Fused), run(Kernels::Composed));
    all
}

/// 1 for fluid, and for walls that fluid supports. The averages of a wall whose only fluid neighbour is about to leave
/// its support change from one thing to another within 1e-3 spacings and are ill-conditioned there: no difference
/// quotient resolves that, and rounding shows. What such a wall adds to the fluid is as small as its weights.
fn supported<R: Sweeps>(step: &Arc<Step<R>>, moved: &Tensor) -> Tensor {
    let (model, n) = (&*step.model, step.model.particles());
    let pairs = step.pairs(moved).unwrap();
    let fluid = pairs.other(&pairs.is_fluid).unwrap();
    let w = model.kernel.composed(&pairs.distance).unwrap().0.mul(&pairs.mask).unwrap().mul(&fluid).unwrap();
    let weight = numbers(&w.sum(2).unwrap());
    let seen = |i: usize| model.is_fluid(i) || weight[i] == 0.0 || weight[i] > 1e-12 * model.kernel.at_zero();
    tensor(&(0..n).map(|i| R::of(seen(i) as u8 as f64)).collect::<Vec<R>>(), n)
}

/// Points between particles, across the periodic seam, and one on top of a particle.
fn targets<R: Sweeps>(model: &Model<R>, scene: &RandomScene) -> Arc<Vec<[f64; 3]>> {
    let (n, size) = (model.particles(), scene.size);
    let mut targets: Vec<[f64; 3]> =
        (0..7).map(|k| [0.05 * DX + 0.13 * k as f64 * size[0], 0.25 * size[1] + k as f64 * DX, 0.01]).collect();
    let fluid = (0..n).find(|&i| model.is_fluid(i)).unwrap();
    targets.push(std::array::from_fn(|k| if k < model.dimension() { scene.state[k * n + fluid] } else { 0.0 }));
    Arc::new(targets)
}

/// Random numbers of a tensor's shape and type.
fn random_like(tensor: &Tensor, normal: &mut Normal) -> Tensor {
    let values: Vec<f64> = (0..tensor.elem_count()).map(|_| normal.next()).collect();
    Tensor::from_vec(values, tensor.shape(), &Device::Cpu).unwrap().to_dtype(tensor.dtype()).unwrap()
}

/// The gradients of (out * cotangent).sum by every input.
fn gradients(function: &Function, inputs: &[Tensor], cotangent: &Tensor) -> Vec<Tensor> {
    let variables: Vec<Var> = inputs.iter().map(|t| Var::from_tensor(t).unwrap()).collect();
    let tensors: Vec<Tensor> = variables.iter().map(|v| v.as_tensor().clone()).collect();
    let loss = (function(&tensors).unwrap() * cotangent).unwrap().sum_all().unwrap();
    let mut all = loss.backward().unwrap();
    tensors.iter().map(|t| all.remove(t).unwrap_or_else(|| t.zeros_like().unwrap())).collect()
}

/// Largest difference of two tensors, row by row, relative to the row's largest value.
fn difference(a: &Tensor, b: &Tensor) -> f64 {
    assert_eq!(a.dims(), b.dims());
    let n = a.dims()[1];
    let (a, b) = (numbers(a), numbers(b));
    let mut worst: f64 = 0.0;
    for (a, b) in a.chunks(n).zip(b.chunks(n)) {
        let scale = b.iter().fold(1e-300f64, |m, x| m.max(x.abs()));
        for (a, b) in a.iter().zip(b) {
            let gap = (a - b).abs() / scale;
            worst = if gap.is_nan() { f64::INFINITY } else { worst.max(gap) };
        }
    }
    worst
}

/// The scenes of these tests: every combination that the kernels are compiled for, with and without walls; the
/// other options take turns.
const OTHERS: [KernelName; 6] = [
    KernelName::WendlandC2,
    KernelName::CubicSpline,
    KernelName::WendlandC4,
    KernelName::SuperGaussian,
    KernelName::WendlandC6,
    KernelName::Gaussian,
];

fn scenes() -> Vec<Options> {
    let mut all = Vec::new();
    for k in 0..64u64 {
        let on = |bit: u64| k >> bit & 1 == 1;
        let walls = on(3);
        let turn = k + k / 4;
        let kernel = match (on(5), OTHERS[turn as usize % OTHERS.len()]) {
            (false, _) => KernelName::QuinticSpline,
            // The walls' sums of W go through zero: see src/sph/kernels/gaussian.rs.
            (true, KernelName::SuperGaussian) if on(3) => KernelName::Gaussian,
            (true, other) => other,
        };
        all.push(Options {
            dimension: if on(4) { 3 } else { 2 },
            walls,
            periodic: match turn % 3 {
                0 => [true, !walls, true],
                1 => [true, false, false],
                _ => [false, false, true],
            },
            transport: on(0),
            heat: on(1),
            mass: on(2) ^ on(4),
            gamma: if turn % 2 == 0 { 7 } else { 1 },
            // Not the usual kernel and its smoothing length: the other laws and kernels with everything they may meet.
            kernel,
            smoothing: if on(5) { 2.8 / kernel.support() } else { 1.0 },
            artificial_viscosity: on(5),
            density: false,
            materials: false,
            flux: FluxName::Pair,
            slips: false,
            renormalises: false,
            seed: k,
        });
    }
    // Densities that evolve, each law and each wall with them.
    for k in 0..16 {
        let plain = all[(k * 5 + 8) % 64];
        all.push(Options { density: true, artificial_viscosity: k % 2 == 0, seed: 64 + k as u64, ..plain });
    }
    // Materials, alone and with all that goes with them.
    for k in 0..4 {
        let on = |bit: u64| k >> bit & 1 == 1;
        let rich =
            Options { transport: false, materials: true, seed: 80 + k, ..Options::rich(if on(0) { 3 } else { 2 }) };
        all.push(Options { mass: on(1), artificial_viscosity: on(1), ..rich });
    }
    // Other fluxes, walls along which the flow slips, and renormalised densities. (Riemann problems go without a transport velocity.)
    for k in 0..24 {
        let on = |bit: u64| k >> bit & 1 == 1;
        let plain = all[(k as usize * 5 + 8) % 64];
        let flux = [FluxName::Delta, FluxName::Riemann, FluxName::Pair][k as usize % 3];
        let density = k % 8 != 6;
        all.push(Options {
            flux,
            density,
            walls: plain.walls || on(1),
            periodic: if on(1) { [true, false, true] } else { plain.periodic },
            slips: on(0) || flux == FluxName::Pair,
            renormalises: density && on(2),
            transport: plain.transport && flux != FluxName::Riemann,
            seed: 84 + k,
            ..plain
        });
    }
    // A process that tries another instruction set takes a few of them.
    let stride = std::env::var(STRIDE).map_or(1, |s| s.parse().unwrap());
    all.into_iter().step_by(stride).collect()
}

#[test]
fn fused_is_composed_forward_and_backward() {
    let (mut worst_value, mut worst_gradient): (f64, f64) = (0.0, 0.0);
    for options in scenes() {
        let scene = RandomScene::new(options);
        let mut normal = Normal::new(stream(options.seed, "bars"));
        for operator in operators::<f64>(&scene) {
            let what = format!("{}, {options:?}", operator.name);
            let fused = (operator.fused)(&operator.inputs).unwrap();
            let composed = (operator.composed)(&operator.inputs).unwrap();
            let gap = difference(&operator.shown(&fused), &operator.shown(&composed));
            assert!(gap <= SAME, "{what}: values differ by {gap:e}");
            worst_value = worst_value.max(gap);
            let bar = operator.cotangent(&composed, &mut normal);
            let ours = gradients(&operator.fused, &operator.inputs, &bar);
            let theirs = gradients(&operator.composed, &operator.inputs, &bar);
            for (k, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
                let gap = difference(ours, theirs);
                assert!(gap <= SAME, "{what}: gradients by input {k} differ by {gap:e}");
                worst_gradient = worst_gradient.max(gap);
            }
        }
    }
    println!("largest relative difference: values {worst_value:.1e}, gradients {worst_gradient:.1e}");
}

#[test]
fn adjoints_are_derivatives() {
    let mut worst: f64 = 0.0;
    for options in scenes() {
        let scene = RandomScene::new(options);
        let mut normal = Normal::new(stream(options.seed, "directions"));
        for operator in operators::<f64>(&scene) {
            let output = (operator.fused)(&operator.inputs).unwrap();
            let bar = operator.cotangent(&output, &mut normal);
            let gradient = gradients(&operator.fused, &operator.inputs, &bar);
            let n = scene.particles();
            // One direction per input: an error in one of them is not hidden by the other.
            for (k, input) in operator.inputs.iter().enumerate() {
                let direction = direction(input, n, options.dimension, &mut normal);
                let slope: f64 = numbers(&gradient[k]).iter().zip(&direction).map(|(g, v)| g * v).sum();
                let at = |t: f64| -> f64 {
                    let moved: Vec<f64> = numbers(input).iter().zip(&direction).map(|(x, v)| x + t * v).collect();
                    let mut inputs = operator.inputs.clone();
                    inputs[k] = tensor(&moved, n);
                    let out = (operator.fused)(&inputs).unwrap();
                    numbers(&out).iter().zip(numbers(&bar)).map(|(x, b)| x * b).sum()
                };
                // Relative to the terms of the sum: the sum itself may happen to be small.
                let terms: f64 = numbers(&gradient[k]).iter().zip(&direction).map(|(g, v)| (g * v).powi(2)).sum();
                // Fourth order, so that the step can be large enough for rounding.
                let quotient = |h: f64| (at(-2.0 * h) - 8.0 * at(-h) + 8.0 * at(h) - at(2.0 * h)) / (12.0 * h);
                let gap_of = |expected: f64| (slope - expected).abs() / terms.sqrt().max(1e-300);
                let mut expected = quotient(1e-5);
                // Artificial viscosity has a kink where a pair begins to approach, the limiter of Riemann problems where it is reached,
                // renormalisation where the support is just filled; a smaller step rarely meets one.
                let kinks = options.artificial_viscosity || options.flux == FluxName::Riemann || options.renormalises;
                if kinks && gap_of(expected) > DERIVATIVE {
                    expected = quotient(1e-6);
                }
                let gap = gap_of(expected);
                let what = operator.name;
                assert!(gap <= DERIVATIVE, "{what} by input {k}: {slope} is not {expected} ({gap:e}), {options:?}");
                worst = worst.max(gap);
            }
        }
    }
    println!("largest relative difference: {worst:.1e}");
}

/// The composed step is candle's alone: here the state is of another type than the model, so whatever read a tensor's
/// numbers as the model's would fail, as it would on another device. Where there is a GPU, it runs there too.
#[test]
fn composed_operators_leave_the_state_where_it_is() {
    let mut devices = vec![Device::Cpu];
    devices.extend(Device::cuda_if_available(0).ok().filter(|device| !device.is_cpu()));
    for options in [Options::rich(2), Options::rich(3), Options { artificial_viscosity: true, ..Options::rich(2) }] {
        let scene = RandomScene::new(options);
        let (model, n) = (scene.model::<f64>(), scene.particles());
        let first = Snapshot::first(&model, scene.state::<f64>());
        let step = |kernels, state: &Tensor| {
            let mut run = TensorSolver::restore(model.clone(), &first, kernels).unwrap();
            let end = run.advance(state).unwrap();
            let shown = run.look(&end).unwrap();
            let seen = [shown.density, shown.velocity, shown.temperature.unwrap()];
            let primitives = Tensor::cat(&seen, 0).unwrap();
            (end, primitives)
        };
        let state = tensor(&scene.state::<f64>(), n);
        let exact = step(Kernels::Fused, &state);
        for device in &devices {
            for dtype in [DType::F64, DType::F32] {
                let elsewhere = state.to_device(device).unwrap().to_dtype(dtype).unwrap();
                let found = step(Kernels::Composed, &elsewhere);
                let tolerance = if dtype == DType::F64 { SAME } else { 1e-3 };
                for (found, exact) in [(found.0, &exact.0), (found.1, &exact.1)] {
                    assert!(found.dtype() == dtype && found.device().same_device(device));
                    let gap = difference(&found.to_device(&Device::Cpu).unwrap(), exact);
                    assert!(gap <= tolerance, "{dtype:?}, {options:?}: {gap:e}");
                }
            }
        }
    }
}

/// A random direction in which each row moves by a share of its own size; positions by a share of the spacing.
fn direction(input: &Tensor, n: usize, dimension: usize, normal: &mut Normal) -> Vec<f64> {
    let values = numbers(input);
    let positions = values.len() / n > dimension;
    values
        .chunks(n)
        .enumerate()
        .flat_map(|(row, values)| {
            let largest = values.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            // Inputs without positions are rates, primitives and densities: their own size is right for them.
            let scale = if positions && row < dimension { DX } else { 0.1 * largest };
            (0..n).map(|_| scale * normal.next()).collect::<Vec<f64>>()
        })
        .collect()
}

/// Rates of a scene, and the mass of every particle.
fn rates_of<R: Sweeps>(scene: &RandomScene) -> (Vec<f64>, Vec<f64>) {
    let (model, n) = (scene.model::<R>(), scene.particles());
    let moved = apply1(drift::Drift(model.clone(), model.dt), &tensor(&scene.state::<R>(), n)).unwrap();
    let step = scene.step(&model, &moved.flatten_all().unwrap().to_vec1::<R>().unwrap());
    let density = apply1(density::Density(Chain::new(step.clone())), &moved).unwrap();
    let primitives = apply2(wall_condition::WallCondition(Chain::new(step.clone())), &moved, &density).unwrap();
    let rates = apply2(Rates(Chain::new(step)), &moved, &primitives).unwrap();
    let mass = match scene.options.mass {
        true => scene.state[model.layout.state_mass() * n..].to_vec(),
        false => vec![model.mass; n],
    };
    (numbers(&rates), mass)
}

#[test]
fn pairs_conserve_momentum_and_heat() {
    for dimension in [2, 3] {
        for periodic in [true, false] {
            for gamma in [1, 7] {
                for flux in [FluxName::Pair, FluxName::Delta, FluxName::Riemann] {
                    let (walls, transport) = (false, flux != FluxName::Riemann);
                    let periodic = [periodic; 3];
                    let options = Options { walls, periodic, gamma, flux, transport, ..Options::rich(dimension) };
                    let mut scene = RandomScene::new(options);
                    scene.body_force = BodyForce::None;
                    scene.open_everywhere = true;
                    let (rates, mass) = rates_of::<f64>(&scene);
                    // Acceleration, transport acceleration, temperature rate: each row is a conserved sum.
                    for (row, rates) in rates.chunks(mass.len()).enumerate() {
                        let flows: Vec<f64> = rates.iter().zip(&mass).map(|(a, m)| a * m).collect();
                        let (sum, size): (f64, f64) = (flows.iter().sum(), flows.iter().map(|f| f.abs()).sum());
                        assert!(
                            size > 0.0 && sum.abs() <= 1e-13 * size,
                            "{options:?}: row {row} loses {sum:e} of {size:e}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn materials_conduct_by_their_harmonic_mean_and_keep_their_heat() {
    for dimension in [2, 3] {
        let rich = Options {
            transport: false,
            materials: true,
            walls: false,
            periodic: [true; 3],
            ..Options::rich(dimension)
        };
        let mut scene = RandomScene::new(rich);
        (scene.body_force, scene.open_everywhere) = (BodyForce::None, true);
        let (model, n) = (scene.model::<f64>(), scene.particles());
        let moved = apply1(drift::Drift(model.clone(), model.dt), &tensor(&scene.state::<f64>(), n)).unwrap();
        let numbers_moved = numbers(&moved);
        let step = scene.step(&model, &numbers_moved);
        let density = numbers(&apply1(density::Density(Chain::new(step)), &moved).unwrap());
        let (rates, mass) = rates_of::<f64>(&scene);
        let rate = &rates[model.layout.rate_temperature() * n..][..n];
        let temperature = &numbers_moved[model.layout.moved_temperature() * n..][..n];
        // c_i dT_i/dt = sum_j m_j 4 k_i k_j / (rho_i rho_j (k_i + k_j)) (T_i - T_j) F_ij (Cleary and Monaghan 1999, eq. 28).
        let heat = model.heat.as_ref().unwrap();
        let (k, c) = (&scene.conductivity, &scene.capacity);
        let (mut heat_flows, mut size) = (0.0, 0.0);
        for i in 0..n {
            let mut expected = 0.0;
            for j in (0..n).filter(|&j| j != i) {
                let r2: f64 = (0..dimension)
                    .map(|d| model.domain.nearest(d, numbers_moved[d * n + i] - numbers_moved[d * n + j]).powi(2))
                    .sum();
                let pair = 4.0 * k[i] * k[j] / (density[i] * density[j] * (k[i] + k[j])) * heat.conductivity;
                expected += mass[j] * pair * (temperature[i] - temperature[j]) * model.kernel.pair(r2).1;
            }
            expected /= c[i] * heat.capacity;
            assert!((rate[i] - expected).abs() < 1e-9 * expected.abs().max(1.0), "{i}: {} is not {expected}", rate[i]);
            heat_flows += mass[i] * c[i] * rate[i];
            size += (mass[i] * c[i] * rate[i]).abs();
        }
        assert!(size > 0.0 && heat_flows.abs() < 1e-13 * size, "{heat_flows:e} of {size:e} is lost");
        // With one material the law is the one without.
        (scene.conductivity, scene.capacity) = (vec![1.0; n], vec![1.0; n]);
        let equal = rates_of::<f64>(&scene).0;
        scene.options.materials = false;
        let none = rates_of::<f64>(&scene).0;
        assert!(difference(&tensor(&equal, n), &tensor(&none, n)) < SAME);
    }
}

#[test]
fn the_body_force_is_its_own_acceleration() {
    let mut scene = RandomScene::new(Options::rich(2));
    scene.body_force = BodyForce::None;
    let without = rates_of::<f64>(&scene).0;
    scene.body_force = BodyForce::Reversing { strength: 2.0, turn: 0.5 * scene.size[1] };
    let with = rates_of::<f64>(&scene).0;
    let n = scene.particles();
    for i in 0..n {
        let upper = scene.state[n + i] > 0.5 * scene.size[1];
        let expected = if scene.tags[i] != tag::FLUID { 0.0 } else { 2.0 * if upper { -1.0 } else { 1.0 } };
        // Drifting particles near the turn may have crossed it.
        if (scene.state[n + i] - 0.5 * scene.size[1]).abs() > 0.1 * DX {
            assert!((with[i] - without[i] - expected).abs() < 1e-10, "particle {i}");
        }
    }
    assert_eq!(with[n..], without[n..], "only the first component");
}

/// a = -beta g (T - T0) for each particle, and their momentum is that of the sum: pairs keep theirs.
#[test]
fn buoyancy_is_its_own_acceleration() {
    for dimension in [2, 3] {
        let mut scene = RandomScene::new(Options { walls: false, periodic: [true; 3], ..Options::rich(dimension) });
        (scene.body_force, scene.buoyancy, scene.open_everywhere) = (BodyForce::None, None, true);
        let (without, _) = rates_of::<f64>(&scene);
        scene.buoyancy = Buoyancy::new(1.7, &[0.7, -2.3, 1.1], 0.04);
        let (with, mass) = rates_of::<f64>(&scene);
        let (model, n) = (scene.model::<f64>(), scene.particles());
        let moved = apply1(drift::Drift(model.clone(), model.dt), &tensor(&scene.state::<f64>(), n)).unwrap();
        let temperature = &numbers(&moved)[model.layout.moved_temperature() * n..][..n];
        for (d, g) in [0.7, -2.3, 1.1][..dimension].iter().enumerate() {
            let given = |i: usize| -1.7 * g * (temperature[i] - 0.04);
            let gap = (0..n).map(|i| (with[d * n + i] - without[d * n + i] - given(i)).abs()).fold(0.0, f64::max);
            assert!(gap < 1e-10, "{dimension}D, component {d}: {gap:e}");
            let force: f64 = (0..n).map(|i| mass[i] * with[d * n + i]).sum();
            let (expected, size): (f64, f64) =
                ((0..n).map(|i| mass[i] * given(i)).sum(), (0..n).map(|i| (mass[i] * with[d * n + i]).abs()).sum());
            assert!((force - expected).abs() < 1e-13 * size, "{dimension}D, component {d}: {force} and {expected}");
        }
        assert_eq!(with[dimension * n..], without[dimension * n..], "nothing but accelerations");
    }
}

/// A random order of 0..n.
fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut rng = stream(seed, "order");
    let mut keys: Vec<(f64, usize)> = (0..n).map(|i| (hydrograd::numerics::random::uniform(&mut rng), i)).collect();
    keys.sort_by(|a, b| a.0.total_cmp(&b.0));
    keys.into_iter().map(|k| k.1).collect()
}

#[test]
fn order_of_particles_does_not_matter() {
    for options in [Options::rich(2), Options::rich(3), Options { seed: 1, ..Options::plain(2) }] {
        let scene = RandomScene::new(options);
        let n = scene.particles();
        let order = shuffled(n, 5);
        let permuted = scene.permuted(&order);
        let mut normal = Normal::new(stream(6, "bars"));
        for (a, b) in operators::<f64>(&scene).into_iter().zip(operators::<f64>(&permuted)) {
            let what = format!("{}, {options:?}", a.name);
            // Interpolated values belong to targets (the last of which follows the first fluid particle), not to particles.
            if a.name.starts_with("interpolation") {
                continue;
            }
            let move_along = |t: &Tensor| tensor(&permute(&numbers(t), n, &order), n);
            let (value, permuted_value) = ((a.fused)(&a.inputs).unwrap(), (b.fused)(&b.inputs).unwrap());
            let gap = difference(&permuted_value, &move_along(&value));
            assert!(gap <= SAME, "{what}: values differ by {gap:e}");
            let bar = a.cotangent(&value, &mut normal);
            let gradient = gradients(&a.fused, &a.inputs, &bar);
            let permuted_gradient = gradients(&b.fused, &b.inputs, &move_along(&bar));
            for (k, (ours, theirs)) in permuted_gradient.iter().zip(&gradient).enumerate() {
                let gap = difference(ours, &move_along(theirs));
                assert!(gap <= SAME, "{what}: gradients by input {k} differ by {gap:e}");
            }
        }
    }
}

/// Single precision: values and adjoints within rounding, amplified by what each operator subtracts. A self pair or an
/// unstable form of the kernel's slope makes the gradients differ by order 1.
#[test]
fn single_precision_agrees_with_double() {
    let mut worst = std::collections::BTreeMap::<&str, (f64, f64)>::new();
    for options in scenes() {
        let scene = RandomScene::new(options);
        let mut normal = Normal::new(stream(options.seed, "bars"));
        for (double, single) in operators::<f64>(&scene).into_iter().zip(operators::<f32>(&scene)) {
            let value = (double.fused)(&double.inputs).unwrap();
            let single_value = (single.fused)(&single.inputs).unwrap();
            let single_value = double.shown(&single_value.to_dtype(DType::F64).unwrap());
            let value_gap = difference(&single_value, &double.shown(&value));
            let bar = double.cotangent(&value, &mut normal);
            let gradient = gradients(&double.fused, &double.inputs, &bar);
            let single_gradient = gradients(&single.fused, &single.inputs, &bar.to_dtype(DType::F32).unwrap());
            let gradient_gap = single_gradient
                .iter()
                .zip(&gradient)
                .map(|(single, double)| difference(&single.to_dtype(DType::F64).unwrap(), double))
                .fold(0.0, f64::max);
            // Averages of walls with little support divide by small sums of weights.
            let allowed = if double.seen.is_some() { 2e-3 } else { 2e-5 };
            let what = format!("{}, {options:?}", double.name);
            assert!(value_gap <= allowed, "{what}: values differ by {value_gap:e}");
            assert!(gradient_gap <= allowed, "{what}: gradients differ by {gradient_gap:e}");
            let worst = worst.entry(double.name).or_default();
            *worst = (worst.0.max(value_gap), worst.1.max(gradient_gap));
        }
    }
    for (name, (value, gradient)) in worst {
        println!("{name}: f32 differs by {value:.1e}, its gradient by {gradient:.1e}");
    }
}

/// Threads and instruction set are chosen once per process, so other settings need other processes: this runs a test of
/// this program again, and returns what the run left in the file named by [`RESULT`].
fn run_again(test: &str, settings: &[(&str, &str)]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let result = folder.path().join("result");
    let mut command = std::process::Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", &format!("operators::{test}"), "--include-ignored", "--nocapture"]);
    command.envs(settings.iter().copied()).env(RESULT, &result);
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("1 passed"), "{test} with {settings:?}:\n{text}{errors}");
    std::fs::read(&result).unwrap_or_default()
}

/// Names the file for the child's result.
const RESULT: &str = "HYDROGRAD_TEST_RESULT";
/// Which formulation is run.
const FORMULATION: &str = "HYDROGRAD_TEST_FORMULATION";
/// Tries every n-th scene only.
const STRIDE: &str = "HYDROGRAD_TEST_STRIDE";

#[test]
#[ignore = "run by the tests below, as a program of its own"]
fn state_and_gradient_of_a_run() {
    let Some(path) = std::env::var_os(RESULT) else { return };
    let formulation = std::env::var(FORMULATION).unwrap_or("standard".into());
    let formulation = format!("method.name={formulation}");
    let sets = ["time.steps=50", "time.cfl=1.0", "design.shape=\"sine\"", "objective.window=0", &formulation];
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let config = Config::load(None, None, &sets).unwrap().config;
    let shape = Shape::from_config(&config).unwrap();
    let channel = Scene::<f64>::from_config(&config).unwrap().design.unwrap();
    let start = channel.start(&shape.offsets);
    let mut solver = Solver::restore(channel.model.clone(), &start).unwrap();
    (0..50).for_each(|_| solver.advance().unwrap());
    let dynamics = Sph::new(channel.model.clone(), config.run.kernels);
    let warmth = FinalSum { steps: 50, of: Summed::SquaredHeat };
    let found = gradient(&dynamics, &start, &Schedule::segments(50, 13), &warmth, &mut |_| ()).unwrap();
    let mut numbers = solver.state.clone();
    numbers.extend(self::numbers(&found.state));
    numbers.extend(channel.by_variables(&shape.offsets, &self::numbers(&found.state)));
    std::fs::write(path, numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
}

#[test]
fn number_of_threads_does_not_change_a_bit() {
    for formulation in ["standard", "consistent"] {
        let run = |threads: &str| {
            let settings = [("CANDLE_NUM_THREADS", threads), (FORMULATION, formulation)];
            run_again("state_and_gradient_of_a_run", &settings)
        };
        let one = run("1");
        assert!(one.len() > 8 * 800 * 10, "only {} bytes", one.len());
        for threads in ["2", "3"] {
            assert!(one == run(threads), "{formulation}: {threads} threads give other bits than one");
        }
    }
}

/// Lane counts change the order of sums, so instruction sets agree to rounding only.
#[test]
fn instruction_sets_agree() {
    let run = |set: &str| -> Vec<f64> {
        let bytes = run_again("state_and_gradient_of_a_run", &[("HYDROGRAD_SIMD", set)]);
        bytes.chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let portable = run("portable");
    assert!(portable.iter().all(|x| x.is_finite()));
    for set in ["avx2", "avx512"] {
        let other = run(set);
        assert_eq!(portable.len(), other.len());
        // Rows of one field of the state or of its gradient; the design gradient's few numbers are the last, short one.
        let worst = portable
            .chunks(800)
            .zip(other.chunks(800))
            .map(|(a, b)| {
                let scale = a.iter().fold(1e-300f64, |m, x| m.max(x.abs()));
                a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs() / scale))
            })
            .fold(0.0, f64::max);
        println!("{set} differs from portable by {worst:.1e}");
        assert!(worst < 1e-9, "{set} differs from portable by {worst:e}");
        let settings = [("HYDROGRAD_SIMD", set), (STRIDE, "5")];
        run_again("fused_is_composed_forward_and_backward", &settings);
    }
    run_again("fused_is_composed_forward_and_backward", &[("HYDROGRAD_SIMD", "portable"), (STRIDE, "5")]);
}

#[test]
fn a_drive_holds_what_it_says_and_knows_its_derivatives() {
    let dt = 0.01;
    for drive in [Drive::Momentum(0.7), Drive::Power(0.4)] {
        for (momentum, mass) in [(0.5, 0.2), (-0.3, 0.2), (0.0, 1.3), (4.0, 0.1)] {
            let found = drive.kick(dt, momentum, mass);
            let after = momentum + mass * found.kick;
            let (held, wanted) = match drive {
                Drive::Momentum(wanted) => (after, wanted),
                Drive::Power(wanted) => (found.kick / dt * after, wanted),
            };
            assert!((held / wanted - 1.0).abs() < 1e-12, "{drive:?} {held}");
            let h = 1e-6;
            let by_momentum =
                (drive.kick(dt, momentum + h, mass).kick - drive.kick(dt, momentum - h, mass).kick) / (2.0 * h);
            let by_mass =
                (drive.kick(dt, momentum, mass + h).kick - drive.kick(dt, momentum, mass - h).kick) / (2.0 * h);
            assert!((by_momentum / found.by_momentum - 1.0).abs() < 1e-6, "{drive:?}: {by_momentum} {found:?}");
            assert!((by_mass / found.by_mass - 1.0).abs() < 1e-6, "{drive:?}: {by_mass} {found:?}");
        }
    }
}
