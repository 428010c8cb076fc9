//! What only a scene with a design has.

use super::objectives::HeatOutflow;
use super::parametrisation::Deformation;
use super::shape::Shape;
use crate::numerics::lanes::Real;
use crate::sph::model::Model;
use crate::sph::solver::Snapshot;
use std::sync::Arc;

/// A scene whose start depends on design variables, and what they are judged by.
#[derive(Debug, Clone)]
pub struct DesignSpace<R> {
    pub model: Arc<Model<R>>,
    pub deformation: Arc<Deformation>,
    pub objective: HeatOutflow,
    /// Of the run.
    pub steps: usize,
    /// Steps of the objective's window.
    pub window: usize,
    /// Spacing of the targets.
    pub spacing: f64,
    /// The shape that the scene starts with.
    pub shape: Shape,
}

impl<R: Real> DesignSpace<R> {
    /// The start of a design.
    pub fn start(&self, offsets: &[f64]) -> Snapshot<R> {
        Snapshot::first(&self.model, self.deformation.state::<R>(offsets))
    }
}
