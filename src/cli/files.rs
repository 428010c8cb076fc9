//! The files of a run.

use crate::config::scene::Config;
use crate::design::diagnostics::Diagnostics;
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::write_columns;
use crate::report::memory::peak_memory_bytes;
use crate::report::plots::{colored_particles, TemperaturePanel};
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
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
        "body_force": found.body_force,
        "pumping_power": found.pumping_power,
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

/// `temperature.png` and `.svg`: particles coloured by temperature, panel by panel.
pub fn plot_temperature(folder: &Path, config: &Config, panels: &[(&str, &ParticleFields)]) -> anyhow::Result<()> {
    let (low, high) = (config.fluid.inlet_temperature, config.wall.hot_temperature);
    // Equal temperatures are a fair question (does nothing happen?) but no range of colours.
    let high = if high == low { low + low.abs().max(1.0) * 1e-6 } else { high };
    let temperatures = panels.iter().map(|(_, fields)| fields.temperature.clone().unwrap_or_default()).collect();
    let range = (low.min(high), low.max(high));
    plot_particles(folder, config, panels, ("temperature", "temperature T (scene units)"), temperatures, range)
}

/// `flow.png` and `.svg`: particles coloured by speed, panel by panel.
pub fn plot_flow(folder: &Path, config: &Config, panels: &[(&str, &ParticleFields)]) -> anyhow::Result<()> {
    let speed = |fields: &ParticleFields| -> Vec<f64> {
        let n = fields.tag.len();
        let square = |i: usize| fields.velocity.iter().skip(i).step_by(n).map(|u| u * u).sum::<f64>();
        (0..n).map(|i| square(i).sqrt()).collect()
    };
    let speeds: Vec<Vec<f64>> = panels.iter().map(|(_, fields)| speed(fields)).collect();
    let fastest = speeds.iter().flatten().copied().fold(1e-6, f64::max);
    plot_particles(folder, config, panels, ("flow", "speed |u| (scene units)"), speeds, (0.0, fastest))
}

/// `NAME.png` and `.svg`: particles coloured by values `[N]` of each panel.
fn plot_particles(
    folder: &Path,
    config: &Config,
    panels: &[(&str, &ParticleFields)],
    (name, label): (&str, &str),
    values: Vec<Vec<f64>>,
    range: (f64, f64),
) -> anyhow::Result<()> {
    let dx = config.resolution.dx;
    let rows = config.channel.wall_rows as f64 * dx;
    let y = || panels.iter().flat_map(|(_, f)| &f.position[f.tag.len()..]);
    let below = y().fold(-rows, |low, &y| low.min(y - 0.5 * dx));
    let above = y().fold(config.channel.height + rows, |high, &y| high.max(y + 0.5 * dx));
    let panels: Vec<TemperaturePanel> = panels
        .iter()
        .zip(&values)
        .map(|((title, f), values)| TemperaturePanel {
            title,
            position: &f.position,
            temperature: values,
            tag: &f.tag,
            diameter: dx,
        })
        .collect();
    colored_particles(&folder.join(name), label, &panels, range, (0.0, config.channel.length), (below, above))?;
    Ok(())
}
