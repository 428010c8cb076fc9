//! Walls judged by a surrogate: its gradient against differences, what it refuses, and the optimisation from the command line.

use crate::support;
use crate::support::program::succeeds;
use candle_core::DType;
use hydrograd::config::layers::Setting;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::design::optimise::Epoch;
use hydrograd::design::{Judge, Optimisation, Search};
use hydrograd::scene::load::Loaded;
use hydrograd::surrogate::design::SurrogateProblem;
use hydrograd::surrogate::load_learned;
use std::path::{Path, PathBuf};

/// A coarse channel that is small enough to learn nothing from in a moment.
const SCENE: [&str; 3] = ["resolution.dx=0.025", "time.jitter=0.02", "channel.height=0.2"];

/// A data set and a model of each kind of heat, hardly trained, made once for all tests.
fn folder() -> &'static Path {
    static FOLDER: std::sync::OnceLock<tempfile::TempDir> = std::sync::OnceLock::new();
    FOLDER
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let mut generate = vec!["generate", "heated-channel", "--trajectories", "2/1/1", "--frames", "12"];
            generate.extend(["--skip", "20", "--out", "data"]);
            SCENE.iter().for_each(|set| generate.extend(["--set", set]));
            succeeds(folder.path(), &generate);
            for heat in ["learned", "conduction"] {
                let (heat, out) = (format!("model.heat={heat}"), format!("train-{heat}"));
                let mut train = vec!["train", "--data", "data", "--steps", "4", "--out", &out, "--set", &heat];
                for set in ["model.latent=8", "model.rounds=2", "validation_steps=4", "validation_windows=1"] {
                    train.extend(["--set", set]);
                }
                succeeds(folder.path(), &train);
            }
            folder
        })
        .path()
}

fn model(heat: &str) -> PathBuf {
    folder().join(format!("train-{heat}/last.safetensors"))
}

/// The scene with a few frames, over a wall that is not flat and not symmetric: where two pieces of the wall are equally near to a
/// dummy particle, the place of its image has a kink.
fn loaded(more: &[&str]) -> Loaded {
    let mut settings: Vec<Setting> = SCENE.iter().map(|text| Setting::set(text)).collect();
    for text in ["surrogate.settle=30", "surrogate.steps=5", "objective.window=0.1", "design.shape=sine"] {
        settings.push(Setting::set(text));
    }
    settings.extend(["design.amplitude=0.008", "design.periods=1.3", "objective.target_x=0.8"].map(Setting::set));
    settings.extend(more.iter().map(|text| Setting::set(text)));
    Config::load_settings(None, None, &settings).unwrap()
}

fn problem(heat: &str, more: &[&str]) -> SurrogateProblem<f64> {
    let model = load_learned(&model(heat), Kernels::Fused, DType::F64).unwrap();
    SurrogateProblem::new(&loaded(more), model).unwrap()
}

/// The derivative along a direction, and the same by central differences, for the learned temperature and for conduction.
#[test]
fn the_gradient_is_that_of_differences() {
    for heat in ["learned", "conduction"] {
        let problem = problem(heat, &[]);
        let x = problem.problem.first.clone();
        let found = problem.differentiate(&x, &mut |_| ()).unwrap();
        assert!((found.value / problem.evaluate(&x).unwrap() - 1.0).abs() < 1e-12);
        let direction: Vec<f64> = (0..x.len()).map(|k| ((k * k + 3) as f64).sin()).collect();
        let along: f64 = direction.iter().zip(&found.by_variables).map(|(d, g)| d * g).sum();
        let at = |step: f64| {
            let moved: Vec<f64> = x.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
            problem.evaluate(&moved).unwrap()
        };
        let difference = |step: f64| (at(step) - at(-step)) / (2.0 * step);
        let difference = difference(1e-7);
        assert!((along / difference - 1.0).abs() < 1e-6, "{heat}: {along:e}, by differences {difference:e}");
    }
}

/// What the command line makes of it, at the shortest: checks, a trust region, both, and what is refused.
#[test]
fn the_command_line_judges_what_the_surrogate_proposes() {
    let folder = folder();
    let model = model("learned");
    let common = |more: &[&str]| -> Vec<String> {
        let mut all: Vec<String> = vec!["optimize".into(), "--no-verify".into(), "--model".into()];
        all.push(model.to_str().unwrap().into());
        let sets =
            ["surrogate.settle=30", "surrogate.steps=5", "output.frames=0", "time.end=0.3", "optimise.search=scene"];
        for set in SCENE.iter().copied().chain(sets).chain(["objective.target_x=0.8"]) {
            all.extend(["--set".to_string(), set.to_string()]);
        }
        all.extend(more.iter().map(|text| text.to_string()));
        all
    };
    let run = |more: &[&str]| {
        let all = common(more);
        succeeds(folder, &all.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let summary = |name: &str| -> serde_json::Value {
        let text = std::fs::read_to_string(folder.join(name).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    };
    run(&["--dynamics", "surrogate", "--trust", "check=2", "--epochs", "3", "--out", "checked"]);
    let checked = summary("checked");
    let known = |key: &str, k: usize| checked[key][k].as_f64();
    assert!((0..3).all(|k| known("q_predicted_per_epoch", k).is_some()));
    assert!(known("q_solver_per_epoch", 0).is_some() && known("q_solver_per_epoch", 2).is_some());
    // The gain that is printed is the solver's.
    let best = checked["best_epoch"].as_u64().unwrap() as usize;
    assert_eq!(checked["q"].as_f64(), known("q_solver_per_epoch", best));
    assert!(checked["solver_steps"].as_u64().unwrap() > 0);
    assert!(std::fs::read_to_string(folder.join("checked/history.csv"))
        .unwrap()
        .contains("predicted,solver,solver_steps"));

    // A run that goes on is the run that was not interrupted.
    let region = ["--dynamics", "surrogate", "--trust", "region", "--set", "surrogate.inner_epochs=3", "--epochs"];
    run(&[&region[..], &["3", "--out", "whole"]].concat());
    run(&[&region[..], &["2", "--out", "parts"]].concat());
    succeeds(folder, &["optimize", "--no-verify", "--resume", "parts", "--epochs", "3"]);
    let (whole, parts) = (summary("whole"), summary("parts"));
    for key in ["q_per_epoch", "q_predicted_per_epoch", "offsets_best"] {
        assert_eq!(whole[key], parts[key], "{key}");
    }
    // Within the region what is promised is close to what comes.
    assert!(whole["q_solver_per_epoch"].as_array().unwrap().iter().all(serde_json::Value::is_number));

    run(&["--dynamics", "both", "--set", "surrogate.epochs=2", "--epochs", "4", "--out", "both"]);
    let both = summary("both");
    assert!(both["q_predicted_per_epoch"][1].is_number() && both["q_predicted_per_epoch"][2].is_null());
    assert!(both["q_solver_per_epoch"][3].is_number());
}

/// The search as the Python package has it is the command's to the bit, whoever judges.
#[test]
fn the_search_of_the_library_is_the_command_s() {
    let model = format!("surrogate.model={:?}", model("learned").display());
    let ways = [
        ["optimise.dynamics=surrogate", "surrogate.trust=check", "surrogate.check_every=2"],
        ["optimise.dynamics=surrogate", "surrogate.trust=region", "surrogate.inner_epochs=3"],
        ["optimise.dynamics=both", "surrogate.epochs=2", "surrogate.trust=none"],
    ];
    for (k, way) in ways.iter().enumerate() {
        let short = ["time.end=0.3", "optimise.search=scene", "output.frames=0", &model];
        let loaded = loaded(&[&short[..], way].concat());
        let out = format!("command-{k}");
        std::fs::write(folder().join("scene.toml"), &loaded.text).unwrap();
        succeeds(folder(), &["optimize", "scene.toml", "--no-verify", "--epochs", "4", "--out", &out]);
        let text = std::fs::read_to_string(folder().join(&out).join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();

        let solver = loaded.scheduled::<f64>().unwrap();
        let surrogate = SurrogateProblem::<f64>::of_config(&loaded).unwrap().unwrap();
        let search = Search { config: &loaded.config, solver: &solver, surrogate: Some(&surrogate) };
        let mut found = Optimisation::new(search.optimiser(&solver.problem.first));
        search.run(&mut found, 4, &mut |_: &Optimisation| Ok(())).unwrap();
        let column =
            |of: fn(&Epoch) -> Option<f64>| serde_json::json!(found.history.iter().map(of).collect::<Vec<_>>());
        assert_eq!(summary["q_per_epoch"], column(|epoch| Some(epoch.figure)), "{way:?}");
        assert_eq!(summary["loss_per_epoch"], column(|epoch| Some(epoch.loss)), "{way:?}");
        assert_eq!(summary["q_predicted_per_epoch"], column(|epoch| epoch.predicted), "{way:?}");
        assert_eq!(summary["q_solver_per_epoch"], column(|epoch| epoch.truth.map(|truth| truth.figure)), "{way:?}");
        assert_eq!(summary["best_epoch"], found.best, "{way:?}");
        assert_eq!(summary["solver_steps"], found.solver_steps(), "{way:?}");
        // What the surrogate says of a design is the same with and without its gradient, up to rounding.
        let x = &found.history[found.best].variables;
        let (one, other) = (surrogate.value(x).unwrap(), surrogate.gradient(x, &mut |_| ()).unwrap());
        assert!((one.loss / other.loss - 1.0).abs() < 1e-12 && one.predicted == Some(one.figure), "{one:?} {other:?}");
        assert!((surrogate.figure(x, one.loss) / one.figure - 1.0).abs() < 1e-12);
    }
}

#[test]
fn every_way_to_search_is_compared() {
    let folder = folder();
    let model = model("learned");
    let mut all =
        vec!["optimize", "--compare", "--epochs", "2", "--out", "compared", "--model", model.to_str().unwrap()];
    let sets =
        ["surrogate.settle=30", "surrogate.steps=5", "output.frames=0", "surrogate.inner_epochs=2", "time.end=0.5"];
    SCENE.iter().chain(&sets).for_each(|set| all.extend(["--set", set]));
    let text = succeeds(folder, &all);
    for way in ["solver", "surrogate", "surrogate, checked", "trust region", "both", "CMA-ES, B-spline"] {
        assert!(text.lines().any(|line| line.starts_with(way)), "{way}: {text}");
    }
    let file = |name: &str| folder.join("compared").join(name);
    assert!(["compare.png", "horizons.png", "horizons.csv"].iter().all(|name| file(name).is_file()));
    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(file("summary.json")).unwrap()).unwrap();
    support::summary::check("compare", &summary);
    // The gain of the solver's search is the one of its own summary.
    let (own, compared) = (&summary["solver"], &summary["compared: solver"]["gain"]);
    let gain = own["q"].as_f64().unwrap() / own["q_first"].as_f64().unwrap() - 1.0;
    assert!((compared.as_f64().unwrap() - gain).abs() < 1e-12, "{summary}");
    // Ended when some ways had not begun, it goes on, and finds the same.
    for (place, kind) in [("", "optimize --compare"), ("solver", "optimize"), ("surrogate", "optimize")] {
        std::fs::write(file(place).join(".hydrograd"), format!("{kind}\n")).unwrap();
    }
    for way in ["surrogate-checked", "trust-region", "both"] {
        std::fs::remove_dir_all(file(way)).unwrap();
    }
    let before = file("solver/checkpoint.safetensors").metadata().unwrap().modified().unwrap();
    succeeds(folder, &["optimize", "--compare", "--resume", "compared"]);
    assert_eq!(file("solver/checkpoint.safetensors").metadata().unwrap().modified().unwrap(), before);
    let again: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(file("summary.json")).unwrap()).unwrap();
    for (key, value) in summary.as_object().unwrap().iter().filter(|(key, _)| key.starts_with("compared: ")) {
        assert_eq!(value["gain"], again[key]["gain"], "{key}");
    }
    // Then there is nothing left to do.
    let output = support::program::hydrograd(folder, &["optimize", "--compare", "--resume", "compared"]);
    support::program::refused(&["optimize"], &output, &["the run has its 2 epochs already", "--epochs 4"]);
}

#[test]
fn what_a_surrogate_can_not_do_is_refused() {
    let folder = folder();
    let model = model("learned");
    let model = model.to_str().unwrap();
    let refuse = |more: &[&str], expected: &[&str]| {
        let mut all = vec!["optimize", "--dynamics", "surrogate", "--model", model];
        SCENE.iter().for_each(|set| all.extend(["--set", set]));
        all.extend(more);
        let output = support::program::hydrograd(folder, &all);
        support::program::refused(&all, &output, expected);
        assert!(!folder.join("runs").exists());
    };
    refuse(&["--set", "channel.height=0.25"], &["the model knows another flow", "channel.height was 0.2 and is 0.25"]);
    refuse(&["--set", "design.bound=0.024"], &["the model knows walls within 0.02 only", "design.bound"]);
    refuse(&["--set", "design.walls=both"], &["design.walls", "allowed: bottom"]);
    refuse(&["--gradient", "truncated"], &["optimise.gradient", "segments or taped"]);
    refuse(&["--trust", "check=0"], &["--trust", "check=N"]);
    refuse(&["--memory", "1kB"], &["optimise.memory"]);
    let nobody = ["optimize", "--trust", "region"];
    let output = support::program::hydrograd(folder, &nobody);
    support::program::refused(&nobody, &output, &["surrogate.trust without a surrogate", "--dynamics surrogate"]);
    let missing = ["optimize", "--dynamics", "surrogate", "--model", "none.safetensors"];
    let output = support::program::hydrograd(folder, &missing);
    support::program::refused(&missing, &output, &["none.safetensors"]);
}
