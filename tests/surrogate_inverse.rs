//! Velocities found by a surrogate: its gradient against differences, what it finds, and what it refuses.

use crate::support::program::{hydrograd, refused, succeeds};
use candle_core::DType;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::surrogate::initial_velocity::{known_scene, LearnedVelocities};
use hydrograd::surrogate::load_learned;

/// Along a direction, against central differences in f64, for a model that sees two frames and for one that sees four. Hardly trained:
/// what it says does not matter.
#[test]
fn the_gradient_is_that_of_differences() {
    let folder = tempfile::tempdir().unwrap();
    let mut generate = vec!["generate", "taylor-green", "--trajectories", "2/1/1", "--frames", "8", "--every", "20"];
    generate.extend(["--relax", "0", "--set", "resolution.dx=0.1", "--out", "data"]);
    succeeds(folder.path(), &generate);
    for frames in ["2", "4"] {
        let (seen, out) = (format!("features.frames={frames}"), format!("train-{frames}"));
        let mut train = vec!["train", "--data", "data", "--steps", "4", "--out", &out, "--set", &seen];
        for set in ["model.latent=8", "model.rounds=2", "validation_steps=2", "validation_windows=1"] {
            train.extend(["--set", set]);
        }
        succeeds(folder.path(), &train);
        let file = folder.path().join(&out).join("last.safetensors");
        let model = load_learned(&file, Kernels::Fused, DType::F64).unwrap();
        let (scene, settings) = known_scene(&model).unwrap();
        assert_eq!(scene, "taylor-green");
        let loaded = Config::load_settings(Some(scene), None, &settings).unwrap();
        assert_eq!(loaded.config.resolution.dx, 0.1);
        let learned = LearnedVelocities::<f64>::new(&loaded, model, 3).unwrap();
        // Three frames of 20 reference steps, 0.22 dx / 11 each.
        let time = learned.problem.scene.steps as f64 * learned.problem.scene.model.dt;
        assert!((time - 3.0 * 20.0 * 0.22 * 0.1 / 11.0).abs() < 1e-12, "{time}");
        let at: Vec<f64> =
            learned.problem.truth().iter().enumerate().map(|(k, v)| 0.6 * v + 0.1 * (k as f64).sin()).collect();
        let (value, gradient) = learned.evaluate(&at, &mut |_| ()).unwrap();
        assert!(value > 0.0 && (value / learned.loss(&at).unwrap() - 1.0).abs() < 1e-12);
        let direction: Vec<f64> = (0..at.len()).map(|k| ((k * k + 1) as f64).cos()).collect();
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let moved = |h: f64| {
            let moved: Vec<f64> = at.iter().zip(&direction).map(|(x, d)| x + h * d).collect();
            learned.loss(&moved).unwrap()
        };
        let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
        assert!((difference / slope - 1.0).abs() < 1e-6, "{frames} frames: {slope:e} {difference:e}");
    }
    // Its own scene with a number that the model does not know.
    let other = ["recover", "taylor-green", "--dynamics", "surrogate", "--model", "train-2/last.safetensors"];
    let other = [&other[..], &["--set", "resolution.dx=0.05"]].concat();
    let expected = ["--set resolution.dx=0.05", "the model knows another flow", "resolution.dx was 0.1 and is 0.05"];
    refused(&other, &hydrograd(folder.path(), &other), &expected);
}

/// With the built-in model, which is as small as its training was short: the solver finds more, and both find something.
#[test]
fn velocities_are_found_and_judged_in_the_solver() {
    let folder = tempfile::tempdir().unwrap();
    let printed = succeeds(
        folder.path(),
        &["recover", "taylor-green", "--dynamics", "surrogate", "--epochs", "4", "--out", "found"],
    );
    assert!(printed.contains("found by the surrogate") && printed.contains("found by the solver"), "{printed}");
    let text = std::fs::read_to_string(folder.path().join("found/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| summary[key].as_f64().unwrap();
    let own = |key: &str| summary["solver"][key].as_f64().unwrap();
    assert_eq!((number("particles"), number("frames"), number("epochs")), (400.0, 8.0, 4.0));
    assert!(number("distance") < number("distance_before") / 3.0, "{summary}");
    assert!(number("velocity_error") < 0.5 && own("velocity_error") < number("velocity_error"), "{summary}");
    assert!(own("distance") < number("distance"), "{summary}");
    assert!(number("distance_in_the_surrogate") < number("distance_in_the_surrogate_before") / 3.0, "{summary}");
    for file in ["history.csv", "history.png", "end.png", "start.png", "config.toml"] {
        assert!(folder.path().join("found").join(file).is_file(), "{file}");
    }
}

#[test]
fn what_a_surrogate_can_not_do_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let surrogate = ["recover", "taylor-green", "--dynamics", "surrogate"];
    for (more, expected) in [
        (vec!["--set", "time.steps=9"], vec!["--set time.steps=9", "--frames"]),
        (vec!["--unknown", "places"], vec!["--unknown", "velocities"]),
        (vec!["--guess", "run.seed=1"], vec!["--guess", "at rest"]),
        (vec!["--target", "state.h5"], vec!["--target"]),
        (vec!["--set", "flow.reynolds=50"], vec!["--set flow.reynolds=50", "flow.reynolds was 100.0 and is 50.0"]),
        (vec!["--model", "none.safetensors"], vec!["none.safetensors"]),
    ] {
        let arguments = [&surrogate[..], &more].concat();
        refused(&arguments, &hydrograd(folder.path(), &arguments), &expected);
    }
    let other = ["recover", "falling-block", "--dynamics", "surrogate"];
    refused(&other, &hydrograd(folder.path(), &other), &["the model knows scene taylor-green"]);
    for option in [["--frames", "3"], ["--model", "model.safetensors"]] {
        let arguments = [&["recover", "taylor-green"][..], &option].concat();
        refused(&arguments, &hydrograd(folder.path(), &arguments), &[option[0], "--dynamics surrogate"]);
    }
}
