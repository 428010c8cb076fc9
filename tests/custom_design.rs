//! Designs of scenes of one's own: gradients by the numbers of shapes, moved particles against particles placed anew, wrong
//! variables, and the program as users run it.

use assert_cmd::Command;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::config::custom::{Fill, Kind, Part, ShapeEntry, ShapeNumber};
use hydrograd::config::scene::Config;
use hydrograd::design::shapes::{At, Dummy, On, Point, Shapes};
use hydrograd::design::Problem;
use hydrograd::particles::{tag, Domain};
use hydrograd::scene::Scene;
use std::path::Path;

fn load(text: &str) -> Result<Config, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mine.toml");
    std::fs::write(&file, format!("scene = \"custom\"\n{text}")).unwrap();
    let loaded = Config::load(file.to_str(), None, &[]).map_err(|error| error.to_string())?;
    // What a run writes down is what it was given.
    assert_eq!(toml::from_str::<Config>(&loaded.text).unwrap(), loaded.config);
    Ok(loaded.config)
}

fn problem(text: &str) -> Problem<f64> {
    let config = load(text).unwrap_or_else(|error| panic!("{error}"));
    Scene::problem(&config).unwrap().unwrap()
}

fn variable(number: &str, lower: f64, upper: f64) -> String {
    format!("[[variables]]\nnumber = \"shapes[0].{number}\"\nlower = {lower}\nupper = {upper}\n")
}

/// A warm obstacle in a short channel, so that everything is seen after a few steps. Particles are not exactly half a spacing from
/// a wall, where the shift's push begins and has no derivative.
fn channel(shape: &str, variables: &[String], kind: &str) -> String {
    format!(
        "[[shapes]]\n{shape}\ntemperature = 2.0\n{}[region]\nsize = [0.6, 0.4]\nacceleration = [0.6, 0.0]\n\
         [initial]\nvelocity = [\"9*y*(0.4 - y)\", 0]\ntemperature = \"1 + x\"\n[resolution]\ndx = 0.025\n\
         [fluid]\nviscosity = 0.02\nconductivity = 0.02\n[time]\nsteps = 12\njitter = 0.05\n\
         [objective]\nkind = \"{kind}\"\ntarget_x = 0.5\nwindow = 0.01\nsamples = 2\n[optimise]\ngradient = \"segments\"\n",
        variables.concat()
    )
}

/// Relative difference of the gradient and central differences along a direction in which every variable takes part.
fn gradient_error(problem: &Problem<f64>) -> f64 {
    let direction: Vec<f64> = (0..problem.first.len()).map(|k| 0.6 + 0.4 * ((k * k) as f64).cos()).collect();
    let schedule = Schedule::every_state(problem.steps, 0, false);
    let gradient = problem.differentiate(&problem.first, &schedule, &mut |_| ()).unwrap().by_variables;
    let along: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let value = |h: f64| {
        let at: Vec<f64> = problem.first.iter().zip(&direction).map(|(x, d)| x + h * d).collect();
        problem.evaluate(&at).unwrap()
    };
    [1e-4, 1e-5, 1e-6, 1e-7]
        .map(|h| ((value(h) - value(-h)) / (2.0 * h) / along - 1.0).abs())
        .into_iter()
        .fold(1.0, f64::min)
}

#[test]
fn gradients_are_those_of_differences() {
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.19]\nradius = 0.08";
    let of_disc =
        [variable("centre[0]", 0.2, 0.4), variable("centre[1]", 0.1, 0.3), variable("radius", 0.05, 0.1)].to_vec();
    let boxed = "kind = \"box\"\nlower = [0.22, 0.0]\nupper = [0.38, 0.1]";
    let of_box = [variable("upper[0]", 0.3, 0.45), variable("upper[1]", 0.05, 0.15)].to_vec();
    let line = "kind = \"polyline\"\npoints = [[0.2, 0.15], [0.4, 0.22]]\nthickness = 0.1";
    let of_line =
        [variable("points[0][1]", 0.1, 0.2), variable("points[1][1]", 0.15, 0.25), variable("thickness", 0.08, 0.12)];
    let polygon = "kind = \"polygon\"\npoints = [[0.15, -0.1], [0.45, -0.1], [0.4, 0.12], [0.25, 0.1]]";
    let of_polygon = [variable("points[2][1]", 0.05, 0.15), variable("points[3][0]", 0.2, 0.3)];
    for (shape, variables, kind) in [
        (disc, &of_disc, "heat-outflow"),
        (disc, &of_disc, "flow-rate"),
        (disc, &of_disc, "wall-heat"),
        (disc, &of_disc, "outlet-temperature"),
        (boxed, &of_box, "heat-outflow"),
        (line, &of_line.to_vec(), "heat-outflow"),
        (polygon, &of_polygon.to_vec(), "heat-outflow"),
    ] {
        let error = gradient_error(&problem(&channel(shape, variables, kind)));
        assert!(error < 1e-6, "{shape}, {kind}: {error:e}");
    }
    // With buoyancy, of a flow that it changes.
    let text = channel(disc, &of_disc, "heat-outflow");
    let still = problem(&text.replace("[0.6, 0.0]", "[0.6, -2.0]"));
    let lifted = text.replace("[0.6, 0.0]", "[0.6, -2.0]").replace("viscosity", "expansion = 3.0\nviscosity");
    let lifted = problem(&lifted);
    assert!((still.evaluate(&still.first).unwrap() / lifted.evaluate(&lifted.first).unwrap() - 1.0).abs() > 1e-4);
    let error = gradient_error(&lifted);
    assert!(error < 1e-7, "buoyancy: {error:e}");
}

#[test]
fn gradients_in_three_dimensions_are_those_of_differences() {
    let text = format!(
        "[[shapes]]\nkind = \"disc\"\ncentre = [0.4, 0.3, 0.4]\nradius = 0.15\n{}{}[region]\nsize = [0.8, 0.6, 0.8]\n\
         periodic = [true, false, true]\nacceleration = [0.6, 0.0, 0.0]\n[resolution]\ndx = 0.1\n[time]\nsteps = 8\njitter = 0.05\n\
         [objective]\ntarget_x = 0.6\nwindow = 0.0\n[optimise]\ngradient = \"segments\"\n",
        variable("centre[1]", 0.2, 0.4),
        variable("radius", 0.1, 0.2)
    );
    let error = gradient_error(&problem(&text));
    assert!(error < 1e-6, "{error:e}");
}

/// Particles that were moved stand on the surface that particles placed anew stand on, and a flow past them is the same.
#[test]
fn moved_shapes_are_shapes() {
    let of = |y: f64, radius: f64| {
        let disc = format!("kind = \"disc\"\ncentre = [0.6, {y}]\nradius = {radius}");
        let variables = [variable("centre[1]", 0.15, 0.25), variable("radius", 0.06, 0.1)];
        let text = channel(&disc, &variables, "flow-rate")
            .replace("dx = 0.025", "dx = 0.02")
            .replace("steps = 12", "end = 1.0");
        problem(&text.replace("size = [0.6, 0.4]", "size = [1.2, 0.4]").replace("window = 0.01", "window = 0.2"))
    };
    let (first, anew) = (of(0.2, 0.08), of(0.21, 0.09));
    // 0.21 and 0.09 are these shares of the ways.
    let variables = [0.6, 0.75];
    let start = first.start(&variables);
    let n = first.model.particles();
    let on_disc = (0..n).filter(|&i| {
        let tag = first.model.tags[i];
        let y = start.state[n + i];
        (tag == tag::SURFACE || tag == tag::HOT_SURFACE) && y > 0.05 && y < 0.35
    });
    let mut count = 0;
    for i in on_disc {
        let away = (start.state[i] - 0.6).hypot(start.state[n + i] - 0.21);
        assert!((away - 0.09).abs() < 1e-12, "{away}");
        count += 1;
    }
    assert!(count > 40, "{count} points");
    // No fluid in the disc, or nearer to it than it may begin.
    let nearest =
        (0..n).filter(|&i| first.model.is_fluid(i)).map(|i| (start.state[i] - 0.6).hypot(start.state[n + i] - 0.21));
    assert!(nearest.fold(1.0, f64::min) > 0.09 + 0.25 * 0.02);
    let (moved, placed) = (first.evaluate(&variables).unwrap(), anew.evaluate(&anew.first).unwrap());
    let before = first.evaluate(&first.first).unwrap();
    assert!(placed < 0.95 * before, "a thicker disc resists more: {before} {placed}");
    assert!((moved / placed - 1.0).abs() < 0.01, "{moved} {placed}");
}

#[test]
fn differences_of_runs_are_a_gradient() {
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.2]\nradius = 0.08";
    let text = channel(disc, &[variable("centre[1]", 0.1, 0.3), variable("radius", 0.08, 0.1)], "flow-rate");
    let exact = problem(&text);
    let differences = problem(&text.replace("segments\"", "differences\"\ndifference = 1e-3"));
    let schedule = Schedule::every_state(exact.steps, 0, false);
    let [exact, found] =
        [&exact, &differences].map(|one| one.differentiate(&one.first, &schedule, &mut |_| ()).unwrap());
    assert_eq!(exact.value, found.value);
    // At its lower limit the radius has a one-sided difference.
    assert!((exact.by_variables[1] / found.by_variables[1] - 1.0).abs() < 1e-2, "{exact:?} {found:?}");
    // One run as it is, two by the centre, one by the radius, which can not become smaller.
    assert!(found.solver_steps >= 4 * 12);
}

/// The ensemble's value and gradient are the means of its members', and its errors those of means.
#[test]
fn an_ensemble_averages_over_starts() {
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.19]\nradius = 0.08";
    let text = channel(disc, &[variable("centre[1]", 0.1, 0.3), variable("radius", 0.06, 0.1)], "flow-rate");
    let of = |gradient: &str, seed: u64| {
        let text = text.replace("\"segments\"", &format!("\"{gradient}\"\nmembers = 3"));
        let problem = problem(&format!("{text}[run]\nseed = {seed}\n"));
        problem.differentiate(&problem.first, &Schedule::taped(problem.steps), &mut |_| ()).unwrap()
    };
    let ensemble = of("ensemble", 5);
    let members = [0, 1, 2].map(|k| of("differences", 5 + (k << 32)));
    let mean = |values: [f64; 3]| values.iter().sum::<f64>() / 3.0;
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12 * b.abs(), "{a} {b}");
    close(ensemble.value, mean(members.each_ref().map(|one| one.value)));
    assert_eq!((ensemble.by_variables.len(), ensemble.errors.len()), (2, 2));
    for k in 0..2 {
        let slopes = members.each_ref().map(|one| one.by_variables[k]);
        close(ensemble.by_variables[k], mean(slopes));
        let squares: f64 = slopes.iter().map(|slope| (slope - mean(slopes)).powi(2)).sum();
        assert!(squares > 0.0, "the members are the same");
        close(ensemble.errors[k], (squares / 2.0 / 3.0).sqrt());
    }
    assert_eq!(ensemble.solver_steps, members.iter().map(|one| one.solver_steps).sum::<usize>());
    assert!(members[0].errors.is_empty());
}

#[test]
fn wrong_variables_are_one_clear_error() {
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.2]\nradius = 0.08";
    let with = |variables: &[String]| channel(disc, variables, "heat-outflow");
    let radius = || variable("radius", 0.06, 0.1);
    let good = with(&[radius()]);
    load(&good).unwrap();
    let cases = [
        (
            with(&[variable("height", 0.0, 1.0)]),
            &["variables[0].number", "no shape has such a number", "shapes[0].radius"][..],
        ),
        (with(&[variable("centre[2]", 0.0, 1.0)]), &["shapes[0].centre[2]", "shapes[0].centre[1]"]),
        (with(&[radius(), radius()]), &["variables[1].number", "for the second time"]),
        (with(&[variable("radius", 0.1, 0.06)]), &["variables[0].upper = 0.06 with lower = 0.1", "upper above lower"]),
        (with(&[variable("radius", 0.09, 0.1)]), &["is 0.08, outside of its limits", "0.09 ... 0.1"]),
        (with(&[variable("radius", -0.1, 0.1)]), &["may become -0.1, but shapes[0].radius"]),
        (
            good.replace("temperature = 2.0", "temperature = \"2 + x\""),
            &["values are formulas: 2 + x", "numbers, or none"],
        ),
        (good.replace("\"heat-outflow\"", "\"nothing\""), &["nothing", "flow-rate"]),
        (
            good.replace("temperature = \"1 + x\"\n", "").replace("temperature = 2.0\n", ""),
            &["about heat", "flow-rate"],
        ),
        (good.replace("target_x = 0.5", "target_x = 5.0"), &["objective.target_x = 5 is outside", "0 ... 0.6"]),
        (good.replace("\"segments\"", "\"steady\""), &["optimise.gradient = steady", "differences"]),
        (
            good.replace("\"segments\"", "\"ensemble\"").replace("jitter = 0.05", "jitter = 0.0"),
            &["optimise.gradient = ensemble with time.jitter = 0", "time.jitter=0.05"],
        ),
        (good.replace("\"segments\"", "\"ensemble\"\nmembers = 1"), &["optimise.members = 1", "2"]),
        (good.replace("[fluid]", "[method]\nname = \"standard\"\n[fluid]"), &["variables in the standard method"]),
        (format!("variables = 3\n{disc}"), &["variables", "mine.toml"]),
    ];
    for (text, parts) in cases {
        let error = load(&text).err().unwrap_or_else(|| panic!("accepted: {text}"));
        for part in parts {
            assert!(error.contains(part), "{text}\n{error}\nhas no `{part}`");
        }
    }
    // Of a run that nothing is optimised in, the window does not matter.
    let long = load(&good.replace("window = 0.01", "window = 10.0")).unwrap();
    let error = Scene::<f64>::problem(&long).unwrap_err().to_string();
    assert!(error.contains("objective.window = 10 is longer than the run"), "{error}");
}

fn hydrograd(folder: &Path, arguments: &[&str]) -> (bool, String) {
    let mut command = Command::cargo_bin("hydrograd").unwrap();
    let output = command.current_dir(folder).args(arguments).args(["--threads", "1"]).output().unwrap();
    let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    (output.status.success(), text)
}

/// The command that shows an ensemble's gradient: derivatives by the numbers themselves, over the scene's own time.
#[test]
fn check_gradient_shows_an_ensemble() {
    let folder = tempfile::tempdir().unwrap();
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.19]\nradius = 0.08";
    let text = channel(disc, &[variable("centre[1]", 0.1, 0.3), variable("radius", 0.06, 0.1)], "flow-rate")
        .replace("\"segments\"", "\"ensemble\"\nmembers = 3\nsearch = \"scene\"");
    std::fs::write(folder.path().join("mine.toml"), format!("scene = \"custom\"\n{text}")).unwrap();
    let (done, said) = hydrograd(folder.path(), &["check-gradient", "mine.toml", "--out", "a"]);
    assert!(done && said.contains("12 steps, V = ") && said.contains("the mean over 3 starts"), "{said}");
    let found: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("a/gradient_check.json")).unwrap()).unwrap();
    let problem = problem(&text);
    let expected = problem.differentiate(&problem.first, &Schedule::taped(12), &mut |_| ()).unwrap();
    for (k, width) in [0.2, 0.04].into_iter().enumerate() {
        for (key, of) in [("gradient", &expected.by_variables), ("gradient_error", &expected.errors)] {
            let by_number = problem.figure.factor * of[k] / width;
            assert!((found[key][k].as_f64().unwrap() / by_number - 1.0).abs() < 1e-9, "{key}: {found}");
        }
    }
    let page = std::fs::read_to_string(folder.path().join("a/report.html")).unwrap();
    assert!(page.contains("mean over 3 starts"));
}

/// A thinner obstacle lets more through: found, verified on particles placed anew, resumable, and its file runs.
#[test]
fn optimize_finds_a_better_shape() {
    let folder = tempfile::tempdir().unwrap();
    let disc = "kind = \"disc\"\ncentre = [0.3, 0.2]\nradius = 0.09";
    let text = channel(disc, &[variable("centre[1]", 0.18, 0.22), variable("radius", 0.06, 0.1)], "flow-rate");
    let text = text
        .replace("steps = 12", "end = 0.4")
        .replace("window = 0.01", "window = 0.1")
        .replace("\"segments\"", "\"differences\"\nsearch = \"scene\"");
    std::fs::write(folder.path().join("mine.toml"), format!("scene = \"custom\"\n{text}")).unwrap();
    let (done, text) =
        hydrograd(folder.path(), &["optimize", "mine.toml", "--epochs", "2", "--out", "a", "--no-verify"]);
    assert!(done, "{text}");
    let (done, text) = hydrograd(folder.path(), &["optimize", "--resume", "a", "--epochs", "4"]);
    assert!(
        done && text.contains("gain that survives: +") && text.contains("shapes[0].radius (0.06 ... 0.1)"),
        "{text}"
    );
    let (done, text) =
        hydrograd(folder.path(), &["optimize", "mine.toml", "--epochs", "4", "--out", "b", "--no-verify"]);
    assert!(done, "{text}");
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join(name).join("summary.json")).unwrap()).unwrap()
    };
    let (resumed, whole) = (read("a"), read("b"));
    assert_eq!(resumed["variables"], whole["variables"]);
    assert_eq!(resumed["v_per_epoch"], whole["v_per_epoch"]);
    assert!(whole["v"].as_f64().unwrap() > 1.02 * whole["v_first"].as_f64().unwrap());
    assert!(whole["variables"][1]["best"].as_f64().unwrap() < 0.08 && whole.get("wall_heat_flux").is_some());
    for file in ["best.toml", "history.png", "flow.png", "temperature.png", "state.h5", "particles/particles.pvd"] {
        assert!(folder.path().join("a").join(file).exists(), "{file}");
    }
    let (done, text) = hydrograd(folder.path(), &["simulate", "a/best.toml", "--set", "time.steps=3", "--out", "c"]);
    assert!(done, "{text}");
    // The first scene by itself has the objective that the search began with, and both say that the run is short.
    let (done, text) = hydrograd(folder.path(), &["simulate", "mine.toml", "--out", "d"]);
    assert!(
        done && text.contains("\nobjective  ") && text.contains("before the flow has crossed the box once"),
        "{text}"
    );
    assert_eq!(read("d")["objective"], whole["v_first"]);
    assert_eq!((&read("d")["flow_rate"], &read("d")["objective_kind"]), (&whole["v_first"], &"flow-rate".into()));
    let codes = |name: &str| -> Vec<String> {
        let all = read(name)["warnings"].as_array().unwrap().clone();
        all.iter().map(|warning| warning["code"].as_str().unwrap().to_string()).collect()
    };
    assert!(codes("b").contains(&"short-run".to_string()) && codes("d").contains(&"short-run".to_string()));
    // `verify` takes the folder of a search for numbers of shapes.
    let (done, text) = hydrograd(folder.path(), &["verify", "b"]);
    assert!(done && text.contains("as optimised") && text.contains("gain that survives: +"), "{text}");
    assert!(folder.path().join("b/verification.json").exists());
    // What a scene without variables, and what variables, do not have.
    std::fs::write(folder.path().join("none.toml"), "scene = \"custom\"\n").unwrap();
    let (done, text) = hydrograd(folder.path(), &["optimize", "none.toml"]);
    assert!(!done && text.contains("names no number of a shape that may change"), "{text}");
    for more in [&["--start", "sine"][..], &["--dynamics", "surrogate"]] {
        let (done, text) = hydrograd(folder.path(), &[&["optimize", "mine.toml"][..], more].concat());
        assert!(!done && text.contains("is not a key of scene custom"), "{more:?}: {text}");
    }
    for more in ["--compare", "--start=all"] {
        let (done, text) = hydrograd(folder.path(), &["optimize", "mine.toml", more, "--out", "unwritten"]);
        assert!(
            !done && text.contains("of a scene of one's own") && !folder.path().join("unwritten").exists(),
            "{text}"
        );
    }
}

/// A place so far away along a normal.
fn beyond(place: [f64; 3], distance: f64, normal: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| place[d] + distance * normal[d])
}

/// A shape of each kind.
fn shape_of(kind: Kind) -> ShapeEntry {
    let two = |x: f64, y: f64| Some(vec![x, y]);
    let points = || Some(vec![[0.2, 0.2], [0.7, 0.3], [0.4, 0.8]]);
    let entry = ShapeEntry { kind, fill: Fill::Wall, ..ShapeEntry::default() };
    match kind {
        Kind::Disc => ShapeEntry { centre: two(0.4, 0.5), radius: Some(0.2), ..entry },
        Kind::Box => ShapeEntry { lower: two(0.3, 0.2), upper: two(0.6, 0.7), ..entry },
        Kind::Polyline => ShapeEntry { points: points(), thickness: Some(0.1), ..entry },
        _ => ShapeEntry { points: points(), ..entry },
    }
}

/// A shape with a point, a dummy particle and some fluid, whose numbers are all variables; and its first state.
fn moving(kind: Kind, place: [f64; 2], normal: [f64; 2]) -> (Shapes, Vec<f64>) {
    let entry = shape_of(kind);
    let parts: Vec<Part> = match kind {
        Kind::Disc => vec![Part::Centre(0), Part::Centre(1), Part::Radius],
        Kind::Box => vec![Part::Lower(0), Part::Lower(1), Part::Upper(0), Part::Upper(1)],
        Kind::Polyline => (0..6).map(|k| Part::Point(k / 2, k % 2)).chain([Part::Thickness]).collect(),
        _ => (0..6).map(|k| Part::Point(k / 2, k % 2)).collect(),
    };
    let numbers = parts.into_iter().map(|part| ShapeNumber { shape: 0, part }).collect();
    let (place, normal) = ([place[0], place[1], 0.0], [normal[0], normal[1], 0.0]);
    let on = On::of(0, &entry, place, normal).unwrap();
    let point = |particle, on, leans| Point { particle, on, leans, leads: true };
    let domain = Domain { dimension: 2, size: [2.0; 3], periodic: [true, false, false] };
    let shapes = Shapes {
        entries: vec![entry],
        numbers,
        domain,
        vector: 2,
        points: vec![point(0, Some(on), true), point(1, None, false)],
        dummies: vec![Dummy { particle: 2, foot: on, depth: 0.03 }],
        fluid: vec![3, 4],
    };
    let mut state = vec![0.0; 20];
    let mut put = |i: usize, at: [f64; 3], vector: [f64; 3]| {
        for d in 0..2 {
            (state[d * 5 + i], state[(2 + d) * 5 + i]) = (at[d], vector[d]);
        }
    };
    put(0, place, normal);
    put(1, [1.5, 1.2, 0.0], [0.0; 3]);
    put(2, beyond(place, -0.03, normal), beyond(place, 0.03, normal));
    put(3, beyond(place, 0.1, normal), [0.3, 0.1, 0.0]);
    put(4, [1.2, 0.9, 0.0], [0.2, 0.4, 0.0]);
    (shapes, state)
}

/// Places on each kind of shape, with normals: on edges and sides, at a corner and at a round end.
fn places() -> Vec<(Kind, [f64; 2], [f64; 2])> {
    let edge = [0.5 / 0.26f64.sqrt(), 0.1 / 0.26f64.sqrt()];
    let below = [edge[1], -edge[0]];
    vec![
        (Kind::Disc, [0.4 + 0.2 * 0.6, 0.5 + 0.2 * 0.8], [0.6, 0.8]),
        (Kind::Box, [0.6, 0.45], [1.0, 0.0]),
        (Kind::Polygon, [0.45, 0.25], below),
        (Kind::Polygon, [0.2, 0.2], [-0.8, -0.6]),
        (Kind::Polyline, [0.45 + 0.05 * below[0], 0.25 + 0.05 * below[1]], below),
        (Kind::Polyline, [0.2 - 0.05 * 0.8, 0.2 - 0.05 * 0.6], [-0.8, -0.6]),
    ]
}

fn deformed(shapes: &Shapes, base: &[f64], changes: &[f64]) -> Vec<f64> {
    let mut state = base.to_vec();
    shapes.deform(5, changes, &mut state);
    state
}

#[test]
fn what_is_moved_stays_on_its_shape() {
    for (kind, place, normal) in places() {
        let (shapes, base) = moving(kind, place, normal);
        assert_eq!(deformed(&shapes, &base, &vec![0.0; shapes.numbers.len()]), base);
        let changes: Vec<f64> = (0..shapes.numbers.len()).map(|k| 0.02 * ((k * k + 1) as f64).sin()).collect();
        let state = deformed(&shapes, &base, &changes);
        let at = |i: usize, row: usize| [state[row * 5 + i], state[(row + 1) * 5 + i], 0.0];
        // The place on the changed shape is the same, and the opposite changes lead back from there.
        let entries = shapes.changed(&changes);
        let (found, before) = (On::of(0, &entries[0], at(0, 0), at(0, 2)).unwrap(), shapes.points[0].on.unwrap());
        let back = Shapes {
            entries: entries.clone(),
            points: vec![Point { on: Some(found), ..shapes.points[0] }, shapes.points[1]],
            ..shapes.clone()
        };
        let returned = deformed(&back, &state, &changes.iter().map(|change| -change).collect::<Vec<f64>>());
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!([0, 5, 10, 15].iter().all(|&at| close(returned[at], base[at])), "{kind:?}");
        match (found.at, before.at) {
            (At::Round(a), At::Round(b)) | (At::Box(a), At::Box(b)) => {
                assert!((0..2).all(|d| close(a[d], b[d])), "{a:?} {b:?}")
            }
            (At::Edge { to, share, away, faces }, At::Edge { to: to_b, share: b, away: away_b, faces: faces_b }) => {
                assert!(to == to_b && close(share, b) && faces == faces_b);
                assert!(kind == Kind::Polygon || away == away_b);
            }
            (At::Corner(a, u), At::Corner(b, v)) => {
                assert!(a == b && (kind == Kind::Polygon || (0..2).all(|d| close(u[d], v[d]))))
            }
            other => panic!("{other:?}"),
        }
        // The dummy particle keeps its depth, and its mirror image the same distance in front, along the normal.
        let (dummy, mirror) = (at(2, 0), at(2, 2));
        let middle: [f64; 2] = std::array::from_fn(|d| 0.5 * (dummy[d] + mirror[d]));
        assert!((0..2).all(|d| close(middle[d], at(0, 0)[d])));
        let across: [f64; 2] = std::array::from_fn(|d| 0.5 / 0.03 * (mirror[d] - dummy[d]));
        assert!(close(across[0].hypot(across[1]), 1.0) && (0..2).all(|d| close(across[d], at(0, 2)[d])), "{kind:?}");
        // Near fluid moves more than distant fluid, and the wall at rest stays.
        let step = |i: usize| (state[i] - base[i]).hypot(state[5 + i] - base[5 + i]);
        assert!(step(1) == 0.0 && step(3) > 5.0 * step(4), "{} {}", step(3), step(4));
    }
}

#[test]
fn the_adjoint_of_moved_shapes_is_the_derivative() {
    for (kind, place, normal) in places() {
        let (shapes, base) = moving(kind, place, normal);
        let count = shapes.numbers.len();
        let changes: Vec<f64> = (0..count).map(|k| 0.02 * ((k * k + 2) as f64).cos()).collect();
        let bar: Vec<f64> = (0..20).map(|k| ((3 * k + 1) as f64).sin()).collect();
        let mut found = vec![0.0; count];
        shapes.pull_back(5, &base, &changes, &bar, &mut found);
        for k in 0..count {
            let value = |h: f64| -> f64 {
                let mut changes = changes.clone();
                changes[k] += h;
                deformed(&shapes, &base, &changes).iter().zip(&bar).map(|(x, bar)| x * bar).sum()
            };
            let difference = (value(1e-5) - value(-1e-5)) / 2e-5;
            assert!((found[k] - difference).abs() < 1e-8, "{kind:?}, {k}: {} {difference}", found[k]);
        }
    }
}
