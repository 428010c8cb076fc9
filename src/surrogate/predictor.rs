//! The interface of a model, learned or not, for rollouts.

use crate::dataset::{Metadata, Trajectory};

/// Positions and temperatures of all particles at one time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Positions, `[N, D]`, wrapped into the box in periodic directions.
    pub position: Vec<f64>,
    /// Temperatures, `[N]`.
    pub temperature: Option<Vec<f64>>,
}

impl Frame {
    /// A frame of a data set's trajectory.
    pub fn of(trajectory: &Trajectory, frame: usize) -> Self {
        let widen = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Self {
            position: widen(trajectory.position_of(frame)),
            temperature: trajectory.temperature_of(frame).map(widen),
        }
    }
}

/// Advances particles by one frame.
pub trait Predictor {
    /// The name in tables.
    fn name(&self) -> String;

    /// The next frame, given the last ones, oldest first. The caller replaces the values of kinematic particles and the
    /// inlet's temperature, so these are arbitrary in the result.
    ///
    /// # Errors
    /// Neighbour search (lost or clumped particles), tensor errors.
    fn next(&self, scenery: &Scenery, window: &[Frame]) -> anyhow::Result<Frame>;

    /// Number of frames that the model needs.
    fn window(&self) -> usize {
        6
    }

    /// How a data set differs from the training data, if that is known and matters.
    fn unlike(&self, _: &Metadata) -> Option<String> {
        None
    }
}

/// The constant properties of a trajectory.
#[derive(Debug, Clone, Copy)]
pub struct Scenery<'a> {
    pub metadata: &'a Metadata,
    /// Kinds of particles, `[N]`, see [`crate::dataset::kind`].
    pub kind: &'a [i32],
    /// Set temperatures of walls, `[N]`, NaN where none is set.
    pub wall_temperature: Option<&'a [f32]>,
}

impl<'a> Scenery<'a> {
    /// The properties of a data set's trajectory.
    pub fn of(metadata: &'a Metadata, trajectory: &'a Trajectory) -> Self {
        Self { metadata, kind: &trajectory.kind, wall_temperature: trajectory.wall_temperature.as_deref() }
    }
}
