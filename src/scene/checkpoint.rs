//! The checkpoint of a simulation: a safetensors file from which the simulation continues to the bit.
//!
//! ```text
//!   state [F, N]                the solver's state
//!   list_positions [D, N]       positions from which the neighbour list was built
//! ```
//!
//! The metadata have the kind of file, `step`, the number of `parts` of the last step and the smallest one of later
//! steps (`least_parts`), the configuration and the program's version. [`open`] reads checkpoints of other kinds too.

use crate::config::difference::difference;
use crate::config::scene::Config;
use crate::error::BadInput;
use crate::io::tensor_file::{write_tensors, Data, TensorFile, Tensors};
use crate::io::FileError;
use crate::numerics::lanes::Real;
use crate::sph::solver::Snapshot;
use crate::sph::Model;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// The kind of file in the metadata.
pub const KIND: &str = "hydrograd simulation";

/// Keys that may change when a simulation is continued. The run may be longer, but its time step stays the same.
const FREE: [&str; 6] = ["output", "run.threads", "optimise", "time.end", "time.steps", "time.step"];

/// Writes a state of a run with the text of its configuration.
pub fn write<R: Real>(
    path: &Path,
    model: &Model<R>,
    state: &Snapshot<R>,
    configuration: &str,
) -> Result<(), FileError> {
    let (n, l) = (model.particles(), model.rows);
    let data = |values: &[R]| Data::F64(values.iter().map(|x| x.f64()).collect());
    let tensors: Tensors = BTreeMap::from([
        ("state".to_string(), (vec![l.count(), n], data(&state.state))),
        ("list_positions".to_string(), (vec![l.dimension, n], data(&state.reference))),
    ]);
    let metadata = [
        ("kind", KIND.to_string()),
        ("step", state.step.to_string()),
        ("parts", state.parts.to_string()),
        ("least_parts", state.least_parts.to_string()),
        ("config", configuration.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_string()),
    ];
    write_tensors(path, &tensors, &metadata.map(|(key, text)| (key.to_string(), text)).into())
}

/// The state of a simulation with this configuration.
///
/// # Errors
/// A missing file, one of another kind or of another scene, and values that no run could have written.
pub fn read<R: Real>(path: &Path, config: &Config, model: &Model<R>) -> Result<Snapshot<R>, BadInput> {
    let file = open(path, KIND, config, &FREE)?;
    let unreadable = |error: FileError| BadInput::new(error.to_string());
    let theirs = Config::from_record(file.text("config").map_err(unreadable)?)
        .map_err(|error| BadInput::new(format!("{}: {}", path.display(), error.message())))?;
    let (before, now) = (theirs.time_step(), config.time_step());
    if before != now {
        return Err(BadInput::new(format!("the run has steps of {before:e}, not {now:e}"))
            .place(path.display().to_string())
            .allowed("the time step that it began with")
            .advice(format!("time.step={before:?}")));
    }
    let (n, l) = (model.particles(), model.rows);
    let rows = |name: &str, rows: usize| -> Result<Vec<R>, BadInput> {
        Ok(file.f64(name, &[rows, n]).map_err(unreadable)?.iter().map(|&x| R::of(x)).collect())
    };
    let (state, reference) = (rows("state", l.count())?, Arc::new(rows("list_positions", l.dimension)?));
    let number = |name: &str| -> Result<usize, BadInput> {
        let text = file.text(name).map_err(unreadable)?;
        text.parse().map_err(|_| {
            BadInput::new(format!("{}: {name} = `{text}` in its metadata", path.display())).allowed("a whole number")
        })
    };
    // Checkpoints of versions without recovery lack this entry.
    let least_parts = if file.metadata.contains_key("least_parts") { number("least_parts")? } else { 1 };
    Ok(Snapshot { step: number("step")?, parts: number("parts")?, least_parts, state, reference })
}

/// Opens a checkpoint of a kind whose configuration equals this one except for the keys and sections in `free`.
pub fn open(path: &Path, kind: &str, config: &Config, free: &[&str]) -> Result<TensorFile, BadInput> {
    let file = TensorFile::read(path).map_err(|e| BadInput::new(e.to_string()))?;
    let found = file.metadata.get("kind").map_or("nothing of ours", String::as_str);
    if found != kind {
        return Err(BadInput::new(format!("{} holds {found}, not a {kind}", path.display()))
            .allowed("the folder of an earlier run of the same subcommand")
            .advice("the subcommand that wrote it"));
    }
    let text = file.text("config").map_err(|e| BadInput::new(e.to_string()))?;
    let theirs = Config::from_record(text).map_err(|e| {
        BadInput::new(format!("{}: its configuration does not load: {}", path.display(), e.message()))
            .allowed("a checkpoint written by this version")
    })?;
    match difference(&theirs, config, free) {
        Some(what) => Err(BadInput::new(format!("{} is a checkpoint of another scene: it has {what}", path.display()))
            .allowed("the same physics, geometry, time step, design and precision")
            .advice("a new run in another folder")),
        None => Ok(file),
    }
}
