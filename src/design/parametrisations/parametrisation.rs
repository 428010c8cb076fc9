//! The interface of a parametrisation.

use super::ColumnAverages;
use crate::design::limits::Limits;
use crate::design::shape::Shape;
use crate::error::BadInput;

/// What every parametrisation has.
#[derive(Debug, Clone, PartialEq)]
pub struct Variables {
    /// What they are called in messages.
    pub name: &'static str,
    /// x of the position of each variable, `[K]`; increasing for a wall over x only.
    pub positions: Vec<f64>,
    /// Limits of the variables, which a parametrisation chooses so that |y| and |dy/dx| are within theirs.
    pub limits: Limits,
    /// The map to the average height of the wall over each particle column, in length units.
    pub averages: ColumnAverages,
}

/// How design variables shape a wall.
pub trait Parametrisation: std::fmt::Debug + Send + Sync {
    fn facts(&self) -> &Variables;

    /// Height of the wall at (x, z), in length units; 0 outside the hot section. Most walls do not vary along z.
    fn height(&self, variables: &[f64], x: f64, z: f64) -> f64;

    /// The wall at points, in a form that can be used as `design.file`.
    fn sampled(&self, variables: &[f64]) -> Shape;

    fn name(&self) -> &str {
        self.facts().name
    }

    /// Number of variables K.
    fn variables(&self) -> usize {
        self.positions().len()
    }

    fn positions(&self) -> &[f64] {
        &self.facts().positions
    }

    /// z of these positions, if the wall varies along z.
    fn across(&self) -> Option<&[f64]> {
        None
    }

    fn limits(&self) -> &Limits {
        &self.facts().limits
    }

    /// Average height of the wall over each particle column, `[K]` -> `[C]`, in length units. The map is linear.
    fn column_heights(&self, variables: &[f64]) -> Vec<f64> {
        self.facts().averages.heights(variables)
    }

    /// The adjoint of [`Self::column_heights`]: maps the derivative by the columns' heights, `[C]`, to that by the
    /// variables, `[K]`.
    fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64> {
        self.facts().averages.pull_back(heights_bar)
    }

    /// Checks variables that were read from a file or a configuration.
    ///
    /// # Errors
    /// Variables that are no numbers, or outside the limits.
    fn check(&self, variables: &[f64]) -> Result<(), BadInput> {
        self.limits().check(self.name(), variables)
    }

    /// Pairs of variables whose difference makes a wall rough.
    fn neighbours(&self) -> Vec<(usize, usize)> {
        (1..self.variables()).map(|k| (k - 1, k)).collect()
    }

    /// The roughness penalty w sum (x_l - x_k)^2 over neighbours k, l, and its derivative by the variables.
    fn penalty(&self, weight: f64, variables: &[f64]) -> (f64, Vec<f64>) {
        let mut gradient = vec![0.0; variables.len()];
        let mut value = 0.0;
        for (one, next) in self.neighbours() {
            let difference = variables[next] - variables[one];
            value += weight * difference * difference;
            gradient[next] += 2.0 * weight * difference;
            gradient[one] -= 2.0 * weight * difference;
        }
        (value, gradient)
    }
}
