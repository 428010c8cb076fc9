//! The flow around shapes on the points of a grid, `output.grid`.

use super::around_shapes::AroundShapes;
use crate::io::grid_file::write_grid;
use crate::io::vtk::Image;
use crate::io::FileError;
use crate::sph::cloud::nearest::Nearest;
use crate::sph::cloud::placing::Polygon;
use crate::sph::cloud::problem::Solution;
use std::path::Path;

impl AroundShapes {
    /// Writes velocity, pressure and temperature at the points i L / N of the grid, if the configuration has one: the fit of the nearest
    /// particle, f + r.grad f + r.(grad grad f).r / 2; not a number inside of shapes. Returns whether there is one.
    ///
    /// # Errors
    /// HDF5's and the system's.
    pub fn write_grid(&self, folder: &Path, solution: &Solution, time: f64) -> Result<bool, FileError> {
        let (config, cloud, shaped) = (self.config(), &self.flow.cloud, &solution.shaped);
        let [nx, ny] = config.output.grid[..] else { return Ok(false) };
        let (plane, size) = (cloud.ground.plane, &config.region.size);
        let places: Vec<[f64; 2]> =
            (0..cloud.particles()).map(|i| plane.wrapped([shaped.position[0][i], shaped.position[1][i]])).collect();
        let nearest = Nearest::new(plane, 2.0 * config.resolution.dx, &places);
        let outlines = cloud.ground.outlines.iter().zip(&shaped.numbers);
        let shapes: Vec<Polygon> =
            outlines.map(|(outline, numbers)| Polygon::of(&outline.points(&outline.samples(8), numbers))).collect();
        let equations = cloud.equations(shaped);
        let count = if config.initial.temperature.is_some() { 4 } else { 3 };
        let mut fields = vec![Vec::with_capacity(nx * ny); count];
        for k in 0..nx * ny {
            let p = [(k / ny) as f64 * size[0] / nx as f64, (k % ny) as f64 * size[1] / ny as f64];
            let found = nearest.one(p, f64::INFINITY).filter(|_| !shapes.iter().any(|shape| shape.covers(&plane, p)));
            for (f, to) in fields.iter_mut().enumerate() {
                let value = found.map_or(f64::NAN, |(_, i)| {
                    let d = shaped.operators.derivatives(&equations.stencils, i, &solution.state.fields[f]);
                    let [x, y] = plane.between(places[i], p);
                    solution.state.fields[f][i]
                        + d[0] * x
                        + d[1] * y
                        + 0.5 * (d[2] * x + d[3] * y) * x
                        + 0.5 * (d[3] * x + d[4] * y) * y
                });
                to.push(value);
            }
        }
        fields[2].iter_mut().for_each(|p| *p *= config.fluid.density);
        fields[3..].iter_mut().flatten().for_each(|t| *t += config.fluid.inlet_temperature);
        let mut scalars = vec![("pressure", fields[2].as_slice())];
        scalars.extend(fields.get(3).map(|temperature| ("temperature", temperature.as_slice())));
        write_grid(folder, &Image { shape: &[nx, ny], size, time, velocity: &fields[..2], scalars: &scalars })?;
        Ok(true)
    }
}
