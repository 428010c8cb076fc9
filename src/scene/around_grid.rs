//! The flow around shapes on the points of a grid, `output.grid`.

use super::around_shapes::AroundShapes;
use crate::io::grid_file::write_grid;
use crate::io::vtk::Image;
use crate::io::FileError;
use crate::sph::cloud::interpolation::{Interpolation, Sample};
use crate::sph::cloud::problem::Solution;
use std::path::Path;

impl AroundShapes {
    /// Writes velocity, pressure and temperature at the points i L / N of the grid, if the configuration has one (see
    /// [`Interpolation`]); not a number inside of shapes. Returns whether there is one.
    ///
    /// # Errors
    /// HDF5's and the system's.
    pub fn write_grid(&self, folder: &Path, solution: &Solution, time: f64) -> Result<bool, FileError> {
        let (config, cloud, shaped) = (self.config(), &self.flow.cloud, &solution.shaped);
        let [nx, ny] = config.output.grid[..] else { return Ok(false) };
        let size = &config.region.size;
        let interpolation = Interpolation::new(cloud, shaped);
        let d = self.flow.solver.equations.derivatives(&shaped.operators, &solution.state, true);
        let count = if config.initial.temperature.is_some() { 4 } else { 3 };
        let mut fields = vec![Vec::with_capacity(nx * ny); count];
        for k in 0..nx * ny {
            let p = [(k / ny) as f64 * size[0] / nx as f64, (k % ny) as f64 * size[1] / ny as f64];
            let sample = interpolation.sample(p);
            for (f, to) in fields.iter_mut().enumerate() {
                let value = |sample: Sample| sample.value(&shaped.position, &solution.state.fields[f], &d.0[f]);
                to.push(sample.map_or(f64::NAN, value));
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
