//! Frames of particles for a page, read from the ParaView files of a run.

use super::folder::Folder;
use crate::io::vtk::{read_frame, read_list, ParticleFile};
use crate::particles::tag::FLUID;
use crate::report::page::{Fields, RawFrame, RawPanel};
use std::path::{Path, PathBuf};

/// The quantities that colour particles, and their units. Scenes without heat have no temperature.
const QUANTITIES: [(&str, &str); 3] =
    [("temperature", "scene units"), ("speed", "scene units"), ("pressure", "scene units")];

/// Panels, each with the frames of some lists in sequence; none without frames, or if they cannot be read.
pub fn fields(folder: &Folder, panels: &[(&str, Vec<PathBuf>)], dx: f64) -> Option<Fields> {
    folder.unless_damaged("the particles", read(panels, dx)).flatten()
}

fn read(panels: &[(&str, Vec<PathBuf>)], dx: f64) -> anyhow::Result<Option<Fields>> {
    let mut lists = Vec::new();
    for (title, lists_of) in panels {
        let mut frames: Vec<(f64, PathBuf)> = Vec::new();
        for list in lists_of.iter().filter(|list| list.is_file()) {
            frames.extend(read_list(list)?);
        }
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        frames.dedup_by(|a, b| a.0 == b.0);
        if !frames.is_empty() {
            lists.push((*title, frames));
        }
    }
    let Some((_, (_, first))) = lists.first().and_then(|(title, frames)| Some((title, frames.first()?))) else {
        return Ok(None);
    };
    let first = read_frame(first)?;
    let (layer, note) = layer(&first.position, dx);
    let particles = first.position.iter().filter(|place| is_in(layer, place)).count();
    let known: Vec<(&str, &str)> =
        QUANTITIES.into_iter().filter(|(name, _)| *name == "speed" || first.scalars.contains_key(*name)).collect();
    let mut raw = Vec::new();
    for (title, frames) in &lists {
        let mut panel = RawPanel { title: title.to_string(), frames: vec![] };
        for k in Fields::chosen(frames.len(), particles, lists.len(), known.len()) {
            panel.frames.push(frame(frames[k].0, &read_frame(&frames[k].1)?, layer, &known));
        }
        raw.push(panel);
    }
    Ok(Fields::new(raw, &known, dx, note))
}

/// The lists of a run's frames, one for each part of a resumed run.
pub fn lists(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let own = names.filter(|name| name == "particles" || name.starts_with("particles-from-"));
    own.map(|name| folder.join(name).join("particles.pvd")).collect()
}

/// The extent of the particles' positions, by component.
fn widths(frame: &ParticleFile) -> [f64; 3] {
    std::array::from_fn(|d| {
        let places = || frame.position.iter().map(|place| place[d]);
        places().fold(f64::NEG_INFINITY, f64::max) - places().fold(f64::INFINITY, f64::min)
    })
}

/// The length of a periodic box, which no file has. It follows from a particle that left the box, whose next position
/// does not match its velocity; none if no particle left.
pub fn period(frames: &[(f64, ParticleFile)]) -> [Option<f64>; 3] {
    let mut found = [None; 3];
    for pair in frames.windows(2) {
        let [(before, old), (now, new)] = pair else { continue };
        let (widths, time) = (widths(new), now - before);
        for (i, (from, to)) in old.position.iter().zip(&new.position).enumerate() {
            let Some(velocity) = new.velocity.get(i) else { continue };
            for d in 0..3 {
                let jump = (to[d] - from[d] - velocity[d] * time).abs();
                if found[d].is_none() && jump > 0.5 * widths[d] && jump > 0.0 {
                    found[d] = Some(jump);
                }
            }
        }
    }
    found
}

/// The mean squared distance between the positions of some particles, by component as in `hydrograd rollout`.
pub fn mean_square(one: &ParticleFile, other: &ParticleFile, kept: &[usize], period: [Option<f64>; 3]) -> f64 {
    let apart = |i: usize, d: usize| {
        let apart = one.position[i][d] - other.position[i][d];
        period[d].map_or(apart, |length| apart - length * (apart / length).round())
    };
    let components: Vec<usize> = (0..3).filter(|&d| widths(other)[d] > 0.0).collect();
    let squares = kept.iter().flat_map(|&i| components.iter().map(move |&d| apart(i, d).powi(2)));
    squares.sum::<f64>() / (kept.len() * components.len()).max(1) as f64
}

/// In three dimensions, the range of z that is shown: the middle, to half a spacing.
pub fn layer(places: &[[f64; 3]], dx: f64) -> (Option<(f64, f64)>, String) {
    let z = || places.iter().map(|place| place[2]);
    let (low, high) = z().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    if high <= low {
        return (None, String::new());
    }
    let middle = 0.5 * (low + high);
    // Of an even number of layers it is the upper one of the middle two.
    (Some((middle - 0.25 * dx, middle + 0.75 * dx)), format!("The layer in the middle of z = {low:.3} ... {high:.3}."))
}

pub fn is_in(layer: Option<(f64, f64)>, place: &[f64; 3]) -> bool {
    layer.is_none_or(|(low, high)| (low..high).contains(&place[2]))
}

/// The particles of a layer, coloured by quantities; a file without speeds has velocities.
pub fn frame(time: f64, file: &ParticleFile, layer: Option<(f64, f64)>, quantities: &[(&str, &str)]) -> RawFrame {
    let kept: Vec<usize> = (0..file.position.len()).filter(|&i| is_in(layer, &file.position[i])).collect();
    let speed = |i: usize| file.velocity.get(i).map_or(f64::NAN, |u| u.iter().map(|u| u * u).sum::<f64>().sqrt());
    let values = quantities.iter().map(|(name, _)| match file.scalars.get(*name) {
        Some(values) => kept.iter().map(|&i| values[i]).collect(),
        None => kept.iter().map(|&i| speed(i)).collect(),
    });
    RawFrame {
        time,
        position: kept.iter().map(|&i| [file.position[i][0], file.position[i][1]]).collect(),
        tag: kept.iter().map(|&i| file.tag.get(i).copied().unwrap_or(FLUID)).collect(),
        values: values.collect(),
    }
}
