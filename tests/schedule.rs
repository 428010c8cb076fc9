//! Schedules without physics: a small machine that plays the actions, knows nothing of how they were made, and fails
//! when a step is missed, taken twice or begun from a state that is not there.

use hydrograd::adjoint::schedule::{Action, Costs, Counts, Kind, Schedule};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// Plays a schedule and counts.
fn play(schedule: &Schedule) -> Counts {
    let mut present = Some(0);
    let mut kept = BTreeSet::new();
    let mut adjoined = schedule.steps;
    let mut seen = 0;
    let mut counts = Counts::default();
    for action in schedule.actions() {
        let at = format!("{schedule:?}, {action:?}");
        match action {
            Action::Advance { from, to } => {
                assert_eq!(present, Some(from), "{at}");
                assert!(from < to && to <= schedule.steps, "{at}");
                counts.plain_steps += to - from;
                counts.recomputed_steps += (from..to).filter(|step| *step < seen).count();
                seen = seen.max(to);
                present = Some(to);
            }
            Action::Store { step } => {
                assert_eq!(present, Some(step), "{at}");
                assert!(kept.insert(step), "{at}: kept already");
                counts.stored_states = counts.stored_states.max(kept.len());
            }
            Action::Restore { step } => {
                assert!(kept.contains(&step), "{at}");
                present = Some(step);
            }
            Action::Tape { from, to } => {
                assert_eq!(present.take(), Some(from), "{at}");
                // Last to first, each step once.
                assert_eq!(to, adjoined, "{at}");
                assert!(from < to, "{at}");
                adjoined = from;
                counts.plain_steps += (from..to).filter(|step| *step >= seen).count();
                seen = seen.max(to);
                counts.differentiated_steps += to - from;
                counts.taped_steps = counts.taped_steps.max(to - from);
            }
            Action::Discard { step } => assert!(kept.remove(&step), "{at}"),
        }
    }
    assert_eq!(adjoined, schedule.first, "{schedule:?}: steps are missing");
    assert!(kept.is_empty(), "{schedule:?}: {kept:?} are kept for ever");
    assert_eq!(counts.differentiated_steps, schedule.steps - schedule.first);
    assert_eq!(counts.plain_steps, schedule.steps + counts.recomputed_steps, "{schedule:?}");
    counts
}

/// The fewest forward steps by trying every place for the next state (Griewank and Walther 2000, eq. 1).
fn fewest(length: usize, states: usize, known: &mut Vec<Vec<Option<usize>>>) -> usize {
    if length <= 1 {
        return 0;
    }
    if states == 1 {
        return length * (length - 1) / 2;
    }
    if let Some(found) = known[length][states] {
        return found;
    }
    let of = |m, known: &mut _| m + fewest(length - m, states - 1, known) + fewest(m, states, known);
    let found = (1..length).map(|m| of(m, known)).min().unwrap_or(0);
    known[length][states] = Some(found);
    found
}

#[test]
fn binomial_schedules_are_optimal() {
    let mut known = vec![vec![None; 16]; 61];
    for length in 1..=60 {
        for states in 1..=15 {
            let best = fewest(length, states, &mut known);
            let counts = play(&Schedule::binomial(length, 0, states));
            // One step more than Revolve's count: the last is run without a graph too, for the objective's value.
            assert_eq!(counts.plain_steps, best + 1, "{length} steps, {states} states");
            assert!(counts.stored_states <= states);
        }
    }
}

/// Published numbers. With s states and r repetitions C(s + r, s) steps can be reversed, each step run forward at most
/// r times.
#[test]
fn binomial_schedules_reach_as_far_as_revolve() {
    let binomial = |n: u64, k: u64| (1..=k).fold(1, |c, i| c * (n - k + i) / i) as usize;
    for (states, repetitions) in [(3, 3), (5, 4), (10, 3), (2, 10), (20, 2), (4, 1)] {
        let reach = binomial(states + repetitions, states);
        let schedule = Schedule::binomial(reach, 0, states as usize);
        let mut runs = vec![0; reach];
        for action in schedule.actions() {
            if let Action::Advance { from, to } = action {
                (from..to).for_each(|step| runs[step] += 1);
            }
        }
        assert_eq!(runs.iter().max(), Some(&(repetitions as usize)), "{reach} steps with {states} states");
    }
    // Griewank and Walther (2000), section 2: 10 steps with 3 states take 15 forward steps besides the taped ones.
    assert_eq!(play(&Schedule::binomial(10, 0, 3)).plain_steps, 15 + 1);
}

#[test]
fn counts_of_each_kind() {
    let counts = |schedule: Schedule| {
        let found = schedule.counts();
        assert_eq!(found, play(&schedule));
        (found.stored_states, found.taped_steps, found.plain_steps, found.recomputed_steps)
    };
    assert_eq!(counts(Schedule::segments(10, 1)), (10, 1, 10, 0));
    assert_eq!(counts(Schedule::segments(10, 4)), (3, 4, 10, 0));
    assert_eq!(counts(Schedule::taped(10)), (1, 10, 10, 0));
    // 0, 4, 8 and 9; then 5, 6, 7 again; then 1, 2, 3 again.
    assert_eq!(counts(Schedule::two_level(10, 0, 4)), (5, 1, 16, 6));
    assert_eq!(counts(Schedule::truncated(10, 5, 3)), (2, 3, 10, 0));
    assert_eq!(counts(Schedule::two_level(12, 2, 5)), (6, 1, 16, 4));
    assert_eq!(counts(Schedule::binomial(10, 0, 1)), (1, 1, 46, 36));
    assert_eq!(Schedule::segments(10, 1).kind, Kind::EveryState { rounded: false });
    assert_eq!(Schedule::truncated(10, 10, 3), Schedule::segments(10, 3));
    // Nothing to differentiate.
    assert_eq!(counts(Schedule::truncated(10, 0, 3)), (0, 0, 10, 0));
    assert_eq!(counts(Schedule::binomial(10, 10, 3)), (0, 0, 10, 0));
}

#[test]
fn memory_is_states_lists_and_taped_steps() {
    let costs = Costs { state: 100, tape_step: 700, ..Costs::default() };
    assert_eq!(Schedule::segments(10, 4).memory(costs), 3 * 100 + 4 * 700 - 100);
    assert_eq!(Schedule::taped(10).memory(costs), 100 + 10 * 700);
    assert_eq!(Schedule::segments(10, 1).memory(costs), 10 * 100 + 700);
    assert_eq!(Schedule::truncated(10, 6, 3).memory(costs), 2 * 100 + 3 * 700);
    let costs = Costs { rounded_state: 50, shared: 10, shared_steps: 4, tape_shared: 300, working: 1000, ..costs };
    // Steps 0-3, 4-7 and 8-9 have a list each.
    assert_eq!(Schedule::segments(10, 1).memory(costs), 10 * 100 + 3 * 10 + 700 + 300 + 1000);
    assert_eq!(Schedule::every_state(10, 0, true).memory(costs), 10 * 50 + 3 * 10 + 700 + 300 + 1000);
    assert_eq!(Schedule::taped(10).memory(costs), 100 + 10 + 10 * 700 + 3 * 300 + 1000);
    assert_eq!(Schedule::taped(10).storage(costs), Schedule::taped(10).memory(costs) - 1000);
}

#[test]
fn least_memory_is_the_least() {
    for steps in [1usize, 2, 5, 50, 500, 2000] {
        for costs in [(100, 100), (100, 700), (67_000, 330_000), (1000, 3), (5, 100_000), (100, 0)] {
            let costs = Costs { state: costs.0, tape_step: costs.1, ..Costs::default() };
            // Full segments: the shorter last one does not matter for the choice.
            let memory = |k: usize| steps.div_ceil(k) * costs.state + k * costs.tape_step;
            let chosen = memory(Schedule::least_memory(steps, costs));
            assert_eq!(chosen, (1..=steps).map(memory).min().unwrap(), "{steps} steps, {costs:?}");
        }
    }
}

/// From a large budget to a small one, all kinds are chosen, each slower than the one before.
#[test]
fn a_smaller_budget_takes_a_slower_schedule() {
    let costs = Costs {
        state: 60_800,
        rounded_state: 30_400,
        shared: 15_200,
        shared_steps: 5,
        tape_step: 167_200,
        tape_shared: 200_000,
        working: 800_000,
    };
    let chosen = |budget| Schedule::within(2000, 0, costs, budget).map(|s| (s.kind, s.counts().recomputed_steps));
    assert_eq!(chosen(200_000_000), Ok((Kind::EveryState { rounded: false }, 0)));
    let mut kinds = Vec::new();
    let mut before = 0;
    for budget in (0..400).map(|k| (2e8 * 0.98f64.powi(k)) as usize) {
        let Ok((kind, recomputed)) = chosen(budget) else { continue };
        assert!(recomputed >= before, "{budget}: {kind:?} runs {recomputed} steps again, a larger budget {before}");
        before = recomputed;
        let name = format!("{kind:?}").split(' ').next().unwrap().to_string();
        if kinds.last() != Some(&name) {
            kinds.push(name);
        }
    }
    assert_eq!(kinds, ["EveryState", "Segments", "TwoLevel", "Binomial"]);
    let least = chosen(1).unwrap_err().least;
    assert_eq!(chosen(least).map(|c| c.0), Ok(Kind::Binomial { states: 1 }));
    assert_eq!(chosen(least - 1).unwrap_err().least, least);
}

proptest! {
    #[test]
    fn every_schedule_is_complete_and_counts_itself(
        steps in 1usize..150,
        first in 0usize..150,
        length in 0usize..160,
        kind in 0..4,
    ) {
        let first = first.min(steps);
        let schedule = match kind {
            0 => Schedule::truncated(steps, steps - first, length),
            1 => Schedule::two_level(steps, first, length),
            2 => Schedule::binomial(steps, first, length),
            _ => Schedule::every_state(steps, first, length % 2 == 0),
        };
        prop_assert_eq!(schedule.counts(), play(&schedule));
    }

    #[test]
    fn what_is_chosen_stays_within_the_budget(
        steps in 1usize..600,
        first in 0usize..600,
        costs in (1usize..2000, 0usize..500, 1usize..20, 1usize..9000, 0usize..9000, 0usize..9000),
        budget in 0usize..300_000,
    ) {
        let first = first.min(steps - 1);
        let (state, shared, shared_steps, tape_step, tape_shared, working) = costs;
        let costs = Costs { state, rounded_state: state / 2, shared, shared_steps, tape_step, tape_shared, working };
        match Schedule::within(steps, first, costs, budget) {
            Ok(chosen) => {
                let counts = play(&chosen);
                prop_assert!(chosen.memory(costs) <= budget, "{chosen:?} takes {}", chosen.memory(costs));
                // Nothing that runs fewer steps would have fitted: segments that run no step again, if any does.
                let least = (1..=steps - first).map(|k| Schedule::truncated(steps, steps - first, k).memory(costs)).min();
                if counts.recomputed_steps > 0 {
                    // The last segment may be shorter than predicted by the length: a margin of one of each.
                    let margin = state + 2 * shared + tape_step + 2 * tape_shared;
                    prop_assert!(least.unwrap() + margin >= budget, "{chosen:?}, but segments take {least:?}");
                }
            }
            Err(too_small) => {
                prop_assert!(too_small.least > budget);
                let enough = Schedule::within(steps, first, costs, too_small.least);
                prop_assert!(enough.is_ok_and(|s| s.memory(costs) <= too_small.least));
            }
        }
    }
}
