//! The course of a training: loss, and validation errors beside those of the linear baseline.

use super::axis::{Axis, Frame, INK};
use super::colors;
use super::drawing::{Drawing, Point};
use super::history::{curve, legend_row};
use super::legend::{Entry, Sample};
use crate::io::FileError;
use crate::surrogate::evaluation::scores::Scores;
use std::path::{Path, PathBuf};

/// Rows of history.csv (step, seconds, loss, rate) and validation.csv (step, seconds, mse_1, mse_5, mse_10, mse_20, sinkhorn,
/// e_kin, temperature_mse).
pub struct TrainingCurves<'a> {
    pub history: &'a [Vec<f64>],
    pub validation: &'a [Vec<f64>],
    pub linear: &'a Scores,
}

/// Two panels over the steps: the loss, and below it validation errors (full) with the linear baseline's (dashed).
///
/// # Errors
/// System errors.
pub fn training_curves(path_stem: &Path, curves: &TrainingCurves) -> Result<[PathBuf; 2], FileError> {
    let column = |rows: &[Vec<f64>], k: usize| -> Vec<Point> { rows.iter().map(|row| (row[0], row[k])).collect() };
    let loss = column(curves.history, 2);
    let mut lines: Vec<(&str, Vec<Point>, Option<f64>)> = vec![
        ("MSE_1", column(curves.validation, 2), curves.linear.mse_1),
        ("MSE_5", column(curves.validation, 3), curves.linear.mse_5),
        ("MSE_20", column(curves.validation, 5), curves.linear.mse_20),
        ("temperature", column(curves.validation, 8), curves.linear.temperature_mse),
    ];
    lines.retain(|(_, points, _)| points.iter().any(|p| p.1.is_finite() && p.1 > 0.0));
    let steps = loss.iter().chain(lines.iter().flat_map(|l| &l.1)).map(|p| p.0);
    let x = Axis::around(steps.chain([0.0]));
    let loss_axis = Axis::around_log(loss.iter().map(|p| p.1));
    let errors = lines.iter().flat_map(|(_, points, linear)| points.iter().map(|p| p.1).chain(*linear));
    let error_axis = Axis::around_log(errors.filter(|e| e.is_finite() && *e > 0.0));
    let (left, width) = (loss_axis.margin().max(error_axis.margin()), 840.0);
    let upper = Frame { left, top: 40.0, width, height: 250.0, x: x.clone(), y: loss_axis };
    let lower = Frame { left, top: 370.0, width, height: 320.0, x, y: error_axis };
    let mut drawing = Drawing::new(left + width + 40.0, 770.0);
    upper.draw(&mut drawing, "", "training loss", INK);
    curve(&mut drawing, &upper, &loss, 0);
    lower.draw(&mut drawing, "step", "validation error (dashed: linear)", INK);
    let mut entries = Vec::new();
    for (k, (name, points, linear)) in lines.iter().enumerate() {
        curve(&mut drawing, &lower, points, k);
        if let Some(linear) = linear.filter(|l| lower.y.shows(*l)) {
            let y = lower.map((0.0, linear)).1;
            drawing.dashed(&[(left, y), (left + width, y)], colors::series(k), 1.5, (7.0, 4.5));
        }
        entries.push(Entry { text: (*name).to_owned(), color: colors::series(k), sample: Sample::Marked(k) });
    }
    legend_row(&mut drawing, (left, 345.0), &entries);
    drawing.save(path_stem)
}
