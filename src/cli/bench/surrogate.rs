//! The surrogate: a training step and a prediction of a graph network simulator, beside the machine's sgemm.
//!
//! Work is counted as the split form does it, 2 rows inputs outputs for each product (L latent, M rounds, K linear layers
//! of each perceptron, F features of a node with its embedding, D dimensions, N nodes, E edges):
//!
//! * encoders: nodes F L + (K - 1) L^2 for each of N, edges (D + 1) L + (K - 1) L^2 for each of E;
//! * a round: nodes 2 L^2 (sender's and receiver's share of the edges' first layer) + 2 L^2 + (K - 1) L^2 for each of N,
//!   edges K L^2 for each of E;
//! * decoder: (K - 1) L^2 + L D for each of N.
//!
//! A training step does each product three times (forward, gradient of the weights, gradient of the inputs), the edges'
//! first twice, because nobody asks for the gradient of their features. Everything else (normalisation, sums, features,
//! neighbours, AdamW) is no work here, but its time counts.

use super::case::{Case, Kind, Length, Measured, Network, COLUMNS, ROWS};
use crate::cli::prepare::compute;
use crate::config::training::{ModelSettings, Settings};
use crate::dataset::{Metadata, Trajectory};
use crate::numerics::lanes::InstructionSet;
use crate::report::memory::{peak_memory_bytes, reset_peak_memory};
use crate::surrogate::models::learned::Learned;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::parameters;
use crate::surrogate::predictor::{Frame, Predictor, Scenery};
use crate::surrogate::training::batch::Team;
use crate::surrogate::training::checkpoint::fresh;
use crate::surrogate::training::samples::Samples;
use crate::surrogate::training::train::Training;
use candle_core::{DType, Var};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

const SPACING: f64 = 0.02;
/// Largest shift of a particle off its place of the lattice, and largest way per frame, in spacings.
const JITTER: f64 = 0.2;
const SPEED: f64 = 0.02;

/// A jittered lattice that moves; scripts/peers/surrogate.py makes the same.
pub fn flow(frames: usize) -> (Metadata, Trajectory) {
    let size = [COLUMNS as f64 * SPACING, ROWS as f64 * SPACING];
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let mut position = vec![];
    for frame in 0..frames {
        for k in 0..Network::PARTICLES {
            let jitter = |k: usize| JITTER * (2.0 * ((k * k) as f64 * golden).fract() - 1.0);
            let x = SPACING * ((k % COLUMNS) as f64 + 0.5 + jitter(2 * k));
            let y = SPACING * ((k / COLUMNS) as f64 + 0.5 + jitter(2 * k + 1));
            let way = frame as f64 * SPEED * SPACING;
            let wave = |x: f64, size: f64| (std::f64::consts::TAU * x / size).sin();
            let moved = [x + way * wave(y, size[1]), y + way * wave(x, size[0])];
            position.extend((0..2).map(|d| moved[d].rem_euclid(size[d]) as f32));
        }
    }
    let metadata = Metadata {
        dim: 2,
        dx: SPACING,
        dt: 1.0,
        write_every: 1,
        num_particles_max: Network::PARTICLES,
        periodic_boundary_conditions: vec![true; 2],
        bounds: size.map(|size| [0.0, size]).to_vec(),
        default_connectivity_radius: 1.45 * SPACING,
        vel_mean: vec![0.0; 2],
        vel_std: vec![SPEED * SPACING; 2],
        acc_mean: vec![0.0; 2],
        acc_std: vec![0.1 * SPEED * SPACING; 2],
        heat: None,
        other: serde_json::Map::new(),
    };
    let particles = Network::PARTICLES;
    (
        metadata,
        Trajectory { name: "0".into(), frames, particles, position, kind: vec![0; particles], ..Default::default() },
    )
}

/// Times steps of a case and counts their work.
pub fn measure(case: &Case, network: Network) -> anyhow::Result<Measured> {
    let Network { rounds, latent, radius } = network;
    let model = ModelSettings { rounds, latent, radius: Some(radius), ..ModelSettings::default() };
    let settings = Settings { model, noise: 0.01 * SPACING, ..Settings::default() };
    let seen = settings.features.frames;
    let (metadata, trajectory) = flow(seen + 1 + settings.pushforward.most());
    let setup = Setup::new(&settings, &metadata)?;
    let compute = compute(case.kernels, case.device)?;
    let model: Arc<dyn parameters::Network> = Arc::from(setup.network(compute, settings.seed, DType::F32)?);
    let sizes = setup.sizes;
    let scenery = Scenery::of(&metadata, &trajectory);
    let frames: Vec<Frame> = (0..seen).map(|frame| Frame::of(&trajectory, frame)).collect();
    let domain = crate::particles::Domain { dimension: 2, size: metadata.size(), periodic: metadata.periodic() };
    let graph = Graph::build(&frames[seen - 1].position, &domain, radius * SPACING)?;

    reset_peak_memory();
    let (steps, seconds) = match case.kind {
        Kind::Training => {
            let variables: Vec<Var> = model.parameters().iter().map(|p| p.values.clone()).collect();
            let train = std::slice::from_ref(&trajectory);
            let mut samples = Samples::new(&metadata, train, &settings, &setup)?;
            let mut training = Training {
                settings: &settings,
                setup: &setup,
                metadata: &metadata,
                train,
                valid: &[],
                network: model.clone(),
                state: fresh(&settings, &*model)?,
                team: Team::ALONE,
                folder: PathBuf::new(),
                is_to_stop: false,
                history: vec![],
                validation: vec![],
                objective: vec![],
                pairs: None,
            };
            let mut step = || {
                training.update(&mut samples, &variables, settings.learning_rate)?;
                training.state.step += 1;
                Ok(())
            };
            time(case, &mut step)?
        }
        _ => {
            let predictor = Learned::new(network.name(), setup.clone(), model.clone());
            time(case, &mut || predictor.next(&scenery, &frames).map(drop))?
        }
    };
    let peak_memory_bytes = peak_memory_bytes();
    let products = products(&sizes, graph.nodes(), graph.edges(), case.kind == Kind::Training);
    let sgemm = products.iter().map(|(product, times)| *times as f64 * product.seconds(case.threads)).sum::<f64>();
    let gflop = products.iter().map(|(product, times)| 1e-9 * *times as f64 * product.operations()).sum::<f64>();
    Ok(Measured {
        dimension: 2,
        pairs: graph.edges(),
        steps,
        seconds,
        peak_memory_bytes,
        instruction_set: InstructionSet::best().name().into(),
        time_step: metadata.dt,
        gflop: Some(gflop),
        sgemm_gflops: Some(gflop / sgemm),
        ..Measured::default()
    })
}

/// Runs blocks of steps: how many steps a block has, and the seconds of each.
fn time(case: &Case, step: &mut dyn FnMut() -> anyhow::Result<()>) -> anyhow::Result<(usize, Vec<f64>)> {
    let mut run = |steps: usize| -> anyhow::Result<f64> {
        let clock = Instant::now();
        (0..steps).try_for_each(|_| step())?;
        Ok(clock.elapsed().as_secs_f64())
    };
    // Pages, caches and threads warm up.
    run(1)?;
    let one = run(1)?;
    let steps = match case.length {
        Length::Steps(steps) => steps,
        Length::Seconds { seconds, least } => least.max((seconds / one) as usize),
    };
    let seconds = (0..case.blocks).map(|_| run(steps)).collect::<anyhow::Result<Vec<f64>>>()?;
    Ok((steps, seconds))
}

/// Which of the three products of a linear layer.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// y = x w.
    Output,
    /// w_bar += x^T y_bar.
    Weight,
    /// x_bar = y_bar w^T.
    Input,
}

/// A product of a linear layer on some rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Product {
    rows: usize,
    inputs: usize,
    outputs: usize,
    form: Form,
}

/// All products of a step, and how often each is there.
pub fn products(sizes: &Sizes, nodes: usize, edges: usize, training: bool) -> Vec<(Product, usize)> {
    let Sizes { latent: l, rounds, linears, .. } = *sizes;
    let mut layers = vec![
        (nodes, sizes.node_features + sizes.embedding, l, 1),
        (edges, sizes.edge_features, l, 1),
        (nodes, l, l, linears - 1 + rounds * (4 + linears - 1) + linears - 1),
        (edges, l, l, linears - 1 + rounds * linears),
        (nodes, l, sizes.outputs, 1),
    ];
    layers.retain(|(.., times)| *times > 0);
    let forms = [Form::Output, Form::Weight, Form::Input];
    let all = layers.iter().flat_map(|&(rows, inputs, outputs, times)| {
        let of_features = (rows, inputs) == (edges, sizes.edge_features);
        let forms = match training {
            true if of_features => &forms[..2],
            true => &forms[..],
            false => &forms[..1],
        };
        forms.iter().map(move |&form| (Product { rows, inputs, outputs, form }, times))
    });
    all.collect()
}

impl Product {
    /// Multiplications and additions.
    pub fn operations(&self) -> f64 {
        2.0 * (self.rows * self.inputs * self.outputs) as f64
    }

    /// The best of several runs of the `gemm` crate with so many threads.
    fn seconds(&self, threads: usize) -> f64 {
        let Self { rows, inputs, outputs, form } = *self;
        // (rows, depth, columns) and the strides (row, column) of both factors, each stored row by row.
        let ((m, k, n), a, b) = match form {
            Form::Output => ((rows, inputs, outputs), (inputs, 1), (outputs, 1)),
            Form::Weight => ((inputs, rows, outputs), (1, inputs), (outputs, 1)),
            Form::Input => ((rows, outputs, inputs), (outputs, 1), (1, outputs)),
        };
        let (left, right, mut to) = (vec![0.5_f32; m * k], vec![0.25_f32; k * n], vec![0_f32; m * n]);
        let parallel = if threads > 1 { gemm::Parallelism::Rayon(threads) } else { gemm::Parallelism::None };
        let mut run = || {
            let clock = Instant::now();
            // SAFETY: each matrix has the numbers that its sizes and strides reach, and `to` is no other's.
            unsafe {
                gemm::gemm(
                    m,
                    n,
                    k,
                    to.as_mut_ptr(),
                    1,
                    n as isize,
                    form == Form::Weight,
                    left.as_ptr(),
                    a.1 as isize,
                    a.0 as isize,
                    right.as_ptr(),
                    b.1 as isize,
                    b.0 as isize,
                    1.0,
                    1.0,
                    false,
                    false,
                    false,
                    parallel,
                );
            }
            clock.elapsed().as_secs_f64()
        };
        (0..10).map(|_| run()).fold(f64::INFINITY, f64::min)
    }
}
