//! Folders of runs: each belongs to one kind of command and one process, and no run is lost unless that was asked for.

use crate::support::program::{hydrograd, refused, succeeds};
use std::collections::BTreeMap;
use std::path::Path;
use tempfile::TempDir;

/// A design and a run as short as can be.
const TINY: [&str; 8] =
    ["--set", "time.end=0.1", "--set", "objective.window=0.05", "--set", "output.frames=2", "--threads", "1"];

fn with<'a>(first: &[&'a str], then: &[&'a str]) -> Vec<&'a str> {
    [first, &TINY, then].concat()
}

fn optimize<'a>(more: &[&'a str]) -> Vec<&'a str> {
    with(&["optimize", "--no-verify"], more)
}

/// The bytes of every file of a folder, by path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => {
                found.insert(path.display().to_string(), std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Expects a refusal that changes nothing.
#[track_caller]
fn refuses(at: &Path, arguments: &[&str], expected: &[&str]) {
    let before = files(at);
    refused(arguments, &hydrograd(at, arguments), expected);
    assert!(files(at) == before, "{arguments:?} changed something");
}

#[test]
fn a_folder_belongs_to_one_command() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &optimize(&["--epochs", "1", "--out", "run"]));
    for command in ["simulate", "check-gradient"] {
        refuses(at, &with(&[command], &["--out", "run"]), &["--out run", "`hydrograd optimize`", "another --out"]);
    }
    for command in ["validate", "generate", "recover"] {
        refuses(at, &[command, "--out", "run"], &["`hydrograd optimize`", "another --out"]);
    }
    // What is there can still be resumed, and looked at.
    succeeds(at, &["optimize", "--no-verify", "--resume", "run", "--epochs", "2"]);
    // A data set's configuration is what it goes on with.
    let short = ["--trajectories", "1/1/1", "--frames", "3", "--skip", "2", "--out", "set", "--shard", "0/3"];
    let set = [&["generate", "--set", "design.bound=0.01"], &short[..]].concat();
    succeeds(at, &set);
    refuses(at, &optimize(&["--epochs", "1", "--out", "set"]), &["`hydrograd generate`"]);
    succeeds(at, &set);
    // Files like ours of which nothing is known.
    std::fs::create_dir(at.join("mine")).unwrap();
    std::fs::write(at.join("mine/config.toml"), "[time]\nend = 0.1\n").unwrap();
    refuses(at, &with(&["simulate"], &["--out", "mine"]), &["holds config.toml", "did not make"]);
}

#[test]
fn a_long_run_is_kept_unless_told_otherwise() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &optimize(&["--epochs", "2", "--out", "run"]));
    let again = optimize(&["--epochs", "1", "--out", "run"]);
    refuses(at, &again, &["a finished run of `hydrograd optimize`", "--resume run", "--overwrite", "another --out"]);
    // What was not its own stays, and what the new run does not write goes.
    std::fs::write(at.join("run/notes.txt"), "mine").unwrap();
    std::fs::write(at.join("run/verification.json"), "{}").unwrap();
    succeeds(at, &[&again[..], &["--overwrite"]].concat());
    assert!(at.join("run/notes.txt").exists() && !at.join("run/verification.json").exists());
    assert_eq!(std::fs::read_to_string(at.join("run/history.csv")).unwrap().lines().count(), 2);
    refuses(at, &["optimize", "--resume", "run", "--overwrite"], &["--overwrite"]);
    // Where no folder is named a finished run stays, and the next one has a folder of its own.
    for name in ["optimize-heated-channel", "optimize-heated-channel-2"] {
        let text = succeeds(at, &optimize(&["--epochs", "1"]));
        assert!(text.contains(&format!("files in runs/{name}:")), "{text}");
    }
}

#[test]
fn a_short_run_makes_room_for_the_next() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["simulate"], &["--set", "output.frames=5"]));
    let run = at.join("runs/simulate-heated-channel");
    let frames = |k: usize| run.join(format!("particles/particles_{k:06}.vtp")).exists();
    assert!(frames(5));
    // A killed run's half of a file, and something of the user's.
    std::fs::write(run.join(".state.partial-a1b2c3.h5"), "half").unwrap();
    std::fs::write(run.join("particles/mine.txt"), "mine").unwrap();
    succeeds(at, &with(&["simulate"], &[]));
    assert!(frames(2) && !frames(3), "frames of the earlier run are left");
    assert!(!run.join(".state.partial-a1b2c3.h5").exists() && run.join("particles/mine.txt").exists());
    succeeds(at, &with(&["simulate"], &["--set", "output.frames=0"]));
    assert!(!frames(0) && run.join("particles/mine.txt").exists());
}

#[test]
fn two_at_once_do_not_mix() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    for command in ["simulate", "optimize", "check-gradient"] {
        let out = at.join(command);
        std::fs::create_dir(&out).unwrap();
        let held = std::fs::File::create(out.join(".hydrograd")).unwrap();
        held.lock().unwrap();
        let arguments = with(&[command], &["--out", command]);
        refuses(at, &arguments, &[command, "another hydrograd is writing", "another --out"]);
    }
}
