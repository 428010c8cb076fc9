//! Files with bytes changed, cut or blanked: what reads them ends as if nothing were wrong, or with one clear error and exit
//! code 2; it does not crash. `HYDROGRAD_DAMAGE=200` makes so many of each file.

mod support;

use hydrograd::dataset::{Split, Trajectory};
use hydrograd::io::tensor_file::{write_tensors, Data, TensorFile};
use hydrograd::numerics::random::{numbered, uniform};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::path::Path;
use support::data_set::{heat, heated_metadata, metadata, trajectory, without_checksum, write};
use support::program::{hydrograd, refused, succeeds};

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
