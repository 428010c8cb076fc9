//! Walls over x and z, seen from above: colours for their heights.

use super::axis::{PlotArea, INK, TICKS};
use super::colors;
use super::drawing::{Anchor, Drawing, Saved};
use super::temperature::{check_ranges, color_bar};
use crate::io::FileError;
use std::path::Path;

#[derive(Clone, Copy, Debug)]
pub struct ReliefPanel<'a> {
    pub title: &'a str,
    /// At the middles of a grid of cells, `[Z, X]`: all along x at the first z first.
    pub heights: &'a [f64],
}

/// Draws walls under each other, true to scale. `x` and `z`: both ends of the grid and its number of cells. Colours are
/// those of heights from -most to most.
///
/// # Errors
/// [`FileError::Input`] if there is no wall, a range is empty, or lengths do not fit; system errors.
pub fn relief(stem: &Path, panels: &[ReliefPanel], most: f64, x: (f64, f64, usize), z: (f64, f64, usize)) -> Saved {
    let cells = x.2 * z.2;
    if panels.is_empty() || panels.iter().any(|panel| panel.heights.len() != cells) {
        let lengths: Vec<usize> = panels.iter().map(|panel| panel.heights.len()).collect();
        return Err(FileError::input(stem, format!("walls have {lengths:?} heights"), format!("{cells} each")));
    }
    check_ranges(stem, [("height", (-most, most)), ("x", (x.0, x.1)), ("z", (z.0, z.1))])?;
    let pixels = f64::min(760.0 / (x.1 - x.0), 460.0 / (z.1 - z.0));
    let (width, height) = (pixels * (x.1 - x.0), pixels * (z.1 - z.0));
    let (left, first_top, gap) = (110.0, 48.0, 62.0);
    let bottom = first_top + panels.len() as f64 * (height + gap) - gap;
    let bar_left = left + width + 30.0;
    let mut drawing = Drawing::new(bar_left + 135.0, bottom + 75.0);
    for (index, panel) in panels.iter().enumerate() {
        let top = first_top + index as f64 * (height + gap);
        let frame = PlotArea::to_scale((left, top), pixels, (x.0, x.1), (z.0, z.1), TICKS);
        let x_label = if index + 1 == panels.len() { "x (scene units)" } else { "" };
        drawing.text(panel.title, (left, frame.top - 20.0), 18.0, Anchor::Left, INK);
        frame.draw(&mut drawing, x_label, "z (scene units)", INK);
        let (cell_width, cell_height) = (width / x.2 as f64, height / z.2 as f64);
        for (k, value) in panel.heights.iter().enumerate() {
            // z grows upwards.
            let corner =
                (left + (k % x.2) as f64 * cell_width, frame.top + height - (k / x.2 + 1) as f64 * cell_height);
            let color = colors::heat((value + most) / (2.0 * most));
            drawing.rectangle(corner, cell_width, cell_height, color, 1.0);
        }
        frame.outline(&mut drawing);
    }
    let label = "height of the wall (scene units)";
    color_bar(&mut drawing, (bar_left, first_top), bottom - first_top, (-most, most), label);
    drawing.save(stem)
}
