//! Wall profiles over the course of an optimisation.

use super::axis::{Axis, PlotArea, INK};
use super::colors;
use super::drawing::{text_width, Anchor, Color, Drawing, Point};
use super::legend::{self, Entry, Sample};
use crate::io::FileError;
use std::path::{Path, PathBuf};

const BEST: Color = [213, 94, 0];
const BOUND: Color = [110, 110, 110];
/// More shapes than this get a colour bar instead of one legend entry each.
const MOST_ENTRIES: usize = 8;

/// Draws named wall profiles (offset at each node) in their order, light to dark, the best one highlighted, the
/// bounds +-`bound` dashed.
///
/// # Errors
/// [`FileError::Input`] if there is no shape, a length differs from that of `nodes`, or `best` is no index.
pub fn wall_shapes(
    path_stem: &Path,
    nodes: &[f64],
    shapes: &[(String, Vec<f64>)],
    best: Option<usize>,
    bound: f64,
) -> Result<[PathBuf; 2], FileError> {
    if shapes.is_empty() || nodes.is_empty() {
        return Err(FileError::input(path_stem, "there is no wall shape to show", "at least one shape with nodes"));
    }
    if let Some((name, offsets)) = shapes.iter().find(|(_, offsets)| offsets.len() != nodes.len()) {
        return Err(FileError::input(
            path_stem,
            format!("shape `{name}` has {} offsets", offsets.len()),
            format!("{}, one for each node", nodes.len()),
        ));
    }
    if let Some(index) = best.filter(|index| *index >= shapes.len()) {
        return Err(FileError::input(
            path_stem,
            format!("the best shape is number {index}"),
            format!("0 to {}", shapes.len() - 1),
        ));
    }
    let color = |index: usize| colors::shade(index as f64 / (shapes.len() - 1).max(1) as f64);
    let entries = entries(shapes, best, bound, color);
    let bounds = bound.is_finite().then_some([-bound, bound]);
    let values = shapes.iter().flat_map(|(_, offsets)| offsets.iter().copied());
    let y_axis = Axis::around(values.chain(bounds.into_iter().flatten()));
    let (left, top, width, height) = (y_axis.margin(), 40.0, 740.0, 440.0_f64.max(legend::height(&entries)));
    let legend_left = left + width + 28.0;
    let bar_label = text_width(&shapes[0].0, 14.0).max(text_width(&shapes[shapes.len() - 1].0, 14.0));
    let total = legend_left + legend::width(&entries).max(40.0 + bar_label) + 24.0;
    let mut drawing = Drawing::new(total.max(1000.0), top + height + 75.0);

    let frame = PlotArea { left, top, width, height, x: Axis::around(nodes.iter().copied()), y: y_axis };
    frame.draw(&mut drawing, "x (scene units)", "wall offset (scene units)", INK);
    for value in bounds.into_iter().flatten() {
        let y = frame.map((0.0, value)).1;
        drawing.dashed(&[(left, y), (left + width, y)], BOUND, 1.6, (7.0, 4.5));
    }
    let profile = |offsets: &[f64]| -> Vec<Point> { nodes.iter().copied().zip(offsets.iter().copied()).collect() };
    for (index, (_, offsets)) in shapes.iter().enumerate() {
        for line in frame.map_lines(&profile(offsets)) {
            drawing.line(line, color(index), 1.8);
        }
    }
    // The best one on top of later shapes.
    if let Some(index) = best {
        for line in frame.map_lines(&profile(&shapes[index].1)) {
            for &point in &line {
                drawing.disc(point, 3.6, BEST);
            }
            drawing.line(line, BEST, 2.8);
        }
    }
    legend::draw(&mut drawing, (legend_left, top), &entries);
    if shapes.len() > MOST_ENTRIES {
        let bar_top = top + legend::height(&entries) + 20.0;
        shade_bar(&mut drawing, (legend_left, bar_top), 200.0, &shapes[0].0, &shapes[shapes.len() - 1].0);
    }
    drawing.save(path_stem)
}

fn entries(
    shapes: &[(String, Vec<f64>)],
    best: Option<usize>,
    bound: f64,
    color: impl Fn(usize) -> Color,
) -> Vec<Entry> {
    let mut entries = Vec::new();
    if bound.is_finite() {
        entries.push(Entry { text: format!("bounds ±{bound}"), color: BOUND, sample: Sample::Dashed });
    }
    if let Some(index) = best {
        entries.push(Entry {
            text: format!("best: {}", shapes[index].0),
            color: BEST,
            sample: Sample::Line { width: 2.8 },
        });
    }
    if shapes.len() <= MOST_ENTRIES {
        entries.extend(shapes.iter().enumerate().map(|(index, (name, _))| Entry {
            text: name.clone(),
            color: color(index),
            sample: Sample::Line { width: 2.2 },
        }));
    }
    entries
}

/// A bar of the line colours with the names of the first and the last shape.
fn shade_bar(drawing: &mut Drawing, (left, top): Point, height: f64, first: &str, last: &str) {
    const STRIPES: usize = 50;
    let stripe = height / STRIPES as f64;
    for index in 0..STRIPES {
        let color = colors::shade(index as f64 / (STRIPES - 1) as f64);
        drawing.rectangle((left, top + stripe * index as f64), 18.0, stripe, color, 1.0);
    }
    drawing.text(first, (left + 28.0, top + 7.0), 14.0, Anchor::Left, INK);
    drawing.text(last, (left + 28.0, top + height - 7.0), 14.0, Anchor::Left, INK);
}
