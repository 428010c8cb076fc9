//! The files of a run.

use super::machine;
use crate::config::scene::Config;
use crate::design::shape::Shape;
use crate::design::Parametrisation;
use crate::error::Error;
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::{write_columns, Cell};
use crate::io::vtk::write_surface;
use crate::report::plots::{colored_particles, fields, relief, Field, FieldPanel, ReliefPanel, TemperaturePanel};
use crate::scene::field_map::FieldMap;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::record::Record;
use serde_json::{json, Value};
use std::io::Write;
use std::path::Path;

pub use crate::report::VERSION;

/// Writes `config.toml`: the resolved configuration.
pub fn write_config(folder: &Path, loaded: &Loaded) -> anyhow::Result<()> {
    Ok(write_bytes_atomically(&folder.join("config.toml"), loaded.text.as_bytes())?)
}

/// Prints a long text. A closed pipe is not an error, as in `hydrograd scenes heated-channel | head`.
pub fn print(text: &[u8]) -> std::io::Result<()> {
    match std::io::stdout().write_all(text) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Reads the configuration that [`write_config`] wrote to a run's folder.
pub fn read_config(folder: &Path) -> Result<Loaded, Error> {
    Config::load(Some(&folder.join("config.toml").to_string_lossy()), None, &[])
}

pub const CHECKPOINT: &str = "checkpoint.safetensors";

/// Folders of the frames of an optimisation's first and best design.
pub const BEFORE: &str = "particles-before";
pub const AFTER: &str = "particles";

/// The configuration with an optimisation's best wall; `config.toml` has the start of the search.
pub const BEST: &str = "best.toml";

/// Writes `shape.csv`: x (and z of a wall that varies along z), and columns of heights there.
pub fn write_shape(folder: &Path, wall: &Shape, columns: &[(&str, &[f64])]) -> anyhow::Result<()> {
    let mut all = vec![("x", wall.nodes.as_slice())];
    all.extend(wall.across.as_deref().map(|across| ("z", across)));
    all.extend_from_slice(columns);
    Ok(write_columns(&folder.join("shape.csv"), &all)?)
}

pub fn write_summary(folder: &Path, record: &Record) -> anyhow::Result<()> {
    write_json(&folder.join("summary.json"), &json!(record))
}

/// Writes the result of a command as a JSON file, and as the answer to `--json`.
pub fn write_json(path: &Path, found: &Value) -> anyhow::Result<()> {
    machine::answer(found);
    Ok(write_bytes_atomically(path, format!("{found:#}\n").as_bytes())?)
}

/// Plots `temperature.png` and `.svg`: particles coloured by temperature, in panels.
pub fn plot_temperature(folder: &Path, config: &Config, panels: &[(&str, &ParticleFields)]) -> anyhow::Result<()> {
    let (low, high) = (config.fluid.inlet_temperature, config.wall.hot_temperature);
    // Equal temperatures are valid but need a range of colours.
    let high = if high == low { low + low.abs().max(1.0) * 1e-6 } else { high };
    let temperatures = panels.iter().map(|(_, fields)| fields.temperature.clone().unwrap_or_default()).collect();
    let range = (low.min(high), low.max(high));
    plot_particles(folder, config, panels, ("temperature", TEMPERATURE), temperatures, range)
}

/// Plots `flow.png` and `.svg`: particles coloured by speed, in panels.
pub fn plot_flow(folder: &Path, config: &Config, panels: &[(&str, &ParticleFields)]) -> anyhow::Result<()> {
    let speeds: Vec<Vec<f64>> = panels.iter().map(|(_, fields)| speeds(fields)).collect();
    let fastest = speeds.iter().flatten().copied().fold(1e-6, f64::max);
    plot_particles(folder, config, panels, ("flow", SPEED), speeds, (0.0, fastest))
}

/// Labels of pictures.
pub const SPEED: &str = "speed |u| (scene units)";
pub const TEMPERATURE: &str = "temperature T (scene units)";

/// A cell of a table; empty without a value.
pub fn or_empty<T: Into<Cell>>(value: Option<T>) -> Cell {
    value.map_or_else(|| "".into(), Into::into)
}

const NO_RANGE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

fn widest(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Plots `NAME.png` and `.svg` for any scene: particles coloured by values `[N]`, in panels with the same colours.
pub fn plot_scene(
    folder: &Path,
    (name, label): (&str, &str),
    panels: &[(&str, &ParticleFields)],
    values: &[Vec<f64>],
    dx: f64,
) -> anyhow::Result<()> {
    let wide = |d: usize| {
        let (low, high) = panels.iter().map(|(_, fields)| ends(fields, d)).fold(NO_RANGE, widest);
        (low - 0.5 * dx, high + 0.5 * dx)
    };
    draw((&folder.join(name), label), panels, values, dx, None, wide(0), wide(1))
}

/// Plots `flow.png`, and `temperature.png` where there is heat, for any scene. Returns whether there is heat.
pub fn plot_flow_and_heat(folder: &Path, panels: &[(&str, &ParticleFields)], dx: f64) -> anyhow::Result<bool> {
    let speeds: Vec<Vec<f64>> = panels.iter().map(|(_, fields)| speeds(fields)).collect();
    plot_scene(folder, ("flow", SPEED), panels, &speeds, dx)?;
    let temperatures: Option<Vec<Vec<f64>>> = panels.iter().map(|(_, fields)| fields.temperature.clone()).collect();
    let Some(temperatures) = temperatures else { return Ok(false) };
    plot_scene(folder, ("temperature", TEMPERATURE), panels, &temperatures, dx)?;
    Ok(true)
}

/// Plots the flow of fixed particles as fields: `flow.png` with streamlines, `temperature.png` where there is heat, and `vorticity.png` if
/// asked for. Returns whether there is heat.
pub fn plot_maps(folder: &Path, panels: &[(&str, &FieldMap)], has_vorticity: bool) -> anyhow::Result<bool> {
    let plot = |name: &str, label: &str, is_signed: bool, of: &dyn for<'a> Fn(&'a FieldMap) -> Option<&'a Field>| {
        let all: Option<Vec<&Field>> = panels.iter().map(|(_, map)| of(map)).collect();
        let Some(all) = all else { return anyhow::Ok(false) };
        let (low, high) = all.iter().map(|field| field.range()).fold(NO_RANGE, widest);
        let most = low.abs().max(high.abs()).max(1e-300);
        let (low, high) = if is_signed { (-most, most) } else { (low, high) };
        // A uniform field is one colour, whatever its last digits are.
        let high = if high - low > 1e-9 * most { high } else { low + most };
        let drawn = panels.iter().zip(all).map(|((title, map), field)| FieldPanel {
            title,
            field,
            streamlines: &map.streamlines,
            walls: &map.walls,
        });
        fields(&folder.join(name), label, &drawn.collect::<Vec<_>>(), (low, high), is_signed)?;
        Ok(true)
    };
    plot("flow", SPEED, false, &|map| Some(&map.speed))?;
    if has_vorticity {
        plot("vorticity", "vorticity (scene units)", true, &|map| Some(&map.vorticity))?;
    }
    plot("temperature", TEMPERATURE, false, &|map| map.temperature.as_ref())
}

/// Plots `error.png`: where the error of a figure comes from. The colours end at what 99 of 100 cells do not exceed.
/// `density`: what each particle has of it, `[N]`.
pub fn plot_error(folder: &Path, figure: &str, map: &FieldMap, density: &[f64]) -> anyhow::Result<()> {
    let field = &map.of_particles(density);
    let mut known: Vec<f64> = field.values.iter().copied().filter(|x| x.is_finite()).collect();
    known.sort_by(f64::total_cmp);
    let high = known.get(known.len() * 99 / 100).copied().unwrap_or(0.0).max(1e-300);
    let panel = FieldPanel { title: "steady", field, streamlines: &[], walls: &map.walls };
    let label = format!("error of {figure} per area");
    fields(&folder.join("error"), &label, &[panel], (0.0, high), false)?;
    Ok(())
}

/// Draws particles in panels, coloured by values `[N]`. Without a range of colours it is that of the fluid's values.
fn draw(
    (stem, label): (&Path, &str),
    panels: &[(&str, &ParticleFields)],
    values: &[Vec<f64>],
    dx: f64,
    colors: Option<(f64, f64)>,
    x: (f64, f64),
    y: (f64, f64),
) -> anyhow::Result<()> {
    let sections: Vec<_> = panels.iter().zip(values).map(|((_, fields), values)| section(fields, values, dx)).collect();
    let colors = colors.unwrap_or_else(|| {
        let all = sections.iter().flat_map(|(_, values, tags)| values.iter().zip(tags));
        let fluid = all.filter(|(_, tag)| **tag == crate::particles::tag::FLUID);
        let (low, high) = fluid.fold(NO_RANGE, |range, (&x, _)| widest(range, (x, x)));
        if low < high {
            (low, high)
        } else {
            (low, low + low.abs().max(1.0))
        }
    });
    let sizes: Vec<Option<Vec<f64>>> = panels.iter().map(|(_, fields)| sizes(fields)).collect();
    let drawn = panels.iter().zip(&sections).zip(&sizes).map(|(((title, _), (position, temperature, tag)), sizes)| {
        let diameters = sizes.as_deref();
        TemperaturePanel { title, position, temperature, tag, diameter: dx, diameters }
    });
    colored_particles(stem, label, &drawn.collect::<Vec<_>>(), colors, x, y)?;
    Ok(())
}

/// The size of each particle in two dimensions, by its mass, if some are twice as large as others.
fn sizes(fields: &ParticleFields) -> Option<Vec<f64>> {
    if fields.dimension != 2 {
        return None;
    }
    let of = |(mass, density): (&f64, &f64)| (mass / density).sqrt();
    let sizes: Vec<f64> = fields.mass.iter().zip(&fields.density).map(of).collect();
    let (least, most) = sizes.iter().fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
    (sizes.iter().all(|x| x.is_finite()) && most > 2.0 * least).then_some(sizes)
}

/// Positions `[2, N]`, values and tags of the particles of a picture: all, or in three dimensions those within half a
/// spacing of the middle of z.
fn section(fields: &ParticleFields, values: &[f64], dx: f64) -> (Vec<f64>, Vec<f64>, Vec<u8>) {
    let n = fields.tag.len();
    let shown: Vec<usize> = match fields.dimension {
        2 => (0..n).collect(),
        _ => {
            let (low, high) = ends(fields, 2);
            let middle = 0.5 * (low + high);
            // Of an even number of layers it is the upper one of the middle two.
            let is_near = |i: usize| (-0.25 * dx..0.75 * dx).contains(&(fields.position[2 * n + i] - middle));
            (0..n).filter(|&i| is_near(i)).collect()
        }
    };
    let position = (0..2).flat_map(|d| shown.iter().map(move |&i| fields.position[d * n + i])).collect();
    (position, shown.iter().map(|&i| values[i]).collect(), shown.iter().map(|&i| fields.tag[i]).collect())
}

/// Smallest and largest coordinate of all particles.
fn ends(fields: &ParticleFields, d: usize) -> (f64, f64) {
    let n = fields.tag.len();
    fields.position[d * n..(d + 1) * n].iter().fold(NO_RANGE, |range, &x| widest(range, (x, x)))
}

/// Plots `NAME.png` and `.svg`: walls over x and z, in panels.
pub fn plot_relief(folder: &Path, name: &str, config: &Config, walls: &[(&str, &Shape)]) -> anyhow::Result<()> {
    let channel = &config.channel;
    let (z, count) =
        walls.first().map_or((vec![], 0), |(_, wall)| (wall.across.clone().unwrap_or_default(), wall.nodes.len()));
    // Points along x at the first z come first.
    let along = z.iter().take_while(|&&other| other == z[0]).count().max(1);
    let panels: Vec<ReliefPanel> =
        walls.iter().map(|(title, wall)| ReliefPanel { title, heights: &wall.offsets }).collect();
    // A flat wall needs a range of colours.
    let most = walls.iter().flat_map(|(_, wall)| &wall.offsets).fold(1e-6, |most: f64, height| most.max(height.abs()));
    let (x, z) = ((channel.hot_from, channel.hot_to, along), (0.0, channel.span, count / along));
    relief(&folder.join(name), &panels, most, x, z)?;
    Ok(())
}

/// Writes `wall.vtp` for ParaView: the surface of a lower wall over x and z with its height above the plane channel's,
/// two squares per spacing.
pub fn write_wall(folder: &Path, config: &Config, wall: &dyn Parametrisation, variables: &[f64]) -> anyhow::Result<()> {
    let half = 0.5 * config.resolution.dx;
    let (along, across) = (2 * config.columns() + 1, 2 * config.layers() + 1);
    let place = |k: usize| ((k % along) as f64 * half, (k / along) as f64 * half);
    let heights: Vec<f64> = (0..along * across).map(place).map(|(x, z)| wall.height(variables, x, z)).collect();
    let points: Vec<[f64; 3]> = (0..).map(place).zip(&heights).map(|((x, z), &y)| [x, y, z]).collect();
    let squares = (0..across - 1).flat_map(|k| (0..along - 1).map(move |i| k * along + i));
    let corners: Vec<[usize; 4]> = squares.map(|k| [k, k + 1, k + along + 1, k + along]).collect();
    Ok(write_surface(&folder.join("wall.vtp"), &points, &corners, &[("height", &heights)])?)
}

/// The speed of every particle.
pub fn speeds(fields: &ParticleFields) -> Vec<f64> {
    let n = fields.tag.len();
    let square = |i: usize| fields.velocity.iter().skip(i).step_by(n).map(|u| u * u).sum::<f64>();
    (0..n).map(|i| square(i).sqrt()).collect()
}

/// Plots `NAME.png` and `.svg`: particles coloured by the values `[N]` of each panel.
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
    let y = || panels.iter().flat_map(|(_, f)| &f.position[f.tag.len()..2 * f.tag.len()]);
    let below = y().fold(-rows, |low, &y| low.min(y - 0.5 * dx));
    let above = y().fold(config.channel.height + rows, |high, &y| high.max(y + 0.5 * dx));
    let (x, y) = ((0.0, config.channel.length), (below, above));
    draw((&folder.join(name), label), panels, &values, dx, Some(range), x, y)
}
