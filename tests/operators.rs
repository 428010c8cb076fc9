//! Each operator of a step: fused against composed, adjoint against central differences, conservation, symmetry.

mod support;

use candle_core::{Device, Tensor, Var};
use hydrograd::lanes::Real;
use hydrograd::particles::tag;
use hydrograd::random::{stream, Normal};
use hydrograd::sph::body_force::BodyForce;
use hydrograd::sph::interpolation::Interpolation;
use hydrograd::sph::model::Model;
use hydrograd::sph::step::Step;
use hydrograd::sph::{advance, composed::quintic, composed::Pairs, density, drift, primitives, rates};
use std::sync::Arc;
use support::random_scene::{permute, Options, RandomScene, DX};

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
}

impl Operator {
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

fn tensor<R: Real>(values: &[R], n: usize) -> Tensor {
    Tensor::from_slice(values, (values.len() / n, n), &Device::Cpu).unwrap()
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    let tensor = tensor.flatten_all().unwrap().to_dtype(candle_core::DType::F64).unwrap();
    tensor.to_vec1::<f64>().unwrap()
}

/// Every operator of a step on the states that a step of this scene gives it.
fn operators<R: Real>(scene: &RandomScene) -> Vec<Operator> {
    let (model, n) = (scene.model::<R>(), scene.particles());
    let state = tensor(&scene.state::<R>(), n);
    let moved = Step::drift(&model, model.dt, &state, true).unwrap();
    let step = scene.step(&model, &moved.flatten_all().unwrap().to_vec1::<R>().unwrap());
    let density = moved.apply_op1(density::Density(step.clone())).unwrap();
    let primitives = moved.apply_op2(&density, primitives::Primitives(step.clone())).unwrap();
    let rates = moved.apply_op2(&primitives, rates::Rates(step.clone())).unwrap();
    let targets = targets(&model, scene);
    let interpolation =
        |include_walls: bool| Interpolation { step: step.clone(), targets: targets.clone(), include_walls };

    let supported = supported(&step, &moved);
    let mut all = Vec::new();
    let mut add = |name, inputs: &[&Tensor], fused: Function, composed: Function| {
        let inputs = inputs.iter().map(|t| (*t).clone()).collect();
        let seen = (name == "primitives").then(|| supported.clone());
        all.push(Operator { name, inputs, fused, composed, seen });
    };
    let (m, dt) = (model.clone(), model.dt);
    let m2 = model.clone();
    add(
        "drift",
        &[&state],
        Box::new(move |t| t[0].apply_op1(drift::Drift(m.clone(), dt))),
        Box::new(move |t| drift::composed(&m2, dt, &t[0])),
    );
    let (s, s2) = (step.clone(), step.clone());
    add(
        "density",
        &[&moved],
        Box::new(move |t| t[0].apply_op1(density::Density(s.clone()))),
        Box::new(move |t| density::composed(&s2, &Pairs::new(&s2, &t[0])?, &t[0])),
    );
    let (s, s2) = (step.clone(), step.clone());
    add(
        "primitives",
        &[&moved, &density],
        Box::new(move |t| t[0].apply_op2(&t[1], primitives::Primitives(s.clone()))),
        Box::new(move |t| primitives::composed(&s2, &Pairs::new(&s2, &t[0])?, &t[0], &t[1])),
    );
    let (s, s2) = (step.clone(), step.clone());
    add(
        "rates",
        &[&moved, &primitives],
        Box::new(move |t| t[0].apply_op2(&t[1], rates::Rates(s.clone()))),
        Box::new(move |t| rates::composed(&s2, &Pairs::new(&s2, &t[0])?, &t[0], &t[1])),
    );
    let (s, s2) = (step.clone(), step.clone());
    add(
        "advance",
        &[&moved, &rates],
        Box::new(move |t| t[0].apply_op2(&t[1], advance::Advance(s.clone()))),
        Box::new(move |t| advance::composed(&s2, &t[0], &t[1])),
    );
    for (name, walls) in [("interpolation over fluid", false), ("interpolation over fluid and walls", true)] {
        let (of_fused, of_composed) = (interpolation(walls), interpolation(walls));
        add(
            name,
            &[&moved, &primitives],
            Box::new(move |t| t[0].apply_op2(&t[1], of_fused.clone())),
            Box::new(move |t| of_composed.composed(&t[0], &t[1])),
        );
    }
    let (s, s2) = (step.clone(), step);
    add(
        "step",
        &[&state],
        Box::new(move |t| s.fused(&Step::drift(&s.model, s.dt, &t[0], true)?)),
        Box::new(move |t| s2.composed(&Step::drift(&s2.model, s2.dt, &t[0], false)?)),
    );
    all
}

/// 1 for fluid, and for walls that fluid supports. The averages of a wall whose only fluid neighbour is about to leave
/// its support change from one thing to another within 1e-3 spacings and are ill-conditioned there: no difference
/// quotient resolves that, and rounding shows. What such a wall adds to the fluid is as small as its weights.
fn supported<R: Real>(step: &Arc<Step<R>>, moved: &Tensor) -> Tensor {
    let (model, n) = (&*step.model, step.model.particles());
    let pairs = Pairs::new(step, moved).unwrap();
    let fluid = pairs.other(&pairs.is_fluid).unwrap();
    let w = quintic(&model.kernel, &pairs.distance).unwrap().mul(&pairs.mask).unwrap().mul(&fluid).unwrap();
    let weight = numbers(&w.sum(2).unwrap());
    let seen = |i: usize| model.is_fluid(i) || weight[i] == 0.0 || weight[i] > 1e-12 * model.kernel.at_zero();
    tensor(&(0..n).map(|i| R::of(seen(i) as u8 as f64)).collect::<Vec<R>>(), n)
}

/// Points between particles, across the periodic seam, and one on top of a particle.
fn targets<R: Real>(model: &Model<R>, scene: &RandomScene) -> Arc<Vec<[f64; 3]>> {
    let (n, size) = (model.particles(), scene.size);
    let mut targets: Vec<[f64; 3]> =
        (0..7).map(|k| [0.05 * DX + 0.13 * k as f64 * size[0], 0.25 * size[1] + k as f64 * DX, 0.01]).collect();
    let fluid = (0..n).find(|&i| model.is_fluid(i)).unwrap();
    targets.push(std::array::from_fn(|k| if k < model.layout.dimension { scene.state[k * n + fluid] } else { 0.0 }));
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
fn scenes() -> Vec<Options> {
    let mut all = Vec::new();
    for k in 0..32u64 {
        let on = |bit: u64| k >> bit & 1 == 1;
        let walls = on(3);
        let turn = k + k / 4;
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
            seed: k,
        });
    }
    all
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
            let gap = difference(&fused, &composed);
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
                // Fourth order, so that the step can be large enough for rounding.
                let h = 1e-5;
                let expected = (at(-2.0 * h) - 8.0 * at(-h) + 8.0 * at(h) - at(2.0 * h)) / (12.0 * h);
                // Relative to the terms of the sum: the sum itself may happen to be small.
                let terms: f64 = numbers(&gradient[k]).iter().zip(&direction).map(|(g, v)| (g * v).powi(2)).sum();
                let gap = (slope - expected).abs() / terms.sqrt().max(1e-300);
                let what = operator.name;
                assert!(gap <= DERIVATIVE, "{what} by input {k}: {slope} is not {expected} ({gap:e}), {options:?}");
                worst = worst.max(gap);
            }
        }
    }
    println!("largest relative difference: {worst:.1e}");
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
