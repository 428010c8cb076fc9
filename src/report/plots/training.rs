//! The course of a training: loss, and validation errors beside those of a baseline.

use super::axis::{Axis, PlotArea, INK};
use super::colors;
use super::drawing::Drawing;
use super::history::{curve, legend_row};
use super::legend::{Entry, Sample};
use crate::io::FileError;
use std::path::{Path, PathBuf};

/// An error that falls (or does not) over the steps, as (step, value).
#[derive(Debug, Clone)]
pub struct ErrorCurve {
    pub name: &'static str,
    pub points: Vec<(f64, f64)>,
    /// The baseline's error, if it has one.
    pub baseline: Option<f64>,
}

/// Two panels over the steps: `loss` as (step, value), and below it `errors` (full) with those of the baseline called
/// `baseline` (dashed). Curves without a number above 0 are left out.
///
/// # Errors
/// System errors.
pub fn training_curves(
    path_stem: &Path,
    loss: &[(f64, f64)],
    errors: &[ErrorCurve],
    baseline: &str,
) -> Result<[PathBuf; 2], FileError> {
    let shows = |line: &&ErrorCurve| line.points.iter().any(|p| p.1.is_finite() && p.1 > 0.0);
    let lines: Vec<&ErrorCurve> = errors.iter().filter(shows).collect();
    let steps = loss.iter().chain(lines.iter().flat_map(|l| &l.points)).map(|p| p.0);
    let x = Axis::around(steps.chain([0.0]));
    let loss_axis = Axis::around_log(loss.iter().map(|p| p.1));
    let errors = lines.iter().flat_map(|line| line.points.iter().map(|p| p.1).chain(line.baseline));
    let error_axis = Axis::around_log(errors.filter(|e| e.is_finite() && *e > 0.0));
    let (left, width) = (loss_axis.margin().max(error_axis.margin()), 840.0);
    let upper = PlotArea { left, top: 40.0, width, height: 250.0, x: x.clone(), y: loss_axis };
    let lower = PlotArea { left, top: 370.0, width, height: 320.0, x, y: error_axis };
    let mut drawing = Drawing::new(left + width + 40.0, 770.0);
    upper.draw(&mut drawing, "", "training loss", INK);
    curve(&mut drawing, &upper, loss, 0);
    lower.draw(&mut drawing, "step", &format!("validation error (dashed: {baseline})"), INK);
    let mut entries = Vec::new();
    for (k, line) in lines.iter().enumerate() {
        curve(&mut drawing, &lower, &line.points, k);
        if let Some(error) = line.baseline.filter(|error| lower.y.shows(*error)) {
            let y = lower.map((0.0, error)).1;
            drawing.dashed(&[(left, y), (left + width, y)], colors::series(k), 1.5, (7.0, 4.5));
        }
        entries.push(Entry { text: line.name.to_owned(), color: colors::series(k), sample: Sample::Marked(k) });
    }
    legend_row(&mut drawing, (left, 345.0), &entries);
    drawing.save(path_stem)
}
