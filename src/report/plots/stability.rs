//! Maps of where something holds: a letter in a coloured cell, panels in rows.

use super::axis::INK;
use super::drawing::{text_width, Anchor, Color, Drawing, Saved};
use crate::io::FileError;
use std::path::Path;

/// One map: rows from the lowest up, a letter per cell: S stable, D degraded, X diverged, others unknown.
#[derive(Clone, Debug)]
pub struct StabilityPanel {
    pub title: String,
    pub cells: Vec<Vec<char>>,
}

/// What the panels have in common: names and labels of their axes.
#[derive(Clone, Copy, Debug)]
pub struct StabilityAxes<'a> {
    pub x: (&'a str, &'a [String]),
    pub y: (&'a str, &'a [String]),
}

const CELL: f64 = 36.0;
const LABEL: f64 = 13.0;
const UNKNOWN: (Color, Color) = ([238, 238, 238], [120, 120, 120]);

/// Colours of a cell and of its letter: they differ in lightness, for those who see no colours.
fn colors(letter: char) -> (Color, Color) {
    match letter {
        'S' => ([198, 226, 245], INK),
        'D' => ([230, 159, 0], INK),
        'X' => ([92, 22, 62], [255, 255, 255]),
        _ => UNKNOWN,
    }
}

/// Draws panels, `columns` in a row.
///
/// # Errors
/// [`FileError::Input`] if there is no panel or cells do not fit the axes; system errors.
pub fn stability(stem: &Path, title: &str, panels: &[StabilityPanel], columns: usize, axes: &StabilityAxes) -> Saved {
    let (across, up) = (axes.x.1.len(), axes.y.1.len());
    let fits = |panel: &StabilityPanel| panel.cells.len() == up && panel.cells.iter().all(|row| row.len() == across);
    if panels.is_empty() || columns == 0 || !panels.iter().all(fits) {
        let allowed = format!("{up} rows of {across} cells");
        return Err(FileError::input(stem, "cells that do not fit the axes", allowed));
    }
    let widest = axes.y.1.iter().map(|label| text_width(label, LABEL)).fold(0.0, f64::max);
    let (width, height) = (across as f64 * CELL, up as f64 * CELL);
    // Titles and the name of the axis may be wider than a panel.
    let titles = panels.iter().map(|panel| text_width(&panel.title, 15.0));
    let text = titles.chain([text_width(axes.x.0, 15.0)]).fold(0.0, f64::max);
    let (left, top, gap_x, gap_y) = (widest + 50.0, 70.0, f64::max(34.0, text + 16.0 - width), 88.0);
    let rows = panels.len().div_ceil(columns);
    let total = left + columns as f64 * (width + gap_x);
    let legend = [('S', "stable"), ('D', "degraded"), ('X', "diverged")];
    let mut drawing = Drawing::new(total, top + rows as f64 * (height + gap_y));
    drawing.text(title, (20.0, 22.0), 17.0, Anchor::Left, INK);
    for (k, panel) in panels.iter().enumerate() {
        let (x0, y0) = (left + (k % columns) as f64 * (width + gap_x), top + (k / columns) as f64 * (height + gap_y));
        drawing.text(panel.title.as_str(), (x0, y0 - 14.0), 15.0, Anchor::Left, INK);
        for (row, cells) in panel.cells.iter().enumerate() {
            let y = y0 + height - (row + 1) as f64 * CELL;
            if k % columns == 0 {
                drawing.text(axes.y.1[row].as_str(), (x0 - 8.0, y + 0.5 * CELL), LABEL, Anchor::Right, INK);
            }
            for (column, &letter) in cells.iter().enumerate() {
                cell(&mut drawing, (x0 + column as f64 * CELL, y), letter);
            }
        }
        for (column, label) in axes.x.1.iter().enumerate() {
            let at = (x0 + (column as f64 + 0.5) * CELL, y0 + height + 5.0);
            drawing.text(label.as_str(), at, LABEL, Anchor::Top, INK);
        }
        drawing.text(axes.x.0, (x0 + 0.5 * width, y0 + height + 25.0), 15.0, Anchor::Top, INK);
        if k % columns == 0 {
            drawing.text(axes.y.0, (16.0, y0 + 0.5 * height), 15.0, Anchor::Upwards, INK);
        }
    }
    let bottom = top + rows as f64 * (height + gap_y) - 44.0;
    for (k, (letter, meaning)) in legend.into_iter().enumerate() {
        let at = (left + 120.0 * k as f64, bottom);
        cell(&mut drawing, at, letter);
        drawing.text(meaning, (at.0 + CELL + 6.0, at.1 + 0.5 * CELL - 4.0), LABEL, Anchor::Left, INK);
    }
    drawing.save(stem)
}

fn cell(drawing: &mut Drawing, (x, y): (f64, f64), letter: char) {
    let (fill, ink) = colors(letter);
    drawing.rectangle((x, y), CELL - 2.0, CELL - 2.0, fill, 1.0);
    drawing.text(letter.to_string(), (x + 0.5 * CELL - 1.0, y + 0.5 * CELL - 6.0), 16.0, Anchor::Top, ink);
}
