//! The consistent formulation: its operators against an oracle, against differences and against what they must be exact for.

use crate::support::consistent::{
    box_model, buoyant, channel, isotropic, noisy_channel, numbers, verlet, vortices, Case, DX,
};
use crate::support::differences::smallest_gap;
use crate::support::final_sum::{FinalSum, Summed};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::run;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::{Dynamics, Objective};
use hydrograd::config::scene::{Config, Kernels};
use hydrograd::design::diagnostics::simulate;
use hydrograd::numerics::lanes::{Lanes, Real};
use hydrograd::numerics::random::{stream, uniform, Normal};
use hydrograd::particles::{tag, Neighbourhood};
use hydrograd::scene::Scene;
use hydrograd::sph::consistent::arrangement::Shift;
use hydrograd::sph::consistent::blocks::width;
use hydrograd::sph::consistent::blocks::Blocks;
use hydrograd::sph::consistent::geometry::Geometry;
use hydrograd::sph::consistent::kept::Kept;
use hydrograd::sph::consistent::kinds::{NO_FLUX, VELOCITY};
use hydrograd::sph::consistent::layout::Layout;
use hydrograd::sph::consistent::stencil::{
    accumulate, along, dot, factorise, monomials, packed, pull_back, pull_back_along, quadratic, solve, values,
};
use hydrograd::sph::consistent::Consistent;
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::pace::TimeSteps;
use hydrograd::sph::rows::Quantity;
use hydrograd::sph::solver::Solver;
use hydrograd::sph::Sweeps;

/// Every kind of scene: boxes in two and three dimensions with and without heat, and the channel with every shift.
fn cases<R: Sweeps>() -> Vec<Case<R>> {
    vec![
        vortices(2, false, isotropic()),
        vortices(2, true, isotropic()),
        vortices(2, true, Shift::None),
        vortices(3, false, isotropic()),
        vortices(3, true, isotropic()),
        verlet(2, false),
        verlet(3, true),
        buoyant(vortices(2, true, isotropic())),
        buoyant(verlet(3, true)),
        buoyant(noisy_channel(&[])),
        noisy_channel(&["method.integrator=verlet", "time.cfl=1"]),
        noisy_channel(&["method.integrator=verlet", "time.cfl=1", "fluid.drive=flow-rate"]),
        noisy_channel(&[]),
        noisy_channel(&["method.shift=isotropic"]),
        noisy_channel(&["method.shift=rows"]),
        noisy_channel(&["method.shift=none"]),
        noisy_channel(&["resolution.kernel=wendland-c2", "resolution.smoothing_length=1.3"]),
        noisy_channel(&["fluid.drive=flow-rate", "fluid.flow_rate=0.17"]),
        noisy_channel(&["fluid.drive=pumping-power"]),
    ]
}

/// The largest difference of each row over the row's largest number.
fn gap(n: usize, found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let row = |(a, b): (&[f64], &[f64])| {
        let scale = b.iter().fold(1e-300_f64, |most, x| most.max(x.abs()));
        let most =
            a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0_f64, |most, x| if x <= most { most } else { x });
        most / scale
    };
    found.chunks(n).zip(expected.chunks(n)).map(row).fold(0.0_f64, |most, x| if x <= most { most } else { x })
}

fn short(numbers: &[f64]) -> String {
    numbers.iter().map(|x| format!("{x:.1e}")).collect::<Vec<_>>().join(", ")
}

#[test]
fn fused_and_composed_steps_agree() {
    for case in cases::<f64>() {
        let (n, bar) = (case.model.particles(), case.random("bar"));
        let (fused, fused_bar) = case.taped(Kernels::Fused, 1, &bar);
        let (composed, composed_bar) = case.taped(Kernels::Composed, 1, &bar);
        let (states, gradients) = (gap(n, &fused, &composed), gap(n, &fused_bar, &composed_bar));
        println!("{}: states differ by {states:.1e}, gradients by {gradients:.1e}", case.name);
        assert!(states < 1e-11, "{}: {states:e}", case.name);
        assert!(gradients < 1e-8, "{}: {gradients:e}", case.name);
        // On buffers and on the graph: the same sweeps, the same bits.
        assert!(case.run(&case.state, 1) == fused, "{}", case.name);
        assert!(fused.iter().zip(&case.state).any(|(a, b)| a != b));
    }
}

#[test]
fn single_precision_agrees_with_double() {
    for (single, double) in cases::<f32>().into_iter().zip(cases::<f64>()) {
        let (n, bar) = (double.model.particles(), double.random("bar"));
        let (found, found_bar) = single.taped(Kernels::Fused, 1, &bar);
        let (expected, expected_bar) = double.taped(Kernels::Fused, 1, &bar);
        let (states, gradients) = (gap(n, &found, &expected), gap(n, &found_bar, &expected_bar));
        println!("{}: f32 differs by {states:.1e}, its gradient by {gradients:.1e}", double.name);
        assert!(states < 1e-4 && gradients < 1e-4, "{}: {states:e}, {gradients:e}", double.name);
        let (composed, composed_bar) = single.taped(Kernels::Composed, 1, &bar);
        let (states, gradients) = (gap(n, &found, &composed), gap(n, &found_bar, &composed_bar));
        println!("    fused and composed: {states:.1e}, {gradients:.1e}");
        assert!(states < 1e-4 && gradients < 1e-4, "{}: {states:e}, {gradients:e}", double.name);
    }
}

/// What a flow is measured by: temperatures, velocities and masses of the present state, fused and composed.
#[test]
fn fused_and_composed_fields_agree() {
    for case in cases::<f64>() {
        let (n, l) = (case.model.particles(), case.model.layout);
        let of = |kernels| {
            let dynamics = Sph::new(case.model.clone(), kernels);
            let start = case.snapshot(&case.state);
            let mut run = dynamics.start(&start).unwrap();
            let kept = dynamics.keep(&run, false).unwrap();
            let (mut tape, state) = dynamics.tape(&kept, None, &run).unwrap();
            let var = candle_core::Var::from_tensor(&state).unwrap();
            let fields = dynamics.fields(&mut tape, var.as_tensor()).unwrap();
            let looked = dynamics.look(&mut run).unwrap();
            let mut rows = vec![fields.position, fields.velocity, fields.mass];
            rows.extend(fields.temperature);
            let mut plain = vec![looked.position, looked.velocity, looked.mass];
            plain.extend(looked.temperature);
            let all = candle_core::Tensor::cat(&rows, 0).unwrap();
            let plain = numbers::<f64>(&candle_core::Tensor::cat(&plain, 0).unwrap());
            let mut normal = Normal::new(stream(4, "fields"));
            let bar: Vec<f64> = plain.iter().map(|_| normal.next()).collect();
            let bar = candle_core::Tensor::from_vec(bar, all.shape(), all.device()).unwrap();
            let gradients = (&all * bar).unwrap().sum_all().unwrap().backward().unwrap();
            (numbers::<f64>(&all), plain, numbers::<f64>(gradients.get(&var).unwrap()))
        };
        let (fused, plain, fused_bar) = of(Kernels::Fused);
        let (composed, _, composed_bar) = of(Kernels::Composed);
        assert!(fused == plain, "{}: looking at a run and at a tape are two things", case.name);
        let found = (gap(n, &fused, &composed), gap(n, &fused_bar, &composed_bar));
        println!("{}: fields differ by {:.1e}, their gradients by {:.1e}", case.name, found.0, found.1);
        assert!(found.0 < 1e-11 && found.1 < 1e-8, "{}: {found:?}", case.name);
        // Particles fill the box, to what their disorder costs.
        if case.name.contains("box") {
            let mass: f64 = plain[2 * l.dimension * n..][..n].iter().sum();
            let whole: f64 = case.model.equation_of_state.reference_density
                * case.model.domain.size[..l.dimension].iter().product::<f64>();
            assert!((mass / whole - 1.0).abs() < 0.05, "{}: {mass} of {whole}", case.name);
        }
    }
}

/// For each fluid particle its number and d of each field, `[fields, monomials]`.
fn derivatives<R: Sweeps>(model: &Consistent<R>, known: &[f64]) -> Vec<(usize, Vec<Vec<f64>>)> {
    let known: Vec<R> = known.iter().map(|&x| R::of(x)).collect();
    let list = Neighbourhood::build(&model.reach(), &known).unwrap().list;
    let mut blocks = Blocks::default();
    R::tables(&mut blocks, &list, &model.fits.surface);
    let geometry = Geometry { model, blocks: &blocks, times: TimeSteps { now: model.dt, before: 0.0 } };
    let (mut kept, mut found) = (Kept::default(), Vec::new());
    R::derivatives(&geometry, &mut kept, &known, &mut found);
    let (d, fields, lanes) = (model.dimension(), model.layout.fields(), width::<R>());
    let (q, rows) = (monomials(d), found.len() / lanes / blocks.fluid.blocks());
    let at = |place: usize, row: usize| found[(place / lanes * rows + row) * lanes + place % lanes].f64();
    let of = |place: usize| (0..fields).map(|f| (0..q).map(|m| at(place, f * q + m)).collect()).collect();
    blocks.fluid.each().map(|(place, i)| (i, of(place))).collect()
}

/// A quadratic around a place: its value, and its derivatives in units of dx.
struct Quadratic {
    centre: [f64; 3],
    scale: f64,
    slope: [f64; 3],
    curvature: [[f64; 3]; 3],
}

impl Quadratic {
    /// A random one in these dimensions, of numbers about one a length `scale` away from the centre.
    fn random(centre: [f64; 3], scale: f64, dimensions: &[usize], normal: &mut Normal) -> Self {
        let (mut slope, mut curvature) = ([0.0; 3], [[0.0; 3]; 3]);
        for &a in dimensions {
            slope[a] = normal.next();
            for &b in dimensions {
                curvature[a][b] = normal.next();
                curvature[b][a] = curvature[a][b];
            }
        }
        Self { centre, scale, slope, curvature }
    }
    fn value(&self, r: [f64; 3]) -> f64 {
        let s: [f64; 3] = std::array::from_fn(|a| (r[a] - self.centre[a]) / self.scale);
        let quadratic: f64 =
            (0..3).map(|a| (0..3).map(|b| 0.5 * self.curvature[a][b] * s[a] * s[b]).sum::<f64>()).sum();
        0.3 + (0..3).map(|a| self.slope[a] * s[a]).sum::<f64>() + quadratic
    }
    /// As the fits have them.
    fn derivatives(&self, d: usize, r: [f64; 3], dx: f64) -> Vec<f64> {
        let mut all = vec![0.0; monomials(d)];
        let unit = dx / self.scale;
        for a in 0..d {
            let s = |b: usize| (r[b] - self.centre[b]) / self.scale;
            all[a] = unit * (self.slope[a] + (0..d).map(|b| self.curvature[a][b] * s(b)).sum::<f64>());
            for b in a..d {
                all[quadratic(d, a, b)] = unit * unit * self.curvature[a][b];
            }
        }
        all
    }
}

fn place(state: &[f64], n: usize, d: usize, i: usize) -> [f64; 3] {
    std::array::from_fn(|k| if k < d { state[k * n + i] } else { 0.0 })
}

#[test]
fn derivatives_of_quadratics_are_exact_in_a_disordered_box() {
    for dimension in [2, 3] {
        let case = vortices::<f64>(dimension, true, isotropic());
        let (n, l, mut known) = (case.model.particles(), case.model.layout, case.state.clone());
        let centre: [f64; 3] = std::array::from_fn(|k| 0.5 * case.model.domain.size[k]);
        let mut normal = Normal::new(stream(21, "quadratics"));
        let all: Vec<usize> = (0..dimension).collect();
        let fields: Vec<_> = (0..l.fields()).map(|_| Quadratic::random(centre, 5.0 * DX, &all, &mut normal)).collect();
        for (field, quadratic) in fields.iter().enumerate() {
            for i in 0..n {
                known[(dimension + field) * n + i] = quadratic.value(place(&known, n, dimension, i));
            }
        }
        let reach = case.model.kernel.cutoff();
        let (mut seen, mut worst) = (0, 0.0_f64);
        for (i, found) in derivatives(&case.model, &known) {
            let r = place(&known, n, dimension, i);
            // A quadratic is not periodic.
            if (0..dimension).any(|k| r[k] < reach || r[k] > case.model.domain.size[k] - reach) {
                continue;
            }
            seen += 1;
            for (quadratic, found) in fields.iter().zip(found) {
                for (a, b) in found.iter().zip(quadratic.derivatives(dimension, r, DX)) {
                    worst = worst.max((a - b).abs());
                }
            }
        }
        println!("{dimension}D: {seen} particles, worst error {worst:.1e}");
        assert!(seen > 20 && worst < 1e-11, "{dimension}D: {seen} particles, {worst:e}");
    }
}

/// Any quadratic velocity and pressure; a temperature that depends on x alone, so that no heat flows into the walls where
/// they are not hot, which is where they are flat.
#[test]
fn derivatives_of_quadratics_are_exact_beside_a_curved_wall() {
    for sets in [&[][..], &["resolution.kernel=wendland-c2", "resolution.smoothing_length=1.3"]] {
        let case = noisy_channel::<f64>(sets);
        let (model, mut known) = (&case.model, case.state.clone());
        let (n, l, fits) = (model.particles(), model.layout, &model.fits);
        let centre = [0.5, 0.1, 0.0];
        let mut normal = Normal::new(stream(22, "quadratics"));
        let dimensions: [&[usize]; 4] = [&[0, 1], &[0, 1], &[0, 1], &[0]];
        let fields = dimensions.map(|all| Quadratic::random(centre, 0.2, all, &mut normal));
        let mut flat = 0;
        for i in 0..n {
            let r = place(&known, n, 2, i);
            let holds_velocity = model.is_fluid(i) || fits.weights[4 * i + VELOCITY] > 0.0;
            for (field, quadratic) in fields.iter().enumerate() {
                if field >= 2 || holds_velocity {
                    known[(2 + field) * n + i] = quadratic.value(r);
                }
            }
            if fits.weights[4 * i + NO_FLUX] > 0.0 {
                assert_eq!(known[l.velocity() * n + i], 0.0, "a wall without heat flux that is not flat, at {r:?}");
                flat += 1;
            }
        }
        assert!(flat > 50);
        let reach = model.kernel.cutoff();
        let (mut worst, mut beside) = ([0.0_f64; 4], 0);
        for (i, found) in derivatives(model, &known) {
            let r = place(&known, n, 2, i);
            if r[0] < reach || r[0] > 1.0 - reach {
                continue;
            }
            beside += (r[1] < 0.04) as usize;
            for (field, (quadratic, found)) in fields.iter().zip(found).enumerate() {
                for (a, b) in found.iter().zip(quadratic.derivatives(2, r, fits.spacing)) {
                    worst[field] = worst[field].max((a - b).abs());
                }
            }
        }
        println!("{}: worst errors {}, {beside} particles beside the wall", case.name, short(&worst));
        assert!(beside > 50 && worst.iter().all(|x| *x < 1e-11), "{}", short(&worst));
    }
}

#[test]
fn steps_have_the_derivatives_that_differences_have() {
    for (steps, hs) in [(1, [1e-5, 1e-6, 1e-7]), (20, [1e-5, 1e-6, 1e-7])] {
        for case in cases::<f64>() {
            // Three dimensions have the same code as two at 20 steps, and take long.
            if steps > 1 && case.model.dimension() == 3 {
                continue;
            }
            let bar = case.random("bar");
            let (_, gradient) = case.taped(Kernels::Fused, steps, &bar);
            for k in 0..2 {
                let direction = case.random(["one way", "the other"][k]);
                let slope: f64 = gradient.iter().zip(&direction).map(|(g, v)| g * v).sum();
                let at = |h: f64| -> f64 {
                    let moved: Vec<f64> = case.state.iter().zip(&direction).map(|(x, v)| x + h * v).collect();
                    case.run(&moved, steps).iter().zip(&bar).map(|(x, b)| x * b).sum()
                };
                // Large steps meet limits of the shift and ends of strips, with small ones rounding takes over.
                let gaps = hs.map(|h| ((at(h) - at(-h)) / (2.0 * h) / slope - 1.0).abs());
                let best = gaps.into_iter().fold(f64::INFINITY, f64::min);
                println!("{}, {steps} steps: {} (slope {slope:.3e})", case.name, short(&gaps));
                assert!(best < 1e-6, "{}, {steps} steps: {}", case.name, short(&gaps));
            }
        }
    }
}

/// A top wall that is nowhere flat: there the dummy particles' nearest points on it have kinks.
const TWO_WALLS: [&str; 4] = [
    "design.walls=both",
    "design.nodes=[0.3, 0.42, 0.51, 0.7]",
    "design.offsets=[0.004, -0.003, 0.005, 0.001]",
    "design.top_offsets=[-0.002, 0.005, 0.001, -0.004]",
];

#[test]
fn design_gradients_are_derivatives() {
    let kinds = [
        &[][..],
        &["method.shift=isotropic"],
        &["method.shift=rows"],
        &["method.shift=none"],
        &["design.parametrisation=b-spline"],
        &["fluid.drive=flow-rate"],
        &["fluid.drive=pumping-power"],
        &TWO_WALLS,
        &[&TWO_WALLS[..], &["objective.kind=wall-heat"]].concat(),
    ];
    for sets in kinds {
        let steps = 10;
        let (_, problem) = channel::<f64>(&[&["time.steps=10", "objective.window=0"], sets].concat());
        let squares = FinalSum { steps, of: Summed::SquaredHeat };
        let warmth: &dyn Objective = match sets.contains(&"objective.kind=wall-heat") {
            true => &*problem.objective,
            false => &squares,
        };
        let of = |kernels| {
            let dynamics = Sph::new(problem.model.clone(), kernels);
            let start = problem.start(&problem.first);
            let found = gradient(&dynamics, &start, &Schedule::segments(steps, 4), warmth, &mut |_| ()).unwrap();
            problem.by_variables(&problem.first, &numbers::<f64>(&found.state))
        };
        let (fused, composed) = (of(Kernels::Fused), of(Kernels::Composed));
        let oracle = gap(fused.len(), &fused, &composed);
        let value = |x: &[f64]| {
            let dynamics = problem.dynamics();
            let mut end = run(&dynamics, &problem.start(x), steps, &mut []).unwrap();
            hydrograd::adjoint::gradient::value(warmth, &dynamics.look(&mut end).unwrap()).unwrap()
        };
        let mut normal = Normal::new(stream(6, "along"));
        for _ in 0..3 {
            let direction: Vec<f64> = fused.iter().map(|_| normal.next()).collect();
            let slope: f64 = fused.iter().zip(&direction).map(|(g, v)| g * v).sum();
            let at = |h: f64| value(&problem.first.iter().zip(&direction).map(|(x, v)| x + h * v).collect::<Vec<_>>());
            let gap = smallest_gap(&[1e-7, 1e-6, 1e-8], 1e-6, |h| ((at(h) - at(-h)) / (2.0 * h) / slope - 1.0).abs());
            println!("{sets:?}: composed {oracle:.1e}, differences {gap:.1e} (slope {slope:.3e})");
            assert!(oracle < 1e-8, "{sets:?}: {oracle:e}");
            assert!(gap < 1e-6, "{sets:?}: {gap:e}");
        }
    }
}

#[test]
fn a_resumed_run_has_the_same_bits() {
    for case in [noisy_channel::<f64>(&[]), vortices(2, true, isotropic()), buoyant(vortices(2, true, isotropic()))] {
        let mut whole = Solver::restore(case.model.clone(), &case.snapshot(&case.state)).unwrap();
        (0..40).for_each(|_| whole.advance().unwrap());
        let mut part = Solver::restore(case.model.clone(), &case.snapshot(&case.state)).unwrap();
        for step in 0..40 {
            if step % 7 == 5 {
                // Looking changes nothing, nor does a search that begins elsewhere.
                part.look().unwrap();
                part = Solver::restore(case.model.clone(), &part.snapshot()).unwrap();
            }
            part.advance().unwrap();
        }
        assert!(whole.state == part.state, "{}", case.name);
    }
}

#[test]
fn uniform_pressure_exerts_no_force() {
    for dimension in [2, 3] {
        let case = vortices::<f64>(dimension, false, isotropic());
        let (n, l, mut state) = (case.model.particles(), case.model.layout, case.state.clone());
        state[l.velocity() * n..l.pressure() * n].fill(0.0);
        state[l.pressure() * n..].fill(3.7);
        let end = case.run(&state, 5);
        let largest = end[l.velocity() * n..].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        assert!(largest < 1e-12, "{dimension}D: {largest:e}");
        // It does shift particles.
        assert!(end[..n] != state[..n]);
    }
    // Between walls, at rest, without a force. Heat moves nothing.
    let case = noisy_channel::<f64>(&["fluid.body_force=0", "design.shape=cosine"]);
    let (n, l, mut state) = (case.model.particles(), case.model.layout, case.state.clone());
    for i in (0..n).filter(|&i| case.model.is_fluid(i)) {
        (l.velocity()..l.pressure()).for_each(|row| state[row * n + i] = 0.0);
        state[l.pressure() * n + i] = 3.7;
    }
    let end = case.run(&state, 5);
    for i in (0..n).filter(|&i| case.model.is_fluid(i)) {
        let largest = (l.velocity()..=l.pressure()).map(|row| end[row * n + i].abs()).fold(0.0, f64::max);
        // The fit over the wall's surface gives the dummy particles 3.7 to rounding and its regularisation.
        assert!(largest < 1e-9, "particle {i}: {largest:e}");
    }
}

#[test]
fn flows_do_not_know_how_fast_they_are_looked_past() {
    for dimension in [2, 3] {
        let case = vortices::<f64>(dimension, true, isotropic());
        let (n, l, steps) = (case.model.particles(), case.model.layout, 10);
        let past = [0.7, -0.4, 0.25];
        let mut moving = case.state.clone();
        for k in 0..dimension {
            moving[(l.velocity() + k) * n..][..n].iter_mut().for_each(|u| *u += past[k]);
        }
        let (still, moved) = (case.run(&case.state, steps), case.run(&moving, steps));
        let time = steps as f64 * case.model.dt;
        let mut worst = 0.0_f64;
        for (row, (a, b)) in still.chunks(n).zip(moved.chunks(n)).enumerate() {
            for (a, b) in a.iter().zip(b) {
                let difference = match row {
                    _ if row < dimension => case.model.domain.nearest(row, b - a - past[row] * time) / DX,
                    _ if row < l.pressure() => b - a - past[row - dimension],
                    _ => b - a,
                };
                worst = worst.max(difference.abs());
            }
        }
        println!("{dimension}D: {worst:.1e} after {steps} steps");
        assert!(worst < 1e-9, "{dimension}D: {worst:e}");
    }
}

/// Without gradients nothing acts but buoyancy: u += dt (-beta g) (T - T0).
#[test]
fn warm_fluid_rises_by_boussinesqs_formula() {
    let case = buoyant(vortices::<f64>(2, true, Shift::None));
    let (n, mut state) = (case.model.particles(), case.state.clone());
    for (row, value) in [(2, 0.8), (3, -0.3), (4, 0.0), (5, 0.6)] {
        state[row * n..][..n].fill(value);
    }
    let end = case.run(&state, 3);
    for (row, first, gravity) in [(2, 0.8, 0.7), (3, -0.3, -2.3)] {
        let expected = first - 3.0 * case.model.dt * 1.7 * gravity * (0.6 - 0.04);
        assert!(end[row * n..][..n].iter().all(|u| (u - expected).abs() < 1e-12), "{} and {expected}", end[row * n]);
    }
    assert!(end[4 * n..] == state[4 * n..]);
}

#[test]
fn a_uniform_flow_stays_uniform() {
    let case = vortices::<f64>(2, true, isotropic());
    let (n, l, mut state) = (case.model.particles(), case.model.layout, case.state.clone());
    for (row, value) in [(2, 0.8), (3, -0.3), (4, 0.0), (5, 0.6)] {
        state[row * n..][..n].fill(value);
    }
    let end = case.run(&state, 30);
    assert!(end[2 * n..] == state[2 * n..], "it did not");
    assert_eq!(l.state_rows(), 6);
    // The shift spreads particles evenly: the volumes' spread falls.
    let spread = |state: &[f64]| {
        let dynamics = Sph::new(case.model.clone(), Kernels::Fused);
        let mut run = dynamics.start(&case.snapshot(state)).unwrap();
        let masses = numbers::<f64>(&dynamics.look(&mut run).unwrap().mass);
        let mean = masses.iter().sum::<f64>() / n as f64;
        (masses.iter().map(|m| (m / mean - 1.0).powi(2)).sum::<f64>() / n as f64).sqrt()
    };
    assert!(spread(&end) < 0.8 * spread(&state), "{} and {}", spread(&state), spread(&end));
}

/// A perfect lattice stays one: nothing shifts it.
#[test]
fn a_lattice_is_not_shifted() {
    let model = box_model::<f64>(2, 12, false, isotropic());
    let (n, l) = (model.particles(), model.layout);
    let mut state = vec![0.0; l.state_rows() * n];
    for i in 0..n {
        state[i] = ((i % 12) as f64 + 0.5) * DX;
        state[n + i] = ((i / 12) as f64 + 0.5) * DX;
    }
    let case = Case { name: "lattice".into(), model, state };
    let end = case.run(&case.state, 20);
    assert!(end.iter().zip(&case.state).all(|(a, b)| (a - b).abs() < 1e-12));
}

/// Whole runs of the default scene against finite elements; and the heat that leaves is the heat that conduction brings.
#[test]
fn outflows_are_those_of_finite_elements() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("data/reference/fem-shapes-H0.2.csv");
    let text = std::fs::read_to_string(path).unwrap();
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let column = |name: &str| lines[0].iter().position(|cell| *cell == name).unwrap();
    let (q, first) = (column("Q"), column("o0"));
    let nodes: Vec<String> = (0..25).map(|k| format!("{}", 0.26 + 0.02 * k as f64)).collect();
    for (shape, amplitude) in [("flat", "0"), ("up", "0.02"), ("down", "0.02"), ("sin1", "0.02")] {
        let line = lines.iter().find(|line| line[0] == shape && line[1] == amplitude).unwrap();
        let sets = [
            format!("design.nodes=[{}]", nodes.join(",")),
            format!("design.offsets=[{}]", line[first..first + 25].join(",")),
        ];
        let config = Config::load(None, None, &sets).unwrap_or_else(|e| panic!("{e}")).config;
        let problem = Scene::<f64>::from_config(&config).unwrap().design.unwrap();
        let start = problem.start(&problem.first);
        let found = simulate(&problem, config.run.kernels, &start, &mut []).unwrap().diagnostics;
        let expected: f64 = line[q].parse().unwrap();
        let error = found.q / expected - 1.0;
        println!(
            "{shape}: Q {:.6}, {:+.2} %, heat balance {:+.2} %",
            found.q,
            100.0 * error,
            100.0 * found.energy_imbalance
        );
        assert!(error.abs() < 5e-3, "{shape}: Q = {} is not {expected}", found.q);
        assert!(found.energy_imbalance.abs() < 0.02, "{shape}: {}", found.energy_imbalance);
    }
}

/// From heights of the surface's points to a state, and back.
#[test]
fn the_adjoint_of_the_surface_is_its_derivative() {
    for sets in
        [&[][..], &["resolution.dx=0.01"], &["channel.height=0.26", "channel.hot_from=0.257", "channel.hot_to=0.741"]]
    {
        let (_, problem) = channel::<f64>(sets);
        let deformation = &problem.deformation;
        let mut rng = stream(8, "heights");
        let mut heights = problem.parametrisation.column_heights(&problem.first);
        assert_eq!(heights.len(), deformation.columns);
        heights.iter_mut().for_each(|s| *s += 0.002 * (2.0 * uniform(&mut rng) - 1.0));
        let mut normal = Normal::new(stream(8, "bars"));
        let bar: Vec<f64> = deformation.base.iter().map(|_| normal.next()).collect();
        let found = deformation.pull_back(&heights, &bar);
        let at = |k: usize, h: f64| -> f64 {
            let mut heights = heights.clone();
            heights[k] += h;
            deformation.state::<f64>(&heights).iter().zip(&bar).map(|(x, b)| x * b).sum()
        };
        let mut worst = 0.0_f64;
        for k in 0..heights.len() {
            // Mirror images have kinks where another segment becomes the nearest one.
            let gaps =
                [1e-6, 1e-7].map(|h| ((at(k, h) - at(k, -h)) / (2.0 * h) - found[k]).abs() / (1.0 + found[k].abs()));
            worst = worst.max(gaps[0].min(gaps[1]));
        }
        println!("{sets:?}: {worst:.1e}");
        assert!(worst < 1e-6, "{sets:?}: {worst:e}");
    }
}

/// What the surface's deformation says of itself: where points, fluid and dummy particles go.
#[test]
fn the_surface_is_deformed_as_described() {
    let (config, problem) = channel::<f64>(&[]);
    let (model, deformation) = (problem.model.of_type::<Consistent<f64>>().unwrap(), &problem.deformation);
    let (n, l, dx) = (model.particles(), model.layout, config.resolution.dx);
    let heights = problem.parametrisation.column_heights(&problem.first);
    let flat = deformation.state::<f64>(&vec![0.0; heights.len()]);
    let state = deformation.state::<f64>(&heights);
    assert_eq!(state[..n], flat[..n], "particles move vertically only");
    // Over a flat wall nothing changes, to rounding.
    assert!(flat.iter().zip(&deformation.base).all(|(a, b)| (a - b).abs() < 1e-14));
    let spacing = 0.5 * dx;
    let level = |x: f64| {
        let k = (x / spacing).floor() as usize % heights.len();
        let share = x / spacing - (x / spacing).floor();
        heights[k] + share * (heights[(k + 1) % heights.len()] - heights[k])
    };
    let height = config.channel.height;
    for i in 0..n {
        let (x, before, after) = (flat[i], flat[n + i], state[n + i]);
        let expected = match model.tags[i] {
            tag::FLUID => before + level(x) * (1.0 - before / height),
            _ if before > 0.5 * height => before,
            _ => before + level(x),
        };
        assert!((after - expected).abs() < 1e-12, "particle {i} (tag {}) at {after}, not {expected}", model.tags[i]);
        let vector = [state[l.velocity() * n + i], state[(l.velocity() + 1) * n + i]];
        if model.fits.weights[4 * i + NO_FLUX] > 0.0 {
            assert!((vector[0].hypot(vector[1]) - 1.0).abs() < 1e-14, "a normal has length 1");
        }
    }
    // A mirror image is as far above the wall as its particle is below, straight across the nearest point.
    for &(dummy, _) in &model.fits.dummies {
        let i = dummy as usize;
        if flat[n + i] > 0.0 {
            continue;
        }
        let middle = [0, 1].map(|k| 0.5 * (state[k * n + i] + state[(l.velocity() + k) * n + i]));
        let x = middle[0].rem_euclid(config.channel.length);
        assert!((level(x) - middle[1]).abs() < 1e-12, "dummy {i}: the middle {middle:?} is not on the wall");
        let away = |x: f64| (x - state[i]).hypot(level(x.rem_euclid(config.channel.length)) - state[n + i]);
        let own = away(middle[0]);
        assert!((0..400).all(|k| away(state[i] + (k as f64 / 200.0 - 1.0) * 5.0 * dx) > own - 1e-12), "dummy {i}");
    }
}

#[test]
fn a_truncated_gradient_drops_what_the_fluid_was() {
    let (_, problem) = channel::<f64>(&[]);
    let (n, model) = (problem.model.particles(), &problem.model);
    let mut bar = vec![1.0; problem.deformation.base.len()];
    problem.deformation.keep_static(&mut bar, |i| model.is_fluid(i));
    for (place, value) in bar.iter().enumerate() {
        assert_eq!(
            *value,
            if model.is_fluid(place % n) { 0.0 } else { 1.0 },
            "row {}, particle {}",
            place / n,
            place % n
        );
    }
}

#[test]
fn the_rows_of_a_state_are_those_of_the_layout() {
    for (dimension, heat, rates) in [(2, false, false), (2, true, true), (3, true, false), (3, false, true)] {
        let l = Layout { dimension, heat, rates };
        let rows = l.rows();
        assert_eq!((rows.count(), rows.velocity()), (l.state_rows(), l.velocity()));
        assert_eq!(rows.row(Quantity::Pressure), Some(l.pressure()));
        assert_eq!(rows.temperature(), heat.then(|| l.temperature()));
        assert_eq!(rows.row(Quantity::Acceleration), rates.then(|| l.last_rates()));
    }
}

type L = <f64 as Real>::Portable;

fn lane(x: L) -> f64 {
    x.largest()
}

#[test]
fn monomials_have_their_places_and_derivatives() {
    assert_eq!((monomials(2), monomials(3), packed(5), packed(9)), (5, 9, 15, 45));
    let s = [L::splat(0.3), L::splat(-0.7), L::splat(1.1)];
    let q = values::<L, 3, 9>(&s).map(lane);
    let right = [0.3, -0.7, 1.1, 0.045, -0.21, 0.33, 0.245, -0.77, 0.605];
    assert!(q.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-15), "{q:?}");
    let c: [L; 9] = std::array::from_fn(|k| L::splat(0.1 * k as f64 - 0.2));
    let n = [L::splat(0.5), L::splat(0.2), L::splat(-0.6)];
    let (s_bar, n_bar) = pull_back_along::<L, 3, 9>(&s, &n, &c);
    for a in 0..3 {
        let f = |by_s: f64, by_n: f64| {
            let (mut s, mut n) = (s, n);
            s[a] += L::splat(by_s);
            n[a] += L::splat(by_n);
            lane(dot(&along::<L, 3, 9>(&s, &n), &c))
        };
        assert!((lane(s_bar[a]) - (f(1e-5, 0.0) - f(-1e-5, 0.0)) / 2e-5).abs() < 1e-9, "{a}");
        assert!((lane(n_bar[a]) - (f(0.0, 1e-5) - f(0.0, -1e-5)) / 2e-5).abs() < 1e-9, "{a}");
        let g = |h: f64| {
            let moved = std::array::from_fn(|k| s[k] + L::splat(h) * n[k]);
            lane(values::<L, 3, 9>(&moved)[a + 3])
        };
        assert!((lane(along::<L, 3, 9>(&s, &n)[a + 3]) - (g(1e-5) - g(-1e-5)) / 2e-5).abs() < 1e-9, "{a}");
    }
    let bar = pull_back::<L, 3, 9>(&s, &c).map(lane);
    for a in 0..3 {
        let f = |h: f64| {
            let mut moved = s;
            moved[a] += L::splat(h);
            lane(dot(&values::<L, 3, 9>(&moved), &c))
        };
        let difference = (f(1e-5) - f(-1e-5)) / 2e-5;
        assert!((bar[a] - difference).abs() < 1e-9, "{a}");
    }
}

#[test]
fn a_factorised_matrix_is_solved() {
    let mut matrix = [L::zero(); 15];
    let points: Vec<[f64; 2]> = (0..9).map(|k| [(k as f64).sin(), (1.7 * k as f64).cos()]).collect();
    let mut b = [L::zero(); 5];
    let x = [1.0, -2.0, 0.5, 3.0, -0.25];
    for p in &points {
        let q = values::<L, 2, 5>(&[L::splat(p[0]), L::splat(p[1])]);
        accumulate::<L, 5, 15>(&mut matrix, L::splat(0.7), &q);
        let f: f64 = q.iter().zip(x).map(|(q, x)| lane(*q) * x).sum();
        for k in 0..5 {
            b[k] = (L::splat(0.7) * q[k]).mul_add(L::splat(f), b[k]);
        }
    }
    factorise::<L, 5, 15>(&mut matrix, L::splat(1e-12));
    let found = solve::<L, 5, 15>(&matrix, b).map(lane);
    assert!(found.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-11), "{found:?}");
}
