//! `hydrograd evaluate` and `rollout`: files, figures that fit together, bad input.

use crate::support::data_set::{heat, heated_metadata, metadata, trajectory, write};
use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::dataset::Split;
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// A folder with the data sets `plain` (uniform motion) and `heated`.
fn data_sets() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (plain, heated) = (folder.path().join("plain"), folder.path().join("heated"));
    std::fs::create_dir(&plain).unwrap();
    std::fs::create_dir(&heated).unwrap();
    let still_short = trajectory("00001", 20, |_, _| [0.0; 2]);
    write(&plain, &metadata(false), Split::Valid, &[trajectory("00000", 60, |_, _| [0.02, 0.01]), still_short]);
    let mut t = trajectory("00000", 30, |_, y| [0.02 * y, 0.0]);
    heat(&mut t, |frame, x| 1.0 + 0.2 * x + 0.001 * frame as f64);
    write(&heated, &heated_metadata(), Split::Test, &[t]);
    folder
}

/// Expects exit code 2, one error with these parts, and no `out`.
fn refuses(folder: &Path, arguments: &[&str], parts: &[&str]) {
    let output = hydrograd(folder, &[arguments, &["--out", "out"]].concat());
    refused(arguments, &output, parts);
    assert!(output.stdout.is_empty() && !folder.join("out").exists(), "something was written");
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    // Whose folder it is.
    names.retain(|name| name != ".hydrograd");
    names.sort();
    names
}

#[test]
fn evaluate_compares_with_the_baselines() {
    let folder = data_sets();
    let out = folder.path().join("out");
    let text = succeeds(folder.path(), &["evaluate", "--model", "still", "--data", "plain", "--out", "out"]);
    for part in ["2 windows of 20", "no change", "linear", "MSE_20", "E_kin", "seconds per step"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    assert!(!text.contains("temperature") && !text.contains("broke"), "{text}");
    let pictures = ["kinetic_energy.png", "kinetic_energy.svg", "mse.png", "mse.svg"];
    assert_eq!(names(&out), [&["evaluation.json"], &pictures[..], &["report.html"]].concat());
    let json: Value = serde_json::from_str(&std::fs::read_to_string(out.join("evaluation.json")).unwrap()).unwrap();
    assert_eq!(json["split"], "valid");
    let scores = &json["scores"];
    assert_eq!((&scores[0]["model"], &scores[1]["model"]), (&Value::from("no change"), &Value::from("linear")));
    assert_eq!(scores.as_array().unwrap().len(), 2, "the model itself is not its own baseline");
    let mse = scores[0]["mse_1"].as_f64().unwrap();
    assert!((mse / ((0.02 * 0.02 + 0.01 * 0.01) / 2.0) - 1.0).abs() < 1e-4, "{mse}");
    assert!(scores[1]["mse_20"].as_f64().unwrap() < 1e-10);
    assert!(scores[0]["temperature_mse"].is_null());
    assert_eq!(scores[0]["curves"]["mse"].as_array().unwrap().len(), 20);
}

#[test]
fn evaluate_measures_heat() {
    let folder = data_sets();
    let arguments = ["evaluate", "--model", "linear", "--data", "heated", "--split", "test", "--steps", "12"];
    let text = succeeds(folder.path(), &[&arguments[..], &["--windows", "1", "--out", "out"]].concat());
    for part in ["1 windows of 12", "temperature MSE", "outflow, relative error", "test split of heated"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    assert!(!text.contains("MSE_20"), "{text}");
    let found = names(&folder.path().join("out"));
    assert!(found.contains(&"outflow.svg".to_string()) && found.contains(&"temperature_mse.png".to_string()));
}

#[test]
fn rollout_writes_series_and_a_picture() {
    let folder = data_sets();
    let arguments = ["rollout", "--model", "linear", "--data", "heated", "--split", "test", "--steps", "6"];
    let text = succeeds(folder.path(), &[&arguments[..], &["--start", "3", "--out", "out"]].concat());
    assert!(text.contains("trajectory 00000, frames 9 to 14"), "{text}");
    let out = folder.path().join("out");
    assert_eq!(names(&out), ["predicted", "report.html", "rollout.png", "rollout.svg", "true"]);
    for name in ["predicted", "true"] {
        let series = std::fs::read_to_string(out.join(name).join(format!("{name}.pvd"))).unwrap();
        assert_eq!(series.matches("<DataSet").count(), 6);
        let frame = std::fs::read(out.join(name).join(format!("{name}_000005.vtp"))).unwrap();
        let header = String::from_utf8_lossy(&frame);
        for part in ["NumberOfPoints=\"100\"", "Name=\"velocity\"", "Name=\"temperature\"", "Name=\"tag\""] {
            assert!(header.contains(part), "no {part}");
        }
    }
    let svg = std::fs::read_to_string(out.join("rollout.svg")).unwrap();
    for part in ["step 6: predicted", "step 6: true", "step 2: difference", "temperature T"] {
        assert!(svg.contains(part), "no `{part}`");
    }
    // Without temperature, by speed.
    succeeds(folder.path(), &["rollout", "--model", "still", "--data", "plain", "--steps", "1", "--out", "speed"]);
    let svg = std::fs::read_to_string(folder.path().join("speed/rollout.svg")).unwrap();
    assert!(svg.contains("speed |v|") && svg.contains("step 1: predicted"));
}

#[test]
fn bad_input() {
    let folder = data_sets();
    let path = folder.path();
    std::fs::write(path.join("text.safetensors"), "not a model").unwrap();
    let tensors = hydrograd::io::tensor_file::Tensors::new();
    let about = std::collections::BTreeMap::from([("kind".to_string(), "hydrograd simulation".to_string())]);
    hydrograd::io::tensor_file::write_tensors(&path.join("other.safetensors"), &tensors, &about).unwrap();
    std::fs::create_dir(path.join("empty")).unwrap();
    std::fs::create_dir(path.join("broken")).unwrap();
    std::fs::write(path.join("broken/metadata.json"), "{\"dim\": 2}").unwrap();
    for command in ["evaluate", "rollout"] {
        let with = |model: &str, data: &str, more: &[&str], parts: &[&str]| {
            refuses(path, &[&[command, "--model", model, "--data", data], more].concat(), parts)
        };
        with("nowhere.safetensors", "plain", &[], &["nowhere.safetensors", "cannot read", "`linear`"]);
        with("text.safetensors", "plain", &[], &["text.safetensors", "not a readable safetensors", "allowed:"]);
        with("other.safetensors", "plain", &[], &["other.safetensors", "not a model of hydrograd", "allowed:"]);
        with("linear", "nowhere", &[], &["--data nowhere", "metadata.json", "cannot read", "allowed:"]);
        with("linear", "empty", &[], &["metadata.json", "cannot read"]);
        with("linear", "broken", &[], &["metadata.json", "missing field"]);
        with("linear", "plain", &["--split", "test"], &["test.h5", "cannot read", "allowed:"]);
        with("linear", "plain", &["--split", "best"], &["best", "train", "valid", "test"]);
        with("linear", "plain", &["--steps", "0"], &["--steps", "at least 1"]);
        with("linear", "plain", &["--steps", "70"], &["00000 has 60 frames", "70 predicted", "--steps 54"]);
    }
    refuses(
        path,
        &["evaluate", "--model", "linear", "--data", "plain", "--windows", "0"],
        &["--windows", "at least 1"],
    );
    let rollout = ["rollout", "--model", "linear", "--data", "plain"];
    let refused = |more: &[&str], parts: &[&str]| refuses(path, &[&rollout[..], more].concat(), parts);
    refused(&["--trajectory", "7"], &["--trajectory 7", "no trajectory `7`", "00000 to 00001"]);
    refused(&["--trajectory", "00001"], &["00001 has 20 frames", "start + 6 + steps <= 20", "--steps 14"]);
    refused(&["--start", "40"], &["00000 has 60 frames", "from frame 40", "try: --steps 14, or an earlier start"]);
    refused(&["--start", "57"], &["try: an earlier start"]);
    // A file in place of the folder of results.
    let output = hydrograd(path, &["evaluate", "--model", "linear", "--data", "plain", "--out", "text.safetensors"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("is a file"));
}
