//! Pages of all other commands, with their tables, curves and pictures.

use super::designs::verification;
use super::folder::{column, percent, warnings, words, Columns, Folder};
use super::names::label;
use super::tables::Choice;
use super::{leads, series, tables};
use crate::report::page::{Cell, Chart, Fact, Page, Series, Table};
use crate::report::text::counted;
use crate::scene::record::Record;
use serde_json::{Map, Value};

/// Files with the figures of a command, and their titles.
const FIGURES: [(&str, &str); 8] = [
    ("summary.json", "Figures"),
    ("gradient_check.json", "Figures"),
    ("verification.json", "Checks"),
    ("evaluation.json", "Scores"),
    ("validation.json", "Cases"),
    ("stress.json", "Maps"),
    ("bench.json", "Rows"),
    ("accuracy.json", "Run time against error"),
];

pub fn page(folder: &Folder) -> Page {
    let mut page = Page::default();
    for (file, title) in FIGURES {
        match folder.value(file) {
            Some(Value::Object(map)) if file == "verification.json" => {
                page.tables.extend(of_checks(title, &Record(map)))
            }
            Some(Value::Object(map)) => {
                if file == "summary.json" {
                    page.warnings = warnings(&Record(map.clone()));
                }
                add_tables(&mut page, title, file, &map);
            }
            Some(Value::Array(rows)) => page.tables.extend(tables::of_chosen(title, file, &rows, columns_of(file))),
            _ => {}
        }
    }
    let mut history = folder.columns("history.csv");
    history.retain(|(name, _)| !["seconds", "learning_rate"].contains(&name.as_str()));
    // Losses and errors decrease by powers of ten.
    page.charts = tables::charts(&history, |name| is_positive(&history, name));
    let validation = folder.columns("validation.csv");
    if validation.first().is_some_and(|(name, _)| name == "step") {
        page.charts.extend(of_training(&validation));
    }
    if let Some((header, rows)) = folder.table("study.csv") {
        let settings = leads::settings(&header).iter().map(String::as_str);
        let best = header.iter().map(String::as_str).filter(|name| name.starts_with("best_"));
        let choice = Choice { first: settings.chain(best).collect(), dropped: vec![] };
        page.tables.push(tables::of_text("Points of the grid", &header, &rows, choice));
    }
    let of = |name: &str| vec![folder.path.join(name).join(format!("{name}.pvd"))];
    page.fields = series::fields(folder, &[("predicted", of("predicted")), ("true", of("true"))], spacing(folder));
    let drawn = !page.charts.is_empty();
    page.pictures = folder.pictures(|stem| !(drawn && ["history", "curves"].contains(&stem)));
    (page.lead, page.remark) = said(folder, &page);
    if folder.kind == "rollout" {
        // The warnings name damaged frames.
        (page.lead, page.charts) = leads::rollout(folder).unwrap_or((page.lead, page.charts));
    }
    let survives = folder.record("verification.json").number("gain_survives");
    page.facts.extend(survives.map(|gain| Fact::new("gain that survives", percent(gain))));
    page
}

/// For files with many columns, those that come first, and those that are left out.
fn columns_of(file: &str) -> Choice<'static> {
    let (first, dropped) = match file {
        "bench.json" => (
            "scene mode kind ms_per_step peak_memory_bytes particles threads precision steps ns_per_pair",
            "version instruction_set time_step dimension group pairs repeats ms_per_step_median ns_per_particle_step \
             predicted_memory_bytes gflop_per_step sgemm_gflops bytes_per_step peak_gflops gigabytes_per_second \
             roofline_ms_per_step",
        ),
        "validation.json" => ("case passed quantity error tolerance error_f32 order dx", "steps"),
        "accuracy.json" => ("code scene dx precision seconds error", ""),
        _ => ("", ""),
    };
    let names = |text: &'static str| text.split_whitespace().collect();
    Choice { first: names(first), dropped: names(dropped) }
}

/// The checks of a wall, as on the page of its search.
fn of_checks(title: &str, record: &Record) -> Option<Table> {
    let first = record.rows("verification")?.first()?.as_object()?;
    let symbol = first.keys().find_map(|key| key.strip_suffix("_reference")).unwrap_or("q").to_uppercase();
    verification(title, &symbol, record, false)
}

/// Adds the scalar figures of an object, and the lists of objects in it.
fn add_tables(page: &mut Page, title: &str, file: &str, map: &Map<String, Value>) {
    let single = tables::of_scalars(title, map);
    let mut lists = Vec::new();
    for (key, value) in map {
        let Some(all) = value.as_array().filter(|all| all.first().is_some_and(Value::is_object)) else { continue };
        let is_main = ["rows", "scores", "verification", "maps"].contains(&key.as_str());
        let name = if is_main { title.to_string() } else { words(key) };
        let rows = tables::of_chosen(&name, file, all, columns_of(file));
        lists.extend(rows.map(|table| if key == "scores" { turned(table) } else { table }));
    }
    match lists.is_empty() {
        true => page.tables.push(single),
        false => {
            page.tables.append(&mut lists);
            page.more.push(Table { title: "What was run".into(), ..single });
        }
    }
}

/// Transposes a table of few rows and many columns.
fn turned(table: Table) -> Table {
    let mut rows: Vec<Vec<Cell>> = table.header.iter().map(|name| vec![Cell::text(name)]).collect();
    for row in table.rows {
        row.into_iter().zip(&mut rows).for_each(|(cell, of)| of.push(cell));
    }
    let header = match rows.is_empty() {
        true => vec![],
        false => rows.remove(0).into_iter().map(|cell| cell.text).collect(),
    };
    Table { header, rows, ..table }
}

fn is_positive(columns: &Columns, name: &str) -> bool {
    column(columns, name).is_none_or(|values| values.iter().all(|value| value.is_nan() || *value > 0.0))
}

/// Errors on the validation split by step, with those of positions in one chart.
fn of_training(columns: &Columns) -> Vec<Chart> {
    let Some((_, step)) = columns.first() else { return vec![] };
    let is_position = |name: &str| name.strip_prefix("mse_").is_some_and(|n| n.parse::<usize>().is_ok());
    let series = |(name, values): &(String, Vec<f64>)| {
        Series::new(label(name), step.iter().copied().zip(values.iter().copied()))
    };
    let mut charts = Vec::new();
    let positions: Vec<Series> = columns.iter().filter(|(name, _)| is_position(name)).map(series).collect();
    if !positions.is_empty() {
        let chart = Chart::new("Position error on the validation split", "step", "MSE", positions);
        charts.push(Chart { log: true, ..chart });
    }
    let rest = columns.iter().filter(|(name, _)| !is_position(name) && name != "seconds").cloned().collect();
    charts.extend(tables::charts(&rest, |name| is_positive(&rest, name)));
    charts
}

/// Particle spacing of a data set; a guess if no file has it.
fn spacing(folder: &Folder) -> f64 {
    let config = folder.config();
    let dx = config.get("resolution").and_then(|of| of.get("dx")).and_then(toml::Value::as_float);
    dx.unwrap_or(0.02)
}

/// The result in one sentence, and a remark.
fn said(folder: &Folder, page: &Page) -> (String, String) {
    let none = String::new();
    let rows = |file: &str, key: &str| -> Vec<Value> {
        match folder.value(file) {
            Some(Value::Array(all)) => all,
            Some(Value::Object(map)) => map.get(key).and_then(Value::as_array).cloned().unwrap_or_default(),
            _ => vec![],
        }
    };
    match folder.kind.as_str() {
        "validate" => {
            let rows = rows("validation.json", "rows");
            let passed = rows.iter().filter(|row| row.get("passed") == Some(&Value::Bool(true))).count();
            let lead = match passed == rows.len() {
                true => format!("All {passed} rows pass, in double and in single precision."),
                false => format!("{} of {} rows fail.", rows.len() - passed, rows.len()),
            };
            (lead, "Scenes with a known answer, run and compared with it.".into())
        }
        "evaluate" => {
            let scores = rows("evaluation.json", "scores");
            let mse = |k: usize| leads::number(scores.get(k)?, "mse");
            let other = scores.get(1).and_then(|of| of.get("model")).and_then(Value::as_str).unwrap_or("the other");
            let Some(own) = mse(0) else { return ("Rollouts of a model against the truth.".into(), none) };
            let lead = format!("The position error of the model is {own:.2e} (MSE over all steps)");
            let rest = match mse(1) {
                Some(error) if own > 0.0 && own < error => {
                    format!("; that of {other}, {error:.2e}, is {:.1} times as large.", error / own)
                }
                Some(error) => format!(", not less than that of {other}, {error:.2e}."),
                None => ".".into(),
            };
            (lead + &rest, none)
        }
        "stress" => {
            let maps = rows("stress.json", "maps");
            let runs: Vec<&Value> = maps.iter().filter_map(|map| map.get("runs")?.as_array()).flatten().collect();
            let count = |name: &str| runs.iter().filter(|run| leads::text(&run["record"], "verdict") == name).count();
            let [stable, degraded, diverged] = ["stable", "degraded", "diverged"].map(count);
            let lead = format!("{} runs: {stable} stable, {degraded} degraded, {diverged} diverged.", runs.len());
            (lead, "Maps of where the solver holds.".into())
        }
        "train" => {
            let validation = folder.columns("validation.csv");
            let position = validation.iter().rev().find(|(name, _)| name.starts_with("mse_") && name != "mse_");
            let best = position.and_then(|(name, values)| {
                let best = values.iter().copied().filter(|v| v.is_finite()).reduce(f64::min)?;
                Some(format!("; the least {} on the validation split is {best:.2e}", label(name)))
            });
            let steps = folder.columns("history.csv").first().and_then(|(_, steps)| steps.last().copied());
            let steps = steps.map_or(none.clone(), |steps| format!(" {steps} steps"));
            (format!("Trained{steps}{}.", best.unwrap_or_default()), none)
        }
        "bench" => (
            leads::bench(&rows("bench.json", "")),
            "Times are of the best repeat; a gradient's include its forward run.".into(),
        ),
        "check-gradient" => {
            let found = folder.record("gradient_check.json");
            let number = |key: &str| found.number(key).unwrap_or(f64::NAN);
            if let Some(members) = found.number("members") {
                return (format!("Derivatives as the mean over {members} starts, and the error of this mean."), none);
            }
            let how =
                if found.0.get("passed") == Some(&Value::Bool(true)) { "agrees with" } else { "does NOT agree with" };
            let lead = format!(
                "The gradient {how} central differences: relative error {:.1e}, allowed {:.0e}.",
                number("worst_relative_error"),
                number("tolerance")
            );
            (lead, none)
        }
        "study" => match folder.table("study.csv") {
            Some((header, rows)) => (leads::study(&header, &rows), none),
            None => ("Trainings over a grid of settings, side by side.".into(), none),
        },
        "rollout" => ("A learned model's rollout beside the truth.".into(), none),
        "recover" => leads::recover(&folder.record("summary.json")),
        "calibrate" => leads::calibrate(&folder.record("summary.json"), &folder.columns("history.csv")),
        "verify" => leads::verify(&folder.record("verification.json")),
        kind => (
            format!(
                "What `hydrograd {kind}` left: {}, {}.",
                counted(page.tables.len(), "table"),
                counted(page.pictures.len(), "picture")
            ),
            none,
        ),
    }
}
