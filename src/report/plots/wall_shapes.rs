//! Wall profiles over the course of an optimisation.

use super::axis::{Axis, PlotArea, INK};
use super::colors;
use super::drawing::{text_width, Anchor, Color, Drawing, Point, Saved};
use super::lines::{self, Line, Look};
use crate::io::FileError;
use std::path::Path;

const BEST: Color = [213, 94, 0];
const BOUND: Color = [110, 110, 110];

/// Draws named wall profiles (offset at each node) in their order, light to dark, the best one highlighted, the
/// bounds +-`bound` dashed.
///
/// # Errors
/// [`FileError::Input`] if there is no shape, a length differs from that of `nodes`, or `best` is no index.
pub fn wall_shapes(
    stem: &Path,
    nodes: &[f64],
    shapes: &[(String, Vec<f64>)],
    best: Option<usize>,
    bound: f64,
) -> Saved {
    let bad = |problem: String, allowed: String| Err(FileError::input(stem, problem, allowed));
    if shapes.is_empty() || nodes.is_empty() {
        return bad("there is no wall shape to show".into(), "at least one shape with nodes".into());
    }
    if let Some((name, offsets)) = shapes.iter().find(|(_, offsets)| offsets.len() != nodes.len()) {
        let problem = format!("shape `{name}` has {} offsets", offsets.len());
        return bad(problem, format!("{}, one for each node", nodes.len()));
    }
    if let Some(index) = best.filter(|index| *index >= shapes.len()) {
        return bad(format!("the best shape is number {index}"), format!("0 to {}", shapes.len() - 1));
    }
    let color = |index: usize| colors::shade(index as f64 / (shapes.len() - 1).max(1) as f64);
    let profile = |index: usize| -> Vec<Point> { nodes.iter().copied().zip(shapes[index].1.iter().copied()).collect() };
    let are_few = shapes.len() <= lines::MOST;
    let mut all: Vec<Line> = (0..shapes.len())
        .map(|k| {
            let name = if are_few && best != Some(k) { shapes[k].0.as_str() } else { "" };
            Line::new(name, profile(k), Look::plain(color(k), 1.8, None))
        })
        .collect();
    if bound.is_finite() {
        let ends = [nodes[0], nodes[nodes.len() - 1]];
        all.extend([("upper bound", bound), ("lower bound", -bound)].map(|(name, value)| {
            Line::new(name, ends.map(|x| (x, value)).to_vec(), Look::plain(BOUND, 1.6, Some(lines::THIN)))
        }));
    }
    // The best one on top of later shapes.
    if let Some(k) = best {
        let look = Look { color: BEST, width: 2.8, dash: None, marker: Some(0) };
        all.push(Line::new(format!("best: {}", shapes[k].0), profile(k), look));
    }
    let y_axis = Axis::around(all.iter().flat_map(|line| &line.points).map(|point| point.1));
    let (left, top, width, height) = (y_axis.margin(), 30.0, 680.0, 440.0);
    let mut drawing = Drawing::new(1000.0, top + height + if are_few { 75.0 } else { 125.0 });
    let frame = PlotArea { left, top, width, height, x: Axis::around(nodes.iter().copied()), y: y_axis };
    frame.draw(&mut drawing, "x (scene units)", "wall offset (scene units)", INK);
    lines::draw(&mut drawing, &frame, &all);
    if !are_few {
        shade_bar(&mut drawing, (left, top + height + 92.0), 240.0, &shapes[0].0, &shapes[shapes.len() - 1].0);
    }
    drawing.save(stem)
}

/// A bar of the line colours between the names of the first and the last shape, the bar's middle line at `y`.
fn shade_bar(drawing: &mut Drawing, (left, y): Point, width: f64, first: &str, last: &str) {
    const STRIPES: usize = 60;
    let (bar, stripe) = (left + text_width(first, 15.0) + 12.0, width / STRIPES as f64);
    for index in 0..STRIPES {
        let color = colors::shade(index as f64 / (STRIPES - 1) as f64);
        drawing.rectangle((bar + stripe * index as f64, y - 8.0), stripe, 16.0, color, 1.0);
    }
    drawing.text(first, (left, y), 15.0, Anchor::Left, INK);
    drawing.text(last, (bar + width + 12.0, y), 15.0, Anchor::Left, INK);
}
