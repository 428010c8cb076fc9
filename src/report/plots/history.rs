//! The course of an optimisation: objective, loss and gradient norm per epoch.

use super::axis::{Axis, PlotArea, INK};
use super::colors;
use super::drawing::{Drawing, Point};
use super::legend::{self, Entry, Sample};
use crate::io::FileError;
use std::path::{Path, PathBuf};

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

/// Two panels: Q per epoch (with a dashed reference, if given by name and value), below it the loss (left axis) and
/// the gradient norm (right axis, logarithmic).
///
/// # Errors
/// [`FileError::Input`] without any epoch; system errors.
pub fn history(
    path_stem: &Path,
    epochs: &[HistoryPoint],
    (symbol, label): (&str, &str),
    q_reference: Option<(&str, f64)>,
) -> Result<[PathBuf; 2], FileError> {
    if epochs.is_empty() {
        return Err(FileError::input(path_stem, "there is no epoch to show", "at least one epoch"));
    }
    let number = |point: &HistoryPoint| point.epoch as f64;
    let series = |value: fn(&HistoryPoint) -> f64| -> Vec<Point> {
        epochs.iter().map(|point| (number(point), value(point))).collect()
    };
    let (q, loss, gradient) = (series(|p| p.q), series(|p| p.loss), series(|p| p.gradient_norm));
    let values = |points: &[Point]| points.iter().map(|point| point.1).collect::<Vec<f64>>();
    let epoch_axis = || Axis::whole_numbers(epochs.iter().map(number));

    let reference = q_reference.map(|(_, value)| value);
    let truth: Vec<Point> = series(|p| p.truth).into_iter().filter(|point| point.1.is_finite()).collect();
    let q_axis = Axis::around(values(&q).into_iter().chain(reference).chain(values(&truth)));
    let loss_axis = Axis::around(values(&loss));
    let gradient_axis = Axis::around_log(values(&gradient));
    let (left, width) = (q_axis.margin().max(loss_axis.margin()), 840.0);
    let upper = PlotArea { left, top: 62.0, width, height: 300.0, x: epoch_axis(), y: q_axis };
    let lower = PlotArea { left, top: 424.0, width, height: 230.0, x: epoch_axis(), y: loss_axis };
    let on_gradient = PlotArea { y: gradient_axis.clone(), ..lower.clone() };
    let mut drawing = Drawing::new(left + width + gradient_axis.margin(), 735.0);

    upper.draw(&mut drawing, "", label, INK);
    let mut entries = vec![Entry { text: symbol.to_owned(), color: colors::series(0), sample: Sample::Marked(0) }];
    if let Some((name, value)) = q_reference.filter(|(_, value)| value.is_finite()) {
        let y = upper.map((0.0, value)).1;
        drawing.dashed(&[(left, y), (left + width, y)], colors::series(1), 1.8, (7.0, 4.5));
        entries.push(Entry { text: name.to_owned(), color: colors::series(1), sample: Sample::Dashed });
    }
    curve(&mut drawing, &upper, &q, 0);
    if !truth.is_empty() {
        curve(&mut drawing, &upper, &truth, 2);
        entries.push(Entry { text: "the solver's".to_owned(), color: colors::series(2), sample: Sample::Marked(2) });
    }
    legend_row(&mut drawing, (left, 34.0), &entries);

    lower.draw(&mut drawing, "epoch", "loss", colors::series(0));
    lower.draw_right(&mut drawing, &gradient_axis, "|gradient|", colors::series(1));
    curve(&mut drawing, &lower, &loss, 0);
    curve(&mut drawing, &on_gradient, &gradient, 1);
    let entries = ["loss (left axis)", "|gradient| (right axis)"].map(|text| text.to_owned());
    let entries: Vec<Entry> = entries
        .into_iter()
        .enumerate()
        .map(|(index, text)| Entry { text, color: colors::series(index), sample: Sample::Marked(index) })
        .collect();
    legend_row(&mut drawing, (left, 396.0), &entries);
    drawing.save(path_stem)
}

/// A line with markers while these are few.
pub(super) fn curve(drawing: &mut Drawing, frame: &PlotArea, points: &[Point], series: usize) {
    let marked = points.len() <= 60;
    for line in frame.map_lines(points) {
        drawing.line(line.clone(), colors::series(series), 2.0);
        if marked || line.len() == 1 {
            for point in line {
                legend::marker(drawing, point, series, colors::series(series));
            }
        }
    }
}

/// Entries side by side above a panel, middle line at `y`.
pub(super) fn legend_row(drawing: &mut Drawing, (left, y): Point, entries: &[Entry]) {
    let mut x = left;
    for entry in entries {
        let single = std::slice::from_ref(entry);
        legend::draw(drawing, (x, y - 0.5 * legend::height(single)), single);
        x += legend::width(single) + 36.0;
    }
}
