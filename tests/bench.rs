//! `hydrograd bench` through the program: rows, filter, comparison, pictures, bad input. Nothing is timed here.

use std::path::Path;
use std::process::Output;

use crate::support::program::{printed, refused};
use assert_cmd::Command;
use hydrograd::cli::bench::accuracy::{fronts, ComparedRun};
use hydrograd::cli::bench::case::{Network, Size};
use hydrograd::cli::bench::child::{count_pairs, taylor_green};
use hydrograd::cli::bench::rows::median;
use hydrograd::cli::bench::surrogate::{flow, products};
use hydrograd::config::scene::{Config, Precision};
use hydrograd::particles::Domain;
use hydrograd::scene::accuracy::{half_life, Run};
use hydrograd::sph::Model;
use hydrograd::surrogate::models::sizes::Sizes;
use hydrograd::surrogate::network::graph::Graph;
use hydrograd::surrogate::predictor::Frame;
use serde_json::{json, Value};
use tempfile::TempDir;

/// One short variant of everything.
const SMALL: [&str; 8] = ["--quick", "--threads", "1", "--precision", "f64", "--sizes", "12^2,8^3", "--out"];

fn bench(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::cargo_bin("hydrograd").unwrap();
    command.current_dir(folder).arg("bench").args(arguments).output().unwrap()
}

/// Runs the bench into `out`, expects success, and returns what it printed and its rows.
fn rows(folder: &Path, out: &str, arguments: &[&str]) -> (String, Vec<Value>) {
    let arguments = [&SMALL[..], &[out], arguments].concat();
    let summary = printed(&arguments, bench(folder, &arguments));
    let text = std::fs::read_to_string(folder.join(out).join("bench.json")).unwrap();
    let rows: Value = serde_json::from_str(&text).unwrap();
    (summary, rows.as_array().unwrap().clone())
}

fn refuses(folder: &Path, arguments: &[&str], expected: &[&str]) {
    refused(arguments, &bench(folder, arguments), expected);
    assert!(!folder.join("unwritten").exists(), "something was written");
}

/// The keys that every row has, with the type and sense of their values.
fn check_row(row: &Value) {
    let text = |key: &str| row[key].as_str().unwrap_or_else(|| panic!("{key} of {row}")).to_string();
    let count = |key: &str| row[key].as_u64().unwrap_or_else(|| panic!("{key} of {row}"));
    let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} of {row}"));
    assert!(["step", "gradient", "scaling", "plan", "kernels"].contains(&&*text("group")));
    assert!(["forward", "gradient"].contains(&&*text("kind")));
    assert!(["f32", "f64"].contains(&&*text("precision")));
    assert!(!text("scene").is_empty());
    assert!([2, 3].contains(&count("dimension")));
    let (n, pairs, steps) = (count("particles") as f64, count("pairs") as f64, count("steps"));
    // Fluid in the bulk has 26 to 28 neighbours in two dimensions, 110 to 122 in three; walls have no pairs of their own.
    let neighbours = if count("dimension") == 2 { 10.0..30.0 } else { 100.0..130.0 };
    assert!(neighbours.contains(&(pairs / n)), "{row}");
    assert!(steps > 0 && count("threads") > 0);
    // A program on candle takes more than a megabyte, a small case less than a gigabyte.
    assert!((1 << 20..1 << 30).contains(&count("peak_memory_bytes")), "{row}");
    let ms = number("ms_per_step");
    assert!(ms > 0.0 && number("ms_per_step_median") >= ms);
    assert!((number("ns_per_particle_step") / (1e6 * ms / n) - 1.0).abs() < 1e-12);
    assert!((number("ns_per_pair") / (1e6 * ms / pairs) - 1.0).abs() < 1e-12);
    assert_eq!(row.get("adjoint_over_forward").is_some(), text("kind") == "gradient");
    let has_groups = ["step", "gradient", "scaling"].contains(&&*text("group"));
    let is_whole = row.get("mode").is_none_or(|mode| mode == "every state");
    assert_eq!(row.get("roofline_ms_per_step").is_some(), has_groups && is_whole, "{row}");
    if has_groups && is_whole {
        // What the machine needs at least is what the slower needs of computing and memory.
        let (gflop, gigabytes) = (number("gflop_per_step"), 1e-9 * number("bytes_per_step"));
        let least = (gflop / number("peak_gflops")).max(gigabytes / number("gigabytes_per_second"));
        assert!((1e-3 * number("roofline_ms_per_step") / least - 1.0).abs() < 1e-12, "{row}");
        // Sums over the neighbours, each of differences, a distance and a kernel: two in the standard method, four with the products of
        // fits in the consistent one; and about three times as many with the adjoint.
        let of_pair = 1e9 * gflop / pairs;
        let expected = if text("kind") == "forward" { 60.0..600.0 } else { 200.0..1500.0 };
        assert!(expected.contains(&of_pair), "{of_pair}: {row}");
        // State, list and fields: tens of numbers of a particle, and two of a pair.
        assert!((300.0..10_000.0).contains(&(1e9 * gigabytes / n)), "{row}");
    }
}

/// Steps of scenes without a design, in two and three dimensions, with a free surface.
#[test]
fn steps_of_every_scene_of_moving_particles() {
    let folder = TempDir::new().unwrap();
    for (scene, sets, dimension) in [
        ("taylor-green", &["--set", "resolution.dx=0.05"][..], 2),
        // With the kernel's own reach: the consistent method's is shorter.
        ("taylor-green-3d", &["--set", "resolution.dx=0.7853981634", "--set", "resolution.smoothing_length=1"], 3),
        ("dam-break", &[], 2),
    ] {
        let (_, rows) = rows(folder.path(), scene, &[&["step", scene], sets].concat());
        assert_eq!(rows.len(), 1);
        check_row(&rows[0]);
        assert_eq!((rows[0]["scene"].as_str(), rows[0]["dimension"].as_u64()), (Some(scene), Some(dimension)));
    }
}

#[test]
fn every_group_gives_rows_of_the_schema() {
    let folder = TempDir::new().unwrap();
    let (text, rows) = rows(folder.path(), "all", &["--set", "time.steps=130", "--set", "objective.window=0"]);
    rows.iter().for_each(check_row);
    let of = |group: &str| rows.iter().filter(|row| row["group"] == group).collect::<Vec<_>>();
    assert_eq!((of("step").len(), of("gradient").len(), of("scaling").len(), of("plan").len()), (2, 6, 4, 20));
    for group in ["step, ", "gradient, ", "scaling, ", "plan, "] {
        assert!(text.contains(group), "{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    // 50 columns of 13 + 6 and 10 + 4 rows (points on a surface are not counted); 12 x 12 and 8 x 8 x 8.
    assert_eq!(of("step").iter().map(|row| row["particles"].as_u64().unwrap()).collect::<Vec<_>>(), [950, 950]);
    let sizes: Vec<_> = of("scaling").iter().map(|row| row["particles"].as_u64().unwrap()).collect();
    assert_eq!(sizes, [144, 144, 512, 512]);
    let steps = |row: &&Value| row["steps"] == 130;
    assert!(of("step").iter().all(steps) && of("gradient").iter().all(steps));
    // A plan leaves out what has no effect, so everything on gives the same result.
    for row in of("plan") {
        match row["mode"].as_str().unwrap() {
            "plan" => assert!(row.get("difference").is_none()),
            "everything on" => assert!(row["difference"].as_f64().unwrap() <= 1e-12, "{row}"),
            other => panic!("{other}"),
        }
    }
    for picture in ["scaling-forward.png", "scaling-gradient.svg", "gradient.png", "gradient.svg"] {
        assert!(folder.path().join("all").join(picture).metadata().unwrap().len() > 1000, "{picture}");
    }
}

#[test]
fn networks_are_measured_beside_sgemm() {
    let folder = TempDir::new().unwrap();
    let (text, rows) = rows(folder.path(), "out", &["surrogate", "--filter", "/gns-5-64-1.45dx/"]);
    assert!(text.contains("sgemm") && text.lines().all(|line| line.chars().count() <= 120), "{text}");
    let kinds: Vec<_> =
        rows.iter().map(|row| (row["kind"].as_str().unwrap(), row["precision"].as_str().unwrap())).collect();
    assert_eq!(kinds, [("forward", "f32"), ("training", "f32")]);
    let number = |row: usize, key: &str| rows[row][key].as_f64().unwrap_or_else(|| panic!("{key} of {}", rows[row]));
    for row in 0..2 {
        assert_eq!((number(row, "particles"), number(row, "pairs")), (950.0, 6728.0));
        let rate = number(row, "gflop_per_step") / (1e-3 * number(row, "ms_per_step"));
        assert!((number(row, "gflops") / rate - 1.0).abs() < 1e-12 && number(row, "sgemm_gflops") > 0.0);
        assert!((1 << 20..1 << 30).contains(&rows[row]["peak_memory_bytes"].as_u64().unwrap()));
    }
    assert!((2.9..3.0).contains(&(number(1, "gflop_per_step") / number(0, "gflop_per_step"))));
}

#[test]
fn fused_and_composed_operators_are_compared() {
    let folder = TempDir::new().unwrap();
    let (text, rows) = rows(folder.path(), "out", &["kernels", "--filter", "/forward/"]);
    let (flows, network) = rows.split_at(6);
    flows.iter().for_each(check_row);
    assert!(text.starts_with("\nkernels, ") && text.lines().all(|line| line.chars().count() <= 120), "{text}");
    let seen: Vec<String> = flows
        .iter()
        .map(|row| format!("{} {} {}", row["scene"], row["particles"], row["mode"]).replace('"', ""))
        .collect();
    let channel = ["heated-channel 950 fused", "heated-channel 950 composed"];
    let vortices = ["144", "512"].iter().flat_map(|n| {
        let scene = if *n == "144" { "taylor-green" } else { "taylor-green-3d" };
        ["fused", "composed"].map(|mode| format!("{scene} {n} {mode}"))
    });
    assert_eq!(seen, channel.map(String::from).into_iter().chain(vortices).collect::<Vec<_>>());
    let of_network =
        |row: &Value| (row["scene"] == "gns-5-64-1.45dx" && row["precision"] == "f32").then(|| row["mode"].clone());
    let modes: Vec<_> = network.iter().map(of_network).collect();
    assert_eq!(modes, [Some(json!("fused")), Some(json!("composed"))]);
    // Each composed row beside its fused one, and only those.
    assert_eq!(text.lines().filter(|line| line.trim_end().ends_with('x')).count(), 4, "{text}");
    assert!(text.contains("vs fused"), "{text}");
    let ms = |row: usize| rows[row]["ms_per_step"].as_f64().unwrap();
    let ratio = format!("{:.1}x", ms(1) / ms(0));
    assert!(text.lines().any(|line| line.contains("composed") && line.ends_with(&ratio)), "no {ratio} in {text}");
    // Composed operators write and read many tensors where fused ones stay in registers: slower on any machine.
    assert!(ms(1) > 1.5 * ms(0), "{text}");

    let (_, rows) =
        self::rows(folder.path(), "gradient", &["kernels", "--filter", "heated-channel/950/f64/1/gradient"]);
    rows.iter().for_each(check_row);
    assert_eq!(rows.len(), 2);
}

#[test]
fn filters_compares_and_varies_threads_and_types() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let (_, old) = rows(at, "old", &["scaling", "--filter", "/144/f64/1/forward"]);
    assert_eq!(old.len(), 1);
    check_row(&old[0]);

    // An earlier run that took twice as long, and one row that this run does not have.
    let mut slower = old[0].clone();
    slower["ms_per_step"] = json!(1e9);
    let mut other = slower.clone();
    other["scene"] = json!("another");
    std::fs::write(at.join("slower.json"), json!([slower, other]).to_string()).unwrap();
    let arguments =
        ["scaling", "--filter", "/144/", "--compare", "slower.json", "--threads", "1,2", "--precision", "f32,f64"];
    let output = bench(at, &[&["--quick", "--sizes", "12^2", "--out", "new"], &arguments[..]].concat());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("new/old") && text.contains("1 of 8 rows are in the earlier run, which has 2"), "{text}");
    assert!(text.contains("0.000"), "{text}");
    let new: Vec<Value> = serde_json::from_str(&std::fs::read_to_string(at.join("new/bench.json")).unwrap()).unwrap();
    let mut variants: Vec<_> = new
        .iter()
        .map(|row| format!("{} {} {}", row["kind"], row["precision"], row["threads"]).replace('"', ""))
        .collect();
    variants.sort();
    let expected = [
        "forward f32 1",
        "forward f32 2",
        "forward f64 1",
        "forward f64 2",
        "gradient f32 1",
        "gradient f32 2",
        "gradient f64 1",
        "gradient f64 2",
    ];
    assert_eq!(variants, expected);
}

#[test]
fn a_gradient_that_does_not_fit_is_left_out_and_said() {
    let folder = TempDir::new().unwrap();
    let (text, rows) = rows(folder.path(), "out", &["scaling", "--memory-limit", "1KB"]);
    assert!(rows.iter().all(|row| row["kind"] == "forward") && rows.len() == 2);
    assert_eq!(text.matches("left out: scaling/").count(), 2, "{text}");
}

#[test]
fn a_case_that_fails_is_named() {
    let folder = TempDir::new().unwrap();
    let sets = ["--set", "time.cfl=4", "--set", "time.diffusion_number=1"];
    let output = bench(folder.path(), &[&["step", "--threads", "1", "--precision", "f64"], &sets[..]].concat());
    let error = String::from_utf8_lossy(&output.stderr).to_string();
    assert_eq!(output.status.code(), Some(3), "{error}");
    assert!(error.starts_with("error: step/heated-channel-report/950/f64/1/forward: step "), "{error}");
    assert!(error.contains("diverged"), "{error}");
}

#[test]
fn accuracy_gives_points_and_draws_those_of_others() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let peer = |error: Value, stable: bool| {
        json!({"code": "another", "scene": "poiseuille", "dx": 0.1, "cfl": 0.2, "precision": "f64", "seconds": 2.0,
            "error": error, "stable": stable})
    };
    std::fs::write(at.join("peers.json"), json!([peer(json!(0.02), true), peer(json!(null), false)]).to_string())
        .unwrap();
    let arguments =
        ["accuracy", "--quick", "--threads", "1", "--filter", "/poiseuille/", "--peers", "peers.json", "--out", "out"];
    let output = bench(at, &arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.matches("another").count(), 2, "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    let points = std::fs::read_to_string(at.join("out/accuracy.json")).unwrap();
    let points: Vec<Value> = serde_json::from_str(&points).unwrap();
    // Two formulations at two spacings in two types; a quarter of the error at half the spacing.
    assert_eq!(points.len(), 8);
    for (code, precision) in ["consistent", "standard"].into_iter().flat_map(|code| [(code, "f64"), (code, "f32")]) {
        let code = format!("hydrograd, {code}");
        let of = |dx: f64| {
            points.iter().find(|p| p["code"] == code && p["precision"] == precision && p["dx"] == dx).unwrap()
        };
        let error = |dx: f64| of(dx)["error"].as_f64().unwrap();
        match code.contains("standard") {
            true => assert!((3.0..5.0).contains(&(error(0.1) / error(0.05))), "{points:?}"),
            // Exact for parabolas: what is left is the start.
            false => assert!(error(0.1) < 1e-3 && error(0.05) < 1e-3, "{points:?}"),
        }
        assert!(of(0.1)["stable"] == true);
    }
    // The other code is in the picture's legend; the scenes that the filter dropped have no picture.
    let picture = std::fs::read_to_string(at.join("out/accuracy-poiseuille.svg")).unwrap();
    assert!(picture.contains("another f64") && picture.contains("hydrograd, standard f32"));
    assert!(!at.join("out/accuracy-taylor-green.svg").exists());
}

#[test]
fn bad_input_is_refused() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let row = json!({"group": "step", "scene": "s", "dimension": 2, "particles": 1, "pairs": 1, "precision": "f64",
        "threads": 1, "kind": "forward", "steps": 1, "ms_per_step": 1.0, "ns_per_particle_step": 1.0,
        "ns_per_pair": 1.0, "peak_memory_bytes": 1});
    let with = |key: &str, value: Value| {
        let mut row = row.clone();
        row[key] = value;
        json!([row]).to_string()
    };
    let mut without = row.clone();
    without.as_object_mut().unwrap().remove("pairs");
    let files = [
        ("text.json", "hello".to_string(), "not an array of JSON"),
        ("object.json", row.to_string(), "not an array of JSON"),
        ("empty.json", "[]".to_string(), "no rows"),
        ("missing.json", json!([row, without]).to_string(), "row 1: missing field `pairs`"),
        ("kind.json", with("kind", json!("sideways")), "row 0: unknown variant `sideways`"),
        ("zero.json", with("ms_per_step", json!(0.0)), "row 0: ms_per_step = 0"),
        ("type.json", with("ms_per_step", json!("fast")), "row 0: invalid type"),
    ];
    for (name, text, problem) in &files {
        std::fs::write(at.join(name), text).unwrap();
        refuses(at, &["--compare", name, "--out", "unwritten"], &[name, problem, "allowed:"]);
    }
    let point = json!({"code": "jax-sph", "scene": "taylor-green", "dx": 0.1, "cfl": 1.0, "precision": "f64",
        "seconds": 1.0, "error": 0.1, "stable": true});
    for (key, value, problem) in [
        ("dx", json!(0.0), "point 0: dx = 0"),
        ("seconds", json!("long"), "point 0: invalid type"),
        ("precision", json!("f16"), "point 0: unknown variant `f16`"),
        ("error", json!(-1.0), "point 0: error = -1"),
        ("error", json!(null), "point 0: a stable run has an error"),
    ] {
        let mut point = point.clone();
        point[key] = value;
        std::fs::write(at.join("peers.json"), json!([point]).to_string()).unwrap();
        refuses(at, &["accuracy", "--peers", "peers.json", "--out", "unwritten"], &["--peers peers.json", problem]);
    }
    refuses(at, &["step", "--peers", "peers.json", "--out", "unwritten"], &["--peers", "accuracy"]);
    refuses(at, &["--compare", "nowhere.json", "--out", "unwritten"], &["--compare nowhere.json", "No such file"]);
    refuses(at, &["stepp", "--out", "unwritten"], &["`stepp`", "gradient", "accuracy"]);
    refuses(at, &["step", "mine.toml", "--out", "unwritten"], &["mine.toml"]);
    refuses(at, &["heated-channel", "heated-channel", "--out", "unwritten"], &["a second scene"]);
    refuses(at, &["gradient", "taylor-green", "--out", "unwritten"], &["taylor-green has no design", "heated-channel"]);
    refuses(
        at,
        &["step", "schaefer-turek-2", "--out", "unwritten"],
        &["method.name", "fixed particles", "method.name=consistent"],
    );
    refuses(at, &["--preset", "nothing", "--out", "unwritten"], &["nothing", "report"]);
    refuses(at, &["--set", "time.cfl=9", "--out", "unwritten"], &["time.cfl"]);
    refuses(at, &["--filter", "nothing", "--out", "unwritten"], &["--filter nothing", "group/scene/particles"]);
    refuses(at, &["--sizes", "7^2", "--out", "unwritten"], &["7^2", "N >= 8"]);
    refuses(at, &["--repeats", "0", "--out", "unwritten"], &["--repeats"]);
    refuses(at, &["--threads", "1,x", "--out", "unwritten"], &["--threads"]);
    refuses(at, &["--memory-limit", "0", "--out", "unwritten"], &["--memory-limit"]);
    std::fs::write(at.join("file"), "").unwrap();
    refuses(at, &["--out", "file"], &["--out file", "is a file"]);
}

fn point(dx: f64, cfl: f64, seconds: f64) -> ComparedRun {
    ComparedRun {
        code: "hydrograd".into(),
        scene: "s".into(),
        dx,
        cfl,
        precision: Precision::F64,
        particles: None,
        steps: None,
        threads: None,
        seconds,
        error: Some(1e-2),
        stable: true,
    }
}

#[test]
fn only_runs_that_none_beats_are_shown() {
    let point = |seconds, error, precision| ComparedRun { error: Some(error), precision, ..point(0.1, 1.0, seconds) };
    let (f64, f32) = (Precision::F64, Precision::F32);
    // 4 s for an error that takes 2 s, a run as slow as another with a larger error, and a separate run of another
    // type.
    let mut points = vec![
        point(4.0, 1e-2, f64),
        point(2.0, 1e-2, f64),
        point(9.0, 1e-3, f64),
        point(1.0, 0.1, f64),
        point(1.0, 0.2, f64),
        point(5.0, 0.5, f32),
    ];
    points.push(ComparedRun { stable: false, ..point(0.1, 1e-9, f64) });
    let found = fronts(points.iter());
    assert_eq!(found.len(), 2);
    assert_eq!(found[0], ("hydrograd f64".to_string(), vec![(1.0, 0.1), (2.0, 1e-2), (9.0, 1e-3)]));
    assert_eq!(found[1], ("hydrograd f32".to_string(), vec![(5.0, 0.5)]));
}

#[test]
fn sizes_are_a_side_and_a_dimension() {
    assert_eq!(Size::parse("100^2").map(Size::particles), Ok(10_000));
    assert_eq!(Size::parse("20^3").map(Size::particles), Ok(8_000));
    for bad in ["100", "7^2", "100^4", "100^1", "x^2", "100000^2", "^2", "9999999999^3"] {
        assert!(Size::parse(bad).is_err(), "{bad}");
    }
}

#[test]
fn as_many_pairs_as_all_against_all() {
    for (dimension, per_side) in [(2, 8), (2, 13), (3, 8)] {
        let (model, state) = taylor_green::<f64>(Size { per_side, dimension });
        let n = model.particles();
        let square = |i: usize, j: usize| -> f64 {
            let along = |d: usize| {
                let (dr, size) = (state[d * n + i] - state[d * n + j], model.domain.size[d]);
                dr - size * (dr / size).round()
            };
            (0..dimension).map(|d| along(d).powi(2)).sum()
        };
        let near = |i: usize, j: usize| j != i && square(i, j) < model.reach().cutoff.powi(2);
        let expected: usize = (0..n).map(|i| (0..n).filter(|&j| near(i, j)).count()).sum();
        assert_eq!(count_pairs(&Model::new(model), &state).unwrap(), expected);
    }
}

#[test]
fn median_of_even_and_odd_counts() {
    assert_eq!(median(&[3.0]), 3.0);
    assert_eq!(median(&[1.0, 2.0, 9.0]), 2.0);
    assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
}

#[test]
fn work_is_that_of_the_split_form() {
    let sizes =
        Sizes { node_features: 10, edge_features: 3, outputs: 2, latent: 128, rounds: 10, linears: 2, embedding: 16 };
    let (n, e, l, f) = (950.0, 24_690.0, 128.0, 26.0);
    let gflop = |training| {
        products(&sizes, 950, 24_690, training).iter().map(|(p, times)| 1e-9 * *times as f64 * p.operations()).sum()
    };
    let encoders = n * (f * l + l * l) + e * (3.0 * l + l * l);
    let rounds = 10.0 * (n * 5.0 * l * l + e * 2.0 * l * l);
    let forward = 2e-9 * (encoders + rounds + n * (l * l + 2.0 * l));
    let found: [f64; 2] = [gflop(false), gflop(true)];
    assert!((found[0] / forward - 1.0).abs() < 1e-12, "{found:?}");
    assert!((found[1] / (3.0 * forward - 2e-9 * e * 3.0 * l) - 1.0).abs() < 1e-12, "{found:?}");
}

#[test]
fn the_graph_has_the_neighbours_of_a_fluid() {
    let (metadata, trajectory) = flow(1);
    let domain = Domain { dimension: 2, size: metadata.size(), periodic: metadata.periodic() };
    let graph = |radius: f64| Graph::build(&Frame::of(&trajectory, 0).position, &domain, radius * metadata.dx).unwrap();
    let per_node = |radius: f64| graph(radius).edges() as f64 / Network::PARTICLES as f64;
    assert!((6.0..9.0).contains(&per_node(1.45)) && (25.0..30.0).contains(&per_node(3.0)));
}

#[test]
fn a_diverged_run_is_reported() {
    // Ten times beyond the limit of stability.
    let run = |sets: &[&str]| {
        let sets: Vec<String> = ["resolution.dx=0.1"].iter().chain(sets).map(|set| set.to_string()).collect();
        let config = Config::load(Some("taylor-green"), None, &sets).unwrap().config;
        Run { code: "ours".into(), config }.point::<f64>(Precision::F64).unwrap()
    };
    let end = format!("time.end={}", half_life(100.0));
    let point = run(&[&end, "method.name=standard", "time.cfl=4", "fluid.sound_speed_factor=1"]);
    assert!(!point.stable, "{point:?}");
    assert!(serde_json::to_string(&point).unwrap().contains("\"stable\":false"));
    let stable = run(&[&end]);
    assert!(stable.stable && stable.cfl <= 1.0 && stable.cfl > 0.98, "{stable:?}");
    assert!((stable.steps as f64 * stable.time_step - 0.8779).abs() < 1e-4);
}

#[test]
fn the_error_of_the_heated_channel_is_that_of_q() {
    let sets = ["time.end=0.3".to_string(), "objective.window=0.05".into()];
    let config = Config::load(None, None, &sets).unwrap().config;
    let point = Run { code: "ours".into(), config }.point::<f32>(Precision::F32).unwrap();
    // The state is far from steady: the outflow has just begun to warm up.
    assert!(point.stable && point.error.unwrap() > 0.1, "{point:?}");
    // Fluid and two rows of dummy particles in each wall; on the walls' surfaces vertices, hot points and no-flux
    // points.
    assert_eq!(point.particles, 50 * (10 + 4) + 100 + 26 + 24 + 50 + 50);
}
