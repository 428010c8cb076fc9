//! Custom scenes of fixed particles in a box that is periodic along all axes, without shapes: a flow in time.

use super::particle_fields::ParticleFields;
use super::periodic_flow::{Gone, PeriodicFlow};
use crate::config::formula::Function;
use crate::config::scene::Config;
use crate::error::{BadInput, Error};
use crate::io::grid_file::{read_velocity, write_grid};
use crate::io::vtk::Image;
use crate::io::FileError;
use crate::particles::tag;
use crate::sph::lattice::equations::{Materials, State};
use crate::sph::lattice::march::Control;
use crate::sph::lattice::transform::resampled;
use crate::sph::laws::buoyancy::Buoyancy;
use std::path::Path;

/// The share of `method.tolerance` that the error of a step may be: derivatives are far more exact here than around shapes.
const SHARE: f64 = 1e-3;

/// The flow of a configuration, see [`Config::is_periodic_box`].
pub struct PeriodicBox {
    pub flow: PeriodicFlow,
    /// The fields at the start: velocity and temperature, `[N]` each.
    pub fields: Vec<Vec<f64>>,
    config: Config,
}

/// Figures of one time. Energies are means over the box, per mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time: f64,
    pub kinetic_energy: f64,
    /// What viscosity takes from it per time.
    pub dissipation: f64,
    pub mean_temperature: Option<f64>,
}

impl PeriodicBox {
    /// # Errors
    /// A file of the velocity that does not fit; formulas without a value.
    pub fn new(config: &Config) -> Result<Self, Error> {
        let (region, fluid, d) = (&config.region, &config.fluid, config.dimension());
        let shape: Vec<usize> = region.size.iter().map(|l| (l / config.resolution.dx).round() as usize).collect();
        let materials = Materials {
            viscosity: config.kinematic_viscosity(),
            diffusivity: config.initial.temperature.as_ref().map(|_| config.thermal_diffusivity()),
            force: region.acceleration.clone(),
            buoyancy: Buoyancy::new(
                fluid.expansion,
                &region.acceleration,
                fluid.reference_temperature.unwrap_or(fluid.inlet_temperature),
            ),
        };
        let derivatives = config.unsteady().map(|fixed| fixed.derivatives).unwrap_or_default();
        let flow = PeriodicFlow::new(&shape, &region.size, materials, derivatives)?;
        let mut all = Self { flow, fields: vec![], config: config.clone() };
        let (velocity, temperature) = config.initial.at_start(d)?;
        all.fields = match &config.initial.file {
            Some(file) => {
                let read = read_velocity(Path::new(file), d, Some(&shape));
                read.map_err(|error| BadInput::at("initial.file", error.to_string()))?.1
            }
            None if velocity.is_empty() => vec![vec![0.0; all.particles()]; d],
            None => velocity.iter().map(|function| all.at_places(|place| function.at(place))).collect(),
        };
        all.fields.extend(temperature.map(|function| all.at_places(|place| function.at(place))));
        if let Some(k) = all.fields.iter().position(|field| field.iter().any(|x| !x.is_finite())) {
            let key = match (&config.initial.file, k < d) {
                (Some(_), true) => "initial.file".to_string(),
                (None, true) => format!("initial.velocity[{k}]"),
                _ => "initial.temperature".to_string(),
            };
            return Err(BadInput::at(&key, format!("{key} is not finite everywhere")).allowed("finite numbers").into());
        }
        Ok(all)
    }

    pub fn config(&self) -> &Config {
        &self.config
    }

    pub fn particles(&self) -> usize {
        self.flow.equations.transform.points()
    }

    /// What a function is at the place of each particle, i dx.
    fn at_places(&self, of: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
        (0..self.particles()).map(|i| of(self.place(i))).collect()
    }

    fn place(&self, particle: usize) -> [f64; 3] {
        let (mut rest, mut place) = (particle, [0.0; 3]);
        let shape = &self.flow.equations.transform.shape;
        for a in (0..shape.len()).rev() {
            place[a] = (rest % shape[a]) as f64 * self.config.region.size[a] / shape[a] as f64;
            rest /= shape[a];
        }
        place
    }

    /// Goes on through `frames` evenly spaced times to the end, or only to it.
    ///
    /// # Errors
    /// A flow that diverges; [`Error::Stopped`].
    pub fn run(
        &self,
        frames: usize,
        watch: &mut dyn FnMut(&Moment, &State) -> Result<(), Error>,
    ) -> Result<Gone, Error> {
        let time = &self.config.time;
        let velocity = self.config.fluid.reference_velocity;
        let control = Control {
            tolerance: SHARE * self.config.unsteady().map_or(1.0, |fixed| fixed.tolerance),
            velocity,
            temperature: self.flow.scales(&self.fields, time.end).1,
            fixed: time.step,
        };
        let count = frames.max(1);
        let stops: Vec<f64> = (1..=count).map(|k| time.end * k as f64 / count as f64).collect();
        self.flow.run(&self.fields, &stops, &control, &mut |time, state| watch(&self.moment(time, state), state))
    }

    pub fn moment(&self, time: f64, state: &State) -> Moment {
        let equations = &self.flow.equations;
        Moment {
            time,
            kinetic_energy: equations.energy(state),
            dissipation: equations.dissipation(state),
            mean_temperature: state.get(equations.dimension()).map(|t| t[0].re / self.particles() as f64),
        }
    }

    /// A state as plain numbers.
    pub fn particle_fields(&self, time: f64, step: usize, state: &State) -> ParticleFields {
        let (equations, d, n) = (&self.flow.equations, self.flow.equations.dimension(), self.particles());
        let density = self.config.fluid.density;
        let mut fields = equations.at_particles(state);
        let temperature = if fields.len() > d { fields.pop() } else { None };
        ParticleFields {
            dimension: d,
            box_size: self.config.region.size.clone(),
            position: (0..d).flat_map(|a| self.at_places(|place| place[a])).collect(),
            velocity: fields.concat(),
            temperature,
            density: vec![density; n],
            pressure: equations.pressure(state).iter().map(|p| density * p).collect(),
            mass: vec![density * equations.dx.powi(d as i32); n],
            tag: vec![tag::FLUID; n],
            time,
            step,
        }
    }

    /// Root mean square of the errors of velocity, over `fluid.reference_velocity`, and temperature, where the configuration
    /// states what they are.
    ///
    /// # Errors
    /// Formulas that cannot be read.
    pub fn errors(&self, fields: &ParticleFields) -> Result<(Option<f64>, Option<f64>), BadInput> {
        let (velocity, temperature) = self.config.exact.of_time(fields.dimension)?;
        let n = self.particles();
        let square = |function: &Function, found: &[f64]| -> f64 {
            let exact = self.at_places(|place| function.at_time(place, fields.time));
            exact.iter().zip(found).map(|(exact, found)| (found - exact).powi(2)).sum::<f64>() / n as f64
        };
        let of_velocity =
            || velocity.iter().zip(fields.velocity.chunks_exact(n)).map(|(f, u)| square(f, u)).sum::<f64>();
        let by = self.config.fluid.reference_velocity;
        let of_temperature = temperature.as_ref().zip(fields.temperature.as_ref()).map(|(f, t)| square(f, t).sqrt());
        Ok(((!velocity.is_empty()).then(|| of_velocity().sqrt() / by), of_temperature))
    }

    /// Writes the fields on the grid of `output.grid`, if there is one.
    ///
    /// # Errors
    /// HDF5's and the system's.
    pub fn write_grid(&self, folder: &Path, fields: &ParticleFields) -> Result<bool, FileError> {
        let grid = &self.config.output.grid;
        if grid.is_empty() {
            return Ok(false);
        }
        let on_grid = |field: &[f64]| resampled(field, &self.flow.equations.transform.shape, grid);
        let velocity: Vec<Vec<f64>> = fields.velocity.chunks_exact(self.particles()).map(on_grid).collect();
        let pressure = on_grid(&fields.pressure);
        let temperature = fields.temperature.as_deref().map(on_grid);
        let mut scalars = vec![("pressure", pressure.as_slice())];
        scalars.extend(temperature.as_deref().map(|temperature| ("temperature", temperature)));
        let (size, velocity) = (&self.config.region.size, &velocity);
        write_grid(folder, &Image { shape: grid, size, time: fields.time, velocity, scalars: &scalars })?;
        Ok(true)
    }
}
