//! Run time against error: a table, a plot per scene, and points of other codes beside ours.

use super::plots::{add, Series};
use super::rows::read_array;
use crate::config::scene::Precision;
use crate::error::BadInput;
use crate::io::FileError;
use crate::report::plots::compare;
use crate::report::table::Table;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A run of this or another code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedRun {
    #[serde(default = "ours")]
    pub code: String,
    pub scene: String,
    pub dx: f64,
    /// Acoustic number dt (c + U)/dx.
    pub cfl: f64,
    pub precision: Precision,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    pub seconds: f64,
    /// None if the run did not reach its end.
    pub error: Option<f64>,
    pub stable: bool,
}

fn ours() -> String {
    "hydrograd".into()
}

impl ComparedRun {
    /// The text that `--filter` searches.
    pub fn label(&self) -> String {
        let count = |value: Option<usize>| value.map_or("?".into(), |count| count.to_string());
        let (particles, threads) = (count(self.particles), count(self.threads));
        format!("accuracy/{}/{particles}/{}/{threads}/forward", self.scene, self.precision.name())
    }

    /// Seconds and error, if the run can be plotted.
    fn place(&self) -> Option<(f64, f64)> {
        self.error.filter(|_| self.stable).map(|error| (self.seconds, error))
    }
}

/// Reads points of other codes. Errors name the file, and the point and field if there is one.
pub fn read(path: &Path) -> Result<Vec<ComparedRun>, BadInput> {
    let bad = |problem: String| {
        BadInput::new(problem)
            .place(format!("--peers {}", path.display()))
            .allowed("a JSON array of {code, scene, dx, cfl, precision, seconds, error, stable}")
    };
    read_array(path, "point", bad, |value| {
        if value.get("code").is_none() {
            return Err("missing field `code`".into());
        }
        let point: ComparedRun = serde_json::from_value(value).map_err(|error| error.to_string())?;
        for (name, value) in [("dx", point.dx), ("cfl", point.cfl), ("seconds", point.seconds)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(format!("{name} = {value} is not above 0"));
            }
        }
        match point.error {
            Some(error) if error.is_nan() || error < 0.0 => Err(format!("error = {error} is below 0")),
            None if point.stable => Err("a stable run has an error, not null".into()),
            _ => Ok(point),
        }
    })
}

/// The points as a table for the terminal.
pub fn text(points: &[ComparedRun]) -> String {
    let mut table =
        Table::new(["scene", "code", "type", "dx", "CFL", "N", "steps", "thr", "seconds", "error", "stable"]);
    for point in points {
        let count = |value: Option<usize>| value.map_or(String::new(), |count| count.to_string());
        table.row([
            point.scene.clone(),
            point.code.clone(),
            point.precision.name().into(),
            format!("{:.4}", point.dx),
            format!("{:.3}", point.cfl),
            count(point.particles),
            count(point.steps),
            count(point.threads),
            format!("{:.3}", point.seconds),
            point.error.map_or("-".into(), |error| format!("{error:.2e}")),
            if point.stable { "yes" } else { "no" }.into(),
        ]);
    }
    format!("accuracy\n\n{}", table.to_text())
}

/// Plots error over run time for each scene, without unstable runs.
pub fn draw(folder: &Path, points: &[ComparedRun]) -> Result<Vec<PathBuf>, FileError> {
    let mut scenes: Vec<&str> = vec![];
    for point in points.iter().filter(|point| point.place().is_some_and(|(_, error)| error > 0.0)) {
        if !scenes.contains(&point.scene.as_str()) {
            scenes.push(&point.scene);
        }
    }
    let mut files = vec![];
    for scene in scenes {
        let stem = folder.join(format!("accuracy-{scene}"));
        let title = format!("Run time against error, best choices of spacing and time step: {scene}");
        let error = match scene {
            "heated-channel" => "error of the heat outflow Q, relative",
            _ => "velocity error, relative (root mean square)",
        };
        let fronts = fronts(points.iter().filter(|point| point.scene == scene));
        files.extend(compare(&stem, &title, "run time (s)", error, &fronts, true, true)?);
    }
    Ok(files)
}

/// For each code and type, the points that no other run beats in both time and error, the fastest first.
pub fn fronts<'a>(points: impl Iterator<Item = &'a ComparedRun>) -> Series {
    let mut fronts = vec![];
    for point in points {
        if let Some(place) = point.place() {
            add(&mut fronts, format!("{} {}", point.code, point.precision.name()), place);
        }
    }
    for (_, places) in &mut fronts {
        places.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        let mut least = f64::INFINITY;
        places.retain(|&(_, error)| {
            let is_less = error < least;
            least = least.min(error);
            is_less
        });
    }
    fronts
}
