//! The files of a run.

use crate::config::scene::Config;
use crate::design::diagnostics::Diagnostics;
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::{write_columns, write_table, Cell};
use crate::io::state_file::{write_state, State};
use crate::io::vtk::ParticleFrame;
use crate::report::memory::peak_memory_bytes;
use crate::report::plots::{temperature_particles, TemperaturePanel};
use crate::scene::load::Loaded;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use serde_json::{json, Map, Value};
use std::path::Path;

pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// `config.toml`: the resolved configuration.
pub fn write_config(folder: &Path, loaded: &Loaded) -> anyhow::Result<()> {
    Ok(write_bytes_atomically(&folder.join("config.toml"), loaded.text.as_bytes())?)
}

/// `shape.csv`: x, offset and further columns.
pub fn write_shape(folder: &Path, nodes: &[f64], columns: &[(&str, &[f64])]) -> anyhow::Result<()> {
    let mut all = vec![("x", nodes)];
    all.extend_from_slice(columns);
    Ok(write_columns(&folder.join("shape.csv"), &all)?)
}

/// What every `summary.json` begins with.
pub fn summary(loaded: &Loaded, found: &Diagnostics, steps: usize, wall_seconds: f64) -> Map<String, Value> {
    let Value::Object(map) = json!({
        "q": found.q,
        "flow_rate": found.flow_rate,
        "mean_outlet_temperature": found.mean_outlet_temperature,
        "wall_heat_flux": found.wall_heat_flux,
        "stored_heat_rate": found.stored_heat_rate,
        "energy_imbalance": found.energy_imbalance,
        "mean_density": found.mean_density,
        "u_max": found.u_max,
        "q_sum": found.q / loaded.config.resolution.dx,
        "steps": steps,
        "time_step": loaded.config.time_step(),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory_bytes(),
        "version": VERSION,
        "seed": loaded.config.run.seed,
        "precision": loaded.config.run.precision,
        "scene": loaded.config.scene,
    }) else {
        unreachable!("a JSON object")
    };
    map
}

/// `summary.json`.
pub fn write_summary(folder: &Path, map: Map<String, Value>) -> anyhow::Result<()> {
    let mut text = serde_json::to_string_pretty(&Value::Object(map))?;
    text.push('\n');
    Ok(write_bytes_atomically(&folder.join("summary.json"), text.as_bytes())?)
}

/// A table of numbers.
pub fn write_numbers(path: &Path, header: &[&str], rows: &[Vec<f64>]) -> anyhow::Result<()> {
    let rows: Vec<Vec<Cell>> = rows.iter().map(|row| row.iter().map(|&x| Cell::from(x)).collect()).collect();
    Ok(write_table(path, header, &rows)?)
}

/// A state as plain f64 fields, walls included.
pub struct Fields {
    pub dimension: usize,
    pub box_size: Vec<f64>,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    /// None where the scene has no heat.
    pub temperature: Option<Vec<f64>>,
    pub density: Vec<f64>,
    pub pressure: Vec<f64>,
    pub mass: Vec<f64>,
    pub tag: Vec<u8>,
    pub time: f64,
    pub step: usize,
}

impl Fields {
    /// Reads a run's present state; fills its primitives for that.
    pub fn of<R: Sweeps>(solver: &mut Solver<R>) -> Self {
        solver.look();
        let model = solver.model.clone();
        let (n, l) = (model.particles(), model.layout);
        let rows = |from: usize, count: usize| -> Vec<f64> {
            solver.state[from * n..(from + count) * n].iter().map(|x| x.f64()).collect()
        };
        let density: Vec<f64> = solver.primitives[..n].iter().map(|x| x.f64()).collect();
        Self {
            dimension: l.dimension,
            box_size: model.domain.size[..l.dimension].to_vec(),
            position: rows(0, l.dimension),
            velocity: rows(l.velocity(), l.dimension),
            temperature: model
                .heat
                .as_ref()
                .map(|heat| rows(l.temperature(), 1).into_iter().map(|t| t + heat.reference).collect()),
            pressure: density.iter().map(|&rho| model.equation_of_state.pressure(rho)).collect(),
            density,
            mass: if l.mass { rows(l.state_mass(), 1) } else { vec![model.mass; n] },
            tag: model.tags.clone(),
            time: solver.step as f64 * model.dt,
            step: solver.step,
        }
    }

    /// As a ParaView frame.
    pub fn with_frame<T>(&self, f: impl FnOnce(&ParticleFrame) -> T) -> T {
        let mut scalars: Vec<(&str, &[f64])> = Vec::new();
        scalars.extend(self.temperature.as_deref().map(|temperature| ("temperature", temperature)));
        scalars.extend([("density", self.density.as_slice()), ("pressure", &self.pressure)]);
        f(&ParticleFrame {
            dimension: self.dimension,
            time: self.time,
            position: &self.position,
            velocity: &self.velocity,
            scalars: &scalars,
            tag: &self.tag,
        })
    }

    /// `state.h5`.
    pub fn write(&self, folder: &Path, loaded: &Loaded) -> anyhow::Result<()> {
        let config = &loaded.config;
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
            configuration: loaded.text.clone(),
            version: VERSION.into(),
            seed: config.run.seed,
        };
        Ok(write_state(&folder.join("state.h5"), &state)?)
    }
}

/// `temperature.png` and `.svg`: particles coloured by temperature, panel by panel.
pub fn plot_temperature(folder: &Path, config: &Config, panels: &[(&str, &Fields)]) -> anyhow::Result<()> {
    let dx = config.resolution.dx;
    let rows = config.channel.wall_rows as f64 * dx;
    let below =
        panels.iter().flat_map(|(_, f)| &f.position[f.tag.len()..]).fold(-rows, |low, &y| low.min(y - 0.5 * dx));
    let panels: Vec<TemperaturePanel> = panels
        .iter()
        .map(|(title, f)| TemperaturePanel {
            title,
            position: &f.position,
            temperature: f.temperature.as_deref().unwrap_or(&[]),
            tag: &f.tag,
            diameter: dx,
        })
        .collect();
    let (low, high) = (config.fluid.inlet_temperature, config.wall.hot_temperature);
    // Equal temperatures are a fair question (does nothing happen?) but no range of colours.
    let high = if high == low { low + low.abs().max(1.0) * 1e-6 } else { high };
    let y_range = (below, config.channel.height + rows);
    temperature_particles(
        &folder.join("temperature"),
        &panels,
        low.min(high),
        low.max(high),
        (0.0, config.channel.length),
        y_range,
    )?;
    Ok(())
}
