//! The interface of a parametrisation.

use crate::design::limits::Limits;
use crate::design::shape::Shape;
use crate::error::BadInput;

/// How design variables shape a wall.
pub trait Parametrisation: std::fmt::Debug + Send + Sync {
    /// The name in tables and files.
    fn name(&self) -> &str;

    /// x of the position of each variable, `[K]`; increasing for a wall over x only.
    fn positions(&self) -> &[f64];

    /// z of these positions, if the wall varies along z.
    fn across(&self) -> Option<&[f64]> {
        None
    }

    /// Average height of the wall over each particle column, `[K]` -> `[C]`, in length units. The map is linear.
    fn column_heights(&self, variables: &[f64]) -> Vec<f64>;

    /// The adjoint of [`Self::column_heights`]: maps the derivative by the columns' heights, `[C]`, to that by the
    /// variables, `[K]`.
    fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64>;

    /// Height of the wall at (x, z), in length units; 0 outside the hot section. Most walls do not vary along z.
    fn height(&self, variables: &[f64], x: f64, z: f64) -> f64;

    /// Limits of the variables, which a parametrisation chooses so that |y| and |dy/dx| are within theirs.
    fn limits(&self) -> &Limits;

    /// Checks variables that were read from a file or a configuration.
    ///
    /// # Errors
    /// Variables that are no numbers, or outside the limits.
    fn check(&self, variables: &[f64]) -> Result<(), BadInput>;

    /// The wall at points, in a form that can be used as `design.file`.
    fn sampled(&self, variables: &[f64]) -> Shape;

    /// Number of variables K.
    fn variables(&self) -> usize {
        self.positions().len()
    }

    /// The roughness penalty w sum (x_{k+1} - x_k)^2, and its derivative by the variables.
    fn penalty(&self, weight: f64, variables: &[f64]) -> (f64, Vec<f64>) {
        let mut gradient = vec![0.0; variables.len()];
        let mut value = 0.0;
        for k in 1..variables.len() {
            let difference = variables[k] - variables[k - 1];
            value += weight * difference * difference;
            gradient[k] += 2.0 * weight * difference;
            gradient[k - 1] -= 2.0 * weight * difference;
        }
        (value, gradient)
    }
}
