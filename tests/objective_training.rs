//! Data sets of pairs of walls with their objective, and training on the objective of a rollout.

use crate::support::program::{refused, succeeds};
use assert_cmd::Command;
use candle_core::{DType, Tensor};
use hydrograd::config::layers::Setting;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::config::training::ObjectiveLoss;
use hydrograd::dataset::objective::objective;
use hydrograd::dataset::store::read_provenance;
use hydrograd::dataset::{read_split, Metadata, Split};
use hydrograd::surrogate::load_learned;
use hydrograd::surrogate::training::objective::Pairs;
use std::path::Path;

const SCENE: [&str; 3] = ["resolution.dx=0.025", "time.jitter=0.02", "channel.height=0.2"];

/// A data set of pairs and a model, hardly trained, made once for all tests.
fn folder() -> &'static Path {
    static FOLDER: std::sync::OnceLock<tempfile::TempDir> = std::sync::OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            succeeds(folder.path(), &generate(&["--pairs", "0.004", "--objective", "--out", "data"]));
            succeeds(folder.path(), &train(&["--steps", "2", "--out", "train"]));
            folder
        })
        .path()
}

fn generate<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let mut all = vec!["generate", "heated-channel", "--trajectories", "4/2/2", "--frames", "12", "--skip", "20"];
    SCENE.iter().for_each(|set| all.extend(["--set", set]));
    all.extend(more);
    all
}

fn train<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let mut all = vec!["train", "--data", "data"];
    let small = ["model.latent=8", "model.rounds=2", "validation_steps=4", "validation_windows=1", "validate_every=2"];
    small.iter().chain(&["store_every=1", "log_every=1"]).for_each(|set| all.extend(["--set", set]));
    ["objective.weight=0.5", "objective.steps=4"].iter().for_each(|set| all.extend(["--set", set]));
    all.extend(more);
    all
}

fn refuses(arguments: &[&str], expected: &[&str]) {
    let output = Command::cargo_bin("hydrograd").unwrap().current_dir(folder()).args(arguments).output().unwrap();
    refused(arguments, &output, expected);
    assert!(!folder().join("unwritten").exists(), "something was written");
}

/// The walls of a pair differ by at most the given length, and both flows begin alike.
#[test]
fn walls_come_in_pairs() {
    let data = folder().join("data");
    let metadata = Metadata::read(&data).unwrap();
    assert_eq!(metadata.other["pairs"], 0.004);
    for split in Split::ALL {
        let path = split.path(&data);
        let file = hdf5::File::open(&path).unwrap();
        let seed = |name: &str| read_provenance(&path, &file.group(name).unwrap()).unwrap().seed;
        for pair in read_split(&data, &metadata, split).unwrap().chunks(2) {
            let [a, b] = pair else { panic!("a trajectory without its neighbour") };
            assert_eq!(seed(&a.name), seed(&b.name));
            let change = a.wall_offset.iter().zip(&b.wall_offset).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
            assert!((5e-4..=0.004 + 1e-12).contains(&change), "{change}");
            // At the inlet, far from the hot wall, particles hardly know which wall is theirs.
            assert!((0..a.particles).any(|i| a.kind[i] == 0 && a.position_of(0)[2 * i] == b.position_of(0)[2 * i]));
        }
    }
    refuses(&generate(&["--pairs", "0.02", "--out", "unwritten"]), &["pairs = 0.02 is out of range", "design.bound"]);
    let odd = ["generate", "heated-channel", "--pairs", "0.004", "--trajectories", "3/2/2", "--out", "unwritten"];
    refuses(&odd, &["3/2/2 with pairs", "even numbers"]);
    let given = ["generate", "heated-channel", "--pairs", "0.004", "--walls", "scene", "--out", "unwritten"];
    refuses(&given, &["pairs of the scene's own wall"]);
    refuses(
        &["generate", "taylor-green", "--objective", "--out", "unwritten"],
        &["no walls to shape", "heated-channel"],
    );
}

/// A wall of a table and its neighbour make a pair, which keeps to the bound where the wall of the table reaches it.
#[test]
fn pairs_over_a_table_of_walls() {
    let nodes = read_split(&folder().join("data"), &Metadata::read(&folder().join("data")).unwrap(), Split::Test)
        .unwrap()[0]
        .wall_offset
        .len();
    let bound = 0.02;
    let line = |height: f64| vec![height.to_string(); nodes].join(",");
    std::fs::write(folder().join("walls.csv"), [line(bound), line(-0.003), line(0.001)].join("\n")).unwrap();
    let from = ["--walls-file", "walls.csv", "--out", "given", "--set", "design.bound=0.02"];
    succeeds(folder(), &[generate(&["--pairs", "0.004"]), from.to_vec()].concat());
    let data = folder().join("given");
    let all = read_split(&data, &Metadata::read(&data).unwrap(), Split::Train).unwrap();
    for (pair, height) in all.chunks(2).zip([bound, -0.003]) {
        assert!(pair[0].wall_offset.iter().all(|offset| *offset == height));
        let change: Vec<f64> = pair[1].wall_offset.iter().map(|offset| offset - height).collect();
        assert!(change.iter().any(|change| change.abs() > 1e-4), "{change:?}");
        assert!(change.iter().all(|change| change.abs() <= 0.004 + 1e-12 && height + change <= bound), "{change:?}");
    }
}

/// What a data set says of a wall is what fixed particles say, and its derivative is that by differences.
#[test]
fn trajectories_have_their_objective() {
    let data = folder().join("data");
    let metadata = Metadata::read(&data).unwrap();
    let settings: Vec<Setting> = SCENE.iter().map(|text| Setting::set(text)).collect();
    let loaded = Config::load_settings(None, None, &settings).unwrap();
    let trajectory = &read_split(&data, &metadata, Split::Train).unwrap()[1];
    let (value, by_nodes) = objective(&loaded, &trajectory.wall_offset).unwrap();
    assert_eq!((trajectory.objective, &trajectory.objective_gradient), (Some(value), &by_nodes));
    let direction: Vec<f64> = (0..by_nodes.len()).map(|k| ((k * k + 3) as f64).sin()).collect();
    let along: f64 = direction.iter().zip(&by_nodes).map(|(d, g)| d * g).sum();
    let at = |step: f64| {
        let moved: Vec<f64> = trajectory.wall_offset.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
        objective(&loaded, &moved).unwrap().0
    };
    let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
    assert!((along / difference - 1.0).abs() < 1e-5, "{along:e}, by differences {difference:e}");
}

/// The gradient of the loss by the parameters, along itself, is that of differences.
#[test]
fn the_gradient_by_the_parameters_is_that_of_differences() {
    let data = folder().join("data");
    let metadata = Metadata::read(&data).unwrap();
    let train = read_split(&data, &metadata, Split::Train).unwrap();
    // Not a new network: its biases are 0, so the edge of a particle to itself, whose features are 0, is at a rectifier's kink.
    let model = load_learned(&folder().join("train/last.safetensors"), Kernels::Fused, DType::F64).unwrap();
    let (setup, network) = (model.setup, model.network);
    let settings = ObjectiveLoss { weight: 0.5, steps: 4, ..ObjectiveLoss::default() };
    let mut pairs = Pairs::new(&settings, 1, &setup, &network, &metadata, &train).unwrap();
    let (_, gradient) = pairs.gradient(7, &*network).unwrap();
    let square: f64 = gradient.iter().map(|g| g.sqr().unwrap().sum_all().unwrap().to_scalar::<f64>().unwrap()).sum();
    assert!(square > 0.0 && square.is_finite());
    let first: Vec<Tensor> =
        network.parameters().iter().map(|p| p.values.as_detached_tensor().copy().unwrap()).collect();
    let mut at = |step: f64| {
        for ((parameter, first), along) in network.parameters().iter().zip(&first).zip(&gradient) {
            parameter.values.set(&(first + (along * (step / square.sqrt())).unwrap()).unwrap()).unwrap();
        }
        pairs.gradient(7, &*network).unwrap().0
    };
    // Where a pair of particles comes into the network's reach or leaves it between both sides, differences jump.
    let mut error = |step: f64| ((at(step) - at(-step)) / (2.0 * step) / square.sqrt() - 1.0).abs();
    let errors = [1e-6, 1e-7, 1e-8].map(&mut error);
    assert!(errors.iter().any(|&error| error < 1e-5), "{errors:?}");
}

/// A training writes the errors of its objective, and continues with the same bits after a stop.
#[test]
fn a_training_on_the_objective_continues() {
    let inside = folder();
    succeeds(inside, &train(&["--steps", "4", "--out", "whole"]));
    succeeds(inside, &train(&["--steps", "2", "--out", "parts"]));
    succeeds(inside, &train(&["--steps", "4", "--out", "parts", "--resume"]));
    let bits = |folder: &str| load_learned(&inside.join(folder).join("last.safetensors"), Kernels::Fused, DType::F32);
    let numbers = |folder: &str| -> Vec<Vec<f32>> {
        bits(folder).unwrap().parameters.iter().map(|p| p.flatten_all().unwrap().to_vec1().unwrap()).collect()
    };
    assert_eq!(numbers("whole"), numbers("parts"));
    let rows = std::fs::read_to_string(inside.join("parts/objective.csv")).unwrap();
    let rows: Vec<&str> = rows.lines().collect();
    assert_eq!(rows[0], "step,seconds,value,difference");
    assert_eq!(rows.len(), 3);
    // Another training of the same data without it ends elsewhere.
    succeeds(inside, &train(&["--steps", "4", "--out", "without", "--set", "objective.weight=0"]));
    assert_ne!(numbers("whole"), numbers("without"));
    assert!(!inside.join("without/objective.csv").exists());
}

/// Data that cannot tell what a change of the wall does are refused.
#[test]
fn data_without_pairs_are_refused() {
    succeeds(folder(), &generate(&["--out", "single"]));
    let mut single = train(&["--out", "unwritten"]);
    single[2] = "single";
    refuses(&single, &["no pairs of neighbouring walls", "pairs=0.004"]);
    refuses(&train(&["--out", "unwritten", "--set", "objective.steps=9"]), &["has 12 frames", "15 frames or more"]);
}
