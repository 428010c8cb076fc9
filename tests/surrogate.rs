//! Operators and models of the surrogate: the fused ones against ordinary candle operators, gradients against central
//! differences, symmetries.

use candle_core::{DType, Device, Tensor, Var};
use hydrograd::config::scene::Kernels;
use hydrograd::dataset::Metadata;
use hydrograd::numerics::candle::{apply2, apply3};
use hydrograd::surrogate::features::{Features, Inputs, Normalisation, Window};
use hydrograd::surrogate::models::egnn::Egnn;
use hydrograd::surrogate::models::gns::{Gns, Sizes};
use hydrograd::surrogate::network::composed;
use hydrograd::surrogate::network::gather::{gather, segment_sum, End};
use hydrograd::surrogate::network::graph::Graph;
use hydrograd::surrogate::network::interaction::{edge_shape, node_shape, Rounds};
use hydrograd::surrogate::network::layer_norm::layer_norm;
use hydrograd::surrogate::network::memory::Memory;
use hydrograd::surrogate::network::mlp::{Mlp, MlpShape};
use hydrograd::surrogate::network::parameters::{detached, tracked, Network};
use hydrograd::surrogate::predictor::Scenery;
use std::sync::Arc;

/// Pseudo-random numbers in -1..1.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
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
    check_gradient_with(1e-6, name, inputs, f);
}

fn check_gradient_with(step: f64, name: &str, inputs: &[&Var], f: impl Fn() -> Tensor) {
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
        let difference = (value(step) - value(-step)) / (2.0 * step);
        input.set(&start).unwrap();
        let along: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let scale = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        assert!(
            (along - difference).abs() < 1e-6 * scale,
            "{name}, input {k}: {along} against {difference}, scale {scale}"
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
fn gather_and_segment_sum_are_each_others_adjoint() {
    let graph = ring(23);
    for end in [End::Sender, End::Receiver] {
        let (x, y) = (random(&[23, 5], 1), random(&[graph.edges(), 5], 2));
        let (gathered, summed) = (gather(&x, &graph, end).unwrap(), segment_sum(&y, &graph, end).unwrap());
        let ends = if end == End::Sender { &graph.senders } else { &graph.receivers };
        let (gx, xs, ys) = (plain(&gathered), plain(&x), plain(&y));
        let mut sums = vec![0.0; 23 * 5];
        for (e, &i) in ends.iter().enumerate() {
            for c in 0..5 {
                assert_eq!(gx[e * 5 + c], xs[i as usize * 5 + c]);
                sums[i as usize * 5 + c] += ys[e * 5 + c];
            }
        }
        assert!(largest(&plain(&summed), &sums) < 1e-14);
        check_gradient("gather", &[&x], || gather(&x, &graph, end).unwrap());
        check_gradient("segment_sum", &[&y], || segment_sum(&y, &graph, end).unwrap());
    }
    let wrong = random(&[22, 5], 1);
    assert!(gather(&wrong, &graph, End::Sender).unwrap_err().to_string().contains("22 rows"));
}

#[test]
fn layer_norm_by_its_formula_and_its_gradient() {
    let (x, scale, offset) = (random(&[4, 7], 3), random(&[7], 4), random(&[7], 5));
    let y = plain(&layer_norm(&x, &scale, &offset, 1e-5).unwrap());
    let (xs, scales, offsets) = (plain(&x), plain(&scale), plain(&offset));
    for r in 0..4 {
        let row = &xs[r * 7..(r + 1) * 7];
        let mean = row.iter().sum::<f64>() / 7.0;
        let variance = row.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 7.0;
        for c in 0..7 {
            let wanted = (row[c] - mean) / (variance + 1e-5).sqrt() * scales[c] + offsets[c];
            assert!((y[r * 7 + c] - wanted).abs() < 1e-13);
        }
    }
    check_gradient("layer_norm", &[&x, &scale, &offset], || layer_norm(&x, &scale, &offset, 1e-5).unwrap());
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
            let memory = Memory::<f64>::default();
            let fused = || apply2(Mlp::<f64>::new(shape, &memory), &x, &p).unwrap();
            let composed = || composed::mlp(&shape, &x, &p).unwrap();
            assert!(largest(&plain(&fused()), &plain(&composed())) < 1e-12, "{shape:?} {rows}");
            let (a, b) = (weighted(&fused()).backward().unwrap(), weighted(&composed()).backward().unwrap());
            for v in [&x, &p] {
                assert!(largest(&plain(a.get(v).unwrap()), &plain(b.get(v).unwrap())) < 1e-10, "{shape:?} {rows}");
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
        let memory = Memory::<f64>::default();
        let fused = || {
            let op = Rounds::<f64>::new(&graph, (latent, latent, linears), rounds, true, &memory, None);
            apply3(op, &x, &y, &p).unwrap()
        };
        let composed = || {
            let (mut a, mut b) = (x.as_tensor().clone(), y.as_tensor().clone());
            for k in 0..rounds {
                let edge_p = p.narrow(0, k * length, edge.parameters()).unwrap();
                let node_p = p.narrow(0, k * length + edge.parameters(), node.parameters()).unwrap();
                (a, b) = composed::interaction(&graph, (&edge, &node), (&a, &b), (&edge_p, &node_p)).unwrap();
            }
            a
        };
        assert!(largest(&plain(&fused()), &plain(&composed())) < 1e-12);
        let (a, b) = (weighted(&fused()).backward().unwrap(), weighted(&composed()).backward().unwrap());
        for v in [&x, &y, &p] {
            assert!(largest(&plain(a.get(v).unwrap()), &plain(b.get(v).unwrap())) < 1e-10);
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
        ("egnn", Box::new(Egnn::new(SIZES, 6, 1, DType::F64).unwrap())),
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
        check_gradient_with(1e-8, name, &frames.iter().collect::<Vec<_>>(), f);
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
