//! `hydrograd validate`: what it runs, writes and says.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::Config;
use hydrograd::scene::Scene;
use hydrograd::validation::cases::{self, Level};
use hydrograd::validation::probe;
use hydrograd::validation::reference::{
    between, heated_channel, heated_channel_outflow, lid_driven_cavity, taylor_green_3d,
};

#[test]
fn a_case_is_run_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeeds(at, &["validate", "--quick", "--filter", "reverse-poiseuille", "--out", "out", "--threads", "1"]);
    for file in ["validation.csv", "validation.json", "reverse-poiseuille.png", "reverse-poiseuille.svg", "errors.png"]
    {
        assert!(at.join("out").join(file).is_file(), "{file}");
    }
    let text = std::fs::read_to_string(at.join("out/validation.json")).unwrap();
    let found: serde_json::Value = serde_json::from_str(&text).unwrap();
    for row in found["rows"].as_array().unwrap() {
        let number = |key: &str| row[key].as_f64().unwrap();
        assert!(row["passed"] == true && number("error") > 0.0 && number("error") <= number("tolerance"), "{row}");
        // Double and single precision are two runs.
        assert!(number("error") != number("error_f32") && number("seconds") > 0.0, "{row}");
    }
    let lines = std::fs::read_to_string(at.join("out/validation.csv")).unwrap();
    assert!(lines.starts_with("case,quantity,reference,dx,") && lines.lines().count() == 2, "{lines}");
}

#[test]
fn cases_are_listed_and_others_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = hydrograd(folder.path(), &["validate", "--list"]);
    let text = String::from_utf8(output.stdout).unwrap();
    for case in cases::all() {
        assert!(text.contains(case.name) && text.contains(case.reference), "{}", case.name);
    }
    let nothing = ["validate", "--filter", "tokamak"];
    refused(&nothing, &hydrograd(folder.path(), &nothing), &["--filter tokamak", "taylor-green", "lid-driven-cavity"]);
    assert!(!folder.path().join("runs").exists());
}

/// A tolerance that nothing meets, and a run that diverges: rows that fail and say why.
#[test]
fn what_is_wrong_fails() {
    let mut case = cases::all().into_iter().find(|case| case.name == "taylor-green").unwrap();
    let coarse = Level { settings: &["resolution.dx=0.1", "time.end=0.05"], tolerance: 1e-9, is_quick: true };
    let wild = ["resolution.dx=0.1", "time.end=0.5", "time.cfl=4", "time.diffusion_number=1", "flow.reynolds=10"];
    let diverging = Level { settings: Box::leak(Box::new(wild)), tolerance: 1.0, is_quick: true };
    case.settings = &[];
    case.levels = vec![coarse, diverging];
    let mut shares = vec![];
    let found = case.run(true, &mut |share| shares.push(share)).unwrap();
    let [one, two] = &found.rows[..] else { panic!("{:?}", found.rows) };
    assert!(!one.passed && one.error.unwrap() > 1e-9 && one.failure.is_none(), "{one:?}");
    assert!(!two.passed && two.error.is_none() && two.failure.is_some() && two.order.is_none(), "{two:?}");
    assert!(shares.windows(2).all(|pair| pair[0] <= pair[1]) && *shares.last().unwrap() <= 1.0);
}

#[test]
fn every_case_is_a_configuration_and_has_a_quick_run_unless_it_is_long() {
    for case in cases::all() {
        assert!(!case.levels.is_empty(), "{}", case.name);
        for level in &case.levels {
            let settings: Vec<String> =
                [case.settings, level.settings].concat().iter().map(|s| s.to_string()).collect();
            Config::load(Some(case.scene), None, &settings).unwrap_or_else(|e| panic!("{}: {e}", case.name));
            assert!(level.tolerance > 0.0);
        }
    }
    let mut names: Vec<_> = cases::all().iter().map(|case| case.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), cases::all().len());
}

#[test]
fn a_quadratic_flow_is_found_anywhere() {
    let loaded = Config::load(Some("taylor-green"), None, &["resolution.dx=0.05".into()]).unwrap();
    let scene = Scene::<f64>::from_config(&loaded.config).unwrap();
    let (model, mut state) = (&scene.model, scene.start.state.clone());
    let n = model.particles();
    let flow = |x: f64, y: f64| [1.0 + x - 2.0 * x * y + y * y, 0.5 * x * x - y];
    for i in 0..n {
        let u = flow(state[i], state[n + i]);
        (0..2).for_each(|d| state[(model.rows.velocity() + d) * n + i] = u[d]);
    }
    for [x, y] in [[0.5, 0.5], [0.313, 0.671], [0.7, 0.25]] {
        let found = probe::velocity(model, &state, [x, y, 0.0]).unwrap();
        let exact = flow(x, y);
        assert!((0..2).all(|d| (found[d] - exact[d]).abs() < 1e-10) && found[2] == 0.0, "{found:?} for {exact:?}");
    }
    // Nobody is around.
    let shifted: Vec<f64> = state.iter().enumerate().map(|(k, x)| if k < n { 0.1 * x } else { *x }).collect();
    assert_eq!(probe::velocity(model, &shifted, [0.5, 0.5, 0.0]), None);
}

#[test]
fn a_quadratic_flow_is_found_in_three_dimensions() {
    let loaded = Config::load(Some("lid-driven-cavity-3d"), None, &["resolution.dx=0.125".into()]).unwrap();
    let scene = Scene::<f64>::from_config(&loaded.config).unwrap();
    let (model, mut state) = (&scene.model, scene.start.state.clone());
    let n = model.particles();
    let flow = |x: f64, y: f64, z: f64| [1.0 - 2.0 * x * z + y * y, z * z - y, x * y + 0.5 * z];
    for i in 0..n {
        let u = flow(state[i], state[n + i], state[2 * n + i]);
        (0..3).for_each(|d| state[(model.rows.velocity() + d) * n + i] = u[d]);
    }
    for [x, y, z] in [[0.9, 0.8, 0.9], [1.0, 0.6, 0.7]] {
        let found = probe::velocity(model, &state, [x, y, z]).unwrap();
        let exact = flow(x, y, z);
        assert!((0..3).all(|d| (found[d] - exact[d]).abs() < 1e-9), "{found:?} for {exact:?}");
    }
}

#[test]
fn references_are_read() {
    let energy = taylor_green_3d().column("kinetic_energy");
    // A quarter of the square of the amplitude, halved; and falling.
    assert!((energy[0] - 0.125).abs() < 1e-12 && energy.windows(2).all(|pair| pair[1] < pair[0]));
    let (s, u, v) = {
        let table = lid_driven_cavity();
        (table.column("s"), table.column("u"), table.column("v"))
    };
    assert!((between(&s, &u, 1.0) - 1.0).abs() < 1e-12 && v[0].abs() < 1e-3);
    // No fluid is made or lost across a line.
    let mean: f64 = u.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]) / 128.0).sum();
    assert!(mean.abs() < 1e-3, "{mean}");
    let channel = heated_channel();
    assert_eq!(
        (channel.texts("shape")[0], channel.column("Q")[0], channel.column("o24").len()),
        ("flat", 0.0234764, 51)
    );
    // The sharper reference has all of these walls, and is nowhere farther off than what the first one claims.
    let (names, amplitudes, q) = (channel.texts("shape"), channel.column("A"), channel.column("Q"));
    for k in 0..names.len() {
        let sharp = heated_channel_outflow(names[k], amplitudes[k]).unwrap();
        assert!((q[k] / sharp - 1.0).abs() < 1.5e-3, "{} {}", names[k], amplitudes[k]);
    }
    assert!(channel.column("none").is_empty());
}
