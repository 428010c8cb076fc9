//! The page on `summary.json` says what runs write: every kind of run has the fields of `data/summary.toml`, and no others.

use super::support::program::{hydrograd, succeeds};
use super::support::summary::{check, known};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A box with a hot disc that may change, and what is to become large.
const PIN: &str = r#"
scene = "custom"
region = { size = [0.6, 0.4], acceleration = [1.0, 0.0], inlet_until = 0.1, outlet_from = 0.5 }
resolution = { dx = 0.04 }
initial = { velocity = ["5*y*(0.4 - y)", 0], temperature = 1.0 }
time = { end = 0.2 }
objective = { kind = "heat-outflow", target_x = 0.45, window = 0.1 }
[[shapes]]
kind = "disc"
centre = [0.25, 0.2]
radius = 0.06
temperature = 2.0
[[variables]]
number = "shapes[0].radius"
lower = 0.05
upper = 0.08
"#;

/// A steady flow around the same disc.
const STEADY: &str = r#"
scene = "custom"
method.name = "fixed"
region = { size = [0.6, 0.4], acceleration = [1.0, 0.0] }
resolution = { dx = 0.04 }
initial = { temperature = 1.0 }
objective = { kind = "heat-outflow" }
[[shapes]]
kind = "box"
lower = [-1.0, -0.5]
upper = [2.0, 0.0]
temperature = 1.0
[[shapes]]
kind = "disc"
centre = [0.25, 0.2]
radius = 0.06
temperature = 2.0
[[variables]]
number = "shapes[1].radius"
lower = 0.05
upper = 0.08
"#;

/// Warm vortices in a periodic box.
const PERIODIC: &str = r#"
scene = "custom"
method = { name = "fixed", flow = "unsteady" }
region = { size = [1.0, 1.0], periodic = [true, true], acceleration = [0.0, 0.0] }
resolution = { dx = 0.1 }
initial = { velocity = ["sin(2*PI*y)", 0], temperature = "1 + x*(1 - x)" }
time = { end = 0.2 }
"#;

/// One around a ball.
const BALL: &str = r#"
scene = "custom"
method = { name = "fixed" }
region = { size = [0.8, 0.6, 0.6], periodic = [true, false, false], acceleration = [1.0, 0.0, 0.0] }
fluid = { viscosity = 0.05 }
resolution = { dx = 0.1 }
objective = { kind = "flow-rate" }
shapes = [{ kind = "disc", centre = [0.4, 0.3, 0.3], radius = 0.12 }]
variables = [{ number = "shapes[0].centre[1]", lower = 0.28, upper = 0.32 }]
"#;

/// The kind of a run, and its command without settings that make it short.
const RUNS: [(&str, &str); 28] = [
    ("periodic", "simulate periodic.toml"),
    ("unsteady", "simulate steady.toml --set method.flow=unsteady --set time.end=0.05 --set objective.window=0.02"),
    ("unsteady", "simulate steady.toml --set method.flow=unsteady --set time.end=0.05 --set objective.periods=2 --set objective.period=0.01"),
    ("timed", "optimize steady.toml --epochs 2 --set method.flow=unsteady --set time.end=0.05 --set objective.periods=2 --set objective.period=0.01"),
    ("steady", "simulate steady.toml --error"),
    ("steady", "simulate steady.toml --set fluid.viscosity=0.002"),
    ("improved", "optimize steady.toml --epochs 3"),
    ("steady", "simulate ball.toml"),
    ("improved", "optimize ball.toml --epochs 1 --no-verify"),
    ("channel", "simulate --set design.walls=both --error"),
    ("channel", "simulate heated-channel-3d --set time.steps=20 --set objective.window=0.01"),
    ("flow", "simulate taylor-green --set time.steps=20 --error"),
    ("flow", "simulate slab --set time.steps=20"),
    ("flow", "simulate isothermal-channel --set time.steps=20"),
    ("flow", "simulate hydrostatic-tank --set time.steps=20"),
    // This step is too long: the run diverges, and recovers.
    ("flow", "simulate taylor-green --recover --set resolution.dx=0.1 --set time.cfl=3 --set time.steps=60"),
    ("custom", "simulate pin.toml --error"),
    ("walls", "optimize --epochs 2 --set design.walls=both"),
    ("walls", "optimize --epochs 1 --no-verify --set optimise.search=scene --set objective.kind=wall-heat"),
    ("walls", "optimize --epochs 1 --no-verify --set time.end=0.1 --set objective.window=0.05 --dynamics surrogate --trust check=1 \
      --set surrogate.settle=50 --set surrogate.steps=2 --set surrogate.window=0.05 --model MODELS/heated-channel/model.safetensors"),
    ("walls", "optimize heated-channel-3d --epochs 1 --no-verify --set time.steps=20 --set objective.window=0.01"),
    ("shapes", "optimize pin.toml --epochs 1"),
    ("shapes", "optimize pin.toml --epochs 1 --no-verify --set objective.kind=flow-rate"),
    ("shapes", "optimize pin.toml --epochs 1 --no-verify --set optimise.gradient=ensemble --set optimise.members=2 --set time.jitter=0.05"),
    ("starts", "optimize --start all --epochs 1"),
    ("recover", "recover taylor-green --set resolution.dx=0.1 --set time.steps=10 --epochs 2"),
    ("recover", "recover falling-block --set resolution.dx=0.1 --set time.steps=10 --epochs 2"),
    ("recover", "recover taylor-green --dynamics surrogate --epochs 1 --model MODELS/taylor-green/model.safetensors"),
];

/// What makes the main job's runs short.
const SHORT: [&str; 3] = ["resolution.dx=0.025", "time.end=0.2", "objective.window=0.1"];

#[test]
fn runs_have_the_fields_of_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("pin.toml"), PIN).unwrap();
    std::fs::write(at.join("steady.toml"), STEADY).unwrap();
    std::fs::write(at.join("ball.toml"), BALL).unwrap();
    std::fs::write(at.join("periodic.toml"), PERIODIC).unwrap();
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models").display().to_string();
    let mut written: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    let mut read = |kind: &'static str, command: &str, out: &str| {
        let text = std::fs::read_to_string(at.join(out).join("summary.json"));
        let text = text.unwrap_or_else(|error| panic!("{command}: {error}"));
        written.entry(kind).or_default().extend(check(kind, &serde_json::from_str(&text).unwrap()));
    };
    for (number, (kind, command)) in RUNS.into_iter().enumerate() {
        let (command, out) = (command.replace("MODELS", &models), number.to_string());
        let mut arguments: Vec<&str> = command.split_whitespace().chain(["--out", &out]).collect();
        // The main job's scene has no name in a command.
        let is_main = arguments[1].starts_with("--") && !command.contains("surrogate");
        if is_main {
            SHORT.iter().for_each(|set| arguments.extend(["--set", set]));
        }
        let output = hydrograd(at, &arguments);
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
        read(kind, &command, &out);
    }
    let data = "generate heated-channel --trajectories 1/1/1 --frames 8 --set time.start=rest --out seen";
    succeeds(at, &data.split_whitespace().collect::<Vec<_>>());
    succeeds(at, &["calibrate", "--data", "seen", "--frames", "6", "--epochs", "1", "--out", "calibrated"]);
    read("calibrate", "calibrate", "calibrated");
    for (name, field) in known() {
        for kind in field.kinds.split(' ') {
            // The comparison of all ways to search takes long: `surrogate_design` checks its file.
            let is_written = kind == "compare" || written.get(kind).is_some_and(|found| found.contains(&name));
            // Every kind of run with steps can recover; one of them shows it.
            let is_rare = name.starts_with("recovered[]") && kind != "flow" || name.starts_with("warnings[]");
            assert!(is_written || is_rare, "no run of {kind} writes {name}");
        }
    }
}

#[test]
fn the_page_is_the_table() {
    let page = include_str!("../src/cli/SUMMARY.md");
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `"));
    let shown: BTreeMap<&str, &str> = rows.map(|row| row.split_once("` | ").unwrap()).collect();
    let known = known();
    for (name, field) in &known {
        let when = field.when.as_deref().unwrap_or_default();
        let row = format!("{} | {} | {when} | {} |", field.unit, field.kinds.replace(' ', ", "), field.what);
        let advice = "write it again: python3 scripts/figures.py summary";
        assert_eq!(shown.get(name.as_str()), Some(&row.as_str()), "{name}: {advice}");
    }
    assert_eq!(shown.len(), known.len(), "the page has fields that data/summary.toml has not");
}
