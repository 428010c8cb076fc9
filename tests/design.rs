//! From wall offsets to a gradient: the deformation and its adjoint, and the gradient of whole runs.

use crate::support::differences::smallest_gap;
use crate::support::final_sum::{FinalSum, Summed};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::Objective;
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::design::deformation::Map;
use hydrograd::design::shape::Shape;
use hydrograd::design::Problem;
use hydrograd::numerics::random::{stream, uniform, Normal};
use hydrograd::particles::tag;
use hydrograd::scene::Scene;
use hydrograd::sph::consistent::Consistent;
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::standard::Standard;
use hydrograd::sph::Sweeps;

fn scene<R: Sweeps>(sets: &[&str]) -> (Config, Shape, Problem<R>) {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let config = Config::load(None, None, &sets).unwrap_or_else(|e| panic!("{e}")).config;
    let shape = Shape::from_config(&config).unwrap();
    let channel = Scene::from_config(&config).unwrap().design.unwrap();
    (config, shape, channel)
}

/// What a test of the standard formulation has.
const STANDARD: &str = "method.name=standard";
const CONSISTENT: &str = "method.name=consistent";

/// Scenes whose columns, nodes and ends of the hot section stand to each other in different ways.
const SCENES: [&[&str]; 5] = [
    &[STANDARD],
    &[STANDARD, "wall.mass=\"constant\""],
    &[STANDARD, "channel.height=0.26", "channel.hot_from=0.257", "channel.hot_to=0.741"],
    &[STANDARD, "design.nodes=[0.3, 0.45, 0.5, 0.7]", "design.offsets=[0, 0, 0, 0]"],
    &[STANDARD, "resolution.dx=0.01", "design.nodes=[0.5]", "design.offsets=[0]"],
];

fn random_offsets(shape: &Shape, seed: u64) -> Vec<f64> {
    let mut rng = stream(seed, "offsets");
    shape.nodes.iter().map(|_| 0.01 * (2.0 * uniform(&mut rng) - 1.0)).collect()
}

#[test]
fn the_deformation_keeps_particles_and_mass_exactly() {
    for (seed, sets) in SCENES.iter().enumerate() {
        let (config, shape, channel) = scene::<f64>(sets);
        let model = channel.model.of_type::<Standard<f64>>().unwrap();
        let deformation = &channel.deformation;
        let (n, l, dx) = (model.particles(), model.layout, config.resolution.dx);
        let Map::Columns(columns) = &deformation.map else { panic!("no columns") };
        let offsets = random_offsets(&shape, seed as u64);
        let heights = channel.parametrisation.column_heights(&offsets);
        let flat = deformation.state::<f64>(&vec![0.0; heights.len()]);
        let state = deformation.state::<f64>(&heights);
        assert_eq!(flat, deformation.base);
        assert_eq!(state.len(), flat.len());
        assert_eq!(state[..n], flat[..n], "{sets:?}: particles move vertically only");
        // The shape's integral, exact between nodes (the shape is linear there) up to the hot section's ends.
        let mut ends = vec![config.channel.hot_from, config.channel.hot_to];
        ends.extend(&shape.nodes);
        ends.sort_by(f64::total_cmp);
        let deformed = Shape { offsets: offsets.clone(), ..shape.clone() };
        let raised: f64 = ends.windows(2).map(|w| deformed.height(0.5 * (w[0] + w[1])) * (w[1] - w[0])).sum();
        assert!(raised != 0.0);
        let area = config.channel.length * config.channel.height - raised;
        let mass: f64 = (0..n)
            .filter(|&i| model.is_fluid(i))
            .map(|i| if l.mass { state[l.state_mass() * n + i] } else { model.mass })
            .sum();
        let expected = if l.mass { area } else { config.channel.length * config.channel.height };
        assert!((mass / (config.fluid.density * expected) - 1.0).abs() < 1e-13, "{sets:?}: {mass} is not {expected}");
        for i in 0..n {
            let (before, after) = (flat[n + i], state[n + i]);
            let s = heights[columns.column[i] as usize];
            let expected = if model.is_fluid(i) {
                // Linear: the surface goes to s, the upper wall stays.
                s + before * (config.channel.height - s) / config.channel.height
            } else if before < 0.0 {
                before + s
            } else {
                before
            };
            assert!((after - expected).abs() < 1e-14, "{sets:?}: particle {i} at {after}, not {expected}");
            if l.mass && !model.is_fluid(i) {
                assert_eq!(state[l.state_mass() * n + i], model.mass, "{sets:?}: walls keep their mass");
            }
        }
        assert!(heights.iter().any(|s| s.abs() > 1e-4));
        assert!((heights.iter().sum::<f64>() * dx / raised - 1.0).abs() < 1e-9, "{sets:?}: columns average the shape");
    }
}

#[test]
fn the_adjoint_of_the_deformation_is_its_derivative() {
    for (seed, sets) in SCENES.iter().enumerate() {
        let (_, shape, channel) = scene::<f64>(sets);
        let problem = &channel;
        let offsets = random_offsets(&shape, seed as u64);
        let mut normal = Normal::new(stream(seed as u64, "bars"));
        let bar: Vec<f64> = problem.deformation.base.iter().map(|_| normal.next()).collect();
        let adjoint = problem.by_variables(&offsets, &bar);
        assert_eq!(adjoint.len(), shape.nodes.len());
        let at = |offsets: &[f64]| -> f64 { problem.start(offsets).state.iter().zip(&bar).map(|(x, b)| x * b).sum() };
        for k in 0..offsets.len() {
            // Linear: any step will do, a large one has the least rounding.
            let moved = |by: f64| {
                let mut offsets = offsets.clone();
                offsets[k] += by;
                at(&offsets)
            };
            let expected = (moved(1.0) - moved(-1.0)) / 2.0;
            assert!((adjoint[k] - expected).abs() < 1e-10, "{sets:?}: variable {k}: {} is not {expected}", adjoint[k]);
            assert!(adjoint[k] != 0.0);
        }
    }
}

/// Scenes with a top wall that is shaped too.
const BOTH: [&[&str]; 3] = [
    &[CONSISTENT, "design.walls=both", "time.jitter=0"],
    &[CONSISTENT, "design.walls=both", "method.name=fixed", "channel.hot_from=0.257", "channel.hot_to=0.741"],
    &[CONSISTENT, "design.walls=both", "method.name=fixed", "design.parametrisation=b-spline"],
];

#[test]
fn the_adjoint_of_two_walls_is_their_derivative() {
    for (seed, sets) in BOTH.iter().enumerate() {
        let (_, _, problem) = scene::<f64>(sets);
        let mut rng = stream(seed as u64, "offsets");
        let variables: Vec<f64> = problem.first.iter().map(|_| 0.01 * (2.0 * uniform(&mut rng) - 1.0)).collect();
        let mut normal = Normal::new(stream(seed as u64, "bars"));
        let bar: Vec<f64> = problem.deformation.base.iter().map(|_| normal.next()).collect();
        let adjoint = problem.by_variables(&variables, &bar);
        assert_eq!(adjoint.len(), problem.parametrisation.variables());
        let at = |x: &[f64]| -> f64 { problem.start(x).state.iter().zip(&bar).map(|(x, b)| x * b).sum() };
        for k in 0..variables.len() {
            let moved = |by: f64| {
                let mut x = variables.clone();
                x[k] += by;
                at(&x)
            };
            let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            let error = (adjoint[k] - expected).abs() / expected.abs().max(1.0);
            assert!(error < 1e-6, "{sets:?}: variable {k}: {} is not {expected}", adjoint[k]);
        }
    }
}

/// A top wall of some heights is the bottom wall of the same heights, upside down.
#[test]
fn the_top_wall_is_the_bottom_wall_s_image() {
    for sets in BOTH {
        let (config, _, problem) = scene::<f64>(sets);
        let (n, half, height) = (problem.model.particles(), problem.first.len() / 2, config.channel.height);
        let mut rng = stream(5, "offsets");
        let wall: Vec<f64> = (0..half).map(|_| 0.01 * (2.0 * uniform(&mut rng) - 1.0)).collect();
        let flat = vec![0.0; half];
        // (x, y) of every fluid particle and of every point where the velocity is zero.
        let places = |variables: &[f64], mirrored: bool| {
            let state = problem.start(variables).state;
            let y = |i: usize| if mirrored { height - state[n + i] } else { state[n + i] };
            let has_twin = |i: usize| match problem.model.of_type::<Consistent<f64>>() {
                Some(consistent) => problem.model.is_fluid(i) || consistent.fits.weights[4 * i] > 0.0,
                None => true,
            };
            let mut all: Vec<[i64; 2]> = (0..n)
                .filter(|&i| has_twin(i))
                .map(|i| [(state[i] * 1e9).round() as i64, (y(i) * 1e9).round() as i64])
                .collect();
            all.sort_unstable();
            all
        };
        let below = places(&[wall.as_slice(), &flat].concat(), false);
        let above = places(&[flat.as_slice(), &wall].concat(), true);
        let above: std::collections::BTreeSet<_> = above.into_iter().collect();
        let lost = below.iter().filter(|place| {
            let [x, y] = **place;
            !(-1..=1).any(|dx| (-1..=1).any(|dy| above.contains(&[x + dx, y + dy])))
        });
        assert_eq!(lost.count(), 0, "{sets:?}");
        assert!(below.len() > 400);
    }
}

#[test]
fn a_truncated_gradient_drops_what_the_fluid_was() {
    let (_, _, channel) = scene::<f64>(&[STANDARD]);
    let (n, model) = (channel.model.particles(), &channel.model);
    let mut bar = vec![1.0; channel.deformation.base.len()];
    channel.deformation.keep_static(&mut bar, |i| model.is_fluid(i));
    for (place, value) in bar.iter().enumerate() {
        let dropped = place / n == 1 && model.tags[place % n] == tag::FLUID;
        assert_eq!(*value, if dropped { 0.0 } else { 1.0 }, "row {}, particle {}", place / n, place % n);
    }
}

/// Gradient of an objective by the offsets, without regularisation.
fn design_gradient<R: Sweeps, O: Objective + ?Sized>(
    channel: &Problem<R>,
    offsets: &[f64],
    objective: &O,
) -> (f64, Vec<f64>) {
    let dynamics = Sph::new(channel.model.clone(), Kernels::Fused);
    let schedule = Schedule::segments(channel.steps, 20);
    let found = gradient(&dynamics, &channel.start(offsets), &schedule, objective, &mut |_| ()).unwrap();
    let bar = found.state.flatten_all().unwrap().to_vec1::<R>().unwrap();
    (found.value, channel.by_variables(offsets, &bar))
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The whole chain over 500 steps: offsets, deformation, solver, neighbour lists, interpolation, average over a window.
#[test]
fn design_gradient_over_500_steps_is_the_derivative() {
    for formulation in [STANDARD, CONSISTENT] {
        design_gradient_is_the_derivative(formulation);
    }
}

fn design_gradient_is_the_derivative(formulation: &str) {
    let (_, shape, channel) = scene::<f64>(&[formulation, "time.steps=500", "time.cfl=1.0"]);
    let offsets = shape.offsets.clone();
    let (value, gradient) = design_gradient(&channel, &offsets, &*channel.objective);
    let q = channel.evaluate(&offsets).unwrap();
    assert_eq!(value, q, "the gradient's run is the plain run");
    let mut normal = Normal::new(stream(11, "along"));
    for _ in 0..3 {
        let direction: Vec<f64> = offsets.iter().map(|_| normal.next()).collect();
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, v)| g * v).sum();
        let at = |t: f64| {
            let moved: Vec<f64> = offsets.iter().zip(&direction).map(|(o, v)| o + t * v).collect();
            channel.evaluate(&moved).unwrap()
        };
        // Q is smooth between jumps: a particle that crosses the inlet or the outlet strip one step earlier changes Q by
        // 1e-9 to 1e-7. Steps of 1e-6 meet such jumps, smaller ones rarely do; below 1e-9 rounding takes over.
        let best = smallest_gap(&[3e-8, 1e-8, 1e-7], 1e-5, |h| ((at(h) - at(-h)) / (2.0 * h) / slope - 1.0).abs());
        println!("{formulation}: relative error {best:.1e} (slope {slope:.4e}, |gradient| {:.4e})", norm(&gradient));
        assert!(best <= 1e-5, "{formulation}: the nearest difference quotient is off by {best:e}");
    }
}

/// Relative to the f64 gradient's norm.
fn single_precision_error<O>(
    formulation: &str,
    steps: usize,
    cfl: &str,
    objective: impl Fn(usize) -> Option<O>,
) -> (f64, f64)
where
    O: Objective,
{
    let (steps_set, cfl_set) = (format!("time.steps={steps}"), format!("time.cfl={cfl}"));
    let sets = [formulation, steps_set.as_str(), cfl_set.as_str(), "objective.window=0"];
    let (_, shape, double) = scene::<f64>(&sets);
    let single = scene::<f32>(&sets).2;
    let chosen = objective(steps);
    let ((_, exact), (_, found)) = match &chosen {
        Some(o) => (design_gradient(&double, &shape.offsets, o), design_gradient(&single, &shape.offsets, o)),
        None => (
            design_gradient(&double, &shape.offsets, &*double.objective),
            design_gradient(&single, &shape.offsets, &*single.objective),
        ),
    };
    let gap: Vec<f64> = exact.iter().zip(&found).map(|(a, b)| a - b).collect();
    (norm(&gap) / norm(&exact), norm(&exact))
}

/// JAX-SPH's f32 gradient of 2000 steps is 1e23 times too large: self pairs in sums of kernel slopes.
#[test]
fn single_precision_gradient_agrees_with_double() {
    let warmth = |steps| Some(FinalSum { steps, of: Summed::Heat });
    let mut cases = Vec::new();
    for steps in [20, 100, 500, 2000] {
        cases.push(("Q", steps, single_precision_error(STANDARD, steps, "0.25", |_| None::<FinalSum>)));
    }
    // Q has barely seen the wall after 20 steps; the fluid's heat has.
    for steps in [20, 100, 500] {
        cases.push(("heat", steps, single_precision_error(STANDARD, steps, "0.25", warmth)));
    }
    // The largest time step of a usual run.
    cases.push(("Q at cfl 2", 100, single_precision_error(STANDARD, 100, "2.0", |_| None::<FinalSum>)));
    // The consistent formulation at its own time step.
    for steps in [100, 500] {
        cases.push(("Q, consistent", steps, single_precision_error(CONSISTENT, steps, "1.5", |_| None::<FinalSum>)));
    }
    cases.push(("heat, consistent", 20, single_precision_error(CONSISTENT, 20, "1.5", warmth)));
    for (name, steps, (error, norm)) in cases {
        println!("{name}, {steps} steps: f32 differs by {error:.1e} (|gradient| {norm:.3e})");
        assert!(error <= 1e-3, "{name}, {steps} steps: f32 differs by {error:e} of {norm:e}");
        assert!(norm > 0.0);
    }
}

#[test]
fn a_variable_without_influence_is_an_error() {
    // After two steps, only the wall near the targets has been felt there. (In the consistent formulation the mean of the
    // pressure, which is subtracted, lets everything be felt everywhere, if only to rounding.)
    let sets = [STANDARD, "time.steps=2", "objective.window=0", "channel.hot_to=0.88"];
    let channel = scene::<f64>(&sets).2;
    let evaluate =
        |channel: &Problem<f64>| channel.differentiate(&channel.first, &Schedule::taped(channel.steps), &mut |_| ());
    let error = evaluate(&channel).unwrap_err().to_string();
    assert!(error.contains("design variable 0 received no gradient"), "{error}");
    // All of them are felt if they are near.
    let near = [
        STANDARD,
        "time.steps=2",
        "objective.window=0",
        "channel.hot_to=0.88",
        "design.nodes=[0.85, 0.87]",
        "design.offsets=[0,0]",
    ];
    let channel = scene::<f64>(&near).2;
    let found = evaluate(&channel).unwrap();
    assert!(found.by_variables.iter().all(|g| *g != 0.0 && g.is_finite()), "{:?}", found.by_variables);
}
