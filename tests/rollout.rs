//! Rollouts, their ends, and the evaluation over windows, on data sets made here.

use crate::support::data_set::{heat, heated_metadata, metadata, trajectory, write};
use hydrograd::dataset::{kind, read_split, Metadata, Split};
use hydrograd::error::BadInput;
use hydrograd::surrogate::evaluation::metrics::Counted;
use hydrograd::surrogate::evaluation::rollout::{rollout, windows, HISTORY};
use hydrograd::surrogate::evaluation::scores::{chosen_windows, evaluate_windows, Options};
use hydrograd::surrogate::models::baselines::{ConstantVelocity, Still};
use hydrograd::surrogate::predictor::{Frame, Predictor, Scenery};
use serde_json::Value;

/// Does to the last frame what a function says, at the n-th call.
struct Odd<F>(F, std::cell::Cell<usize>);

impl<F: Fn(usize, &mut Frame) -> anyhow::Result<()>> Predictor for Odd<F> {
    fn name(&self) -> String {
        "odd".into()
    }

    fn next(&self, _: &Scenery, window: &[Frame]) -> anyhow::Result<Frame> {
        assert_eq!(window.len(), HISTORY);
        self.1.set(self.1.get() + 1);
        let mut frame = window[HISTORY - 1].clone();
        (self.0)(self.1.get(), &mut frame)?;
        Ok(frame)
    }
}

fn odd<F: Fn(usize, &mut Frame) -> anyhow::Result<()>>(what: F) -> Odd<F> {
    Odd(what, std::cell::Cell::new(0))
}

#[test]
fn windows_do_not_overlap() {
    let text = std::fs::read_to_string("data/reference/gns/windows.json").unwrap();
    let reference: Value = serde_json::from_str(&text).unwrap();
    for (name, trajectories) in [("LJ_valid", 1), ("TGV_valid", 4)] {
        let entry = |key: &str| reference[name][key].as_u64().unwrap() as usize;
        assert_eq!(entry("subseq_length"), HISTORY + 20);
        let starts: Vec<usize> = windows(entry("sequence_length"), 20).collect();
        assert_eq!(starts.len(), entry("split_valid_traj_into_n"), "{name}");
        assert_eq!(starts.len() * trajectories, entry("num_samples"), "{name}");
        assert!(starts.iter().enumerate().all(|(k, &start)| start == 26 * k));
    }
    assert_eq!(windows(25, 20).count(), 0);
    assert_eq!(windows(26, 20).count(), 1);

    let set = [trajectory("00000", 53, |_, _| [0.0; 2]), trajectory("00001", 80, |_, _| [0.0; 2])];
    let all = chosen_windows(&set, &Options::default()).unwrap();
    assert_eq!(all, [(0, 0), (0, 26), (1, 0), (1, 26), (1, 52)]);
    let some = |count| chosen_windows(&set, &Options { windows: Some(count), ..Options::default() }).unwrap();
    assert_eq!(some(2), [(0, 0), (1, 0)]);
    assert_eq!(some(9), all);
}

#[test]
fn constant_velocity_is_exact_for_uniform_motion() {
    // Through both ends of the box.
    let set = [trajectory("00000", 60, |_, y| [0.04 * y, -0.013])];
    let scores = evaluate_windows(&ConstantVelocity, &metadata(false), &set, &Options::default(), &mut || ()).unwrap();
    assert_eq!((scores.windows, scores.steps, scores.model.as_str()), (2, 20, "linear"));
    assert!(scores.broken.is_empty());
    // f32 positions: rounded velocities grow linearly.
    assert!(scores.mse < 1e-10, "{}", scores.mse);
    assert!(scores.sinkhorn.unwrap().abs() < 1e-9 && scores.e_kin.unwrap() < 1e-8);
    assert_eq!((scores.temperature_mse, scores.outflow_error), (None, None));

    let still = evaluate_windows(&Still, &metadata(false), &set, &Options::default(), &mut || ()).unwrap();
    // Without motion the error after k steps is (k v)^2, the mean over the fluid's nine rows and two directions.
    let rows = (1..10).map(|row| 0.1 * row as f64 + 0.05);
    let square = rows.map(|y| (0.04 * y).powi(2) + 0.013_f64.powi(2)).sum::<f64>() / 9.0 / 2.0;
    for (k, mse) in still.curves.mse.iter().take(10).enumerate() {
        let expected = square * ((k + 1) as f64).powi(2);
        assert!((mse / expected - 1.0).abs() < 1e-3, "{mse} {expected}");
    }
    assert_eq!(still.mse_1, Some(still.curves.mse[0]));
    assert_eq!(still.mse_20, Some(still.mse));
    assert_eq!(still.curves.e_kin_predicted, vec![0.0; 20]);
    // Walls at rest, counted as LagrangeBench does, make every model look better.
    let all = Options { counted: Counted::All, ..Options::default() };
    let with_walls = evaluate_windows(&Still, &metadata(false), &set, &all, &mut || ()).unwrap();
    assert!((with_walls.mse / still.mse - 0.9).abs() < 1e-9);
}

#[test]
fn fewer_steps_have_fewer_metrics() {
    let set = [trajectory("00000", 20, |_, _| [0.01, 0.0])];
    let options = Options { steps: 7, sinkhorn: false, ..Options::default() };
    let scores = evaluate_windows(&Still, &metadata(false), &set, &options, &mut || ()).unwrap();
    assert!(scores.mse_5.is_some() && scores.mse_10.is_none() && scores.sinkhorn.is_none());
    assert_eq!(scores.curves.mse.len(), 7);
    let one = Options { steps: 1, ..options };
    assert_eq!(evaluate_windows(&Still, &metadata(false), &set, &one, &mut || ()).unwrap().e_kin, None);
}

#[test]
fn what_is_known_is_not_predicted() {
    let metadata = heated_metadata();
    let mut t = trajectory("00000", 30, |_, _| [0.03, 0.0]);
    heat(&mut t, |_, x| 1.0 + 0.2 * x);
    // Moves everything by 0.2 to the right and makes it hot.
    let wild = odd(|_, frame| {
        frame.position.iter_mut().step_by(2).for_each(|x| *x += 0.2);
        frame.temperature.as_mut().unwrap().fill(5.0);
        Ok(())
    });
    let run = rollout(&wild, &metadata, &t, 2, 3).unwrap();
    assert_eq!((run.frames.len(), run.broken.is_none()), (3, true));
    for (step, frame) in run.frames.iter().enumerate() {
        let truth = Frame::of(&t, 2 + HISTORY + step);
        let (hot, true_hot) = (frame.temperature.as_ref().unwrap(), truth.temperature.as_ref().unwrap());
        let mut set = 0;
        for i in 0..t.particles {
            let x = frame.position[2 * i];
            assert!((0.0..1.0).contains(&x), "wrapped");
            if kind::is_kinematic(t.kind[i]) {
                assert_eq!(frame.position[2 * i..2 * i + 2], truth.position[2 * i..2 * i + 2]);
                assert_eq!(hot[i], true_hot[i]);
            } else if x < 0.2 {
                // In the inlet (x < 0.1), or around through it within this frame.
                assert_eq!(hot[i], 1.0);
                set += 1;
            } else {
                assert_eq!(hot[i], 5.0);
            }
        }
        assert!(set > 0);
    }
}

#[test]
fn the_linear_baseline_keeps_what_the_inlet_set() {
    let metadata = heated_metadata();
    let mut t = trajectory("00000", 26, |_, _| [0.03, 0.0]);
    heat(&mut t, |frame, _| 1.0 + 0.01 * frame as f64);
    let scenery = Scenery::of(&metadata, &t);
    let frames = [Frame::of(&t, 4), Frame::of(&t, 5)];
    let next = ConstantVelocity.next(&scenery, &frames).unwrap();
    let mut seen = [0, 0];
    for i in 0..t.particles {
        let at_inlet = frames[1].position[2 * i] < 0.1;
        let came_from_inlet = frames[0].position[2 * i] < 0.1;
        let expected = match (at_inlet, came_from_inlet) {
            (true, _) => 1.0,
            (false, true) => 1.05 + 0.05,
            (false, false) => 1.06,
        };
        assert!((next.temperature.as_ref().unwrap()[i] - expected).abs() < 1e-6);
        seen[usize::from(at_inlet)] += 1;
    }
    assert!(seen[0] > 0 && seen[1] > 0);
}

#[test]
fn temperature_and_outflow_are_scored() {
    let metadata = heated_metadata();
    let mut t = trajectory("00000", 26, |_, _| [0.03, 0.0]);
    heat(&mut t, |_, x| 1.0 + 0.2 * x);
    let still = evaluate_windows(&Still, &metadata, std::slice::from_ref(&t), &Options::default(), &mut || ()).unwrap();
    // Nothing moves: no heat flows out, all of it is missing.
    assert_eq!(still.outflow_error, Some(1.0));
    assert!(still.temperature_mse.unwrap() > 1e-4);
    assert_eq!(still.curves.outflow_predicted, Some(vec![0.0; 20]));
    assert!(still.curves.outflow_true.unwrap().iter().all(|&q| q > 0.0));
    // A model that knows the truth.
    let truth = t.clone();
    let oracle = odd(move |call, frame| {
        *frame = Frame::of(&truth, HISTORY + call - 1);
        Ok(())
    });
    let scores = evaluate_windows(&oracle, &metadata, &[t], &Options::default(), &mut || ()).unwrap();
    assert_eq!((scores.outflow_error, scores.temperature_mse, scores.mse), (Some(0.0), Some(0.0), 0.0));
}

#[test]
fn a_rollout_that_breaks_ends_and_says_so() {
    let t = trajectory("00000", 60, |_, _| [0.01, 0.0]);
    let reason = |metadata: &Metadata, what: fn(&mut Frame) -> anyhow::Result<()>| {
        let model = odd(move |call, frame| if call == 4 { what(frame) } else { Ok(()) });
        let run = rollout(&model, metadata, &t, 0, 20).unwrap();
        assert_eq!(run.frames.len(), 3);
        let broken = run.broken.unwrap();
        assert_eq!(broken.step, 4);
        broken.reason
    };
    let (periodic, closed) = (metadata(false), metadata(true));
    let nan = |frame: &mut Frame| {
        frame.position[2 * 37] = f64::NAN;
        Ok(())
    };
    assert_eq!(reason(&periodic, nan), "particle 37 has a position that is not finite");
    let far = |frame: &mut Frame| {
        frame.position[2 * 37 + 1] = 1.7;
        Ok(())
    };
    assert_eq!(reason(&closed, far), "particle 37 left the box: y = 1.7000");
    let failing = |_: &mut Frame| Err(anyhow::anyhow!("too many neighbours").context("neighbour search"));
    assert_eq!(reason(&periodic, failing), "neighbour search: too many neighbours");
    let short = |frame: &mut Frame| {
        frame.position.truncate(10);
        Ok(())
    };
    assert_eq!(reason(&periodic, short), "10 coordinates instead of 200");

    // In an evaluation: 2 windows, the second breaks at its fifth step and stands still from there on.
    let model = odd(|call, frame| {
        frame.position.iter_mut().step_by(2).for_each(|x| *x += 0.01);
        if call == 25 {
            frame.position[50] = f64::INFINITY;
        }
        Ok(())
    });
    let scores =
        evaluate_windows(&model, &periodic, std::slice::from_ref(&t), &Options::default(), &mut || ()).unwrap();
    assert_eq!(scores.broken.len(), 1);
    let broken = &scores.broken[0];
    assert_eq!((broken.trajectory.as_str(), broken.start, broken.step), ("00000", 26, 5));
    assert!(scores.curves.mse[3] < 1e-10);
    for k in 4..20 {
        let behind = 0.01 * (k - 3) as f64;
        let expected = behind * behind / 2.0 / 2.0;
        assert!((scores.curves.mse[k] / expected - 1.0).abs() < 1e-3, "{k} {}", scores.curves.mse[k]);
    }
    // Comes back from JSON (whose reader may be off by a rounding).
    let text = serde_json::to_string(&scores).unwrap();
    let back: hydrograd::surrogate::evaluation::scores::Scores = serde_json::from_str(&text).unwrap();
    assert_eq!((back.broken, back.windows, back.temperature_mse), (scores.broken, 2, None));
    assert!((back.mse / scores.mse - 1.0).abs() < 1e-12);

    // A model that never works is an error.
    let never = odd(|_, _| anyhow::bail!("no such tensor"));
    let error = evaluate_windows(&never, &periodic, &[t], &Options::default(), &mut || ()).unwrap_err().to_string();
    assert!(error.contains("odd") && error.contains("no such tensor"), "{error}");
}

#[test]
fn a_divergence_without_an_end_is_left_out_and_counted() {
    // All in one place but one, which is predicted far away.
    let mut t = trajectory("00000", 52, |_, _| [0.0; 2]);
    t.position.fill(0.5);
    let one_leaves = odd(|call, frame| {
        frame.position[199] = if call == 1 { 0.99 } else { 0.5 };
        Ok(())
    });
    let scores = evaluate_windows(&one_leaves, &metadata(true), &[t], &Options::default(), &mut || ()).unwrap();
    assert_eq!((scores.sinkhorn_failures, scores.broken.len()), (1, 0));
    assert_eq!(scores.sinkhorn, Some(0.0), "of the others");
}

#[test]
fn trajectories_that_are_too_short_are_bad_input() {
    let t = trajectory("00003", 20, |_, _| [0.0; 2]);
    let metadata = metadata(false);
    let check = |error: anyhow::Error| {
        assert!(error.is::<BadInput>());
        let text = error.to_string();
        for part in ["00003 has 20 frames", "6 true and 20 predicted", "try: steps=14"] {
            assert!(text.contains(part), "no `{part}` in {text}");
        }
    };
    check(evaluate_windows(&Still, &metadata, std::slice::from_ref(&t), &Options::default(), &mut || ()).unwrap_err());
    check(rollout(&Still, &metadata, &t, 0, 20).unwrap_err());
    assert!(evaluate_windows(&Still, &metadata, &[], &Options::default(), &mut || ()).unwrap_err().is::<BadInput>());
}

#[test]
fn the_data_sets_of_these_tests_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut t = trajectory("00000", 30, |_, _| [0.01, 0.0]);
    heat(&mut t, |_, x| x);
    write(folder.path(), &heated_metadata(), Split::Test, std::slice::from_ref(&t));
    let metadata = Metadata::read(folder.path()).unwrap();
    assert_eq!(metadata, heated_metadata());
    assert_eq!(read_split(folder.path(), &metadata, Split::Test).unwrap(), [t]);
}
