//! The search for unknowns: epochs of an optimiser, each a run with its gradient.

use crate::design::limits::Limits;
use crate::design::optimisers::Optimiser;
use crate::error::Error;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch<'a> {
    pub number: usize,
    /// The values of the unknowns.
    pub at: &'a [f64],
    /// The loss; infinite if the run diverged.
    pub loss: f64,
}

/// Computes loss and gradient for values of the unknowns in an epoch.
pub type Evaluate<'a> = dyn FnMut(usize, &[f64]) -> Result<(f64, Vec<f64>), Error> + 'a;

#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    pub at: Vec<f64>,
    pub loss: f64,
    /// Number of epochs of the search.
    pub epochs: usize,
}

/// Searches for up to `epochs` epochs, fewer if the optimiser is done or the gradient is zero. A run that diverges
/// after the first epoch had too long a step. `evaluate` gives loss and gradient of an epoch; `see` gets its result.
///
/// # Errors
/// Those of `evaluate`, except for a divergence after the first epoch.
pub fn search(
    optimiser: &mut dyn Optimiser,
    limits: &Limits,
    epochs: usize,
    evaluate: &mut Evaluate<'_>,
    see: &mut dyn FnMut(Epoch<'_>),
) -> Result<Found, Error> {
    let mut best = Found { at: optimiser.ask().to_vec(), loss: f64::INFINITY, epochs: 0 };
    while best.epochs < epochs && !optimiser.is_done() {
        let at = optimiser.ask().to_vec();
        let (loss, gradient) = match evaluate(best.epochs, &at) {
            Err(Error::Diverged { .. }) if best.epochs > 0 => (f64::INFINITY, vec![0.0; at.len()]),
            found => found?,
        };
        see(Epoch { number: best.epochs, at: &at, loss });
        best.epochs += 1;
        if loss < best.loss {
            (best.at, best.loss) = (at, loss);
        }
        if loss.is_finite() && gradient.iter().all(|g| *g == 0.0) {
            break;
        }
        optimiser.tell(limits, loss, &gradient);
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::optimisers::BarzilaiBorwein;

    /// (x - 3)^2, which diverges beyond `edge`.
    fn parabola(edge: f64) -> impl FnMut(usize, &[f64]) -> Result<(f64, Vec<f64>), Error> {
        move |_, x| match x[0] <= edge {
            true => Ok(((x[0] - 3.0).powi(2), vec![2.0 * (x[0] - 3.0)])),
            false => Err(Error::diverged("beyond the edge", "less")),
        }
    }

    fn found(first: f64, edge: f64, epochs: usize) -> (Result<Found, Error>, Vec<f64>) {
        let limits = Limits::within(vec![f64::NEG_INFINITY], vec![f64::INFINITY]);
        let mut losses = vec![];
        let mut optimiser = BarzilaiBorwein::new(8.0, &[first]);
        let mut see = |epoch: Epoch<'_>| losses.push(epoch.loss);
        let found = search(&mut optimiser, &limits, epochs, &mut parabola(edge), &mut see);
        (found, losses)
    }

    #[test]
    fn a_run_that_diverges_is_a_step_too_far() {
        let (best, losses) = found(0.0, 5.0, 30);
        let best = best.unwrap();
        // The first step is by 8, then 2, and to the minimum.
        assert_eq!(losses[..3], [9.0, f64::INFINITY, 1.0]);
        assert_eq!((best.at, best.loss), (vec![3.0], 0.0));
        assert!(best.epochs == losses.len() && best.epochs < 30, "{losses:?}");
    }

    #[test]
    fn the_best_of_the_epochs_is_kept_and_a_first_run_must_not_diverge() {
        assert_eq!(found(0.0, 5.0, 2).0.unwrap(), Found { at: vec![0.0], loss: 9.0, epochs: 2 });
        assert!(matches!(found(6.0, 5.0, 2).0, Err(Error::Diverged { .. })));
    }
}
