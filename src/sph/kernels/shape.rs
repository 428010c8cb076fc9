//! What a smoothing kernel's shape says of itself.

use crate::numerics::lanes::{Lanes, Real};
use candle_core::{Result, Tensor};

/// The shape of a kernel, as a function of q = d/h alone.
pub trait SmoothingKernel: Copy {
    /// Support radius in h: w(q) = 0 from there on. The same as [`crate::config::scene::KernelName::support`], which configurations are checked by.
    const SUPPORT: f64;
    /// What F and G of [`Self::shape`] are to be multiplied with: a factor that all their terms share.
    const SLOPE: f64;

    /// w(0).
    fn at_zero(_dimension: usize) -> f64 {
        1.0
    }

    /// sigma: W integrates to 1.
    fn sigma(dimension: usize, smoothing_length: f64) -> f64;

    /// w, and over [`Self::SLOPE`] w'/q and (w'/q)'/q; `inverse` is 1/q, `dimension` the number of
    /// dimensions. At q = 0, which only self pairs and padding have, all must be finite.
    fn shape<L: Lanes>(q: L, inverse: L, dimension: L) -> (L, L, L);

    /// w and w'/q of a tensor of q > 0, from candle's operators.
    fn composed(q: &Tensor, dimension: usize) -> Result<(Tensor, Tensor)>;
}

/// A number in every lane.
#[inline(always)]
pub(crate) fn number<L: Lanes>(value: f64) -> L {
    L::splat(L::Real::of(value))
}

/// A sigma that is a numerator over a denominator and h^D, given for 1, 2 and 3 dimensions.
pub(super) fn ratio(of: [(f64, f64); 3], dimension: usize, h: f64) -> f64 {
    let (numerator, denominator) = of[dimension - 1];
    numerator / (0..dimension).fold(denominator, |product, _| product * h)
}
