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
pub mod parametrisation;
pub mod spline_surface;
pub mod two_walls;

pub use b_spline::BSpline;
pub use column_averages::{ColumnAverages, Polygon};
pub use nodes::Nodes;
pub use numbers::Numbers;
pub use parametrisation::{Parametrisation, Variables};
pub use spline_surface::SplineSurface;
pub use two_walls::TwoWalls;

use super::shape::{HotSection, Shape};
use crate::config::scene::{Config, DesignWalls, ParametrisationName};
use crate::error::BadInput;
use std::sync::Arc;

/// The parametrisation of a configuration, and its variables for an initial shape.
///
/// # Errors
/// Too few control points.
pub fn of_config(config: &Config, start: &Shape) -> Result<(Arc<dyn Parametrisation>, Vec<f64>), BadInput> {
    let (design, dx) = (&config.design, config.resolution.dx);
    let section = HotSection::of(config);
    let facts = config.method.facts();
    let columns = || (0..config.columns()).map(|column| first_column(config) + column as f64 * dx).collect();
    let polygon = (!facts.wall_cells).then(|| match facts.moves {
        true => Polygon { x: section.vertices(), keeps_area: None },
        false => Polygon { x: columns(), keeps_area: Some(dx) },
    });
    Ok(match design.parametrisation {
        ParametrisationName::Nodes => {
            let nodes = Nodes::new(start.nodes.clone(), section, design.bound)?.as_polygon(polygon.as_ref());
            each_wall(design.walls, nodes, start, |wall| wall.offsets.clone())
        }
        ParametrisationName::BSpline => {
            let spline = BSpline::new(design.control_points, section, design.bound)?;
            let points = spline.clone();
            each_wall(design.walls, spline.as_polygon(polygon.as_ref()), start, |wall| points.fitted(wall))
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
