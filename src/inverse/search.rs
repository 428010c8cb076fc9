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
