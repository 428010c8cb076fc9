//! The rows of a group as a table for the terminal, at most 120 columns wide.

use super::case::{Group, Kind, COMPOSED, EVERYTHING_ON, FUSED, PLAN};
use super::rows::{Earlier, Row};
use crate::report::table::Table;
use crate::report::text::counted;

/// A heading with the common values of all rows, the table, and notes.
pub fn text(group: Group, rows: &[Row], earlier: Option<&Earlier>) -> String {
    type Cell = fn(&Row) -> String;
    let words: [(&str, Cell); 5] = [
        ("scene", |row| row.scene.clone()),
        ("N", |row| row.particles.to_string()),
        ("type", |row| row.precision.clone()),
        ("thr", |row| row.threads.to_string()),
        ("work", work),
    ];
    // Constant values go to the heading.
    let (constant, varying): (Vec<_>, Vec<_>) =
        words.into_iter().partition(|(_, cell)| rows.len() > 1 && rows.iter().all(|row| cell(row) == cell(&rows[0])));
    let common = constant.iter().map(|(name, cell)| match *name {
        "N" => format!("{} particles", cell(&rows[0])),
        "thr" => counted(rows[0].threads, "thread"),
        _ => cell(&rows[0]),
    });
    let mut heading = vec![group.name()];
    heading.extend(common);
    if rows.len() > 1 && rows.iter().all(|row| row.steps == rows[0].steps) {
        heading.push(format!("{} steps", rows[0].steps));
    }
    if group == Group::Scaling && rows.iter().any(|row| row.kind == Kind::Gradient) {
        heading.push("gradients keep every state".into());
    }

    let milliseconds = |ms: f64| format!("{ms:.*}", if ms < 10.0 { 4 } else { 1 });
    let mut table: Vec<(String, Vec<String>)> = vec![];
    let mut column = |name: &str, cell: &dyn Fn(&Row) -> Option<String>| {
        if rows.iter().any(|row| cell(row).is_some()) {
            table.push((name.into(), rows.iter().map(|row| cell(row).unwrap_or_default()).collect()));
        }
    };
    for (name, cell) in varying {
        column(name, &|row| Some(cell(row)));
    }
    column("on", &|row| row.device.clone());
    column("ms/step", &|row| Some(milliseconds(row.ms_per_step)));
    column("median", &|row| row.ms_per_step_median.map(milliseconds));
    column("ns/part.", &|row| Some(format!("{:.0}", row.ns_per_particle_step)));
    let by_pair = ![Group::Plan, Group::Surrogate].contains(&group);
    column("ns/pair", &|row| by_pair.then(|| format!("{:.2}", row.ns_per_pair)));
    if group == Group::Surrogate {
        column("edges", &|row| Some(row.pairs.to_string()));
        column("GFLOP", &|row| row.gflop_per_step.map(|gflop| format!("{gflop:.1}")));
        column("GFLOP/s", &|row| row.gflops.map(|rate| format!("{rate:.0}")));
        column("sgemm", &|row| row.sgemm_gflops.map(|rate| format!("{rate:.0}")));
        column("of it", &|row| Some(format!("{:.0} %", 100.0 * row.gflops? / row.sgemm_gflops?)));
    }
    let of_particle = |figure: f64, row: &Row| format!("{:.0}", figure / row.particles as f64);
    if group != Group::Surrogate {
        column("flop/part.", &|row| Some(of_particle(1e9 * row.gflop_per_step?, row)));
        column("B/part.", &|row| Some(of_particle(row.bytes_per_step? as f64, row)));
        column("roof ns", &|row| Some(of_particle(1e6 * row.roofline_ms_per_step?, row)));
        column("of it", &|row| Some(format!("{:.0} %", 100.0 * row.roofline_ms_per_step? / row.ms_per_step)));
    }
    column("MB", &|row| Some(format!("{:.0}", row.peak_memory_bytes as f64 / 1e6)));
    if group == Group::Gradient {
        column("adj/fwd", &|row| row.adjoint_over_forward.map(|ratio| format!("{ratio:.2}")));
        column("seconds", &|row| Some(format!("{:.3}", 1e-3 * row.ms_per_step * row.steps as f64)));
    }
    if group == Group::Plan {
        column("vs plan", &|row| against(row, rows, EVERYTHING_ON, PLAN).map(|ratio| format!("{ratio:.2}x")));
        column("differs", &|row| row.difference.map(|difference| format!("{difference:.1e}")));
    }
    if group == Group::Kernels {
        column("vs fused", &|row| against(row, rows, COMPOSED, FUSED).map(|ratio| format!("{ratio:.1}x")));
    }
    column("new/old", &|row| earlier?.ratio(row).map(|ratio| format!("{ratio:.3}")));

    let mut lines = Table::new(table.iter().map(|(name, _)| name.clone()));
    for place in 0..rows.len() {
        lines.row(table.iter().map(|(_, cells)| cells[place].clone()));
    }
    format!("{}\n\n{}", heading.join(", "), lines.to_text())
}

/// Forward or gradient, and its mode.
fn work(row: &Row) -> String {
    let mode = row.mode.as_deref().unwrap_or_default();
    match row.group {
        Group::Gradient => mode.to_string(),
        Group::Plan | Group::Kernels => format!("{} {mode}", row.kind.name()),
        _ => row.kind.name(),
    }
}

/// The ratio of a row's time to that of its counterpart in mode `base`, for rows of mode `mode`.
fn against(row: &Row, rows: &[Row], mode: &str, base: &str) -> Option<f64> {
    if row.mode.as_deref() != Some(mode) {
        return None;
    }
    let base = Row { mode: Some(base.into()), ..row.clone() }.label();
    rows.iter().find(|other| other.label() == base).map(|other| row.ms_per_step / other.ms_per_step)
}
