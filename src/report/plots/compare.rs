//! Any number of series in one frame: starts against each other, work against precision, gradient checks.

use super::axis::{Axis, PlotArea, INK};
use super::drawing::{Anchor, Drawing, Point};
use super::legend::{self, Entry, Sample};
use super::{colors, drawing::text_width};
use crate::io::FileError;
use std::path::{Path, PathBuf};

/// Beyond this many points the markers would be a band.
const MOST_MARKERS: usize = 40;

/// Lengths of dashes and of what is between them; the first is that of legends.
const DASHES: [(f64, f64); 3] = [(7.0, 4.5), (2.5, 4.0), (14.0, 5.0)];

/// Draws named series of (x, y) as lines with markers, legend on the right. On a logarithmic axis values that are
/// not positive are left out, as are NaN and infinities. Lines of many points have no markers: behind the first they are
/// dashed, so that one that lies under them is seen. A series without points is not shown; its colour stays free, for pictures
/// beside each other.
///
/// # Errors
/// [`FileError::Input`] if there is not a single point to show; system errors.
pub fn compare(
    path_stem: &Path,
    title: &str,
    x_label: &str,
    y_label: &str,
    series: &[(String, Vec<Point>)],
    log_x: bool,
    log_y: bool,
) -> Result<[PathBuf; 2], FileError> {
    let usable = |value: f64, log: bool| value.is_finite() && (!log || value > 0.0);
    let points =
        || series.iter().flat_map(|(_, points)| points).filter(move |(x, y)| usable(*x, log_x) && usable(*y, log_y));
    if points().next().is_none() {
        return Err(FileError::input(
            path_stem,
            "no series has a point to show",
            "at least one finite point (positive on a logarithmic axis)",
        ));
    }
    let axis = |values: Vec<f64>, log: bool| match log {
        true => Axis::around_log(values),
        // Between epochs or steps there is nothing.
        false if values.iter().all(|value| value.fract() == 0.0) => Axis::whole_numbers(values),
        false => Axis::around(values),
    };
    let is_marked = |points: &[Point]| points.len() <= MOST_MARKERS;
    let entries: Vec<Entry> = series
        .iter()
        .enumerate()
        .filter(|(_, (_, points))| !points.is_empty())
        .map(|(index, (name, points))| Entry {
            text: name.clone(),
            color: colors::series(index),
            sample: match index {
                _ if is_marked(points) => Sample::Marked(index),
                0 => Sample::Line { width: 2.0 },
                _ => Sample::Dashed,
            },
        })
        .collect();

    let y_axis = axis(points().map(|point| point.1).collect(), log_y);
    let (left, top, width) = (y_axis.margin(), 60.0, 740.0);
    let height = f64::max(460.0, legend::height(&entries));
    let legend_left = left + width + 28.0;
    let total = (legend_left + legend::width(&entries) + 24.0).max(left + text_width(title, 20.0) + 24.0);
    let mut drawing = Drawing::new(total.max(1000.0), top + height + 75.0);
    let frame =
        PlotArea { left, top, width, height, x: axis(points().map(|point| point.0).collect(), log_x), y: y_axis };
    drawing.text(title, (left, 32.0), 20.0, Anchor::Left, INK);
    frame.draw(&mut drawing, x_label, y_label, INK);
    for (index, (_, points)) in series.iter().enumerate() {
        let lines = frame.map_lines(points);
        for line in lines {
            match is_marked(points) || index == 0 {
                true => drawing.line(line.clone(), colors::series(index), 2.0),
                false => drawing.dashed(&line, colors::series(index), 1.8, DASHES[(index - 1) % DASHES.len()]),
            }
            if is_marked(points) || line.len() == 1 {
                for point in line {
                    legend::marker(&mut drawing, point, index, colors::series(index));
                }
            }
        }
    }
    legend::draw(&mut drawing, (legend_left, top), &entries);
    drawing.save(path_stem)
}
