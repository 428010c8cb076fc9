//! The numbers of shapes as variables, see [`crate::design::shapes`].
//!
//! A variable is the position of a number between its limits, 0 ... 1, so that all variables are of one scale. The
//! "heights" of this parametrisation are the changes of the numbers from their initial values.

use super::{ColumnAverages, Parametrisation, Variables};
use crate::config::custom::VariableEntry;
use crate::config::scene::Config;
use crate::design::limits::Limits;
use crate::design::shape::Shape;

#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    first: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// Its positions are 0, 1, 2, ..., because numbers have none.
    facts: Variables,
}

impl Numbers {
    /// The variables of a configuration.
    pub fn of_config(config: &Config) -> Self {
        let limits = |of: fn(&VariableEntry) -> f64| config.variables.iter().map(of).collect();
        Self::new(config.shape_values(), limits(|variable| variable.lower), limits(|variable| variable.upper))
    }

    pub fn new(first: Vec<f64>, lower: Vec<f64>, upper: Vec<f64>) -> Self {
        let count = first.len();
        let width = |k: usize| vec![(k, upper[k] - lower[k])];
        let facts = Variables {
            name: "variables",
            positions: (0..count).map(|k| k as f64).collect(),
            limits: Limits::within(vec![0.0; count], vec![1.0; count]),
            averages: ColumnAverages::new(count, (0..count).map(width).collect()),
        };
        Self { first, lower, upper, facts }
    }

    /// The variables of the initial numbers.
    pub fn start(&self) -> Vec<f64> {
        (0..self.first.len()).map(|k| (self.first[k] - self.lower[k]) / (self.upper[k] - self.lower[k])).collect()
    }

    /// The numbers. Those of unchanged variables are the initial ones to the bit.
    pub fn values(&self, variables: &[f64]) -> Vec<f64> {
        let start = self.start();
        let value = |k: usize| self.first[k] + (variables[k] - start[k]) * (self.upper[k] - self.lower[k]);
        (0..start.len()).map(|k| value(k).clamp(self.lower[k], self.upper[k])).collect()
    }
}

impl Parametrisation for Numbers {
    fn facts(&self) -> &Variables {
        &self.facts
    }

    fn column_heights(&self, variables: &[f64]) -> Vec<f64> {
        let start = self.start();
        (0..start.len()).map(|k| (variables[k] - start[k]) * (self.upper[k] - self.lower[k])).collect()
    }

    fn height(&self, _: &[f64], _: f64, _: f64) -> f64 {
        0.0
    }

    /// The numbers take the place of offsets.
    fn sampled(&self, variables: &[f64]) -> Shape {
        Shape::of_numbers(self.values(variables))
    }

    /// Numbers have no neighbours, so there is no roughness penalty.
    fn neighbours(&self) -> Vec<(usize, usize)> {
        vec![]
    }
}
