//! Predicted, true, difference: three panels of particles in a row, row under row.

use super::axis::{PlotArea, INK};
use super::drawing::{Anchor, Drawing, Saved};
use super::temperature::{check, color_bar, draw_particles, TemperaturePanel};
use std::path::Path;

/// What the panels have in common. Panels' `temperature` may be any value of the particles.
#[derive(Clone, Copy, Debug)]
pub struct SideBySide<'a> {
    pub label: &'a str,
    pub difference_label: &'a str,
    /// Of the colours of the first two columns, and of the third.
    pub range: (f64, f64),
    pub difference_range: (f64, f64),
    pub x_range: (f64, f64),
    pub y_range: (f64, f64),
}

/// Draws rows of panels; both axes have the same scale.
///
/// # Errors
/// [`crate::io::FileError::Input`] if lengths do not fit, a range is empty, or there is no row; system errors.
pub fn side_by_side(stem: &Path, rows: &[[TemperaturePanel; 3]], options: &SideBySide) -> Saved {
    let SideBySide { range, difference_range, x_range, y_range, .. } = *options;
    check(stem, rows.as_flattened(), range, x_range, y_range)?;
    check(stem, rows.as_flattened(), difference_range, x_range, y_range)?;
    let (x_span, y_span) = (x_range.1 - x_range.0, y_range.1 - y_range.0);
    let pixels = f64::min(420.0 / x_span, 300.0 / y_span);
    let (width, height) = (pixels * x_span, pixels * y_span);
    let (margin, top, gap_x, gap_y, bar) = (80.0, 40.0, 44.0, 44.0, 140.0);
    let true_left = margin + width + gap_x;
    let bar_left = true_left + width + 16.0;
    let difference_left = bar_left + bar;
    let last_bar_left = difference_left + width + 16.0;
    let total_height = rows.len() as f64 * (height + gap_y) - gap_y;
    let mut drawing = Drawing::new(last_bar_left + bar, top + total_height + 70.0);
    for (index, row) in rows.iter().enumerate() {
        for (column, (panel, left)) in row.iter().zip([margin, true_left, difference_left]).enumerate() {
            let corner = (left, top + index as f64 * (height + gap_y));
            let frame = PlotArea::to_scale(corner, pixels, x_range, y_range, 5);
            drawing.text(panel.title, (left, frame.top - 16.0), 16.0, Anchor::Left, INK);
            let x_label = if index + 1 == rows.len() { "x (scene units)" } else { "" };
            let y_label = if column == 0 { "y (scene units)" } else { "" };
            frame.draw(&mut drawing, x_label, y_label, INK);
            let colors = if column == 2 { difference_range } else { range };
            draw_particles(&mut drawing, &frame, panel, colors, pixels);
            frame.outline(&mut drawing);
        }
    }
    color_bar(&mut drawing, (bar_left, top), total_height, range, options.label);
    color_bar(&mut drawing, (last_bar_left, top), total_height, difference_range, options.difference_label);
    drawing.save(stem)
}
