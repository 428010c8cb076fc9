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
    let speeds: Vec<Vec<f64>> = panels.iter().map(|(_, fields)| speeds(fields)).collect();
    let fastest = speeds.iter().flatten().copied().fold(1e-6, f64::max);
    plot_particles(folder, config, panels, ("flow", "speed |u| (scene units)"), speeds, (0.0, fastest))
}

/// `NAME.png` and `.svg` of any scene: particles coloured by values `[N]`, as far as they reach; of a scene in three dimensions
/// those whose height z is that of the middle, to half a spacing.
pub fn plot_scene(
    folder: &Path,
    (name, label, title): (&str, &str, &str),
    fields: &ParticleFields,
    values: &[f64],
    dx: f64,
) -> anyhow::Result<()> {
    let n = fields.tag.len();
    let row = |d: usize| &fields.position[d * n..(d + 1) * n];
    let ends = |d: usize| row(d).iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &x| (a.min(x), b.max(x)));
    let shown: Vec<usize> = match fields.dimension {
        2 => (0..n).collect(),
        _ => {
            let (low, high) = ends(2);
            let middle = 0.5 * (low + high);
            // Of an even number of layers the upper one of the middle two.
            (0..n).filter(|&i| (-0.25 * dx..0.75 * dx).contains(&(row(2)[i] - middle))).collect()
        }
    };
    let position: Vec<f64> = (0..2).flat_map(|d| shown.iter().map(move |&i| row(d)[i])).collect();
    let tag: Vec<u8> = shown.iter().map(|&i| fields.tag[i]).collect();
    let shown: Vec<f64> = shown.iter().map(|&i| values[i]).collect();
    let of_fluid =
        shown.iter().zip(&tag).filter(|(_, tag)| **tag == crate::particles::tag::FLUID).map(|(value, _)| *value);
    let (low, high) = of_fluid.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    let range = if low < high { (low, high) } else { (low, low + low.abs().max(1.0)) };
    let panel = TemperaturePanel { title, position: &position, temperature: &shown, tag: &tag, diameter: dx };
    let wide = |d: usize| {
        let (low, high) = ends(d);
        (low - 0.5 * dx, high + 0.5 * dx)
    };
    colored_particles(&folder.join(name), label, &[panel], range, wide(0), wide(1))?;
    Ok(())
}

/// Of every particle.
pub fn speeds(fields: &ParticleFields) -> Vec<f64> {
    let n = fields.tag.len();
    let square = |i: usize| fields.velocity.iter().skip(i).step_by(n).map(|u| u * u).sum::<f64>();
    (0..n).map(|i| square(i).sqrt()).collect()
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
