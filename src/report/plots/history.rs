//! The course of an optimisation: objective, loss and gradient norm per epoch.

use super::axis::{Axis, PlotArea, INK};
use super::drawing::{Drawing, Point, Saved};
use super::lines::{self, Line, Look};
use crate::io::FileError;
use std::path::Path;

/// One epoch. Values that are not finite are left out of the plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryPoint {
    pub epoch: usize,
    /// Heat outflow, scene units.
    pub q: f64,
    pub loss: f64,
    /// Euclidean norm of d loss / d parameters.
    pub gradient_norm: f64,
    /// The solver's Q, where a surrogate's is shown and the solver was asked.
    pub truth: f64,
}

/// Panels under each other: Q per epoch (with a dashed reference, if given by name and value), the loss, and the gradient
/// norm (logarithmic).
///
/// # Errors
/// [`FileError::Input`] without any epoch; system errors.
pub fn history(
    stem: &Path,
    epochs: &[HistoryPoint],
    (symbol, label): (&str, &str),
    q_reference: Option<(&str, f64)>,
) -> Saved {
    if epochs.is_empty() {
        return Err(FileError::input(stem, "there is no epoch to show", "at least one epoch"));
    }
    let number = |point: &HistoryPoint| point.epoch as f64;
    let series = |value: fn(&HistoryPoint) -> f64| -> Vec<Point> {
        epochs.iter().map(|point| (number(point), value(point))).collect()
    };
    let mut upper = vec![Line::new("", series(|p| p.q), Look::series(0))];
    let truth = series(|p| p.truth);
    if truth.iter().any(|point| point.1.is_finite()) {
        upper[0].name = symbol.to_owned();
        upper.push(Line::new("the solver's", truth, Look::series(1)));
    }
    if let Some((name, value)) = q_reference.filter(|(_, value)| value.is_finite()) {
        upper[0].name = symbol.to_owned();
        let ends = [epochs.first(), epochs.last()].into_iter().flatten().map(|point| (number(point), value));
        upper.push(Line::new(name, ends.collect(), Look::plain(INK, 1.6, Some(lines::THIN))));
    }
    let values =
        |lines: &[Line]| -> Vec<f64> { lines.iter().flat_map(|line| &line.points).map(|point| point.1).collect() };
    let lower = |value| vec![Line::new("", series(value), Look::series(0))];
    let (loss, gradient) = (lower(|p| p.loss), lower(|p| p.gradient_norm));
    panels(
        stem,
        ("epoch", Axis::whole_numbers(epochs.iter().map(number))),
        &[
            (label, 300.0, Axis::around(values(&upper)), upper),
            ("loss", 190.0, Axis::around(values(&loss)), loss),
            ("|gradient|", 190.0, Axis::around_log(values(&gradient)), gradient),
        ],
    )
}

/// A panel's label, height in pixels, vertical axis and lines.
pub(super) type Panel<'a> = (&'a str, f64, Axis, Vec<Line>);

/// Draws panels under each other over one horizontal axis.
pub(super) fn panels(stem: &Path, (x_label, x): (&str, Axis), panels: &[Panel]) -> Saved {
    const GAP: f64 = 26.0;
    let left = panels.iter().map(|(_, _, y, _)| y.margin()).fold(0.0, f64::max);
    let height: f64 = panels.iter().map(|panel| panel.1 + GAP).sum();
    let mut drawing = Drawing::new(1000.0, height + 84.0);
    let mut top = 30.0;
    for (k, (label, height, y, lines)) in panels.iter().enumerate() {
        let frame = PlotArea { left, top, width: 700.0, height: *height, x: x.clone(), y: y.clone() };
        frame.draw(&mut drawing, if k + 1 == panels.len() { x_label } else { "" }, label, INK);
        lines::draw(&mut drawing, &frame, lines);
        top += height + GAP;
    }
    drawing.save(stem)
}
