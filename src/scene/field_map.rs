//! The flow of fixed particles as fields on a fine grid, for pictures.

use super::around_shapes::AroundShapes;
use crate::numerics::streamlines::streamlines;
use crate::report::plots::Field;
use crate::sph::cloud::interpolation::{Interpolation, Sample};
use crate::sph::cloud::problem::Solution;

/// Cells along the longer side.
const CELLS: f64 = 300.0;
/// Distance of streamlines, in the shorter side.
const SPACING: f64 = 1.0 / 22.0;
/// Streamlines end where the flow has this part of the largest speed.
const SLOWEST: f64 = 1e-4;

/// Fields between the walls, see [`Interpolation`].
#[derive(Debug, Clone, PartialEq)]
pub struct FieldMap {
    pub speed: Field,
    /// dv/dx - du/dy.
    pub vorticity: Field,
    pub temperature: Option<Field>,
    pub streamlines: Vec<Vec<[f64; 2]>>,
    /// Closed outlines of the shapes and of their periodic images.
    pub walls: Vec<Vec<[f64; 2]>>,
    /// The nearest particle of each cell; none inside of shapes.
    nearest: Vec<Option<usize>>,
}

impl FieldMap {
    /// What particles have, `[N]`, as a field: in each cell that of the nearest one.
    pub fn of_particles(&self, values: &[f64]) -> Field {
        let values = self.nearest.iter().map(|nearest| nearest.map_or(f64::NAN, |i| values[i])).collect();
        Field { cells: self.speed.cells, corners: self.speed.corners, values }
    }
}

impl AroundShapes {
    /// The fields of a flow.
    pub fn map(&self, solution: &Solution) -> FieldMap {
        let cloud = &self.flow.cloud;
        let (plane, shaped, state) = (cloud.ground.plane, &solution.shaped, &solution.state);
        let interpolation = Interpolation::new(cloud, shaped);
        let [low, high] = cloud.places.corners;
        let size = [high[0] - low[0], high[1] - low[1]];
        let cell = size[0].max(size[1]) / CELLS;
        let cells = size.map(|size| (size / cell).round().max(2.0) as usize);
        let middle = |k: usize| {
            [0, 1].map(|d| {
                let k = if d == 0 { k % cells[0] } else { k / cells[0] };
                low[d] + (k as f64 + 0.5) * size[d] / cells[d] as f64
            })
        };
        let samples: Vec<Option<Sample>> = (0..cells[0] * cells[1]).map(|k| interpolation.sample(middle(k))).collect();
        let d = self.flow.solver.equations.derivatives(&shaped.operators, state, true);
        let value = |sample: &Sample, f: usize| sample.value(&shaped.position, &state.fields[f], &d.0[f]);
        let slope = |sample: &Sample, f: usize| sample.slope(&shaped.position, &d.0[f]);
        let field = |of: &dyn Fn(&Sample) -> f64| {
            let values = samples.iter().map(|sample| sample.as_ref().map_or(f64::NAN, of)).collect();
            Field { cells, corners: [low, high], values }
        };
        let speed = field(&|sample| value(sample, 0).hypot(value(sample, 1)));
        let reference = self.config().fluid.inlet_temperature;
        let temperature = self.config().initial.temperature.is_some();
        let temperature = temperature.then(|| field(&|sample| reference + value(sample, 3)));
        let velocity = |p: [f64; 2]| {
            // A line ends at the end of the picture, also where that is periodic.
            let is_in = (0..2).all(|d| (low[d]..=high[d]).contains(&p[d]));
            let sample = is_in.then(|| interpolation.sample(p)).flatten()?;
            Some([value(&sample, 0), value(&sample, 1)])
        };
        let spacing = SPACING * size[0].min(size[1]);
        // Every few spacings a seed, so that flows on both sides of a wall have lines.
        let counts = size.map(|size| (size / (4.0 * spacing)).ceil() as usize);
        let seed = |k: usize, d: usize, at: usize| {
            low[d] + (at as f64 + 0.37 + 0.01 * k as f64 % 0.2) * size[d] / counts[d] as f64
        };
        let seeds: Vec<[f64; 2]> =
            (0..counts[0] * counts[1]).map(|k| [seed(k, 0, k % counts[0]), seed(k, 1, k / counts[0])]).collect();
        let least = SLOWEST * speed.range().1.max(1e-300);
        let outlines = cloud.ground.outlines.iter().zip(&shaped.numbers);
        let walls = outlines.flat_map(|(outline, numbers)| {
            let points: Vec<[f64; 2]> = outline.points(&outline.samples(16), numbers).iter().map(|p| p.place).collect();
            let image = move |by: [f64; 2]| points.iter().map(|p| [p[0] + by[0], p[1] + by[1]]).collect();
            plane.images().map(image).collect::<Vec<Vec<[f64; 2]>>>()
        });
        FieldMap {
            vorticity: field(&|sample| slope(sample, 1)[0] - slope(sample, 0)[1]),
            temperature,
            streamlines: streamlines(&velocity, &seeds, spacing, least),
            walls: walls.collect(),
            nearest: samples.iter().map(|sample| sample.map(|sample| sample.particle)).collect(),
            speed,
        }
    }
}
