//! Training from the command line: what it leaves behind, resuming, threads, bad input.

use assert_cmd::Command;
use hydrograd::io::tensor_file::TensorFile;
use std::path::{Path, PathBuf};

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
    // Another training there would overwrite it.
    fails(&mut train(&out, &["--steps", "9"]), 2, "holds a training already");
    // The best checkpoint is a model that `evaluate` takes.
    hydrograd()
        .args(["evaluate", "--steps", "4", "--model"])
        .arg(out.join("best.safetensors"))
        .arg("--data")
        .arg(data().join("data"))
        .arg("--out")
        .arg(folder.path().join("scores"))
        .assert()
        .success();
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

#[test]
fn bad_input_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let cases: [(&[&str], &str); 8] = [
        (&["--set", "model.latentt=8"], "model.latentt"),
        (&["--set", "learning_rate=-1"], "learning_rate"),
        (&["--set", "noise"], "KEY=VALUE"),
        (&["--set", "model.linears=1"], "model.linears"),
        (&["--set", "pushforward.odds=[1.0]"], "pushforward"),
        (&["--set", "validation_steps=400"], "validation_steps"),
        (&["--set", "features.frames=9"], "features.frames"),
        (&["--resume"], "last.safetensors"),
    ];
    for (more, text) in cases {
        fails(&mut train(&out, more), 2, text);
        assert!(!out.exists(), "{more:?} left something");
    }
    fails(hydrograd().args(["train", "--data", "/nowhere", "--out"]).arg(&out), 2, "/nowhere");
    // A rate that blows the weights up: an error with advice, not a file full of not-a-number.
    fails(
        &mut train(&out, &["--steps", "50", "--set", "learning_rate=1e30", "--set", "learning_rate_least=1e30"]),
        1,
        "diverged",
    );
    let last = out.join("last.safetensors");
    if last.exists() {
        let finite = |data: &hydrograd::io::tensor_file::Data| match data {
            hydrograd::io::tensor_file::Data::F32(values) => values.iter().all(|v| v.is_finite()),
            _ => true,
        };
        assert!(tensors(&out, "last.safetensors").values().all(|(_, data)| finite(data)));
    }
}
