//! Walls judged by a surrogate: its gradient against differences, what it refuses, and the optimisation from the command line.

mod support;

use candle_core::DType;
use hydrograd::config::layers::Setting;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::scene::load::Loaded;
use hydrograd::surrogate::design::SurrogateProblem;
use hydrograd::surrogate::load_learned;
use std::path::{Path, PathBuf};
use support::program::succeeds;

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
    for text in ["surrogate.settle=30", "surrogate.steps=3", "objective.window=0.1", "design.shape=sine"] {
        settings.push(Setting::set(text));
    }
    settings.extend(["design.amplitude=0.008", "design.periods=1.3", "objective.target_x=0.8"].map(Setting::set));
    settings.extend(more.iter().map(|text| Setting::set(text)));
    Config::load_settings(None, None, &settings).unwrap()
}

fn problem(heat: &str, more: &[&str]) -> SurrogateProblem<f64> {
    let model = load_learned(Some(&model(heat)), Kernels::Fused, DType::F64).unwrap();
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
