//! Difference quotients of several steps, of which one has to be near enough.

/// The smallest gap that a step of the differences gives. A large step meets kinks and the next term of the series, a small one
/// rounding; so steps are tried in their order until one gives at most `allowed`.
pub fn smallest_gap(steps: &[f64], allowed: f64, mut gap: impl FnMut(f64) -> f64) -> f64 {
    let mut smallest = f64::INFINITY;
    for &step in steps {
        smallest = smallest.min(gap(step));
        if smallest <= allowed {
            break;
        }
    }
    smallest
}
