//! Operators and models of the surrogate: the fused ones against ordinary candle operators, gradients against central
//! differences, symmetries.

use candle_core::{DType, Device, Tensor, Var};
use candle_nn::Module;
use hydrograd::config::scene::Kernels;
use hydrograd::config::training::{HeatModel, Settings};
use hydrograd::dataset::{kind, Metadata, Trajectory};
use hydrograd::numerics::candle::{apply2, apply3};
use hydrograd::numerics::pool::Buffers;
use hydrograd::numerics::random::stream;
use hydrograd::surrogate::differentiable_rollout::DifferentiableRollout;
use hydrograd::surrogate::evaluation::rollout::rollout;
use hydrograd::surrogate::features::{Features, Inputs, Normalisation, Window};
use hydrograd::surrogate::models::egnn::Egnn;
use hydrograd::surrogate::models::gns::Gns;
use hydrograd::surrogate::models::learned::{window, Learned};
use hydrograd::surrogate::models::setup::Setup;
use hydrograd::surrogate::models::sizes::Sizes;
use hydrograd::surrogate::network::graph::{Ends, Graph};
use hydrograd::surrogate::network::interaction::{edge_shape, node_shape, Rounds};
use hydrograd::surrogate::network::layers::{builder, Perceptron, Round};
use hydrograd::surrogate::network::mlp::{Mlp, MlpShape};
use hydrograd::surrogate::network::parameters::{detached, tracked, Network, Parameter};
use hydrograd::surrogate::predictor::{Frame, Scenery};
use std::sync::Arc;

/// Numbers that look random, in -1 .. 1.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut next = crate::support::noise::noise(seed);
    (0..count).map(|_| next()).collect()
}

fn random(shape: &[usize], seed: u64) -> Var {
    let values = noise(shape.iter().product(), seed);
    Var::from_tensor(&Tensor::from_vec(values, shape, &Device::Cpu).unwrap()).unwrap()
}

fn plain(t: &Tensor) -> Vec<f64> {
    t.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let scale = b.iter().fold(1e-12f64, |m, x| m.max(x.abs()));
    a.iter().zip(b).fold(0.0f64, |m, (a, b)| if (a - b).is_nan() { f64::INFINITY } else { m.max((a - b).abs()) })
        / scale
}

/// (weights * f(inputs)).sum(): a number whose gradient is that of every output at once.
fn weighted(y: &Tensor) -> Tensor {
    let weights = Tensor::from_vec(noise(y.elem_count(), 99), y.shape(), &Device::Cpu).unwrap();
    (y * weights).unwrap().sum_all().unwrap()
}

/// Gradients by candle against central differences along random directions, f64.
fn check_gradient(name: &str, inputs: &[&Var], f: impl Fn() -> Tensor) {
    check_gradient_with(&[1e-6], name, inputs, f);
}

/// By the best of these steps: edges come and go within the long ones, and the short ones have rounding.
fn check_gradient_with(steps: &[f64], name: &str, inputs: &[&Var], f: impl Fn() -> Tensor) {
    let store = weighted(&f()).backward().unwrap();
    for (k, input) in inputs.iter().enumerate() {
        let gradient = plain(store.get(input).unwrap_or_else(|| panic!("{name}: input {k} has no gradient")));
        let direction = noise(gradient.len(), 7 + k as u64);
        let start = input.as_tensor().copy().unwrap();
        let value = |step: f64| {
            let moved: Vec<f64> = plain(&start).iter().zip(&direction).map(|(x, d)| x + step * d).collect();
            input.set(&Tensor::from_vec(moved, start.shape(), &Device::Cpu).unwrap()).unwrap();
            plain(&weighted(&f()))[0]
        };
        let differences: Vec<f64> = steps.iter().map(|h| (value(*h) - value(-h)) / (2.0 * h)).collect();
        input.set(&start).unwrap();
        let along: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let scale = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        assert!(
            differences.iter().any(|difference| (along - difference).abs() < 1e-6 * scale),
            "{name}, input {k}: {along} against {differences:?}, scale {scale}"
        );
    }
}

fn ring(nodes: u32) -> Arc<Graph> {
    // Not symmetric, with a node that nobody sends to but itself and one with many edges.
    let mut edges: Vec<(u32, u32)> = (0..nodes).map(|i| (i, i)).collect();
    edges.extend((0..nodes - 1).map(|i| (i, (i * 7 + 3) % (nodes - 1))).filter(|(s, r)| s != r));
    edges.extend((1..nodes).map(|i| (i, 0)));
    Arc::new(Graph::new(nodes as usize, edges))
}

#[test]
fn rows_by_ends_and_sums_are_each_others_adjoint() {
    let graph = ring(23);
    let ends = Ends::new(&graph, &Device::Cpu).unwrap();
    let (x, y) = (random(&[23, 5], 1), random(&[graph.edges(), 5], 2));
    let (sent, received) = (plain(&ends.of_senders(&x).unwrap()), plain(&ends.of_receivers(&x).unwrap()));
    let (xs, ys) = (plain(&x), plain(&y));
    let mut sums = vec![0.0; 23 * 5];
    for e in 0..graph.edges() {
        let (j, i) = (graph.senders[e] as usize, graph.receivers[e] as usize);
        for c in 0..5 {
            assert_eq!((sent[e * 5 + c], received[e * 5 + c]), (xs[j * 5 + c], xs[i * 5 + c]));
            sums[i * 5 + c] += ys[e * 5 + c];
        }
    }
    assert!(largest(&plain(&ends.sums(&y).unwrap()), &sums) < 1e-14);
    check_gradient("senders", &[&x], || ends.of_senders(&x).unwrap());
    check_gradient("receivers", &[&x], || ends.of_receivers(&x).unwrap());
    check_gradient("sums", &[&y], || ends.sums(&y).unwrap());
    assert!(ends.of_senders(&random(&[22, 5], 1)).is_err());
}

/// A perceptron of a shape from candle-nn's layers, with its parameters in one vector.
fn perceptron(shape: &MlpShape, p: &Tensor) -> Perceptron {
    let parameter = Parameter::perceptron("mlp", shape, &mut stream(0, "weights"), DType::F64).unwrap();
    Perceptron::new(shape, builder(&[parameter], std::slice::from_ref(p)).unwrap().pp("mlp")).unwrap()
}

/// A perceptron on one row, number by number.
fn perceptron_by_its_formula(shape: &MlpShape, x: &[f64], p: &[f64]) -> Vec<f64> {
    let mut y = x.to_vec();
    for k in 0..shape.linears {
        let (weight, bias) = (&p[shape.weight(k)], &p[shape.bias(k)]);
        let outputs = bias.len();
        let sum = |c: usize| y.iter().enumerate().map(|(r, y)| y * weight[r * outputs + c]).sum::<f64>() + bias[c];
        let sums: Vec<f64> = (0..outputs).map(sum).collect();
        y = if k + 1 < shape.linears { sums.iter().map(|x| x.max(0.0)).collect() } else { sums };
    }
    if shape.norm {
        let count = y.len() as f64;
        let mean = y.iter().sum::<f64>() / count;
        let variance = y.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count;
        let (scale, offset) = (&p[shape.scale()], &p[shape.offset()]);
        y = (0..y.len()).map(|c| (y[c] - mean) / (variance + 1e-5).sqrt() * scale[c] + offset[c]).collect();
    }
    y
}

/// candle-nn's own normalisation would end the gradient without a word: the scale, the offset and all before them get one.
#[test]
fn perceptron_by_its_formula_and_its_gradient() {
    for norm in [true, false] {
        let shape = MlpShape { inputs: 4, hidden: 6, outputs: 7, linears: 3, norm };
        let (x, p) = (random(&[5, 4], 3), random(&[shape.parameters()], 4));
        let y = plain(&perceptron(&shape, &p).forward(&x).unwrap());
        let (xs, ps) = (plain(&x), plain(&p));
        let wanted: Vec<f64> = xs.chunks(4).flat_map(|x| perceptron_by_its_formula(&shape, x, &ps)).collect();
        assert!(largest(&y, &wanted) < 1e-13);
        check_gradient("perceptron", &[&x, &p], || perceptron(&shape, &p).forward(&x).unwrap());
    }
}

/// Widths that are no multiple of a vector, depth, with and without normalisation, more rows than a block and a part.
#[test]
fn fused_perceptron_is_composed() {
    let shapes = [
        MlpShape { inputs: 3, hidden: 13, outputs: 13, linears: 2, norm: true },
        MlpShape { inputs: 5, hidden: 9, outputs: 2, linears: 3, norm: false },
        MlpShape { inputs: 16, hidden: 32, outputs: 32, linears: 4, norm: true },
    ];
    for shape in shapes {
        for rows in [1, 37, 1500] {
            let (x, p) = (random(&[rows, shape.inputs], 11), random(&[shape.parameters()], 12));
            let memory = Buffers::<f64>::default();
            let fused = || apply2(Mlp::<f64>::new(shape, &memory), &x, &p).unwrap();
            let composed = || perceptron(&shape, &p).forward(&x).unwrap();
            assert!(largest(&plain(&fused()), &plain(&composed())) < 1e-12, "{shape:?} {rows}");
            let (a, b) = (weighted(&fused()).backward().unwrap(), weighted(&composed()).backward().unwrap());
            for v in [&x, &p] {
                assert!(largest(&plain(a.get(v).unwrap()), &plain(b.get(v).unwrap())) < 1e-12, "{shape:?} {rows}");
            }
            if rows == 37 {
                check_gradient("mlp", &[&x, &p], fused);
            }
        }
    }
}

#[test]
fn fused_rounds_are_composed() {
    for (latent, linears, nodes, rounds) in [(5, 2, 23, 1), (5, 2, 23, 3), (8, 3, 40, 2), (16, 2, 900, 2)] {
        let graph = ring(nodes);
        let (n, e) = (nodes as usize, graph.edges());
        let (edge, node) = (edge_shape(latent, latent, linears), node_shape(latent, latent, linears));
        let (x, y) = (random(&[n, latent], 21), random(&[e, latent], 22));
        let length = edge.parameters() + node.parameters();
        let p = random(&[rounds * length], 23);
        let memory = Buffers::<f64>::default();
        let fused = || {
            let op = Rounds::<f64>::new(&graph, (latent, latent, linears), rounds, true, &memory, None);
            apply3(op, &x, &y, &p).unwrap()
        };
        let names = (0..rounds).flat_map(|k| [(format!("{k}.edge"), edge), (format!("{k}.node"), node)]);
        let names: Vec<_> = names.collect();
        let parameter = Parameter::perceptrons(&names, &mut stream(0, "weights"), DType::F64).unwrap();
        let composed = || {
            let builder = builder(std::slice::from_ref(&parameter), &[p.as_tensor().clone()]).unwrap();
            let ends = Ends::new(&graph, &Device::Cpu).unwrap();
            let (mut a, mut b) = (x.as_tensor().clone(), y.as_tensor().clone());
            for k in 0..rounds {
                (a, b) = Round::new(&edge, &node, builder.pp(k)).unwrap().forward(&ends, &a, &b).unwrap();
            }
            a
        };
        assert!(largest(&plain(&fused()), &plain(&composed())) < 1e-12);
        let (a, b) = (weighted(&fused()).backward().unwrap(), weighted(&composed()).backward().unwrap());
        for v in [&x, &y, &p] {
            assert!(largest(&plain(a.get(v).unwrap()), &plain(b.get(v).unwrap())) < 1e-12);
        }
        if nodes == 23 {
            check_gradient("rounds", &[&x, &y, &p], fused);
        }
    }
}

fn metadata(size: f64) -> Metadata {
    let text = format!(
        "{{\"dim\": 2, \"dx\": 0.1, \"dt\": 1.0, \"write_every\": 1, \"num_particles_max\": 60, \
         \"periodic_boundary_conditions\": [true, true], \"bounds\": [[0, {size}], [0, {size}]], \
         \"default_connectivity_radius\": 0.145, \"vel_mean\": [0, 0], \"vel_std\": [0.01, 0.01], \
         \"acc_mean\": [0, 0], \"acc_std\": [0.001, 0.001]}}"
    );
    serde_json::from_str(&text).unwrap()
}

/// Six frames of 60 particles that move by about 0.01 a frame, `[N, D]` each.
fn cloud() -> Vec<Vec<f64>> {
    let (start, velocity) = (noise(120, 31), noise(120, 32));
    let wobble = noise(720, 33);
    (0..6)
        .map(|t| {
            (0..120)
                .map(|k| 0.5 + 0.25 * start[k] + 0.01 * t as f64 * velocity[k] + 0.001 * wobble[t * 120 + k])
                .collect()
        })
        .collect()
}

fn inputs(frames: &[Vec<f64>], kinds: &[i32], size: f64) -> Inputs {
    let metadata = metadata(size);
    let scenery = Scenery { metadata: &metadata, kind: kinds, wall_temperature: None };
    let position =
        frames.iter().map(|f| Tensor::from_slice(f, (f.len() / 2, 2), &Device::Cpu).unwrap()).collect::<Vec<_>>();
    let window = Window { position, temperature: Vec::new() };
    let normalisation = Normalisation::new(&metadata, 3e-4, 0.145, None);
    Features::default().inputs(&scenery, &normalisation, &window, None, DType::F64).unwrap()
}

const SIZES: Sizes =
    Sizes { node_features: 10, edge_features: 3, outputs: 2, latent: 12, rounds: 3, linears: 2, embedding: 4 };

fn models() -> Vec<(&'static str, Box<dyn Network>)> {
    vec![
        ("gns", Box::new(Gns::new(SIZES, Kernels::Fused, 1, DType::F64).unwrap()) as Box<dyn Network>),
        ("egnn", Box::new(Egnn::new(SIZES, 6, Kernels::Fused, 1, DType::F64).unwrap())),
    ]
}

fn answer(model: &dyn Network, frames: &[Vec<f64>], kinds: &[i32]) -> Vec<f64> {
    plain(&model.apply(&inputs(frames, kinds, 1.0), &detached(model)).unwrap())
}

#[test]
fn particles_can_be_renumbered_and_moved() {
    let frames = cloud();
    let kinds: Vec<i32> = (0..60).map(|i| i % 3).collect();
    for (name, model) in models() {
        let before = answer(&*model, &frames, &kinds);
        // Another order, over the periodic edge of the box.
        let order: Vec<usize> = (0..60).map(|i| (i * 23 + 5) % 60).collect();
        let place = |frame: &Vec<f64>| -> Vec<f64> {
            order
                .iter()
                .flat_map(|&i| [frame[2 * i] + 0.37, frame[2 * i + 1] - 0.61].map(|x: f64| x.rem_euclid(1.0)))
                .collect()
        };
        let moved: Vec<Vec<f64>> = frames.iter().map(place).collect();
        let moved_kinds: Vec<i32> = order.iter().map(|&i| kinds[i]).collect();
        let after = answer(&*model, &moved, &moved_kinds);
        let wanted: Vec<f64> = order.iter().flat_map(|&i| [before[2 * i], before[2 * i + 1]]).collect();
        assert!(largest(&after, &wanted) < 1e-9, "{name}: {}", largest(&after, &wanted));
    }
}

/// Random features on a graph, each a variable, for a network of these sizes.
fn random_inputs(sizes: &Sizes, nodes: u32) -> (Inputs, [Var; 2]) {
    let graph = ring(nodes);
    let n = nodes as usize;
    let (x, y) = (random(&[n, sizes.node_features], 61), random(&[graph.edges(), sizes.edge_features], 62));
    let kinds: Vec<u32> = (0..nodes).map(|i| i * 5 % 9).collect();
    let inputs = Inputs {
        graph,
        nodes: x.as_tensor().clone(),
        edges: y.as_tensor().clone(),
        kinds: Tensor::new(kinds, &Device::Cpu).unwrap(),
        velocity: Tensor::zeros((n, sizes.edge_features - 1), DType::F64, &Device::Cpu).unwrap(),
    };
    (inputs, [x, y])
}

/// Random numbers in place of what a new network has: its biases of 0 would prove nothing.
fn scatter(network: &dyn Network) {
    for (k, p) in network.parameters().iter().enumerate() {
        let moved = (p.values.as_tensor() + random(&[p.count()], 70 + k as u64).affine(0.3, 0.0).unwrap()).unwrap();
        p.values.set(&moved).unwrap();
    }
}

/// Values, and gradients by every parameter and by the features, of two networks with the same parameters.
fn agree(name: &str, parameters: &[Parameter], features: &[Var], [a, b]: [&dyn Fn() -> Tensor; 2]) {
    let (x, y) = (a(), b());
    assert!(largest(&plain(&x), &plain(&y)) < 1e-12, "{name}: {}", largest(&plain(&x), &plain(&y)));
    let (a, b) = (weighted(&x).backward().unwrap(), weighted(&y).backward().unwrap());
    let variables = parameters.iter().map(|p| (p.parts[0].0.as_str(), &p.values));
    for (what, variable) in variables.chain(features.iter().map(|v| ("features", v))) {
        let [a, b] = [&a, &b].map(|store| plain(store.get(variable).unwrap_or_else(|| panic!("{name}: {what}"))));
        assert!(largest(&a, &b) < 1e-12, "{name}, {what}: {}", largest(&a, &b));
    }
}

/// The whole network from candle-nn's layers against the fused one, with widths that are no multiple of a vector, and of
/// one round and several, in two and three dimensions.
#[test]
fn composed_gns_is_fused_gns() {
    let sizes = |latent, rounds, linears, d: usize| Sizes {
        node_features: 4 + 5 * d,
        edge_features: d + 1,
        outputs: d + 1,
        latent,
        rounds,
        linears,
        embedding: 3,
    };
    for (sizes, nodes) in [(sizes(12, 3, 2, 2), 40), (sizes(5, 1, 3, 3), 23), (sizes(16, 2, 4, 2), 700)] {
        let network = |kernels| Gns::new(sizes, kernels, 3, DType::F64).unwrap();
        let (fused, composed) = (network(Kernels::Fused), network(Kernels::Composed));
        let (mut inputs, features) = random_inputs(&sizes, nodes);
        // Fresh, with biases of 0, edges without features stand on the ReLU's kink; scattered, nothing does.
        let still = inputs.graph.senders.iter().zip(&inputs.graph.receivers).map(|(s, r)| f64::from(u8::from(s != r)));
        let still = Tensor::from_vec(still.collect(), (inputs.graph.edges(), 1), &Device::Cpu).unwrap();
        inputs.edges = inputs.edges.broadcast_mul(&still).unwrap();
        for fresh in [true, false] {
            if !fresh {
                scatter(&fused);
            }
            let parameters = tracked(&fused);
            let [a, b] = [&fused, &composed].map(|network| || network.apply(&inputs, &parameters).unwrap());
            agree(&format!("{sizes:?}, fresh {fresh}"), fused.parameters(), &features, [&a, &b]);
        }
    }
}

/// The equivariant network as its formulas read, on parameters cut out of their vectors one by one.
fn egnn_by_its_formulas(sizes: &Sizes, inputs: &Inputs, p: &[Tensor]) -> Tensor {
    let (latent, steps, d) = (sizes.latent, 5, sizes.edge_features - 1);
    let mlp = |inputs, outputs, norm, p: &Tensor, x: &Tensor| {
        let shape = MlpShape { inputs, hidden: latent, outputs, linears: sizes.linears, norm };
        let part = |at: std::ops::Range<usize>| p.narrow(0, at.start, at.len()).unwrap();
        let mut y = x.clone();
        for k in 0..shape.linears {
            let weight = part(shape.weight(k)).reshape(shape.size(k)).unwrap();
            y = y.matmul(&weight).unwrap().broadcast_add(&part(shape.bias(k))).unwrap();
            y = if k + 1 < shape.linears { y.relu().unwrap() } else { y };
        }
        if norm {
            let centred = y.broadcast_sub(&y.mean_keepdim(1).unwrap()).unwrap();
            let deviation = (centred.sqr().unwrap().mean_keepdim(1).unwrap() + 1e-5).unwrap().sqrt().unwrap();
            let normal = centred.broadcast_div(&deviation).unwrap();
            y = normal.broadcast_mul(&part(shape.scale())).unwrap().broadcast_add(&part(shape.offset())).unwrap();
        }
        y
    };
    let ends = |of: &[u32]| Tensor::new(of, &Device::Cpu).unwrap();
    let (senders, receivers) = (ends(&inputs.graph.senders), ends(&inputs.graph.receivers));
    let sums = |x: &Tensor| {
        let zero = Tensor::zeros((inputs.graph.nodes(), x.dim(1).unwrap()), DType::F64, &Device::Cpu).unwrap();
        zero.index_add(&receivers, x, 0).unwrap()
    };
    let velocity = |k: usize| inputs.nodes.narrow(1, k * d, d).unwrap();
    let speed = |k: usize| (velocity(k).sqr().unwrap().sum_keepdim(1).unwrap() + 1e-12).unwrap().sqrt().unwrap();
    let mut scalars: Vec<Tensor> = (0..steps).map(speed).collect();
    let others = sizes.node_features - steps * d;
    scalars.push(inputs.nodes.narrow(1, steps * d, others).unwrap());
    scalars.push(p[0].reshape((9, sizes.embedding)).unwrap().index_select(&inputs.kinds, 0).unwrap());
    let cat = |all: &[&Tensor]| Tensor::cat(all, 1).unwrap();
    let known = steps + others + sizes.embedding;
    let mut h = mlp(known, latent, true, &p[1], &Tensor::cat(&scalars, 1).unwrap());
    let (relative, length) = (inputs.edges.narrow(1, 0, d).unwrap(), inputs.edges.narrow(1, d, 1).unwrap());
    let mut x = velocity(0).zeros_like().unwrap();
    for k in 0..sizes.rounds {
        let p = &p[2 + 4 * k..6 + 4 * k];
        let (from, to) = (h.index_select(&senders, 0).unwrap(), h.index_select(&receivers, 0).unwrap());
        let messages = mlp(2 * latent + 1, latent, true, &p[0], &cat(&[&from, &to, &length]));
        h = (&h + mlp(2 * latent, latent, true, &p[1], &cat(&[&h, &sums(&messages)]))).unwrap();
        let pull = mlp(latent, 1, false, &p[2], &messages);
        x = (x + sums(&relative.broadcast_mul(&pull).unwrap())).unwrap();
        let drift = mlp(latent, steps, false, &p[3], &h);
        for k in 0..steps {
            x = (x + velocity(k).broadcast_mul(&drift.narrow(1, k, 1).unwrap()).unwrap()).unwrap();
        }
    }
    cat(&[&x, &mlp(latent, sizes.outputs - d, false, &p[2 + 4 * sizes.rounds], &h)])
}

#[test]
fn egnn_is_that_of_its_formulas() {
    for (latent, rounds, linears, d, nodes) in [(12, 3, 2, 2, 40), (7, 1, 3, 3, 23), (16, 2, 2, 2, 300)] {
        let node_features = 4 + 5 * d;
        let sizes =
            Sizes { node_features, edge_features: d + 1, outputs: d + 1, latent, rounds, linears, embedding: 3 };
        for kernels in [Kernels::Composed, Kernels::Fused] {
            let network = Egnn::new(sizes, 6, kernels, 5, DType::F64).unwrap();
            scatter(&network);
            let (inputs, features) = random_inputs(&sizes, nodes);
            let parameters = tracked(&network);
            let formulas = || egnn_by_its_formulas(&sizes, &inputs, &parameters);
            let found = || network.apply(&inputs, &parameters).unwrap();
            agree(&format!("{sizes:?}, {kernels:?}"), network.parameters(), &features, [&found, &formulas]);
        }
    }
}

/// Turned and mirrored about the box's middle (particles stay away from its edges).
#[test]
fn egnn_turns_with_the_flow_and_gns_does_not() {
    let frames = cloud();
    let kinds = vec![0; 60];
    let (sin, cos) = 0.7f64.sin_cos();
    for mirror in [1.0, -1.0] {
        let turn = |x: f64, y: f64| [cos * x - sin * y, mirror * (sin * x + cos * y)];
        let turned: Vec<Vec<f64>> = frames
            .iter()
            .map(|f| f.chunks(2).flat_map(|p| turn(p[0] - 0.5, p[1] - 0.5).map(|x| x + 0.5)).collect())
            .collect();
        for (name, model) in models() {
            let wanted: Vec<f64> = answer(&*model, &frames, &kinds).chunks(2).flat_map(|a| turn(a[0], a[1])).collect();
            let error = largest(&answer(&*model, &turned, &kinds), &wanted);
            assert_eq!(error < 1e-9, name == "egnn", "{name}: {error}");
        }
    }
}

#[test]
fn gradient_by_positions_and_parameters() {
    let frames: Vec<Var> = cloud()
        .iter()
        .map(|f| Var::from_tensor(&Tensor::from_slice(f, (60, 2), &Device::Cpu).unwrap()).unwrap())
        .collect();
    let metadata = metadata(1.0);
    let kinds = vec![0; 60];
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: None };
    let normalisation = Normalisation::new(&metadata, 3e-4, 0.145, None);
    for (name, model) in models() {
        let f = || {
            let position = frames.iter().map(|v| v.as_tensor().clone()).collect();
            let window = Window { position, temperature: Vec::new() };
            let inputs = Features::default().inputs(&scenery, &normalisation, &window, None, DType::F64).unwrap();
            model.apply(&inputs, &tracked(&*model)).unwrap()
        };
        let parameters: Vec<Var> = model.parameters().iter().map(|p| p.values.clone()).collect();
        // Biases of 0 put the self edges, whose features are all 0, exactly on the ReLU's kink.
        for (k, p) in parameters.iter().enumerate() {
            p.set(&(p.as_tensor() + random(&[p.elem_count()], 50 + k as u64).affine(0.1, 0.0).unwrap()).unwrap())
                .unwrap();
        }
        check_gradient(name, &parameters.iter().collect::<Vec<_>>(), f);
        // Small steps: a frame's normalisation makes 100 of 1, and a ReLU's kink or a pair at the radius must not lie between.
        check_gradient_with(&[1e-8], name, &frames.iter().collect::<Vec<_>>(), f);
    }
}

#[test]
fn edges_are_all_pairs_within_the_radius() {
    let frame = &cloud()[5];
    let graph = inputs(&cloud(), &[0; 60], 1.0).graph;
    let mut wanted = Vec::new();
    for i in 0..60 {
        for j in 0..60 {
            let square: f64 = (0..2)
                .map(|d| {
                    let dr = frame[2 * i + d] - frame[2 * j + d];
                    (dr - dr.round()).powi(2)
                })
                .sum();
            if square.sqrt() < 0.145 {
                wanted.push((i as u32, j as u32));
            }
        }
    }
    let found: Vec<(u32, u32)> = graph.receivers.iter().zip(&graph.senders).map(|(&r, &s)| (r, s)).collect();
    assert_eq!(found, wanted);
    assert!(wanted.len() > 150);
}

/// A particle of particles that all sit in one place clumps the list: an error, not an endless search.
#[test]
fn clumped_particles_are_an_error() {
    let metadata = metadata(1.0);
    let kinds = vec![0; 2000];
    let scenery = Scenery { metadata: &metadata, kind: &kinds, wall_temperature: None };
    let frame = Tensor::full(0.5, (2000, 2), &Device::Cpu).unwrap();
    let window = Window { position: vec![frame; 6], temperature: Vec::new() };
    let normalisation = Normalisation::new(&metadata, 3e-4, 0.145, None);
    let error = Features::default().inputs(&scenery, &normalisation, &window, None, DType::F32).unwrap_err();
    assert!(error.to_string().contains("clumped"), "{error}");
}

/// A heated box with an inlet, and a learned model of it with random parameters, in f64.
fn heated(model: HeatModel) -> (Metadata, Learned) {
    let mut metadata = metadata(1.0);
    let heat = serde_json::json!({
        "temperature_mean": 1.2, "temperature_std": 0.3, "change_mean": 0.01, "change_std": 0.05,
        "inlet_length": 0.4, "inlet_temperature": 1.0, "target_x": 0.9, "diffusivity": 0.02,
        "conductivity": 0.02, "heat_capacity": 1.0, "outlet_length": 0.1
    });
    metadata.heat = Some(serde_json::from_value(heat).unwrap());
    let mut settings = Settings::default();
    (settings.model.latent, settings.model.rounds, settings.model.embedding) = (12, 2, 4);
    settings.model.heat = model;
    let setup = Setup::new(&settings, &metadata).unwrap();
    let network: Arc<dyn Network> = Arc::from(setup.network(Kernels::Fused, 2, DType::F64).unwrap());
    scatter(&*network);
    (metadata, Learned::new("random".into(), setup, network))
}

/// On candle's graph: the frames of the plain rollout, and the gradient by the first frames and the parameters.
#[test]
fn rollout_on_the_graph_is_the_plain_one_and_has_its_gradient() {
    rollout_on_the_graph(HeatModel::Learned);
    rollout_on_the_graph(HeatModel::Conduction);
}

fn rollout_on_the_graph(heat: HeatModel) {
    let (metadata, mut learned) = heated(heat);
    let kind: Vec<i32> = (0..60).map(|i| if i % 4 == 0 { kind::SOLID_WALL } else { kind::FLUID }).collect();
    let frames = cloud();
    let still = |k: usize| kind[k / 2] == kind::SOLID_WALL;
    let place = |t: usize, k: usize| frames[if still(k) { 0 } else { t.min(5) }][k] as f32;
    let warm = noise(60, 41);
    let trajectory = Trajectory {
        name: "0".into(),
        frames: 9,
        particles: 60,
        position: (0..9).flat_map(|t| (0..120).map(move |k| (t, k))).map(|(t, k)| place(t, k)).collect(),
        temperature: Some((0..9 * 60).map(|k| (1.2 + 0.1 * warm[k % 60]) as f32).collect()),
        kind: kind.clone(),
        ..Trajectory::default()
    };
    let plainly = rollout(&learned, &metadata, &trajectory, 0, 3).unwrap();
    assert!(plainly.broken.is_none(), "{:?}", plainly.broken);

    let scenery = Scenery::of(&metadata, &trajectory);
    let seen: Vec<Frame> = (0..6).map(|frame| Frame::of(&trajectory, frame)).collect();
    let variables = |t: &[Tensor]| t.iter().map(|t| Var::from_tensor(t).unwrap()).collect::<Vec<Var>>();
    let first = window(&seen, 2).unwrap();
    let (position, temperature) = (variables(&first.position), variables(&first.temperature));
    let parameters: Vec<Var> = learned.network.parameters().iter().map(|p| p.values.clone()).collect();
    learned.parameters = tracked(&*learned.network);
    let on_graph = DifferentiableRollout::new(&learned, scenery).unwrap();
    let tensors = |v: &[Var]| v.iter().map(|v| v.as_tensor().clone()).collect::<Vec<_>>();
    let run = |mut see: Box<dyn FnMut(&Window)>| {
        let mut window = Window { position: tensors(&position), temperature: tensors(&temperature) };
        for _ in 0..3 {
            window = on_graph.advance(&window, None).unwrap();
            see(&window);
        }
        Tensor::cat(&[&window.position[5], &window.temperature[5].unsqueeze(1).unwrap()], 1).unwrap()
    };
    let mut wanted = plainly.frames.clone().into_iter();
    let inlet = std::rc::Rc::new(std::cell::Cell::new(0));
    let met = inlet.clone();
    run(Box::new(move |window| {
        let frame = wanted.next().unwrap();
        let temperature = plain(&window.temperature[5]);
        assert!(largest(&plain(&window.position[5]), &frame.position) < 1e-15);
        // Conduction adds up in another order.
        assert!(largest(&temperature, frame.temperature.as_ref().unwrap()) < 1e-14);
        met.set(met.get() + temperature.iter().filter(|t| **t == 1.0).count());
    }));
    assert!(inlet.get() > 0, "nobody met the inlet: nothing was tried");
    // Conduction begins with the last temperatures, and its network sees none.
    let seen = if heat == HeatModel::Conduction { &temperature[5..] } else { &temperature[..] };
    let all: Vec<&Var> = position.iter().chain(seen).chain(&parameters).collect();
    // Rounding of many sums asks for longer steps, edges that come and go within them for shorter ones.
    check_gradient_with(&[1e-8, 1e-7, 1e-6], "rollout", &all, || run(Box::new(|_| ())));
}
