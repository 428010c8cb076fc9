//! `hydrograd dataset inspect`: shows the content of a data set.

use super::arguments::at_least_one;
use super::files::TEMPERATURE;
use super::machine;
use super::page;
use super::run_folder::{Earlier, RunFolder};
use crate::dataset::store::{read_provenance, Store};
use crate::dataset::{kind, read_split, Metadata, Split, Trajectory};
use crate::error::BadInput;
use crate::io::hdf5_file::{failed, open};
use crate::particles::tag;
use crate::report::plots::{colored_particles, TemperaturePanel};
use crate::report::table::Table;
use crate::report::text::shown;
use clap::{Args, Subcommand};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What to do with a data set.
#[derive(Debug, Clone, Subcommand)]
pub enum DatasetCommand {
    Inspect(InspectArguments),
}

/// Print what a data set holds (trajectories, particles, statistics, heat, walls) and plot a few frames.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd dataset inspect data/heated
      a summary, and three frames of the first trajectory in data/heated/frames.png
  hydrograd dataset inspect 2D_TGV_2500_10kevery100 --split test --trajectory 3 --out pictures
      LagrangeBench's own data sets too")]
pub struct InspectArguments {
    /// A folder with train.h5, valid.h5, test.h5 and metadata.json.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The file that the plotted trajectory is in.
    #[arg(long, value_enum, default_value = "train")]
    pub split: Split,
    /// Its number in the file.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub trajectory: usize,
    /// Frames to plot, evenly spaced.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = at_least_one)]
    pub frames: usize,
    /// Folder for frames.png and frames.svg [default: DIR].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

const KINDS: [(i32, &str); 5] = [
    (kind::FLUID, "fluid"),
    (kind::SOLID_WALL, "solid wall"),
    (kind::MOVING_WALL, "moving wall"),
    (kind::RIGID_BODY, "rigid body"),
    (kind::PADDING, "padding"),
];

const KIND: &str = "dataset inspect";

pub fn inspect(arguments: InspectArguments) -> anyhow::Result<()> {
    let folder = &arguments.folder;
    let metadata = load_metadata(folder)?;
    let out = arguments.out.as_deref().unwrap_or(folder);
    let earlier = if out == folder { Earlier::Visited } else { Earlier::Replaced };
    RunFolder::check(out, KIND, earlier)?;
    print_metadata(folder, &metadata);
    let mut table = Table::new(["split", "trajectories", "frames", "particles", "temperature", "MB"]);
    let mut walls: BTreeMap<String, usize> = BTreeMap::new();
    let mut plotted = None;
    for split in Split::ALL {
        let path = split.path(folder);
        let mut trajectories = read_split(folder, &metadata, split).map_err(|e| BadInput::new(e.to_string()))?;
        let range = |values: Vec<usize>| match (values.iter().min(), values.iter().max()) {
            (Some(low), Some(high)) if low == high => low.to_string(),
            (Some(low), Some(high)) => format!("{low} ... {high}"),
            _ => "-".into(),
        };
        let temperatures = trajectories.iter().filter_map(|t| t.temperature.as_deref()).flatten();
        let (low, high) = temperatures.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &t| (l.min(t), h.max(t)));
        table.row(vec![
            split.name().into(),
            trajectories.len().to_string(),
            range(trajectories.iter().map(|t| t.frames).collect()),
            range(trajectories.iter().map(|t| t.particles).collect()),
            if low <= high { format!("{low:.3} ... {high:.3}") } else { "-".into() },
            format!("{:.1}", std::fs::metadata(&path).map_or(0, |file| file.len()) as f64 / 1e6),
        ]);
        for name in wall_names(&path, &trajectories)? {
            *walls.entry(name).or_default() += 1;
        }
        if split == arguments.split {
            if arguments.trajectory >= trajectories.len() {
                return Err(BadInput::new(format!("{} has no trajectory {}", path.display(), arguments.trajectory))
                    .place(format!("--trajectory {}", arguments.trajectory))
                    .allowed(format!("0 ... {}", trajectories.len().saturating_sub(1)))
                    .into());
            }
            plotted = Some(trajectories.swap_remove(arguments.trajectory));
        }
    }
    print!("\n{table}");
    machine::answer(&json!({ "metadata": metadata, "splits": table.to_json() }));
    let Some(trajectory) = plotted else { return Ok(()) };
    let count = |kind: i32| trajectory.kind.iter().filter(|other| **other == kind).count();
    let kinds = KINDS.iter().filter(|(kind, _)| count(*kind) > 0);
    let kinds: Vec<String> = kinds.map(|(kind, name)| format!("{} {name} ({kind})", count(*kind))).collect();
    println!("\nparticles           {}", kinds.join(", "));
    if let Some(set) = &trajectory.wall_temperature {
        println!("hot wall            {} particles of set temperature", set.iter().filter(|t| t.is_finite()).count());
    }
    if !walls.is_empty() {
        let walls: Vec<String> = walls.iter().map(|(name, count)| format!("{count} {}", shown(name))).collect();
        println!("walls               {}", walls.join(", "));
    }
    let _own = RunFolder::take(out, KIND, earlier)?;
    let picture = plot(out, &metadata, &trajectory, arguments.frames)?;
    // The plot is now part of the page of our data set.
    page::refresh(out)?;
    let (split, name) = (arguments.split.name(), shown(&trajectory.name));
    println!("{picture} of {split}/{name} in {}", out.join("frames.png").display());
    Ok(())
}

fn load_metadata(folder: &Path) -> Result<Metadata, BadInput> {
    let store = Store::new(folder);
    if let (false, Some(begun)) = (store.is_complete(), store.begun()?) {
        let (missing, all) = (store.missing(&begun.recipe).len(), begun.recipe.jobs().len());
        return Err(BadInput::new(format!("{} of {all} trajectories are there, not merged", all - missing))
            .place(folder.display().to_string())
            .allowed("a finished data set")
            .advice(match missing {
                0 => format!("hydrograd merge {}", folder.display()),
                _ => "the same `hydrograd generate` command again: it goes on where it was".into(),
            }));
    }
    Metadata::read(folder).map_err(|error| {
        BadInput::new(error.to_string())
            .place(folder.display().to_string())
            .allowed("a folder with metadata.json, train.h5, valid.h5 and test.h5")
            .advice("hydrograd generate makes one")
    })
}

fn print_metadata(folder: &Path, metadata: &Metadata) {
    let d = metadata.dim;
    let text = |key: &str| metadata.other.get(key).map(|value| shown(value.as_str().unwrap_or(&value.to_string())));
    let list = |values: &[f64]| values[..d].iter().map(|x| format!("{x:.4e}")).collect::<Vec<_>>().join(", ");
    println!("{}: {}", folder.display(), text("case").unwrap_or_else(|| "a data set".into()));
    let bounds: Vec<String> = metadata.bounds[..d].iter().map(|[low, high]| format!("{low} ... {high:.4}")).collect();
    let periodic: Vec<&str> = (0..d).map(|k| if metadata.periodic()[k] { "periodic" } else { "open" }).collect();
    println!("box                 {} ({})", bounds.join(" x "), periodic.join(", "));
    let (steps, dt) = (metadata.write_every, metadata.dt);
    println!("frames              {:.5} apart: {steps} steps of {dt:.4e}", dt * steps as f64);
    if let (Some(steps), Some(dt)) = (text("solver_steps_per_frame"), text("solver_dt")) {
        println!("                    run with {steps} steps of {dt}");
    }
    println!("spacing             {}   connectivity radius {:.4}", metadata.dx, metadata.default_connectivity_radius);
    let [mean, deviation] = [&metadata.vel_mean, &metadata.vel_std].map(|values| list(values));
    println!("velocity            mean {mean}   deviation {deviation}   per frame");
    println!("acceleration        mean {}   deviation {}", list(&metadata.acc_mean), list(&metadata.acc_std));
    if let Some(heat) = &metadata.heat {
        println!("temperature         mean {:.4}   deviation {:.4}", heat.temperature_mean, heat.temperature_std);
        println!("temperature change  mean {:.4e}   deviation {:.4e}   per frame", heat.change_mean, heat.change_std);
        println!(
            "heat                inlet {} at x < {}, measured at x = {}, diffusivity {:.5}",
            heat.inlet_temperature, heat.inlet_length, heat.target_x, heat.diffusivity
        );
    }
    if let (Some(seed), Some(version)) = (text("seed"), text("version")) {
        println!("made by             hydrograd {version}, seed {seed}");
    }
}

/// Names of the trajectories' walls without amplitudes; empty if the data set is not ours.
fn wall_names(path: &Path, trajectories: &[Trajectory]) -> anyhow::Result<Vec<String>> {
    let file = open(path, "data set")?;
    let mut names = Vec::new();
    for trajectory in trajectories {
        let group = file.group(&trajectory.name).map_err(failed(path, "open")(&trajectory.name))?;
        let Ok(provenance) = read_provenance(path, &group) else { continue };
        let name = provenance.wall.split(", amplitude").next().unwrap_or_default();
        names.extend((!name.is_empty()).then(|| name.to_string()));
    }
    Ok(names)
}

/// Writes `frames.png` and `frames.svg`, and returns what they show.
fn plot(out: &Path, metadata: &Metadata, trajectory: &Trajectory, count: usize) -> anyhow::Result<&'static str> {
    let (d, n, last) = (metadata.dim, trajectory.particles, trajectory.frames - 1);
    let count = count.min(trajectory.frames);
    let chosen: Vec<usize> = (0..count).map(|k| if count == 1 { last } else { k * last / (count - 1) }).collect();
    // A slice with a thickness of one spacing in three dimensions.
    let shown: Vec<usize> = (0..n)
        .filter(|&i| d == 2 || f64::from(trajectory.position[i * d + 2]) - metadata.bounds[2][0] < metadata.dx)
        .collect();
    let hot = |i: usize| trajectory.wall_temperature.as_ref().is_some_and(|set| set[i].is_finite());
    let tag_of = |&i: &usize| match trajectory.kind[i] {
        kind::FLUID => tag::FLUID,
        kind::MOVING_WALL => tag::MOVING_WALL,
        _ if hot(i) => tag::HOT_WALL,
        _ => tag::WALL,
    };
    let tags: Vec<u8> = shown.iter().map(tag_of).collect();
    let values = |frame: usize| -> Vec<f64> {
        match trajectory.temperature_of(frame) {
            Some(temperature) => shown.iter().map(|&i| f64::from(temperature[i])).collect(),
            None => trajectory.speeds(metadata, frame, &shown),
        }
    };
    let of_frame = |frame: usize| {
        let position = trajectory.position_of(frame);
        let all = (0..2).flat_map(|k| shown.iter().map(move |&i| f64::from(position[i * d + k])));
        (format!("frame {frame} of {}", trajectory.frames), all.collect::<Vec<f64>>(), values(frame))
    };
    let frames: Vec<_> = chosen.into_iter().map(of_frame).collect();
    let fluid = frames.iter().flat_map(|(_, _, values)| values.iter().zip(&tags)).filter(|(_, t)| **t == tag::FLUID);
    let (low, high) = fluid.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (&v, _)| (l.min(v), h.max(v)));
    let (low, high) = if low < high { (low, high) } else { (0.0, 1.0) };
    let panels: Vec<TemperaturePanel> = frames
        .iter()
        .map(|(title, position, temperature)| TemperaturePanel {
            title,
            position,
            temperature,
            tag: &tags,
            diameter: metadata.dx,
            diameters: None,
        })
        .collect();
    let (label, what) = match trajectory.temperature {
        Some(_) => (TEMPERATURE, "temperatures"),
        None => ("distance to the neighbouring frame / dx", "speeds"),
    };
    let range = |k: usize| (metadata.bounds[k][0], metadata.bounds[k][1]);
    colored_particles(&out.join("frames"), label, &panels, (low, high), range(0), range(1))?;
    Ok(what)
}
