//! A search without gradients, to compare with: CMA-ES (Hansen and Ostermeier 2001), by the crate `cmaes`.
//!
//! It moves a cloud of designs by their ranks alone. A design outside of the limits is taken to the nearest one inside, and pays
//! for the distance: f(nearest) + |x - nearest|^2 / step^2 times the fall of f so far (Hansen 2016, "The CMA evolution strategy: a
//! tutorial", section B.5). What it finds takes many evaluations, so it is for a few variables: the control points of a B-spline.

use super::limits::Limits;
use crate::error::Error;
use cmaes::{CMAESOptions, DVector};

/// A design that was evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluated {
    pub variables: Vec<f64>,
    pub loss: f64,
}

/// Evaluates `evaluations` designs or a few more (generations are not cut), in their order; the first is `first`. `step` is how
/// far the first ones are from it.
///
/// # Errors
/// Those of `loss`: after one, nothing more is evaluated. A design whose run diverges should have an infinite loss instead.
pub fn search(
    first: &[f64],
    step: f64,
    evaluations: usize,
    seed: u64,
    limits: &Limits,
    loss: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
) -> Result<Vec<Evaluated>, Error> {
    let begin = loss(first)?;
    let mut seen = vec![Evaluated { variables: first.to_vec(), loss: begin }];
    let mut failed = None;
    let mut least = begin;
    let function = |x: &DVector<f64>| {
        let mut nearest = x.as_slice().to_vec();
        limits.nearest(&mut nearest);
        if failed.is_some() {
            return f64::MAX;
        }
        let found = loss(&nearest).unwrap_or_else(|error| {
            failed = Some(error);
            f64::INFINITY
        });
        let distance: f64 = x.iter().zip(&nearest).map(|(x, near)| (x - near).powi(2)).sum();
        least = least.min(found);
        seen.push(Evaluated { variables: nearest, loss: found });
        // The crate wants numbers.
        let price = distance / (step * step) * (begin - least).max(1e-3 * begin.abs());
        if found.is_finite() {
            found + price
        } else {
            f64::MAX
        }
    };
    let options = CMAESOptions::new(first.to_vec(), step).max_function_evals(evaluations).seed(seed);
    let mut state = options
        .build(function)
        .map_err(|error| Error::run(format!("CMA-ES does not begin: {error:?}"), "more design variables than none"))?;
    state.run();
    drop(state);
    match failed {
        Some(error) => Err(error),
        None => Ok(seen),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_minimum_within_limits_and_again() {
        // (x - 3)^2 + (y + 1)^2 over x <= 2: the minimum is at (2, -1).
        let limits = Limits::within(vec![-5.0, -5.0], vec![2.0, 5.0]);
        let mut loss = |x: &[f64]| Ok((x[0] - 3.0).powi(2) + (x[1] + 1.0).powi(2));
        let mut run = || search(&[0.0, 0.0], 0.5, 300, 7, &limits, &mut loss).unwrap();
        let seen = run();
        assert!(seen.iter().all(|one| limits.contains(&one.variables)));
        let best = seen.iter().min_by(|a, b| a.loss.total_cmp(&b.loss)).unwrap();
        assert!((best.variables[0] - 2.0).abs() < 1e-3 && (best.variables[1] + 1.0).abs() < 1e-2, "{best:?}");
        assert_eq!(run(), seen, "the same seed, the same search");
    }

    #[test]
    fn an_error_ends_it() {
        let limits = Limits::within(vec![-1.0], vec![1.0]);
        let mut calls = 0;
        let mut loss = |x: &[f64]| {
            calls += 1;
            match calls {
                4 => Err(Error::run("no", "nothing")),
                _ => Ok(x[0]),
            }
        };
        assert!(search(&[0.5], 0.1, 50, 1, &limits, &mut loss).is_err());
        assert_eq!(calls, 4);
    }
}
