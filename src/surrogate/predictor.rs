//! What a rollout needs of a model, learned or not.

use crate::dataset::{Metadata, Trajectory};

/// Positions and temperatures of all particles at one time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// `[N, D]`, wrapped into the box where it is periodic.
    pub position: Vec<f64>,
    /// `[N]`.
    pub temperature: Option<Vec<f64>>,
}

impl Frame {
    /// A frame of a data set.
    pub fn of(trajectory: &Trajectory, frame: usize) -> Self {
        let widen = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Self {
            position: widen(trajectory.position_of(frame)),
            temperature: trajectory.temperature_of(frame).map(widen),
        }
    }
}

/// Advances particles by one frame from the frames before.
pub trait Predictor {
    /// What it is called in tables.
    fn name(&self) -> String;

    /// The next frame from the last ones, oldest first. The caller overwrites kinematic particles and the inlet's
    /// temperature afterwards; what stands there in the result does not matter.
    ///
    /// # Errors
    /// Neighbour search (lost or clumped particles), tensor errors.
    fn next(&self, scenery: &Scenery, window: &[Frame]) -> anyhow::Result<Frame>;

    /// Frames it wants to see.
    fn window(&self) -> usize {
        6
    }

    /// How a data set differs from what it was trained on, if that is known and matters.
    fn unlike(&self, _: &Metadata) -> Option<String> {
        None
    }
}

/// What does not change along a trajectory.
#[derive(Debug, Clone, Copy)]
pub struct Scenery<'a> {
    pub metadata: &'a Metadata,
    /// `[N]`, see [`crate::dataset::kind`].
    pub kind: &'a [i32],
    /// `[N]`, not-a-number where no temperature is set.
    pub wall_temperature: Option<&'a [f32]>,
}

impl<'a> Scenery<'a> {
    /// Of a data set's trajectory.
    pub fn of(metadata: &'a Metadata, trajectory: &'a Trajectory) -> Self {
        Self { metadata, kind: &trajectory.kind, wall_temperature: trajectory.wall_temperature.as_deref() }
    }
}
