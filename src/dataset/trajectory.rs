//! A trajectory of a data set: frames of particles, and properties of the whole trajectory.
//!
//! Group "00000" has `position` `[T, N, D]` f32 and `particle_type` `[N]` i32 as in LagrangeBench. Ours add
//! `temperature` `[T, N]` f32, `wall_temperature` `[N]` f32 (NaN where none is set), and `wall_x`, `wall_offset` `[M]`
//! f64 (the shape of the wall). On request there are `objective` `[1]` and `objective_gradient` `[M]` f64: the heat that
//! flows out of the steady flow over the wall, and its derivative by the heights of the nodes.

use super::metadata::Metadata;
use crate::io::hdf5_file::{failed, mismatch, missing, open, read_dataset, read_text};
use crate::io::FileError;
use std::path::{Path, PathBuf};

/// LagrangeBench's particle types.
pub mod kind {
    pub const PADDING: i32 = -1;
    pub const FLUID: i32 = 0;
    pub const SOLID_WALL: i32 = 1;
    pub const MOVING_WALL: i32 = 2;
    pub const RIGID_BODY: i32 = 3;
    /// Number of types; those of LagrangeBench are below it.
    pub const COUNT: i32 = 9;

    /// Whether particles are moved by others than the model: walls and padding.
    pub fn is_kinematic(kind: i32) -> bool {
        matches!(kind, SOLID_WALL | MOVING_WALL | PADDING)
    }
}

/// Which file of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    Train,
    Valid,
    Test,
}

impl Split {
    pub const ALL: [Self; 3] = [Self::Train, Self::Valid, Self::Test];

    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Valid => "valid",
            Self::Test => "test",
        }
    }

    pub fn path(self, folder: &Path) -> PathBuf {
        folder.join(format!("{}.h5", self.name()))
    }
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    /// The group's name.
    pub name: String,
    /// Number of frames, T.
    pub frames: usize,
    /// Number of particles, N, without padding.
    pub particles: usize,
    /// Positions, `[T, N, D]`.
    pub position: Vec<f32>,
    /// Types, `[N]`, see [`kind`].
    pub kind: Vec<i32>,
    /// Temperatures, `[T, N]`.
    pub temperature: Option<Vec<f32>>,
    /// Set temperatures of walls, `[N]`, NaN where none is set.
    pub wall_temperature: Option<Vec<f32>>,
    /// Positions of the wall shape's nodes and its heights there, `[M]` each.
    pub wall_x: Vec<f64>,
    pub wall_offset: Vec<f64>,
    /// The heat that flows out of the steady flow over the wall, and its derivative by the nodes' heights `[M]`, if
    /// the data have them.
    pub objective: Option<f64>,
    pub objective_gradient: Vec<f64>,
}

impl Trajectory {
    /// Positions of one frame, `[N, D]`.
    pub fn position_of(&self, frame: usize) -> &[f32] {
        let row = self.position.len() / self.frames;
        &self.position[frame * row..(frame + 1) * row]
    }

    /// Temperatures of one frame, `[N]`.
    pub fn temperature_of(&self, frame: usize) -> Option<&[f32]> {
        self.temperature.as_deref().map(|t| &t[frame * self.particles..(frame + 1) * self.particles])
    }

    /// Distances to the next frame (for the last one from the frame before), in spacings.
    pub fn speeds(&self, metadata: &Metadata, frame: usize, shown: &[usize]) -> Vec<f64> {
        let d = metadata.dim;
        let to = (frame + 1).min(self.frames - 1);
        let (from, to) = (self.position_of(frame.min(to.saturating_sub(1))), self.position_of(to));
        let domain = metadata.domain();
        let step = |i: usize, k: usize| domain.nearest(k, f64::from(to[i * d + k]) - f64::from(from[i * d + k]));
        shown.iter().map(|&i| (0..d).map(|k| step(i, k).powi(2)).sum::<f64>().sqrt() / metadata.dx).collect()
    }

    /// Tags: 0 fluid, 1 wall, 2 moving wall, 3 wall of set temperature (as in hydrograd), 4 rigid body, 5 padding.
    pub fn tags(&self) -> Vec<u8> {
        let hot = |i: usize| self.wall_temperature.as_ref().is_some_and(|t| t[i].is_finite());
        let tag = |(i, &k): (usize, &i32)| match k {
            kind::FLUID => 0,
            kind::SOLID_WALL if hot(i) => 3,
            kind::SOLID_WALL => 1,
            kind::MOVING_WALL => 2,
            kind::RIGID_BODY => 4,
            _ => 5,
        };
        self.kind.iter().enumerate().map(tag).collect()
    }
}

/// Reads all trajectories of a split, sorted by name.
///
/// # Errors
/// The file is missing, damaged, or a dataset in it is missing or of the wrong shape.
pub fn read_split(folder: &Path, metadata: &Metadata, split: Split) -> Result<Vec<Trajectory>, FileError> {
    let path = &split.path(folder);
    let file = open(path, "data set")?;
    names(path, &file)?.into_iter().map(|name| read_checked(path, &file, metadata, name)).collect()
}

/// Reads one trajectory of a split by its number; none if there are fewer.
pub fn read_one(
    folder: &Path,
    metadata: &Metadata,
    split: Split,
    number: usize,
) -> Result<Option<Trajectory>, FileError> {
    let path = &split.path(folder);
    let file = open(path, "data set")?;
    let name = names(path, &file)?.into_iter().nth(number);
    name.map(|name| read_checked(path, &file, metadata, name)).transpose()
}

/// A trajectory without its frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outline {
    /// The group's name.
    pub name: String,
    /// Number of frames, T.
    pub frames: usize,
    /// Number of particles, N.
    pub particles: usize,
    /// Positions of the wall shape's nodes and its heights there, `[M]` each; empty if no wall is shaped.
    pub wall_x: Vec<f64>,
    pub wall_offset: Vec<f64>,
    /// Name of the wall; empty if unknown.
    pub wall: String,
}

impl Outline {
    /// The outlines of all trajectories of a split, sorted by name.
    pub fn of_split(folder: &Path, metadata: &Metadata, split: Split) -> Result<Vec<Self>, FileError> {
        let path = &split.path(folder);
        let file = open(path, "data set")?;
        let of = |name: String| {
            let group = file.group(&name).map_err(failed(path, "open")(&name))?;
            let present = group.member_names().map_err(failed(path, "read")(&name))?;
            let [frames, particles, _] = shape(path, &group, metadata.dim, &name)?;
            Ok(Self {
                frames,
                particles,
                wall_x: nodes(path, &group, &present, "wall_x")?,
                wall_offset: nodes(path, &group, &present, "wall_offset")?,
                // Only our data have it.
                wall: read_text(path, &group, "wall").unwrap_or_default(),
                name,
            })
        };
        names(path, &file)?.into_iter().map(of).collect()
    }

    /// The kind of the wall, without its amplitude.
    pub fn kind_of_wall(&self) -> &str {
        self.wall.split(", amplitude").next().unwrap_or_default()
    }
}

/// The sorted names of a file's trajectories.
fn names(path: &Path, file: &hdf5::File) -> Result<Vec<String>, FileError> {
    let mut names = file.member_names().map_err(failed(path, "read")("the list of trajectories"))?;
    names.sort();
    Ok(names)
}

fn read_checked(path: &Path, file: &hdf5::File, metadata: &Metadata, name: String) -> Result<Trajectory, FileError> {
    let trajectory = read_trajectory(path, file, metadata.dim, name)?;
    check(path, metadata, &trajectory)?;
    Ok(trajectory)
}

/// Checks that positions are in the box or near it (walls are around it), and that data with heat have temperatures.
fn check(path: &Path, metadata: &Metadata, trajectory: &Trajectory) -> Result<(), FileError> {
    let (d, size, name) = (metadata.dim, metadata.size(), &trajectory.name);
    let is_near = |k: usize, x: f32| {
        let [lower, upper] = metadata.bounds[k % d];
        (lower - size[k % d]..=upper + size[k % d]).contains(&f64::from(x))
    };
    let place = |k: usize| format!("frame {}, particle {}", k / d / trajectory.particles, k / d % trajectory.particles);
    let bad = |what: &str, found: String, allowed: &str| mismatch(path, &format!("{name}/{what}"), found, allowed);
    if let Some((k, x)) = trajectory.position.iter().enumerate().find(|(k, x)| !is_near(*k, **x)) {
        let allowed = format!("within a box's length of the bounds {:?}", metadata.bounds[k % d]);
        return Err(bad("position", format!("{x} in {}", place(k)), &allowed));
    }
    let temperature = trajectory.temperature.as_deref();
    if let Some((k, t)) = temperature.into_iter().flatten().enumerate().find(|(_, t)| !t.is_finite()) {
        return Err(bad("temperature", format!("{t} in {}", place(k * d)), "finite numbers"));
    }
    if metadata.heat.is_some() && temperature.is_none() {
        let present = vec!["what metadata.json without heat has".into()];
        return Err(missing(path, "dataset", &format!("{name}/temperature"), present));
    }
    Ok(())
}

/// T, N and D of a trajectory's group; `dim` is the expected D.
fn shape(path: &Path, group: &hdf5::Group, dim: usize, name: &str) -> Result<[usize; 3], FileError> {
    let shape = group.dataset("position").map_err(failed(path, "open")("position"))?.shape();
    let bad = |allowed: &str| mismatch(path, &format!("{name}/position"), format!("of shape {shape:?}"), allowed);
    match *shape.as_slice() {
        [frames, particles, dimension] if dimension == dim => Ok([frames, particles, dimension]),
        [_, _, _] => Err(bad(&format!("[T, N, {dim}] as metadata.json says"))),
        _ => Err(bad("of shape [T, N, D]")),
    }
}

/// Values along a wall, `[M]`; empty if the group lacks them.
fn nodes(path: &Path, group: &hdf5::Group, present: &[String], name: &str) -> Result<Vec<f64>, FileError> {
    if !present.iter().any(|other| other == name) {
        return Ok(Vec::new());
    }
    let length = group.dataset(name).map_err(failed(path, "open")(name))?.shape();
    Ok(read_dataset(path, group, present, name, &length)?.unwrap_or_default())
}

/// Reads a trajectory of an open file; `dim` is D.
pub(super) fn read_trajectory(
    path: &Path,
    file: &hdf5::File,
    dim: usize,
    name: String,
) -> Result<Trajectory, FileError> {
    let group = file.group(&name).map_err(failed(path, "open")(&name))?;
    let present = group.member_names().map_err(failed(path, "read")(&name))?;
    for needed in ["position", "particle_type"] {
        if !present.iter().any(|other| other == needed) {
            return Err(missing(path, "dataset", &format!("{name}/{needed}"), present));
        }
    }
    let shape = shape(path, &group, dim, &name)?;
    let [frames, particles, _] = shape;
    let nodes = |name: &str| nodes(path, &group, &present, name);
    let kinds: Vec<i32> = read_dataset(path, &group, &present, "particle_type", &[particles])?.unwrap_or_default();
    if let Some(odd) = kinds.iter().find(|k| !(kind::PADDING..kind::COUNT).contains(*k)) {
        let allowed = format!("from {} to {}", kind::PADDING, kind::COUNT - 1);
        return Err(mismatch(path, &format!("{name}/particle_type"), format!("{odd} for a particle"), &allowed));
    }
    Ok(Trajectory {
        frames,
        particles,
        position: read_dataset(path, &group, &present, "position", &shape)?.unwrap_or_default(),
        kind: kinds,
        temperature: read_dataset(path, &group, &present, "temperature", &[frames, particles])?,
        wall_temperature: read_dataset(path, &group, &present, "wall_temperature", &[particles])?,
        wall_x: nodes("wall_x")?,
        wall_offset: nodes("wall_offset")?,
        objective: nodes("objective")?.first().copied(),
        objective_gradient: nodes("objective_gradient")?,
        name,
    })
}
