//! A state as plain numbers, for files and plots.

use crate::adjoint::RunError;
use crate::config::scene::Config;
use crate::io::state_file::{write_state, State};
use crate::io::vtk::ParticleFrame;
use crate::io::FileError;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use std::path::Path;

/// The fields of a state in f64, including those of wall particles.
pub struct ParticleFields {
    pub dimension: usize,
    pub box_size: Vec<f64>,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    /// None without heat.
    pub temperature: Option<Vec<f64>>,
    pub density: Vec<f64>,
    pub pressure: Vec<f64>,
    pub mass: Vec<f64>,
    pub tag: Vec<u8>,
    pub time: f64,
    pub step: usize,
}

impl ParticleFields {
    pub fn of<R: Sweeps>(solver: &mut Solver<R>) -> Result<Self, RunError> {
        solver.look()?;
        let model = solver.model.clone();
        let (n, l) = (model.particles(), model.rows);
        let rows = |from: usize, count: usize| -> Vec<f64> {
            solver.state[from * n..(from + count) * n].iter().map(|x| x.f64()).collect()
        };
        let plain = |numbers: &[R]| -> Vec<f64> { numbers.iter().map(|x| x.f64()).collect() };
        let (looked, kept) = (&solver.looked, model.has_wall_values());
        let density = plain(&looked.density);
        Ok(Self {
            dimension: l.dimension,
            box_size: model.domain.size[..l.dimension].to_vec(),
            position: rows(0, l.dimension),
            velocity: if kept { rows(l.velocity(), l.dimension) } else { plain(&looked.velocity) },
            temperature: model.heat.as_ref().zip(l.temperature()).map(|(heat, row)| {
                let found = if kept { rows(row, 1) } else { plain(&looked.temperature) };
                found.into_iter().map(|t| t + heat.reference).collect()
            }),
            pressure: density.iter().map(|&rho| model.equation_of_state.pressure(rho)).collect(),
            density,
            mass: (0..n).map(|i| solver.mass(i)).collect(),
            tag: model.tags.clone(),
            time: solver.step as f64 * model.dt,
            step: solver.step,
        })
    }

    /// Some of the particles.
    pub fn some(&self, particles: &[usize]) -> Self {
        let n = self.tag.len();
        let of = |field: &[f64]| -> Vec<f64> {
            field.chunks_exact(n).flat_map(|row| particles.iter().map(|&i| row[i])).collect()
        };
        Self {
            position: of(&self.position),
            velocity: of(&self.velocity),
            temperature: self.temperature.as_deref().map(of),
            density: of(&self.density),
            pressure: of(&self.pressure),
            mass: of(&self.mass),
            tag: particles.iter().map(|&i| self.tag[i]).collect(),
            box_size: self.box_size.clone(),
            ..*self
        }
    }

    /// Calls `f` with these fields as a ParaView frame.
    pub fn with_frame<T>(&self, f: impl FnOnce(&ParticleFrame) -> T) -> T {
        self.with_frame_and(&[], f)
    }

    /// The same, with more fields of scalars.
    pub fn with_frame_and<T>(&self, more: &[(&str, &[f64])], f: impl FnOnce(&ParticleFrame) -> T) -> T {
        let mut scalars: Vec<(&str, &[f64])> = more.to_vec();
        scalars.extend(self.temperature.as_deref().map(|temperature| ("temperature", temperature)));
        scalars.extend([("density", self.density.as_slice()), ("pressure", &self.pressure)]);
        f(&ParticleFrame {
            dimension: self.dimension,
            time: self.time,
            position: &self.position,
            velocity: &self.velocity,
            scalars: &scalars,
            tag: &self.tag,
            number: &[],
        })
    }

    /// Writes `state.h5`, with the text of the configuration.
    pub fn write(&self, folder: &Path, config: &Config, text: &str) -> Result<(), FileError> {
        let state = State {
            dimension: self.dimension,
            position: self.position.clone(),
            velocity: Some(self.velocity.clone()),
            temperature: self.temperature.clone(),
            density: Some(self.density.clone()),
            pressure: Some(self.pressure.clone()),
            mass: Some(self.mass.clone()),
            tag: Some(self.tag.clone()),
            time: self.time,
            step: self.step as u64,
            box_size: self.box_size.clone(),
            dx: config.resolution.dx,
            configuration: text.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            seed: config.run.seed,
        };
        write_state(&folder.join("state.h5"), &state)
    }
}
