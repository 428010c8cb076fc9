//! The page of a data set: its content, one of its trajectories, its walls, and what to do with it.

use super::folder::Folder;
use super::series;
use crate::dataset::trajectory::{read_one, Outline};
use crate::dataset::{Metadata, Split, Trajectory};
use crate::io::vtk::ParticleFile;
use crate::report::page::{short, Cell, Fact, Fields, Page, RawPanel, Side, Table, Text, Walls};
use serde_json::Value;
use std::collections::BTreeMap;

/// Largest size of the trajectory's frames before they are converted to text, so that the page is below 2 MB.
const MOST_BYTES: usize = 800_000;
/// Largest number of walls on a page; of more, some are selected.
const MOST_WALLS: usize = 200;

pub fn page(folder: &Folder) -> anyhow::Result<Page> {
    let metadata = Metadata::read(&folder.path)?;
    let mut splits = Vec::new();
    for split in Split::ALL {
        splits.push((split, Outline::of_split(&folder.path, &metadata, split)?));
    }
    let mut page = Page::default();
    (page.lead, page.remark) = said(&metadata, &splits);
    page.facts = facts(&metadata, &splits);
    page.walls = walls(&splits);
    let (split, _) = splits.iter().find(|(_, all)| !all.is_empty()).unwrap_or(&splits[0]);
    let shown = read_one(&folder.path, &metadata, *split, 0)?;
    page.fields = shown.and_then(|trajectory| fields(&metadata, *split, &trajectory));
    page.tables.push(holds(folder, &splits));
    page.tables.push(statistics(&metadata));
    page.tables.push(numbers(&metadata));
    page.tables.extend(names_of_walls(&splits));
    page.tables.push(next(folder, &metadata));
    page.pictures = folder.pictures(|stem| stem == "frames");
    if let Some(text) = metadata.other.get(crate::dataset::store::CONFIGURATION).and_then(Value::as_str) {
        let title = "The scene of all trajectories (metadata.json); each has its own start and wall in its attributes";
        page.texts.push(Text { title: title.into(), text: text.into() });
    }
    Ok(page)
}

type Splits = [(Split, Vec<Outline>)];

/// The smallest and the largest count as text.
fn range(counts: impl Iterator<Item = usize> + Clone) -> String {
    match (counts.clone().min(), counts.max()) {
        (Some(low), Some(high)) if low == high => low.to_string(),
        (Some(low), Some(high)) => format!("{low} to {high}"),
        _ => "-".into(),
    }
}

fn all(splits: &Splits) -> impl Iterator<Item = &Outline> + Clone {
    splits.iter().flat_map(|(_, all)| all)
}

fn apart(metadata: &Metadata) -> f64 {
    metadata.dt * metadata.write_every as f64
}

fn said(metadata: &Metadata, splits: &Splits) -> (String, String) {
    let case = metadata.other.get("case").and_then(Value::as_str).map_or(String::new(), |case| format!(" of {case}"));
    let [train, valid, test] = [0, 1, 2].map(|k| splits[k].1.len());
    let lead = format!(
        "{} trajectories{case}, each of {} frames with {} particles: {train} to train with, {valid} to validate, {test} to test.",
        all(splits).count(),
        range(all(splits).map(|one| one.frames)),
        range(all(splits).map(|one| one.particles)),
    );
    let temperatures = if metadata.heat.is_some() { " and temperatures" } else { "" };
    let remark = format!(
        "Places{temperatures} of particles, {} of time apart, in LagrangeBench's layout: what a network learns a flow from.",
        short(apart(metadata))
    );
    (lead, remark)
}

fn facts(metadata: &Metadata, splits: &Splits) -> Vec<Fact> {
    vec![
        Fact::new("trajectories", Cell::number(all(splits).count() as f64)),
        Fact::new("frames each", Cell::text(range(all(splits).map(|one| one.frames)))),
        Fact::new("particles", Cell::text(range(all(splits).map(|one| one.particles)))),
        Fact::new("time between frames", Cell::number(apart(metadata))),
        Fact::new("spacing", Cell::number(metadata.dx)),
    ]
}

/// The content of each file.
fn holds(folder: &Folder, splits: &Splits) -> Table {
    let mut table = Table::new("What it holds", ["split", "trajectories", "frames", "particles", "file"]);
    for (split, all) in splits {
        let bytes = split.path(&folder.path).metadata().map_or(0, |file| file.len());
        let cells = [
            Cell::number(all.len() as f64),
            Cell::text(range(all.iter().map(|one| one.frames))),
            Cell::text(range(all.iter().map(|one| one.particles))),
            Cell::shown(crate::report::text::bytes(bytes as usize), bytes as f64),
        ];
        table.row(split.name(), cells);
    }
    table
}

/// Means and standard deviations by which a network's inputs and outputs are normalised.
fn statistics(metadata: &Metadata) -> Table {
    let mut table = Table::new("Statistics", ["per frame", "mean", "deviation"]);
    let mut row = |name: String, mean: f64, deviation: f64| table.row(name, [mean, deviation].map(Cell::number));
    let axes = ["x", "y", "z"];
    for d in 0..metadata.dim {
        row(format!("velocity in {}", axes[d]), metadata.vel_mean[d], metadata.vel_std[d]);
    }
    for d in 0..metadata.dim {
        row(format!("acceleration in {}", axes[d]), metadata.acc_mean[d], metadata.acc_std[d]);
    }
    if let Some(heat) = &metadata.heat {
        row("temperature".into(), heat.temperature_mean, heat.temperature_std);
        row("change of temperature".into(), heat.change_mean, heat.change_std);
    }
    table.note = "Of the fluid of the training split; a frame is the unit of time.".into();
    table
}

/// Box, time and heat.
fn numbers(metadata: &Metadata) -> Table {
    let mut table = Table::new("Box and time", ["", ""]);
    let mut row = |name: &str, cell: Cell| table.row(name, [cell]);
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate().take(metadata.dim) {
        let [low, high] = metadata.bounds[k];
        let kind = if metadata.periodic()[k] { "periodic" } else { "open" };
        row(&format!("bounds in {axis}"), Cell::text(format!("{} to {}, {kind}", short(low), short(high))));
    }
    row("particle spacing", Cell::number(metadata.dx));
    row("connectivity radius", Cell::number(metadata.default_connectivity_radius));
    row("time between frames", Cell::number(apart(metadata)));
    row("reference steps between frames", Cell::number(metadata.write_every as f64));
    row("reference step", Cell::number(metadata.dt));
    let known = [
        ("solver_steps_per_frame", "solver's steps between frames"),
        ("solver_dt", "solver's step"),
        ("viscosity", "viscosity"),
        ("seed", "seed"),
        ("version", "made by hydrograd"),
    ];
    for (key, name) in known {
        if let Some(cell) = metadata.other.get(key).and_then(super::tables::cell) {
            row(name, cell);
        }
    }
    if let Some(heat) = &metadata.heat {
        row("inlet's temperature", Cell::number(heat.inlet_temperature));
        row("length of the inlet", Cell::number(heat.inlet_length));
        row("outflowing heat is measured at x", Cell::number(heat.target_x));
        row("thermal diffusivity", Cell::number(heat.diffusivity));
    }
    table
}

/// Number of trajectories by kind of wall and split.
fn names_of_walls(splits: &Splits) -> Option<Table> {
    let mut counts: BTreeMap<String, [usize; 3]> = BTreeMap::new();
    for (k, (_, all)) in splits.iter().enumerate() {
        for one in all.iter().filter(|one| !one.wall.is_empty()) {
            counts.entry(one.kind_of_wall().to_string()).or_default()[k] += 1;
        }
    }
    let mut table = Table::new("Kinds of walls", ["wall", "train", "valid", "test"]);
    for (name, counts) in counts {
        table.row(name, counts.map(|count| Cell::number(count as f64)));
    }
    (!table.rows.is_empty()).then_some(table)
}

/// Commands for a data set.
fn next(folder: &Folder, metadata: &Metadata) -> Table {
    let data = folder.path.display();
    let mut table = Table::new("What to do next", ["", "command"]);
    let mut row = |what: &str, command: String| table.row(what, [Cell::text(command)]);
    row("look at other trajectories", format!("hydrograd dataset inspect {data} --split test --trajectory 0"));
    row("train a network", format!("hydrograd train --data {data} --steps 20000 --out runs/train"));
    row("judge it", format!("hydrograd evaluate --model runs/train/best.safetensors --data {data} --split test"));
    row("see what it predicts", format!("hydrograd rollout --model runs/train/best.safetensors --data {data}"));
    if metadata.heat.is_some() {
        row(
            "shape the wall with it",
            "hydrograd optimize --dynamics surrogate --model runs/train/best.safetensors".into(),
        );
    }
    table
}

/// The walls of the trajectories; none if no wall is shaped.
fn walls(splits: &Splits) -> Option<Walls> {
    let mut named: Vec<(String, &Outline)> = Vec::new();
    for (split, all) in splits {
        let name = |one: &Outline| match one.wall.as_str() {
            "" => format!("{} {}", split.name(), one.name),
            wall => format!("{} {}, {wall}", split.name(), one.name),
        };
        named.extend(all.iter().filter(|one| !one.wall_x.is_empty()).map(|one| (name(one), one)));
    }
    // A slider needs walls with the same nodes.
    let nodes = named.first()?.1.wall_x.clone();
    named.retain(|(_, one)| one.wall_x == nodes && one.wall_offset.len() == nodes.len());
    let count = named.len().min(MOST_WALLS);
    let chosen = (0..count).map(|k| &named[k * named.len() / count]);
    let (names, offsets) = chosen.map(|(name, one)| (name.clone(), one.wall_offset.clone())).unzip();
    Some(Walls {
        nodes,
        sides: vec![Side { name: "the wall".into(), base: 0.0, sign: 1.0, offsets }],
        names,
        ..Walls::default()
    })
}

/// One trajectory over time, coloured by temperature and by speed.
fn fields(metadata: &Metadata, split: Split, trajectory: &Trajectory) -> Option<Fields> {
    let (d, every) = (metadata.dim, (0..trajectory.particles).collect::<Vec<_>>());
    // Converts spacings per frame to a speed.
    let unit = metadata.dx / apart(metadata);
    let particles = |k: usize| {
        let place = |place: &[f32]| std::array::from_fn(|d| place.get(d).map_or(0.0, |&x| f64::from(x)));
        let speed = trajectory.speeds(metadata, k, &every).into_iter().map(|steps| steps * unit).collect();
        let warm = trajectory.temperature_of(k).map(|warm| warm.iter().map(|&t| f64::from(t)).collect());
        let warm = warm.map(|warm| ("temperature".to_string(), warm));
        ParticleFile {
            position: trajectory.position_of(k).chunks_exact(d).map(place).collect(),
            velocity: vec![],
            scalars: warm.into_iter().chain([("speed".to_string(), speed)]).collect(),
            tag: trajectory.tags(),
            ..Default::default()
        }
    };
    let first = particles(0).position;
    let (layer, layer_note) = series::layer(&first, metadata.dx);
    let in_layer = first.iter().filter(|place| series::is_in(layer, place)).count();
    let mut quantities = vec![("speed", "scene units")];
    if trajectory.temperature.is_some() {
        quantities.insert(0, ("temperature", "scene units"));
    }
    let chosen = Fields::chosen_within(MOST_BYTES, trajectory.frames, in_layer, 1, quantities.len());
    let frame = |k: usize| series::frame(k as f64 * apart(metadata), &particles(k), layer, &quantities);
    let frames = chosen.into_iter().map(frame).collect();
    let panel = RawPanel { title: format!("of {}/{}", split.name(), trajectory.name), frames };
    let note = format!("Time since the first frame; coordinates as in the files. {layer_note}");
    Fields::new(vec![panel], &quantities, metadata.dx, note.trim_end().to_string())
}
