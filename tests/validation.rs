//! `hydrograd validate`: what it runs, writes and says.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::validation::cases::{self, Level};

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
