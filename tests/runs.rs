//! Whole runs of the command line: files, figures that fit together, resuming, broken checkpoints.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::adjoint::run::run;
use hydrograd::config::scene::{Config, Family};
use hydrograd::design::diagnostics::{simulate, Diagnostics};
use hydrograd::design::objectives::Figure;
use hydrograd::io::tensor_file::{write_tensors, Data, TensorFile};
use hydrograd::scene::record::Record;
use hydrograd::scene::warnings::Warning;
use hydrograd::scene::{checkpoint, Scene};
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::solver::Solver;
use hydrograd::sph::Sweeps;
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// A short, small run: 0.3 time units.
const SHORT: [&str; 8] = [
    "--set",
    "time.end=0.3",
    "--set",
    "objective.window=0.1",
    "--set",
    "output.frames=2",
    "--set",
    "optimise.learning_rate=1e-3",
];

/// Expects exit code 2, one error with these parts, and no new folder `unwritten`.
fn refuses(folder: &Path, arguments: &[&str], expected: &[&str]) {
    refused(arguments, &hydrograd(folder, arguments), expected);
    assert!(!folder.join("unwritten").exists(), "something was written");
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn with<'a>(first: &[&'a str], then: &[&'a str]) -> Vec<&'a str> {
    [first, &SHORT, then].concat()
}

#[test]
fn threads_are_said_and_too_many_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let run = |threads: &str| {
        let arguments =
            ["simulate", "taylor-green", "--dx", "0.1", "--end", "0.02", "--threads", threads, "--out", "out"];
        let output = hydrograd(folder.path(), &arguments);
        assert!(output.status.success());
        let text = std::fs::read_to_string(folder.path().join("out/summary.json")).unwrap();
        let summary: Value = serde_json::from_str(&text).unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        (summary["threads"].as_u64().unwrap(), printed, String::from_utf8(output.stderr).unwrap())
    };
    let (threads, printed, error) = run("1");
    assert!(threads == 1 && printed.contains(" s on 1 thread (") && error.is_empty(), "{threads} {printed} {error}");
    let (threads, _, error) = run("1000");
    let cores = std::thread::available_parallelism().unwrap().get() as u64;
    assert!(threads == cores && error.starts_with("warning: 1000 threads on "), "{threads} {error}");
    assert!(error.contains("try: --threads "), "{error}");
}

#[test]
fn optimize_writes_what_it_says_and_resumes_bit_for_bit() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text =
        succeeds(at, &with(&["optimize", "--no-verify"], &["--epochs", "4", "--out", "whole", "--threads", "2"]));
    assert!(text.contains("Q ") && text.contains("next: hydrograd simulate"), "{text}");
    for file in [
        "config.toml",
        "summary.json",
        "history.csv",
        "shape.csv",
        "history.png",
        "history.svg",
        "shapes.png",
        "shapes.svg",
        "temperature.png",
        "flow.png",
        "temperature.svg",
        "state.h5",
        "checkpoint.safetensors",
        "particles/particles.pvd",
    ] {
        assert!(at.join("whole").join(file).metadata().unwrap().len() > 0, "{file}");
    }
    let summary = json(&at.join("whole/summary.json"));
    for key in [
        "q",
        "flow_rate",
        "mean_outlet_temperature",
        "wall_heat_flux",
        "energy_imbalance",
        "mean_density",
        "u_max",
        "steps",
        "wall_seconds",
        "peak_memory_bytes",
        "seed",
    ] {
        assert!(summary[key].as_f64().unwrap().is_finite(), "{key}");
    }
    assert_eq!(summary["version"], env!("CARGO_PKG_VERSION"));
    let q = numbers(&summary["q_per_epoch"]);
    assert_eq!(q.len(), 4);
    assert_eq!(numbers(&summary["gradient_norm_per_epoch"]).len(), 4);
    let best = summary["best_epoch"].as_u64().unwrap() as usize;
    assert_eq!(summary["q"].as_f64().unwrap(), q[best]);
    let nodes = numbers(&summary["nodes"]);
    for key in ["offsets_first", "offsets_best", "offsets_last"] {
        assert_eq!(numbers(&summary[key]).len(), nodes.len(), "{key}");
    }
    assert!(numbers(&summary["offsets_first"]).iter().all(|o| *o == 0.0));
    assert!(numbers(&summary["offsets_last"]).iter().all(|o| *o != 0.0 && o.abs() <= 0.02));

    // The best wall has a file of its own, which runs as it was shown.
    succeeds(at, &["simulate", "whole/best.toml", "--out", "best"]);
    let shown = summary["q_scene"].as_f64().unwrap();
    assert!((json(&at.join("best/summary.json"))["q"].as_f64().unwrap() / shown - 1.0).abs() < 1e-9, "{shown}");

    // The same in two parts, and with another number of threads: every bit of design and moments.
    succeeds(at, &with(&["optimize", "--no-verify"], &["--epochs", "2", "--out", "parts"]));
    succeeds(at, &["optimize", "--no-verify", "--resume", "parts", "--epochs", "4", "--threads", "1"]);
    let again = json(&at.join("parts/summary.json"));
    for key in ["q_per_epoch", "gradient_norm_per_epoch", "offsets_best", "offsets_last", "q"] {
        assert_eq!(summary[key], again[key], "{key}");
    }
    let tensors = |name: &str| {
        let bytes = std::fs::read(at.join(name).join("checkpoint.safetensors")).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut names: Vec<String> = file.names().iter().map(|n| n.to_string()).collect();
        names.retain(|n| n != "history.seconds");
        names.sort();
        names.into_iter().map(|n| (n.clone(), file.tensor(&n).unwrap().data().to_vec())).collect::<Vec<_>>()
    };
    assert_eq!(tensors("whole"), tensors("parts"));

    // Broken or foreign checkpoints.
    let checkpoint = at.join("parts/checkpoint.safetensors");
    let bytes = std::fs::read(&checkpoint).unwrap();
    for (value, expected) in [(f64::NAN, "design.offsets[0] = NaN"), (0.03, "design.offsets[0] = 0.03")] {
        let mut file = TensorFile::parse(&checkpoint, &bytes).unwrap();
        match file.tensors.get_mut("offsets") {
            Some((_, Data::F64(offsets))) => offsets[0] = value,
            other => panic!("{other:?}"),
        }
        write_tensors(&checkpoint, &file.tensors, &file.metadata).unwrap();
        let arguments = ["optimize", "--resume", "parts", "--epochs", "6", "--out", "unwritten"];
        refuses(folder.path(), &arguments, &["checkpoint.safetensors", expected]);
    }
    std::fs::write(&checkpoint, &bytes).unwrap();
    refuses(at, &["optimize", "--resume", "parts"], &["has its 4 epochs", "--epochs 8"]);
    refuses(at, &["optimize", "--resume", "nowhere", "--out", "unwritten"], &["nowhere", "config.toml"]);
    refuses(
        at,
        &["optimize", "--resume", "parts", "--epochs", "6", "--set", "fluid.viscosity=0.02", "--out", "unwritten"],
        &["another scene", "fluid.viscosity = 0.01, not 0.02"],
    );
    refuses(
        at,
        &["simulate", "--resume", "parts", "--out", "unwritten"],
        &["optimisation", "not a hydrograd simulation"],
    );
    std::fs::write(&checkpoint, &bytes[..bytes.len() / 2]).unwrap();
    refuses(at, &["optimize", "--resume", "parts", "--epochs", "6", "--out", "unwritten"], &["checkpoint.safetensors"]);
    std::fs::remove_file(&checkpoint).unwrap();
    refuses(at, &["optimize", "--resume", "parts", "--epochs", "6", "--out", "unwritten"], &["checkpoint.safetensors"]);
}

/// What makes figures doubtful is said on the screen, with options to try, and in the summary; nothing is said of a sound run.
#[test]
fn doubtful_figures_are_warned_of() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let warnings = |out: &str| json(&at.join(out).join("summary.json"))["warnings"].as_array().unwrap().clone();
    let says = |output: &std::process::Output| String::from_utf8(output.stderr.clone()).unwrap();
    let short = hydrograd(at, &with(&["simulate"], &["--out", "short"]));
    assert!(short.status.success());
    assert!(
        says(&short).contains("warning: the flow is not steady: the outflowing heat")
            && says(&short).contains("try: --set time.end=0.6"),
        "{}",
        says(&short)
    );
    assert!(warnings("short").iter().any(|one| one["problem"].as_str().unwrap().contains("not steady")));
    // A column of water that was said to be slow.
    let sets =
        ["resolution.dx=0.1", "tank.length=3.0", "time.end=2", "output.frames=0", "fluid.reference_velocity=0.4"];
    let mut arguments = vec!["simulate", "dam-break", "--out", "fast"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    let fast = hydrograd(at, &arguments);
    assert!(fast.status.success() && says(&fast).contains("Mach 0."), "{}", says(&fast));
    assert!(json(&at.join("fast/summary.json"))["divided_steps"].as_u64().unwrap() > 0);
    arguments.truncate(arguments.len() - 2);
    arguments[3] = "sound";
    let sound = hydrograd(at, &arguments);
    assert!(sound.status.success() && says(&sound).is_empty() && warnings("sound").is_empty(), "{}", says(&sound));
}

#[test]
fn simulation_resumes_bit_for_bit_from_any_checkpoint() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["simulate"], &["--out", "whole", "--set", "design.shape=sine", "--threads", "2"]));
    // What an interrupted run leaves: a run of the same scene whose last checkpoint is an early one. Killing a process at
    // the right moment is not reproducible, so the early checkpoint is made by copying it while the run goes on.
    let arguments = with(&["simulate"], &["--out", "parts", "--set", "design.shape=sine", "--threads", "1"]);
    let program = assert_cmd::cargo::cargo_bin("hydrograd");
    let mut child = std::process::Command::new(program)
        .current_dir(at)
        .args(&arguments)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let checkpoint = at.join("parts/checkpoint.safetensors");
    let mut early = None;
    while child.try_wait().unwrap().is_none() {
        if early.is_none() {
            early = std::fs::read(&checkpoint).ok();
        }
    }
    let early = early.unwrap_or_else(|| std::fs::read(&checkpoint).unwrap());
    std::fs::write(&checkpoint, &early).unwrap();
    let step: usize = {
        let (_, header) = safetensors::SafeTensors::read_metadata(&early).unwrap();
        header.metadata().as_ref().unwrap()["step"].parse().unwrap()
    };
    let end = json(&at.join("whole/summary.json"));
    if step < end["steps"].as_u64().unwrap() as usize {
        succeeds(at, &["simulate", "--resume", "parts"]);
    }
    let state = |name: &str| {
        let file = hdf5::File::open(at.join(name).join("state.h5")).unwrap();
        ["position", "velocity", "temperature", "density", "pressure"]
            .map(|field| file.dataset(field).unwrap().read_raw::<f64>().unwrap())
    };
    assert!(state("whole") == state("parts"), "resumed at step {step}");
    assert_eq!(end["q"], json(&at.join("parts/summary.json"))["q"]);
}

#[test]
fn check_gradient_passes_and_fails_as_it_should() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text = succeeds(at, &["check-gradient", "--steps", "150", "--directions", "2", "--out", "good"]);
    assert!(text.contains("PASSED"), "{text}");
    let report = json(&at.join("good/gradient_check.json"));
    assert_eq!(report["passed"], true);
    assert!(report["worst_relative_error"].as_f64().unwrap() <= 1e-5);
    assert!((report["cosine"].as_f64().unwrap() - 1.0).abs() < 1e-9);
    // A truncated gradient is not the derivative, and the check must say so.
    let arguments = ["check-gradient", "--steps", "150", "--gradient", "truncated", "--horizon", "20", "--out", "bad"];
    let output = hydrograd(at, &arguments);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("FAILED"));
    assert_eq!(json(&at.join("bad/gradient_check.json"))["passed"], false);
}

#[test]
fn composed_kernels_and_single_precision_run() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let tiny = [
        "--set",
        "optimise.search=scene",
        "--set",
        "time.end=0.05",
        "--set",
        "objective.window=0.02",
        "--set",
        "output.frames=0",
        "--epochs",
        "1",
    ];
    let q = |name: &str, more: &[&str]| {
        let arguments = [&["optimize", "--no-verify", "--out", name], &tiny[..], more].concat();
        succeeds(at, &arguments);
        json(&at.join(name).join("summary.json"))["gradient_norm_per_epoch"][0].as_f64().unwrap()
    };
    let fused = q("fused", &[]);
    assert!((q("composed", &["--kernels", "composed"]) / fused - 1.0).abs() < 1e-9);
    assert!((q("taped", &["--gradient", "taped"]) / fused - 1.0).abs() < 1e-15);
    assert!((q("single", &["--precision", "f32"]) / fused - 1.0).abs() < 1e-2);
}

#[test]
fn explain_shows_the_plan_and_runs_nothing() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text = succeeds(at, &["simulate", "--explain"]);
    for part in [
        "wall values",
        "derivatives",
        "continuity",
        "conduction",
        "directed pairs",
        "left out",
        "limited by sound",
        "f64",
    ] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    assert!(!text.contains("gradient of"), "{text}");
    let moving = ["optimize", "--explain", "--set", "optimise.search=scene"];
    let of = |more: &[&str]| succeeds(at, &[&moving, more].concat());
    assert!(succeeds(at, &moving[..2]).contains("flux again"), "fixed particles");
    assert!(of(&[]).contains("every state kept"));
    assert!(of(&["--memory", "20MB"]).contains("on the tape at once"));
    assert!(of(&["--memory", "8MB"]).contains("restored in turn"));
    assert!(of(&["--memory", "4MB"]).contains("binomial"));
    assert!(of(&["--store", "f32"]).contains("rounded to f32"));
    assert!(of(&["--segment", "7"]).contains("a state every 7 steps"));
    assert!(of(&["--gradient", "truncated"]).contains("steps 0 ... 716"));
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "--explain wrote something");
}

#[test]
fn a_small_budget_gives_the_same_gradient() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let gradient = |name: &str, more: &[&str]| {
        let arguments = [&["check-gradient", "--steps", "60", "--directions", "1", "--out", name], more].concat();
        succeeds(at, &arguments);
        json(&at.join(name).join("gradient_check.json"))["gradient"].clone()
    };
    let every_state = gradient("large", &[]);
    assert_eq!(gradient("small", &["--memory", "4MB"]), every_state);
    assert_eq!(gradient("segments", &["--memory", "6.5MB"]), every_state);
}

#[test]
fn a_taped_gradient_that_does_not_fit_is_refused_with_an_estimate() {
    let folder = TempDir::new().unwrap();
    let arguments = ["optimize", "--gradient", "taped", "--set", "optimise.memory=20MB", "--out", "out"];
    let output = hydrograd(folder.path(), &arguments);
    let error = String::from_utf8_lossy(&output.stderr).to_string();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("MB") && error.contains("--gradient segments --segment"), "{error}");
    assert!(!folder.path().join("out").exists());
}

#[test]
fn a_run_that_diverges_says_so() {
    let folder = TempDir::new().unwrap();
    let arguments = ["simulate", "--set", "time.cfl=4", "--set", "time.diffusion_number=1", "--out", "out"];
    let output = hydrograd(folder.path(), &arguments);
    let error = String::from_utf8_lossy(&output.stderr).to_string();
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(error.contains("diverged") && error.contains("time.cfl"), "{error}");
    for part in [
        "where: particle ",
        "likely cause: the step is too long for sound",
        "last good state: out/last-good.safetensors",
    ] {
        assert!(error.contains(part), "no `{part}` in {error}");
    }
    assert!(folder.path().join("out/last-good.safetensors").is_file());
    assert!(!folder.path().join("out/summary.json").exists());
}

/// Steps that are too long are halved where the run diverges; what has gone wrong is forgotten.
#[test]
fn a_run_recovers_with_shorter_steps() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let run = |more: &[&str]| {
        let sets = ["simulate", "taylor-green", "--set", "resolution.dx=0.05", "--set", "time.end=0.5", "--out", "out"];
        let output = hydrograd(at, &[&sets[..], &["--set", "output.frames=5", "--recover"], more].concat());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).to_string())
    };
    let (code, error) = run(&["--set", "time.cfl=2"]);
    assert_eq!(code, Some(0), "{error}");
    assert!(error.starts_with("warning: step ") && error.contains("every step in 2 parts"), "{error}");
    let summary = json(&at.join("out/summary.json"));
    let recovered = summary["recovered"].as_array().unwrap();
    assert!(
        recovered[0]["parts"] == 2 && recovered[0]["step"].as_u64() > recovered[0]["from_step"].as_u64(),
        "{recovered:?}"
    );
    assert!(summary["velocity_error"].as_f64().unwrap() < 0.05, "{summary}");
    let history = std::fs::read_to_string(at.join("out/history.csv")).unwrap();
    let times: Vec<f64> =
        history.lines().skip(1).map(|line| line.split(',').next().unwrap().parse().unwrap()).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
    let frames = std::fs::read_to_string(at.join("out/particles/particles.pvd")).unwrap();
    assert_eq!(frames.matches("<DataSet").count(), 6, "{frames}");

    // What does not come from the step is given up.
    let (code, error) = run(&["--set", "method.shift=none", "--set", "time.end=3"]);
    assert_eq!(code, Some(3), "{error}");
    assert!(error.contains("given up after 4 halvings") && error.matches("warning: ").count() == 4, "{error}");

    let fixed = ["simulate", "--recover", "--set", "method.name=fixed", "--out", "fixed"];
    refuses(at, &fixed, &["--recover with fixed particles"]);
}

/// A verification flow that takes a moment.
const VORTICES: [&str; 8] =
    ["simulate", "taylor-green", "--set", "resolution.dx=0.05", "--set", "time.end=0.4", "--set", "output.frames=2"];

#[test]
fn flows_write_what_they_say() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let cube = ["simulate", "taylor-green-3d", "--set", "resolution.dx=0.5235987755982988", "--set", "time.end=0.5"];
    let channel = ["simulate", "poiseuille", "--set", "resolution.dx=0.1", "--set", "time.end=0.0025"];
    for (name, arguments, exact, dimension) in
        [("plane", &VORTICES[..], true, 2), ("cube", &cube, false, 3), ("channel", &channel, true, 2)]
    {
        let text = succeeds(at, &[arguments, &["--out", name]].concat());
        assert!(text.contains("kinetic energy") && text.contains("velocity error"), "{text}");
        for file in ["config.toml", "history.csv", "kinetic_energy.png", "state.h5", "particles/particles.pvd"] {
            assert!(at.join(name).join(file).metadata().unwrap().len() > 0, "{name}/{file}");
        }
        assert_eq!(at.join(name).join("profile.png").exists(), name == "channel");
        let summary = json(&at.join(name).join("summary.json"));
        for key in ["kinetic_energy", "largest_velocity", "steps", "particles", "wall_seconds", "time_step"] {
            assert!(summary[key].as_f64().unwrap() > 0.0, "{key}");
        }
        assert_eq!(summary["scene"].as_str().unwrap(), arguments[1]);
        assert_eq!(summary["velocity_error"].is_null(), !exact);
        let history = std::fs::read_to_string(at.join(name).join("history.csv")).unwrap();
        let lines: Vec<&str> = history.lines().collect();
        assert_eq!(lines[0].split(',').count(), if exact { 5 } else { 3 });
        assert_eq!(lines.len() as u64, 2 + summary["steps"].as_u64().unwrap(), "{name}: header, start, steps");
        // The last row is what the summary says.
        let last: Vec<f64> = lines[lines.len() - 1].split(',').map(|x| x.parse().unwrap()).collect();
        for (value, key) in last.iter().zip(["time", "kinetic_energy", "largest_velocity"]) {
            // serde_json reads numbers to the last bit but one.
            assert!((value / summary[key].as_f64().unwrap() - 1.0).abs() < 1e-15, "{name}: {key}");
        }
        let file = hdf5::File::open(at.join(name).join("state.h5")).unwrap();
        let position = file.dataset("position").unwrap();
        assert_eq!(position.shape(), [summary["particles"].as_u64().unwrap() as usize, dimension]);
        assert!(file.dataset("temperature").is_err());
    }
    // Measured 0.0101, see tests/flows.rs.
    let error = json(&at.join("channel/summary.json"))["velocity_error"].as_f64().unwrap();
    assert!(error > 0.0 && error < 0.0115, "{error}");
}

#[test]
fn flows_resume_and_agree_between_kernels_and_precisions() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let energy = |name: &str, more: &[&str]| {
        succeeds(at, &[&VORTICES[..], &["--out", name], more].concat());
        json(&at.join(name).join("summary.json"))["kinetic_energy"].as_f64().unwrap()
    };
    let fused = energy("fused", &["--threads", "2"]);
    assert!((energy("composed", &["--kernels", "composed"]) / fused - 1.0).abs() < 1e-9);
    assert!((energy("single", &["--precision", "f32"]) / fused - 1.0).abs() < 1e-3);
    assert_ne!(energy("other", &["--seed", "1"]), fused);
    refuses(at, &["simulate", "--resume", "fused", "--out", "unwritten"], &["steps already", "time.end"]);

    // A finished run that is made longer, and one of that length.
    let dt = json(&at.join("fused/summary.json"))["time_step"].as_f64().unwrap();
    let by_steps = |steps: &str, out: &str| {
        let cfl = format!("time.cfl={}", dt * 11.0 / 0.05);
        let arguments = ["simulate", "taylor-green", "--set", "resolution.dx=0.05", "--set", &cfl, "--out", out];
        succeeds(
            at,
            &[&arguments[..], &["--set", &format!("time.steps={steps}"), "--set", "output.frames=0"]].concat(),
        );
    };
    by_steps("88", "whole");
    by_steps("30", "part");
    succeeds(at, &["simulate", "--resume", "part", "--set", "time.steps=88"]);
    let [whole, part] = ["whole", "part"].map(|name| {
        let file = hdf5::File::open(at.join(name).join("state.h5")).unwrap();
        ["position", "velocity", "density"].map(|field| file.dataset(field).unwrap().read_raw::<f64>().unwrap())
    });
    assert!(whole == part, "a resumed run ends with other bits");
    let history = |name: &str| std::fs::read_to_string(at.join(name).join("history.csv")).unwrap();
    assert_eq!(history("whole"), history("part"));
}

/// By its end, whose steps were made to fit the shorter run.
#[test]
fn a_finished_simulation_becomes_longer_to_the_bit() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["simulate"], &["--out", "run", "--set", "design.shape=sine"]));
    let before = json(&at.join("run/summary.json"))["time_step"].clone();
    // Averages of the last 0.1 would begin before what the run is at.
    refuses(
        at,
        &["simulate", "--resume", "run", "--set", "time.end=0.35", "--out", "unwritten"],
        &["averages", "objective.window", "--set time.end=0.6"],
    );
    refuses(
        at,
        &["simulate", "--resume", "run", "--set", "time.end=0.7", "--seed", "3", "--out", "unwritten"],
        &["run/checkpoint.safetensors", "run.seed = 0, not 3"],
    );
    succeeds(at, &["simulate", "--resume", "run", "--set", "time.end=0.7"]);
    // What it has become, in one go.
    succeeds(at, &["simulate", "run/config.toml", "--out", "whole"]);
    let [run, whole] = ["run", "whole"].map(|name| json(&at.join(name).join("summary.json")));
    assert_eq!(run["time_step"], before);
    assert!(run["steps"].as_f64().unwrap() * before.as_f64().unwrap() >= 0.7 - 1e-9);
    for key in ["q", "flow_rate", "wall_heat_flux", "stored_heat_rate", "mean_density", "u_max", "steps"] {
        assert_eq!(run[key], whole[key], "{key}");
    }
    let state = |name: &str| {
        let file = hdf5::File::open(at.join(name).join("state.h5")).unwrap();
        ["position", "velocity", "temperature", "density"]
            .map(|field| file.dataset(field).unwrap().read_raw::<f64>().unwrap())
    };
    assert!(state("run") == state("whole"));
    refuses(at, &["simulate", "--resume", "run", "--out", "unwritten"], &["steps already", "a longer time.end"]);
}

#[test]
fn a_flow_that_diverges_says_so() {
    let folder = TempDir::new().unwrap();
    let sets = ["--set", "time.diffusion_number=1", "--set", "resolution.dx=0.1"];
    let output = hydrograd(folder.path(), &[&["simulate", "poiseuille", "--out", "out"], &sets[..]].concat());
    let error = String::from_utf8_lossy(&output.stderr).to_string();
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(error.contains("diverged") && error.contains("time.diffusion_number"), "{error}");
    assert!(!folder.path().join("out/summary.json").exists());
}

/// Continues a run where the averages begin, so that they must be the same too.
fn resumes<R: Sweeps>(precision: &str) {
    let sets = ["time.steps=40", "design.shape=\"sine\"", &format!("run.precision=\"{precision}\"")].map(String::from);
    let loaded = Config::load(None, None, &sets).unwrap();
    let mut config = loaded.config;
    config.objective.window = 10.0 * config.time_step();
    let text = toml::to_string(&config).unwrap();
    let scene = Scene::<R>::from_config(&config).unwrap();
    let design = scene.design.as_ref().unwrap();
    assert_eq!(design.window, 10);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    let mut keep = |_: &Sph<R>, solver: &mut Solver<R>| {
        if solver.step == 30 {
            checkpoint::write(&path, &solver.model, &solver.snapshot(), &text)?;
        }
        Ok(())
    };
    let whole = simulate(design, config.run.kernels, &scene.start, &mut [&mut keep]).unwrap();
    let from = checkpoint::read(&path, &config, &scene.model).unwrap();
    assert_eq!(from.step, 30);
    let rest = simulate(design, config.run.kernels, &from, &mut []).unwrap();
    let bits = |state: &[R]| state.iter().map(|x| x.f64().to_bits()).collect::<Vec<u64>>();
    assert!(bits(&whole.solver.state) == bits(&rest.solver.state));
    assert_eq!(whole.diagnostics, rest.diagnostics);
    // A checkpoint of another scene or another kind is rejected.
    let other = Config { scene: config.scene, ..Config::default() };
    let error = checkpoint::read(&path, &other, &scene.model).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("checkpoint of another scene: it has"), "{error}");
    let error = checkpoint::open(&path, "hydrograd optimisation", &config, &[]).unwrap_err().to_string();
    assert!(error.contains("holds hydrograd simulation, not a hydrograd optimisation"), "{error}");
    // A run that ends where it begins returns its start.
    let dynamics = Sph::new(scene.model.clone(), config.run.kernels);
    assert!(bits(&run(&dynamics, &from, 30, &mut []).unwrap().state) == bits(&from.state));
}

#[test]
fn a_simulation_goes_on_to_the_bit() {
    resumes::<f64>("f64");
    resumes::<f32>("f32");
}

#[test]
fn what_was_put_into_a_summary_is_read_again() {
    let mut record = Record::of(&Diagnostics { q: 0.0237, energy_imbalance: f64::NAN, ..Diagnostics::default() });
    record.put("q_first", 0.0234);
    record.put("best_epoch", 1);
    record.put("q_per_epoch", [0.0234, 0.0237, f64::NAN]);
    record.put("warnings", [Warning::new("code", [2.0, 1.0], "a".into(), "b")]);
    record.put("before", Record::of(&Diagnostics { q: 0.0234, ..Diagnostics::default() }));
    let text = serde_json::to_string(&record).unwrap();
    let read: Record = serde_json::from_str(&text).unwrap();
    assert_eq!(read, record);
    assert_eq!((read.number("energy_imbalance"), read.number("u_max")), (None, Some(0.0)));
    assert_eq!((read.before().number("q"), read.warnings()[0].advice.as_str()), (Some(0.0234), "b"));
    let search = read.search(Figure::of_config(&Config::default())).unwrap();
    assert_eq!((search.best_epoch, search.values.len(), search.values[2], search.survives), (1, 3, None, None));
    assert!((search.gain() - 0.0003 / 0.0234).abs() < 1e-12);
    // A record of an earlier version, without some figures.
    let older: Record = serde_json::from_str(r#"{ "q": 0.02 }"#).unwrap();
    assert!(older.search(Figure::of_config(&Config::default())).is_none() && older.warnings().is_empty());
    // A box without heat has no figures of it, and a closed one has no flow rate.
    let found = Diagnostics { q: 0.02, flow_rate: 0.1, mean_density: 1.0, ..Diagnostics::default() };
    let mut config = Family::Custom.defaults();
    let has = |config: &Config| {
        let record = Record::of_measured(config, &found);
        ["q", "flow_rate", "mean_density"].map(|key| record.number(key).is_some())
    };
    assert_eq!(has(&config), [false, true, true]);
    config.region.periodic[0] = false;
    assert_eq!(has(&config), [false, false, true]);
}
