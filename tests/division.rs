//! The adaptive time step: steps that are made in parts.

use crate::support::final_sum::{FinalSum, Summed};
use hydrograd::adjoint::gradient::{gradient, Gradient};
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::scene::Scene;
use hydrograd::sph::division::{Division, MOST};
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::flow::Flow;
use hydrograd::sph::solver::{Snapshot, Solver};
use hydrograd::sph::standard::Standard;
use hydrograd::sph::Model;
use hydrograd::sph::Sweeps;
use std::sync::Arc;

/// A scene with its model changed.
fn scene<R: Sweeps>(name: &str, sets: &[&str], change: impl Fn(&mut Flow<R>)) -> Scene<R> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    let mut scene = Scene::from_config(&Config::load(Some(name), None, &sets).unwrap().config).unwrap();
    scene.model = scene.model.with(change);
    scene
}

fn after<R: Sweeps>(scene: &Scene<R>, kernels: Kernels, steps: usize) -> Solver<R> {
    let mut solver = Solver::restore(scene.model.clone(), &scene.start).unwrap();
    for _ in 0..steps {
        match kernels {
            Kernels::Fused => solver.advance().unwrap(),
            Kernels::Composed => solver.advance_composed().unwrap(),
        }
    }
    solver
}

/// So many parts for any speed that a weakly compressible flow has: 1.25 C dx / (c + u) is a little more than dt / parts.
fn always<R>(model: &Flow<R>, spacing: f64, sound_speed: f64, parts: usize) -> Division {
    let courant_number = model.dt / (parts as f64 - 0.4) * sound_speed / spacing / 1.25;
    Division { spacing, sound_speed, courant_number }
}

/// A step in two parts is two steps of half the length, to the bit; the one without a step before it included.
#[test]
fn parts_are_shorter_steps() {
    let standard = "method.name=standard";
    let cases: [(&str, &[&str]); 5] = [
        ("taylor-green", &["resolution.dx=0.05"]),
        ("taylor-green", &["resolution.dx=0.05", "method.integrator=\"symplectic-euler\"", "time.cfl=0.5"]),
        ("taylor-green", &["resolution.dx=0.05", standard, "method.transport_velocity=0.5"]),
        ("lid-driven-cavity", &["resolution.dx=0.1"]),
        ("dam-break", &["resolution.dx=0.1", "tank.length=3.0", "time.adaptive=false"]),
    ];
    for (name, sets) in cases {
        for (kernels, steps) in [(Kernels::Fused, 12), (Kernels::Composed, 3)] {
            let mut shorter = scene::<f64>(name, sets, |flow| flow.dt *= 0.5);
            if let Some(standard) = shorter.model.of_type::<Standard<f64>>() {
                let mut standard = standard.clone();
                standard.laws.transport *= 2.0;
                shorter.model = Model::new(standard);
            }
            let plain = scene::<f64>(name, sets, |_| ());
            let (spacing, sound_speed) = (plain.spacing, plain.sound_speed());
            let divided = scene::<f64>(name, sets, |model| {
                model.division = Some(always(model, spacing, sound_speed, 2));
            });
            let (divided, expected) = (after(&divided, kernels, steps), after(&shorter, kernels, 2 * steps));
            assert_eq!((divided.divided.steps, divided.divided.most, divided.step), (steps, 2, steps));
            let differing =
                divided.state.iter().zip(&expected.state).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
            assert_eq!(differing, 0, "{name} {sets:?} {kernels:?}: {differing} of {} numbers", expected.state.len());
            let whole = after(&plain, kernels, steps);
            assert!(whole.divided.steps == 0 && whole.state != divided.state, "{name}: the parts changed nothing");
        }
    }
}

/// A collapsing column of water whose steps are made in fewer and fewer parts, in every formulation with a free surface or not.
fn slowing<R: Sweeps>(name: &str, sets: &[&str]) -> Scene<R> {
    let dt = scene::<R>(name, sets, |_| ()).model.dt;
    let mut scene = scene::<R>(name, sets, |model| {
        // By speed alone, without sound: three parts at a speed of 1.
        let courant_number = dt / 0.05 / 2.9 / 1.25;
        model.division = Some(Division { spacing: 0.05, sound_speed: 0.0, courant_number });
        model.skin *= 0.2;
    });
    let (n, l) = (scene.model.particles(), scene.model.rows);
    let state = &mut scene.start.state;
    let fastest = (0..n).map(|i| state[l.velocity() * n + i].f64().abs()).fold(0.0, f64::max);
    for i in (0..n).filter(|&i| scene.model.is_fluid(i)) {
        let [x, y] = [state[i].f64(), state[n + i].f64()];
        if fastest == 0.0 {
            state[l.velocity() * n + i] = R::of((7.0 * y).sin());
            state[(l.velocity() + 1) * n + i] = R::of(0.5 * (9.0 * x).cos());
        }
    }
    scene
}

fn run<R: Sweeps>(scene: &Scene<R>, start: &Snapshot<R>, schedule: &Schedule) -> Gradient {
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    let objective = FinalSum { steps: schedule.counts().differentiated_steps, of: Summed::KineticEnergy };
    gradient(&dynamics, start, schedule, &objective, &mut |_| ()).unwrap()
}

fn numbers<R: Sweeps>(gradient: &Gradient) -> Vec<f64> {
    gradient.state.flatten_all().unwrap().to_vec1::<R>().unwrap().iter().map(|x| x.f64()).collect()
}

const STEPS: usize = 24;
const CASES: [(&str, &[&str]); 2] = [
    ("dam-break", &["resolution.dx=0.1", "tank.length=3.0", "fluid.viscosity=0.1"]),
    ("taylor-green", &["resolution.dx=0.05", "flow.reynolds=10", "time.cfl=0.5"]),
];

fn replays_exactly<R: Sweeps>() {
    for (name, sets) in CASES {
        let scene = slowing::<R>(name, sets);
        // The run has whole steps and divided ones, and lists of their own within steps.
        let mut solver = Solver::restore(scene.model.clone(), &scene.start).unwrap();
        let (mut seen, mut within) = (std::collections::BTreeSet::new(), 0);
        for _ in 0..STEPS {
            let asked = scene.model.parts(&solver.state);
            solver.advance().unwrap();
            assert_eq!(solver.pace.parts, asked);
            seen.insert(asked);
            within += !Arc::ptr_eq(solver.began_with(), &solver.neighbourhood.reference) as usize;
        }
        assert!(seen.len() > 1 && within > 0, "{name}: parts {seen:?}, {within} lists within steps");
        let taped = run(&scene, &scene.start, &Schedule::taped(STEPS));
        let expected = numbers::<R>(&taped);
        for schedule in [
            Schedule::segments(STEPS, 1),
            Schedule::segments(STEPS, 5),
            Schedule::two_level(STEPS, 0, 7),
            Schedule::binomial(STEPS, 0, 3),
        ] {
            let found = run(&scene, &scene.start, &schedule);
            assert!(found.value == taped.value, "{name}, {schedule:?}");
            let found = numbers::<R>(&found);
            let differing = found.iter().zip(&expected).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
            assert_eq!(differing, 0, "{name}, {schedule:?}: {differing} of {} components", expected.len());
        }
        // A run that is taken up in the middle goes on to the bit.
        let mut first = Solver::restore(scene.model.clone(), &scene.start).unwrap();
        (0..STEPS / 2).for_each(|_| first.advance().unwrap());
        let mut second = Solver::restore(scene.model.clone(), &first.snapshot()).unwrap();
        (STEPS / 2..STEPS).for_each(|_| second.advance().unwrap());
        assert!(second.state == solver.state, "{name}");
    }
}

#[test]
fn a_replay_divides_as_the_run_did() {
    replays_exactly::<f64>();
    replays_exactly::<f32>();
}

/// Against central differences along one direction, where no step is at a jump of its parts.
#[test]
fn the_gradient_is_that_of_the_parts() {
    for (name, sets) in CASES {
        let scene = slowing::<f64>(name, sets);
        let (model, start) = (&scene.model, &scene.start);
        let found = numbers::<f64>(&run(&scene, start, &Schedule::segments(STEPS, 5)));
        let (n, l) = (model.particles(), model.rows);
        let mut direction = vec![0.0; start.state.len()];
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            direction[l.velocity() * n + i] = (0.3 * i as f64).sin();
            direction[i] = 0.01 * (0.7 * i as f64).cos();
        }
        let slope: f64 = found.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let value = |h: f64| -> (f64, Vec<usize>) {
            let state = start.state.iter().zip(&direction).map(|(x, d)| x + h * d).collect();
            let mut solver = Solver::restore(model.clone(), &Snapshot { state, ..start.clone() }).unwrap();
            let mut all = Vec::new();
            for _ in 0..STEPS {
                solver.advance().unwrap();
                all.push(solver.pace.parts);
            }
            let square = |i: usize| (0..2).map(|d| solver.state[(l.velocity() + d) * n + i].powi(2)).sum::<f64>();
            ((0..n).filter(|&i| model.is_fluid(i)).map(|i| 0.5 * square(i)).sum(), all)
        };
        let mut best = f64::INFINITY;
        for h in [1e-4, 1e-5, 1e-6] {
            let ((up, up_parts), (down, down_parts)) = (value(h), value(-h));
            assert_eq!(up_parts, down_parts, "{name}: a jump of the parts within {h}");
            best = best.min(((up - down) / (2.0 * h) / slope - 1.0).abs());
        }
        assert!(best < 1e-6, "{name}: off by {best:e} of {slope}");
    }
}

/// Faster than was said: whole steps are too long for it, divided ones hold.
#[test]
fn a_flow_faster_than_expected_is_carried() {
    let sets = ["resolution.dx=0.1", "tank.length=3.0", "fluid.reference_velocity=0.3", "time.cfl=1.5", "time.end=3"];
    let run = |adaptive: &str| {
        let scene = scene::<f64>("dam-break", &[&sets[..], &[adaptive]].concat(), |_| ());
        let mut solver = Solver::restore(scene.model.clone(), &scene.start).unwrap();
        for _ in 0..scene.steps {
            solver.advance().map_err(|error| error.to_string())?;
            solver.check().map_err(|error| error.to_string())?;
        }
        Ok::<_, String>(solver.divided)
    };
    let whole = run("time.adaptive=false").unwrap_err();
    assert!(whole.contains("diverged") || whole.contains("step"), "{whole}");
    let divided = run("time.adaptive=true").unwrap();
    assert!(divided.steps > 10 && divided.most > 1, "{divided:?}");
}

#[test]
fn steps_are_divided_where_the_flow_asks_for_it() {
    let division = Division { spacing: 0.01, sound_speed: 10.0, courant_number: 1.0 };
    let dt = 0.01 / 11.0;
    // Not divided at rest, at the reference velocity and well above it.
    for speed in [0.0, 1.0, 2.5] {
        assert_eq!(division.parts(dt, speed, 0.0), 1, "{speed}");
    }
    // At a speed of 2.75 a particle moves by a quarter of a spacing in a step.
    assert_eq!((division.parts(dt, 2.76, 0.0), division.parts(dt, 5.6, 0.0)), (2, 3));
    // At a = dx / (4 dt)^2, 1/4 sqrt(dx / a) = dt.
    let a = 0.01 / (4.0 * dt).powi(2);
    assert_eq!((division.parts(dt, 0.0, a), division.parts(dt, 0.0, 1.01 * a)), (1, 2));
    assert_eq!(division.parts(dt, 0.0, 9.01 * a), 4);
    // With a slow speed of sound c + u decides.
    let slow = Division { sound_speed: 1.0, courant_number: 0.1, ..division };
    assert_eq!((slow.parts(5e-4, 1.4, 0.0), slow.parts(5e-4, 1.6, 0.0)), (1, 2));
    for nonsense in [f64::NAN, f64::INFINITY] {
        assert!((1..=MOST).contains(&division.parts(dt, nonsense, nonsense)));
    }
}
