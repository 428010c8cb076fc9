//! The states of a run that an objective samples.

use std::collections::BTreeMap;

/// The sampled states of a run: the weight of the state after each of these steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Samples(pub BTreeMap<usize, f64>);

impl Samples {
    /// `count` evenly spaced samples among the last `window` steps of `steps`, the last step among them, equally weighted.
    pub fn window(steps: usize, window: usize, count: usize) -> Self {
        let count = count.min(window.max(1)).max(1);
        let chosen: std::collections::BTreeSet<usize> =
            (0..count).map(|k| steps - k * window / count).filter(|&s| s > 0).collect();
        let weight = 1.0 / chosen.len().max(1) as f64;
        Self(chosen.into_iter().map(|s| (s, weight)).collect())
    }

    /// The weight of the state after `step` steps, if it is sampled.
    pub fn weight(&self, step: usize) -> Option<f64> {
        self.0.get(&step).copied()
    }
}
