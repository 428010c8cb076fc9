//! Plots of the bench.

use super::case::{Group, Kind};
use super::rows::Row;
use crate::io::FileError;
use crate::report::plots::compare;
use crate::report::text::counted;
use std::path::{Path, PathBuf};

pub fn draw(folder: &Path, group: Group, rows: &[Row]) -> Result<Vec<PathBuf>, FileError> {
    let mut files = vec![];
    let mut picture = |name: &str, title: &str, x: &str, y: &str, series: Series| -> Result<(), FileError> {
        if !series.is_empty() {
            files.extend(compare(&folder.join(name), title, x, y, &series, true, true)?);
        }
        Ok(())
    };
    match group {
        Group::Scaling => {
            for kind in [Kind::Forward, Kind::Gradient] {
                let title = format!("Taylor-Green vortices, {}: time over the number of particles", kind.name());
                let name = format!("scaling-{}", kind.name());
                picture(&name, &title, "number of particles", "time per particle and step (ns)", scaling(rows, kind))?;
            }
        }
        Group::Gradient => {
            let y = "time per step, forward run included (ms)";
            picture("gradient", "Gradient: time against memory", "peak memory (MB)", y, gradient(rows))?;
        }
        _ => {}
    }
    Ok(files)
}

pub type Series = Vec<(String, Vec<(f64, f64)>)>;

pub fn add(series: &mut Series, name: String, point: (f64, f64)) {
    match series.iter_mut().find(|(other, _)| *other == name) {
        Some((_, points)) => points.push(point),
        None => series.push((name, vec![point])),
    }
}

fn scaling(rows: &[Row], kind: Kind) -> Series {
    let mut series = vec![];
    for dimension in [2, 3] {
        for row in rows.iter().filter(|row| row.kind == kind && row.dimension == dimension) {
            let variant = format!("{dimension}D, {}, {}", row.precision, counted(row.threads, "thread"));
            let place = (row.particles as f64, 1e6 * row.ms_per_step / row.particles as f64);
            add(&mut series, variant, place);
        }
    }
    series.iter_mut().for_each(|(_, points)| points.sort_by(|a, b| a.0.total_cmp(&b.0)));
    series
}

fn gradient(rows: &[Row]) -> Series {
    let mut series = vec![];
    for row in rows {
        // Each mode is a series with its variants as points.
        let mode = row.mode.clone().unwrap_or_default();
        let point = (row.peak_memory_bytes as f64 / 1e6, row.ms_per_step);
        add(&mut series, format!("{mode}, {}", row.precision), point);
    }
    series
}
