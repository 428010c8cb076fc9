//! Inverse problems: gradients against differences, and what is found again.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::layers::Setting;
use hydrograd::config::scene::Config;
use hydrograd::dataset::{read_split, Metadata, Split};
use hydrograd::design::limits::Limits;
use hydrograd::design::optimisers::BarzilaiBorwein;
use hydrograd::error::Error;
use hydrograd::inverse::calibration::{Calibration, Parameter};
use hydrograd::inverse::initial_state::{InitialState, Unknown};
use hydrograd::inverse::search::{search, Epoch, Found};
use std::path::Path;

/// A scene with some settings, a part of whose start is unknown; with a guess of it, unless it is at rest.
fn problem(scene: &str, settings: &[&str], unknown: Unknown, guess: &[&str]) -> InitialState<f64> {
    let load = |more: &[&str]| {
        let settings: Vec<Setting> = settings.iter().chain(more).map(|text| Setting::set(text)).collect();
        Config::load_settings(Some(scene), None, &settings).unwrap().config
    };
    let assumed = (!guess.is_empty()).then(|| load(guess));
    InitialState::new(&load(&[]), unknown, assumed.as_ref(), None).unwrap()
}

/// The derivative along a direction, against central differences; the value.
fn check_gradient(problem: &InitialState<f64>, at: &[f64], step: f64, tolerance: f64) {
    let direction: Vec<f64> = (0..at.len()).map(|k| ((k * k + 1) as f64).cos()).collect();
    let (value, gradient) = problem.evaluate(at, &mut |_| ()).unwrap();
    assert!(value > 0.0);
    let moved = |h: f64| {
        let moved: Vec<f64> = at.iter().zip(&direction).map(|(x, d)| x + h * d).collect();
        problem.evaluate(&moved, &mut |_| ()).unwrap().0
    };
    let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let difference = (moved(step) - moved(-step)) / (2.0 * step);
    assert!((difference / slope - 1.0).abs() < tolerance, "{slope:e} {difference:e}");
}

#[test]
fn the_gradient_by_initial_velocities() {
    let problem = problem("taylor-green", &["resolution.dx=0.1", "time.steps=20"], Unknown::Velocities, &[]);
    let truth = problem.truth();
    let at: Vec<f64> = truth.iter().enumerate().map(|(k, v)| 0.6 * v + 0.1 * (k as f64).sin()).collect();
    check_gradient(&problem, &at, 1e-5, 1e-6);
    // At the truth there is nothing to gain.
    let (value, gradient) = problem.evaluate(&truth, &mut |_| ()).unwrap();
    assert!(value < 1e-20 && gradient.iter().all(|g| g.abs() < 1e-9));
    assert_eq!(problem.error(&truth), 0.0);
}

/// A block that is on the floor when it is compared, so that the gradient goes through walls, surface and evolved density.
const ON_THE_FLOOR: [&str; 4] = ["water.y=0.1", "fluid.viscosity=0.02", "time.cfl=1.0", "time.steps=60"];

#[test]
fn the_gradient_by_initial_places() {
    let guess = ["water.x=0.1", "run.seed=1"];
    let places = problem("falling-block", &ON_THE_FLOOR, Unknown::Places, &guess);
    check_gradient(&places, &places.first(), 1e-7, 1e-6);
    let truth = places.truth();
    let (value, gradient) = places.evaluate(&truth, &mut |_| ()).unwrap();
    assert!(value < 1e-20 && gradient.iter().all(|g| g.abs() < 1e-9));
    assert_eq!(places.error(&truth), 0.0);

    let offset = problem("falling-block", &ON_THE_FLOOR, Unknown::Offset, &guess);
    assert_eq!(offset.first(), [0.0, 0.0]);
    check_gradient(&offset, &[0.013, 0.02], 1e-7, 1e-6);
    // What is the same for both is the same.
    let whole: f64 = places.evaluate(&places.first(), &mut |_| ()).unwrap().0;
    assert_eq!(offset.evaluate(&[0.0, 0.0], &mut |_| ()).unwrap().0, whole);
    // The whole block stays in its tank, and so does each of its particles.
    let (limits, within) = (offset.limits(), places.limits());
    let first = places.first();
    for d in 0..2 {
        let row = &first[d * first.len() / 2..(d + 1) * first.len() / 2];
        let (least, most) = row.iter().fold((9.0_f64, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
        assert!((limits.lower[d] + least).abs() < 1e-12 && (limits.upper[d] + most - 1.0).abs() < 1e-12);
    }
    assert!(within.lower.iter().all(|x| x.abs() < 1e-12) && within.upper.iter().all(|x| (x - 1.0).abs() < 1e-12));
}

/// In a periodic box a place has images, and one that has left comes back.
#[test]
fn the_gradient_by_initial_places_in_a_periodic_box() {
    let settings = ["resolution.dx=0.1", "time.steps=20", "method.name=standard"];
    let problem = problem("taylor-green", &settings, Unknown::Places, &["run.seed=1"]);
    let first = problem.first();
    check_gradient(&problem, &first, 1e-7, 1e-6);
    let far: Vec<f64> = first.iter().map(|x| x + 3.0).collect();
    let [near, far] = [&first, &far].map(|x| problem.evaluate(x, &mut |_| ()).unwrap().0);
    assert!((far / near - 1.0).abs() < 1e-9, "{near} {far}");
    assert!(problem.error(&first) > 0.0 && problem.error(&first) < 0.02);
}

/// JAX-SPH's notebook brings 0.300 to 0.008 and 0.315 to 0.023 in 15 steps.
#[test]
fn velocities_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["resolution.dx=0.05", "time.steps=40", "method.name=standard"].map(|set| ["--set", set]).concat();
    let small = [&["recover", "taylor-green"], &small[..]].concat();
    succeeds(folder.path(), &[&small[..], &["--out", "found"]].concat());
    let text = std::fs::read_to_string(folder.path().join("found/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| summary[key].as_f64().unwrap();
    assert!(number("distance") < number("distance_before") / 50.0, "{summary}");
    assert!(number("velocity_error") < 0.1, "{summary}");
    for file in ["history.csv", "history.png", "end.png", "start.png", "config.toml"] {
        assert!(folder.path().join("found").join(file).is_file(), "{file}");
    }
    // From a file it is the same; from one of other particles it is refused.
    let simulate = [&["simulate"], &small[1..], &["--out", "seen"]].concat();
    // It warns of the vortices' disorder, which is faster than the flow.
    assert!(hydrograd(folder.path(), &simulate).status.success());
    succeeds(folder.path(), &[&small[..], &["--target", "seen/state.h5", "--out", "again"]].concat());
    let other = ["recover", "taylor-green", "--set", "resolution.dx=0.1", "--target", "seen/state.h5"];
    refused(&other, &hydrograd(folder.path(), &other), &["the target has 800 coordinates", "200 coordinates"]);
    let fixed = ["recover", "heated-channel", "--set", "method.name=fixed"];
    refused(&fixed, &hydrograd(folder.path(), &fixed), &["method.name"]);
}

/// JAX-SPH's notebook on a falling block: 0.300 -> 0.008 and 0.315 -> 0.023 in 15 steps, by factors of 37 and 14; with its time
/// step and viscosity, and its targets.
#[test]
fn the_places_of_a_falling_block_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let notebook = ["fluid.viscosity=0.02", "time.jitter=0.02", "time.cfl=1.1", "time.steps=100"];
    let block = [vec!["recover", "falling-block"], notebook.map(|set| ["--set", set]).concat()].concat();
    let found = |name: &str, more: &[&str]| -> serde_json::Value {
        succeeds(folder.path(), &[&block[..], more, &["--out", name]].concat());
        let text = std::fs::read_to_string(folder.path().join(name).join("summary.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    };
    let number = |summary: &serde_json::Value, key: &str| summary[key].as_f64().unwrap();
    let falls = found("falls", &[]);
    assert!(number(&falls, "distance_before") > 0.28, "{falls}");
    // What falls freely is moved at the end as at the start: found as soon as it is looked for.
    assert!(number(&falls, "distance") < 1e-6 && number(&falls, "place_error") < 1e-6, "{falls}");
    for file in ["history.csv", "history.png", "end.png", "start.png", "config.toml"] {
        assert!(folder.path().join("falls").join(file).is_file(), "{file}");
    }
    // From a guess at the wall, which pushes it out of its lattice: another start that ends as near.
    let pushed = found("pushed", &["--guess", "water.x=0.05"]);
    assert!(number(&pushed, "distance_before") > 0.3, "{pushed}");
    assert!(number(&pushed, "distance") < number(&pushed, "distance_before") / 60.0, "{pushed}");
    // One that hits the floor, from a guess that does not, and as a whole.
    let lower = ["--set", "water.y=0.3", "--guess", "water.x=0.05", "--guess", "water.y=0.5"];
    let hits = found("hits", &lower);
    assert!(number(&hits, "distance_before") > 0.3, "{hits}");
    assert!(number(&hits, "distance") < number(&hits, "distance_before") / 100.0, "{hits}");
    let whole = found("whole", &[&lower[..], &["--unknown", "offset"]].concat());
    assert_eq!(number(&whole, "unknowns"), 2.0);
    assert!(number(&whole, "place_error") < 1e-3, "{whole}");
}

#[test]
fn a_guess_is_of_the_same_particles_in_the_same_flow() {
    let folder = tempfile::tempdir().unwrap();
    for (guess, expected) in [
        (
            "fluid.viscosity=0.02",
            vec!["--guess fluid.viscosity=0.02", "fluid.viscosity = 0.02 instead of 0.01", "water.x"],
        ),
        ("water.length=0.4", vec!["--guess water.length=0.4", "water.length = 0.4"]),
        ("water.x=0.5", vec!["there is nothing to find"]),
        ("water.x=0.9", vec!["water.length = 0.3 reaches out of the tank"]),
        ("waters.x=0.1", vec!["--guess waters.x=0.1"]),
    ] {
        let arguments = ["recover", "falling-block", "--guess", guess];
        refused(&arguments, &hydrograd(folder.path(), &arguments), &expected);
    }
    assert!(!folder.path().join("runs").exists());
}

fn seen(folder: &Path) {
    let generate = ["generate", "heated-channel", "--set", "time.start=rest", "--set", "resolution.dx=0.025"];
    let short = ["--trajectories", "1/1/1", "--frames", "5", "--skip", "60", "--walls", "smooth", "--out", "seen"];
    succeeds(folder, &[&generate[..], &short].concat());
}

#[test]
fn viscosity_and_conductivity_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    seen(folder.path());
    let data = folder.path().join("seen");
    let metadata = Metadata::read(&data).unwrap();
    let trajectory = read_split(&data, &metadata, Split::Train).unwrap().remove(0);
    let guess = ["--set", "fluid.viscosity=0.016", "--set", "fluid.conductivity=5.0"];
    let found = ["calibrate", "--data", "seen", "--frames", "5", "--out", "found"];
    succeeds(folder.path(), &[&found[..], &guess].concat());
    let text = std::fs::read_to_string(folder.path().join("found/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    for key in ["fluid.viscosity", "fluid.conductivity"] {
        assert!(summary[key]["error"].as_f64().unwrap().abs() < 0.01, "{summary}");
    }
    let many = ["calibrate", "--data", "seen", "--frames", "6"];
    refused(&many, &hydrograd(folder.path(), &many), &["frames = 6", "1 ... 5"]);

    // The gradient by the logarithms, against differences.
    let shape: Vec<String> = trajectory.wall_offset.iter().map(f64::to_string).collect();
    let offsets = format!("design.offsets=[{}]", shape.join(","));
    let text = std::fs::read_to_string(data.join("config.toml")).unwrap();
    let scene = folder.path().join("scene.toml");
    std::fs::write(&scene, text).unwrap();
    let settings = [Setting::set(&offsets), Setting::set("fluid.viscosity=0.014")];
    let loaded = Config::load_settings(scene.to_str(), None, &settings).unwrap();
    let both = vec![Parameter::Viscosity, Parameter::Conductivity];
    let problem = Calibration::<f64>::new(loaded, &metadata, &trajectory, 5, both).unwrap();
    let x = [0.05, -0.1];
    let (value, gradient) = problem.evaluate(&x, &mut |_| ()).unwrap();
    assert!((value / problem.value(&x).unwrap() - 1.0).abs() < 1e-12);
    for k in 0..2 {
        let at = |h: f64| {
            let mut x = x;
            x[k] += h;
            problem.value(&x).unwrap()
        };
        let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
        assert!((difference / gradient[k] - 1.0).abs() < 1e-6, "{k}: {} {difference}", gradient[k]);
    }
}

/// (x - 3)^2, which diverges beyond `edge`.
fn parabola(edge: f64) -> impl FnMut(usize, &[f64]) -> Result<(f64, Vec<f64>), Error> {
    move |_, x| match x[0] <= edge {
        true => Ok(((x[0] - 3.0).powi(2), vec![2.0 * (x[0] - 3.0)])),
        false => Err(Error::diverged("beyond the edge", "less")),
    }
}

fn searched(first: f64, edge: f64, epochs: usize) -> (Result<Found, Error>, Vec<f64>) {
    let limits = Limits::within(vec![f64::NEG_INFINITY], vec![f64::INFINITY]);
    let mut losses = vec![];
    let mut optimiser = BarzilaiBorwein::new(8.0, &[first]);
    let mut see = |epoch: Epoch<'_>| losses.push(epoch.loss);
    let found = search(&mut optimiser, &limits, epochs, &mut parabola(edge), &mut see);
    (found, losses)
}

#[test]
fn a_run_that_diverges_is_a_step_too_far() {
    let (best, losses) = searched(0.0, 5.0, 30);
    let best = best.unwrap();
    // The first step is by 8, then 2, and to the minimum.
    assert_eq!(losses[..3], [9.0, f64::INFINITY, 1.0]);
    assert_eq!((best.at, best.loss), (vec![3.0], 0.0));
    assert!(best.epochs == losses.len() && best.epochs < 30, "{losses:?}");
}

#[test]
fn the_best_of_the_epochs_is_kept_and_a_first_run_must_not_diverge() {
    assert_eq!(searched(0.0, 5.0, 2).0.unwrap(), Found { at: vec![0.0], loss: 9.0, epochs: 2 });
    assert!(matches!(searched(6.0, 5.0, 2).0, Err(Error::Diverged { .. })));
}
