//! The pages of runs: what they say is what the files say, and they ask for nothing outside of themselves.

use crate::support::program::{hydrograd, refused, succeeds};
use base64::Engine;
use hydrograd::cli::page::names::{label, rounded, sized};
use hydrograd::dataset::{read_split, Metadata, Split};
use hydrograd::report::page::{
    link, short, Body, Cell, Chart, Column, Fields, File, Note, Page, RawFrame, RawPanel, Series, Table, Text,
    GENERATOR,
};
use hydrograd::report::text::counted;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use tempfile::TempDir;

const TINY: [&str; 8] =
    ["--set", "time.end=0.1", "--set", "objective.window=0.05", "--set", "output.frames=3", "--threads", "1"];

fn with<'a>(first: &[&'a str], then: &[&'a str]) -> Vec<&'a str> {
    [first, &TINY, then].concat()
}

fn optimize(at: &Path, out: &str, more: &[&str]) {
    succeeds(at, &with(&["optimize", "--epochs", "3", "--out", out], more));
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// A page, and that it is one that stands alone.
#[track_caller]
fn page(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.starts_with("<!doctype html>") && text.trim_end().ends_with("</html>"));
    for outside in
        ["http://", "https://", "//cdn", "@import", "<iframe", "<link rel=\"stylesheet\"", "fetch(", "XMLHttpRequest"]
    {
        assert!(!text.contains(outside), "{} has `{outside}`", path.display());
    }
    for source in text.split("src=\"").skip(1) {
        assert!(source.starts_with("data:image/"), "{}", &source[..40]);
    }
    // Links lead to files that are there.
    let folder = path.parent().unwrap();
    for target in text.split("href=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
        let file =
            target.replace("%3C", "<").replace("%3E", ">").replace("%20", " ").replace("%28", "(").replace("%29", ")");
        assert!(target == "data:," || folder.join(&file).exists(), "{}: a link to {target}", path.display());
    }
    assert!(text.len() < 5_000_000, "{} bytes", text.len());
    text
}

/// What the page's script draws.
#[track_caller]
fn drawn(page: &str) -> Value {
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// The numbers behind what stands in the text, bit for bit.
fn numbers(page: &str) -> BTreeSet<u64> {
    let values = page.split("<data value=\"").skip(1).filter_map(|rest| rest.split('"').next()?.parse::<f64>().ok());
    values.map(f64::to_bits).collect()
}

#[track_caller]
fn has_number(page: &str, value: &Value) {
    let value = value.as_f64().unwrap();
    assert!(numbers(page).contains(&value.to_bits()), "the page does not have {value:?}");
}

fn series(chart: &Value, k: usize) -> Vec<f64> {
    let points = chart["series"][k]["points"].as_array().unwrap();
    points.iter().map(|point| point[1].as_f64().unwrap()).collect()
}

fn floats(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

#[test]
fn optimize_shows_what_its_files_say() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "run", &[]);
    let text = page(&at.join("run/report.html"));
    let summary = json(&at.join("run/summary.json"));
    for key in ["q_first", "q", "gain_survives", "flow_rate", "u_max", "q_scene", "wall_seconds"] {
        has_number(&text, &summary[key]);
    }
    has_number(&text, &summary["before"]["flow_rate"]);
    for check in summary["verification"].as_array().unwrap() {
        has_number(&text, &check["gain"]);
        assert!(text.contains(check["check"].as_str().unwrap()));
    }
    let data = drawn(&text);
    assert_eq!(series(&data["charts"][0], 0), floats(&summary["q_per_epoch"]));
    assert_eq!(series(&data["charts"][1], 0), floats(&summary["gradient_norm_per_epoch"]));
    let walls = &data["walls"];
    assert_eq!(walls["best"], summary["best_epoch"]);
    let offsets = walls["sides"][0]["offsets"].as_array().unwrap();
    assert_eq!((offsets.len(), offsets[0].as_array().unwrap().len()), (3, floats(&summary["nodes"]).len()));
    assert_eq!(floats(&offsets[0]), floats(&summary["offsets_first"]));
    assert_eq!(floats(&offsets[2]), floats(&summary["offsets_last"]));
    let fields = &data["fields"];
    let names: Vec<&str> =
        fields["quantities"].as_array().unwrap().iter().map(|q| q["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["temperature", "speed", "pressure"]);
    let panels = fields["panels"].as_array().unwrap();
    assert_eq!((panels.len(), &panels[0]["title"], &panels[1]["title"]), (2, &"before".into(), &"after".into()));
    assert!(panels.iter().all(|panel| panel["frames"].as_array().unwrap().len() >= 4));
    // The walls differ, and so do the flows, at the end but not in what they begin with.
    let last = |k: usize| panels[k]["frames"].as_array().unwrap().last().unwrap()["position"].clone();
    assert_ne!(last(0), last(1));
    for part in
        ["one step:", "schedule", "[resolution]", "href=\"particles-before/particles.pvd\"", "href=\"summary.json\""]
    {
        assert!(text.contains(part), "no {part}");
    }
    // `verify` adds what it found.
    assert!(!text.contains("Checked again"));
    succeeds(at, &["verify", "run", "--threads", "1"]);
    assert!(page(&at.join("run/report.html")).contains("Checked again"));
    // Into a folder of its own: a page with the result, the wall and what it is measured against.
    succeeds(at, &["verify", "run", "--threads", "1", "--out", "checks"]);
    let (text, found) = (page(&at.join("checks/report.html")), json(&at.join("checks/verification.json")));
    has_number(&text, &found["gain_survives"]);
    let survives = format!("{:+.2}\u{a0}%", 100.0 * found["gain_survives"].as_f64().unwrap());
    let (_, lead) = text.split_once("<h1>").unwrap();
    let lead = lead.split("</h1>").next().unwrap();
    // So short a run is far from steady, and its gain may not be proved.
    let told = if found["proved"] == true { "surviv" } else { "is proved: less its error" };
    assert!(lead.contains("gain of run over the first design") && lead.contains(told), "{lead}");
    assert!(lead.contains(&survives), "{lead}");
    assert!(text.contains(">Q reference<") && !text.contains(">error<"), "{text}");
}

/// A small data set of the heated channel.
const DATA: [&str; 13] = [
    "generate",
    "heated-channel",
    "--trajectories",
    "3/1/1",
    "--frames",
    "30",
    "--every",
    "30",
    "--set",
    "resolution.dx=0.025",
    "--threads",
    "1",
    "--out",
];

#[test]
fn a_data_set_shows_what_it_holds() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let said = succeeds(at, &[&DATA[..], &["data"]].concat());
    assert!(said.contains("report.html"), "{said}");
    let text = page(&at.join("data/report.html"));
    assert!(text.len() < 2_000_000, "{} bytes", text.len());
    assert!(
        text.contains("5 trajectories of heated-channel, each of 30 frames with 480 particles: 3 to train with"),
        "{text}"
    );
    let metadata = json(&at.join("data/metadata.json"));
    for value in [&metadata["dx"], &metadata["dt"], &metadata["vel_mean"][0], &metadata["acc_std"][1]] {
        has_number(&text, value);
    }
    for key in ["temperature_mean", "change_std", "diffusivity", "target_x"] {
        has_number(&text, &metadata["heat"][key]);
    }
    for part in ["href=\"train.h5\"", "hydrograd train --data data", "hydrograd dataset inspect data", "[resolution]"] {
        assert!(text.contains(part), "no {part}");
    }
    // The trajectory and the walls are those of the files.
    let own = Metadata::read(&at.join("data")).unwrap();
    let trajectory = &read_split(&at.join("data"), &own, Split::Train).unwrap()[0];
    let data = drawn(&text);
    let fields = &data["fields"];
    let names: Vec<&str> =
        fields["quantities"].as_array().unwrap().iter().map(|q| q["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["temperature", "speed"]);
    let frames = fields["panels"][0]["frames"].as_array().unwrap();
    assert!(frames.len() == 21 && fields["panels"].as_array().unwrap().len() == 1);
    let apart = own.dt * own.write_every as f64;
    assert!((frames[20]["time"].as_f64().unwrap() - 29.0 * apart).abs() < 1e-9);
    let fluid = || (0..trajectory.particles).filter(|&i| trajectory.kind[i] == 0);
    let shown = (0..21).map(|k| (k * 29_usize).div_ceil(20));
    let warmest = shown.flat_map(|k| fluid().map(move |i| trajectory.temperature_of(k).unwrap()[i]));
    assert_eq!(fields["quantities"][0]["high"].as_f64().unwrap() as f32, warmest.fold(0.0, f32::max));
    let walls = &data["walls"];
    let offsets = walls["sides"][0]["offsets"].as_array().unwrap();
    assert_eq!(
        (offsets.len(), floats(&walls["nodes"]), floats(&offsets[0])),
        (5, trajectory.wall_x.clone(), trajectory.wall_offset.clone())
    );
    assert!(walls["names"][4].as_str().unwrap().starts_with("test 00000"), "{}", walls["names"]);
    assert!(text.contains("Wall by trajectory") && !text.contains("Wall by epoch"));
    // Whoever looks at it adds to it, and the same command again writes the page that is missing, as does `merge`.
    succeeds(at, &["dataset", "inspect", "data"]);
    assert!(page(&at.join("data/report.html")).contains("href=\"frames.svg\""));
    for again in [[&DATA[..], &["data"]].concat(), vec!["merge", "data"]] {
        std::fs::remove_file(at.join("data/report.html")).unwrap();
        succeeds(at, &again);
        page(&at.join("data/report.html"));
    }
}

#[test]
fn data_of_flows_have_no_walls_and_a_layer_of_three_dimensions() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let sizes = ["--trajectories", "1/1/1", "--frames", "3", "--every", "5", "--relax", "20", "--threads", "1"];
    let dx = ["--set", "resolution.dx=0.7853981633974483", "--out", "data"];
    succeeds(at, &[&["generate", "taylor-green-3d"], &sizes[..], &dx].concat());
    let text = page(&at.join("data/report.html"));
    let data = drawn(&text);
    assert!(data["walls"].is_null() && text.contains("The layer in the middle of z"), "{text}");
    assert!(text.contains("512 particles") && !text.contains("Kinds of walls"));
    assert_eq!(data["fields"]["quantities"].as_array().unwrap().len(), 1);
}

#[test]
fn a_page_does_without_what_is_damaged() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "run", &["--no-verify"]);
    succeeds(at, &["verify", "run", "--threads", "1"]);
    assert!(page(&at.join("run/report.html")).contains("Checked again"));
    std::fs::write(at.join("run/verification.json"), "{ \"verification\": [\u{1b}[2J").unwrap();
    let output = hydrograd(at, &["optimize", "--resume", "run", "--epochs", "4", "--no-verify"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{error}");
    assert_eq!(error.matches("warning: the page is without verification.json").count(), 1, "{error}");
    assert!(error.contains("try: hydrograd verify run") && !error.contains('\u{1b}'), "{error}");
    let text = page(&at.join("run/report.html"));
    assert!(!text.contains("Checked again") && text.contains("the page is without verification.json"));
    has_number(&text, &json(&at.join("run/summary.json"))["q"]);
    // Another one, among several runs, and a table; the rest is still compared.
    optimize(at, "other", &["--no-verify"]);
    std::fs::write(at.join("other/summary.json"), "[").unwrap();
    std::fs::write(at.join("other/history.csv"), [0xff, 0xfe]).unwrap();
    let output = hydrograd(at, &["compare", "run", "other", "--out", "both.html"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && error.matches("warning:").count() == 2, "{error}");
    let text = page(&at.join("both.html"));
    assert!(text.contains("without summary.json") && text.contains("without history.csv"));
    // What is damaged is written anew, and the page is whole again.
    succeeds(at, &["verify", "run", "--threads", "1"]);
    let text = page(&at.join("run/report.html"));
    assert!(text.contains("Checked again") && !text.contains("the page is without"));
}

#[test]
fn a_resumed_run_has_the_page_that_it_lacked() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "run", &["--no-verify"]);
    let before = drawn(&page(&at.join("run/report.html")));
    // As if it had been killed just before the page was written.
    std::fs::remove_file(at.join("run/report.html")).unwrap();
    std::fs::write(at.join("run/.hydrograd"), "optimize\n").unwrap();
    succeeds(at, &["optimize", "--no-verify", "--resume", "run"]);
    let after = drawn(&page(&at.join("run/report.html")));
    assert!(before["walls"] == after["walls"] && before["fields"] == after["fields"]);
}

#[test]
fn names_and_files_are_no_code() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let name = "<script>alert(1)<script>";
    std::fs::create_dir(at.join(name)).unwrap();
    std::fs::write(at.join(name).join("\"><script>alert(2)"), "mine").unwrap();
    succeeds(at, &with(&["simulate", "--out", name], &[]));
    let text = std::fs::read_to_string(at.join(name).join("report.html")).unwrap();
    assert!(!text.contains("<script>alert"));
    assert_eq!(text.matches("<script").count(), 2, "its own two");
    assert!(text.contains("&lt;script&gt;alert(1)&lt;script&gt;"));
}

#[test]
fn simulate_shows_its_course() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["simulate", "--out", "run"], &["--set", "design.shape=sine"]));
    let text = page(&at.join("run/report.html"));
    let summary = json(&at.join("run/summary.json"));
    for key in ["q", "flow_rate", "mean_outlet_temperature", "steps"] {
        has_number(&text, &summary[key]);
    }
    let data = drawn(&text);
    let titles: Vec<&str> = data["charts"].as_array().unwrap().iter().map(|c| c["title"].as_str().unwrap()).collect();
    assert_eq!(titles, ["Q by time", "Flow rate by time", "Wall"]);
    assert_eq!(series(&data["charts"][2], 0), floats(&summary["offsets"]));
    assert_eq!(data["fields"]["panels"][0]["frames"].as_array().unwrap().len(), 4);
    // Longer: the frames of both parts, one after the other.
    succeeds(at, &["simulate", "--resume", "run", "--set", "time.end=0.2"]);
    let longer = drawn(&page(&at.join("run/report.html")));
    let frames = longer["fields"]["panels"][0]["frames"].as_array().unwrap();
    let times: Vec<f64> = frames.iter().map(|frame| frame["time"].as_f64().unwrap()).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]) && times.len() > 4, "{times:?}");
    assert!((times[times.len() - 1] - 0.2).abs() < 0.01, "{times:?}");
    // A flow without heat or walls, and an exact answer.
    succeeds(
        at,
        &["simulate", "taylor-green", "--set", "time.end=0.05", "--set", "resolution.dx=0.05", "--out", "flow"],
    );
    let text = page(&at.join("flow/report.html"));
    has_number(&text, &json(&at.join("flow/summary.json"))["velocity_error"]);
    let data = drawn(&text);
    let energy = &data["charts"][0];
    assert_eq!((&energy["series"][0]["name"], &energy["series"][1]["name"]), (&"simulated".into(), &"exact".into()));
    let names = data["fields"]["quantities"].as_array().unwrap();
    assert!(names.len() == 2 && names[0]["name"] == "speed", "{names:?}");
}

#[test]
fn without_frames_the_pictures_are_drawn() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "run", &["--no-verify", "--set", "output.frames=0"]);
    let text = page(&at.join("run/report.html"));
    assert!(drawn(&text)["fields"].is_null() && text.matches("data:image/svg+xml").count() == 2);
    assert!(!at.join("run/particles-before").exists());
}

#[test]
fn runs_are_compared() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "a", &["--no-verify"]);
    optimize(at, "b", &["--no-verify", "--set", "design.shape=sine"]);
    succeeds(at, &with(&["simulate", "--out", "forward"], &[]));
    let text = succeeds(at, &["compare", "a", "b", "--out", "pages/both.html"]);
    assert!(text.contains("pages/both.html") && text.contains("Best of 2 searches"), "{text}");
    let text = page(&at.join("pages/both.html"));
    let data = drawn(&text);
    for (k, name) in ["a", "b"].iter().enumerate() {
        let summary = json(&at.join(name).join("summary.json"));
        has_number(&text, &summary["q"]);
        has_number(&text, &summary["q_first"]);
        assert_eq!(series(&data["charts"][0], k), floats(&summary["q_per_epoch"]));
        assert_eq!(series(&data["charts"][1], k), floats(&summary["offsets_best"]));
        assert!(text.contains(&format!("href=\"../{name}/report.html\"")));
    }
    let (_, differs) = text.split_once("What differs").unwrap();
    assert!(differs.contains("design.shape") && differs.contains("sine") && !differs.contains("resolution.dx"));
    // An earlier page is replaced, another file is not.
    succeeds(at, &["compare", "b", "a", "--out", "pages/both.html"]);
    std::fs::write(at.join("mine.html"), "<html>mine</html>").unwrap();
    std::fs::create_dir(at.join("empty")).unwrap();
    std::fs::create_dir(at.join("begun")).unwrap();
    std::fs::write(at.join("begun/.hydrograd"), "optimize\n").unwrap();
    for (arguments, expected) in [
        (vec!["a", "forward"], vec!["runs of different commands", "hydrograd simulate", "hydrograd optimize"]),
        (vec!["a", "empty"], vec!["empty", "holds no run"]),
        (vec!["a", "nowhere"], vec!["nowhere", "no such folder"]),
        (vec!["a", "begun"], vec!["begun", "not finished", "--resume begun"]),
        (vec!["a"], vec!["nothing to be compared with", "a/report.html"]),
        (vec!["a", "b", "--out", "mine.html"], vec!["--out mine.html", "file of something else"]),
        (vec!["a", "b", "--out", "pages"], vec!["--out pages", "folder"]),
    ] {
        let arguments = [&["compare"], &arguments[..]].concat();
        refused(&arguments, &hydrograd(at, &arguments), &expected);
    }
    assert!(!at.join("runs").exists(), "a refused comparison left something");
    assert_eq!(std::fs::read_to_string(at.join("mine.html")).unwrap(), "<html>mine</html>");
}

#[test]
fn runs_of_different_problems_are_not_ranked() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["simulate", "--out", "heated"], &["--set", "output.frames=0"]));
    let other =
        ["simulate", "isothermal-channel", "--out", "other", "--set", "time.end=0.02", "--set", "output.frames=0"];
    succeeds(at, &other);
    let text = succeeds(at, &["compare", "heated", "other", "--out", "page.html"]);
    assert!(text.contains("not to be ranked"), "{text}");
    let text = page(&at.join("page.html"));
    assert!(text.contains("Not the same in all of them: scene.") && !text.contains(" marked\""), "{text}");
}

#[test]
fn runs_that_hold_different_things_are_not_ranked() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    optimize(at, "force", &["--no-verify", "--set", "output.frames=0"]);
    optimize(at, "rate", &["--no-verify", "--set", "output.frames=0", "--set", "fluid.drive=flow-rate"]);
    let text = succeeds(at, &["compare", "force", "rate", "--out", "page.html"]);
    assert!(text.contains("not to be ranked") && !text.contains("Best of"), "{text}");
    let text = page(&at.join("page.html"));
    assert!(text.contains("Not the same in all of them: fluid.drive.") && !text.contains(" marked\""), "{text}");
    // How the flow is solved is no other problem.
    optimize(at, "slower", &["--no-verify", "--set", "output.frames=0", "--set", "fluid.reference_velocity=1.2"]);
    let text = succeeds(at, &["compare", "force", "slower", "--out", "page.html"]);
    assert!(text.contains("Best of 2 searches"), "{text}");
}

/// A folder as `evaluate` leaves it.
fn evaluated(at: &Path, name: &str, model: &str, data: &str, mse: f64) {
    std::fs::create_dir(at.join(name)).unwrap();
    std::fs::write(at.join(name).join(".hydrograd"), "evaluate\nfinished\n").unwrap();
    let score =
        |model: &str, mse: f64| serde_json::json!({ "model": model, "windows": 2, "mse_1": mse / 9.0, "mse": mse });
    let scores = serde_json::json!({
        "model": format!("{model}.safetensors"), "data": data, "split": "valid",
        "scores": [score(model, mse), score("linear", 0.5)],
    });
    std::fs::write(at.join(name).join("evaluation.json"), scores.to_string()).unwrap();
}

#[test]
fn models_are_compared_whatever_their_files_are_called() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    evaluated(at, "a", "best", "d/one", 2e-4);
    evaluated(at, "b", "model", "d/one", 1e-4);
    evaluated(at, "c", "model", "d/two", 1e-5);
    let text = succeeds(at, &["compare", "a", "b", "--out", "same.html"]);
    assert!(text.contains("that of b has the least position error: MSE 1.00e-4"), "{text}");
    let text = page(&at.join("same.html"));
    let (_, row) = text.split_once("model: position MSE over all steps").unwrap();
    let row = row.split("</tr>").next().unwrap();
    assert!(row.contains("value=\"0.0002\"") && row.contains("value=\"0.0001\""), "{row}");
    assert!(text.contains("linear: position MSE over 1 step") && !text.contains("config.toml"));
    let text = succeeds(at, &["compare", "a", "c", "--out", "other.html"]);
    assert!(text.contains("not to be ranked"), "{text}");
}

#[test]
fn starts_have_a_page_together_and_each() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &with(&["optimize", "--start", "all", "--epochs", "2", "--no-verify", "--out", "all"], &[]));
    let text = page(&at.join("all/report.html"));
    let data = drawn(&text);
    assert_eq!(data["charts"][0]["series"].as_array().unwrap().len(), 4);
    // All are measured against the flat wall; only the largest Q is marked.
    let summary = json(&at.join("all/summary.json"));
    let starts = ["flat", "linear", "random", "sine"].map(|name| summary[name]["q"].as_f64().unwrap());
    let best = starts.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let gain = best / summary["flat"]["q_first"].as_f64().unwrap() - 1.0;
    assert!(text.contains(&format!("{:+.2}\u{a0}% over the flat wall", 100.0 * gain)), "{gain}");
    has_number(&text, &gain.into());
    assert_eq!(text.matches(" marked\"").count(), 1);
    assert!(!text.contains("not checked"));
    for name in ["flat", "linear", "random", "sine"] {
        assert!(text.contains(&format!("href=\"{name}/report.html\"")));
        page(&at.join("all").join(name).join("report.html"));
    }
}

#[test]
fn keys_have_names() {
    for (key, expected) in [
        ("q", "outflowing heat Q"),
        ("mse_20", "position MSE over 20 steps"),
        ("best_mse_1", "least position MSE over 1 step"),
        ("no change: e_kin", "no change: kinetic energy, squared error"),
        ("before.flow_rate", "before: flow rate"),
        ("some_key", "some key"),
    ] {
        assert_eq!(label(key), expected);
    }
}

#[test]
fn numbers_have_few_digits() {
    for (value, expected) in
        [(0.2595789, "0.2596"), (77.014123, "77.01"), (12.0, "12"), (3.2e-7, "3.200e-7"), (12345.6, "12346")]
    {
        assert_eq!(rounded(Cell::number(value), 4).text, expected);
    }
    assert_eq!(sized("peak_memory_bytes", Cell::number(164904960.0)).text, "164.9 MB");
    assert_eq!((counted(1, "epoch"), counted(2, "epoch")), ("1 epoch".into(), "2 epochs".into()));
}

#[test]
fn numbers_are_short() {
    for (value, expected) in [
        (0.0, "0"),
        (13.0, "13"),
        (0.25, "0.25"),
        (123456.7, "123457"),
        (0.99999999, "1"),
        (0.023431234, "0.0234312"),
        (-1234.5678, "-1234.57"),
        (1.5e-9, "1.5000e-9"),
        (f64::NAN, "-"),
    ] {
        assert_eq!(short(value), expected);
    }
}

#[test]
fn columns_are_aligned_alike() {
    let mut table = Table::new("", ["name", "figure", "kind", "what", "nothing"]);
    for (figure, kind) in [(Cell::number(1.0), "a"), (Cell::number(2.0), "b"), (Cell::text("failed"), "")] {
        let long = Cell::text("a text of more than one line, if it has to be");
        table.rows.push(vec![Cell::text("row"), figure, Cell::text(kind), long, Cell::text("-")]);
    }
    let expected = [Column::Text, Column::Numbers, Column::Text, Column::Words, Column::Numbers];
    assert_eq!(table.found_columns(), expected);
}

#[test]
fn addresses_keep_their_meaning() {
    assert_eq!(link("a b/100%.csv"), "a%20b/100%25.csv");
    assert_eq!(link("<script>.toml"), "%3Cscript%3E.toml");
}

#[test]
fn text_stays_text() {
    let nasty = "<script>alert(1)</script>\"'";
    let page = Page {
        title: nasty.into(),
        lead: nasty.into(),
        tables: vec![Table { rows: vec![vec![Cell::text(nasty)]], ..Table::new(nasty, [nasty]) }],
        charts: vec![Chart { title: nasty.into(), series: vec![Series::new(nasty, [])], ..Chart::default() }],
        texts: vec![Text { title: nasty.into(), text: nasty.into() }],
        files: vec![File { name: nasty.into(), link: link(nasty), size: String::new(), what: nasty.into() }],
        ..Page::default()
    };
    for body in [Body::Run, Body::Compare] {
        let html = Page { body, ..page.clone() }.to_html().unwrap();
        assert!(!html.contains("<script>alert"), "{html}");
        // Its two own scripts: data and code.
        assert_eq!(html.matches("<script").count(), 2);
        assert!(html.contains("&lt;script&gt;alert(1)") && html.contains(GENERATOR));
    }
}

#[test]
fn what_a_file_says_is_shown_as_it_may_be() {
    let nasty = format!("a\u{1b}[2J\u{202e}b{}", "x".repeat(9000));
    let page = Page {
        title: nasty.clone(),
        warnings: vec![Note { problem: nasty.clone(), advice: nasty.clone() }],
        tables: vec![Table { rows: vec![vec![Cell::text(&nasty)]], ..Table::new(&nasty, [&nasty]) }],
        texts: vec![Text { title: "all".into(), text: format!("[a]\n\tb = 1\u{7}\n{nasty}") }],
        ..Page::default()
    };
    let html = page.to_html().unwrap();
    assert!(html.contains("a\\u{1b}[2J\\u{202e}bxxx"), "{html}");
    assert!(html.chars().all(|c| c == '\n' || !c.is_control()) && !html.contains('\u{202e}'));
    // A text is quoted whole, its lines up to a length that no configuration has; all else is cut.
    let longest = html.split(|c| c != 'x').map(str::len).filter(|&length| length > 1000).collect::<Vec<_>>();
    assert_eq!(longest.iter().filter(|&&length| length == 9000).count(), 1);
    assert!(longest.iter().all(|&length| length == 9000 || length < 2000) && longest.len() > 5, "{longest:?}");
    assert!(html.contains("[a]\n    b = 1\\u{7}\n"), "{html}");
}

#[test]
fn frames_of_particles_are_chosen_evenly() {
    assert_eq!(Fields::chosen(41, 1000, 2, 3), (0..=40).step_by(2).collect::<Vec<_>>());
    assert_eq!(Fields::chosen(3, 1000, 2, 3), [0, 1, 2]);
    assert_eq!(Fields::chosen(1, 1000, 1, 3), [0]);
    assert_eq!(Fields::chosen(0, 1000, 1, 3), [0; 0]);
    let few = Fields::chosen(41, 40_000, 2, 3);
    assert!(few.len() == 4 && few[0] == 0 && few[3] == 40, "{few:?}");
    assert!(Fields::chosen(41, 10_000_000, 2, 3).len() >= 2);
    assert_eq!(Fields::chosen_within(500_000, 41, 40_000, 1, 2), [0, 40]);
}

#[test]
fn particles_survive_to_a_share_of_their_range() {
    let frame = RawFrame {
        time: 0.5,
        position: vec![[0.0, 0.0], [1.0, 0.25], [2.0, 1.0]],
        tag: vec![0, 0, 1],
        values: vec![vec![1.0, 3.0, 99.0]],
    };
    let panels = vec![RawPanel { title: "after".into(), frames: vec![frame.clone(), frame] }];
    let fields = Fields::new(panels, &[("temperature", "K")], 0.1, String::new()).unwrap();
    // Walls have no share in the colours.
    assert_eq!((fields.quantities[0].low, fields.quantities[0].high), (1.0, 3.0));
    assert_eq!((fields.x, fields.y), ((-0.05, 2.05), (-0.05, 1.05)));
    let bytes = |text: &str| base64::engine::general_purpose::STANDARD.decode(text).unwrap();
    let frames = &fields.panels[0].frames;
    assert_eq!(bytes(&frames[0].values[0]), [0, 255, 255]);
    assert_eq!((bytes(&frames[0].tag), frames[1].tag.as_str()), (vec![0, 0, 1], ""));
    let position = bytes(&frames[1].position);
    let place = |k: usize| f64::from(u16::from_le_bytes([position[2 * k], position[2 * k + 1]])) / 65535.0;
    for (k, (expected, ends)) in [(1.0, fields.x), (0.25, fields.y)].into_iter().enumerate() {
        let found = ends.0 + place(2 + k) * (ends.1 - ends.0);
        assert!((found - expected).abs() < 2e-5, "{found} {expected}");
    }
}
