//! The flow around shapes on the points of a grid, `output.grid`.

use super::around_shapes::{no_solution, AroundShapes};
use super::history::Derivative;
use crate::error::Error;
use crate::io::grid_file::write_grid;
use crate::io::vtk::Image;
use crate::io::FileError;
use crate::sph::cloud::equations::Bar;
use crate::sph::cloud::figures::Measures;
use crate::sph::cloud::interpolation::{Interpolation, Sample};
use crate::sph::cloud::particles::Shaped;
use crate::sph::cloud::problem::Solution;
use std::path::Path;

impl AroundShapes {
    /// What each point i L / N of `output.grid` is interpolated from (see [`Interpolation`]); none inside of shapes.
    fn grid_samples(&self, shaped: &Shaped) -> Vec<Option<Sample>> {
        let [nx, ny] = self.config().output.grid[..] else { return vec![] };
        let size = &self.config().region.size;
        let interpolation = Interpolation::new(&self.flow.cloud, shaped);
        let place = |k: usize| [(k / ny) as f64 * size[0] / nx as f64, (k % ny) as f64 * size[1] / ny as f64];
        (0..nx * ny).map(|k| interpolation.sample(place(k))).collect()
    }

    /// The fields of a flow on the grid, `[fields][points]`; not a number inside of shapes.
    fn fields_on_grid(&self, solution: &Solution, count: usize) -> Vec<Vec<f64>> {
        let shaped = &solution.shaped;
        let d = self.flow.solver.equations.derivatives(&shaped.operators, &solution.state, true);
        let samples = self.grid_samples(shaped);
        let of = |f: usize| {
            let value = |sample: &Sample| sample.value(&shaped.position, &solution.state.fields[f], &d.0[f]);
            samples.iter().map(|sample| sample.as_ref().map_or(f64::NAN, value)).collect()
        };
        (0..count).map(of).collect()
    }

    /// Writes velocity, pressure and temperature on the grid, if the configuration has one. Returns whether it has.
    ///
    /// # Errors
    /// HDF5's and the system's.
    pub fn write_grid(&self, folder: &Path, solution: &Solution, time: f64) -> Result<bool, FileError> {
        let config = self.config();
        let (shape, size) = (&config.output.grid[..], &config.region.size);
        if shape.is_empty() {
            return Ok(false);
        }
        let mut fields = self.fields_on_grid(solution, if config.initial.temperature.is_some() { 4 } else { 3 });
        fields[2].iter_mut().for_each(|p| *p *= config.fluid.density);
        fields[3..].iter_mut().flatten().for_each(|t| *t += config.fluid.inlet_temperature);
        let mut scalars = vec![("pressure", fields[2].as_slice())];
        scalars.extend(fields.get(3).map(|temperature| ("temperature", temperature.as_slice())));
        write_grid(folder, &Image { shape, size, time, velocity: &fields[..2], scalars: &scalars })?;
        Ok(true)
    }

    /// The velocity of a flow on the grid, `[points, 2]`.
    pub(super) fn grid_velocity(&self, solution: &Solution) -> Option<Vec<f64>> {
        let fields = (!self.config().output.grid.is_empty()).then(|| self.fields_on_grid(solution, 2))?;
        Some(fields[0].iter().zip(&fields[1]).flat_map(|(u, v)| [*u, *v]).collect())
    }

    /// Adds the cotangents of a flow with all its derivatives, given those of its velocity on the grid, `[points, 2]`.
    pub(super) fn grid_velocity_back(&self, solution: &Solution, by: &[f64], bar: &mut Bar) {
        let at = self.flow.at(solution);
        for (sample, by) in self.grid_samples(&solution.shaped).iter().zip(by.chunks_exact(2)) {
            for (field, &by) in by.iter().enumerate() {
                if let Some(sample) = sample.as_ref().filter(|_| by != 0.0) {
                    Measures::sampled_back(sample, &at, field, by, bar);
                }
            }
        }
    }

    /// The derivative of the sum of a steady flow's velocities on the grid times `by`, `[points, 2]`.
    ///
    /// # Errors
    /// A transposed system that cannot be solved.
    pub fn grid_gradient(&mut self, solution: &Solution, by: &[f64]) -> Result<Derivative, Error> {
        let mut bar = Bar::new(self.flow.cloud.particles(), solution.shaped.area.len());
        self.grid_velocity_back(solution, by, &mut bar);
        let wanted = self.wanted.clone();
        let found = self.flow.pull_back(solution, bar, &wanted);
        Derivative::of_steady(self.config(), found.map_err(|why| no_solution(self.config(), &why))?)
    }
}
