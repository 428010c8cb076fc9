//! The wall's height at nodes with linear interpolation, see [`crate::design::shape`].
//!
//! The column averages are exact (the hat functions are integrated piecewise), and limits of the nodes are limits of
//! the wall, because between nodes it is neither higher nor steeper.

use super::{ColumnAverages, Parametrisation};
use crate::design::limits::Limits;
use crate::design::shape::{HotSection, Shape, MAX_SLOPE};
use crate::error::BadInput;

/// A wall that is piecewise linear in x.
#[derive(Debug, Clone, PartialEq)]
pub struct Nodes {
    /// The shape with zero offsets.
    flat: Shape,
    averages: ColumnAverages,
    limits: Limits,
}

impl Nodes {
    /// Nodes at `positions`, increasing and inside the section, with heights up to `bound`.
    ///
    /// # Errors
    /// Those of [`Shape::new`] about nodes.
    pub fn new(positions: Vec<f64>, section: HotSection, bound: f64) -> Result<Self, BadInput> {
        let offsets = vec![0.0; positions.len()];
        let flat = Shape::new(positions, offsets, section.from, section.to)?;
        let averages = ColumnAverages::new(flat.nodes.len(), flat.column_weights(section.dx, section.length));
        let limits = Limits::symmetric(bound, &flat.nodes, MAX_SLOPE);
        Ok(Self { flat, averages, limits })
    }

    /// Uses the wall's heights at these points, if given, instead of averages over columns.
    pub fn sampled_at(mut self, points: Option<&[f64]>) -> Self {
        if let Some(points) = points {
            self.averages = ColumnAverages::at_points(self.flat.nodes.len(), points, |offsets, x| {
                Shape { offsets: offsets.to_vec(), ..self.flat.clone() }.surface(x)
            });
        }
        self
    }
}

impl Parametrisation for Nodes {
    fn name(&self) -> &str {
        "nodes"
    }

    fn positions(&self) -> &[f64] {
        &self.flat.nodes
    }

    fn column_heights(&self, variables: &[f64]) -> Vec<f64> {
        self.averages.heights(variables)
    }

    fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64> {
        self.averages.pull_back(heights_bar)
    }

    fn height(&self, variables: &[f64], x: f64, _: f64) -> f64 {
        self.sampled(variables).height(x)
    }

    fn limits(&self) -> &Limits {
        &self.limits
    }

    fn check(&self, variables: &[f64]) -> Result<(), BadInput> {
        self.limits.check("design.offsets", variables)
    }

    fn sampled(&self, variables: &[f64]) -> Shape {
        Shape { offsets: variables.to_vec(), ..self.flat.clone() }
    }
}
