//! The folder of a run as the source of a page.

use crate::io::csv::{read_table, TextTable};
use crate::io::FileError;
use crate::report::page::{link, short, Cell, File, Note, Picture, Text, PAGE};
use crate::report::text::{bytes, shown};
use crate::scene::record::Record;
use crate::scene::warnings::Warning;
use serde_json::{Map, Value};
use std::cell::RefCell;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Size of a picture above which it is not embedded in the page.
const LARGEST_PICTURE: usize = 1 << 20;
/// Largest size of all embedded pictures of a page.
const LARGEST_PICTURES: usize = 3 << 19;

/// Names of columns and their values, NaN for cells that are not numbers.
pub type Columns = Vec<(String, Vec<f64>)>;

/// The values of a column; none if there is no such column.
pub fn column<'a>(columns: &'a Columns, name: &str) -> Option<&'a [f64]> {
    columns.iter().find(|(other, _)| other == name).map(|(_, values)| &values[..])
}

pub struct Folder {
    pub path: PathBuf,
    /// Name of the command.
    pub kind: String,
    /// What could not be read; its parts share this list.
    damage: Rc<RefCell<Vec<Note>>>,
}

impl Folder {
    pub fn new(path: &Path, kind: &str) -> Self {
        Self { path: path.to_path_buf(), kind: kind.to_string(), damage: Rc::default() }
    }

    /// The result of reading `what`, or none and a note: a page leaves out what could not be read, and says so.
    pub fn unless_damaged<T>(&self, what: &str, found: Result<T, impl Display>) -> Option<T> {
        let error = match found {
            Ok(found) => return Some(found),
            Err(error) => error,
        };
        let problem = shown(&format!("the page is without {what}: {error}"));
        let advice = match what {
            "verification.json" => format!("hydrograd verify {}, which writes it anew", self.path.display()),
            _ => "the run again, or a copy of the file that is whole".to_string(),
        };
        let mut damage = self.damage.borrow_mut();
        // A file may be read twice.
        if !damage.iter().any(|note| note.problem == problem) {
            damage.push(Note { problem, advice });
        }
        None
    }

    /// The notes on what could not be read so far.
    pub fn damage(&self) -> Vec<Note> {
        self.damage.borrow().clone()
    }

    pub fn has(&self, file: &str) -> bool {
        self.path.join(file).is_file()
    }

    pub fn name(&self) -> String {
        let real = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        real.file_name().map_or_else(|| self.path.display().to_string(), |name| name.to_string_lossy().into())
    }

    /// The command and its scene.
    pub fn subtitle(&self) -> String {
        let scene = self.scene();
        format!("hydrograd {}{}{scene}", self.kind, if scene.is_empty() { "" } else { ", " })
    }

    /// The scene of the run, or the name of its file for a custom scene, if known; empty without a scene.
    pub fn scene(&self) -> String {
        let of_summary = || {
            let summary = std::fs::read_to_string(self.path.join("summary.json")).ok()?.parse::<Value>().ok()?;
            let name = summary.get("scene_file").or_else(|| summary.get("scene"))?;
            name.as_str().map(str::to_string)
        };
        of_summary().or_else(|| self.config().get("scene")?.as_str().map(str::to_string)).unwrap_or_default()
    }

    /// The values in `config.toml`; empty if it cannot be read.
    pub fn config(&self) -> toml::Table {
        let text = std::fs::read_to_string(self.path.join("config.toml")).unwrap_or_default();
        text.parse().unwrap_or_default()
    }

    /// A JSON object in a file; none if there is no such file.
    pub fn json(&self, file: &str) -> Option<Map<String, Value>> {
        match self.value(file) {
            Some(Value::Object(map)) => Some(map),
            _ => None,
        }
    }

    /// The record in a file; empty if there is no such file.
    pub fn record(&self, file: &str) -> Record {
        Record(self.json(file).unwrap_or_default())
    }

    /// The JSON value in a file; none if there is no such file.
    pub fn value(&self, file: &str) -> Option<Value> {
        let path = self.path.join(file);
        let read = || -> Result<Value, FileError> {
            let text = std::fs::read_to_string(&path).map_err(|source| FileError::read(&path, source))?;
            serde_json::from_str(&text).map_err(|error| FileError::Damaged {
                path: path.clone(),
                format: "JSON file",
                what: error.to_string(),
                hint: "run the command again",
            })
        };
        self.unless_damaged(file, path.is_file().then(read).transpose()).flatten()
    }

    /// The columns of a CSV file, NaN for cells that are not numbers; empty if there is no such file.
    pub fn columns(&self, file: &str) -> Columns {
        let Some((header, rows)) = self.table(file) else { return vec![] };
        let number = |text: &String| text.parse().unwrap_or(f64::NAN);
        let column = |k: usize| rows.iter().map(|row| number(&row[k])).collect();
        header.iter().enumerate().map(|(k, name)| (shown(name), column(k))).collect()
    }

    /// A CSV file as text; none if there is no such file.
    pub fn table(&self, file: &str) -> Option<TextTable> {
        let path = self.path.join(file);
        self.unless_damaged(file, path.is_file().then(|| read_table(&path)).transpose()).flatten()
    }

    /// The text of `config.toml`.
    pub fn configuration(&self) -> Option<Text> {
        let text = std::fs::read_to_string(self.path.join("config.toml")).ok()?;
        Some(Text { title: "The configuration (config.toml)".into(), text })
    }

    /// The pictures whose name without extension is wanted, except for too large ones.
    pub fn pictures(&self, is_wanted: impl Fn(&str) -> bool) -> Vec<Picture> {
        let mut room = LARGEST_PICTURES;
        let mut found = Vec::new();
        for name in self.names() {
            let Some(stem) = name.strip_suffix(".svg").filter(|stem| is_wanted(stem)) else { continue };
            let Ok(bytes) = std::fs::read(self.path.join(&name)) else { continue };
            if bytes.len() <= LARGEST_PICTURE.min(room) {
                room -= bytes.len();
                found.push(Picture::svg(words(stem), &name, &bytes));
            }
        }
        found
    }

    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.path).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .filter(|name| !name.starts_with('.'))
            .collect();
        names.sort();
        names
    }

    /// The subfolders with runs of one kind.
    pub fn parts(&self, kind: &str) -> Vec<Folder> {
        let folders = self.names().into_iter().map(|name| self.path.join(name)).filter(|path| path.is_dir());
        let is_part = |path: &PathBuf| super::kind_of(path).as_deref() == Some(kind);
        folders
            .filter(is_part)
            .map(|path| Folder { path, kind: kind.to_string(), damage: self.damage.clone() })
            .collect()
    }

    /// The files in the folder with descriptions.
    pub fn files(&self) -> Vec<File> {
        let mut names = self.names();
        // It is written when the page is, see `simulate`.
        if self.kind == "simulate" && !names.iter().any(|name| name == "checkpoint.safetensors") {
            names.push("checkpoint.safetensors".into());
        }
        let of = |name: String| {
            let path = self.path.join(&name);
            if !path.is_dir() {
                let size = path.metadata().map_or(String::new(), |data| bytes(data.len() as usize));
                return File { link: link(&name), what: what(&name).into(), name, size };
            }
            // For a folder, its page, or the list of its frames, or the browser's view of it.
            let list = format!("{}.pvd", name.split('-').next().unwrap_or_default());
            let inside = [PAGE, &list].into_iter().find(|file| path.join(file).is_file());
            let name = format!("{name}/{}", inside.unwrap_or_default());
            let what = match inside {
                Some(PAGE) => "a run of its own",
                Some(_) => "frames for ParaView",
                None => "",
            };
            File { link: link(&name), name, size: String::new(), what: what.into() }
        };
        names.into_iter().filter(|name| name != PAGE).map(of).collect()
    }
}

pub fn words(name: &str) -> String {
    let mut letters = name.replace(['_', '-'], " ");
    if let Some(first) = letters.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    letters
}

/// Warnings of a run, with options named as on the command line.
pub fn warnings(record: &Record) -> Vec<Note> {
    let note = |it: Warning| Note { advice: crate::cli::arguments::with_options(&it.advice), problem: it.problem };
    record.warnings().into_iter().map(note).collect()
}

/// A figure for comparisons, with six decimals if these are enough.
pub fn figure(value: f64) -> String {
    if value.abs() >= 1e-3 {
        format!("{value:.6}")
    } else {
        short(value)
    }
}

/// A fraction as a percentage with its sign.
pub fn percent(share: f64) -> Cell {
    // A value that is shown as 0 has no sign.
    let share = if share.abs() < 5e-5 { 0.0 } else { share };
    Cell::shown(format!("{:+.2}\u{a0}%", 100.0 * share), share)
}

fn what(name: &str) -> &'static str {
    match name {
        "config.toml" => "the resolved configuration",
        "best.toml" => "the configuration with the best design, for simulate",
        "summary.json" => "every figure of the run",
        "history.csv" => "figures by epoch, over time, or by step",
        "shape.csv" => "the walls: can be given back as design.file",
        "state.h5" => "the final state, for h5py",
        "checkpoint.safetensors" => "from which --resume goes on",
        "last-good.safetensors" => "the last state that was good",
        "verification.json" => "checks of the gain, of hydrograd verify",
        "evaluation.json" => "scores and curves of each model",
        "validation.csv" => "errors, row by row",
        "best.safetensors" => "the parameters that did best on the validation split",
        "last.safetensors" => "the last parameters, from which --resume goes on",
        "train.h5" => "trajectories to train with, for h5py",
        "valid.h5" => "trajectories to validate with",
        "test.h5" => "trajectories to test with",
        "metadata.json" => "what the numbers mean, and their statistics",
        "generate.json" => "what the data set was begun with",
        "wall.vtp" => "the wall's surface, for ParaView",
        _ if name.starts_with("events.out.tfevents") => "curves for TensorBoard",
        _ if name.ends_with(".png") || name.ends_with(".svg") => "picture",
        _ if name.ends_with(".json") => "figures",
        _ if name.ends_with(".csv") => "table",
        _ => "",
    }
}
