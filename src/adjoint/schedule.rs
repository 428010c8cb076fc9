//! Which states of a run are kept, and what that costs. Apart from the executor, so that it can be tested without
//! running physics.

/// Bytes that a schedule's two kinds of storage take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Costs {
    /// A kept state.
    pub state: usize,
    /// One step on the tape: every tensor that the backward pass reads.
    pub tape_step: usize,
}

/// A run of `steps` steps in segments of equal length (the last may be shorter). The forward run keeps the state at
/// the start of each segment that is differentiated; the backward run replays segment by segment, last to first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    pub steps: usize,
    pub segment: usize,
    /// First step that is differentiated: 0, or `steps - horizon` for a truncated gradient.
    pub first: usize,
}

impl Schedule {
    /// Segments of a given length over the whole run.
    pub fn segments(steps: usize, segment: usize) -> Self {
        Self { steps, segment: segment.clamp(1, steps.max(1)), first: 0 }
    }

    /// One tape for the whole run.
    pub fn taped(steps: usize) -> Self {
        Self::segments(steps, steps)
    }

    /// Only the last `horizon` steps are differentiated.
    pub fn truncated(steps: usize, horizon: usize, segment: usize) -> Self {
        let first = steps.saturating_sub(horizon);
        Self { steps, segment: segment.clamp(1, (steps - first).max(1)), first }
    }

    /// The segment length that needs the least memory, near sqrt(steps state/tape): (steps/k) states and k taped steps.
    pub fn least_memory(steps: usize, costs: Costs) -> usize {
        (1..=steps).min_by_key(|&k| Self::segments(steps, k).memory(costs)).unwrap_or(1)
    }

    /// Starts and ends of the segments, first to last.
    pub fn bounds(&self) -> Vec<(usize, usize)> {
        (self.first..self.steps)
            .step_by(self.segment)
            .map(|start| (start, (start + self.segment).min(self.steps)))
            .collect()
    }

    /// States kept at the same time.
    pub fn stored_states(&self) -> usize {
        (self.steps - self.first).div_ceil(self.segment)
    }

    /// Steps that are run twice.
    pub fn recomputed_steps(&self) -> usize {
        self.steps - self.first
    }

    /// Largest number of steps on the tape.
    pub fn taped_steps(&self) -> usize {
        self.segment.min(self.steps - self.first)
    }

    /// Peak storage in bytes.
    pub fn memory(&self, costs: Costs) -> usize {
        self.stored_states() * costs.state + self.taped_steps() * costs.tape_step
    }
}
