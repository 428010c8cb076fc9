//! What programs are told: JSON, exit codes, completions, man pages, logs; and scenes made by `hydrograd new`.

mod support;

use serde_json::Value;
use std::path::Path;
use support::program::{hydrograd, refused, succeeds};
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
    assert!(page.contains("hydrograd\\-optimize") && page.contains("Examples:"), "{page}");
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
