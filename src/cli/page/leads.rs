//! The result of a run in one sentence, for commands whose figures need to be searched.

use super::folder::{column, Columns, Folder};
use super::names::label;
use super::series;
use crate::io::vtk::{read_frame, read_list, ParticleFile};
use crate::particles::tag::FLUID;
use crate::report::page::{short, Chart, Series};
use crate::report::text::counted;
use crate::scene::record::Record;
use serde_json::Value;

pub fn number(row: &Value, key: &str) -> Option<f64> {
    row.get(key).and_then(Value::as_f64)
}

pub fn text<'a>(row: &'a Value, key: &str) -> &'a str {
    row.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// A number with the digits that a sentence needs.
fn about(value: f64) -> String {
    short(format!("{value:.2e}").parse().unwrap_or(value))
}

/// Milliseconds per step, without and with a gradient.
pub fn bench(rows: &[Value]) -> String {
    let plain = format!("{} measured.", counted(rows.len(), "row"));
    let is = |row: &&Value, kind: &str| text(row, "kind") == kind;
    let Some(first) = rows.iter().find(|row| is(row, "forward")) else { return plain };
    let Some(ms) = number(first, "ms_per_step") else { return plain };
    let same = |row: &&Value| {
        ["scene", "particles", "threads", "precision"].iter().all(|key| row.get(*key) == first.get(*key))
    };
    let others =
        rows.iter().filter(same).filter(|row| is(row, "gradient") && !text(row, "mode").starts_with("truncated"));
    let gradient = others.filter_map(|row| number(row, "ms_per_step")).reduce(f64::min);
    let count = |what: &str| counted(number(first, &format!("{what}s")).unwrap_or(0.0) as usize, what);
    let (scene, particles, threads, ms) = (text(first, "scene"), count("particle"), count("thread"), about(ms));
    let gradient = gradient.map_or(String::new(), |ms| format!(", one with its exact gradient {}\u{a0}ms", about(ms)));
    format!("A step of {scene} with {particles} on {threads} takes {ms}\u{a0}ms{gradient}.")
}

/// The best point of a grid.
pub fn study(header: &[String], rows: &[Vec<String>]) -> String {
    let plain = format!("{} of a grid of settings, side by side.", counted(rows.len(), "training"));
    let Some(best) = header.iter().position(|name| name.starts_with("best_mse")) else { return plain };
    let value = |row: &Vec<String>| row.get(best).and_then(|text| text.parse::<f64>().ok()).filter(|x| x.is_finite());
    let found = rows.iter().filter_map(|row| Some((row, value(row)?))).min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((row, least)) = found else { return plain };
    let settings = settings(header).iter().zip(row).map(|(name, value)| format!("{name} = {value}"));
    format!(
        "Of {} that with {} does best: {least:.2e} on the validation split ({}).",
        counted(rows.len(), "training"),
        settings.collect::<Vec<_>>().join(", "),
        label(&header[best])
    )
}

/// The columns of a study that precede those of its results.
pub fn settings(header: &[String]) -> &[String] {
    let count = header.iter().position(|name| name.starts_with("mse")).unwrap_or(0);
    &header[..count]
}

/// The result of a search for the initial state.
pub fn recover(found: &Record) -> (String, String) {
    let number = |key: &str| found.number(key);
    let what = found.text("unknown").unwrap_or("start");
    let errors = [("velocity_error", "velocity_error_before"), ("temperature_error", "temperature_error_before")];
    let error = errors.into_iter().find_map(|(now, before)| Some((number(now)?, number(before)?)));
    let lead = match error {
        Some((now, before)) => {
            let (now, before) = (about(now), about(before));
            let epochs = counted(number("epochs").unwrap_or(0.0) as usize, "epoch");
            format!("The {what} at the start were found with a relative error of {now} ({before} before) in {epochs}.")
        }
        None => format!("What a flow began with, its {what}, found from where its particles are later."),
    };
    let remark = match (number("distance_before"), number("distance")) {
        (Some(before), Some(now)) => {
            let (now, before) = (about(now), about(before));
            format!("Its particles end {now} from where they were seen, {before} before: in units of the scene.")
        }
        _ => String::new(),
    };
    (lead, remark)
}

/// The error of each parameter, and whether the search has converged.
pub fn calibrate(found: &Record, history: &Columns) -> (String, String) {
    let parameters: Vec<String> = found
        .0
        .iter()
        .filter_map(|(key, of)| {
            let (name, value) = (key.rsplit('.').next()?, number(of, "found")?);
            let error =
                number(of, "error").map_or(String::new(), |error| format!(" ({:+.2}\u{a0}% off)", 100.0 * error));
            Some(format!("{name} {}{error}", about(value)))
        })
        .collect();
    let lead = match parameters.is_empty() {
        true => "Viscosity and conductivity, found from a trajectory.".into(),
        false => format!("Found: {}.", parameters.join(", ")),
    };
    let losses = column(history, "loss").unwrap_or_default();
    let remark = match losses {
        [.., before, last] if *before > 0.0 => {
            let fell = 1.0 - last / before;
            let epochs = counted(losses.len(), "epoch");
            match fell > 1e-3 {
                true => format!(
                    "Not converged: in the last of {epochs} the loss still fell, by {}\u{a0}%; more epochs may come nearer.",
                    about(100.0 * fell)
                ),
                false => format!("Converged: the last of {epochs} changed the loss by less than 0.1\u{a0}%."),
            }
        }
        _ => "One epoch alone does not say whether it converged.".into(),
    };
    (lead, remark)
}

/// The result of the checks of a wall.
pub fn verify(found: &Record) -> (String, String) {
    let checks = found.rows("verification").map_or(0, Vec::len);
    let wall = found.text("wall").unwrap_or("the wall");
    let reference = found.text("verification_reference").unwrap_or("its reference");
    let lead = match found.number("gain_survives") {
        Some(gain) if gain > 0.0 => {
            format!("The gain of {wall} over {reference} holds: {:+.2}\u{a0}% survives its error.", 100.0 * gain)
        }
        Some(gain) => {
            format!("No gain of {wall} over {reference} is proved: less its error it is {:+.2}\u{a0}%.", 100.0 * gain)
        }
        None => format!("The error of the gain of {wall} is not known."),
    };
    (lead, format!("By {}, each with one thing changed.", counted(checks, "check")))
}

/// The errors of a rollout by step, from its frames: of positions and of temperatures.
pub fn rollout(folder: &Folder) -> anyhow::Result<(String, Vec<Chart>)> {
    let none = "A learned model's rollout beside the truth.".to_string();
    let list = |name: &str| folder.path.join(name).join(format!("{name}.pvd"));
    if !(list("predicted").is_file() && list("true").is_file()) {
        return Ok((none, vec![]));
    }
    let read = |name: &str| -> anyhow::Result<Vec<(f64, ParticleFile)>> {
        read_list(&list(name))?.into_iter().map(|(time, path)| Ok((time, read_frame(&path)?))).collect()
    };
    let (predicted, truth) = (read("predicted")?, read("true")?);
    let period = [&predicted, &truth].map(|frames| series::period(frames));
    let period = std::array::from_fn(|d| period[0][d].or(period[1][d]));
    let (mut positions, mut temperatures) = (Vec::new(), Vec::new());
    for (k, ((_, p), (_, t))) in predicted.iter().zip(&truth).enumerate() {
        let step = (k + 1) as f64;
        let fluid: Vec<usize> = (0..p.position.len().min(t.position.len()))
            .filter(|&i| t.tag.get(i).is_none_or(|tag| *tag == FLUID))
            .collect();
        positions.push((step, series::mean_square(p, t, &fluid, period)));
        if let (Some(p), Some(t)) = (p.scalars.get("temperature"), t.scalars.get("temperature")) {
            let sum: f64 = fluid.iter().map(|&i| (p[i] - t[i]).powi(2)).sum();
            temperatures.push((step, sum / fluid.len().max(1) as f64));
        }
    }
    let Some((step, mse)) = positions.last().copied() else { return Ok((none, vec![])) };
    let lead = format!(
        "At step {step} the MSE of the predicted positions is {mse:.2e}{}.",
        temperatures.last().map_or(String::new(), |(_, mse)| format!(", that of the temperatures {mse:.2e}"))
    );
    let errors = [("Position error by step", positions), ("Temperature error by step", temperatures)];
    let charts = errors
        .into_iter()
        .filter(|(_, points)| !points.is_empty())
        .map(|(title, points)| Chart { log: true, ..Chart::new(title, "step", "MSE", vec![Series::new("", points)]) });
    Ok((lead, charts.collect()))
}
