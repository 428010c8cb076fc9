//! Difference quotients: of several steps, of which one has to be near enough, and of means of a flow in time.

use hydrograd::scene::around_flow::Around;

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

/// The derivative of the mean objective by variable k, along steps of these sizes: Richardson's from differences by `step` and half of it.
pub fn of_mean(around: &impl Around, first: &[f64], sizes: &[f64], k: usize, step: f64) -> f64 {
    let at = |step: f64| {
        let mut moved = first.to_vec();
        moved[k] += step;
        let (found, _) = around.march(&moved, Some(sizes), &mut |_, _| Ok(())).unwrap();
        found.objective(&around.window(&moved, &found).unwrap())
    };
    let central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
    (4.0 * central(0.5 * step) - central(step)) / 3.0
}
