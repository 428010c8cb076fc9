//! `optimize` and `check-gradient` with every optimiser, parametrisation and objective, from the command line.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::Config;
use hydrograd::design::{Optimisation, Search};
use hydrograd::io::tensor_file::TensorFile;
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// A short, small run.
const SHORT: [&str; 8] = [
    "--set",
    "time.end=0.3",
    "--set",
    "objective.window=0.1",
    "--set",
    "output.frames=0",
    "--set",
    "optimise.learning_rate=1e-3",
];

const NODES: &str = "design.parametrisation=nodes";
const B_SPLINE: &str = "design.parametrisation=b-spline";
const HEAT: &str = "objective.kind=heat-outflow";
const TEMPERATURE: &str = "objective.kind=outlet-temperature";
const ADAM: &str = "optimise.method=adam";
const L_BFGS_B: &str = "optimise.method=l-bfgs-b";

fn summary(folder: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Every tensor of a checkpoint but the seconds.
fn tensors(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = std::fs::read(folder.join("checkpoint.safetensors")).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let mut names: Vec<String> = file.names().iter().map(|name| name.to_string()).collect();
    names.retain(|name| name != "history.seconds");
    names.sort();
    names.into_iter().map(|name| (name.clone(), file.tensor(&name).unwrap().data().to_vec())).collect()
}

/// A wall that cools the fluid has a negative heat outflow. What is found is told and judged as of one that heats it.
#[test]
fn a_cooling_wall_is_searched_and_judged() {
    let folder = TempDir::new().unwrap();
    let sets = ["wall.hot_temperature=0.8", "resolution.dx=0.025", "design.bound=0.02", "output.frames=0"];
    let mut arguments = vec!["optimize", "heated-channel", "--out", "run", "--epochs", "4"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    let said = succeeds(folder.path(), &arguments);
    let found = summary(&folder.path().join("run"));
    let of = |key: &str| found[key].as_f64().unwrap();
    let change = (of("q") - of("q_first")) / of("q_first").abs();
    assert!(of("q_first") < 0.0 && change > 0.005, "{change}");
    assert!((of("gain") - change).abs() < 0.5 * change, "{} and {change}", of("gain"));
    assert!(said.contains(&format!("({:+.2} %)", 100.0 * change)), "{said}");
    assert!(found["warnings"].as_array().unwrap().iter().any(|warning| warning["code"] == "negative-objective"));
}

/// The search as the Python package has it, without files, is the command's to the bit: of a wall (by the steady state of fixed
/// particles, and by the scene's own) and of shapes.
#[test]
fn the_search_of_the_library_is_the_command_s() {
    let cylinder = concat!(env!("CARGO_MANIFEST_DIR"), "/data/scenes/examples/cylinder.toml");
    let wall = ["resolution.dx=0.04", "design.bound=0.006", "design.shape=sine", "design.amplitude=0.003"];
    let own = [&wall[..], &["optimise.search=scene", "time.end=0.3", "objective.window=0.1"]].concat();
    let shapes = ["time.steps=30", "objective.window=0.0", "objective.samples=1"];
    for (scene, sets) in [("heated-channel", &wall[..]), ("heated-channel", &own), (cylinder, &shapes)] {
        let folder = TempDir::new().unwrap();
        let mut arguments = vec!["optimize", scene, "--no-verify", "--out", "run", "--epochs", "3"];
        sets.iter().chain(&["output.frames=0"]).for_each(|set| arguments.extend(["--set", set]));
        succeeds(folder.path(), &arguments);
        let file = TensorFile::read(&folder.path().join("run/checkpoint.safetensors")).unwrap();

        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let loaded = Config::load(Some(scene), None, &sets).unwrap();
        let solver = loaded.scheduled::<f64>().unwrap();
        let search = Search { config: &loaded.config, solver: &solver, surrogate: None };
        let mut found = Optimisation::new(search.optimiser(&solver.problem.first));
        search.run(&mut found, 3, &mut |_: &Optimisation| Ok(())).unwrap();
        let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let column = |name: &str| bits(file.f64(&format!("history.{name}"), &[3]).unwrap());
        assert_eq!(bits(&found.column(|epoch| epoch.figure)), column("q"), "{scene}");
        assert_eq!(bits(&found.column(|epoch| epoch.loss)), column("loss"), "{scene}");
        assert_eq!(bits(&found.column(|epoch| epoch.gradient_norm)), column("gradient_norm"), "{scene}");
        let next = found.optimiser.ask();
        assert_eq!(bits(next), bits(file.f64("offsets", &[next.len()]).unwrap()), "{scene}");
        assert!(next != solver.problem.first && found.history.iter().all(|epoch| !epoch.is_rejected()), "{scene}");
    }
}

#[test]
fn every_choice_runs_and_resumes_bit_for_bit() {
    for choices in [[L_BFGS_B, B_SPLINE, TEMPERATURE], [L_BFGS_B, NODES, HEAT], [ADAM, B_SPLINE, HEAT]] {
        let folder = TempDir::new().unwrap();
        let at = folder.path();
        let sets = ["--set", choices[0], "--set", choices[1], "--set", choices[2]];
        let run = |out: &str, epochs: &str| {
            succeeds(at, &[&["optimize", "--no-verify", "--out", out, "--epochs", epochs], &SHORT[..], &sets].concat())
        };
        let text = run("whole", "3");
        run("parts", "1");
        succeeds(at, &["optimize", "--no-verify", "--resume", "parts", "--epochs", "2"]);
        succeeds(at, &["optimize", "--no-verify", "--resume", "parts", "--epochs", "3"]);
        assert_eq!(tensors(&at.join("whole")), tensors(&at.join("parts")), "{choices:?}");

        let found = summary(&at.join("whole"));
        let (symbol, key) = if choices[2] == HEAT { ("Q", "q") } else { ("T", "t") };
        assert!(text.contains(&format!("\n{symbol} 0.")), "{text}");
        let values = numbers(&found[&format!("{key}_per_epoch")]);
        assert_eq!(values.len(), 3);
        let best = found["best_epoch"].as_u64().unwrap() as usize;
        assert!(best > 0 && values[best] > values[0], "{choices:?} gained nothing: {values:?}");
        assert_eq!(found[key].as_f64().unwrap(), values[best]);
        let history = std::fs::read_to_string(at.join("whole/history.csv")).unwrap();
        assert!(history.starts_with(&format!("epoch,{key},loss,")), "{history}");
        let variables = if choices[1] == NODES { 25 } else { 8 };
        assert_eq!(numbers(&found["offsets_best"]).len(), variables);
        assert_eq!(numbers(&found["nodes"]).len(), variables);

        // The best wall again, from its file: the same control points up to rounding, and the same flow.
        let file = format!("design.file={}", at.join("whole/shape.csv").display());
        let back = [&["optimize", "--no-verify", "--out", "back", "--epochs", "1", "--set", &file], &SHORT[..], &sets]
            .concat();
        succeeds(at, &back);
        let again = summary(&at.join("back"));
        for (one, two) in numbers(&found["offsets_best"]).iter().zip(numbers(&again["offsets_first"])) {
            assert!((one - two).abs() < 1e-12, "{choices:?}: {one} became {two}");
        }
        assert!((again[key].as_f64().unwrap() / values[best] - 1.0).abs() < 1e-6);

        // Another optimiser can not go on with this one's checkpoint.
        let other = if choices[0] == ADAM { L_BFGS_B } else { ADAM };
        let arguments = ["optimize", "--resume", "parts", "--epochs", "4", "--set", other];
        refused(&arguments, &hydrograd(at, &arguments), &["another scene", "optimise.method"]);
    }
}

#[test]
fn gradients_of_every_choice_pass_the_check() {
    for choices in [[B_SPLINE, TEMPERATURE], [NODES, TEMPERATURE], [B_SPLINE, HEAT]] {
        let folder = TempDir::new().unwrap();
        let sets = ["--set", choices[0], "--set", choices[1], "--set", "design.shape=cosine"];
        let arguments = ["check-gradient", "--steps", "120", "--directions", "1", "--out", "out"];
        let text = succeeds(folder.path(), &[&arguments[..], &sets].concat());
        assert!(text.contains("PASSED"), "{choices:?}: {text}");
        let symbol = if choices[1] == HEAT { "Q = " } else { "T = " };
        assert!(text.contains(symbol), "{text}");
    }
}
