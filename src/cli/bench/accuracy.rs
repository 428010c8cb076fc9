//! Run time against error: a table, a picture per scene, and other codes' points beside ours.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cli::files::write_json;
use crate::config::scene::Precision;
use crate::error::BadInput;
use crate::io::FileError;
use crate::report::plots::compare;
use crate::report::table::Table;

use super::case::precision_name;

/// Values that differ by less than this share belong to one series: a time step is made to divide the run.
const SAME: f64 = 0.05;

/// One run, ours or of another code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedRun {
    #[serde(default = "ours")]
    pub code: String,
    pub scene: String,
    pub dx: f64,
    /// dt (c + U)/dx.
    pub cfl: f64,
    pub precision: Precision,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    pub seconds: f64,
    /// None if the run did not get to its end.
    pub error: Option<f64>,
    pub stable: bool,
}

fn ours() -> String {
    "hydrograd".into()
}

impl ComparedRun {
    /// What `--filter` looks into.
    pub fn label(&self) -> String {
        let count = |value: Option<usize>| value.map_or("?".into(), |count| count.to_string());
        let (particles, threads) = (count(self.particles), count(self.threads));
        format!("accuracy/{}/{particles}/{}/{threads}/forward", self.scene, precision_name(self.precision))
    }

    /// Seconds and error, if the run has a place in the picture.
    fn place(&self) -> Option<(f64, f64)> {
        self.error.filter(|_| self.stable).map(|error| (self.seconds, error))
    }
}

/// Reads other codes' points; every mistake names the file, and the point and field where there is one.
pub fn read(path: &Path) -> Result<Vec<ComparedRun>, BadInput> {
    let bad = |problem: String| {
        BadInput::new(problem)
            .place(format!("--peers {}", path.display()))
            .allowed("a JSON array of {code, scene, dx, cfl, precision, seconds, error, stable}")
    };
    let text = std::fs::read_to_string(path).map_err(|error| bad(error.to_string()))?;
    let values: Vec<serde_json::Value> =
        serde_json::from_str(&text).map_err(|error| bad(format!("not an array of JSON: {error}")))?;
    let points = values.into_iter().enumerate().map(|(number, value)| {
        if value.get("code").is_none() {
            return Err(bad(format!("point {number}: missing field `code`")));
        }
        let point: ComparedRun =
            serde_json::from_value(value).map_err(|error| bad(format!("point {number}: {error}")))?;
        for (name, value) in [("dx", point.dx), ("cfl", point.cfl), ("seconds", point.seconds)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(bad(format!("point {number}: {name} = {value} is not above 0")));
            }
        }
        match point.error {
            Some(error) if error.is_nan() || error < 0.0 => {
                Err(bad(format!("point {number}: error = {error} is below 0")))
            }
            None if point.stable => Err(bad(format!("point {number}: a stable run has an error, not null"))),
            _ => Ok(point),
        }
    });
    points.collect()
}

/// Writes the points as a JSON array that `--peers` reads.
pub fn write(path: &Path, points: &[ComparedRun]) -> anyhow::Result<()> {
    write_json(path, &serde_json::to_value(points)?)
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
            precision_name(point.precision).into(),
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

/// Draws error over run time, a picture per scene; runs that were not stable have no place in it.
pub fn draw(folder: &Path, points: &[ComparedRun]) -> Result<Vec<PathBuf>, FileError> {
    let mut scenes: Vec<&str> = vec![];
    for point in points.iter().filter(|point| point.place().is_some_and(|(_, error)| error > 0.0)) {
        if !scenes.contains(&point.scene.as_str()) {
            scenes.push(&point.scene);
        }
    }
    let mut files = vec![];
    for scene in scenes {
        let here: Vec<&ComparedRun> = points.iter().filter(|point| point.scene == scene).collect();
        let stem = folder.join(format!("accuracy-{scene}"));
        let title = format!("Run time against error: {scene}");
        files.extend(compare(&stem, &title, "seconds", "error", &series(&here), true, true)?);
    }
    Ok(files)
}

/// Runs of one code and type whose time steps belong together, over the spacing: those of one CFL number, or, where
/// the time step follows diffusion, of one dt/dx^2.
fn series(points: &[&ComparedRun]) -> Vec<(String, Vec<(f64, f64)>)> {
    let mut variants: Vec<(&str, Precision)> = vec![];
    for point in points {
        if !variants.contains(&(&point.code, point.precision)) {
            variants.push((&point.code, point.precision));
        }
    }
    let mut series = vec![];
    for (code, precision) in variants {
        let own: Vec<&ComparedRun> =
            points.iter().copied().filter(|point| point.code == code && point.precision == precision).collect();
        let by_sound = grouped(&own, |point| point.cfl);
        let by_diffusion = grouped(&own, |point| point.cfl / point.dx);
        let groups = if by_diffusion.len() < by_sound.len() { by_diffusion } else { by_sound };
        for group in groups {
            let (finest, coarsest) = (group[0], group[group.len() - 1]);
            let name = match (coarsest.cfl / finest.cfl - 1.0).abs() < SAME {
                true => format!("CFL {:.2}", coarsest.cfl),
                false => format!("CFL {:.3} to {:.3}", finest.cfl, coarsest.cfl),
            };
            let places: Vec<(f64, f64)> = group.iter().filter_map(|point| point.place()).collect();
            if !places.is_empty() {
                series.push((format!("{code} {}, {name}", precision_name(precision)), places));
            }
        }
    }
    series
}

/// Points with the same value, each group from fine to coarse.
fn grouped<'a>(points: &[&'a ComparedRun], value: impl Fn(&ComparedRun) -> f64) -> Vec<Vec<&'a ComparedRun>> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| value(a).total_cmp(&value(b)));
    let mut groups: Vec<Vec<&ComparedRun>> = vec![];
    for point in sorted {
        match groups.last_mut() {
            Some(group) if value(point) / value(group[0]) - 1.0 < SAME => group.push(point),
            _ => groups.push(vec![point]),
        }
    }
    groups.iter_mut().for_each(|group| group.sort_by(|a, b| a.dx.total_cmp(&b.dx)));
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(dx: f64, cfl: f64, seconds: f64) -> ComparedRun {
        ComparedRun {
            code: ours(),
            scene: "s".into(),
            dx,
            cfl,
            precision: Precision::F64,
            particles: None,
            steps: None,
            threads: None,
            seconds,
            error: Some(1e-2),
            stable: true,
        }
    }

    #[test]
    fn series_follow_the_law_of_the_time_step() {
        // Two CFL numbers, one of them rounded to divide the run.
        let sound = [point(0.1, 1.0, 1.0), point(0.05, 0.98, 2.0), point(0.1, 0.25, 4.0), point(0.05, 0.25, 8.0)];
        let found = series(&sound.iter().collect::<Vec<_>>());
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["hydrograd f64, CFL 0.25", "hydrograd f64, CFL 1.00"]);
        assert_eq!(found[1].1, [(2.0, 1e-2), (1.0, 1e-2)]);
        // dt ~ dx^2: the CFL number falls with dx.
        let diffusion = [point(0.1, 0.4, 1.0), point(0.05, 0.2, 2.0), point(0.025, 0.1, 4.0)];
        let found = series(&diffusion.iter().collect::<Vec<_>>());
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].0, "hydrograd f64, CFL 0.100 to 0.400");
    }
}
