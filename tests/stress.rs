//! `hydrograd stress`: what it runs, keeps and says; and why a run diverged.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::layers::Setting;
use hydrograd::config::scene::Config;
use hydrograd::scene::Scene;
use hydrograd::sph::divergence::Cause;
use hydrograd::validation::stress::{maps, Job};
use serde_json::Value;
use std::path::Path;

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

const STEPS: [&str; 5] = ["stress", "taylor-green", "--filter", "step", "--quick"];

#[test]
fn a_map_is_run_in_shares_kept_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = |more: &[&str]| succeeds(at, &[&STEPS[..], &["--out", "out", "--threads", "1"], more].concat());
    let text = run(&["--shard", "0/2"]);
    assert!(text.contains("16 of 32 runs") && text.contains("next: hydrograd stress --resume --out out"), "{text}");
    // Another folder that holds runs is not written over.
    let again = [&STEPS[..], &["--out", "out"]].concat();
    refused(&again, &hydrograd(at, &again), &["--out out", "holds runs already", "--resume"]);
    let text = run(&["--resume"]);
    assert!(text.contains("32 of 32 runs") && text.contains("16 kept from before"), "{text}");
    assert!(text.contains("edge: CFL 1 -> 1.5 (jitter 0.05, consistent, f64): diverged in step "), "{text}");

    let found = json(&at.join("out/stress.json"));
    let runs = found["maps"][0]["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 32);
    for run in runs {
        let (record, cfl) = (&run["record"], run["x"].as_str().unwrap().parse::<f64>().unwrap());
        let expected = match run["formulation"].as_str().unwrap() {
            "consistent" if cfl == 1.0 => Some("stable"),
            _ if cfl == 3.0 => Some("diverged"),
            "consistent" => Some("diverged"),
            _ => None,
        };
        assert!(expected.is_none_or(|verdict| record["verdict"] == verdict), "{run}");
        assert!((record["courant_number"].as_f64().unwrap() / cfl - 1.0).abs() < 0.15, "{run}");
        if record["verdict"] == "diverged" {
            let fault = &record["fault"];
            assert!(fault["particle"].is_u64() && fault["tag"] == "fluid", "{run}");
            assert!(fault["position"].as_array().unwrap().len() == 2 && fault["cause"].is_string(), "{run}");
        }
    }
    let largest = &found["maps"][0]["largest"][0];
    assert!(largest["stable"] == "1" && largest["not_diverged"] == "1", "{largest}");
    let lines = std::fs::read_to_string(at.join("out/stress.csv")).unwrap();
    assert!(lines.starts_with("scene,map,formulation,precision,") && lines.lines().count() == 33, "{lines}");
    for picture in ["taylor-green-step.png", "taylor-green-step.svg"] {
        assert!(at.join("out").join(picture).is_file(), "{picture}");
    }

    // A run that was made otherwise is not kept.
    let text = run(&["--resume", "--set", "run.seed=7"]);
    assert!(text.contains("0 kept from before"), "{text}");
}

#[test]
fn maps_are_listed_and_others_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = succeeds(folder.path(), &["stress", "--list"]);
    for map in maps::all() {
        assert!(text.contains(&map.id()) && text.contains(map.x.name), "{}", map.id());
    }
    for (arguments, parts) in [
        (["stress", "tokamak"].as_slice(), ["`tokamak`", "dam-break"].as_slice()),
        (&["stress", "--filter", "tokamak"], &["--filter tokamak", "heated-channel-wall"]),
        (&["stress", "dam-break", "--set", "fluid.colour=1"], &["fluid.colour"]),
    ] {
        refused(arguments, &hydrograd(folder.path(), arguments), parts);
    }
    assert!(!folder.path().join("runs").exists());
}

/// `time.cfl = "auto"` follows from the steps, and a run's own configuration has the number.
#[test]
fn the_cfl_number_can_follow_from_the_steps() {
    let load = |scene: &str, sets: &[&str]| {
        let sets: Vec<String> = [&["time.cfl=auto"], sets].concat().iter().map(|set| set.to_string()).collect();
        Config::load(Some(scene), None, &sets).unwrap()
    };
    let cases: [(&str, &[&str], f64); 7] = [
        ("heated-channel", &[], 1.4),
        ("heated-channel", &["method.name=standard"], 1.6),
        ("heated-channel", &["method.name=fixed"], 0.9),
        ("taylor-green", &[], 1.0),
        ("taylor-green", &["method.integrator=symplectic-euler"], 1.4),
        ("lid-driven-cavity", &["time.jitter=0.3"], 0.4),
        ("dam-break", &[], 0.8),
    ];
    for (scene, sets, expected) in cases {
        let loaded = load(scene, sets);
        assert_eq!(loaded.config.time.cfl, expected, "{scene} {sets:?}");
        assert!(loaded.text.contains(&format!("\ncfl = {expected:?}\n")), "{}", loaded.text);
        assert_eq!(loaded.place("time.cfl"), Some("time.cfl = \"auto\""));
    }
    // It follows what is set later.
    let other = load("heated-channel", &[]).with(&[Setting::set("method.name=standard")]).unwrap();
    assert_eq!(other.config.time.cfl, 1.6);
    let wrong = Config::load(None, None, &["time.cfl=fast".into()]).unwrap_err().to_string();
    assert!(wrong.contains("a number or \"auto\""), "{wrong}");
    let number = Config::load(None, None, &["time.cfl=nan".into()]).unwrap_err().to_string();
    assert!(number.contains("time.cfl"), "{number}");
}

/// The likely cause follows from the numbers of the last good state.
#[test]
fn causes_are_told_apart() {
    let cause = |scene: &str, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let config = Config::load(Some(scene), None, &sets).unwrap().config;
        let scene = Scene::<f64>::from_config(&config).unwrap();
        Cause::of(&scene.model, &scene.start)
    };
    let cases: [(&str, &[&str], &str, &str); 5] = [
        ("taylor-green", &["time.cfl=2"], "too long for sound: its Courant number is 2.00", "time.cfl="),
        ("poiseuille", &["time.diffusion_number=1"], "too long for diffusion", "time.diffusion_number="),
        (
            "heated-channel",
            &["fluid.viscosity=0.0024"],
            "too fast for its sound speed, 10.000",
            "fluid.reference_velocity=",
        ),
        ("taylor-green", &["flow.reynolds=1e6"], "cell Reynolds number u dx / nu is 19979", "resolution.dx"),
        ("heated-channel", &[], "the arrangement of the particles", "method.name=fixed"),
    ];
    for (scene, sets, why, advice) in cases {
        let found = cause(scene, sets);
        assert!(found.why.contains(why) && found.advice.contains(advice), "{scene}: {found:?}");
    }
}

#[test]
fn every_run_is_a_configuration_and_axes_have_quick_and_usual_values() {
    for map in maps::all() {
        for axis in [&map.x, &map.y] {
            assert!(axis.usual < axis.values.len(), "{}", map.id());
            assert!(axis.values.iter().filter(|value| value.is_quick).count() > 1, "{}", map.id());
        }
        for quick in [false, true] {
            for job in Job::of(&map, quick, &[]) {
                Config::load(Some(map.scene), None, &job.settings).unwrap_or_else(|e| panic!("{job:?}: {e}"));
            }
        }
    }
}
