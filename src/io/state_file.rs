//! The state of a run at one time, in HDF5 (gzip 4 with shuffle), readable by h5py and by ourselves.
//!
//! Datasets: `position` `[N, D]`, and where known `velocity` `[N, D]`, `temperature`, `density`, `pressure`, `mass`
//! `[N]` (all f64) and `tag` `[N]` (u8). Attributes of the file: `time`, `step`, `box_size` `[D]`, `dx`,
//! `configuration` (TOML text), `version`, `seed`.

use super::hdf5_file::{
    failed, mismatch, missing, open, read_attribute, read_dataset, read_number, read_text, write_attribute,
    write_dataset, write_file, write_text,
};
use super::FileError;
use std::path::Path;

/// One state. Vectors are component-major `[D, N]` in memory (all x first), `[N, D]` in the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// D, 1 to 3.
    pub dimension: usize,
    /// `[D, N]`, scene length units.
    pub position: Vec<f64>,
    /// `[D, N]`, scene velocity units.
    pub velocity: Option<Vec<f64>>,
    /// `[N]`, as are the following.
    pub temperature: Option<Vec<f64>>,
    pub density: Option<Vec<f64>>,
    pub pressure: Option<Vec<f64>>,
    pub mass: Option<Vec<f64>>,
    pub tag: Option<Vec<u8>>,
    /// Scene time units.
    pub time: f64,
    pub step: u64,
    /// `[D]`, scene length units.
    pub box_size: Vec<f64>,
    /// Particle spacing, scene length units.
    pub dx: f64,
    /// The configuration of the run as TOML text.
    pub configuration: String,
    /// Version of the program that wrote the state.
    pub version: String,
    pub seed: u64,
}

impl State {
    /// Number of particles N.
    pub fn count(&self) -> usize {
        self.position.len() / self.dimension.max(1)
    }

    fn scalars(&self) -> [(&'static str, &Option<Vec<f64>>); 4] {
        [
            ("temperature", &self.temperature),
            ("density", &self.density),
            ("pressure", &self.pressure),
            ("mass", &self.mass),
        ]
    }

    fn check(&self, path: &Path) -> Result<(), FileError> {
        let (count, vector) = (self.count(), self.dimension * self.count());
        let mut arrays = vec![("position", vector, self.position.len())];
        arrays.extend(self.velocity.as_ref().map(|values| ("velocity", vector, values.len())));
        arrays.extend(
            self.scalars().into_iter().filter_map(|(name, values)| Some((name, count, values.as_ref()?.len()))),
        );
        arrays.extend(self.tag.as_ref().map(|values| ("tag", count, values.len())));
        arrays.push(("box_size", self.dimension, self.box_size.len()));
        FileError::check_lengths(path, self.dimension, count, &arrays)
    }
}

/// Writes a state atomically.
///
/// # Errors
/// [`FileError::Input`] if lengths do not fit together, [`FileError::Hdf5`] or system errors.
pub fn write_state(path: &Path, state: &State) -> Result<(), FileError> {
    state.check(path)?;
    let count = state.count();
    write_file(path, |file| {
        let shape = [count, state.dimension];
        write_dataset(path, file, "position", &shape, &transposed(&state.position, state.dimension))?;
        if let Some(velocity) = &state.velocity {
            write_dataset(path, file, "velocity", &shape, &transposed(velocity, state.dimension))?;
        }
        for (name, values) in state.scalars() {
            if let Some(values) = values {
                write_dataset(path, file, name, &[count], values)?;
            }
        }
        if let Some(tag) = &state.tag {
            write_dataset(path, file, "tag", &[count], tag)?;
        }
        write_attribute(path, file, "time", &[], &[state.time])?;
        write_attribute(path, file, "step", &[], &[state.step])?;
        write_attribute(path, file, "box_size", &[state.dimension], &state.box_size)?;
        write_attribute(path, file, "dx", &[], &[state.dx])?;
        write_attribute(path, file, "seed", &[], &[state.seed])?;
        write_text(path, file, "configuration", &state.configuration)?;
        write_text(path, file, "version", &state.version)
    })
}

/// Reads a state; each name in `required` (`velocity`, `temperature`, `density`, `pressure`, `mass`, `tag`) must
/// be there.
///
/// # Errors
/// The file is missing, cut short or of another format; a dataset or attribute is missing or of wrong shape.
pub fn read_state(path: &Path, required: &[&str]) -> Result<State, FileError> {
    let file = open(path, "HDF5 state")?;
    let present = file.member_names().map_err(failed(path, "read")("the list of datasets"))?;
    for name in required.iter().chain(&["position"]) {
        if !present.iter().any(|other| other == name) {
            return Err(missing(path, "dataset", name, present));
        }
    }

    let shape = file.dataset("position").map_err(failed(path, "open")("position"))?.shape();
    let &[count, dimension @ 1..=3] = shape.as_slice() else {
        return Err(mismatch(path, "position", format!("of shape {shape:?}"), "of shape [N, 1], [N, 2] or [N, 3]"));
    };
    let vector = |name: &str| -> Result<Option<Vec<f64>>, FileError> {
        let values = read_dataset::<f64>(path, &file, &present, name, &[count, dimension])?;
        Ok(values.map(|values| transposed(&values, count)))
    };
    let scalar = |name: &str| read_dataset::<f64>(path, &file, &present, name, &[count]);
    Ok(State {
        dimension,
        position: vector("position")?.unwrap_or_default(),
        velocity: vector("velocity")?,
        temperature: scalar("temperature")?,
        density: scalar("density")?,
        pressure: scalar("pressure")?,
        mass: scalar("mass")?,
        tag: read_dataset::<u8>(path, &file, &present, "tag", &[count])?,
        time: read_number(path, &file, "time")?,
        step: read_number(path, &file, "step")?,
        box_size: read_attribute(path, &file, "box_size", &[dimension])?,
        dx: read_number(path, &file, "dx")?,
        configuration: read_text(path, &file, "configuration")?,
        version: read_text(path, &file, "version")?,
        seed: read_number(path, &file, "seed")?,
    })
}

/// A matrix of so many rows with its columns as rows: `[D, N]` to `[N, D]` and back.
fn transposed(values: &[f64], rows: usize) -> Vec<f64> {
    let columns = values.len() / rows.max(1);
    (0..values.len()).map(|index| values[(index % rows) * columns + index / rows]).collect()
}
