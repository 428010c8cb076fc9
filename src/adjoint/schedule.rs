//! Checkpointing schedules: which states of a run are kept, which steps are recomputed, and what this costs. A schedule
//! is a list of actions, from which all counts follow, so it can be tested without physics.
//!
//! Every kind tapes (runs on the graph and differentiates) each step exactly once:
//!
//! | kind | states kept | on the tape | steps run again |
//! |---|---|---|---|
//! | every state | n | 1 step | 0 |
//! | segments of k | n/k | k steps | 0 |
//! | two-level, every k-th | n/k + k - 1 | 1 step | n - n/k - k + 1 |
//! | binomial, c states | c | 1 step | least possible for c |
//!
//! Binomial schedules: Griewank and Walther (2000), Algorithm 799: Revolve, ACM Trans. Math. Softw. 26(1). With c
//! states and no step run more than r times, at most C(c + r, c) steps can be reversed.

use super::dynamics::{Bytes, Held};
use crate::config::memory_size::MemorySize;
use crate::error::BadInput;

/// Memory costs of a schedule, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Costs {
    pub state: usize,
    pub rounded_state: usize,
    /// Data that kept states share for `shared_steps` steps: the positions from which their neighbour list is built.
    pub shared: usize,
    /// Approximate number of steps for which one such list is valid; 0 stands for 1.
    pub shared_steps: usize,
    /// One step on the tape: every tensor that the backward pass reads.
    pub tape_step: usize,
    /// The list itself, once for the steps on the tape that share it.
    pub tape_shared: usize,
    /// What any gradient needs: the run's buffers, a list, and the cotangents of one step.
    pub working: usize,
}

impl Costs {
    /// Number of lists that `count` states need, evenly spread over `steps` steps.
    fn lists(&self, count: usize, steps: usize) -> usize {
        count.min(steps.div_ceil(self.shared_steps.max(1)) + 1)
    }
}

/// The states that a schedule keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Every state, with one step at a time on the tape. `rounded`: in single precision. A step linearised at a rounded
    /// state is nearly the same, but a replay of many steps would be another run, so other kinds are not rounded.
    EveryState { rounded: bool },
    /// The state at the start of each segment of `length` steps (the last may be shorter), which is taped as a whole.
    Segments { length: usize },
    /// As `Segments`, but the states of a segment are recomputed and kept when it is differentiated, with one step at a
    /// time on the tape.
    TwoLevel { interval: usize },
    /// Revolve with at most `states` kept at a time, and one step at a time on the tape.
    Binomial { states: usize },
}

/// An action of the executor. The present state is the one after the last `Advance` or `Restore`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Run the steps `from` ... `to` - 1 from the present state without a graph.
    Advance { from: usize, to: usize },
    /// Keep the present state.
    Store { step: usize },
    /// Return to a kept state.
    Restore { step: usize },
    /// Run the steps `from` ... `to` - 1 on the graph from the present state, and map the cotangent of their end to
    /// that of their start. The present state is lost.
    Tape { from: usize, to: usize },
    /// Delete a kept state.
    Discard { step: usize },
}

/// The work and the storage of a schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Counts {
    /// Largest number of states kept at the same time.
    pub stored_states: usize,
    /// Largest number of steps on the tape at the same time.
    pub taped_steps: usize,
    /// Number of steps run without a graph, including the first forward run.
    pub plain_steps: usize,
    /// Number of these steps that had been run before.
    pub recomputed_steps: usize,
    /// Number of steps run on the graph.
    pub differentiated_steps: usize,
}

/// The schedule of a gradient over the steps `first` ... `steps` - 1 of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    pub steps: usize,
    /// First step that is differentiated: 0, or `steps - horizon` for a truncated gradient.
    pub first: usize,
    pub kind: Kind,
    /// Limit of the derivative by the state where the flow moves it, as a multiple of its largest norm while terms of
    /// the objective were added; applied every [`super::run::CHECK_EVERY`] steps. 0: no limit, an exact gradient.
    pub clip: f64,
}

/// A memory budget that is too small for any schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooSmall {
    /// Bytes of the schedule with the least memory.
    pub least: usize,
}

impl Schedule {
    fn new(steps: usize, first: usize, kind: Kind) -> Self {
        let first = first.min(steps);
        let most = (steps - first).max(1);
        let kind = match kind {
            Kind::EveryState { rounded } => Kind::EveryState { rounded },
            Kind::Segments { length } if length.min(most) <= 1 => Kind::EveryState { rounded: false },
            Kind::Segments { length } => Kind::Segments { length: length.min(most) },
            Kind::TwoLevel { interval } => Kind::TwoLevel { interval: interval.clamp(1, most) },
            Kind::Binomial { states } => Kind::Binomial { states: states.clamp(1, most) },
        };
        Self { steps, first, kind, clip: 0.0 }
    }

    /// Adds a limit to the derivative by the state, see [`Self::clip`]; the gradient is then not exact.
    pub fn clipped(self, clip: f64) -> Self {
        Self { clip, ..self }
    }

    /// Segments of a given length over the whole run; a length of 1 keeps every state.
    pub fn segments(steps: usize, length: usize) -> Self {
        Self::new(steps, 0, Kind::Segments { length })
    }

    /// One tape for the whole run.
    pub fn taped(steps: usize) -> Self {
        Self::segments(steps, steps)
    }

    /// Differentiates only the last `horizon` steps.
    pub fn truncated(steps: usize, horizon: usize, length: usize) -> Self {
        Self::new(steps, steps.saturating_sub(horizon), Kind::Segments { length })
    }

    /// Keeps every state, exactly or rounded to single precision.
    pub fn every_state(steps: usize, first: usize, rounded: bool) -> Self {
        Self::new(steps, first, Kind::EveryState { rounded })
    }

    /// Keeps every `interval`-th state, and recomputes those between when they are needed.
    pub fn two_level(steps: usize, first: usize, interval: usize) -> Self {
        Self::new(steps, first, Kind::TwoLevel { interval })
    }

    /// Revolve with `states` kept.
    pub fn binomial(steps: usize, first: usize, states: usize) -> Self {
        Self::new(steps, first, Kind::Binomial { states })
    }

    /// The schedule of the steps from `first` on that recomputes the fewest steps within `budget` bytes. If none need
    /// be recomputed, it keeps every state if that fits, else it uses the shortest segments that fit. (Segments of ten
    /// or more steps are about 10 % faster than every state where a step is short, N = 950, because starting and ending
    /// a tape costs several passes over a state. `--segment` chooses them.)
    pub fn within(steps: usize, first: usize, costs: Costs, budget: usize) -> Result<Self, TooSmall> {
        let most = steps.saturating_sub(first).max(1);
        let fits = |schedule: &Self| schedule.bound(costs) <= budget;
        let lengths = 1..=most;
        let segments = lengths.clone().map(|length| Self::new(steps, first, Kind::Segments { length }));
        // All but the first step of each interval, and none of the last interval, whose states are still kept.
        let again = |k: usize| (most.div_ceil(k) - 1) * (k - 1);
        let two_level = lengths.map(|k| (again(k), Self::two_level(steps, first, k)));
        let least_again = two_level.filter(|(_, s)| fits(s)).min_by_key(|(again, _)| *again).map(|(_, s)| s);
        if let Some(found) = { segments }.find(fits).or(least_again) {
            return Ok(found);
        }
        let least = Self::binomial(steps, first, 1).bound(costs);
        if budget < least {
            return Err(TooSmall { least });
        }
        let states = 1 + (budget - least) / (costs.state + costs.shared).max(1);
        Ok(Self::binomial(steps, first, states))
    }

    /// [`Self::within`] for the budget of `optimise.memory`.
    ///
    /// # Errors
    /// A budget that is too small for any schedule.
    pub fn affordable(steps: usize, first: usize, costs: Costs, budget: MemorySize) -> Result<Self, BadInput> {
        Self::within(steps, first, costs, budget.bytes()).map_err(|too_small| {
            let segments = Self::least_memory(steps - first, costs);
            let good = Self::segments(steps - first, segments).memory(costs);
            let problem =
                format!("optimise.memory = {budget} is too small for the gradient of {} steps", steps - first);
            BadInput::new(problem)
                .allowed(format!("at least {} (one state kept, and very slow)", rounded_up(too_small.least)))
                .advice(format!("optimise.memory={} (no step is run twice)", rounded_up(good)))
        })
    }

    /// The segment length with the least memory, near sqrt(steps state/tape): (steps/k) states and k taped steps.
    pub fn least_memory(steps: usize, costs: Costs) -> usize {
        (1..=steps).min_by_key(|&k| Self::segments(steps, k).bound(costs)).unwrap_or(1)
    }

    /// Number of steps that are differentiated.
    fn differentiated(&self) -> usize {
        self.steps - self.first
    }

    /// Whether kept states are rounded to single precision.
    pub fn is_rounded(&self) -> bool {
        self.kind == Kind::EveryState { rounded: true }
    }

    /// The actions, in order. They are made one by one, because the list may be longer than the states.
    pub fn actions(&self) -> Box<dyn Iterator<Item = Action>> {
        let (first, end) = (self.first, self.steps);
        let before = (first > 0).then_some(Action::Advance { from: 0, to: first }).into_iter();
        match self.kind {
            Kind::EveryState { .. } => Box::new(before.chain(segments(first, end, 1))),
            Kind::Segments { length } => Box::new(before.chain(segments(first, end, length))),
            Kind::TwoLevel { interval } => Box::new(before.chain(two_level(first, end, interval))),
            Kind::Binomial { states } => Box::new(before.chain(revolve(first, end, states))),
        }
    }

    /// Plays the actions and counts.
    pub fn counts(&self) -> Counts {
        self.play(Costs::default()).0
    }

    /// Peak memory of kept states and tape, in bytes.
    pub fn storage(&self, costs: Costs) -> usize {
        self.play(costs).1
    }

    /// Peak memory in bytes, including what any gradient needs.
    pub fn memory(&self, costs: Costs) -> usize {
        self.storage(costs) + costs.working
    }

    /// The counts, and the largest number of bytes kept and taped at the same time.
    fn play(&self, costs: Costs) -> (Counts, usize) {
        let own = if self.is_rounded() { costs.rounded_state } else { costs.state };
        let list_of = |step: usize| step / costs.shared_steps.max(1);
        let kept = |step: usize| Bytes { own, shared: costs.shared, identity: list_of(step) };
        let (mut counts, mut held) = (Counts::default(), Held::default());
        let (mut seen, mut stored) = (0, 0);
        for action in self.actions() {
            match action {
                Action::Advance { from, to } => {
                    counts.plain_steps += to - from;
                    counts.recomputed_steps += seen.clamp(from, to) - from;
                    seen = seen.max(to);
                }
                Action::Store { step } => {
                    stored += 1;
                    counts.stored_states = counts.stored_states.max(stored);
                    held.add(kept(step));
                }
                Action::Discard { step } => {
                    stored -= 1;
                    held.remove(kept(step));
                }
                Action::Tape { from, to } => {
                    // Values of the objective come from a plain run, which is made for steps that were taped first.
                    counts.plain_steps += to - seen.clamp(from, to);
                    seen = seen.max(to);
                    counts.differentiated_steps += to - from;
                    counts.taped_steps = counts.taped_steps.max(to - from);
                    let taped_lists = list_of(to - 1) - list_of(from) + 1;
                    let tape = (to - from) * costs.tape_step + taped_lists * costs.tape_shared;
                    held.peak = held.peak.max(held.now + tape);
                }
                Action::Restore { .. } => {}
            }
        }
        (counts, held.peak)
    }

    /// An upper bound of [`Self::memory`] in closed form, for comparing many schedules.
    fn bound(&self, costs: Costs) -> usize {
        let n = self.differentiated();
        let (states, taped) = match self.kind {
            Kind::EveryState { .. } => (n, 1),
            Kind::Segments { length } => (n.div_ceil(length), length),
            Kind::TwoLevel { interval } => (n.div_ceil(interval) + interval - 1, 1),
            Kind::Binomial { states } => (states, 1),
        };
        let state = if self.is_rounded() { costs.rounded_state } else { costs.state };
        states * state
            + costs.lists(states, n) * costs.shared
            + taped * costs.tape_step
            + costs.lists(taped, taped) * costs.tape_shared
            + costs.working
    }
}

impl std::fmt::Display for Schedule {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.differentiated();
        match self.kind {
            Kind::EveryState { rounded: false } => write!(out, "every state kept"),
            Kind::EveryState { rounded: true } => write!(out, "every state kept, rounded to f32"),
            Kind::Segments { length } if length >= n => write!(out, "one tape"),
            Kind::Segments { length } => {
                write!(out, "a state every {length} steps, {length} steps on the tape at once")
            }
            Kind::TwoLevel { interval } => {
                write!(out, "a state every {interval} steps, those between restored in turn")
            }
            Kind::Binomial { states } => write!(out, "binomial (Revolve) with {states} states"),
        }
    }
}

/// Goes back over the steps `from` ... `to` - 1, whose first state is kept and no longer needed then.
fn back(from: usize, to: usize) -> [Action; 3] {
    [Action::Restore { step: from }, Action::Tape { from, to }, Action::Discard { step: from }]
}

/// Forward over the segments of the steps `first` ... `end` - 1, and back over them.
fn segments(first: usize, end: usize, length: usize) -> impl Iterator<Item = Action> {
    let starts = (first..end).step_by(length);
    let until = move |from: usize| (from + length).min(end);
    let forward = move |from| [Action::Store { step: from }, Action::Advance { from, to: until(from) }];
    starts.clone().flat_map(forward).chain(starts.rev().flat_map(move |from| back(from, until(from))))
}

/// As [`segments`], but back over single steps, whose states are first kept in a run from the beginning of the segment.
/// The last segment is differentiated first, so its states are kept at once.
fn two_level(first: usize, end: usize, interval: usize) -> impl Iterator<Item = Action> {
    let starts = (first..end).step_by(interval);
    let last = starts.clone().next_back().unwrap_or(end);
    let forward = move |from: usize| {
        let to = if from < last { from + interval } else { from + 1 };
        [Action::Store { step: from }, Action::Advance { from, to }]
    };
    let refill = |from: usize| [Action::Advance { from, to: from + 1 }, Action::Store { step: from + 1 }];
    let backward = move |from: usize| {
        let (to, left_out) = if from < last { (from + interval, from..from + interval - 1) } else { (end, end..end) };
        let restore = (!left_out.is_empty()).then_some(Action::Restore { step: from });
        let steps = (from..to).rev().flat_map(|step| back(step, step + 1));
        restore.into_iter().chain(left_out.flat_map(refill)).chain(steps)
    };
    (first..last).step_by(interval).chain(last..end).flat_map(forward).chain(starts.rev().flat_map(backward))
}

/// Revolve over the steps `first` ... `end` - 1 with room for `states` states.
fn revolve(first: usize, end: usize, states: usize) -> impl Iterator<Item = Action> {
    enum Task {
        Do(Action),
        /// Adjoints of the steps `from` ... `to` - 1, starting from the present and kept state `from`, with room for
        /// `states` states, including that of `from`.
        Reverse(usize, usize, usize),
    }
    // The last task is the next one.
    let mut pending = match first < end {
        true => vec![
            Task::Do(Action::Discard { step: first }),
            Task::Reverse(first, end, states),
            Task::Do(Action::Store { step: first }),
        ],
        false => vec![],
    };
    std::iter::from_fn(move || loop {
        match pending.pop()? {
            Task::Do(action) => return Some(action),
            Task::Reverse(from, to, _) if to - from == 1 => return Some(Action::Tape { from, to }),
            Task::Reverse(from, to, 1) => pending.extend([
                Task::Reverse(from, to - 1, 1),
                Task::Do(Action::Restore { step: from }),
                Task::Do(Action::Tape { from: to - 1, to }),
                Task::Do(Action::Advance { from, to: to - 1 }),
            ]),
            Task::Reverse(from, to, states) => {
                let middle = from + split(to - from, states);
                pending.extend([
                    Task::Reverse(from, middle, states),
                    Task::Do(Action::Restore { step: from }),
                    Task::Do(Action::Discard { step: middle }),
                    Task::Reverse(middle, to, states - 1),
                    Task::Do(Action::Store { step: middle }),
                    Task::Do(Action::Advance { from, to: middle }),
                ]);
            }
        }
    })
}

/// Largest number of times that one of `length` steps is run forward with room for `states` states: the smallest r with
/// C(states + r, states) >= length.
fn repetitions(length: usize, states: usize) -> usize {
    let (mut reach, mut r) = (1u128, 0usize);
    while reach < length as u128 {
        r += 1;
        reach = reach * (states + r) as u128 / r as u128;
    }
    r
}

/// The next state to keep: the m that minimises m + t(l - m, s - 1) + t(m, s), where t(l, s) is the smallest number of
/// steps to run forward for the adjoints of l steps with room for s states: r l - C(s + r, r - 1), r = `repetitions`
/// (Griewank and Walther 2000). t is convex in the length with slope r, so the slope of the sum changes its sign once.
fn split(length: usize, states: usize) -> usize {
    let (mut low, mut high) = (1, length - 1);
    while low < high {
        let m = (low + high) / 2;
        // From m to m + 1: one more step to reach it, r(m + 1, s) more on the left, r(l - m, s - 1) fewer on the right.
        if 1 + repetitions(m + 1, states) >= repetitions(length - m, states - 1) {
            high = m;
        } else {
            low = m + 1;
        }
    }
    low
}

/// A number of bytes in the form of `optimise.memory`, rounded up to a tenth of a megabyte.
pub fn rounded_up(bytes: usize) -> String {
    format!("{:.1}MB", (bytes as f64 / 1e5).ceil() / 10.0)
}
