//! What programs are told: JSON, exit codes, completions, man pages, logs; and scenes made by `hydrograd new`.

use crate::support::program::{hydrograd, refused, succeeds};
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// The one document on stdout.
#[track_caller]
fn document(at: &Path, arguments: &[&str], exit_code: i32) -> Value {
    let output = hydrograd(at, arguments);
    assert_eq!(output.status.code(), Some(exit_code), "{}", String::from_utf8_lossy(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["exit_code"], exit_code);
    assert_eq!(document["version"], env!("CARGO_PKG_VERSION"));
    document
}

fn file(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn json_is_what_the_files_say() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let short = ["--set", "time.end=0.4", "--set", "objective.window=0.1", "--set", "resolution.dx=0.025"];
    let run = |more: &[&'static str]| [more, &short[..]].concat();
    let found = document(at, &run(&["simulate", "--json", "--out", "run"]), 0);
    assert_eq!(found["result"], file(&at.join("run/summary.json")));
    assert!(found["result"]["q"].is_f64() && found["error"].is_null());
    // What people read is on stderr.
    let output = hydrograd(at, &run(&["--json", "simulate", "--out", "again"]));
    assert!(String::from_utf8(output.stderr).unwrap().contains("outflowing heat"));
    let found = document(at, &run(&["optimize", "--json", "--no-verify", "--epochs", "2", "--out", "opt"]), 0);
    assert_eq!(found["result"], file(&at.join("opt/summary.json")));
    let scenes = document(at, &["scenes", "--json"], 0);
    assert_eq!(scenes["result"]["scenes"][0]["name"], "heated-channel");
    let scene = document(at, &["scenes", "heated-channel", "--json"], 0);
    assert_eq!(scene["result"]["resolution"]["dx"], 0.02);
    let maps = document(at, &["stress", "--list", "--json"], 0);
    assert!(maps["result"].as_array().unwrap().iter().any(|map| map["map"] == "dam-break-step" && map["runs"] == 80));
}

/// What a document lists as files is there.
#[track_caller]
fn are_there(at: &Path, files: &Value, names: &[&str]) {
    let files: Vec<&str> = files.as_array().unwrap().iter().map(|file| file.as_str().unwrap()).collect();
    assert!(files.iter().all(|file| at.join(file).is_file()), "{files:?}");
    for name in names {
        assert!(files.iter().any(|file| file.ends_with(name)), "no {name} in {files:?}");
    }
}

/// A column of a CSV file, without its header.
fn column(path: &Path, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let k = rows[0].iter().position(|other| *other == name).unwrap();
    rows[1..].iter().map(|row| row[k].parse().unwrap_or(f64::NAN)).collect()
}

#[test]
fn json_of_data_and_models() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let small = ["--trajectories", "2/1/1", "--frames", "12", "--every", "30", "--skip", "20"];
    let small = [&small[..], &["--set", "resolution.dx=0.025", "--threads", "1", "--json"]].concat();
    let generate = |more: &[&'static str]| [&["generate", "heated-channel"], &small[..], more].concat();
    let made = &document(at, &generate(&["--out", "data"]), 0)["result"];
    let metadata = file(&at.join("data/metadata.json"));
    assert_eq!((&made["metadata"], &made["particles"]), (&metadata, &metadata["num_particles_max"]));
    assert_eq!(
        (&made["made"], &made["kept"], &made["missing"], &made["complete"]),
        (&4.into(), &0.into(), &0.into(), &true.into())
    );
    assert_eq!((&made["trajectories"]["train"], &made["frames"]), (&2.into(), &12.into()));
    are_there(at, &made["files"], &["train.h5", "valid.h5", "test.h5", "metadata.json"]);
    let again = &document(at, &generate(&["--out", "data"]), 0)["result"];
    assert_eq!((&again["made"], &again["kept"], &again["metadata"]), (&0.into(), &4.into(), &metadata));
    // Two shares, of which the first knows that something is missing; a merge of what is there already says so.
    let first = &document(at, &generate(&["--out", "shares", "--shard", "0/2"]), 0)["result"];
    assert_eq!((&first["made"], &first["missing"], &first["complete"]), (&2.into(), &2.into(), &false.into()));
    assert!(first["metadata"].is_null());
    document(at, &generate(&["--out", "shares", "--shard", "1/2"]), 0);
    let merged = &document(at, &["merge", "shares", "--json"], 0)["result"];
    assert_eq!((&merged["merged_before"], &merged["metadata"]), (&true.into(), &metadata));

    let sizes = ["--set", "model.latent=8", "--set", "model.rounds=1", "--set", "validation_steps=4"];
    let train = [
        "train",
        "--data",
        "data",
        "--steps",
        "4",
        "--set",
        "validate_every=2",
        "--out",
        "trained",
        "--threads",
        "1",
        "--json",
    ];
    let trained = &document(at, &[&train[..], &sizes].concat(), 0)["result"];
    let csv = at.join("trained/validation.csv");
    let (steps, errors) = (column(&csv, "step"), column(&csv, "mse_1"));
    let best = steps.iter().position(|step| Some(*step) == trained["best_step"].as_f64()).unwrap();
    assert_eq!(trained["validation_at_best"]["mse_1"].as_f64().unwrap(), errors[best]);
    assert_eq!(trained["validation"]["mse_1"].as_f64().unwrap(), *errors.last().unwrap());
    assert_eq!(
        (&trained["steps"], trained["loss"].as_f64()),
        (&4.into(), column(&at.join("trained/history.csv"), "loss").last().copied())
    );
    assert!(trained["best_validation_loss"].as_f64().unwrap() > 0.0);
    assert_eq!(
        (&trained["best"], &trained["last"]),
        (&"trained/best.safetensors".into(), &"trained/last.safetensors".into())
    );
    are_there(at, &trained["files"], &["history.csv", "curves.png", "report.html"]);
    let settings = document(at, &["train", "--print-config", "--set", "noise=1e-3", "--json"], 0);
    assert_eq!(settings["result"]["noise"], 1e-3);

    let rollout = [
        "rollout",
        "--model",
        "trained/best.safetensors",
        "--data",
        "data",
        "--steps",
        "3",
        "--out",
        "rolled",
        "--json",
    ];
    let rolled = &document(at, &rollout, 0)["result"];
    let errors = rolled["errors"].as_array().unwrap();
    assert_eq!((errors.len(), &errors[2]["step"], &rolled["first_frame"]), (3, &3.into(), &6.into()));
    assert!(errors
        .iter()
        .all(|error| error["position_mse"].as_f64().unwrap() >= 0.0 && error["temperature_mse"].is_f64()));
    are_there(at, &rolled["files"], &["rollout.png", "predicted.pvd", "true.pvd"]);

    let study = [
        "study",
        "--data",
        "data",
        "--grid",
        "seed=1,2",
        "--steps",
        "2",
        "--threads",
        "1",
        "--out",
        "studied",
        "--json",
    ];
    let studied = &document(at, &[&study[..], &sizes].concat(), 0)["result"];
    let points = studied["points"].as_array().unwrap();
    assert_eq!(
        (points.len(), &studied["trained"], &studied["kept"], &points[1]["point"]["seed"]),
        (2, &2.into(), &0.into(), &"2".into())
    );
    let of_file = column(&at.join("studied/study.csv"), "mse_1");
    assert_eq!(points.iter().map(|point| point["mse_1"].as_f64().unwrap()).collect::<Vec<_>>(), of_file);
    are_there(at, &studied["files"], &["study.csv", "report.html"]);
    let share = &document(at, &[&study[..], &sizes, &["--shard", "0/2"]].concat(), 0)["result"];
    assert_eq!((share["points"].as_array().unwrap().len(), &share["kept"]), (1, &1.into()));
}

#[test]
fn every_command_has_something_to_tell() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let told = |arguments: &[&str]| {
        let result = document(at, arguments, 0)["result"].clone();
        assert!(!result.is_null(), "{arguments:?}");
        result
    };
    let tiny = [
        "--set",
        "time.end=0.1",
        "--set",
        "objective.window=0.05",
        "--set",
        "output.frames=0",
        "--threads",
        "1",
        "--json",
    ];
    let with = |words: &[&'static str]| [words, &tiny].concat();
    let plan = told(&with(&["optimize", "--explain"]));
    assert!(
        plan["plan"].as_array().unwrap().iter().any(|line| line.as_str().unwrap().starts_with("gradient of")),
        "{plan}"
    );
    told(&with(&["simulate", "--explain"]));
    told(&with(&["optimize", "--epochs", "1", "--no-verify", "--out", "a"]));
    told(&with(&["optimize", "--epochs", "2", "--no-verify", "--out", "b"]));
    let share = told(&with(&["optimize", "--start", "all", "--epochs", "1", "--out", "starts", "--shard", "1/4"]));
    assert_eq!(share["random"], file(&at.join("starts/random/summary.json")));
    let compared = told(&["compare", "a", "b", "--out", "both.html", "--json"]);
    assert_eq!(compared["runs"][1]["figures"], file(&at.join("b/summary.json")));
    let checked = told(&["scenes", "check", "heated-channel", "--out", "check", "--json"]);
    let kinds = checked["particles"]["kinds"].as_object().unwrap().values();
    assert_eq!(checked["particles"]["all"].as_u64().unwrap(), kinds.map(|count| count.as_u64().unwrap()).sum::<u64>());
    are_there(at, &checked["files"], &["particles.png"]);
    let cases = told(&["validate", "--list", "--json"]);
    assert!(cases.as_array().unwrap().iter().any(|case| case["scene"] == "couette"), "{cases}");
    let new = told(&["new", "my.toml", "heated-channel", "--json"]);
    assert_eq!((&new["file"], &new["scene"]), (&"my.toml".into(), &"heated-channel".into()));
    let printed = told(&["--json", "slurm", "--print", "validate", "--quick"]);
    assert!(printed["files"][0]["text"].as_str().unwrap().starts_with("#!/bin/"), "{printed}");
    assert_eq!(told(&["completions", "bash", "--json"])["shell"], "bash");
    assert_eq!(told(&["man", "pages", "--json"])["first"], "pages/hydrograd.1");
    let bench =
        ["bench", "step", "--quick", "--filter", "950/f32/1/forward", "--threads", "1", "--out", "bench", "--json"];
    let measured = told(&bench);
    assert_eq!(measured["rows"], file(&at.join("bench/bench.json")));
    assert!(!measured["rows"].as_array().unwrap().is_empty() && measured["accuracy"].is_null());
}

#[test]
fn json_has_errors_too() {
    let folder = TempDir::new().unwrap();
    let found = document(folder.path(), &["simulate", "--json", "--set", "resolution.dx=-1"], 2);
    let error = found["error"].as_str().unwrap();
    assert!(error.contains("resolution.dx") && error.contains("allowed:"), "{error}");
    assert!(found["result"].is_null());
    let wild =
        ["simulate", "taylor-green", "--json", "--set", "time.cfl=4", "--set", "time.jitter=0.3", "--out", "wild"];
    let found = document(folder.path(), &wild, 3);
    assert!(found["error"].as_str().unwrap().contains("likely cause"), "{found}");
}

#[test]
fn a_new_scene_runs_and_keeps_its_comments() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text = succeeds(at, &["new", "my.toml", "heated-channel", "--set", "channel.height=0.26"]);
    assert!(
        text.contains("next: hydrograd scenes check my.toml") && text.contains("hydrograd optimize my.toml"),
        "{text}"
    );
    let scene = std::fs::read_to_string(at.join("my.toml")).unwrap();
    assert!(scene.contains("height = 0.26") && scene.contains("# Dynamic viscosity."), "{scene}");
    succeeds(at, &["simulate", "my.toml", "--explain"]);
    // Nobody is asked where there is no terminal: the first scene as it is.
    succeeds(at, &["new", "first.toml"]);
    assert!(std::fs::read_to_string(at.join("first.toml")).unwrap().contains("scene = \"heated-channel\""));
    for (arguments, expected) in [
        (vec!["new", "my.toml"], vec!["my.toml is there already", "--overwrite"]),
        (vec!["new", "."], vec![". is a folder"]),
        (vec!["new", "x.toml", "heated"], vec!["heated", "heated-channel"]),
        (vec!["new", "x.toml", "custom", "--set", "region.size=3"], vec!["region.size", "--set region.size=3"]),
    ] {
        refused(&arguments, &hydrograd(at, &arguments), &expected);
    }
    assert!(!at.join("x.toml").exists());
    succeeds(at, &["new", "my.toml", "custom", "--overwrite"]);
}

#[test]
fn shells_and_man_know_every_command() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let text = succeeds(at, &["completions", shell]);
        assert!(text.contains("optimize") && text.contains("preset"), "{shell}");
    }
    succeeds(at, &["man", "pages"]);
    let page = std::fs::read_to_string(at.join("pages/hydrograd-optimize.1")).unwrap();
    assert!(page.contains("hydrograd\\-optimize") && page.contains("EXAMPLES"), "{page}");
    let main = std::fs::read_to_string(at.join("pages/hydrograd.1")).unwrap();
    for command in ["simulate", "verify", "train", "new", "man"] {
        assert!(main.contains(command) && at.join(format!("pages/hydrograd-{command}.1")).is_file(), "{command}");
    }
    assert!(at.join("pages/hydrograd-dataset-inspect.1").is_file());
}

#[test]
fn a_log_says_what_is_done() {
    let folder = TempDir::new().unwrap();
    let mut command = assert_cmd::Command::cargo_bin("hydrograd").unwrap();
    let short = ["simulate", "--set", "time.steps=5", "--set", "objective.window=0", "--out", "run"];
    let output = command.current_dir(folder.path()).env("RUST_LOG", "hydrograd=debug").args(short).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("built heated-channel: 950 particles") && error.contains("run/summary.json"), "{error}");
}
