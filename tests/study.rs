//! `hydrograd study`: the grid, what is trained and what is kept, the table; with a stand-in for training.

use assert_cmd::Command;
use hydrograd::cli::grid::{points, GridKey, GridPoint, PointOutcome, Study, Validation};
use hydrograd::error::BadInput;
use std::path::{Path, PathBuf};

fn grid(texts: &[&str]) -> Vec<GridKey> {
    texts.iter().map(|text| GridKey::parse(text).unwrap()).collect()
}

/// A study whose training is a shell script; `$out` is the point's folder there, `$all` the command line.
fn study(folder: &Path, script: &str) -> Study {
    let program = folder.join("train.sh");
    let text = format!(
        "#!/bin/sh\nall=\"$*\"\nwhile [ $# -gt 0 ]; do case $1 in --out) out=$2;; esac; shift; done\n{script}\n"
    );
    std::fs::write(&program, text).unwrap();
    Study {
        program: vec!["sh".into(), program.into()],
        data: folder.into(),
        steps: 100,
        sets: vec!["seed=3".into()],
        out: folder.join("out"),
        threads: 1,
    }
}

/// Writes what training does, and one line to `trained` beside the study.
const TRAINS: &str = "mkdir -p \"$out\"\n\
    echo \"$all\" >> \"$out/../../trained\"\n\
    echo step,seconds,mse_1,mse_5,mse_10,mse_20,sinkhorn,e_kin,temperature_mse > \"$out/validation.csv\"\n\
    echo 50,1.5,2e-6,2e-5,2e-4,2e-3,1e-6,1e-5, >> \"$out/validation.csv\"\n\
    echo 100,3,1e-6,3e-5,1e-4,1e-3,1e-6,1e-5, >> \"$out/validation.csv\"";

#[test]
fn grids_expand() {
    let all = points(&grid(&["noise=3e-5,3e-4", "model.latent=32,64,128"])).unwrap();
    assert_eq!(all.len(), 6);
    let pair = |noise: &str, latent: &str| {
        GridPoint(vec![("noise".into(), noise.into()), ("model.latent".into(), latent.into())])
    };
    assert_eq!(all[1], pair("3e-5", "64"));
    assert_eq!(all[5], pair("3e-4", "128"));
    assert_eq!(all[5].name(), "model.latent=128,noise=3e-4");
    // The same folder whatever the order of the keys: a grid can grow.
    assert_eq!(points(&grid(&["model.latent=128", "noise=3e-4"])).unwrap()[0].name(), all[5].name());
    assert_eq!(all[1].value("noise"), Some("3e-5"));

    for (text, part) in [
        ("noise", "no `=`"),
        ("noise=", "empty"),
        ("=3", "empty"),
        ("noise=1,,2", "empty"),
        ("noise=1,2,1", "1 is there twice"),
        ("noise=../x", "character `/`"),
    ] {
        let error = GridKey::parse(text).unwrap_err().to_string();
        for part in [part, &format!("--grid {text}"), "allowed:", "try:"] {
            assert!(error.contains(part), "no `{part}` in {error}");
        }
    }
    assert!(points(&[]).unwrap_err().to_string().contains("no grid"));
    assert!(points(&grid(&["a=1", "a=2"])).unwrap_err().to_string().contains("a is there twice"));
    let values = |key: &str| format!("{key}={}", (0..200).map(|k| k.to_string()).collect::<Vec<_>>().join(","));
    let many = grid(&[&values("a"), &values("b")]);
    assert!(points(&many).unwrap_err().to_string().contains("40000 points"));
}

#[cfg(unix)]
#[test]
fn points_are_trained_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut study = study(folder.path(), TRAINS);
    let all = points(&grid(&["noise=3e-5,3e-4"])).unwrap();
    assert_eq!(study.finished(&all[0]).unwrap(), None);
    let PointOutcome::Trained { seconds, validation } = study.train(&all[0]).unwrap() else { panic!("failed") };
    assert_eq!(seconds, 3.0);
    assert_eq!((validation.last("mse_20"), validation.best("mse_5")), (Some(1e-3), Some((2e-5, 50.0))));
    assert_eq!(validation.last("temperature_mse"), None);
    let trained = std::fs::read_to_string(folder.path().join("trained")).unwrap();
    let data = folder.path().display();
    let expected = format!(
        "train --data {data} --out {data}/out/noise=3e-5 --steps 100 --threads 1 --set seed=3 --set noise=3e-5\n"
    );
    assert_eq!(trained, expected);

    let Some(PointOutcome::Trained { validation: again, .. }) = study.finished(&all[0]).unwrap() else {
        panic!("lost")
    };
    assert_eq!(again, validation);
    assert_eq!(study.finished(&all[1]).unwrap(), None);
    // One that was killed on the way has files, but is not finished.
    let half = study.folder(&all[1]);
    std::fs::create_dir_all(&half).unwrap();
    std::fs::copy(study.folder(&all[0]).join("validation.csv"), half.join("validation.csv")).unwrap();
    assert_eq!(study.finished(&all[1]).unwrap(), None);

    std::fs::write(half.join("last.safetensors"), "").unwrap();
    study.train(&all[1]).unwrap();
    let trained = std::fs::read_to_string(folder.path().join("trained")).unwrap();
    assert!(
        trained.ends_with("out/noise=3e-4 --steps 100 --threads 1 --resume --set seed=3 --set noise=3e-4\n"),
        "{trained}"
    );
    assert!(study.finished(&all[1]).unwrap().is_some());

    // Points of another study are not taken for this one's.
    let refuses = |study: &Study, parts: &[&str]| {
        let error = study.finished(&all[0]).unwrap_err().to_string();
        for part in [parts, &["finished.json", "another --out"]].concat() {
            assert!(error.contains(part), "no `{part}` in {error}");
        }
    };
    study.steps = 200;
    refuses(&study, &["--steps 100, not 200"]);
    (study.steps, study.sets) = (100, vec!["seed=4".into()]);
    refuses(&study, &["--set seed=3, not seed=4"]);
    (study.sets, study.data) = (vec!["seed=3".into()], PathBuf::from("/"));
    refuses(&study, &["--data", "not /"]);
    study.data = folder.path().into();
    std::fs::remove_file(study.folder(&all[0]).join("validation.csv")).unwrap();
    refuses(&study, &["validation.csv"]);
}

#[cfg(unix)]
#[test]
fn training_that_fails() {
    let folder = tempfile::tempdir().unwrap();
    let point = &points(&grid(&["noise=1"])).unwrap()[0];
    let train = |script: &str| study(folder.path(), script).train(point);
    let failed = train("echo all well; echo 'error: the loss is not finite' >&2; exit 1").unwrap();
    assert_eq!(failed, PointOutcome::Failed("the loss is not finite".into()));
    let PointOutcome::Failed(text) = train("kill -9 $$").unwrap() else { panic!("not failed") };
    assert!(text.contains("signal"), "{text}");
    let PointOutcome::Failed(text) = train("true").unwrap() else { panic!("not failed") };
    assert!(text.contains("validation.csv"), "{text}");
    let study = study(folder.path(), "true");
    assert_eq!(study.finished(point).unwrap(), None, "what failed is tried again");
    // Bad input is that of all points.
    let error = train("echo 'error: no key `noise`' >&2; exit 2").unwrap_err();
    assert!(error.is::<BadInput>());
    assert_eq!(error.to_string(), "noise=1: no key `noise`");
    let missing = Study { program: vec![folder.path().join("nowhere").into()], ..study };
    assert!(missing.train(point).unwrap_err().to_string().contains("can not start"));
}

#[test]
fn broken_tables_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("validation.csv");
    assert!(Validation::read(folder.path()).is_err());
    std::fs::write(&path, "step,seconds\n1,2\n").unwrap();
    assert!(Validation::read(folder.path()).unwrap_err().to_string().contains("mse_1"));
    std::fs::write(&path, "step,seconds,mse_1\n1,2,NaN\n").unwrap();
    assert!(Validation::read(folder.path()).is_err());
}

/// The whole command, of points that were trained before.
#[cfg(unix)]
#[test]
fn the_command_makes_a_table_and_plots() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), TRAINS);
    let metadata = serde_json::json!({
        "dim": 2, "dx": 0.05, "dt": 0.001, "write_every": 100, "num_particles_max": 400,
        "periodic_boundary_conditions": [true, true], "bounds": [[0.0, 1.0], [0.0, 1.0]],
        "default_connectivity_radius": 0.0725,
        "vel_mean": [0.0, 0.0], "vel_std": [0.01, 0.01], "acc_mean": [0.0, 0.0], "acc_std": [0.001, 0.001],
    });
    std::fs::write(folder.path().join("metadata.json"), metadata.to_string()).unwrap();
    for point in points(&grid(&["noise=3e-5,3e-4", "model.kind=gns,egnn"])).unwrap() {
        assert!(matches!(study.train(&point).unwrap(), PointOutcome::Trained { .. }));
    }
    let run = |arguments: &[&str]| {
        let mut command = Command::cargo_bin("hydrograd").unwrap();
        command.current_dir(folder.path()).args(["study", "--data", ".", "--out", "out", "--set", "seed=3"]);
        command.args(arguments).output().unwrap()
    };
    let whole = ["--grid", "noise=3e-5,3e-4", "--grid", "model.kind=gns,egnn", "--steps", "100"];
    let output = run(&whole);
    let text = String::from_utf8_lossy(&output.stdout).to_string();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for part in ["4 points, 4 of them trained before", "noise", "egnn", "1.000e-3", "2.000e-5"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    let csv = std::fs::read_to_string(folder.path().join("out/study.csv")).unwrap();
    let mut lines = csv.lines();
    assert_eq!(
        lines.next(),
        Some("noise,model.kind,mse_1,mse_5,mse_10,mse_20,sinkhorn,e_kin,temperature_mse,best_mse_5,best_step,seconds")
    );
    assert!(lines.next().unwrap().starts_with("3e-5,gns,1e-6,3e-5,0.0001,0.001,1e-6,1e-5,,2e-5,50.0,"));
    assert_eq!(lines.count(), 3);
    // Bad values, wherever they stand, before the first training.
    for (more, part) in [
        (["--grid", "steps=10,20"], "--steps N"),
        (["--grid", "seed=1,2"], "seed is in the grid, too"),
        (["--grid", "model.heat=learned,cold"], "model.heat=cold"),
    ] {
        let output = run(&[&more[..], &["--steps", "10"]].concat());
        let text = String::from_utf8_lossy(&output.stderr).to_string();
        assert!(output.status.code() == Some(2) && text.contains(part), "no `{part}` in {text}");
    }
    // A key of words has no axis.
    for (name, there) in [
        ("final-noise.png", true),
        ("curves-noise.svg", true),
        ("curves-model.kind.png", true),
        ("final-model.kind.png", false),
    ] {
        assert_eq!(folder.path().join("out").join(name).exists(), there, "{name}");
    }

    // Another number of steps, other data, slips in the grid: refused before anything is trained.
    for (arguments, parts) in [
        (&["--grid", "noise=3e-5", "--grid", "model.kind=gns", "--steps", "9"][..], &["--steps 100, not 9"][..]),
        (&["--grid", "noise", "--steps", "9"], &["--grid noise", "allowed:", "try:"]),
        (&["--grid", "a=1", "--steps", "0"], &["--steps", "at least 1"]),
        (&["--steps", "5"], &["--grid"]),
    ] {
        let output = run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).to_string();
        assert_eq!(output.status.code(), Some(2), "{error}");
        parts.iter().for_each(|part| assert!(error.contains(part), "no `{part}` in {error}"));
    }
    let mut command = Command::cargo_bin("hydrograd").unwrap();
    command.current_dir(folder.path()).args(["study", "--data", "nowhere", "--grid", "a=1", "--steps", "5"]);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--data nowhere"));
    assert!(!folder.path().join("runs").exists());
}
