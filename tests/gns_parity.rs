//! The graph network against LagrangeBench's: every model fixture of a folder, by the parts that it has.
//!
//! `HYDROGRAD_GNS_FIXTURES` names another folder.

use candle_core::{DType, Device, Tensor, Var};
use hydrograd::config::scene::Kernels;
use hydrograd::config::training::{HeatModel, Kind};
use hydrograd::dataset::{kind, Metadata};
use hydrograd::io::tensor_file::TensorFile;
use hydrograd::surrogate::differentiable_rollout::DifferentiableRollout;
use hydrograd::surrogate::features::{Features, Inputs, Normalisation, Window};
use hydrograd::surrogate::integrate;
use hydrograd::surrogate::models::gns::Gns;
use hydrograd::surrogate::models::learned::Learned;
use hydrograd::surrogate::models::setup::Setup;
use hydrograd::surrogate::models::sizes::Sizes;
use hydrograd::surrogate::network::adamw::AdamW;
use hydrograd::surrogate::network::parameters::{tracked, Network};
use hydrograd::surrogate::predictor::Scenery;
use hydrograd::surrogate::training::{loss, noise};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const DOUBLE: f64 = 1e-10;
const SINGLE: f64 = 1e-4;

fn folder() -> PathBuf {
    std::env::var_os("HYDROGRAD_GNS_FIXTURES")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("data/reference/gns"), PathBuf::from)
}

struct Fixture {
    file: TensorFile,
    metadata: Metadata,
    kind: Vec<i32>,
    normalisation: Normalisation,
    features: Features,
    sizes: Sizes,
    /// `[frames]` of `[N, D]`.
    frames: Vec<Tensor>,
    force: Option<Tensor>,
    failures: Vec<String>,
    checks: Vec<String>,
}

fn numbers(file: &TensorFile, name: &str) -> Vec<f64> {
    file.numbers(name).unwrap().1
}

/// `[N, T, D]` as T tensors `[N, D]`.
fn frames(file: &TensorFile, name: &str) -> Vec<Tensor> {
    let (shape, values) = file.numbers(name).unwrap();
    let all = Tensor::from_vec(values, shape, &Device::Cpu).unwrap();
    (0..shape[1]).map(|k| all.narrow(1, k, 1).unwrap().squeeze(1).unwrap().contiguous().unwrap()).collect()
}

fn plain(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference over the largest number of the reference.
fn error(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1e-300f64, |most, x| most.max(x.abs()));
    let worst =
        |worst: f64, (a, b): (&f64, &f64)| if (a - b).is_nan() { f64::INFINITY } else { worst.max((a - b).abs()) };
    ours.iter().zip(theirs).fold(0.0, worst) / scale
}

impl Fixture {
    /// None if the file holds no model fixture.
    fn read(path: &Path) -> Option<Self> {
        let file = TensorFile::read(path).unwrap();
        if !file.tensors.contains_key("in.pos_hist") || !file.tensors.contains_key("param.embed.weight") {
            return None;
        }
        let metadata: Metadata = serde_json::from_str(file.text("metadata_json").unwrap()).unwrap();
        let kind: Vec<i32> = numbers(&file, "in.particle_type").iter().map(|&k| k as i32).collect();
        let noise = numbers(&file, "in.noise_std")[0];
        let normalisation = Normalisation::new(&metadata, noise, numbers(&file, "in.cutoff")[0], None);
        let dim = metadata.dim;
        let shape = |name: &str| file.shape(name).unwrap().to_vec();
        let force_name = file.tensors.keys().find(|k| k.starts_with("in.") && k.contains("force")).cloned();
        let force = force_name.map(|name| {
            let (shape, values) = file.numbers(&name).unwrap();
            Tensor::from_vec(values, shape, &Device::Cpu).unwrap().broadcast_as((kind.len(), dim)).unwrap()
        });
        let embedding = shape("param.embed.weight")[1];
        let node_features = shape("param.enc.node.0.weight")[0] - embedding;
        let count =
            |prefix: &str| (0..).take_while(|k| file.tensors.contains_key(&format!("{prefix}{k}.weight"))).count();
        let rounds = (0..).take_while(|k| file.tensors.contains_key(&format!("param.proc.{k}.edge.0.weight"))).count();
        // Which features the fixture was made with follows from their number.
        let forces = if force.is_some() { dim } else { 0 };
        let choices = [(false, false), (false, true), (true, false), (true, true)];
        let features = choices
            .map(|(speed, boundary)| Features { speed, boundary, ..Features::default() })
            .into_iter()
            .find(|f| f.count(&metadata, false, forces) == node_features)
            .expect("a set of features with the fixture's number");
        let sizes = Sizes {
            node_features,
            edge_features: dim + 1,
            outputs: *shape("param.dec.1.weight").last().unwrap(),
            latent: shape("param.enc.edge.0.weight")[1],
            rounds,
            linears: count("param.enc.edge."),
            embedding,
        };
        let frames = frames(&file, "in.pos_hist");
        let (failures, checks) = (Vec::new(), Vec::new());
        Some(Self { file, metadata, kind, normalisation, features, sizes, frames, force, failures, checks })
    }

    fn has(&self, name: &str) -> bool {
        self.file.tensors.contains_key(name)
    }

    fn compare(&mut self, name: &str, ours: &[f64], tolerance: f64) {
        if self.has(name) {
            let error = error(ours, &numbers(&self.file, name));
            self.checks.push(format!("{name} {error:.1e}"));
            if error.is_nan() || error > tolerance {
                self.failures.push(format!("{name}: {error:.3e}, allowed {tolerance:e}"));
            }
        }
    }

    fn model(&self, dtype: DType) -> Gns {
        let model = Gns::new(self.sizes, Kernels::Fused, 0, dtype).unwrap();
        model.parameters().iter().for_each(|p| p.load(&self.file, "param.").unwrap());
        model
    }

    fn inputs(&self, frames: &[Tensor], dtype: DType) -> Inputs {
        let scenery = Scenery { metadata: &self.metadata, kind: &self.kind, wall_temperature: None };
        let window = Window { position: frames.to_vec(), temperature: Vec::new() };
        self.features.inputs(&scenery, &self.normalisation, &window, self.force.as_ref(), dtype).unwrap()
    }

    fn target(&self, frames: &[Tensor]) -> Tensor {
        loss::target_acceleration([&frames[0], &frames[1], &frames[2]], &self.normalisation, &self.metadata).unwrap()
    }

    /// `[N, D]`: 1 for particles that the model moves.
    fn mask(&self, dtype: DType) -> Tensor {
        let mask: Vec<f64> = self.kind.iter().map(|&k| if kind::is_kinematic(k) { 0.0 } else { 1.0 }).collect();
        let mask = Tensor::from_vec(mask, (self.kind.len(), 1), &Device::Cpu).unwrap();
        mask.broadcast_as((self.kind.len(), self.metadata.dim)).unwrap().to_dtype(dtype).unwrap()
    }

    /// Edges of the fixture as places in our order.
    fn edge_order(&mut self, inputs: &Inputs) -> Option<Vec<usize>> {
        if !self.has("feat.senders") {
            return None;
        }
        let ends = |name: &str| numbers(&self.file, name).iter().map(|&x| x as u32).collect::<Vec<_>>();
        let (senders, receivers) = (ends("feat.senders"), ends("feat.receivers"));
        if senders.len() != inputs.graph.edges() {
            self.failures.push(format!("{} edges, not {}", inputs.graph.edges(), senders.len()));
            return None;
        }
        let ours: std::collections::HashMap<(u32, u32), usize> =
            (0..senders.len()).map(|e| ((inputs.graph.senders[e], inputs.graph.receivers[e]), e)).collect();
        let order: Option<Vec<usize>> =
            senders.iter().zip(&receivers).map(|(&s, &r)| ours.get(&(s, r)).copied()).collect();
        if order.is_none() {
            self.failures.push("the edges are others".to_owned());
        }
        order
    }

    fn features_and_activations(&mut self) {
        let inputs = self.inputs(&self.frames[..6], DType::F64);
        let history = inputs.nodes.narrow(1, 0, 5 * self.metadata.dim).unwrap();
        self.compare("feat.vel_hist", &plain(&history), DOUBLE);
        let model = self.model(DType::F64);
        let (out, states) = model.apply_traced(&inputs, &tracked(&model)).unwrap();
        let embedded =
            tracked(&model)[0].reshape((9, self.sizes.embedding)).unwrap().index_select(&inputs.kinds, 0).unwrap();
        self.compare("feat.node_in", &plain(&Tensor::cat(&[&inputs.nodes, &embedded], 1).unwrap()), DOUBLE);
        let n = self.kind.len();
        if let Some(order) = self.edge_order(&inputs) {
            let sorted = |values: Tensor| -> Vec<f64> {
                let width = values.dim(1).unwrap();
                let values = plain(&values);
                order.iter().flat_map(|&e| values[e * width..(e + 1) * width].to_vec()).collect()
            };
            let dim = self.metadata.dim;
            self.compare("feat.rel_disp", &sorted(inputs.edges.narrow(1, 0, dim).unwrap()), DOUBLE);
            self.compare("feat.rel_dist", &sorted(inputs.edges.narrow(1, dim, 1).unwrap()), DOUBLE);
            for (k, state) in states.iter().enumerate() {
                let name = |what: &str| match k {
                    0 => format!("trace.enc.{what}"),
                    k => format!("trace.proc.{}.{what}_out", k - 1),
                };
                let edges = sorted(state.narrow(0, n, inputs.graph.edges()).unwrap());
                self.compare(&name("edge"), &edges, DOUBLE);
                self.compare(&name("node"), &plain(&state.narrow(0, 0, n).unwrap()), DOUBLE);
            }
        }
        self.compare("out.acc_f64", &plain(&out), DOUBLE);
        let next = integrate::position(&self.frames[5], &inputs, &out, &self.normalisation, &self.metadata).unwrap();
        self.compare("out.next_pos_f64", &plain(&next), DOUBLE);
        let inputs = self.inputs(&self.frames[..6], DType::F32);
        let model = self.model(DType::F32);
        self.compare("out.acc_f32", &plain(&model.apply(&inputs, &tracked(&model)).unwrap()), SINGLE);
    }

    fn loss_of(&self, model: &Gns, dtype: DType) -> Tensor {
        let inputs = self.inputs(&self.frames[..6], dtype);
        let target = self.target(&self.frames[4..7]).to_dtype(dtype).unwrap();
        let out = model.apply(&inputs, &tracked(model)).unwrap();
        loss::loss(&out, &target, &self.mask(dtype)).unwrap()
    }

    fn loss_and_gradients(&mut self) {
        if self.frames.len() < 7 {
            return;
        }
        let target = self.target(&self.frames[4..7]);
        self.compare("target.acc", &plain(&target), DOUBLE);
        for (dtype, loss, prefix, tolerance) in
            [(DType::F64, "loss.f64", "grad64.", DOUBLE), (DType::F32, "loss.f32", "grad32.", SINGLE)]
        {
            let model = self.model(dtype);
            let value = self.loss_of(&model, dtype);
            self.compare(loss, &plain(&value), tolerance);
            let gradients = value.backward().unwrap();
            for parameter in model.parameters() {
                let gradient = plain(gradients.get(&parameter.values).expect("a gradient for every parameter"));
                for (name, at, _) in &parameter.parts {
                    self.compare(&format!("{prefix}{name}"), &gradient[at.clone()], tolerance);
                }
            }
        }
    }

    fn updates(&mut self) {
        if !self.has("adamw.losses") {
            return;
        }
        let model = self.model(DType::F64);
        let variables: Vec<Var> = model.parameters().iter().map(|p| p.values.clone()).collect();
        let mut optimiser = AdamW::new(&variables).unwrap();
        let mut losses = Vec::new();
        for step in 0..numbers(&self.file, "adamw.losses").len() {
            let value = self.loss_of(&model, DType::F64);
            losses.extend(plain(&value));
            let store = value.backward().unwrap();
            let gradients: Vec<Tensor> = variables.iter().map(|v| store.get(v).unwrap().clone()).collect();
            let rate = hydrograd::surrogate::network::adamw::learning_rate(5e-4, 0.1, 100_000, 1e-6, step as u64);
            optimiser.step(&variables, &gradients, rate).unwrap();
        }
        self.compare("adamw.losses", &losses, DOUBLE);
        for parameter in model.parameters() {
            let values = plain(parameter.values.as_tensor());
            for (name, at, _) in &parameter.parts {
                // A gradient that is zero but for rounding decides about the sign of a whole Adam step: compared by
                // what the updates changed, of the size of the learning rate, not by the parameter's own size.
                self.compare(&format!("adamw.step5.{name}"), &values[at.clone()], DOUBLE);
            }
        }
    }

    fn noise_and_pushforward(&mut self) {
        if !self.has("noise.z") {
            return;
        }
        let mut noisy: Vec<Vec<f64>> = self.frames.iter().map(plain).collect();
        let z = numbers(&self.file, "noise.z");
        noise::walk(&mut noisy, &self.kind, &z, numbers(&self.file, "in.noise_std")[0], 6);
        let shape = (self.kind.len(), self.metadata.dim);
        let noisy: Vec<Tensor> = noisy
            .into_iter()
            .map(|p| Tensor::from_vec(p, shape, &Device::Cpu).unwrap())
            .map(|p| hydrograd::surrogate::features::wrap(&p, &self.metadata).unwrap())
            .collect();
        let together = |frames: &[Tensor]| plain(&Tensor::stack(frames, 1).unwrap());
        self.compare("noise.pos_noisy", &together(&noisy[..7]), DOUBLE);
        let inputs = self.inputs(&noisy[..6], DType::F64);
        let width = 5 * self.metadata.dim;
        self.compare("noise.vel_hist", &plain(&inputs.nodes.narrow(1, 0, width).unwrap()), DOUBLE);
        self.compare("noise.target_acc", &plain(&self.target(&noisy[4..7])), DOUBLE);
        if self.frames.len() < 8 {
            return;
        }
        // The first unrolled step sees the noisy features, and moves the true positions.
        let model = self.model(DType::F64);
        let out = model.apply(&inputs, &tracked(&model)).unwrap();
        let truth = Inputs { velocity: self.inputs(&self.frames[..6], DType::F64).velocity, ..inputs };
        let next = integrate::position(&self.frames[5], &truth, &out, &self.normalisation, &self.metadata).unwrap();
        let window = [&self.frames[1..6], &[next]].concat();
        self.compare("pf1.pos", &together(&window), DOUBLE);
        let inputs = self.inputs(&window, DType::F64);
        self.compare("pf1.vel_hist", &plain(&inputs.nodes.narrow(1, 0, width).unwrap()), DOUBLE);
        self.compare("pf1.target_acc", &plain(&self.target(&noisy[5..8])), DOUBLE);
    }

    /// Twenty steps with a tamed decoder, and how the last positions' distance from a frame depends on the input frames.
    fn rollout(&mut self) {
        if !self.has("roll.pos") {
            return;
        }
        let network = self.model(DType::F64);
        let tame = numbers(&self.file, "roll.decoder_last_layer_scale")[0];
        let mut parameters: Vec<Tensor> = tracked(&network).iter().map(|p| p.detach()).collect();
        let decoder = parameters.pop().unwrap();
        let last = network.parameters().last().unwrap().parts.len() - 2;
        let begin = network.parameters().last().unwrap().parts[last].1.start;
        let head = decoder.narrow(0, 0, begin).unwrap();
        let tail = decoder.narrow(0, begin, decoder.dim(0).unwrap() - begin).unwrap();
        parameters.push(Tensor::cat(&[head, (tail * tame).unwrap()], 0).unwrap());
        let setup = Setup {
            kind: Kind::Gns,
            sizes: self.sizes,
            features: self.features,
            normalisation: self.normalisation.clone(),
            heat: HeatModel::None,
            periodic: self.metadata.periodic()[..self.metadata.dim].to_vec(),
            spacing: None,
            frame_time: None,
            data: None,
        };
        let learned = Learned { name: "fixture".into(), setup, network: Arc::new(network), parameters };
        let (metadata, kind) = (self.metadata.clone(), self.kind.clone());
        let scenery = Scenery { metadata: &metadata, kind: &kind, wall_temperature: None };
        let rollout = DifferentiableRollout::new(&learned, scenery).unwrap();
        let inputs: Vec<Var> = self.frames[..6].iter().map(|f| Var::from_tensor(f).unwrap()).collect();
        let position = inputs.iter().map(|v| v.as_tensor().clone()).collect();
        let mut window = Window { position, temperature: Vec::new() };
        let mut positions = Vec::new();
        for step in 1..=20 {
            window = rollout.advance(&window, self.force.as_ref()).unwrap();
            let next = window.position[5].clone();
            positions.extend(plain(&next));
            if self.has(&format!("roll.loss_{step}")) {
                let off = hydrograd::surrogate::features::displacement(&next, &self.frames[6], &self.metadata).unwrap();
                let value = (off.sqr().unwrap().sum_all().unwrap() / self.kind.len() as f64).unwrap();
                self.compare(&format!("roll.loss_{step}"), &plain(&value), DOUBLE);
                let store = value.backward().unwrap();
                let zeros = next.zeros_like().unwrap();
                let gradient: Vec<Tensor> = inputs.iter().map(|v| store.get(v).unwrap_or(&zeros).clone()).collect();
                let gradient = plain(&Tensor::stack(&gradient, 1).unwrap());
                self.compare(&format!("roll.grad_pos_{step}"), &gradient, DOUBLE);
            }
        }
        self.compare("roll.pos", &positions, DOUBLE);
    }
}

#[test]
fn every_fixture() {
    let mut found = 0;
    let mut failures = Vec::new();
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder()).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    for path in paths.iter().filter(|p| p.extension().is_some_and(|e| e == "safetensors")) {
        let Some(mut fixture) = Fixture::read(path) else { continue };
        fixture.features_and_activations();
        fixture.loss_and_gradients();
        fixture.updates();
        fixture.noise_and_pushforward();
        fixture.rollout();
        println!("{}: {} parts", path.display(), fixture.checks.len());
        fixture.checks.iter().for_each(|check| println!("  {check}"));
        assert!(!fixture.checks.is_empty(), "{} has no part that could be checked", path.display());
        found += 1;
        failures.extend(fixture.failures.iter().map(|f| format!("{}: {f}", path.display())));
    }
    assert!(found > 0, "no model fixture in {}", folder().display());
    assert!(failures.is_empty(), "{} parts differ:\n{}", failures.len(), failures.join("\n"));
}

/// Learning rates by step, as LagrangeBench's schedule gives them.
#[test]
fn learning_rates() {
    let Ok(file) = TensorFile::read(&folder().join("metrics_lr.safetensors")) else {
        // Another folder of fixtures need not have it.
        assert!(std::env::var_os("HYDROGRAD_GNS_FIXTURES").is_some());
        return;
    };
    let steps = numbers(&file, "lr.steps");
    let ours: Vec<f64> = steps
        .iter()
        .map(|&step| hydrograd::surrogate::network::adamw::learning_rate(5e-4, 0.1, 100_000, 1e-6, step as u64))
        .collect();
    // Theirs are computed in f32.
    let worst = ours.iter().zip(numbers(&file, "lr.values")).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
    assert!(steps.len() > 5 && worst < 1e-6, "{worst:e}");
}
