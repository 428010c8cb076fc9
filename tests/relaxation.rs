//! Relaxation of predicted particles by SPH (Neural SPH): against a plain sum over all pairs, its symmetry, its gradient and the
//! command line; and the external force as a feature.

use crate::support::program::{refused, succeeds};
use assert_cmd::Command;
use candle_core::{Device, Tensor, Var};
use hydrograd::dataset::metadata::ExternalForce;
use hydrograd::dataset::Metadata;
use hydrograd::io::tensor_file::{write_tensors, TensorFile};
use hydrograd::numerics::random::{stream, uniform};
use hydrograd::surrogate::predictor::Scenery;
use hydrograd::surrogate::relaxation::Relaxation;
use std::collections::BTreeMap;
use std::path::Path;

const DX: f64 = 0.1;

fn box_of(across: f64, is_open: bool) -> Metadata {
    let bounds = vec![[0.0, 1.2], [0.0, across]];
    let periodic_boundary_conditions = vec![true, !is_open];
    Metadata { dim: 2, dx: DX, bounds, periodic_boundary_conditions, ..Metadata::default() }
}

/// A jittered lattice `[N, 2]` of 12 columns, from `low` on, and the same a little earlier.
fn lattice(rows: usize, low: f64, jitter: f64) -> (Vec<f64>, Vec<f64>) {
    let mut rng = stream(5, "lattice");
    let mut draw = || uniform(&mut rng) - 0.5;
    let mut now = Vec::new();
    for row in 0..rows {
        for column in 0..12 {
            let place = [(column as f64 + 0.5) * DX, low + (row as f64 + 0.5) * DX];
            now.extend(place.map(|x| x + jitter * DX * draw()));
        }
    }
    let last = now.iter().map(|x| (x + 0.05 * DX * draw()).max(0.0)).collect();
    (now, last)
}

fn tensor(position: &[f64]) -> Tensor {
    Tensor::from_slice(position, (position.len() / 2, 2), &Device::Cpu).unwrap()
}

fn numbers(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// The quintic kernel of smoothing length 1 in two dimensions, and its derivative (Morris, Fox and Zhu 1997).
fn quintic(q: f64) -> (f64, f64) {
    let sigma = 7.0 / (478.0 * std::f64::consts::PI);
    let part = |k: f64, power: i32| (k - q).max(0.0).powi(power);
    let w = part(3.0, 5) - 6.0 * part(2.0, 5) + 15.0 * part(1.0, 5);
    let slope = -5.0 * (part(3.0, 4) - 6.0 * part(2.0, 4) + 15.0 * part(1.0, 4));
    (sigma * w, sigma * slope)
}

/// One pseudo-step as the paper's equations say it, over all pairs.
fn by_all_pairs(metadata: &Metadata, kind: &[i32], last: &[f64], now: &[f64], own: Relaxation) -> Vec<f64> {
    let n = kind.len();
    let now: Vec<f64> = (0..2 * n).map(|at| if kind[at / 2] == 0 { now[at] } else { last[at] }).collect();
    let nearest = |k: usize, x: f64| match metadata.periodic_boundary_conditions[k] {
        true => x - metadata.bounds[k][1] * (x / metadata.bounds[k][1]).round(),
        false => x,
    };
    let apart = |i: usize, j: usize| [0, 1].map(|k| nearest(k, now[2 * i + k] - now[2 * j + k]) / DX);
    let distance = |r: [f64; 2]| (r[0] * r[0] + r[1] * r[1]).sqrt();
    let mut pressure: Vec<f64> = (0..n)
        .map(|i| {
            let rho: f64 = (0..n).map(|j| quintic(distance(apart(i, j))).0).sum();
            100.0 * (if rho < 0.98 { 1.0 } else { rho.min(1.02) } - 1.0)
        })
        .collect();
    let mut moved: Vec<[f64; 2]> =
        (0..n).map(|i| [0, 1].map(|k| nearest(k, now[2 * i + k] - last[2 * i + k]) / DX)).collect();
    let (before, shifts) = (pressure.clone(), moved.clone());
    for i in (0..n).filter(|&i| kind[i] != 0) {
        let fluid: Vec<(usize, f64)> =
            (0..n).filter(|&j| kind[j] == 0).map(|j| (j, quintic(distance(apart(i, j))).0)).collect();
        let sum: f64 = fluid.iter().map(|(_, w)| w).sum();
        let mean = |of: &dyn Fn(usize) -> f64| match sum > 0.0 {
            true => fluid.iter().map(|&(j, w)| w * of(j)).sum::<f64>() / sum,
            false => 0.0,
        };
        pressure[i] = mean(&|j| before[j]);
        moved[i] = [0, 1].map(|k| 2.0 * shifts[i][k] - mean(&|j| shifts[j][k]));
    }
    let rho: Vec<f64> = pressure.iter().map(|p| p / 100.0 + 1.0).collect();
    let mut found = now.clone();
    for i in (0..n).filter(|&i| kind[i] == 0) {
        for j in (0..n).filter(|&j| j != i) {
            let (r, d) = (apart(i, j), distance(apart(i, j)));
            let slope = quintic(d).1;
            let shared = (rho[j] * pressure[i] + rho[i] * pressure[j]) / (rho[i] + rho[j]);
            let volumes = rho[i].powi(-2) + rho[j].powi(-2);
            for k in 0..2 {
                let pushed = -shared * slope * r[k] / d;
                let sheared = own.viscosity * (moved[i][k] - moved[j][k]) / d * slope;
                found[2 * i + k] += own.strength * DX * volumes * (pushed + sheared);
            }
        }
    }
    for (at, x) in found.iter_mut().enumerate().filter(|(at, _)| metadata.periodic_boundary_conditions[at % 2]) {
        *x = x.rem_euclid(metadata.bounds[at % 2][1]);
    }
    found
}

#[test]
fn a_pseudo_step_is_the_sum_over_all_pairs() {
    let metadata = box_of(1.2, true);
    let (now, last) = lattice(12, 0.0, 0.6);
    // Three rows of walls below and above.
    let kind: Vec<i32> = (0..144).map(|i| i32::from(!(36..108).contains(&i))).collect();
    let scenery = Scenery { metadata: &metadata, kind: &kind, wall_temperature: None };
    let own = Relaxation { steps: 1, strength: 0.03, viscosity: 0.2 };
    let found = numbers(&own.apply(&scenery, &tensor(&last), &tensor(&now)).unwrap());
    let expected = by_all_pairs(&metadata, &kind, &last, &now, own);
    let worst = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-13, "{worst:e}");
    // It is not nothing: particles of a jittered lattice move by some per cent of a spacing.
    let moved = found.iter().zip(&now).skip(72).take(144).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!((1e-3 * DX..0.3 * DX).contains(&moved), "{moved:e}");
}

/// Without walls the shifts sum to zero, and a disordered lattice becomes more even.
#[test]
fn relaxation_spreads_particles_and_keeps_their_centre() {
    let metadata = box_of(1.2, false);
    let (now, last) = lattice(12, 0.0, 0.6);
    let kind = vec![0; 144];
    let scenery = Scenery { metadata: &metadata, kind: &kind, wall_temperature: None };
    let relaxed = |steps: usize| {
        let own = Relaxation { steps, ..Relaxation::default() };
        numbers(&own.apply(&scenery, &tensor(&last), &tensor(&now)).unwrap())
    };
    let one = relaxed(1);
    for k in 0..2 {
        let shift = |at: usize| {
            let x = one[at] - now[at];
            x - 1.2 * (x / 1.2).round()
        };
        let sum: f64 = (0..144).map(|i| shift(2 * i + k)).sum();
        assert!(sum.abs() < 1e-13, "{sum:e}");
    }
    let unevenness = |position: &[f64]| {
        let nearest = |x: f64| (x - 1.2 * (x / 1.2).round()) / DX;
        let apart = |i: usize, j: usize| {
            let [x, y] = [0, 1].map(|k| nearest(position[2 * i + k] - position[2 * j + k]));
            (x * x + y * y).sqrt()
        };
        let rho = |i: usize| (0..144).map(|j| quintic(apart(i, j)).0).sum::<f64>() - 1.0;
        ((0..144).map(|i| rho(i).powi(2)).sum::<f64>() / 144.0).sqrt()
    };
    let (before, after) = (unevenness(&now), unevenness(&relaxed(5)));
    assert!(after < 0.7 * before, "{before} {after}");
}

/// The derivative along a direction, by predicted positions, is that of differences.
#[test]
fn the_gradient_is_that_of_differences() {
    let metadata = box_of(1.2, true);
    let (now, last) = lattice(12, 0.0, 0.3);
    let kind: Vec<i32> = (0..144).map(|i| i32::from(!(36..108).contains(&i))).collect();
    let scenery = Scenery { metadata: &metadata, kind: &kind, wall_temperature: None };
    let own = Relaxation { steps: 2, strength: 0.03, viscosity: 0.1 };
    let weights: Vec<f64> = (0..288).map(|k| ((k * k + 3) as f64).sin()).collect();
    let value = |position: &Tensor| {
        let found = own.apply(&scenery, &tensor(&last), position).unwrap();
        found.mul(&tensor(&weights)).unwrap().sum_all().unwrap()
    };
    let variable = Var::from_tensor(&tensor(&now)).unwrap();
    let gradient = value(&variable).backward().unwrap().remove(&variable).unwrap();
    let direction: Vec<f64> = (0..288).map(|k| ((k + 7) as f64 * 1.7).cos()).collect();
    let along: f64 = numbers(&gradient).iter().zip(&direction).map(|(g, d)| g * d).sum();
    let at = |step: f64| {
        let moved: Vec<f64> = now.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
        value(&tensor(&moved)).to_scalar::<f64>().unwrap()
    };
    let difference = (at(1e-8) - at(-1e-8)) / 2e-8;
    assert!((along / difference - 1.0).abs() < 1e-6, "{along:e}, by differences {difference:e}");
}

/// The force of LagrangeBench's flows: opposed in the halves of reverse Poiseuille flow, down in a dam break.
#[test]
fn a_flow_has_the_force_of_lagrangebench() {
    let of = |case: &str, magnitude: f64| {
        let mut metadata = box_of(2.0, false);
        metadata.other.insert("case".into(), case.into());
        metadata.other.insert("g_ext_magnitude".into(), magnitude.into());
        metadata.external_force()
    };
    for case in ["RPF", "reverse-poiseuille"] {
        let force = of(case, 1.5).unwrap();
        assert_eq!(force, ExternalForce::Opposed { magnitude: 1.5, middle: 1.0 });
        assert_eq!((force.at(0.4), force.at(1.4)), ([1.5, 0.0, 0.0], [-1.5, 0.0, 0.0]));
    }
    assert_eq!(of("DAM", 1.0).unwrap().at(0.3), [0.0, -1.0, 0.0]);
    assert_eq!((of("taylor-green", 1.0), of("RPF", 0.0)), (None, None));
}

fn refuses(folder: &Path, arguments: &[&str], expected: &[&str]) {
    let output = Command::cargo_bin("hydrograd").unwrap().current_dir(folder).args(arguments).output().unwrap();
    refused(arguments, &output, expected);
    assert!(!folder.join("unwritten").exists(), "something was written");
}

#[test]
fn the_command_line_relaxes_and_sees_the_force() {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path();
    let mut generate =
        vec!["generate", "reverse-poiseuille", "--trajectories", "2/1/1", "--frames", "12", "--skip", "20"];
    generate.extend(["--relax", "40", "--every", "20", "--set", "resolution.dx=0.1", "--out", "data"]);
    succeeds(inside, &generate);
    let small =
        ["model.latent=8", "model.rounds=2", "validation_steps=4", "validation_windows=1", "features.force=true"];
    let mut train = vec!["train", "--data", "data", "--steps", "4", "--out", "train"];
    small.iter().for_each(|set| train.extend(["--set", set]));
    succeeds(inside, &train);
    let model = ["--model", "train/last.safetensors", "--data", "data", "--threads", "1"];
    let evaluate = [&["evaluate", "--steps", "5", "--relax", "2", "--out", "relaxed"][..], &model].concat();
    let said = succeeds(inside, &evaluate);
    assert!(said.contains("last, relaxed"), "{said}");
    let file: serde_json::Value =
        serde_json::from_slice(&std::fs::read(inside.join("relaxed/evaluation.json")).unwrap()).unwrap();
    let scores = file["scores"].as_array().unwrap();
    let names: Vec<&str> = scores.iter().map(|score| score["model"].as_str().unwrap()).collect();
    assert_eq!(names, ["last, relaxed", "linear", "no change", "last"]);
    assert_ne!(scores[0]["mse"], scores[3]["mse"]);
    succeeds(inside, &[&["rollout", "--steps", "3", "--relax", "1", "--out", "rollout"][..], &model].concat());
    // The same weights by LagrangeBench's names alone; which features they are of is in the file or cannot be told.
    let mut weights = TensorFile::read(&inside.join("train/last.safetensors")).unwrap();
    weights.tensors.retain(|name, _| name.starts_with("param."));
    weights.metadata = BTreeMap::from([("noise_std".into(), "3e-4".into())]);
    let mut write = |name: &str, features: Option<&str>| {
        weights.metadata.remove("features");
        weights.metadata.extend(features.map(|features| ("features".to_string(), features.to_string())));
        write_tensors(&inside.join(name), &weights.tensors, &weights.metadata).unwrap();
    };
    write("named.safetensors", Some(r#"{"force": true}"#));
    write("unnamed.safetensors", None);
    write("wrong.safetensors", Some(r#"{"froce": true}"#));
    let of =
        |name| ["evaluate", "--steps", "5", "--model", name, "--data", "data", "--threads", "1", "--out", "unwritten"];
    refuses(inside, &of("unnamed.safetensors"), &["node features do not belong to these data"]);
    refuses(inside, &of("wrong.safetensors"), &["its `features`", "froce"]);
    let mut named = of("named.safetensors");
    named[10] = "named";
    succeeds(inside, &named);
    let file: serde_json::Value =
        serde_json::from_slice(&std::fs::read(inside.join("named/evaluation.json")).unwrap()).unwrap();
    assert_eq!(file["scores"][0]["mse"], scores[3]["mse"]);
    let refused = [&["evaluate", "--relax-strength", "0.1", "--out", "unwritten"][..], &model].concat();
    let output = Command::cargo_bin("hydrograd").unwrap().current_dir(inside).args(refused).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let mut heated = vec!["generate", "heated-channel", "--trajectories", "1/1/1", "--frames", "12", "--skip", "20"];
    heated.extend(["--set", "resolution.dx=0.025", "--out", "heated"]);
    succeeds(inside, &heated);
    refuses(
        inside,
        &["evaluate", "--model", "linear", "--data", "heated", "--relax", "1", "--steps", "3", "--out", "unwritten"],
        &["--relax with data of the heated channel", "equal volume"],
    );
    let unforced = ["train", "--data", "heated", "--set", "features.force=true", "--out", "unwritten"];
    refuses(inside, &unforced, &["features.force = true", "no external force"]);
}
