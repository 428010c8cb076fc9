//! The bench's pictures.

use std::path::{Path, PathBuf};

use super::arguments::Group;
use super::cases::Kind;
use super::rows::Row;
use crate::io::FileError;
use crate::report::plots::compare;

/// Draws what a group has to show, and says where.
pub fn draw(folder: &Path, group: Group, rows: &[Row]) -> Result<Vec<PathBuf>, FileError> {
    let series = match group {
        Group::Scaling => scaling(rows),
        Group::Gradient => gradient(rows),
        _ => return Ok(vec![]),
    };
    if series.is_empty() {
        return Ok(vec![]);
    }
    let stem = folder.join(group.name());
    let files = match group {
        Group::Scaling => compare(
            &stem,
            "Time per particle and step over the number of particles",
            "particles",
            "ns per particle and step",
            &series,
            true,
            true,
        )?,
        _ => compare(
            &stem,
            "Gradient: time against memory",
            "peak memory, MB",
            "ms per step, forward run included",
            &series,
            true,
            true,
        )?,
    };
    Ok(files.to_vec())
}

type Series = Vec<(String, Vec<(f64, f64)>)>;

/// Adds a point to the series of that name.
fn add(series: &mut Series, name: String, point: (f64, f64)) {
    match series.iter_mut().find(|(other, _)| *other == name) {
        Some((_, points)) => points.push(point),
        None => series.push((name, vec![point])),
    }
}

fn scaling(rows: &[Row]) -> Series {
    let mut series = vec![];
    for kind in [Kind::Forward, Kind::Gradient] {
        for dimension in [2, 3] {
            for row in rows.iter().filter(|row| row.kind == kind && row.dimension == dimension) {
                let threads = if row.threads == 1 { "thread" } else { "threads" };
                let variant = format!("{dimension}D, {}, {} {threads}", row.precision, row.threads);
                let at = |ms: f64| (row.particles as f64, 1e6 * ms / row.particles as f64);
                add(&mut series, format!("{} {variant}", kind.name()), at(row.ms_per_step));
                if let Some(floor) = row.floor_ms_per_step {
                    add(&mut series, format!("{} {variant}, plain C", kind.name()), at(floor));
                }
            }
        }
    }
    series.iter_mut().for_each(|(_, points)| points.sort_by(|a, b| a.0.total_cmp(&b.0)));
    series
}

fn gradient(rows: &[Row]) -> Series {
    let mut series = vec![];
    for row in rows {
        // A mode is a series of its own: its variants are connected, its name stands in the legend.
        let mode = row.mode.clone().unwrap_or_default();
        let point = (row.peak_memory_bytes as f64 / 1e6, row.ms_per_step);
        add(&mut series, format!("{mode}, {}", row.precision), point);
    }
    series
}
