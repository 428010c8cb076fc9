//! Maps from design variables to the height of a wall over each particle column, and their adjoints.
//!
//! A parametrisation is a linear map s = A x from variables x `[K]` to the averages s `[C]` of the wall's height y(x)
//! over the particle columns. With averages the fluid's area is the same at every resolution. [`super::deformation`]
//! maps the heights to particles.
//!
//! A new one needs a file here that implements [`Parametrisation`] (with [`ColumnAverages`] for the map and its
//! adjoint), and a line in [`of_config`].

pub mod b_spline;
pub mod column_averages;
pub mod nodes;
pub mod numbers;
pub mod spline_surface;
pub mod two_walls;

pub use b_spline::BSpline;
pub use column_averages::ColumnAverages;
pub use nodes::Nodes;
pub use numbers::Numbers;
pub use spline_surface::SplineSurface;
pub use two_walls::TwoWalls;

use super::limits::Limits;
use super::shape::{HotSection, Shape};
use crate::config::scene::{Config, DesignWalls, ParametrisationName};
use crate::error::BadInput;
use std::sync::Arc;

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

/// The parametrisation of a configuration, and its variables for an initial shape.
///
/// # Errors
/// Too few control points.
pub fn of_config(config: &Config, start: &Shape) -> Result<(Arc<dyn Parametrisation>, Vec<f64>), BadInput> {
    let (design, dx) = (&config.design, config.resolution.dx);
    let section = HotSection::of(config);
    let facts = config.method.facts();
    let columns = || (0..config.columns()).map(|column| first_column(config) + column as f64 * dx).collect();
    let at_points = (!facts.wall_cells).then(|| if facts.moves { section.vertices() } else { columns() });
    Ok(match design.parametrisation {
        ParametrisationName::Nodes => {
            let nodes = Nodes::new(start.nodes.clone(), section, design.bound)?.sampled_at(at_points.as_deref());
            each_wall(design.walls, nodes, start, |wall| wall.offsets.clone())
        }
        ParametrisationName::BSpline => {
            let spline = BSpline::new(design.control_points, section, design.bound)?;
            let points = spline.clone();
            each_wall(design.walls, spline.sampled_at(at_points.as_deref()), start, |wall| points.fitted(wall))
        }
    })
}

/// The parametrisation of one wall or of both, and its variables for an initial shape; `first` gives those of one wall.
fn each_wall(
    walls: DesignWalls,
    one: impl Parametrisation + 'static,
    start: &Shape,
    first: impl Fn(&Shape) -> Vec<f64>,
) -> (Arc<dyn Parametrisation>, Vec<f64>) {
    match walls {
        DesignWalls::Bottom => (Arc::new(one), first(start)),
        DesignWalls::Both => (Arc::new(TwoWalls::new(one)), [first(start), first(&start.top_wall())].concat()),
    }
}

/// x of the first column of fixed particles. If dx fits, column cells begin where the hot section begins.
pub fn first_column(config: &Config) -> f64 {
    let dx = config.resolution.dx;
    let x = (config.channel.hot_from / dx + 0.5).rem_euclid(1.0) * dx;
    // A value just below a spacing is 0 up to rounding.
    if x > dx * (1.0 - 1e-9) {
        0.0
    } else {
        x
    }
}
