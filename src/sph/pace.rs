//! The part of a step that is being made, and its length.

/// The present time step and the one before it, which is 0 at the start of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeSteps {
    pub now: f64,
    pub before: f64,
}

/// The part of a step that is being made, and the one before it. Between steps it is the last part of the last step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Number of parts of this step.
    pub parts: usize,
    /// Number of parts of the step that the previous part belongs to.
    before: usize,
    /// Whether this part is the first of its step.
    first: bool,
}

impl Pace {
    /// The state after a step of `parts` parts.
    pub fn after(parts: usize) -> Self {
        Self { parts, before: parts, first: true }
    }

    /// Moves on to part number `part` of a step of `parts` parts.
    pub fn next(self, part: usize, parts: usize) -> Self {
        Self { parts, before: self.parts, first: part == 0 }
    }

    /// The length of this part of step number `step`, and of the part before it.
    pub fn times(self, dt: f64, step: usize) -> TimeSteps {
        let has_before = step > 0 || !self.first;
        TimeSteps { now: dt / self.parts as f64, before: if has_before { dt / self.before as f64 } else { 0.0 } }
    }
}
