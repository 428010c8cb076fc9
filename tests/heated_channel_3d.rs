//! The heated channel in three dimensions: its wall, what the wall moves, against the channel in two dimensions, gradients, and the
//! program as users run it.

use crate::support::differences::smallest_gap;
use assert_cmd::Command;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::config::scene::Config;
use hydrograd::design::deformation::Map;
use hydrograd::design::diagnostics::Diagnostics;
use hydrograd::design::parametrisations::SplineSurface;
use hydrograd::design::shape::MAX_SLOPE;
use hydrograd::design::{diagnostics, Optimisation, Parametrisation, Problem, Scheduled, Search};
use hydrograd::numerics::random::{stream, uniform, Normal};
use hydrograd::particles::tag;
use hydrograd::scene::Scene;
use hydrograd::sph::consistent::kinds::NO_FLUX;
use hydrograd::sph::consistent::Consistent;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

const SCENE: &str = "heated-channel-3d";
/// As coarse as the channel's height allows, flat at the start, and driven as the channel in two dimensions.
const COARSE: [&str; 5] =
    ["resolution.dx=0.04", "channel.span=0.24", "design.bound=0.008", "design.shape=flat", "fluid.drive=body-force"];

fn load(scene: &str, sets: &[&str]) -> Config {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    Config::load(Some(scene), None, &sets).unwrap_or_else(|error| panic!("{error}")).config
}

fn problem(sets: &[&str]) -> (Config, Problem<f64>) {
    let config = load(SCENE, &[&COARSE[..], sets].concat());
    let problem = Scene::from_config(&config).unwrap().design.unwrap();
    (config, problem)
}

fn numbers(name: &str, count: usize, size: f64) -> Vec<f64> {
    let mut random = stream(7, name);
    (0..count).map(|_| size * (2.0 * uniform(&mut random) - 1.0)).collect()
}

fn surface(sets: &[&str]) -> (Config, SplineSurface) {
    let config = load(SCENE, sets);
    let surface = SplineSurface::of_config(&config, &[]);
    (config, surface)
}

#[test]
fn the_wall_is_smooth_periodic_and_within_its_limits() {
    for sets in
        [&[][..], &["design.control_points=9", "design.control_points_across=1"], &["design.control_points_across=2"]]
    {
        let (config, surface) = surface(sets);
        let (channel, bound) = (&config.channel, config.design.bound);
        let [h, g] = config.control_distances();
        let mut points = numbers("wall", surface.variables(), 1.0);
        points.iter_mut().for_each(|point| *point = bound.copysign(*point));
        let at = |x: f64, z: f64| surface.height(&points, x, z);
        let step = 1e-6;
        for i in 0..400 {
            let x = channel.length * (i as f64 + 0.5) / 400.0;
            for k in 0..12 {
                let z = channel.span * k as f64 / 12.0;
                let (y, slopes) =
                    (at(x, z), [(at(x + step, z) - at(x, z)) / step, (at(x, z + step) - at(x, z)) / step]);
                assert!((at(x, z + channel.span) - y).abs() < 1e-14, "periodic");
                assert!(y.abs() <= bound * (1.0 + 1e-12));
                assert!(slopes[0].abs() <= 2.0 * bound / h + 1e-4 && slopes[1].abs() <= 2.0 * bound / g + 1e-4);
                assert!(slopes.iter().all(|slope| slope.abs() <= MAX_SLOPE));
                let is_outside = x <= channel.hot_from || x >= channel.hot_to;
                assert!(!is_outside || y == 0.0, "outside the hot section");
            }
        }
        // Of third order where it begins: with its slope and curvature it is zero there.
        let near = |share: f64| at(channel.hot_from + share * h, 0.3 * channel.span);
        assert!((near(0.02) / near(0.01) - 8.0).abs() < 1e-9, "{}", near(0.02) / near(0.01));
        // Equal control points: a plateau.
        let equal = vec![0.3; surface.variables()];
        let middle = channel.hot_from + 0.5 * (channel.hot_to - channel.hot_from);
        for k in 0..10 {
            assert!((surface.height(&equal, middle, 0.1 * k as f64 * channel.span) - 0.3).abs() < 1e-14);
        }
        let (one, across) = (surface.positions(), surface.across().unwrap());
        for (k, (&x, &z)) in one.iter().zip(across).enumerate() {
            let unit: Vec<f64> = (0..one.len()).map(|i| (i == k) as usize as f64).collect();
            let own = surface.height(&unit, x, z);
            assert!(
                (0..20).all(|i| surface.height(&unit, x + 0.3 * h, z + 0.1 * i as f64 * g) <= own),
                "highest where it stands"
            );
        }
    }
}

#[test]
fn a_sampled_wall_gives_its_control_points_back() {
    for sets in [
        &[][..],
        &["design.bound=0.02", "design.control_points=11", "design.control_points_across=3"],
        &["design.control_points_across=1"],
    ] {
        let (config, surface) = surface(sets);
        let points = numbers("fit", surface.variables(), config.design.bound);
        let wall = surface.sampled(&points);
        let found = surface.fitted(&wall.nodes, wall.across.as_ref().unwrap(), &wall.offsets);
        let worst = points.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{sets:?}: {worst:e}");
    }
}

#[test]
fn roughness_costs_what_it_says() {
    let (_, surface) = surface(&[]);
    let points = numbers("rough", surface.variables(), 0.02);
    let (value, gradient) = surface.penalty(0.3, &points);
    assert!(value > 0.0);
    for k in 0..points.len() {
        let moved = |by: f64| {
            let mut points = points.clone();
            points[k] += by;
            surface.penalty(0.3, &points).0
        };
        // Quadratic: any step is exact, a large one has the least rounding.
        assert!(((moved(1.0) - moved(-1.0)) / 2.0 - gradient[k]).abs() < 1e-12);
    }
    let turned: Vec<f64> = (0..24).map(|i| points[(i + 6) % 24]).collect();
    assert!((surface.penalty(0.3, &turned).0 / value - 1.0).abs() < 1e-12, "there is no first row across the span");
}

/// Curved along both directions.
fn curved(problem: &Problem<f64>) -> Vec<f64> {
    numbers("curved", problem.first.len(), 0.008)
}

#[test]
fn the_wall_moves_what_it_says() {
    let (config, problem) = problem(&[]);
    let (model, deformation) = (problem.model.of_type::<Consistent<f64>>().unwrap(), &problem.deformation);
    let (n, l, height) = (model.particles(), model.layout, config.channel.height);
    let points = curved(&problem);
    let flat = problem.start(&vec![0.0; points.len()]).state;
    assert!(
        flat.iter().zip(&deformation.base).all(|(a, b)| (a - b).abs() < 1e-14),
        "a flat wall is the plane channel's"
    );
    let state = problem.start(&points).state;
    let level = |x: f64, z: f64| problem.parametrisation.height(&points, x, z);
    let mirrored: Vec<u32> = model.fits.dummies.iter().map(|(dummy, _)| *dummy).collect();
    let (mut normals, mut images) = (0, 0);
    for i in 0..n {
        let [x, y, z] = [0, 1, 2].map(|d| flat[d * n + i]);
        assert_eq!((state[i], state[2 * n + i]), (x, z), "particles move along y only");
        let expected = match model.tags[i] {
            tag::FLUID => y + level(x, z) * (1.0 - y / height),
            _ if y > 0.5 * height => y,
            _ => y + level(x, z),
        };
        assert!((state[n + i] - expected).abs() < 1e-13, "particle {i} at {}, not {expected}", state[n + i]);
        let vector = [0, 1, 2].map(|d| state[(l.velocity() + d) * n + i]);
        let step = 1e-4 * config.resolution.dx;
        let slope = |dx: f64, dz: f64| (level(x + dx, z + dz) - level(x - dx, z - dz)) / (2.0 * step);
        let tangents = [[1.0, slope(step, 0.0), 0.0], [0.0, slope(0.0, step), 1.0]];
        // The deformation's own slopes are differences over half a spacing: of cubics that is (dx/4)^2 y'''/6 off.
        let [h, g] = config.control_distances();
        let third = config.design.bound / h.min(g).powi(3);
        let slack = 8.0 * third * (0.25 * config.resolution.dx).powi(2) / 6.0;
        if model.fits.weights[4 * i + NO_FLUX] > 0.0 {
            normals += (vector[1] < 1.0 && y == 0.0) as usize;
            assert!((vector.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-14, "a normal has length 1");
            for tangent in tangents.iter().filter(|_| y == 0.0) {
                let along: f64 = tangent.iter().zip(vector).map(|(a, b)| a * b).sum();
                assert!(along.abs() < slack, "point {i}: {along:e} along the wall");
            }
        }
        if mirrored.contains(&(i as u32)) && y < 0.0 {
            images += (level(x, z) != 0.0) as usize;
            // Half way lies in the tangent plane above the particle, and the way is normal to that.
            let way = [0, 1, 2].map(|d| vector[d] - state[d * n + i]);
            let half = [0.5 * way[0], state[n + i] + 0.5 * way[1] - level(x, z), 0.5 * way[2]];
            let above = half[1] - tangents[0][1] * half[0] - tangents[1][1] * half[2];
            assert!(above.abs() < slack * -2.0 * y, "dummy {i}: {above:e} above the plane");
            for tangent in tangents {
                let along: f64 = tangent.iter().zip(way).map(|(a, b)| a * b).sum();
                assert!(along.abs() < slack * -4.0 * y, "dummy {i}: {along:e} along the wall");
            }
        }
    }
    assert!(images > 20 && normals == 0, "the wall is flat where no heat flows: {images} {normals}");
}

#[test]
fn the_adjoint_of_the_wall_is_its_derivative() {
    let (_, problem) = problem(&[]);
    let (deformation, points) = (&problem.deformation, curved(&problem));
    let Map::Relief(relief) = &deformation.map else { panic!("no relief") };
    assert_eq!(relief.places.len(), deformation.columns);
    let mut normal = Normal::new(stream(8, "bars"));
    let bar: Vec<f64> = deformation.base.iter().map(|_| normal.next()).collect();
    // By the heights: rough ones, so that the points where no heat flows lean too.
    let mut heights = problem.parametrisation.column_heights(&points);
    heights.iter_mut().zip(numbers("heights", deformation.columns, 0.002)).for_each(|(height, more)| *height += more);
    let found = deformation.pull_back(&heights, &bar);
    let at = |heights: &[f64]| -> f64 { deformation.state::<f64>(heights).iter().zip(&bar).map(|(x, b)| x * b).sum() };
    let direction = numbers("direction", deformation.columns, 1.0);
    let along: f64 = found.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let moved = |by: f64| at(&heights.iter().zip(&direction).map(|(s, d)| s + by * d).collect::<Vec<_>>());
    let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
    assert!((difference / along - 1.0).abs() < 1e-7, "{difference} and {along}");
    // Some heights of every kind one by one.
    for k in (0..deformation.columns).step_by(97) {
        let one = |by: f64| {
            let mut heights = heights.clone();
            heights[k] += by;
            at(&heights)
        };
        let difference = (one(1e-6) - one(-1e-6)) / 2e-6;
        assert!(
            (difference - found[k]).abs() < 1e-6 * (1.0 + found[k].abs()),
            "height {k}: {difference}, {}",
            found[k]
        );
    }
    // By the variables.
    let adjoint = problem.by_variables(&points, &bar);
    for k in 0..points.len() {
        let one = |by: f64| -> f64 {
            let mut points = points.clone();
            points[k] += by;
            problem.start(&points).state.iter().zip(&bar).map(|(x, b)| x * b).sum()
        };
        let difference = (one(1e-6) - one(-1e-6)) / 2e-6;
        assert!((difference / adjoint[k] - 1.0).abs() < 1e-6, "variable {k}: {difference}, {}", adjoint[k]);
    }
}

/// Q, flow rate and heat balance at the end of a scene's run.
fn figures(config: &Config) -> Diagnostics {
    let problem = Scene::<f64>::from_config(config).unwrap().design.unwrap();
    let start = problem.start(&problem.first);
    diagnostics::simulate(&problem, config.run.kernels, &start, &mut []).unwrap().diagnostics
}

/// The channel in two dimensions with what the one in three has.
const PLANE: [&str; 5] =
    ["resolution.dx=0.04", "design.bound=0.008", "method.shift=isotropic", "method.shift_strength=1", "time.cfl=1"];
const WINDOW: [&str; 3] = ["time.end=1.2", "objective.window=0.25", "objective.samples=20"];

fn plane(sets: &[&str]) -> Diagnostics {
    figures(&load("heated-channel", &[&PLANE[..], &WINDOW, sets].concat()))
}

fn deep(sets: &[&str]) -> Diagnostics {
    figures(&load(SCENE, &[&COARSE[..], &WINDOW, sets].concat()))
}

/// Of flat walls, in two and in three dimensions.
static FLAT: LazyLock<[Diagnostics; 2]> = LazyLock::new(|| [plane(&[]), deep(&[])]);

/// What is left between the two is the error of the spacing, as kernels and disorder differ: Q 2.9e-3 here, 1.5e-3 at dx = 0.025.
#[test]
fn a_flat_wall_has_the_outflow_of_two_dimensions() {
    let [plane, deep] = &*FLAT;
    let (q, flow) = (deep.q / plane.q - 1.0, deep.flow_rate / plane.flow_rate - 1.0);
    let power = deep.pumping_power / plane.pumping_power - 1.0;
    println!("Q {:.6} and {:.6} ({q:+.1e}), flow rate {flow:+.1e}, pumping power {power:+.1e}", plane.q, deep.q);
    println!("heat balances {:+.1e} and {:+.1e}", plane.energy_imbalance, deep.energy_imbalance);
    assert!(q.abs() < 5e-3, "{q:e}");
    assert!(flow.abs() < 2e-4, "{flow:e}");
    // Masses are sums over particles that stand closer to the walls in two dimensions.
    assert!(power.abs() < 6e-3, "{power:e}");
    assert!((deep.energy_imbalance - plane.energy_imbalance).abs() < 6e-3);
}

/// The spacing's error cancels in what the wall changes, which agrees to 3e-5.
#[test]
fn a_wall_along_x_alone_does_what_it_does_in_two_dimensions() {
    let wall = ["design.control_points_across=1", "design.offsets=[0.008, -0.008, -0.008, -0.004, 0.004, 0.008]"];
    let (config, problem) = problem(&wall);
    let (channel, count) = (&config.channel, 100);
    let width = (channel.hot_to - channel.hot_from) / count as f64;
    let nodes: Vec<f64> = (0..count).map(|k| channel.hot_from + (k as f64 + 0.5) * width).collect();
    let offsets: Vec<f64> = nodes.iter().map(|&x| problem.parametrisation.height(&problem.first, x, 0.1)).collect();
    let profile = [format!("design.nodes={nodes:?}"), format!("design.offsets={offsets:?}")];
    let [flat_plane, flat_deep] = &*FLAT;
    let (plane, deep) = (plane(&[&profile[0], &profile[1]]), deep(&wall));
    for (name, of) in [("Q", (|d| d.q) as fn(&Diagnostics) -> f64), ("flow rate", |d| d.flow_rate)] {
        let (expected, found) = (of(&plane) / of(flat_plane) - 1.0, of(&deep) / of(flat_deep) - 1.0);
        println!("{name}: the wall changes it by {expected:+.2e} and {found:+.2e}");
        assert!(expected.abs() > 2e-3, "{name}: the wall does something");
        assert!((found - expected).abs() < 3e-4, "{name}: {expected:e} and {found:e}");
    }
}

/// A short run, and what it says at its end, near the hot section.
const SHORT: [&str; 5] = [
    "time.steps=40",
    "objective.window=0.03",
    "objective.samples=4",
    "objective.target_x=0.76",
    "design.control_points_across=4",
];

#[test]
fn the_gradient_is_the_derivative() {
    let held = ["fluid.drive=flow-rate", "objective.kind=outlet-temperature"];
    for sets in [&[][..], &held, &["objective.kind=wall-heat", "method.integrator=verlet"]] {
        let (_, problem) = problem(&[&SHORT[..], sets].concat());
        let x = curved(&problem);
        let schedule = Schedule::segments(problem.steps, 10);
        let found = problem.differentiate(&x, &schedule, &mut |_| ()).unwrap();
        assert_eq!(found.value, problem.evaluate(&x).unwrap(), "the gradient's run is the plain run");
        let mut normal = Normal::new(stream(5, "along"));
        let direction: Vec<f64> = x.iter().map(|_| normal.next()).collect();
        let slope: f64 = found.by_variables.iter().zip(&direction).map(|(g, v)| g * v).sum();
        let at = |t: f64| {
            let moved: Vec<f64> = x.iter().zip(&direction).map(|(x, v)| x + t * v).collect();
            problem.evaluate(&moved).unwrap()
        };
        // As in two dimensions: larger steps meet particles that cross a strip, below them rounding takes over.
        let gap = |h: f64| ((at(h) - at(-h)) / (2.0 * h) / slope - 1.0).abs();
        let best = smallest_gap(&[1e-7, 3e-8, 1e-6], 1e-5, gap);
        println!("{sets:?}: relative error {best:.1e} of {slope:.3e}");
        assert!(best <= 1e-5, "{sets:?}: {best:e}");
    }
}

/// The segments' gradient is that of one graph; and single precision agrees.
#[test]
fn segments_and_single_precision_agree() {
    let (config, double) = problem(&SHORT);
    let x = curved(&double);
    let of = |schedule: &Schedule| double.differentiate(&x, schedule, &mut |_| ()).unwrap().by_variables;
    let taped = of(&Schedule::taped(double.steps));
    assert_eq!(of(&Schedule::segments(double.steps, 7)), taped);
    let single = Scene::<f32>::from_config(&config).unwrap().design.unwrap();
    let found = single.differentiate(&x, &Schedule::taped(single.steps), &mut |_| ()).unwrap().by_variables;
    let norm = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>().sqrt();
    let gap = norm(&mut found.iter().zip(&taped).map(|(a, b)| a - b)) / norm(&mut taped.iter().copied());
    println!("f32 differs by {gap:.1e}");
    assert!(gap < 1e-3, "{gap:e}");
}

/// The channel has no preferred direction along z: a mirrored wall has the mirrored gradient.
#[test]
fn a_mirrored_wall_has_the_mirrored_gradient() {
    let (config, problem) = problem(&[&SHORT[..], &["time.jitter=0"]].concat());
    let along = config.design.control_points;
    let mirrored = |x: &[f64]| x.chunks(along).rev().flatten().copied().collect::<Vec<f64>>();
    let schedule = Schedule::segments(problem.steps, 10);
    let x = curved(&problem);
    let one = problem.differentiate(&x, &schedule, &mut |_| ()).unwrap();
    let other = problem.differentiate(&mirrored(&x), &schedule, &mut |_| ()).unwrap();
    assert!((one.value / other.value - 1.0).abs() < 1e-11);
    let largest = one.by_variables.iter().fold(0.0_f64, |most, g| most.max(g.abs()));
    let gaps = mirrored(&one.by_variables).into_iter().zip(&other.by_variables).map(|(a, b)| (a - b).abs() / largest);
    let worst = gaps.fold(0.0, f64::max);
    println!("mirrored gradients differ by {worst:.1e}");
    assert!(worst < 1e-8, "{worst:e}");
    let same = one.by_variables.iter().zip(&other.by_variables).all(|(a, b)| (a - b).abs() < 1e-3 * largest);
    assert!(!same, "the wall is not its own image");
}

#[test]
fn an_optimisation_raises_the_outflow() {
    let sets = [
        "time.end=0.4",
        "objective.target_x=0.76",
        "objective.window=0.1",
        "objective.samples=5",
        "design.shape=random",
        "design.amplitude=0.004",
    ];
    let (config, problem) = problem(&sets);
    let schedule = problem.schedule(&config.optimise, config.run.precision).unwrap();
    let solver = Scheduled { problem, schedule };
    let (problem, search) = (&solver.problem, Search { config: &config, solver: &solver, surrogate: None });
    let mut optimisation = Optimisation::new(search.optimiser(&problem.first));
    search.run(&mut optimisation, 3, &mut |_: &Optimisation| Ok(())).unwrap();
    let values: Vec<f64> = optimisation.history.iter().map(|epoch| epoch.figure).collect();
    println!("{values:?}");
    let best = &optimisation.history[optimisation.best];
    assert!(optimisation.best > 0 && best.figure > 1.002 * values[0], "{values:?}");
    assert_eq!(best.figure, problem.evaluate(&best.variables).unwrap(), "the solver says so too");
    assert!(problem.parametrisation.limits().contains(&best.variables));
}

fn run(folder: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_hydrograd")).current_dir(folder).args(arguments).output().unwrap()
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

fn columns(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect());
    lines.collect()
}

#[test]
fn the_program_simulates_optimises_resumes_and_checks() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let set = |sets: &[&'static str]| -> Vec<&'static str> { sets.iter().flat_map(|set| ["--set", *set]).collect() };
    let small = set(&[&COARSE[..], &SHORT[..], &["output.frames=2"]].concat());
    let with = |command: &[&'static str], more: &[&'static str]| [command, &small, more].concat();
    let text = succeeds(at, &with(&["simulate", SCENE, "--out", "flat"], &[]));
    assert!(text.contains("hydrograd optimize heated-channel-3d") && text.contains("per depth"), "{text}");
    for file in [
        "summary.json",
        "shape.csv",
        "wall.png",
        "temperature.png",
        "flow.png",
        "history.csv",
        "particles/particles.pvd",
    ] {
        assert!(at.join("flat").join(file).is_file(), "{file}");
    }
    let whole = ["optimize", SCENE, "--epochs", "3", "--no-verify", "--out", "whole"];
    let started = set(&["design.shape=random", "design.amplitude=0.004"]);
    succeeds(at, &[&with(&whole, &[])[..], &started].concat());
    for file in [
        "summary.json",
        "shape.csv",
        "shapes.png",
        "history.csv",
        "temperature.png",
        "wall.vtp",
        "particles/particles.pvd",
    ] {
        assert!(at.join("whole").join(file).is_file(), "{file}");
    }
    // Two epochs, and then one more.
    let parts = ["optimize", SCENE, "--epochs", "2", "--no-verify", "--out", "parts"];
    succeeds(at, &[&with(&parts, &[])[..], &started].concat());
    succeeds(at, &["optimize", "--resume", "parts", "--epochs", "3", "--no-verify"]);
    assert_eq!(columns(&at.join("parts/shape.csv")), columns(&at.join("whole/shape.csv")), "to the bit");
    let header = std::fs::read_to_string(at.join("whole/shape.csv")).unwrap();
    assert!(header.starts_with("x,z,height,first,last\n"), "{header}");
    // The wall is the same when it is read back, and verified.
    let read = set(&["design.file=whole/shape.csv"]);
    succeeds(at, &[&with(&["simulate", SCENE, "--out", "again"], &[])[..], &read].concat());
    let heights = |file: &str| columns(&at.join(file)).into_iter().map(|row| row[2]).collect::<Vec<f64>>();
    let gaps = heights("again/shape.csv").into_iter().zip(heights("whole/shape.csv")).map(|(a, b)| (a - b).abs());
    assert!(gaps.fold(0.0, f64::max) < 1e-12);
    let text = succeeds(at, &["verify", "whole"]);
    assert!(text.contains("a finer spacing (0.02)") && !text.contains("fixed particles"), "{text}");
    assert!(!text.contains("WARNING: the check"), "{text}");
    let check = ["check-gradient", SCENE, "--steps", "12", "--directions", "1", "--out", "check"];
    let coarse = set(&COARSE);
    assert!(succeeds(at, &[&check[..], &coarse].concat()).contains("PASSED"));
}

#[test]
fn what_there_is_not_is_refused() {
    let folder = TempDir::new().unwrap();
    std::fs::write(folder.path().join("wall.csv"), "x,z,height\n0.5,0.1,0.01\n0.5,0.1,0.05\n").unwrap();
    std::fs::write(folder.path().join("profile.csv"), "x,offset\n0.5,0.01\n").unwrap();
    let refuses = |arguments: &[&str], parts: &[&str]| {
        let output = run(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        parts.iter().for_each(|part| assert!(text.contains(part), "{arguments:?}: no `{part}` in {text}"));
        assert!(!text.contains("no design"), "{text}");
    };
    let set = |set: &str, parts: &[&str]| refuses(&["simulate", SCENE, "--set", set], parts);
    set("method.name=standard", &["method.name = standard can not solve this scene", "allowed: consistent, fixed"]);
    set("method.shift=chain", &["method.shift = chain", "isotropic", "try: --set method.shift=isotropic"]);
    set("design.control_points=30", &["design.bound = 0.02", "control points' distance", "0 ... 0.015"]);
    set("design.offsets=[0.0, 0.01]", &["design.offsets has 2 numbers", "24", "design.control_points = 6"]);
    set("design.control_points_across=0", &["design.control_points_across = 0", "1"]);
    set("channel.span=0.1", &["channel.span = 0.1 is too short", "at least"]);
    set("channel.span=0.21", &["does not divide channel.span = 0.21", "channel.span"]);
    set("resolution.dx=0.0005", &["particles", "at most"]);
    set("design.file=wall.csv", &["0.05", "x = 0.5, z = 0.1", "out of bounds"]);
    set("design.file=profile.csv", &["no column `z`", "x,z,height"]);
    set("design.file=none.csv", &["no such file"]);
    refuses(
        &["optimize", SCENE, "--gradient", "steady"],
        &["optimise.gradient = steady with method.name = consistent", "allowed: segments, taped, truncated"],
    );
    refuses(&["optimize", SCENE, "--dynamics", "surrogate"], &["--dynamics surrogate", "is not a key of scene"]);
    refuses(&["optimize", SCENE, "--compare"], &["--compare", "is not a key of scene heated-channel-3d"]);
    refuses(
        &["generate", SCENE, "--set", "fluid.drive=body-force", "--out", "data"],
        &["no data sets of scene heated-channel-3d"],
    );
    refuses(&["optimize", SCENE, "--preset", "report"], &["preset report", "not a key"]);
}
