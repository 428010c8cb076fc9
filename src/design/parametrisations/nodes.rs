//! The wall's height at nodes with linear interpolation, see [`crate::design::shape`].
//!
//! The column averages are exact (the hat functions are integrated piecewise), and limits of the nodes are limits of
//! the wall, because between nodes it is neither higher nor steeper.

use super::{ColumnAverages, Parametrisation, Polygon, Variables};
use crate::design::limits::Limits;
use crate::design::shape::{HotSection, Shape, MAX_SLOPE};
use crate::error::BadInput;

#[derive(Debug, Clone, PartialEq)]
pub struct Nodes {
    /// The shape with zero offsets.
    flat: Shape,
    facts: Variables,
}

impl Nodes {
    /// Nodes at `positions`, increasing and inside the section, with heights up to `bound`.
    ///
    /// # Errors
    /// Those of [`Shape::new`] about nodes.
    pub fn new(positions: Vec<f64>, section: HotSection, bound: f64) -> Result<Self, BadInput> {
        let offsets = vec![0.0; positions.len()];
        let flat = Shape::new(positions, offsets, section.from, section.to)?;
        let facts = Variables {
            name: "design.offsets",
            positions: flat.nodes.clone(),
            limits: Limits::symmetric(bound, &flat.nodes, MAX_SLOPE),
            averages: ColumnAverages::new(flat.nodes.len(), flat.column_weights(section.dx, section.length)),
        };
        Ok(Self { flat, facts })
    }

    /// Uses the heights of a polygon, if given, instead of averages over columns.
    pub fn as_polygon(mut self, polygon: Option<&Polygon>) -> Self {
        if let Some(polygon) = polygon {
            self.facts.averages = ColumnAverages::of_polygon(self.flat.nodes.len(), polygon, |offsets, x| {
                Shape { offsets: offsets.to_vec(), ..self.flat.clone() }.surface(x)
            });
        }
        self
    }
}

impl Parametrisation for Nodes {
    fn facts(&self) -> &Variables {
        &self.facts
    }

    fn height(&self, variables: &[f64], x: f64, _: f64) -> f64 {
        self.sampled(variables).height(x)
    }

    fn sampled(&self, variables: &[f64]) -> Shape {
        Shape { offsets: variables.to_vec(), ..self.flat.clone() }
    }
}
