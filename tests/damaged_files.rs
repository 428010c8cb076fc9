//! Files with bytes changed, cut or blanked: what reads them ends as if nothing were wrong, or with one clear error and exit
//! code 2; it does not crash. `HYDROGRAD_DAMAGE=200` makes so many of each file.

use crate::support::data_set::{heat, heated_metadata, metadata, trajectory, without_checksum, write};
use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::dataset::{Split, Trajectory};
use hydrograd::io::tensor_file::{write_tensors, Data, TensorFile};
use hydrograd::numerics::random::{numbered, uniform};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::path::Path;

fn count() -> u32 {
    std::env::var("HYDROGRAD_DAMAGE").ok().and_then(|count| count.parse().ok()).unwrap_or(8)
}

/// Some bytes changed, a stretch of zeros, or the end cut off.
fn damage(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    let mut below = |count: usize| ((uniform(random) * count as f64) as usize).min(count.saturating_sub(1));
    match below(4) {
        0 => bytes.truncate(below(bytes.len())),
        1 => {
            let from = below(bytes.len());
            let to = (from + 1 + below(64)).min(bytes.len());
            bytes[from..to].fill(0);
        }
        _ => {
            // Most damage is done near the beginning.
            let within = if below(2) == 0 { bytes.len().min(2048) } else { bytes.len() };
            for _ in 0..1 + below(8) {
                bytes[below(within)] = below(256) as u8;
            }
        }
    }
}

/// Runs a command with a file that is damaged in many ways, one by one; the file is whole again then.
fn survives(folder: &Path, file: &str, arguments: &[&str]) {
    let path = folder.join(file);
    let whole = std::fs::read(&path).unwrap();
    for number in 0..count() {
        let mut bytes = whole.clone();
        damage(&mut bytes, &mut numbered(5, "dmg", number));
        std::fs::write(&path, &bytes).unwrap();
        let _ = std::fs::remove_dir_all(folder.join("out"));
        let output = hydrograd(folder, arguments);
        let error = String::from_utf8_lossy(&output.stderr);
        let what = format!("{file}, damage {number}, exit code {:?}: {error}", output.status.code());
        // Numbers of a text that are others now may be those of another run, which may fail.
        assert!(matches!(output.status.code(), Some(0..=3)), "{what}");
        assert!(error.matches("error:").count() <= 1 && error.len() < 6000, "{what}");
        assert!(!error.contains("internal error") && !error.contains("HDF5-DIAG"), "{what}");
    }
    std::fs::write(&path, whole).unwrap();
}

#[test]
fn a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--set", "resolution.dx=0.1", "--set", "time.steps=4", "--set", "output.frames=0"];
    succeeds(folder.path(), &[&["simulate", "taylor-green", "--out", "first"][..], &small].concat());
    std::fs::copy(folder.path().join("first/config.toml"), folder.path().join("mine.toml")).unwrap();
    survives(folder.path(), "mine.toml", &["scenes", "check", "mine.toml", "--out", "out"]);
}

#[test]
fn a_data_set_and_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    let mut warm = trajectory("00000", 30, |_, y| [0.02 * y, 0.0]);
    heat(&mut warm, |frame, x| 1.0 + 0.2 * x + 0.001 * frame as f64);
    for split in Split::ALL {
        write(&data, &heated_metadata(), split, std::slice::from_ref(&warm));
    }
    let sizes = ["--set", "model.latent=8", "--set", "model.rounds=1", "--set", "validation_steps=4"];
    succeeds(folder.path(), &[&["train", "--data", "data", "--steps", "2", "--out", "trained"][..], &sizes].concat());
    let model = "trained/last.safetensors";
    let evaluate = ["evaluate", "--model", model, "--data", "data", "--split", "test", "--steps", "3", "--out", "out"];
    succeeds(folder.path(), &evaluate);
    for file in [model, "data/test.h5", "data/metadata.json"] {
        survives(folder.path(), file, &evaluate);
    }
    // What a header promises is not made before the file is seen to have it.
    let path = folder.path().join(model);
    let whole = std::fs::read(&path).unwrap();
    let changed = |change: &dyn Fn(&mut TensorFile)| {
        let mut file = TensorFile::parse(&path, &whole).unwrap();
        change(&mut file);
        write_tensors(&path, &file.tensors, &file.metadata).unwrap();
    };
    for name in ["latent", "rounds", "linears", "embedding", "node_features"] {
        changed(&|file| {
            let mut setup: serde_json::Value = serde_json::from_str(&file.metadata["setup"]).unwrap();
            setup["sizes"][name] = json!(1_000_000_000);
            file.metadata.insert("setup".into(), setup.to_string());
        });
        refused(
            &evaluate,
            &hydrograd(folder.path(), &evaluate),
            &["last.safetensors", &format!("{name} = 1000000000")],
        );
    }
    // A weight of a hidden layer: behind it a rectifier takes what is no number for 0.
    changed(&|file| {
        let weights = file.tensors.iter_mut().find(|(name, _)| name.starts_with("param."));
        if let Some((_, (_, Data::F32(numbers)))) = weights {
            numbers[1] = f32::NAN;
        }
    });
    refused(&evaluate, &hydrograd(folder.path(), &evaluate), &["last.safetensors", "NaN at place 1", "finite numbers"]);
    // One bit of a weight.
    let mut bytes = whole.clone();
    let last = bytes.len() - 3;
    bytes[last] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    refused(&evaluate, &hydrograd(folder.path(), &evaluate), &["last.safetensors", "checksum"]);
    std::fs::write(&path, &whole).unwrap();

    let text = std::fs::read_to_string(data.join("metadata.json")).unwrap();
    let original: serde_json::Value = serde_json::from_str(&text).unwrap();
    for (key, value, part) in [
        ("bounds", json!([[0.0, 1e30], [0.0, 1.0]]), "bounds[0]"),
        ("bounds", json!([[0.0, 1.0], [1.0, 1.0]]), "bounds[1]"),
        ("dt", json!(0.0), "dt is 0"),
        ("write_every", json!(0), "write_every is 0"),
    ] {
        let mut changed = original.clone();
        changed[key] = value;
        std::fs::write(data.join("metadata.json"), changed.to_string()).unwrap();
        refused(&evaluate, &hydrograd(folder.path(), &evaluate), &["metadata.json", part]);
    }
    std::fs::write(data.join("metadata.json"), text).unwrap();
    type Change = fn(&mut Trajectory);
    let changes: [(Change, &str); 4] = [
        (|t| t.position[7] = f32::NAN, "`00000/position` is NaN in frame 0, particle 3"),
        (|t| t.position[7] = 1e30, "within a box's length"),
        (|t| t.temperature.as_mut().unwrap()[105] = f32::INFINITY, "`00000/temperature` is inf in frame 1, particle 5"),
        (|t| t.temperature = None, "00000/temperature"),
    ];
    for (change, part) in changes {
        let mut other = warm.clone();
        change(&mut other);
        write(&data, &heated_metadata(), Split::Test, &[other]);
        refused(&evaluate, &hydrograd(folder.path(), &evaluate), &["test.h5", part]);
    }
    // A model of other data.
    write(&data, &metadata(false), Split::Test, &[trajectory("00000", 30, |_, _| [0.01, 0.0])]);
    refused(&evaluate, &hydrograd(folder.path(), &evaluate), &["periodic directions"]);
}

#[test]
fn a_data_set_of_ours() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--set", "resolution.dx=0.1", "--trajectories", "1/1/1", "--frames", "4", "--out", "data"];
    succeeds(folder.path(), &[&["generate", "taylor-green"][..], &small].concat());
    let look = ["dataset", "inspect", "data", "--split", "test", "--frames", "2"];
    succeeds(folder.path(), &look);
    survives(folder.path(), "data/test.h5", &look);
    // A byte of what HDF5 keeps about the file, which it would believe.
    let path = folder.path().join("data/test.h5");
    let whole = std::fs::read(&path).unwrap();
    let mut bytes = whole.clone();
    bytes[512 + 40] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    refused(&look, &hydrograd(folder.path(), &look), &["test.h5", "checksum"]);
    std::fs::write(&path, &whole).unwrap();
    without_checksum(&path);
    succeeds(folder.path(), &look);
}

#[test]
fn a_search() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--set", "time.end=0.1", "--set", "output.frames=0", "--set", "resolution.dx=0.025"];
    succeeds(folder.path(), &[&["optimize", "--epochs", "1", "--no-verify", "--out", "run"][..], &small].concat());
    let resume = ["optimize", "--resume", "run", "--epochs", "2", "--no-verify", "--out", "out"];
    for file in ["run/checkpoint.safetensors", "run/config.toml"] {
        survives(folder.path(), file, &resume);
    }
}

/// Nothing that a terminal or a browser would do something else with, and no line that fills the screen.
#[track_caller]
fn can_be_shown(text: &str) {
    let harmful = |c: &char| c.is_control() && *c != '\n';
    assert_eq!(text.chars().find(harmful), None, "{text:?}");
    assert!(text.lines().all(|line| line.len() < 6000), "{text}");
}

#[test]
fn what_files_say_in_warnings_and_pages() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let small = ["--set", "time.end=0.1", "--set", "output.frames=0", "--set", "resolution.dx=0.025"];
    succeeds(at, &[&["optimize", "--epochs", "1", "--no-verify", "--out", "run"][..], &small].concat());
    // Control characters in the name of the folder, which a warning names, and in what its files say.
    let name = "r\u{1b}[2Jn";
    let run = at.join(name);
    std::fs::rename(at.join("run"), &run).unwrap();
    std::fs::write(run.join("verification.json"), "[").unwrap();
    let read = |file: &str| std::fs::read_to_string(run.join(file)).unwrap();
    let mut summary: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
    let long = "long ".repeat(20_000);
    summary["scene"] = json!("heated\u{1b}]0;title\u{7}");
    summary["warnings"] = json!([{ "problem": format!("\u{1b}[31m{long}"), "advice": "\u{9b}2J" }]);
    std::fs::write(run.join("summary.json"), summary.to_string()).unwrap();
    let output = hydrograd(at, &["optimize", "--resume", name, "--epochs", "2", "--no-verify"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && error.contains("warning: the page is without verification.json"), "{error}");
    assert!(error.contains("r\\u{1b}[2Jn/verification.json"), "{error}");
    can_be_shown(&error);
    // Its own summary is written anew; one among several is quoted as it is.
    succeeds(at, &[&["optimize", "--epochs", "1", "--no-verify", "--out", "other"][..], &small].concat());
    std::fs::write(run.join("summary.json"), summary.to_string()).unwrap();
    std::fs::write(run.join("config.toml"), format!("# {}\n{}", "x".repeat(90_000), read("config.toml"))).unwrap();
    let compared = succeeds(at, &["compare", name, "other", "--out", "both.html"]);
    can_be_shown(&compared);
    // Of all that stands in the text, but what the script draws: its data are JSON in one line.
    let html = std::fs::read_to_string(at.join("both.html")).unwrap();
    let (text, _) = html.split_once("<script type=\"application/json\"").unwrap();
    assert_eq!(text.chars().find(|c| c.is_control() && *c != '\n'), None);
    assert!(text.contains("heated\\u{1b}]0;title\\u{7}"), "the page does not quote the scene");
    assert!(!html.contains(&"x".repeat(30_000)) && html.len() < 500_000, "{} bytes", html.len());

    // A data set's own words.
    let data = at.join("data");
    std::fs::create_dir(&data).unwrap();
    let mut words = metadata(false);
    words.other.insert("case".into(), json!("\u{1b}[2Jcase"));
    for split in Split::ALL {
        write(&data, &words, split, &[trajectory("0\u{7}0", 12, |_, _| [0.01, 0.0])]);
    }
    let inspected = succeeds(at, &["dataset", "inspect", "data", "--frames", "1"]);
    assert!(inspected.contains("\\u{1b}[2Jcase"), "{inspected}");
    can_be_shown(&inspected);
    let rollout = ["rollout", "--model", "linear", "--data", "data", "--steps", "2", "--out", "rolled"];
    can_be_shown(&succeeds(at, &rollout));
}
