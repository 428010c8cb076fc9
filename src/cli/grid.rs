//! A grid over training settings: every point trained by this program in a process of its own, finished ones kept.

use super::program;
use super::train::ended_early;
use crate::config::training::Settings;
use crate::error::{BadInput, Error};
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use crate::io::csv::read_columns;
use crate::numerics::interrupt;
use crate::surrogate::training::train::METRICS;
use serde::{Deserialize, Serialize};
use std::ffi::{OsStr, OsString};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Stdio;

/// More points than this are a slip of the keyboard.
const MOST_POINTS: usize = 10_000;

/// A key of the training configuration and the values that it takes.
#[derive(Debug, Clone, PartialEq)]
pub struct GridKey {
    pub key: String,
    pub values: Vec<String>,
}

impl GridKey {
    /// `noise=3e-5,3e-4`.
    ///
    /// # Errors
    /// No key, no value, a value twice, or characters that can not stand in the name of a folder.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        let bad = |problem: String| {
            BadInput::new(problem)
                .place(format!("--grid {text}"))
                .allowed("KEY=VALUE,VALUE,... with letters, digits and . + - _")
                .advice("--grid noise=3e-5,3e-4,3e-3")
        };
        let (key, values) = text.split_once('=').ok_or_else(|| bad("there is no `=`".into()))?;
        let values: Vec<String> = values.split(',').map(|value| value.trim().to_string()).collect();
        for word in [key].into_iter().chain(values.iter().map(String::as_str)) {
            if word.is_empty() {
                return Err(bad("a key or value is empty".into()));
            }
            if let Some(c) = word.chars().find(|c| !(c.is_ascii_alphanumeric() || ".+-_".contains(*c))) {
                return Err(bad(format!("`{word}` has the character `{c}`")));
            }
        }
        if let Some(k) = (1..values.len()).find(|&k| values[..k].contains(&values[k])) {
            return Err(bad(format!("the value {} is there twice", values[k])));
        }
        Ok(Self { key: key.into(), values })
    }
}

/// Values of all keys of the grid, in their order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GridPoint(pub Vec<(String, String)>);

impl GridPoint {
    /// Folder's name: independent of the grid it is in, so that a larger grid finds it again.
    pub fn name(&self) -> String {
        let mut settings: Vec<String> = self.0.iter().map(|(key, value)| format!("{key}={value}")).collect();
        settings.sort();
        settings.join(",")
    }

    pub fn value(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(other, _)| other == key).map(|(_, value)| value.as_str())
    }
}

/// All points of the grid; the last key changes first.
///
/// # Errors
/// No key, a key twice, too many points.
pub fn points(grid: &[GridKey]) -> Result<Vec<GridPoint>, BadInput> {
    if grid.is_empty() {
        return Err(BadInput::new("there is no grid").allowed("--grid KEY=VALUE,... at least once"));
    }
    if let Some(k) = (1..grid.len()).find(|&k| grid[..k].iter().any(|other| other.key == grid[k].key)) {
        return Err(BadInput::new(format!("the key {} is there twice", grid[k].key)).allowed("each key once"));
    }
    let count = grid.iter().map(|key| key.values.len()).fold(1_usize, usize::saturating_mul);
    if count > MOST_POINTS {
        return Err(BadInput::new(format!("the grid has {count} points")).allowed(format!("at most {MOST_POINTS}")));
    }
    let mut points = vec![vec![]];
    for GridKey { key, values } in grid {
        let with = |point: &Vec<_>, value: &String| [point.as_slice(), &[(key.clone(), value.clone())]].concat();
        points = points.iter().flat_map(|point| values.iter().map(move |value| with(point, value))).collect();
    }
    Ok(points.into_iter().map(GridPoint).collect())
}

/// What all points have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// What starts the program: ourselves.
    pub program: Vec<OsString>,
    pub data: PathBuf,
    pub steps: usize,
    /// `key=value`, below those of the grid.
    pub sets: Vec<String>,
    pub out: PathBuf,
    /// Of each training; 0 for every core that the process may use.
    pub threads: usize,
}

/// `finished.json` of a point: what it was trained with. Without it, a point is trained (again).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    pub point: GridPoint,
    pub data: PathBuf,
    pub steps: usize,
    pub sets: Vec<String>,
    pub seconds: f64,
}

/// How a point ended.
#[derive(Debug, Clone, PartialEq)]
pub enum PointOutcome {
    Trained {
        seconds: f64,
        validation: Validation,
    },
    /// What the process said.
    Failed(String),
}

/// `validation.csv` of a training run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Validation {
    pub step: Vec<f64>,
    pub seconds: Vec<f64>,
    /// As [`METRICS`]; empty where the file has none or not everywhere.
    pub metrics: [Vec<f64>; METRICS.len()],
}

impl Validation {
    /// # Errors
    /// The file, its steps or its `mse_1` are missing or damaged.
    pub fn read(folder: &Path) -> anyhow::Result<Self> {
        let path = folder.join("validation.csv");
        let column = |name| read_columns(&path, &[name]).map(|mut columns| columns.remove(0));
        let (step, seconds) = (column("step")?, column("seconds")?);
        column(METRICS[0])?;
        // The others may be left out: no temperature, fewer steps.
        Ok(Self { step, seconds, metrics: METRICS.map(|name| column(name).unwrap_or_default()) })
    }

    pub fn curve(&self, metric: &str) -> &[f64] {
        METRICS.iter().position(|name| *name == metric).map_or(&[], |k| self.metrics[k].as_slice())
    }

    pub fn last(&self, metric: &str) -> Option<f64> {
        self.curve(metric).last().copied()
    }

    /// The least value of a metric and its step.
    pub fn best(&self, metric: &str) -> Option<(f64, f64)> {
        let pairs = self.curve(metric).iter().zip(&self.step).map(|(value, step)| (*value, *step));
        pairs.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

impl Study {
    pub fn folder(&self, point: &GridPoint) -> PathBuf {
        self.out.join(point.name())
    }

    /// A point that was trained before.
    ///
    /// # Errors
    /// [`BadInput`] if it was trained otherwise (data, steps, settings) or its files are damaged.
    pub fn finished(&self, point: &GridPoint) -> Result<Option<PointOutcome>, BadInput> {
        let folder = self.folder(point);
        let path = folder.join("finished.json");
        let Ok(text) = std::fs::read_to_string(&path) else { return Ok(None) };
        let bad = |problem: String| {
            BadInput::new(problem)
                .place(path.display().to_string())
                .allowed("points of this study only")
                .advice(format!("another --out, or remove {}", folder.display()))
        };
        let found: Finished = serde_json::from_str(&text).map_err(|error| bad(error.to_string()))?;
        for (what, found, now) in [
            ("--steps", found.steps.to_string(), self.steps.to_string()),
            ("--data", found.data.display().to_string(), absolute(&self.data).display().to_string()),
            ("--set", found.sets.join(" "), self.sets.join(" ")),
        ] {
            if found != now {
                return Err(bad(format!("trained with {what} {found}, not {now}")));
            }
        }
        let validation = Validation::read(&folder).map_err(|error| bad(error.to_string()))?;
        Ok(Some(PointOutcome::Trained { seconds: found.seconds, validation }))
    }

    /// `key=value` of a point, its own last.
    fn all_sets(&self, point: &GridPoint) -> Vec<String> {
        let own = point.0.iter().map(|(key, value)| format!("{key}={value}"));
        self.sets.iter().cloned().chain(own).collect()
    }

    /// An error if a point's settings are bad: before hours of training, not between them.
    pub fn check(&self, points: &[GridPoint]) -> Result<(), BadInput> {
        for point in points {
            for (key, _) in &point.0 {
                if key == "steps" {
                    return Err(BadInput::new("steps cannot be in the grid")
                        .place("--grid steps")
                        .allowed("--steps N, the same for all points"));
                }
                if let Some(set) = self.sets.iter().find(|set| set.split('=').next().map(str::trim) == Some(key)) {
                    return Err(BadInput::new(format!("{key} is in the grid, too"))
                        .place(format!("--set {set}"))
                        .allowed("each key in --set or in --grid"));
                }
            }
            Settings::load(None, None, &self.all_sets(point)).map_err(|bad| bad.place(point.name()))?;
        }
        Ok(())
    }

    /// Trains a point.
    ///
    /// # Errors
    /// [`BadInput`] if training says that its input is bad: the other points' will be, too. The process can not be started;
    /// system errors. A training run that fails is [`PointOutcome::Failed`].
    pub fn train(&self, point: &GridPoint) -> anyhow::Result<PointOutcome> {
        let folder = self.folder(point);
        // Not into the folder: that is training's to create, once it knows that its input is good.
        let mut log = tempfile::tempfile()?;
        let mut command = program::command(&self.program);
        command.arg("train").arg("--data").arg(&self.data).arg("--out").arg(&folder);
        command.args(["--steps", &self.steps.to_string(), "--threads", &self.threads.to_string()]);
        // Killed on the way: goes on with the settings it was begun with.
        if folder.join("last.safetensors").is_file() || ended_early(&folder) {
            command.arg("--resume");
        }
        for set in self.all_sets(point) {
            command.args(["--set", &set]);
        }
        command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log.try_clone()?);
        let status = program::attended(&mut command).map_err(|error| {
            let program = self.program.join(OsStr::new(" "));
            Error::run(format!("can not start {}: {error}", program.display()), "check that it is still there")
        })?;
        interrupt::check()?;
        let mut text = String::new();
        std::io::Seek::rewind(&mut log)?;
        log.read_to_string(&mut text)?;
        if !status.success() {
            let message = text.find("error: ").map_or(text.trim(), |at| text[at + "error: ".len()..].trim());
            let message = if message.is_empty() { format!("it ended with {status}") } else { message.to_string() };
            if status.code() == Some(i32::from(crate::error::EXIT_INPUT)) {
                return Err(BadInput::new(message).place(point.name()).into());
            }
            return Ok(PointOutcome::Failed(message));
        }
        prepare_output_folder(&folder)?;
        write_bytes_atomically(&folder.join("log.txt"), text.as_bytes())?;
        let validation = match Validation::read(&folder) {
            Ok(validation) => validation,
            Err(error) => return Ok(PointOutcome::Failed(error.to_string())),
        };
        // Training's own count, which goes on when it is resumed.
        let seconds = validation.seconds.last().copied().unwrap_or(0.0);
        let (data, steps, sets) = (absolute(&self.data), self.steps, self.sets.clone());
        let finished = Finished { point: point.clone(), data, steps, sets, seconds };
        let text = serde_json::to_string_pretty(&finished)? + "\n";
        write_bytes_atomically(&folder.join("finished.json"), text.as_bytes())?;
        Ok(PointOutcome::Trained { seconds, validation })
    }
}

fn absolute(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf())
}
