//! What is left of a gain: what a check changes, `verify`, what `optimize` says of it, and a search with other particles than the scene's.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::{Config, Method};
use hydrograd::design::objectives::Figure;
use hydrograd::design::shape::Shape;
use hydrograd::scene::verification::{Check, Finding, Verification, Verified};
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// A coarse, short run.
const TINY: [&str; 12] = [
    "--set",
    "resolution.dx=0.04",
    "--set",
    "design.bound=0.006",
    "--set",
    "time.end=0.3",
    "--set",
    "objective.window=0.1",
    "--set",
    "output.frames=0",
    "--set",
    "optimise.search=scene",
];

/// The checks of a scene with moving particles.
const CHECKS: [&str; 5] =
    ["as optimised", "half the spacing (0.02)", "fixed particles", "twice the time (0.6)", "another seed (1)"];

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn with<'a>(first: &[&'a str], then: &[&'a str]) -> Vec<&'a str> {
    [first, &TINY, then].concat()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// The checks of a file, whose numbers fit together.
fn checks(file: &Value) -> Vec<Value> {
    let found = file["verification"].as_array().unwrap().clone();
    for check in &found {
        if check["error"].is_null() {
            let gain = number(&check["gain"]);
            assert!((number(&check["q_best"]) / number(&check["q_reference"]) - 1.0 - gain).abs() < 1e-12);
        } else {
            assert!(check["gain"].is_null() && check["q_best"].is_null(), "{check}");
        }
    }
    let parts = &file["gain_error_parts"];
    let error: f64 = ["discretisation", "iteration", "sampling"].iter().map(|part| number(&parts[part])).sum();
    assert_eq!(number(&file["gain_error"]), error);
    // The gain is that of the finer spacing, if that could be run.
    let finer = found.iter().find(|check| check["check"].as_str().unwrap().contains(" spacing ("));
    let finer = finer.filter(|check| !check["gain"].is_null());
    assert_eq!(file["gain"], finer.unwrap_or(&found[0])["gain"]);
    assert!((number(&file["gain_survives"]) - (number(&file["gain"]) - error)).abs() < 1e-15);
    assert_eq!(file["proved"], number(&file["gain_survives"]) > 0.0);
    found
}

#[test]
fn optimize_ends_with_the_checks_and_verify_repeats_them() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text = succeeds(at, &with(&["optimize"], &["--epochs", "2", "--out", "run"]));
    for part in
        CHECKS.iter().chain(&["gain that survives: ", "the gain less its error", "reference: the first design; "])
    {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    let summary = json(&at.join("run/summary.json"));
    let found = checks(&summary);
    assert!(found.iter().zip(CHECKS).all(|(check, name)| check["check"] == name), "{found:?}");
    // As optimised: the numbers of the loop.
    assert!((number(&found[0]["q_reference"]) / number(&summary["q_first"]) - 1.0).abs() < 1e-12);
    assert!((number(&found[0]["q_best"]) / number(&summary["q"]) - 1.0).abs() < 1e-12);
    assert_ne!(found[1]["q_best"], found[0]["q_best"], "another spacing, another figure");
    assert!(number(&summary["verification_seconds"]) > 0.0);

    let text = succeeds(at, &["verify", "run"]);
    assert!(text.contains("gain that survives") && text.contains("run/verification.json"), "{text}");
    let again = json(&at.join("run/verification.json"));
    assert_eq!(checks(&again), found);
    assert_eq!(again["version"], env!("CARGO_PKG_VERSION"));
    let config = std::fs::read_to_string(at.join("run/config.toml")).unwrap();
    succeeds(at, &["verify", "run", "--set", "time.end=0.2", "--out", "other"]);
    assert_ne!(checks(&json(&at.join("other/verification.json"))), found);
    assert_eq!(std::fs::read_to_string(at.join("run/config.toml")).unwrap(), config);

    let text = succeeds(at, &with(&["optimize"], &["--epochs", "1", "--out", "quick", "--no-verify"]));
    assert!(!text.contains("gain that survives"), "{text}");
    assert!(json(&at.join("quick/summary.json"))["verification"].is_null());
}

/// Both walls, at a flow rate, by the heat of the walls: the file of a run's walls gives the run back.
#[test]
fn two_walls_are_kept_by_their_file() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let kind = [
        "--set",
        "design.walls=both",
        "--set",
        "design.bound=0.003",
        "--set",
        "fluid.drive=flow-rate",
        "--set",
        "objective.kind=wall-heat",
        "--set",
        "optimise.search=fixed",
    ];
    let text = succeeds(at, &with(&["optimize"], &[&kind[..], &["--epochs", "3", "--out", "run"]].concat()));
    assert!(text.contains("W, heat from the walls") && text.contains("gain that survives"), "{text}");
    let header = std::fs::read_to_string(at.join("run/shape.csv")).unwrap();
    assert!(header.starts_with("x,offset,first,last,top,top_first,top_last\n"), "{header}");
    let summary = json(&at.join("run/summary.json"));
    assert!(at.join("run/shapes-top.png").exists());
    let flow_rate = number(&summary["flow_rate"]) / number(&summary["before"]["flow_rate"]);
    assert!((flow_rate - 1.0).abs() < 0.02, "{flow_rate}");
    assert!(number(&summary["body_force"]) != number(&summary["before"]["body_force"]));
    succeeds(at, &["verify", "run"]);
    let found = json(&at.join("run/verification.json"));
    let first = &found["verification"][0];
    assert!((number(&first["w_best"]) / number(&summary["w"]) - 1.0).abs() < 0.02, "{first} {}", summary["w"]);
    // The same file as a design of its own.
    let wall = at.join("run/shape.csv");
    let file = format!("design.file={}", wall.display());
    let sets = ["--set", &file, "--set", "method.name=fixed", "--set", "design.bound=0.003", "--out", "again"];
    succeeds(at, &with(&["simulate"], &sets));
    let config = std::fs::read_to_string(at.join("again/config.toml")).unwrap();
    assert!(config.contains("walls = \"both\"") && config.contains("top_offsets = ["), "{config}");
    let header = std::fs::read_to_string(at.join("again/shape.csv")).unwrap();
    assert!(header.starts_with("x,offset,top\n"), "{header}");
    // Whoever says which walls is not overruled by the file.
    let sets = ["--set", &file, "--set", "design.walls=bottom", "--set", "design.bound=0.003", "--out", "bottom"];
    succeeds(at, &with(&["simulate"], &sets));
    let config = std::fs::read_to_string(at.join("bottom/config.toml")).unwrap();
    assert!(config.contains("walls = \"bottom\"") && !config.contains("\ntop_offsets"), "{config}");
}

/// A wall without a top, in a scene whose top is shaped, is judged with a flat top.
#[test]
fn a_scene_s_top_wall_is_not_taken_for_a_design_s() {
    let sets =
        ["design.walls=both", "design.nodes=[0.4, 0.5]", "design.offsets=[0, 0]", "design.top_offsets=[0.01, 0.01]"];
    let verification = verification(&sets);
    let pair = verification.pair(Check::AsOptimised).unwrap();
    for loaded in &pair {
        assert!(loaded.config.design.top_offsets.as_ref().unwrap().iter().all(|o| *o == 0.0));
    }
}

#[test]
fn the_best_of_all_starts_is_verified_against_the_flat_wall() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let amplitude = ["--set", "design.amplitude=0.005"];
    let more = [&["--epochs", "1", "--start", "all", "--out", "starts"], &amplitude[..]].concat();
    let text = succeeds(at, &with(&["optimize"], &more));
    assert_eq!(text.matches("gain that survives").count(), 1, "{text}");
    assert!(text.contains("reference: the flat wall"), "{text}");
    let summary = json(&at.join("starts/summary.json"));
    let name = summary["verified_start"].as_str().unwrap();
    let q = |start: &str| number(&summary[start]["q"]);
    assert!(["flat", "random", "linear", "sine"].iter().all(|start| q(start) <= q(name)), "{summary}");
    let found = checks(&summary);
    assert!((number(&found[0]["q_best"]) / q(name) - 1.0).abs() < 1e-12);
    let output = hydrograd(at, &["verify", "starts"]);
    refused(&["verify", "starts"], &output, &["starts is not the folder of a run", "shape.csv", "starts/flat"]);
    // There is nothing left to do, and it still says so the next time; more epochs are something.
    for _ in 0..2 {
        let again = ["optimize", "--start", "all", "--resume", "starts"];
        refused(&again, &hydrograd(at, &again), &["the run has its 1 epochs already", "--epochs 2"]);
        assert!(std::fs::read_to_string(at.join("starts/.hydrograd")).unwrap().contains("finished"));
    }
    succeeds(at, &["optimize", "--start", "all", "--no-verify", "--resume", "starts", "--epochs", "2"]);
    let longer = json(&at.join("starts/summary.json"));
    assert_eq!(longer["flat"]["q_per_epoch"].as_array().unwrap().len(), 2, "{longer}");
}

#[test]
fn a_wall_without_a_gain_is_a_warning() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    std::fs::write(at.join("wall.csv"), "x,offset\n0.3,0.0\n0.5,0.0\n").unwrap();
    let text = succeeds(at, &with(&["verify", "wall.csv", "--scene", "heated-channel"], &["--out", "out"]));
    assert!(text.contains("WARNING: no gain survives: this wall is not better than the flat wall"), "{text}");
    assert_eq!(number(&json(&at.join("out/verification.json"))["gain_survives"]), 0.0);
    // A check that can not be run has a row and a reason, and the others count.
    let sets = ["--set", "method.name=standard", "--set", "resolution.smoothing_length=0.801", "--set", "time.cfl=0.5"];
    let text = succeeds(at, &with(&["verify", "wall.csv"], &sets));
    assert!(text.contains("WARNING: the check `fixed particles` failed: "), "{text}");
    assert!(text.contains("moving particles only"), "{text}");
    let found = checks(&json(&at.join("verification.json")));
    assert_eq!(found.iter().filter(|check| !check["error"].is_null()).count(), 1, "{found:?}");
    // Runs that diverge are found out, not the end.
    let wild = ["--set", "time.cfl=4", "--set", "time.diffusion_number=1"];
    let text = succeeds(at, &with(&["verify", "wall.csv"], &[&sets[..4], &wild].concat()));
    assert!(text.contains("gain that survives: not known") && text.contains("nothing is known of this wall"), "{text}");
    assert!(
        text.contains("WARNING: the check `as optimised` failed: step ") && text.contains("has diverged"),
        "{text}"
    );
    assert!(json(&at.join("verification.json"))["gain_survives"].is_null());
}

#[test]
fn a_search_with_fixed_particles_is_shown_with_the_scenes_own() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let text = succeeds(at, &with(&["optimize"], &["--epochs", "2", "--out", "run", "--set", "optimise.search=fixed"]));
    for part in ["with moving particles: Q", "moving particles, another seed (1)"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    let summary = json(&at.join("run/summary.json"));
    assert_eq!(summary["search"], "fixed");
    assert!(number(&summary["q_scene"]) > 0.0 && number(&summary["q_scene_before"]) > 0.0);
    assert_eq!(checks(&summary)[2]["check"], "moving particles");
    succeeds(at, &["optimize", "--resume", "run", "--epochs", "3", "--no-verify"]);
    let arguments = ["optimize", "--resume", "run", "--epochs", "4", "--set", "optimise.search=scene"];
    refused(&arguments, &hydrograd(at, &arguments), &["another scene", "optimise.search"]);
    // Where there is nothing to choose from, the search takes what there is.
    let standard =
        ["--set", "method.name=standard", "--set", "resolution.smoothing_length=0.801", "--set", "time.cfl=0.5"];
    let more = [&["--epochs", "1", "--no-verify", "--set", "optimise.search=fixed"], &standard[..]].concat();
    let text = succeeds(at, &with(&["optimize"], &more));
    assert!(!text.contains("particles: Q"), "{text}");
}

#[test]
fn mistakes_are_refused() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let file = |name: &str, text: &str| std::fs::write(at.join(name), text).unwrap();
    std::fs::create_dir(at.join("empty")).unwrap();
    std::fs::create_dir(at.join("run")).unwrap();
    file("wall.csv", "x,offset\n0.3,0.001\n0.5,0.002\n");
    file("run/shape.csv", "x,offset,first\n0.3,0.001,0.0\n0.5,0.002,0.0\n");
    file("run/config.toml", "");
    file("high.csv", "x,offset\n0.3,0.3\n0.5,0.3\n");
    file("beside.csv", "x,offset\n0.1,0.0\n0.5,0.0\n");
    file("nothing.csv", "x,y\n0.3,0.1\n");
    file("first.csv", "x,offset,first\n0.3,0.0,much\n");
    let cases: [(&[&str], &[&str]); 13] = [
        (&["verify", "nowhere"], &["no such file or folder: nowhere", "x and offset"]),
        (&["verify", "empty"], &["empty is not the folder of a run", "empty/config.toml"]),
        (&["verify", "run", "--scene", "poiseuille"], &["--scene poiseuille", "run/config.toml", "run/shape.csv"]),
        (&["verify", "high.csv"], &["high.csv", "design.offsets[0] = 0.3", "design.bound"]),
        (&["verify", "beside.csv"], &["beside.csv", "design.nodes[0] = 0.1", "0.25 ... 0.75"]),
        (&["verify", "nothing.csv"], &["nothing.csv", "no column `offset`"]),
        (&["verify", "first.csv"], &["first.csv, line 2", "first is `much`"]),
        (&["verify", "wall.csv", "--scene", "poiseuille"], &["poiseuille has no design", "heated-channel"]),
        (&["verify", "wall.csv", "--scene", "heated-chanel"], &["heated-chanel", "try: `heated-channel`"]),
        (&["verify", "wall.csv", "--set", "time.ende=1"], &["--set time.ende=1", "`end`"]),
        (&["verify", "wall.csv", "--out", "wall.csv"], &["--out wall.csv", "is a file"]),
        (
            &["simulate", "--set", "method.name=fixed", "--set", "time.adaptive=true"],
            &["method.name = fixed", "consistent"],
        ),
        (&["optimize", "--set", "optimise.search=both"], &["--set optimise.search=both", "fixed", "scene"]),
    ];
    for (arguments, expected) in cases {
        refused(arguments, &hydrograd(at, arguments), expected);
    }
    assert!(!at.join("verification.json").exists());
}

/// A verification of the flat wall against itself.
fn verification(sets: &[&str]) -> Verification {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    let loaded = Config::load(None, None, &sets).unwrap();
    let (from, to) = (loaded.config.channel.hot_from, loaded.config.channel.hot_to);
    let flat = Shape::new(vec![0.5], vec![0.0], from, to).unwrap();
    Verification { loaded, reference: flat.clone(), best: flat, reference_name: "the flat wall", quick: false }
}

#[test]
fn a_check_changes_one_thing() {
    let verification = verification(&["time.end=0.37", "objective.window=0.11", "design.shape=sine", "run.seed=6"]);
    let before = verification.loaded.config.clone();
    let of = |check: Check| {
        let [reference, best] = verification.pair(check).unwrap();
        assert_eq!(reference.config, best.config, "the same wall twice");
        reference.config
    };
    let mut expected = before.clone();
    (expected.design.nodes, expected.design.offsets) = (Some(vec![0.5]), Some(vec![0.0]));
    assert_eq!(of(Check::AsOptimised), expected);
    let mut fine = expected.clone();
    fine.resolution.dx = 0.01;
    assert_eq!(of(Check::FinerSpacing), fine);
    assert_eq!(of(Check::FinerSpacing).duration(), before.duration());
    let mut other = expected.clone();
    other.method = Method::named("fixed").unwrap();
    // Its own time step.
    other.time.cfl = 1.2;
    assert_eq!(of(Check::OtherMotion), other);
    let long = of(Check::TwiceTime);
    assert!((long.duration() - 0.74).abs() < 1e-12 && long.objective.window == 0.11, "{long:?}");
    assert_eq!(long.resolution, before.resolution);
    let mut seed = expected.clone();
    seed.run.seed = 7;
    assert_eq!(of(Check::OtherSeed), seed);
}

#[test]
fn fixed_particles_are_checked_against_moving_ones() {
    let verification = verification(&["method.name=fixed", "time.steps=100"]);
    let config = |check: Check| verification.pair(check).unwrap()[0].config.clone();
    assert_eq!(config(Check::OtherMotion).method.name(), "consistent");
    assert_eq!(config(Check::OtherSeed).method.name(), "consistent");
    assert_eq!(config(Check::FinerSpacing).method.name(), "fixed");
    // A number of steps is a time: half the spacing takes more of them.
    let time = verification.loaded.config.duration();
    assert!((config(Check::FinerSpacing).duration() - time).abs() < 1e-12);
    assert!((config(Check::TwiceTime).duration() - 2.0 * time).abs() < 1e-12);
    assert!(verification.describe(Check::OtherSeed).starts_with("moving particles, another seed"));
}

#[test]
fn deep_walls_of_the_standard_formulation_stay_covered() {
    let verification = verification(&["method.name=standard", "design.bound=0.04", "time.end=0.3"]);
    let fine = verification.pair(Check::FinerSpacing).unwrap()[0].config.clone();
    assert_eq!((fine.resolution.dx, fine.channel.wall_rows), (0.01, 4));
    let error = verification.pair(Check::OtherMotion).unwrap_err().to_string();
    assert!(error.contains("moving particles only"), "{error}");
}

/// With fixed particles the slopes of the best wall at both ends of the hot section are part of the error of a gain of heat.
#[test]
fn slopes_at_the_ends_of_the_hot_section_are_an_error_of_the_gain() {
    let of = |sets: &[&str]| {
        let same = verification(sets);
        let best = Shape::new(vec![0.26, 0.5, 0.74], vec![0.01, 0.0, -0.006], 0.25, 0.75).unwrap();
        Verification { best, ..same }.least()
    };
    // Up by 0.01 and down by 0.006 over 0.13, from the middle between nodes before the hot section to the first one.
    let [share, least] = of(&["method.name=fixed"]);
    assert!(share == 0.06 && (least - (0.9e-3 * 0.01 + 2.2e-3 * 0.006) / 0.13).abs() < 1e-12, "{least}");
    for other in ["method.name=consistent", "objective.kind=flow-rate", "design.walls=both", "fluid.drive=flow-rate"] {
        let rate = "fluid.flow_rate=0.15";
        let sets = ["method.name=fixed", other, rate];
        assert_eq!(of(&sets[..if other.contains("drive") { 3 } else { 2 }]), [0.1, 0.0], "{other}");
    }
}

/// Gains of steady flows around shapes in the plane are right to less than a hundredth of them.
#[test]
fn gains_around_shapes_have_a_smaller_error() {
    let of = |scene: &str, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let loaded = Config::load(Some(&format!("data/scenes/examples/{scene}.toml")), None, &sets).unwrap();
        let none = Shape::of_numbers(vec![]);
        Verification { loaded, reference: none.clone(), best: none, reference_name: "the first design", quick: false }
            .least()
    };
    assert_eq!(of("least-drag", &[]), [0.02, 0.0]);
    assert_eq!(of("least-drag", &["method.flow=unsteady", "time.end=1"]), [0.1, 0.0]);
    // Moving particles.
    assert_eq!(of("wake", &[]), [0.1, 0.0]);
}

/// What is left of a gain is the gain less its error, whose parts are those of the checks.
#[test]
fn a_gain_survives_less_its_error() {
    let finding = |kind: Check, figures: Result<(f64, f64), String>| Finding {
        kind,
        check: "a check".into(),
        figures,
        smaller: false,
    };
    let verified = |checks: Vec<Finding>| Verified {
        figure: Figure::of_config(&Config::default()),
        finer: 0.5,
        order: 2.0,
        moves: false,
        least: [0.1, 0.0],
        reference_name: "the flat wall",
        checks,
        seconds: 1.0,
    };
    let mut checks = vec![
        finding(Check::AsOptimised, Ok((1.0, 1.02))),
        finding(Check::FinerSpacing, Ok((1.0, 1.012))),
        finding(Check::OtherMotion, Err("diverged".into())),
        finding(Check::TwiceTime, Ok((1.0, 1.021))),
    ];
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} is not {b}");
    let found = verified(checks.clone());
    // The gain is that at half the spacing, 0.012; 1.25 / (2^2 - 1) of the change from 0.02 is the error that is left there.
    close(found.gain().unwrap(), 0.012);
    let parts = found.error().unwrap();
    close(parts.discretisation, 0.008 * 1.25 / 3.0);
    // Twice the change over twice the time.
    close(parts.iteration, 0.002);
    close(parts.sampling, 0.0);
    close(found.survives().unwrap(), 0.012 - parts.total());
    // Of the best wall's figure as optimised, the change from 1.02 to 1.012, and what is left.
    let relative = 1.02 / 1.012 - 1.0;
    close(found.error_of_best().unwrap().discretisation, 1.02 * relative * (1.0 + 1.25 / 3.0));
    assert!(found.is_proved() && found.failed().count() == 1);
    // Both figures changed alike: no less than a tenth of the gain.
    checks[1] = finding(Check::FinerSpacing, Ok((1.2, 1.2 * 1.02)));
    close(verified(checks.clone()).error().unwrap().discretisation, 0.1 * 0.02);
    let sloping = Verified { least: [0.06, 0.0013], ..verified(checks.clone()) };
    close(sloping.error().unwrap().discretisation, 0.0013);
    // Without a finer spacing particles of the other kind tell the error; they have another seed.
    checks[1] = finding(Check::OtherMotion, Ok((1.0, 1.04)));
    checks[2] = finding(Check::OtherSeed, Ok((1.0, 1.0402)));
    let parts = verified(checks.clone()).error().unwrap();
    close(parts.discretisation, 0.02);
    close(parts.sampling, 0.0002);
    assert!(!verified(checks.clone()).is_proved());
    // Without a finer spacing or other particles nothing is known of the error.
    checks.retain(|finding| [Check::AsOptimised, Check::TwiceTime].contains(&finding.kind));
    let found = verified(checks);
    assert_eq!((found.error(), found.survives(), found.is_proved()), (None, None, false));
    close(found.gain().unwrap(), 0.02);
}
