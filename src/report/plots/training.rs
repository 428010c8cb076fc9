//! The course of a training: loss, and validation errors beside those of a baseline.

use super::axis::Axis;
use super::drawing::Saved;
use super::history::panels;
use super::lines::{self, Line, Look};
use std::path::Path;

/// An error that falls (or does not) over the steps, as (step, value).
#[derive(Debug, Clone)]
pub struct ErrorCurve {
    pub name: &'static str,
    pub points: Vec<(f64, f64)>,
    /// The baseline's error, if it has one.
    pub baseline: Option<f64>,
}

/// Two panels over the steps: `loss` as (step, value), and below it `errors` with those of the baseline called `baseline`
/// (thin). Curves without a number above 0 are left out.
pub fn training_curves(stem: &Path, loss: &[(f64, f64)], errors: &[ErrorCurve], baseline: &str) -> Saved {
    let shows = |line: &&ErrorCurve| line.points.iter().any(|p| p.1.is_finite() && p.1 > 0.0);
    let steps = loss.iter().chain(errors.iter().flat_map(|error| &error.points)).map(|p| p.0);
    let last = steps.clone().fold(0.0, f64::max);
    let mut lower = vec![];
    for (k, error) in errors.iter().filter(shows).enumerate() {
        let look = Look::series(k);
        lower.push(Line::new(error.name, error.points.clone(), look));
        if let Some(value) = error.baseline.filter(|value| value.is_finite() && *value > 0.0) {
            let thin = Look::plain(look.color, 1.4, Some(lines::THIN));
            lower.push(Line::new(format!("{}, {baseline}", error.name), vec![(0.0, value), (last, value)], thin));
        }
    }
    let axis = |points: &mut dyn Iterator<Item = &(f64, f64)>| Axis::around_log(points.map(|p| p.1));
    panels(
        stem,
        ("training step", Axis::around(steps.chain([0.0]))),
        &[
            ("training loss", 250.0, axis(&mut loss.iter()), vec![Line::new("", loss.to_vec(), Look::series(0))]),
            ("validation error", 340.0, axis(&mut lower.iter().flat_map(|line| &line.points)), lower),
        ],
    )
}
