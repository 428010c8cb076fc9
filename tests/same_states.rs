//! Short runs of every built-in scene by every method that can solve it end in the states of a table that an earlier version wrote
//! (data/reference/states.csv): what a change of structure must not change. Portable lanes on one thread, so that processors do not
//! differ; `scripts/checksums.py` compares two programs to the bit, on this processor and in more ways.
//!
//! `HYDROGRAD_NEW_STATES=FILE` writes the table anew. Where a row is meant to change, say which and why in the commit.

use crate::support::program::printed;
use hydrograd::config::builtin::SCENES;
use hydrograd::io::state_file::read_state;
use std::fmt::Write;

/// How long the runs are; other scenes: 0.05.
const SHORT: [(&str, &str); 6] = [
    ("poiseuille", "0.0001"),
    ("couette", "0.005"),
    ("slab", "0.01"),
    ("taylor-green", "0.02"),
    ("heated-channel", "0.1"),
    ("custom", "0.1"),
];

/// Sums over a field that see a value at another particle, too: of x cos(k), and of |x| for their size.
fn sums(field: &[f64]) -> [f64; 2] {
    let weighted = field.iter().enumerate().map(|(k, x)| x * (k as f64).cos()).sum();
    [weighted, field.iter().map(|x| x.abs()).sum()]
}

#[test]
fn short_runs_end_where_they_did() {
    let reference = include_str!("../data/reference/states.csv");
    let folder = tempfile::tempdir().unwrap();
    let mut table = String::from("scene,method,field,weighted_sum,absolute_sum\n");
    let (mut wrong, mut seen) = (vec![], 0);
    for scene in SCENES {
        for method in scene.methods() {
            let end = SHORT.iter().find(|(name, _)| *name == scene.name).map_or("0.05", |(_, end)| end);
            let sets = [format!("time.end={end}"), format!("method.name={method}")];
            let mut all = vec!["simulate", scene.name, "--out", "run", "--threads", "1", "--set", "output.frames=0"];
            sets.iter().for_each(|set| all.extend(["--set", set]));
            if scene.family().has_design() {
                all.extend(["--set", "objective.window=0"]);
            }
            let mut command = assert_cmd::Command::cargo_bin("hydrograd").unwrap();
            command.current_dir(folder.path()).env("HYDROGRAD_SIMD", "portable").args(&all);
            printed(&all, command.output().unwrap());
            let state = read_state(&folder.path().join("run/state.h5"), &[]).unwrap();
            std::fs::remove_dir_all(folder.path().join("run")).unwrap();
            let fields = [
                ("position", Some(state.position)),
                ("velocity", state.velocity),
                ("temperature", state.temperature),
                ("density", state.density),
            ];
            for (field, values) in fields.into_iter().filter_map(|(name, values)| Some((name, values?))) {
                let [weighted, absolute] = sums(&values);
                let key = format!("{},{method},{field},", scene.name);
                writeln!(table, "{key}{weighted:e},{absolute:e}").unwrap();
                let row = reference.lines().find_map(|line| line.strip_prefix(&key));
                let before: Vec<f64> = row.iter().flat_map(|row| row.split(',')).map(|x| x.parse().unwrap()).collect();
                // Another libm starts with other last digits; in so short a run they grow to no more than this.
                let near = |now: f64, before: f64| (now - before).abs() <= 1e-9 * absolute.max(1e-3);
                seen += 1;
                if before.len() != 2 || !near(weighted, before[0]) || !near(absolute, before[1]) {
                    wrong.push(format!("{key} {weighted:e}, {absolute:e}, in the table {before:?}"));
                }
            }
        }
    }
    if let Ok(file) = std::env::var("HYDROGRAD_NEW_STATES") {
        std::fs::write(file, table).unwrap();
        return;
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 80 && seen + 1 == reference.lines().count(), "{seen} rows");
}
