//! From design variables to the height of a wall over each particle column, and back.
//!
//! A parametrisation is a linear map s = A x from variables x `[K]` to the averages s `[C]` of the wall's height y(x) over
//! the particle columns: with averages the fluid's area is the same at every resolution. [`super::deformation`] takes the
//! heights on to the particles.
//!
//! Another one is a file here that implements [`Parametrisation`] (a [`ColumnAverages`] has the map and its adjoint), and
//! a line in [`of_config`].

pub mod b_spline;
pub mod nodes;
pub mod numbers;
pub mod spline_surface;
pub mod two_walls;

pub use b_spline::BSpline;
pub use nodes::Nodes;
pub use numbers::Numbers;
pub use spline_surface::SplineSurface;
pub use two_walls::TwoWalls;

use super::limits::Limits;
use super::shape::{HotSection, Shape};
use crate::config::scene::{Config, DesignWalls, Formulation, Motion, ParametrisationName};
use crate::error::BadInput;
use std::sync::Arc;

/// The parametrisation of a configuration, and its variables at a start shape.
///
/// # Errors
/// Too few control points.
pub fn of_config(config: &Config, start: &Shape) -> Result<(Arc<dyn Parametrisation>, Vec<f64>), BadInput> {
    let (channel, design) = (&config.channel, &config.design);
    let (dx, length) = (config.resolution.dx, channel.length);
    let section = HotSection { from: channel.hot_from, to: channel.hot_to, dx, length };
    let at_points = match (config.fluid.formulation, config.fluid.motion) {
        (Formulation::Standard, _) => None,
        (Formulation::Consistent, Motion::Moving) => Some(section.vertices()),
        (Formulation::Consistent, Motion::Fixed) => {
            Some((0..config.columns()).map(|column| first_column(config) + column as f64 * dx).collect())
        }
    };
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

/// The parametrisation of one wall or of both, and its variables at a start shape: those of a wall are `first` of its shape.
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

/// x of the first column of fixed particles: such that the cells of columns begin where the hot section does, if dx fits.
pub fn first_column(config: &Config) -> f64 {
    let dx = config.resolution.dx;
    let x = (config.channel.hot_from / dx + 0.5).rem_euclid(1.0) * dx;
    // Just below a spacing is rounding.
    if x > dx * (1.0 - 1e-9) {
        0.0
    } else {
        x
    }
}

/// How design variables shape a wall.
pub trait Parametrisation: std::fmt::Debug + Send + Sync {
    /// What it is called in tables and files.
    fn name(&self) -> &str;

    /// x of the place where each variable acts, `[K]`; of a wall over x alone increasing.
    fn positions(&self) -> &[f64];

    /// z of these places, if the wall varies along z.
    fn across(&self) -> Option<&[f64]> {
        None
    }

    /// Average height of the wall over each particle column, `[K]` -> `[C]`, in length units: linear.
    fn column_heights(&self, variables: &[f64]) -> Vec<f64>;

    /// The adjoint of [`Self::column_heights`]: from the derivative by the columns' heights, `[C]`, to that by the
    /// variables, `[K]`.
    fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64>;

    /// Height of the wall at (x, z), in length units; 0 outside the hot section. Most walls do not vary along z.
    fn height(&self, variables: &[f64], x: f64, z: f64) -> f64;

    /// Where the variables may be. A parametrisation chooses limits that keep |y| and |dy/dx| in theirs.
    fn limits(&self) -> &Limits;

    /// An error that names what is wrong with variables that were read from somewhere.
    ///
    /// # Errors
    /// Variables that are no numbers, or outside the limits.
    fn check(&self, variables: &[f64]) -> Result<(), BadInput>;

    /// The wall at points, such that a file of them can be given back as `design.file`.
    fn sampled(&self, variables: &[f64]) -> Shape;

    /// Number of variables K.
    fn variables(&self) -> usize {
        self.positions().len()
    }

    /// What roughness costs, w sum (x_{k+1} - x_k)^2, and its derivative by the variables.
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

/// A linear map from variables to the averages over columns, as a sparse matrix, and its adjoint.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnAverages {
    variables: usize,
    /// Pairs (variable, weight) of each column.
    weights: Vec<Vec<(usize, f64)>>,
}

impl ColumnAverages {
    pub fn new(variables: usize, weights: Vec<Vec<(usize, f64)>>) -> Self {
        Self { variables, weights }
    }

    /// Values at points instead of averages over columns, of what is linear in its variables.
    pub fn at_points(variables: usize, points: &[f64], height: impl Fn(&[f64], f64) -> f64) -> Self {
        let mut weights = vec![vec![]; points.len()];
        for k in 0..variables {
            let mut unit = vec![0.0; variables];
            unit[k] = 1.0;
            for (weights, &x) in weights.iter_mut().zip(points) {
                let weight = height(&unit, x);
                if weight != 0.0 {
                    weights.push((k, weight));
                }
            }
        }
        Self { variables, weights }
    }

    /// `[K]` -> `[C]`.
    pub fn heights(&self, variables: &[f64]) -> Vec<f64> {
        self.weights.iter().map(|w| w.iter().map(|(k, w)| w * variables[*k]).sum()).collect()
    }

    /// `[C]` -> `[K]`, summed in the order of the columns.
    pub fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64> {
        let mut gradient = vec![0.0; self.variables];
        for (weights, bar) in self.weights.iter().zip(heights_bar) {
            for (k, w) in weights {
                gradient[*k] += w * bar;
            }
        }
        gradient
    }
}

/// Steps of the conjugate gradients of [`fitted`], as a multiple of the number of variables.
const FIT_STEPS: usize = 4;

/// Variables whose heights come nearest to given ones: those with the least sum of squared distances, and of these, where heights
/// are few, those nearest to `first`. Heights that the map made of variables give these back, up to rounding, if every variable
/// is seen. Conjugate gradients for least squares (Björck 1996, algorithm 7.4.1).
fn fitted(map: &ColumnAverages, heights: &[f64], first: Vec<f64>) -> Vec<f64> {
    let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    let mut variables = first;
    let mut residual: Vec<f64> = map.heights(&variables).iter().zip(heights).map(|(y, o)| o - y).collect();
    let mut slope = map.pull_back(&residual);
    let mut direction = slope.clone();
    let (mut norm, begin) = (square(&slope), square(&slope));
    for _ in 0..FIT_STEPS * variables.len() {
        if norm <= 1e-32 * begin || norm == 0.0 {
            break;
        }
        let moved = map.heights(&direction);
        let step = norm / square(&moved);
        variables.iter_mut().zip(&direction).for_each(|(c, d)| *c += step * d);
        residual.iter_mut().zip(&moved).for_each(|(r, m)| *r -= step * m);
        slope = map.pull_back(&residual);
        let before = std::mem::replace(&mut norm, square(&slope));
        direction.iter_mut().zip(&slope).for_each(|(d, s)| *d = s + norm / before * *d);
    }
    variables
}
