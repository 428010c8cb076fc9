//! What runs on a GPU, against the same on the CPU: steps and gradients of every formulation, and networks.
//!
//! `HYDROGRAD_DEVICE=cuda:0 scripts/cuda.sh cargo test --release --features cuda device::` compares that device. Where none is
//! named, what a GPU does differently is done on the CPU: gathers whose adjoints are sums by place.

use crate::support::consistent::{isotropic, noisy_channel, numbers, verlet, vortices, Case};
use crate::support::final_sum::{FinalSum, Summed};
use crate::support::random_scene::{Options, RandomScene};
use candle_core::{DType, Device, Tensor, Var};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::{Dynamics, Objective};
use hydrograd::config::device::{Compute, DeviceName};
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::numerics::gather::{sum_by_place_everywhere, Gather};
use hydrograd::numerics::random::{stream, uniform, Normal};
use hydrograd::particles::neighbour_list::Workspace;
use hydrograd::particles::{tag, Domain, NeighbourList};
use hydrograd::scene::Scene;
use hydrograd::sph::consistent::arrangement::Shift;
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::solver::{Snapshot, TensorSolver};
use hydrograd::sph::Sweeps;
use hydrograd::surrogate::features::Inputs;
use hydrograd::surrogate::models::egnn::Egnn;
use hydrograd::surrogate::models::gns::Gns;
use hydrograd::surrogate::models::sizes::Sizes;
use hydrograd::surrogate::network::graph::Graph;
use hydrograd::surrogate::network::parameters::{tracked, Network};
use std::sync::Arc;

/// The device to compare, if one is named.
fn named() -> Option<DeviceName> {
    let name = std::env::var("HYDROGRAD_DEVICE").ok()?;
    Some(name.parse().unwrap_or_else(|problem| panic!("HYDROGRAD_DEVICE: {problem}")))
}

/// What something comes to: its numbers, row by row of so many.
struct Answer {
    name: String,
    columns: usize,
    numbers: Vec<f64>,
}

fn answer(name: impl Into<String>, columns: usize, numbers: Vec<f64>) -> Answer {
    Answer { name: name.into(), columns, numbers }
}

/// The largest difference of each row over the row's largest number (or over next to nothing beside that of all rows).
fn gap(found: &Answer, expected: &Answer) -> f64 {
    assert_eq!((&found.name, found.numbers.len()), (&expected.name, expected.numbers.len()));
    let most = |numbers: &mut dyn Iterator<Item = f64>| numbers.fold(0.0_f64, |m, x| if x <= m { m } else { x });
    let least = 1e-14 * expected.numbers.iter().fold(1e-280_f64, |m, x| m.max(x.abs()));
    let row = |(a, b): (&[f64], &[f64])| {
        let scale = b.iter().fold(least, |m, x| m.max(x.abs()));
        most(&mut a.iter().zip(b).map(|(a, b)| (a - b).abs() / scale))
    };
    let rows = |of: &'_ Answer| of.numbers.chunks(of.columns).map(<[f64]>::to_vec).collect::<Vec<_>>();
    let (found, expected) = (rows(found), rows(expected));
    most(&mut found.iter().zip(&expected).map(|(a, b)| row((a, b))))
}

/// Two ways to compute the same thing agree to these in single and in double precision. (Three steps of the standard method over a curved
/// wall leave 230 roundings between an H200 and the CPU, in the least of the components: 2.3e-5 and 5e-14. All else is within 4e-6.)
const TOLERANCE: [f64; 2] = [5e-5, 1e-12];

/// Whether all answers agree; what was compared is printed.
fn compare<R: Sweeps>(found: &[Answer], expected: &[Answer]) {
    let (tolerance, precision) = match R::DTYPE {
        DType::F32 => (TOLERANCE[0], "f32"),
        _ => (TOLERANCE[1], "f64"),
    };
    assert!(found.len() == expected.len() && !found.is_empty());
    let mut wrong = Vec::new();
    for (found, expected) in found.iter().zip(expected) {
        let gap = gap(found, expected);
        println!("{precision}, {}: {gap:.1e}", found.name);
        let scale = expected.numbers.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        assert!(scale > 0.0, "{}: nothing but 0", found.name);
        if gap.is_nan() || gap > tolerance {
            wrong.push(format!("{}: {gap:.1e}", found.name));
        }
    }
    assert!(wrong.is_empty(), "{precision}, beyond {tolerance:e}:\n{}", wrong.join("\n"));
}

/// A step and its gradient, of the consistent formulation.
fn of_case<R: Sweeps>(case: &Case<R>, compute: &Compute) -> Vec<Answer> {
    let n = case.model.particles();
    let (state, bar) = case.taped(compute.clone(), 1, &case.random("bar"));
    vec![answer(format!("{}: step", case.name), n, state), answer(format!("{}: gradient", case.name), n, bar)]
}

/// The same of the standard formulation.
fn of_random_scene<R: Sweeps>(options: Options, compute: &Compute) -> Vec<Answer> {
    let scene = RandomScene::new(options);
    let (model, n) = (scene.model::<R>(), scene.particles());
    let first = Snapshot::first(&model, scene.state::<R>());
    let shape = (model.layout.state_rows(), n);
    let mut tape = TensorSolver::restore(model, &first, compute.clone()).unwrap();
    let start = Var::from_tensor(&Tensor::from_slice(&first.state, shape, &Device::Cpu).unwrap()).unwrap();
    let after = tape.advance(start.as_tensor()).unwrap();
    let mut normal = Normal::new(stream(5, "bar"));
    let bar: Vec<R> = (0..first.state.len()).map(|_| R::of(normal.next())).collect();
    let bar = Tensor::from_vec(bar, shape, &Device::Cpu).unwrap();
    let gradients = after.mul(&bar).unwrap().sum_all().unwrap().backward().unwrap();
    let name = format!("{options:?}");
    vec![
        answer(format!("{name}: step"), n, numbers::<R>(&after)),
        answer(format!("{name}: gradient"), n, numbers::<R>(gradients.get(&start).unwrap())),
    ]
}

/// A design run: the state behind some steps, the objective and its gradient by the first state, by a schedule.
fn of_design<R: Sweeps>(sets: &[&str], compute: &Compute) -> Vec<Answer> {
    const STEPS: usize = 3;
    let usual = ["design.shape=sine", "design.amplitude=0.01", "time.steps=3", "objective.window=0"];
    let sets: Vec<String> = usual.iter().chain(sets).map(|set| set.to_string()).collect();
    let config = Config::load(None, None, &sets).unwrap_or_else(|error| panic!("{error}")).config;
    let problem = Scene::<R>::from_config(&config).unwrap().design.unwrap();
    let (start, n) = (problem.start(&problem.first), problem.model.particles());
    let dynamics = Sph::new(problem.model.clone(), compute.clone());
    let mut run = dynamics.start(&start).unwrap();
    (0..STEPS).for_each(|_| dynamics.advance(&mut run).unwrap());
    let state = run.state.iter().map(|x| x.f64()).collect();
    let schedule = Schedule::segments(STEPS, 2);
    // So soon no heat has come to the outlet.
    let sum: Arc<dyn Objective + Send> = Arc::new(FinalSum { steps: STEPS, of: Summed::SquaredHeat });
    let objective = if problem.model.wall_heat_until.is_some() { problem.objective.clone() } else { sum };
    let found = gradient(&dynamics, &start, &schedule, &*objective, &mut |_| ()).unwrap();
    let name = format!("design {}", sets.join(" "));
    vec![
        answer(format!("{name}: {STEPS} steps"), n, state),
        answer(format!("{name}: objective"), 1, vec![found.value]),
        answer(format!("{name}: gradient"), n, numbers::<R>(&found.state)),
    ]
}

/// Steps and gradients of every formulation, in two and three dimensions, with and without heat and walls.
fn flows<R: Sweeps>(compute: &Compute) -> Vec<Answer> {
    let cases = [
        vortices::<R>(2, false, isotropic()),
        vortices(2, true, Shift::None),
        vortices(3, true, isotropic()),
        verlet(2, false),
        noisy_channel(&["method.integrator=verlet", "time.cfl=1"]),
        noisy_channel(&["method.shift=isotropic"]),
        noisy_channel(&["method.shift=rows", "fluid.drive=flow-rate"]),
    ];
    let mut all: Vec<Answer> = cases.iter().flat_map(|case| of_case(case, compute)).collect();
    let rich = Options { transport: false, heat: false, density: true, seed: 3, ..Options::rich(2) };
    for options in [Options::plain(2), Options::rich(2), Options::rich(3), rich] {
        all.extend(of_random_scene::<R>(options, compute));
    }
    let fixed = "method.name=fixed";
    for sets in [
        &["method.name=standard"][..],
        &["method.name=consistent"],
        &[fixed],
        &[fixed, "fluid.drive=flow-rate", "objective.kind=wall-heat"],
    ] {
        all.extend(of_design::<R>(sets, compute));
    }
    all
}

/// Outputs of networks and their gradients by all parameters and by the features.
fn networks(compute: &Compute, dtype: DType) -> Vec<Answer> {
    let sizes =
        Sizes { node_features: 14, edge_features: 3, outputs: 3, latent: 12, rounds: 3, linears: 2, embedding: 4 };
    let nodes = 60_u32;
    // Not symmetric: a node that nobody sends to but itself, and one with many edges.
    let mut edges: Vec<(u32, u32)> = (0..nodes).map(|i| (i, i)).collect();
    edges.extend((0..nodes - 1).map(|i| (i, (i * 7 + 3) % (nodes - 1))).filter(|(from, to)| from != to));
    edges.extend((1..nodes).map(|i| (i, 0)));
    let graph = Arc::new(Graph::new(nodes as usize, edges));
    let mut normal = Normal::new(stream(7, "features"));
    let mut random = |shape: &[usize]| {
        let values: Vec<f64> = (0..shape.iter().product()).map(|_| 0.5 * normal.next()).collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap().to_dtype(dtype).unwrap()
    };
    let (n, e) = (nodes as usize, graph.edges());
    let features = [random(&[n, 14]), random(&[e, 3])].map(|tensor| Var::from_tensor(&tensor).unwrap());
    let inputs = Inputs {
        graph,
        nodes: features[0].as_tensor().clone(),
        edges: features[1].as_tensor().clone(),
        kinds: Tensor::new((0..nodes).map(|i| i * 5 % 9).collect::<Vec<_>>(), &Device::Cpu).unwrap(),
        velocity: Tensor::zeros((n, 2), DType::F64, &Device::Cpu).unwrap(),
    };
    let weights = random(&[n, 3]);
    let gns = Gns::new(sizes, compute.clone(), 3, dtype).unwrap();
    let egnn = Egnn::new(sizes, 6, compute.clone(), 5, dtype).unwrap();
    let all: [(&str, Box<dyn Network>); 2] = [("GNS", Box::new(gns)), ("EGNN", Box::new(egnn))];
    let mut found = Vec::new();
    for (name, network) in all {
        // Biases of 0 would prove nothing.
        for parameter in network.parameters() {
            let moved =
                (parameter.values.as_tensor() + random(&[parameter.count()]).affine(0.3, 0.0).unwrap()).unwrap();
            parameter.values.set(&moved).unwrap();
        }
        let output = network.apply(&inputs, &tracked(&*network)).unwrap();
        assert!(output.device().is_cpu() && output.dtype() == dtype);
        let gradients = (&output * &weights).unwrap().sum_all().unwrap().backward().unwrap();
        let plain = |tensor: &Tensor| {
            let plain = tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap();
            (plain.len(), plain)
        };
        let mut add = |what: String, tensor: &Tensor| {
            let (columns, numbers) = plain(tensor);
            found.push(answer(format!("{name}: {what}"), columns, numbers));
        };
        add("output".into(), &output);
        for parameter in network.parameters() {
            add(format!("gradient by {}", parameter.parts[0].0), gradients.get(&parameter.values).unwrap());
        }
        for (what, features) in ["nodes", "edges"].iter().zip(&features) {
            add(format!("gradient by {what}"), gradients.get(features).unwrap());
        }
    }
    found
}

fn everything<R: Sweeps>(compute: &Compute) -> Vec<Answer> {
    let mut all = flows::<R>(compute);
    all.extend(networks(compute, R::DTYPE));
    all
}

/// Everything with sums by place, as a GPU takes them, against candle's own.
fn sums_by_place_change_nothing<R: Sweeps>() {
    let compute = Compute::from(Kernels::Composed);
    let expected = everything::<R>(&compute);
    sum_by_place_everywhere(true);
    let found = std::panic::catch_unwind(|| everything::<R>(&compute));
    sum_by_place_everywhere(false);
    compare::<R>(&found.unwrap(), &expected);
}

#[test]
fn sums_by_place_change_nothing_in_double_precision() {
    crate::in_a_process_of_its_own!();
    sums_by_place_change_nothing::<f64>();
}

#[test]
fn sums_by_place_change_nothing_in_single_precision() {
    crate::in_a_process_of_its_own!();
    sums_by_place_change_nothing::<f32>();
}

/// The named device against the CPU.
#[test]
fn the_device_agrees_with_the_cpu() {
    crate::in_a_process_of_its_own!();
    let Some(name) = named() else {
        println!("not compared: HYDROGRAD_DEVICE names no device");
        return;
    };
    let there = Compute::new(Kernels::Fused, name.open().unwrap_or_else(|problem| panic!("{problem}")));
    println!("{name}: {:?}", there.device().location());
    let here = Compute::from(Kernels::Composed);
    compare::<f64>(&everything::<f64>(&there), &everything::<f64>(&here));
    compare::<f32>(&everything::<f32>(&there), &everything::<f32>(&here));
}

/// Rows by number and sums by number, with their derivatives, by place and as candle has them.
#[test]
fn gathers_are_candles_own() {
    crate::in_a_process_of_its_own!();
    let mut rng = stream(11, "gather");
    let lists: Vec<(Vec<u32>, usize)> = vec![
        // Every row named once, in another order; one row named by all; one that nobody names, the first and the last.
        ((0..12).map(|i| i * 5 % 12).collect(), 12),
        (vec![3; 9], 5),
        (vec![1, 1, 2, 1], 4),
        (vec![0], 1),
        // A padded list, whose rows end with their own number, as often as another has neighbours.
        (vec![1, 2, 3, 0, 0, 0, 2, 2, 2, 3, 3, 3], 4),
        ((0..500).map(|_| (40.0 * uniform(&mut rng)) as u32).collect(), 47),
    ];
    let mut normal = Normal::new(stream(12, "rows"));
    let mut random = |shape: [usize; 2]| {
        let values: Vec<f64> = (0..shape[0] * shape[1]).map(|_| normal.next()).collect();
        Tensor::from_vec(values, &shape, &Device::Cpu).unwrap()
    };
    for (numbers, rows) in &lists {
        let m = numbers.len();
        let plain = Gather::new(numbers, *rows, &Device::Cpu).unwrap();
        sum_by_place_everywhere(true);
        let by_place = Gather::new(numbers, *rows, &Device::Cpu).unwrap();
        sum_by_place_everywhere(false);
        for dim in [0, 1] {
            let shape = |count: usize| if dim == 0 { [count, 3] } else { [3, count] };
            for (x, bar, sums) in
                [(random(shape(*rows)), random(shape(m)), false), (random(shape(m)), random(shape(*rows)), true)]
            {
                let of = |gather: &Gather| {
                    let x = Var::from_tensor(&x).unwrap();
                    // Not contiguous, and used twice.
                    let turned = x.t().unwrap().contiguous().unwrap().t().unwrap();
                    let x2 = (&turned + x.as_tensor()).unwrap();
                    let y = match sums {
                        true => gather.sums(&x2.contiguous().unwrap(), dim),
                        false => gather.rows(&x2, dim),
                    };
                    let y = y.unwrap();
                    let loss = (y.sqr().unwrap() * &bar).unwrap().sum_all().unwrap();
                    let gradients = loss.backward().unwrap();
                    let found = gradients.get(&x).unwrap().to_vec2::<f64>().unwrap();
                    (y.dims().to_vec(), y.to_vec2::<f64>().unwrap().concat(), found.concat())
                };
                let ((dims, values, gradient), (own_dims, own_values, own_gradient)) = (of(&by_place), of(&plain));
                assert_eq!(dims, own_dims);
                let far = |a: &[f64], b: &[f64]| {
                    let scale = b.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
                    a.iter().zip(b).any(|(a, b)| (a - b).is_nan() || (a - b).abs() > 1e-12 * scale)
                };
                assert!(values.len() == own_values.len() && gradient.len() == own_gradient.len());
                assert!(!far(&values, &own_values), "{rows} rows by {m}, dim {dim}, sums {sums}: values");
                assert!(!far(&gradient, &own_gradient), "{rows} rows by {m}, dim {dim}, sums {sums}: gradients");
            }
        }
    }
    assert!(Gather::new(&[0, 4], 4, &Device::Cpu).is_ok(), "candle itself finds that, when it looks");
    sum_by_place_everywhere(true);
    let beyond = Gather::new(&[0, 4], 4, &Device::Cpu);
    sum_by_place_everywhere(false);
    assert!(beyond.unwrap_err().to_string().contains("row 4 of 4"));
}

/// What is made of a list is kept, until the list is another one.
#[test]
fn tensors_of_a_list_are_of_that_list() {
    crate::in_a_process_of_its_own!();
    let domain = Domain { dimension: 2, size: [1.0; 3], periodic: [true; 3] };
    let mut rng = stream(13, "list");
    let mut position = || (0..200).map(|_| uniform(&mut rng)).collect::<Vec<f64>>();
    let (first, second, tags) = (position(), position(), vec![tag::FLUID; 100]);
    let new = |position: &[f64]| NeighbourList::build(position, &tags, &domain, 0.2, 16).unwrap();
    let neighbours = |list: &NeighbourList| {
        let (index, mask) = list.tensors(&Device::Cpu, DType::F64).unwrap();
        let numbers = Tensor::arange(0.0, 100.0, &Device::Cpu).unwrap().unsqueeze(0).unwrap();
        let found = index.rows(&numbers, 1).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
        (found, mask.flatten_all().unwrap().to_vec1::<f64>().unwrap(), mask.id())
    };
    let plain = [&first, &second].map(|position| neighbours(&new(position)));
    sum_by_place_everywhere(true);
    let mut list = new(&first);
    let (found, again) = (neighbours(&list), neighbours(&list));
    let elsewhere = std::thread::scope(|scope| scope.spawn(|| neighbours(&list).2).join().unwrap());
    list.rebuild(&second, &tags, &domain, 0.2, &mut Workspace::default()).unwrap();
    let later = neighbours(&list);
    sum_by_place_everywhere(false);
    assert!(found.2 == again.2 && found.2 != elsewhere && found.2 != later.2);
    assert!((found.0, found.1) == (plain[0].0.clone(), plain[0].1.clone()));
    assert!((later.0, later.1) == (plain[1].0.clone(), plain[1].1.clone()));
    assert!(plain[0].0 != plain[1].0 && plain[0].2 != neighbours(&new(&first)).2);
}

/// A device that is not there is one clear error, whatever the build.
#[test]
fn a_device_that_is_not_there_says_so() {
    let problem = DeviceName::Cuda(77).open().unwrap_err();
    assert!(problem.is_about("run.device"));
    let text = problem.to_string();
    assert!(text.starts_with("there is no device cuda:77: ") && text.contains("run.device=cpu"), "{text}");
    assert_eq!(text.contains("without CUDA"), !cfg!(feature = "cuda"), "{text}");
    assert!(DeviceName::Cpu.open().unwrap().is_cpu());
}
