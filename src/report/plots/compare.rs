//! Any number of series in one picture: starts against each other, work against precision, gradient checks.

use super::axis::{Axis, PlotArea, INK};
use super::drawing::{Anchor, Drawing, Point, Saved};
use super::lines::{self, Line, Look};
use crate::io::FileError;
use std::path::Path;

/// Draws named series of (x, y) as lines whose names stand at their ends. On a logarithmic axis values that are not
/// positive are left out, as are NaN and infinities. More series than one frame can show are divided over frames under
/// each other, with the same axes. A series without points is not shown; its look stays free, for pictures beside each
/// other.
///
/// # Errors
/// [`FileError::Input`] if there is not a single point to show; system errors.
pub fn compare(
    stem: &Path,
    title: &str,
    x_label: &str,
    y_label: &str,
    series: &[(String, Vec<Point>)],
    log_x: bool,
    log_y: bool,
) -> Saved {
    let usable = |value: f64, log: bool| value.is_finite() && (!log || value > 0.0);
    let points =
        || series.iter().flat_map(|(_, points)| points).filter(move |(x, y)| usable(*x, log_x) && usable(*y, log_y));
    if points().next().is_none() {
        let allowed = "at least one finite point (positive on a logarithmic axis)";
        return Err(FileError::input(stem, "no series has a point to show", allowed));
    }
    let axis = |values: Vec<f64>, log: bool| match log {
        true => Axis::around_log(values),
        // Between epochs or steps there is nothing.
        false if values.iter().all(|value| value.fract() == 0.0) => Axis::whole_numbers(values),
        false => Axis::around(values),
    };
    let x = axis(points().map(|point| point.0).collect(), log_x);
    let y = axis(points().map(|point| point.1).collect(), log_y);
    let frames = series.len().div_ceil(lines::MOST);
    let height = if frames > 1 { 380.0 } else { 460.0 };
    let (left, top, gap) = (y.margin(), 60.0, 24.0);
    let bottom = top + frames as f64 * (height + gap) - gap;
    let mut drawing = Drawing::new(1000.0, bottom + 75.0);
    drawing.text(title, (left, 32.0), 20.0, Anchor::Left, INK);
    for (k, part) in series.chunks(series.len().div_ceil(frames)).enumerate() {
        let top = top + k as f64 * (height + gap);
        let frame = PlotArea { left, top, width: 660.0, height, x: x.clone(), y: y.clone() };
        frame.draw(&mut drawing, if k + 1 == frames { x_label } else { "" }, y_label, INK);
        let line =
            |(k, (name, points)): (usize, &(String, Vec<Point>))| Line::new(name, points.clone(), Look::series(k));
        lines::draw(&mut drawing, &frame, &part.iter().enumerate().map(line).collect::<Vec<_>>());
    }
    drawing.save(stem)
}
