//! Fields as filled contours with streamlines over them, true to scale.

use super::axis::{PlotArea, INK, TICKS};
use super::colors;
use super::drawing::{Anchor, Color, Drawing, Point, Saved};
use super::temperature::{check_ranges, color_bar_of};
use crate::io::FileError;
use std::path::Path;

/// Colours between the smallest and the largest value.
const BANDS: f64 = 24.0;
const WALL_GREY: Color = [188, 188, 188];
const WALL_EDGE: Color = [90, 90, 90];
const LINE: Color = [255, 255, 255];
const DARK_LINE: Color = [110, 110, 110];

/// Values on a grid of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Number of cells along x and y.
    pub cells: [usize; 2],
    /// Lower and upper corner.
    pub corners: [[f64; 2]; 2],
    /// In the middles of cells, `[y, x]`; not a number where there is no fluid.
    pub values: Vec<f64>,
}

impl Field {
    /// Smallest and largest value.
    pub fn range(&self) -> (f64, f64) {
        let finite = self.values.iter().filter(|x| x.is_finite());
        finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)))
    }
}

#[derive(Clone, Copy, Debug)]
pub struct FieldPanel<'a> {
    pub title: &'a str,
    pub field: &'a Field,
    pub streamlines: &'a [Vec<[f64; 2]>],
    /// Closed outlines of walls.
    pub walls: &'a [Vec<[f64; 2]>],
}

/// Draws panels under each other with the same colours, from `low` to `high`; `is_signed`: with white for zero.
///
/// # Errors
/// [`FileError::Input`] if there is no panel, a range is empty, or lengths do not fit; system errors.
pub fn fields(stem: &Path, label: &str, panels: &[FieldPanel], (low, high): (f64, f64), is_signed: bool) -> Saved {
    if panels.is_empty() {
        return Err(FileError::input(stem, "there is no panel", "at least one"));
    }
    // All of every panel.
    let corner = |end: usize, of: fn(f64, f64) -> f64| {
        [0, 1].map(|d| panels.iter().map(|panel| panel.field.corners[end][d]).reduce(of).unwrap_or_default())
    };
    let corners = [corner(0, f64::min), corner(1, f64::max)];
    let [x, y] = [0, 1].map(|d| (corners[0][d], corners[1][d]));
    check_ranges(stem, [("value", (low, high)), ("x", x), ("y", y)])?;
    if let Some(panel) =
        panels.iter().find(|panel| panel.field.values.len() != panel.field.cells[0] * panel.field.cells[1])
    {
        let (count, cells) = (panel.field.values.len(), panel.field.cells);
        return Err(FileError::input(
            stem,
            format!("a field of {cells:?} cells has {count} values"),
            "one for each cell",
        ));
    }
    let color = |part: f64| {
        let part = ((part * BANDS).floor().clamp(0.0, BANDS - 1.0) + 0.5) / BANDS;
        if is_signed {
            colors::signed(2.0 * part - 1.0)
        } else {
            colors::heat(part)
        }
    };
    let pixels = f64::min(900.0 / (x.1 - x.0), if panels.len() > 1 { 460.0 } else { 700.0 } / (y.1 - y.0));
    let (width, height) = (pixels * (x.1 - x.0), pixels * (y.1 - y.0));
    let (left, first_top, gap) = (110.0, 48.0, 62.0);
    let bottom = first_top + panels.len() as f64 * (height + gap) - gap;
    let bar_left = left + width + 30.0;
    let mut drawing = Drawing::new(bar_left + 125.0, bottom + 70.0);
    for (index, panel) in panels.iter().enumerate() {
        let top = first_top + index as f64 * (height + gap);
        let frame = PlotArea::to_scale((left, top), pixels, x, y, TICKS);
        let x_label = if index + 1 == panels.len() { "x (scene units)" } else { "" };
        drawing.text(panel.title, (left, frame.top - 20.0), 18.0, Anchor::Left, INK);
        frame.draw(&mut drawing, x_label, "y (scene units)", INK);
        fill(&mut drawing, &frame, panel.field, |value| color((value - low) / (high - low)));
        let to_pixels = |line: &[[f64; 2]]| line.iter().map(|p| frame.map((p[0], p[1]))).collect::<Vec<Point>>();
        let ink = if is_signed { DARK_LINE } else { LINE };
        for line in panel.streamlines {
            drawing.line(to_pixels(line), ink, 0.8);
            if let Some(head) = arrow(&to_pixels(line)) {
                drawing.area(head, ink, 1.0);
            }
        }
        for wall in panel.walls {
            let inside = to_pixels(&clipped(wall, corners));
            if inside.len() > 2 {
                drawing.area(inside.clone(), WALL_GREY, 1.0);
                drawing.line([&inside[..], &inside[..1]].concat(), WALL_EDGE, 1.2);
            }
        }
        frame.outline(&mut drawing);
    }
    color_bar_of(color, &mut drawing, (bar_left, first_top), bottom - first_top, (low, high), label);
    drawing.save(stem)
}

/// Fills cells of the same colour beside each other as one rectangle.
fn fill(drawing: &mut Drawing, frame: &PlotArea, field: &Field, color: impl Fn(f64) -> Color) {
    let [columns, rows] = field.cells;
    let [(left, bottom), (right, top)] = field.corners.map(|[x, y]| frame.map((x, y)));
    let (width, height) = ((right - left) / columns as f64, (bottom - top) / rows as f64);
    for (row, values) in field.values.chunks(columns).enumerate() {
        let colors: Vec<Option<Color>> = values.iter().map(|x| x.is_finite().then(|| color(*x))).collect();
        let mut first = 0;
        for run in colors.chunk_by(|a, b| a == b) {
            if let Some(color) = run[0] {
                // y grows upwards. (Rectangles overlap a little: no gaps between them.)
                let corner = (left + first as f64 * width, top + (rows - 1 - row) as f64 * height);
                drawing.rectangle(corner, run.len() as f64 * width, height + 0.25, color, 1.0);
            }
            first += run.len();
        }
    }
}

/// A small arrow head in the middle of a line, in pixels.
fn arrow(line: &[Point]) -> Option<Vec<Point>> {
    let middle = line.len() / 2;
    let (from, tip) = (line.get(middle.checked_sub(1)?)?, line.get(middle)?);
    let (dx, dy) = (tip.0 - from.0, tip.1 - from.1);
    let length = dx.hypot(dy);
    let (dx, dy) = (dx / length, dy / length);
    let at = |along: f64, across: f64| (tip.0 + along * dx - across * dy, tip.1 + along * dy + across * dx);
    length.is_normal().then(|| vec![at(5.0, 0.0), at(-3.0, 3.2), at(-3.0, -3.2)])
}

/// A polygon's part within a rectangle (Sutherland and Hodgman 1974).
fn clipped(polygon: &[[f64; 2]], [low, high]: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    let mut points = polygon.to_vec();
    for (d, side, sign) in [(0, low[0], 1.0), (0, high[0], -1.0), (1, low[1], 1.0), (1, high[1], -1.0)] {
        let inside = |p: &[f64; 2]| sign * (p[d] - side) >= 0.0;
        let mut kept = vec![];
        for (k, b) in points.iter().enumerate() {
            let a = &points[(k + points.len() - 1) % points.len()];
            if inside(a) != inside(b) {
                let share = (side - a[d]) / (b[d] - a[d]);
                kept.push([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]);
            }
            if inside(b) {
                kept.push(*b);
            }
        }
        points = kept;
    }
    points
}
