//! Training from the command line: what it leaves behind, resuming, threads, bad input.

use crate::support::data_set::without_checksum;
use assert_cmd::Command;
use candle_core::{DType, Device, Tensor};
use hydrograd::config::scene::Kernels;
use hydrograd::io::tensor_file::{Data, TensorFile};
use hydrograd::surrogate::features::Inputs;
use hydrograd::surrogate::models::composed_gns::composed_gns;
use hydrograd::surrogate::network::graph::Graph;
use hydrograd::surrogate::network::parameters::detached;
use hydrograd::surrogate::training::checkpoint;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A data set of the heated channel, two short trajectories a split, made once for all tests.
fn data() -> &'static Path {
    static FOLDER: std::sync::OnceLock<tempfile::TempDir> = std::sync::OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            hydrograd()
                .args(["generate", "heated-channel", "--trajectories", "2/1/1", "--frames", "12", "--skip", "20"])
                .args(["--set", "resolution.dx=0.025", "--out"])
                .arg(folder.path().join("data"))
                .assert()
                .success();
            folder
        })
        .path()
}

fn hydrograd() -> Command {
    Command::cargo_bin("hydrograd").unwrap()
}

fn train(out: &Path, more: &[&str]) -> Command {
    let mut command = hydrograd();
    command.args(["train", "--data"]).arg(data().join("data")).arg("--out").arg(out);
    for set in [
        "model.latent=8",
        "model.rounds=2",
        "validation_steps=4",
        "validation_windows=1",
        "validate_every=4",
        "store_every=3",
        "log_every=2",
        "ema=0.9",
        "batch_size=2",
        "pushforward.after=[-1, 2]",
        "pushforward.unrolls=[0, 1]",
        "pushforward.odds=[1.0, 1.0]",
    ] {
        command.args(["--set", set]);
    }
    command.args(more);
    command
}

fn tensors(folder: &Path, name: &str) -> hydrograd::io::tensor_file::Tensors {
    TensorFile::read(&folder.join(name)).unwrap().tensors
}

#[test]
fn leaves_checkpoints_tables_and_curves() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    train(&out, &["--steps", "9"]).assert().success();
    for file in [
        "last.safetensors",
        "best.safetensors",
        "history.csv",
        "validation.csv",
        "config.toml",
        "curves.png",
        "curves.svg",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let history = std::fs::read_to_string(out.join("history.csv")).unwrap();
    let steps: Vec<&str> = history.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(steps, ["2", "4", "6", "8", "9"]);
    let validation = std::fs::read_to_string(out.join("validation.csv")).unwrap();
    assert_eq!(validation.lines().count(), 4);
    assert!(validation.lines().last().unwrap().starts_with("9,"));
    let events = std::fs::read_dir(&out)
        .unwrap()
        .filter(|e| e.as_ref().unwrap().file_name().to_string_lossy().starts_with("events.out.tfevents."));
    assert_eq!(events.count(), 1);
    let file = TensorFile::read(&out.join("last.safetensors")).unwrap();
    assert_eq!(file.text("step").unwrap(), "9");
    for name in
        ["param.proc.1.edge.0.weight", "adam.first.dec.1.bias", "adam.second.embed.weight", "ema.enc.node.ln.scale"]
    {
        assert!(file.tensors.contains_key(name), "{name}");
    }
    assert_eq!(file.shape("param.proc.1.edge.0.weight").unwrap(), [24, 8]);
    // Acceleration and temperature change.
    assert_eq!(file.shape("param.dec.1.bias").unwrap(), [3]);
    // Another training there would overwrite it, and so would other commands.
    fails(&mut train(&out, &["--steps", "9"]), 2, "a finished run of `hydrograd train` already");
    fails(&mut train(&out, &["--steps", "9", "--resume", "--set", "noise=1e-3"]), 2, "noise was 0.0003 and is 0.001");
    fails(&mut train(&out, &["--steps", "5", "--resume"]), 2, "the training is at step 9");
    fails(hydrograd().args(["generate", "--out"]).arg(&out), 2, "belongs to another command");
    // The best checkpoint is a model that `evaluate` takes, and says where it does not belong.
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    std::fs::copy(data().join("data/valid.h5"), other.join("valid.h5")).unwrap();
    let text = std::fs::read_to_string(data().join("data/metadata.json")).unwrap();
    std::fs::write(other.join("metadata.json"), text.replacen("\"dx\": 0.025", "\"dx\": 0.024", 1)).unwrap();
    for (set, warning) in [(&other, true), (&data().join("data"), false)] {
        let mut command = hydrograd();
        command.args(["evaluate", "--steps", "4", "--threads", "1", "--model"]).arg(out.join("best.safetensors"));
        let to = folder.path().join(format!("scores-{warning}"));
        let output = command.arg("--data").arg(set).arg("--out").arg(to).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.success() && error.contains("spacing of 0.0250, these have 0.0240") == warning,
            "{error}"
        );
    }
}

/// Ends with this exit code and says this.
fn fails(command: &mut Command, code: i32, text: &str) {
    let assert = command.assert().code(code);
    let error = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(error.contains(text), "{error}");
}

/// Nine steps at once, and five, then four more: the same numbers in every tensor, bit for bit, and the same tables but for
/// the time. With one thread the same again.
#[test]
fn resumes_bit_for_bit_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts, single]: [PathBuf; 3] = ["whole", "parts", "single"].map(|name| folder.path().join(name));
    train(&whole, &["--steps", "9", "--threads", "2"]).assert().success();
    train(&parts, &["--steps", "5", "--threads", "2"]).assert().success();
    train(&parts, &["--steps", "9", "--threads", "1", "--resume"]).assert().success();
    train(&single, &["--steps", "9", "--threads", "1"]).assert().success();
    for other in [&parts, &single] {
        assert_eq!(tensors(&whole, "last.safetensors"), tensors(other, "last.safetensors"));
    }
    let losses = |folder: &Path| -> Vec<String> {
        let text = std::fs::read_to_string(folder.join("history.csv")).unwrap();
        text.lines().map(|line| line.split(',').nth(2).unwrap().to_owned()).collect()
    };
    assert_eq!(losses(&whole), losses(&single));
}

/// Killed without warning, it goes on from its last checkpoint to the same end.
#[test]
fn survives_being_killed() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed]: [PathBuf; 2] = ["whole", "killed"].map(|name| folder.path().join(name));
    train(&whole, &["--steps", "30"]).assert().success();
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let mut command = std::process::Command::new(program);
    command.args(train(&killed, &["--steps", "30"]).get_args());
    let mut child = command.stdout(std::process::Stdio::null()).spawn().unwrap();
    for _ in 0..2000 {
        if killed.join("last.safetensors").exists() || child.try_wait().unwrap().is_some() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    train(&killed, &["--steps", "30", "--resume"]).assert().success();
    assert_eq!(tensors(&whole, "last.safetensors"), tensors(&killed, "last.safetensors"));
    let rows = |folder: &Path| std::fs::read_to_string(folder.join("history.csv")).unwrap().lines().count();
    assert_eq!(rows(&whole), rows(&killed));
}

#[test]
fn two_trainings_do_not_share_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    std::fs::create_dir(&out).unwrap();
    let other = std::fs::File::create(out.join(".hydrograd")).unwrap();
    other.lock().unwrap();
    fails(&mut train(&out, &["--steps", "2"]), 2, "another hydrograd is writing");
    drop(other);
    train(&out, &["--steps", "2"]).assert().success();
    // Begun anew only where that is said.
    train(&out, &["--steps", "3", "--overwrite"]).assert().success();
    assert_eq!(TensorFile::read(&out.join("last.safetensors")).unwrap().text("step").unwrap(), "3");
}

#[test]
fn begins_with_another_trainings_parameters() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    train(&first, &["--steps", "4", "--set", "ema=0"]).assert().success();
    let from = first.join("last.safetensors");
    let from = from.to_str().unwrap();
    // A learning rate so small that nothing moves shows what it began with.
    let still = ["--steps", "1", "--set", "learning_rate=1e-30", "--set", "learning_rate_least=0", "--init", from];
    train(&second, &still).assert().success();
    let (a, b) = (tensors(&first, "last.safetensors"), tensors(&second, "last.safetensors"));
    assert_eq!(a["param.proc.0.node.0.weight"], b["param.proc.0.node.0.weight"]);
    assert_ne!(a["adam.first.proc.0.node.0.weight"], b["adam.first.proc.0.node.0.weight"]);
    let third = folder.path().join("third");
    fails(
        &mut train(&third, &["--steps", "1", "--set", "model.latent=16", "--init", from]),
        2,
        "the same kind and sizes",
    );
    assert!(!third.exists());
    // Told nothing of the sizes, it takes the file's.
    let bare = ["--steps", "1", "--set", "learning_rate=1e-30", "--set", "learning_rate_least=0"];
    let settings = ["--set", "validation_windows=1", "--set", "validation_steps=2", "--init", from];
    hydrograd()
        .args(["train", "--data"])
        .arg(data().join("data"))
        .arg("--out")
        .arg(&third)
        .args(bare)
        .args(settings)
        .assert()
        .success();
    let c = tensors(&third, "last.safetensors");
    assert_eq!(a["param.proc.0.node.0.weight"], c["param.proc.0.node.0.weight"]);
}

#[test]
fn every_kind_of_model_and_of_heat_trains() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, heat, outputs) in [("egnn", "learned", 3), ("gns", "conduction", 2), ("egnn", "none", 2)] {
        let out = folder.path().join(format!("{kind}-{heat}"));
        let (kind, heat) = (format!("model.kind={kind}"), format!("model.heat={heat}"));
        train(&out, &["--steps", "4", "--set", &kind, "--set", &heat]).assert().success();
        let setup = TensorFile::read(&out.join("last.safetensors")).unwrap().text("setup").unwrap().to_owned();
        assert!(setup.contains(&format!("\"outputs\":{outputs}")), "{setup}");
        let validation = std::fs::read_to_string(out.join("validation.csv")).unwrap();
        let warm = validation.lines().last().unwrap().split(',').next_back().unwrap();
        assert!(warm.parse::<f64>().unwrap() > 0.0, "{validation}");
    }
}

/// The same training with the network from candle-nn's layers: the same losses but for rounding, checkpoints that either
/// goes on with, and models that `evaluate` and `rollout` run with either.
#[test]
fn composed_kernels_train_evaluate_and_roll_out() {
    let folder = tempfile::tempdir().unwrap();
    let [fused, composed, mixed]: [PathBuf; 3] = ["fused", "composed", "mixed"].map(|name| folder.path().join(name));
    // AdamW's first steps are as long as the rate wherever a gradient is not 0: rounding decides about the sign of the
    // smallest, and edges of a particle with itself, whose features are 0, make much of it. With a rate that moves nothing
    // only what is computed differs; the moments show the gradients.
    let run = |out: &Path, more: &[&str]| {
        let still = ["--set", "learning_rate=1e-30", "--set", "learning_rate_least=0"];
        train(out, more).args(still).assert().success();
    };
    run(&fused, &["--steps", "8"]);
    run(&composed, &["--steps", "8", "--kernels", "composed"]);
    run(&mixed, &["--steps", "4", "--kernels", "composed"]);
    run(&mixed, &["--steps", "8", "--kernels", "fused", "--resume"]);
    let losses = |folder: &Path| -> Vec<f64> {
        let text = std::fs::read_to_string(folder.join("history.csv")).unwrap();
        text.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse().unwrap()).collect()
    };
    let wanted = losses(&fused);
    assert_eq!(wanted.len(), 4);
    for other in [&composed, &mixed] {
        for (a, b) in losses(other).iter().zip(&wanted) {
            assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
        }
    }
    let moments = |folder: &Path| -> Vec<(String, Vec<f32>)> {
        let named = tensors(folder, "last.safetensors").into_iter().filter(|(name, _)| name.starts_with("adam.first."));
        named
            .map(|(name, (_, data))| match data {
                Data::F32(values) => (name, values),
                _ => panic!("{name} is not F32"),
            })
            .collect()
    };
    for other in [&composed, &mixed] {
        for ((name, a), (_, b)) in moments(other).iter().zip(moments(&fused)) {
            let scale = b.iter().fold(1e-6f32, |most, x| most.max(x.abs()));
            let worst = a.iter().zip(&b).fold(0.0f32, |most, (a, b)| most.max((a - b).abs())) / scale;
            assert!(worst < 1e-3, "{name}: {worst}");
        }
    }
    // Rounding differs, or the option did nothing.
    assert_ne!(tensors(&fused, "last.safetensors"), tensors(&composed, "last.safetensors"));
    let [a, b] = [&fused, &composed].map(|folder| TensorFile::read(&folder.join("last.safetensors")).unwrap().metadata);
    assert_eq!((&a["settings"], &a["setup"]), (&b["settings"], &b["setup"]));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    let score = |kernels: &str| -> f64 {
        let out = folder.path().join(kernels);
        let run = |command: &str, more: &[&str]| {
            let mut all = hydrograd();
            all.args([command, "--steps", "4", "--kernels", kernels, "--model"]).arg(fused.join("last.safetensors"));
            all.arg("--data")
                .arg(data().join("data"))
                .arg("--out")
                .arg(out.join(command))
                .args(more)
                .assert()
                .success();
        };
        run("evaluate", &["--windows", "1"]);
        run("rollout", &[]);
        assert!(out.join("rollout/rollout.png").is_file());
        let text = std::fs::read_to_string(out.join("evaluate/evaluation.json")).unwrap();
        let file: serde_json::Value = serde_json::from_str(&text).unwrap();
        file["scores"][0]["mse"].as_f64().unwrap()
    };
    let (fused, composed) = (score("fused"), score("composed"));
    assert!((composed / fused - 1.0).abs() < 1e-3 && composed != fused, "{composed} {fused}");
    fails(&mut train(&mixed, &["--kernels", "quick"]), 2, "[possible values: fused, composed]");
}

/// Names and shapes of a checkpoint are candle-nn's business: nothing of hydrograd's reads it here.
#[test]
fn a_checkpoint_opens_with_candle_alone() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    train(&out, &["--steps", "2", "--set", "ema=0"]).assert().success();
    let path = out.join("last.safetensors");
    let header = checkpoint::read(&path).unwrap();
    let network = header.setup.network(Kernels::Fused, 0, DType::F32).unwrap();
    header.load_into(&*network, false).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let builder = candle_nn::VarBuilder::from_buffered_safetensors(bytes, DType::F32, &Device::Cpu).unwrap();
    let graph = Arc::new(Graph::new(5, (0..5).flat_map(|i| [(i, i), (i, (i + 1) % 5)])));
    let features = |rows: usize, columns: usize| {
        let values = (0..rows * columns).map(|k| (k as f32 * 0.7).sin()).collect();
        Tensor::from_vec(values, (rows, columns), &Device::Cpu).unwrap()
    };
    let inputs = Inputs {
        nodes: features(5, header.setup.sizes.node_features),
        edges: features(graph.edges(), header.setup.sizes.edge_features),
        kinds: Tensor::new(&[0u32, 1, 0, 1, 0], &Device::Cpu).unwrap(),
        velocity: features(5, 2),
        graph,
    };
    let numbers = |t: Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    let ours = numbers(network.apply(&inputs, &detached(&*network)).unwrap());
    let theirs = numbers(composed_gns(&header.setup.sizes, &builder.pp("param"), &inputs).unwrap());
    assert!(ours.len() == 15 && ours.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 1e-5), "{ours:?} {theirs:?}");
}

#[test]
fn bad_input_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let cases: [(&[&str], &str); 13] = [
        (&["--set", "model.latentt=8"], "model.latentt"),
        (&["--set", "learning_rate=-1"], "learning_rate"),
        (&["--set", "noise"], "KEY=VALUE"),
        (&["--set", "model.linears=1"], "model.linears"),
        (&["--set", "pushforward.odds=[1.0]"], "pushforward"),
        (&["--set", "validation_steps=400"], "validation_steps"),
        (&["--set", "features.frames=9"], "features.frames"),
        (&["--resume"], "last.safetensors"),
        (&["--steps", "0"], "steps = 0"),
        (&["--set", "learning_rate_factor=2"], "learning_rate_factor"),
        (&["--set", "learning_rate_least=1"], "learning_rate_least = 1"),
        (&["--set", "pushforward.after=[-1, -2]"], "pushforward.after = [-1, -2]"),
        (&["--set", "pushforward.odds=[1.0, 0.0]"], "pushforward.odds = [1.0, 0.0]"),
    ];
    for (more, text) in cases {
        fails(&mut train(&out, more), 2, text);
        assert!(!out.exists(), "{more:?} left something");
    }
    fails(hydrograd().args(["train", "--data", "/nowhere", "--out"]).arg(&out), 2, "/nowhere");
    let config = folder.path().join("config.toml");
    std::fs::write(&config, "steps = 5\nnoise = \"a lot\"\n").unwrap();
    fails(&mut train(&out, &["--config", config.to_str().unwrap()]), 2, "noise = \"a lot\"");
    // Each command keeps to folders of its own.
    fails(&mut train(&data().join("data"), &[]), 2, "belongs to another command");
    let copy = folder.path().join("copy");
    std::fs::create_dir(&copy).unwrap();
    for name in ["metadata.json", "train.h5", "valid.h5"] {
        std::fs::copy(data().join("data").join(name), copy.join(name)).unwrap();
    }
    let with_copy = |text: &str| {
        fails(hydrograd().args(["train", "--steps", "1", "--data"]).arg(&copy).arg("--out").arg(&out), 2, text);
        assert!(!out.exists(), "{text}: something was left");
    };
    let change = |from: &str, to: &str| {
        let text = std::fs::read_to_string(data().join("data/metadata.json")).unwrap();
        assert!(text.contains(from));
        std::fs::write(copy.join("metadata.json"), text.replacen(from, to, 1)).unwrap();
    };
    change("\"dx\": 0.025", "\"dx\": -0.025");
    with_copy("dx is -0.025");
    change("\"dx\": 0.025", "\"dx\": 0.025");
    // As in support/data_set.rs: what is read is a copy, whose lock no other test's process can have inherited.
    let edit = |name: &str, change: &dyn Fn(&hdf5::File)| {
        // For the same reason no file is opened for two changes.
        let edited = copy.join(format!("edited-{name}"));
        std::fs::copy(data().join("data").join(name), &edited).unwrap();
        without_checksum(&edited);
        let file = hdf5::File::open_rw(&edited).unwrap();
        change(&file);
        file.close().unwrap();
        std::fs::copy(&edited, copy.join(name)).unwrap();
    };
    edit("valid.h5", &|file| file.unlink("00000").unwrap());
    with_copy("valid.h5 holds no trajectory");
    std::fs::copy(data().join("data/valid.h5"), copy.join("valid.h5")).unwrap();
    edit("train.h5", &|file| {
        let kinds = file.dataset("00001/particle_type").unwrap();
        let mut values: Vec<i32> = kinds.read_raw().unwrap();
        values[3] = 77;
        kinds.write_raw(&values).unwrap();
    });
    with_copy("`00001/particle_type` is 77 for a particle");
    // A rate that blows the weights up: an error with advice, not a file full of not-a-number.
    fails(
        &mut train(&out, &["--steps", "50", "--set", "learning_rate=1e30", "--set", "learning_rate_least=1e30"]),
        1,
        "diverged",
    );
    let last = out.join("last.safetensors");
    if last.exists() {
        let finite = |data: &Data| match data {
            Data::F32(values) => values.iter().all(|v| v.is_finite()),
            _ => true,
        };
        assert!(tensors(&out, "last.safetensors").values().all(|(_, data)| finite(data)));
    }
}
