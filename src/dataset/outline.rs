//! Outlines of the trajectories in a data set, without frames: counts and walls.

use super::metadata::Metadata;
use super::trajectory::{names, nodes, shape, Split};
use crate::io::hdf5_file::{failed, open, read_text};
use crate::io::FileError;
use std::path::Path;

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
