//! Fixed particles around any shape: solver, fits, outlines, equations and their adjoint, and finite elements beside them.

use crate::deferred_correction::corrected;
use crate::support::differences::of_mean;
use crate::support::noise::noise;
use crate::support::program::{hydrograd, refused};
use candle_core::{Device, Tensor, Var};
use hydrograd::config::custom::{Kind, ShapeEntry};
use hydrograd::config::scene::Config;
use hydrograd::design::sqp::{Limited, Point, Sqp};
use hydrograd::io::csv::read_table;
use hydrograd::numerics::eigenvalues::outermost;
use hydrograd::numerics::krylov::gmres;
use hydrograd::numerics::sparse_lu::{BlockMatrix, Order, SparseLu};
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_in_time::Marching;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::Of;
use hydrograd::scene::shape_search::{Epoch, Search};
use hydrograd::sph::cloud::composed::residual;
use hydrograd::sph::cloud::contour::Contour;
use hydrograd::sph::cloud::corner_fit::{self, Corner};
use hydrograd::sph::cloud::equations::{Bar, Derivatives, State};
use hydrograd::sph::cloud::figures::Figure;
use hydrograd::sph::cloud::fit_adjoint::PairCotangents;
use hydrograd::sph::cloud::interpolation::Interpolation;
use hydrograd::sph::cloud::nearest::{Nearest, Plane};
use hydrograd::sph::cloud::outline::{area, centroid_within, OnOutline, Outline};
use hydrograd::sph::cloud::particles::{At, Balanced};
use hydrograd::sph::cloud::placing::{behind, BoundaryPoint, Polygon};
use hydrograd::sph::cloud::problem::Solution;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

/// The channel of data/reference/bodies-in-channel.csv with other keys and shapes behind it.
pub(crate) fn channel(dx: f64, more: &str) -> String {
    format!(
        "scene = \"custom\"\nregion.size = [1.0, 0.4]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
         fluid.viscosity = 0.006\nfluid.conductivity = 0.006\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
         resolution.dx = {dx}\nmethod.name = \"fixed\"\n{more}\n\
         [[shapes]]\nkind = \"box\"\nlower = [-1.0, -0.2]\nupper = [2.0, 0.0]\ntemperature = 0.0\n\
         [[shapes]]\nkind = \"box\"\nlower = [-1.0, 0.4]\nupper = [2.0, 0.6]\ntemperature = 0.0\n"
    )
}

pub(crate) fn loaded(text: &str) -> Config {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, text).unwrap();
    Config::load(Some(file.to_str().unwrap()), None, &[]).unwrap_or_else(|error| panic!("{error}")).config
}

/// The flow of a scene's text.
pub(crate) fn solved(text: &str) -> (AroundShapes, Solution) {
    let mut around = AroundShapes::new(&loaded(text)).unwrap();
    let numbers = around.flow.cloud.numbers();
    let solution = around.flow.solve(&numbers).unwrap();
    (around, solution)
}

/// A body of the reference file as a shape.
pub(crate) fn shape(kind: &str, numbers: &[f64]) -> String {
    let list = |numbers: &[f64]| format!("{numbers:?}");
    let keys = match kind {
        "disc" => format!("radius = {}", numbers[2]),
        "ellipse" => format!("axes = {}\nangle = {}", list(&numbers[2..4]), numbers[4]),
        _ => format!("radii = {}", list(&numbers[2..])),
    };
    format!("[[shapes]]\nkind = \"{kind}\"\ncentre = {}\n{keys}\ntemperature = 1.0\n", list(&numbers[..2]))
}

#[test]
fn the_direct_solver_solves_a_matrix_and_its_transpose_with_any_number_of_threads() {
    let (columns, size) = (31, 3);
    let nodes = columns * columns;
    let neighbours = |i: usize| {
        let (x, y) = ((i % columns) as i64, (i / columns) as i64);
        let all = [(1, 0), (-1, 0), (0, 1), (0, -1), (2, 1), (-1, 2)];
        let inside = move |(a, b): (i64, i64)| {
            let (x, y) = (x + a, y + b);
            let is_in = (0..columns as i64).contains(&x) && (0..columns as i64).contains(&y);
            is_in.then_some((y * columns as i64 + x) as u32)
        };
        all.into_iter().filter_map(inside).collect::<Vec<u32>>()
    };
    let mut matrix = BlockMatrix::of_lists(nodes, size, neighbours);
    let mut draw = noise(7);
    matrix.values.iter_mut().for_each(|x| *x = draw());
    for i in 0..nodes {
        let diagonal = matrix.entry(i, i as u32);
        // Not so large that no rows are exchanged.
        (0..size).for_each(|k| matrix.block_mut(diagonal)[k * size + k] += 8.0);
    }
    let order = Arc::new(Order::new(&matrix, |i| [(i % columns) as f64, (i / columns) as f64]));
    let right: Vec<f64> = (0..nodes * size).map(|_| draw()).collect();
    let mut seen: Vec<Vec<f64>> = vec![];
    for threads in [1, 2, 3] {
        let lu = SparseLu::new(&order, &matrix, threads).unwrap();
        for transposed in [false, true] {
            let residual = |x: &[f64]| {
                let product = matrix.times(x, transposed);
                product.iter().zip(&right).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
            };
            let x = lu.solve(&right, transposed);
            assert!(residual(&x) < 1e-10, "{threads} threads, transposed {transposed}: residual {:e}", residual(&x));
            seen.push(x);
        }
    }
    // The transpose, by its definition: y . A x = x . A^T y.
    let other: Vec<f64> = (0..nodes * size).map(|_| draw()).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (one, two) = (dot(&other, &matrix.times(&right, false)), dot(&right, &matrix.times(&other, true)));
    assert!((one - two).abs() < 1e-10 * one.abs().max(1.0), "{one} and {two}");
    assert!(seen.chunks(2).all(|pair| pair == &seen[..2]), "the number of threads changes bits");
    // A matrix of zeros has no factors.
    matrix.values.fill(0.0);
    assert!(SparseLu::new(&order, &matrix, 1).is_err());
}

#[test]
fn gmres_solves_with_and_without_help_and_gives_up_when_told() {
    let n = 60;
    let mut draw = noise(3);
    let a: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| draw() / 8.0 + if i == j { 3.0 } else { 0.0 }).collect()).collect();
    let times = |x: &[f64]| a.iter().map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum()).collect::<Vec<f64>>();
    let right: Vec<f64> = (0..n).map(|_| draw()).collect();
    let third = |x: &[f64]| x.iter().map(|x| x / 3.0).collect::<Vec<f64>>();
    let x = gmres(&right, 1e-12, 60, &times, &third).unwrap();
    let worst = times(&x).iter().zip(&right).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-10, "{worst:e}");
    assert!(gmres(&right, 1e-12, 2, &times, &third).is_none());
}

#[test]
fn the_outermost_eigenvalues_are_found() {
    // Blocks a +- b i on the diagonal, and something above it.
    let n = 200;
    let mut draw = noise(2);
    let values: Vec<(f64, f64)> =
        (0..n / 2).map(|k| if k == 0 { (1.1, 0.9) } else { (0.4 * draw(), 0.4 * draw()) }).collect();
    let above: Vec<f64> = (0..n).map(|_| 0.05 * draw()).collect();
    let mut map = |x: &[f64]| {
        (0..n)
            .map(|i| {
                let (a, b) = values[i / 2];
                let own = if i % 2 == 0 { a * x[i] + b * x[i + 1] } else { a * x[i] - b * x[i - 1] };
                own + if i + 2 < n { above[i] * x[i + 2] } else { 0.0 }
            })
            .collect::<Vec<f64>>()
    };
    let first: Vec<f64> = (0..n).map(|_| draw()).collect();
    let found = outermost(&first, 40, &mut map);
    let best = found.iter().max_by(|a, b| a.value.norm().total_cmp(&b.value.norm())).unwrap();
    assert!((best.value.re - 1.1).abs() < 1e-8 && (best.value.im.abs() - 0.9).abs() < 1e-8, "{best:?}");
    assert!(best.residual < 1e-6);
}

/// Behind a cylinder in an open stream vortices begin at a Reynolds number of 46 to 47 (Jackson 1987; Strouhal number 0.12 there).
#[test]
fn the_stream_behind_a_cylinder_is_stable_at_30_and_unstable_at_80() {
    for (reynolds, is_stable) in [(30.0, true), (80.0, false)] {
        let text = format!(
            "scene = \"custom\"\nregion.size = [16.0, 10.0]\nregion.periodic = [false, false]\nregion.acceleration = [0.0, 0.0]\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [1.0, 0.0] }}\nregion.sides.right = {{ kind = \"outflow\" }}\n\
             region.sides.top = {{ kind = \"symmetry\" }}\nregion.sides.bottom = {{ kind = \"symmetry\" }}\n\
             fluid.viscosity = {}\nresolution.dx = 0.2\nmethod.name = \"fixed\"\n\
             [[shapes]]\nkind = \"disc\"\ncentre = [5.0, 5.0]\nradius = 0.5\n",
            1.0 / reynolds
        );
        let mut around = AroundShapes::new(&loaded(&text)).unwrap();
        let solution = around.solve(&[]).unwrap();
        // The drag coefficient of a cylinder is 1.7 at 30 in an open stream; steady and symmetric it has no lift.
        let drag = 2.0 * around.value(&solution, Figure::Force { shape: 0, along: 0 });
        let lift = 2.0 * around.value(&solution, Figure::Force { shape: 0, along: 1 });
        let (growth, frequency) = around.flow.growth(&solution, 1.0).unwrap().unwrap();
        println!("{reynolds}: drag {drag}, growth {growth}, frequency {frequency}");
        assert!(lift.abs() < 0.05 * drag, "{lift}");
        assert_eq!(growth < 0.0, is_stable, "growth {growth} at {reynolds}, drag {drag}");
        if !is_stable {
            let strouhal = frequency / std::f64::consts::TAU;
            assert!((0.09..0.16).contains(&strouhal), "{strouhal}");
        }
    }
}

#[test]
fn the_nearest_are_the_nearest_across_a_periodic_side() {
    let plane = Plane { size: [1.0, 0.5], periodic: [true, false] };
    let mut draw = noise(11);
    let places: Vec<[f64; 2]> = (0..400).map(|_| [0.5 + 0.5 * draw(), 0.25 + 0.25 * draw()]).collect();
    let near = Nearest::new(plane, 0.04, &places);
    for &p in places.iter().step_by(17) {
        let found: Vec<u32> = near.of(p, 9, |_, _| true).into_iter().map(|(_, i)| i).collect();
        let mut all: Vec<(f64, u32)> =
            places.iter().enumerate().map(|(i, q)| (plane.distance(p, *q), i as u32)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert_eq!(found, all[..9].iter().map(|(_, i)| *i).collect::<Vec<u32>>());
    }
}

fn entries() -> Vec<ShapeEntry> {
    let of = |kind: Kind| ShapeEntry { kind, centre: Some(vec![0.5, 0.2]), ..ShapeEntry::default() };
    vec![
        ShapeEntry { radius: Some(0.1), ..of(Kind::Disc) },
        ShapeEntry { axes: Some(vec![0.1, 0.05]), angle: Some(30.0), ..of(Kind::Ellipse) },
        ShapeEntry { radii: Some(vec![0.1, 0.08, 0.07, 0.09, 0.11]), ..of(Kind::Spline) },
        ShapeEntry { digits: Some("2412".into()), chord: Some(0.3), angle: Some(-5.0), ..of(Kind::Naca) },
        ShapeEntry { kind: Kind::Box, lower: Some(vec![0.3, 0.1]), upper: Some(vec![0.6, 0.2]), ..Default::default() },
        ShapeEntry {
            kind: Kind::Polygon,
            points: Some(vec![[0.3, 0.1], [0.4, 0.3], [0.6, 0.15]]),
            ..Default::default()
        },
        ShapeEntry {
            kind: Kind::Polyline,
            points: Some(vec![[0.3, 0.1], [0.4, 0.2], [0.6, 0.15]]),
            thickness: Some(0.03),
            ..Default::default()
        },
        ShapeEntry {
            kind: Kind::BSpline,
            points: Some(vec![[0.3, 0.1], [0.6, 0.1], [0.6, 0.3], [0.3, 0.3]]),
            ..Default::default()
        },
    ]
}

#[test]
fn outlines_run_counter_clockwise_and_their_slopes_are_their_derivatives() {
    for entry in entries() {
        let outline = Outline::new(&entry, 0.005).unwrap();
        let s = outline.numbers.clone();
        let fine = outline.samples(40);
        let all = outline.points(&fine, &s);
        assert!(area(&all) > 0.0, "{:?} runs clockwise", entry.kind);
        let t = [0.013, 0.21, 0.47, 0.741, 0.98];
        let points = outline.points(&t, &s);
        // Along t.
        let (ahead, behind) = (outline.points(&t.map(|t| t + 1e-6), &s), outline.points(&t.map(|t| t - 1e-6), &s));
        for k in 0..t.len() {
            for d in 0..2 {
                let slope = (ahead[k].place[d] - behind[k].place[d]) / 2e-6;
                assert!(
                    (points[k].along[d] - slope).abs() < 1e-5,
                    "{:?}: {} and {slope}",
                    entry.kind,
                    points[k].along[d]
                );
            }
        }
        // By each number.
        for number in 0..s.len() {
            let step = 1e-6;
            let moved = |by: f64| {
                let mut s = s.clone();
                s[number] += by;
                outline.points(&t, &s)
            };
            let (up, down) = (moved(step), moved(-step));
            for (k, slope) in outline.slopes(&t, &s, number).iter().enumerate() {
                for d in 0..2 {
                    let of_place = (up[k].place[d] - down[k].place[d]) / (2.0 * step);
                    let of_along = (up[k].along[d] - down[k].along[d]) / (2.0 * step);
                    assert!((slope.place[d].slope - of_place).abs() < 1e-7, "{:?} {number}", entry.kind);
                    assert!((slope.along[d].slope - of_along).abs() < 1e-5, "{:?} {number}", entry.kind);
                }
            }
        }
    }
    // Areas that are known: of a disc, of an ellipse, and of the NACA 0012 with a closed trailing edge, 0.0817 of its chord squared.
    let exact = |entry: &ShapeEntry| {
        let outline = Outline::new(entry, 1e-6).unwrap();
        area(&outline.points(&outline.samples(64), &outline.numbers))
    };
    assert!((exact(&entries()[0]) / (std::f64::consts::PI * 0.01) - 1.0).abs() < 1e-4);
    assert!((exact(&entries()[1]) / (std::f64::consts::PI * 0.005) - 1.0).abs() < 1e-4);
    let naca = ShapeEntry { digits: Some("0012".into()), chord: Some(1.0), ..entries()[3].clone() };
    assert!((exact(&naca) / 0.0817 - 1.0).abs() < 2e-3, "{}", exact(&naca));
}

#[test]
fn parameters_of_a_wall_do_not_move_its_outline() {
    for entry in entries() {
        let outline = Outline::new(&entry, 0.005).unwrap();
        let with = Outline::new(&ShapeEntry { parameters: vec![0.3, 7.0], ..entry.clone() }, 0.005).unwrap();
        let t = outline.samples(40);
        assert_eq!(t, with.samples(40));
        assert_eq!(outline.points(&t, &outline.numbers), with.points(&t, &with.numbers), "{:?}", entry.kind);
        assert_eq!(outline.corners(), with.corners(), "{:?}", entry.kind);
    }
}

/// A flow with every kind of condition.
pub(crate) const SIDES: &str = "scene = \"custom\"\nregion.size = [1.0, 0.5]\nregion.acceleration = [0.1, 0.2]\n\
    region.sides.left = { kind = \"inflow\", velocity = [\"1 + y\", 0.1], temperature = \"y\" }\n\
    region.sides.right = { kind = \"outflow\" }\nregion.sides.top = { kind = \"symmetry\" }\n\
    region.sides.bottom = { kind = \"wall\", heat_flux = \"0.1 + x\" }\n\
    fluid.viscosity = 0.02\nfluid.conductivity = 0.03\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
    resolution.dx = 0.05\nmethod.name = \"fixed\"\n\
    [[shapes]]\nkind = \"ellipse\"\ncentre = [0.4, 0.25]\naxes = [0.1, 0.07]\nangle = 20\nvelocity = [\"y - 0.25\", \"0.4 - x\"]\ntemperature = 1.0\n\
    [[shapes]]\nkind = \"disc\"\ncentre = [0.7, 0.2]\nradius = 0.06\nheat_flux = \"1 + x\"\n";

#[test]
fn fits_are_exact_for_quadratics_and_what_they_leave_vanishes() {
    let around = AroundShapes::new(&loaded(SIDES)).unwrap();
    let cloud = &around.flow.cloud;
    let shaped = cloud.shaped(&cloud.numbers()).unwrap();
    let [x, y] = &shaped.position;
    let f: Vec<f64> = x.iter().zip(y).map(|(x, y)| 1.0 + 2.0 * x - y + 3.0 * x * x + x * y - 2.0 * y * y).collect();
    for i in 0..cloud.particles() {
        let exact = [2.0 + 6.0 * x[i] + y[i], -1.0 + x[i] - 4.0 * y[i], 6.0, 1.0, -4.0, 0.0];
        let found = shaped.operators.derivatives(&cloud.fits.all, i, &f);
        let worst = found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-8, "particle {i}: {found:?}");
    }
}

#[test]
fn quadratic_fields_are_interpolated_exactly_and_walls_hide_what_is_inside() {
    let around = AroundShapes::new(&loaded(SIDES)).unwrap();
    let cloud = &around.flow.cloud;
    // Of shapes that moved: the ellipse up, the disc larger.
    let mut numbers = cloud.numbers();
    numbers[0][1] += 0.004;
    numbers[1][2] += 0.003;
    let shaped = cloud.shaped(&numbers).unwrap();
    let value = |x: f64, y: f64| 1.0 + 2.0 * x - y + 3.0 * x * x + x * y - 2.0 * y * y;
    let [x, y] = &shaped.position;
    let f: Vec<f64> = x.iter().zip(y).map(|(x, y)| value(*x, *y)).collect();
    let d: Vec<_> = (0..cloud.particles()).map(|i| shaped.operators.derivatives(&cloud.fits.all, i, &f)).collect();
    let all = Interpolation::new(cloud, &shaped);
    let (mut inside, mut hidden) = (0, 0);
    let mut draw = noise(5);
    for _ in 0..4000 {
        let p = cloud.ground.plane.size.map(|size| size * (0.5 + 0.5 * draw()));
        let is_in_disc = (p[0] - 0.7).hypot(p[1] - 0.2) < 0.063;
        match all.sample(p) {
            None => hidden += 1,
            Some(sample) => {
                inside += 1;
                assert!(!is_in_disc, "{p:?}");
                let found = sample.value(&shaped.position, &f, &d);
                assert!((found - value(p[0], p[1])).abs() < 1e-10, "{p:?}: {found}");
                let slope = sample.slope(&shaped.position, &d);
                let exact = [2.0 + 6.0 * p[0] + p[1], -1.0 + p[0] - 4.0 * p[1]];
                assert!((0..2).all(|k| (slope[k] - exact[k]).abs() < 1e-8), "{p:?}: {slope:?}");
            }
        }
    }
    // The share of points inside of shapes is that of their areas.
    let size = cloud.ground.plane.size;
    let covered = std::f64::consts::PI * (0.1 * 0.07 + 0.063 * 0.063) / (size[0] * size[1]);
    let share = f64::from(hidden) / f64::from(hidden + inside);
    assert!((share - covered).abs() < 0.02, "{share} and {covered}");
    assert_eq!(all.sample([0.5, -0.01]), None);
}

#[test]
fn pictures_have_the_flow_beside_the_bodies() {
    let mut around = AroundShapes::new(&loaded(SIDES)).unwrap();
    let solution = around.solve(&[]).unwrap();
    let map = around.map(&solution);
    let hidden = map.speed.values.iter().filter(|x| x.is_nan()).count() as f64;
    let covered = std::f64::consts::PI * (0.1 * 0.07 + 0.06 * 0.06) / 0.5;
    assert!((hidden / map.speed.values.len() as f64 / covered - 1.0).abs() < 0.02, "{hidden}");
    // At the left side 1 + y and 0.1 are given: along a column there the speed and the vorticity dv/dx - du/dy.
    let [columns, rows] = map.speed.cells;
    for row in [rows / 4, rows / 2, rows - 1] {
        let y = 0.5 * (row as f64 + 0.5) / rows as f64;
        let found = map.speed.values[row * columns];
        assert!((found - (1.0 + y).hypot(0.1)).abs() < 0.05, "y = {y}: {found}");
    }
    let inner = |p: &[f64; 2]| (p[0] - 0.7).hypot(p[1] - 0.2) > 0.06 - 1e-3;
    assert!(map.streamlines.len() > 10 && map.streamlines.iter().flatten().all(inner));
    assert_eq!(map.walls.len(), 2);
    assert!(map.temperature.is_some() && map.vorticity.values.len() == columns * rows);
}

#[test]
fn fits_at_walls_are_exact_for_cubics_and_their_adjoint_is_their_derivative() {
    let around = AroundShapes::new(&loaded(SIDES)).unwrap();
    let cloud = &around.flow.cloud;
    let position = cloud.shaped(&cloud.numbers()).unwrap().position;
    let n = cloud.particles();
    let field = |of: &dyn Fn(f64, f64) -> f64| (0..n).map(|i| of(position[0][i], position[1][i])).collect::<Vec<f64>>();
    let cubic = field(&|x, y| 1.0 + x - 2.0 * y + x * x + x * y - 3.0 * x.powi(3) + 2.0 * x * x * y - y.powi(3));
    let other = field(&|x, y| (5.0 * x + 3.0 * y).sin());
    let fits: Vec<_> = cloud.wall_fits.iter().enumerate().filter_map(|(k, fit)| Some((k, fit.as_ref()?))).collect();
    assert!(fits.len() > 40);
    for (k, fit) in fits {
        let i = cloud.places.boundary[k].particle;
        let (x, y) = (position[0][i], position[1][i]);
        let exact = [1.0 + 2.0 * x + y - 9.0 * x * x + 4.0 * x * y, -2.0 + x + 2.0 * x * x - 3.0 * y * y];
        let found = fit.gradient(&position, &cubic);
        assert!((0..2).all(|d| (found[d] - exact[d]).abs() < 1e-9), "{found:?} and {exact:?}");
        // Along a direction in which all positions and values change.
        let (mut by_position, mut by_field) = ([vec![0.0; n], vec![0.0; n]], vec![0.0; n]);
        let bar = [0.7, -1.3];
        fit.pull_back((&position, &other), bar, &mut by_position, &mut by_field);
        let way = |i: usize, k: usize| ((i * 7 + k * 13) as f64).sin();
        let along = |step: f64| {
            let moved: [Vec<f64>; 2] =
                std::array::from_fn(|d| (0..n).map(|i| position[d][i] + step * way(i, d)).collect());
            let values: Vec<f64> = (0..n).map(|i| other[i] + step * way(i, 2)).collect();
            let found = fit.gradient(&moved, &values);
            bar[0] * found[0] + bar[1] * found[1]
        };
        let difference = (along(1e-6) - along(-1e-6)) / 2e-6;
        let sum = |k: usize, bar: &[f64]| (0..n).map(|i| bar[i] * way(i, k)).sum::<f64>();
        let exact = sum(0, &by_position[0]) + sum(1, &by_position[1]) + sum(2, &by_field);
        assert!((difference - exact).abs() < 1e-6 * exact.abs().max(1.0), "{difference} and {exact}");
    }
}

#[test]
fn the_residual_and_its_adjoint_equal_candles() {
    let around = AroundShapes::new(&loaded(SIDES)).unwrap();
    let cloud = &around.flow.cloud;
    let mut numbers = cloud.numbers();
    numbers[0][0] += 0.004;
    let shaped = cloud.shaped(&numbers).unwrap();
    let equations = cloud.equations(&shaped);
    let n = cloud.particles();
    let mut draw = noise(5);
    let mut state = State::at_rest(n);
    state.fields.iter_mut().flatten().for_each(|x| *x = draw());
    let d = equations.derivatives(&shaped.operators, &state, true);
    let (flow, heat) = (equations.flow_residual(&state, &d), equations.heat_residual(&state, &d));
    let tensor = |rows: &[Vec<f64>]| Tensor::from_vec(rows.concat(), (rows.len(), n), &Device::Cpu).unwrap();
    let position = Var::from_tensor(&tensor(&shaped.position)).unwrap();
    let fields = Var::from_tensor(&tensor(&state.fields)).unwrap();
    let composed = residual(&equations, &position, &fields).unwrap();
    let rows = composed.to_vec2::<f64>().unwrap();
    let size = flow.iter().chain(&heat).fold(0.0, |most: f64, x| most.max(x.abs()));
    for i in 0..n {
        for (k, row) in rows.iter().enumerate() {
            let own = if k < 3 { flow[3 * i + k] } else { heat[i] };
            assert!((row[i] - own).abs() < 1e-11 * size, "row {k} of particle {i}: {} and {own}", row[i]);
        }
    }
    // The adjoint, for random cotangents.
    let bars: Vec<Vec<f64>> = (0..4).map(|_| (0..n).map(|_| draw()).collect()).collect();
    let sum = (composed * tensor(&bars)).unwrap().sum_all().unwrap();
    let gradients = sum.backward().unwrap();
    let mut bar = Bar::new(n, shaped.area.len());
    let of_flow: Vec<f64> = (0..3 * n).map(|k| bars[k % 3][k / 3]).collect();
    equations.pull_back(&state, &d, &of_flow, Some(&bars[3]), &mut bar);
    let own = equations.by_positions(&shaped.position, &state, &bar);
    let theirs = gradients.get(&position).unwrap().to_vec2::<f64>().unwrap();
    let size = theirs.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
    for d in 0..2 {
        for i in 0..n {
            assert!((own[d][i] - theirs[d][i]).abs() < 1e-10 * size, "position {d} of particle {i}");
        }
    }
    // The same by the coefficients' cotangents, in two parts.
    let mut pairs = PairCotangents::zeros(&equations.fits.all);
    let numbers: Vec<&[f64]> = state.fields.iter().map(Vec::as_slice).collect();
    pairs.add(&equations.fits.all, &numbers[..1], &bar.derivatives.0[..1]);
    pairs.add(&equations.fits.all, &numbers[1..], &bar.derivatives.0[1..]);
    let mut summed = bar.position.clone();
    equations.fits.all.pull_back_pairs(&shaped.position, &pairs, &mut summed);
    for d in 0..2 {
        for i in 0..n {
            assert!((own[d][i] - summed[d][i]).abs() < 1e-11 * size, "position {d} of particle {i} by pairs");
        }
    }
    // The matrices are the derivatives by the fields.
    let theirs = gradients.get(&fields).unwrap().to_vec2::<f64>().unwrap();
    let (mut of_u, mut of_t) = (equations.fits.all.matrix(3), equations.fits.all.matrix(1));
    equations.flow_matrix(&state, &d, &shaped.operators, &mut of_u);
    equations.heat_matrix(&state, &shaped.operators, &mut of_t);
    let (mut by_u, by_t) = (of_u.times(&of_flow, true), of_t.times(&bars[3], true));
    for (i, by) in equations.heat_by_velocity(&d, &bars[3]).iter().enumerate() {
        (0..2).for_each(|e| by_u[3 * i + e] += by[e]);
    }
    let size = theirs.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
    for i in 0..n {
        for (k, row) in theirs.iter().enumerate() {
            let own = if k < 3 { by_u[3 * i + k] } else { by_t[i] };
            assert!((row[i] - own).abs() < 1e-10 * size, "field {k} of particle {i}: {} and {own}", row[i]);
        }
    }
}

/// What a corner's fit is made of is found exactly, whatever the angle and the direction.
#[test]
fn fits_beside_corners_find_the_singular_temperature() {
    let mut random = noise(3);
    for (turn, from) in [(0.4, 0.3), (1.57, -2.0), (2.0, 3.0), (3.0, 1.1)] {
        let along = |angle: f64| [angle.cos(), angle.sin()];
        let corner = Corner::new([0.3, 0.2], along(from - turn), along(from), 0.3).unwrap();
        assert!(Corner::new([0.3, 0.2], along(from + turn), along(from), 0.3).is_none());
        let (angle, a, g) = (PI + turn, 0.7, [0.2, -0.4]);
        let of = |[x, y]: [f64; 2], phi: f64| {
            a * x.hypot(y).powf(PI / angle) * (PI / angle * phi).sin() + g[0] * x + g[1] * y
        };
        let mut near: Vec<([f64; 2], f64)> = (0..=corner_fit::NEIGHBOURS)
            .map(|k| {
                // The fluid is clockwise from the edge that begins in the corner.
                let (phi, size) = ((0.5 + 0.5 * random()) * angle, 0.02 + 0.005 * k as f64);
                let r = along(from - phi).map(|x| size * x);
                assert!((corner.angle_of(r).unwrap() - phi).abs() < 1e-12);
                (r, of(r, phi))
            })
            .collect();
        let fit = corner.fit(&near).unwrap();
        for (direction, side) in [(from, 1.0), (from - angle, -1.0)] {
            let normal = [side * direction.sin(), -side * direction.cos()];
            let exact = a * 0.03f64.powf(PI / angle) + (g[0] * normal[0] + g[1] * normal[1]) * 0.03;
            let found = fit.slope(normal, 0.03);
            assert!((found - exact).abs() < 1e-9, "{turn}: {found} and {exact}");
        }
        near.pop();
        assert!(corner.fit(&near).is_none() && corner.angle_of(along(from + 0.5 * (PI - turn))).is_none());
    }
}

/// Behind a warm disc the stream carries its heat, and before it none.
#[test]
fn heat_flows_out_through_the_section_that_is_asked_for() {
    let outflow = |target: f64| {
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [2.0, 0.6]\nregion.periodic = [false, false]\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [1, 0], temperature = 0 }}\nregion.sides.right = {{ kind = \"outflow\" }}\n\
             region.sides.bottom = {{ kind = \"symmetry\" }}\nregion.sides.top = {{ kind = \"symmetry\" }}\n\
             fluid.viscosity = 0.05\nfluid.conductivity = 0.02\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
             resolution.dx = 0.05\nobjective.target_x = {target}\n\
             [[shapes]]\nkind = \"disc\"\ncentre = [0.9, 0.3]\nradius = 0.1\ntemperature = 1.0\n"
        );
        let (around, solution) = solved(&text);
        [Figure::HeatOutflow, Figure::Heat { shape: 0 }].map(|figure| around.flow.value(&solution, figure))
    };
    for (target, share) in [(0.4, 0.0), (1.5, 1.0), (5.0, 1.0)] {
        let [carried, heat] = outflow(target);
        println!("{target}: {carried} of {heat}");
        // The disc has four spacings: what flows out is 2 % less than what it gives.
        assert!(heat > 0.1 && (carried / heat - share).abs() < 0.03, "{target}: {carried} of {heat}");
    }
}

#[test]
fn derivatives_of_every_figure_are_differences_of_whole_solutions() {
    let held = channel(0.03, "fluid.drive = \"flow-rate\"\nfluid.flow_rate = 0.2\n")
        + &shape("ellipse", &[0.5, 0.2, 0.08, 0.05, 20.0]);
    let power = channel(0.03, "fluid.drive = \"pumping-power\"\nfluid.pumping_power = 0.3\n")
        + &shape("disc", &[0.5, 0.18, 0.06]);
    let all = |shape: usize| {
        vec![
            Figure::FlowRate,
            Figure::Force { shape, along: 0 },
            Figure::Force { shape, along: 1 },
            Figure::Torque { shape },
            Figure::Heat { shape },
            Figure::HeatOutflow,
            Figure::PressureDrop,
            Figure::Dissipation,
            Figure::Probe { field: 0, probe: 0 },
            Figure::Probe { field: 1, probe: 1 },
            Figure::Probe { field: 2, probe: 1 },
            Figure::Probe { field: 3, probe: 0 },
        ]
    };
    let probes =
        "objective.terms = [{ kind = \"velocity-x\", at = [0.85, 0.21] }, { kind = \"pressure\", at = [0.5, 0.31] }]\n";
    let more = [(corrected(SIDES), 0), (corrected(&power), 2)];
    for (text, shape) in [(SIDES.to_string(), 0), (held, 2), (power, 2)].into_iter().chain(more) {
        let text = probes.to_string() + &text;
        let (mut around, solution) = solved(&text);
        let numbers = around.flow.cloud.numbers();
        let wanted: Vec<(usize, usize)> = (0..numbers[shape].len()).map(|k| (shape, k)).collect();
        let steps: Vec<f64> = wanted.iter().map(|&(_, k)| if k == 4 { 1e-2 } else { 2e-5 }).collect();
        let mut moved = vec![];
        for (&(shape, k), step) in wanted.iter().zip(&steps) {
            let mut at = |by: f64| {
                let mut numbers = numbers.clone();
                numbers[shape][k] += by;
                around.flow.solve(&numbers).unwrap()
            };
            moved.push([at(*step), at(-step)]);
        }
        for figure in all(shape) {
            let exact = around.flow.gradient(&solution, &[(figure, 1.0)], &wanted).unwrap().by_numbers;
            let differences: Vec<f64> = moved
                .iter()
                .zip(&steps)
                .map(|([up, down], step)| {
                    (around.flow.value(up, figure) - around.flow.value(down, figure)) / (2.0 * step)
                })
                .collect();
            let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
            if norm < 1e-9 {
                // What is held does not change.
                assert!(differences.iter().all(|d| d.abs() < 1e-7), "{figure:?}: {exact:?} and {differences:?}");
                continue;
            }
            for (a, b) in exact.iter().zip(&differences) {
                assert!((a - b).abs() < 3e-6 * norm, "{figure:?} of shape {shape}: {exact:?} and {differences:?}");
            }
        }
    }
}

#[test]
fn flow_drag_and_heat_are_those_of_finite_elements() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/reference/bodies-in-channel.csv");
    let (_, rows) = read_table(&file).unwrap();
    let number = |row: &[String], k: usize| row[k].parse::<f64>().unwrap();
    let mut names: Vec<&String> = rows.iter().map(|row| &row[0]).collect();
    names.dedup();
    for name in names {
        let bodies: Vec<&Vec<String>> = rows.iter().filter(|row| row[0] == *name).collect();
        let shapes: String = bodies
            .iter()
            .map(|row| shape(&row[2], &row[3].split(' ').map(|x| x.parse().unwrap()).collect::<Vec<f64>>()))
            .collect();
        let mut around = AroundShapes::new(&loaded(&(channel(0.02, "") + &shapes))).unwrap();
        let solution = around.solve(&[]).unwrap();
        let value = |figure: Figure| around.value(&solution, figure);
        let sum = |of: &dyn Fn(usize) -> Figure| (0..bodies.len()).map(|k| value(of(k + 2))).sum::<f64>();
        let total = |k: usize| bodies.iter().map(|row| number(row, k)).sum::<f64>();
        let off = |found: f64, exact: f64| 100.0 * (found / exact - 1.0);
        let flow = off(value(Figure::FlowRate), number(bodies[0], 4));
        let drag = off(sum(&|shape| Figure::Force { shape, along: 0 }), total(5));
        let heat = off(sum(&|shape| Figure::Heat { shape }), total(8));
        // Two discs across the channel leave gaps of two and a half spacings, which cost 1.6 % of the flow rate.
        let most_flow = if name == "circles-across" { 1.8 } else { 0.3 };
        assert!(
            flow.abs() < most_flow && drag.abs() < 0.3 && heat.abs() < 0.65,
            "{name}: {flow:.2}, {drag:.2}, {heat:.2} %"
        );
    }
}

/// A lattice that becomes coarser far away has a third of the particles in an open stream, and the same drag and heat within 1.5 %.
#[test]
fn far_away_the_lattice_may_be_coarse() {
    let text = |far: f64| {
        format!(
            "scene = \"custom\"\nregion.size = [9.6, 6.4]\nregion.acceleration = [0.0, 0.0]\nregion.sides.left = {{ kind = \"inflow\", velocity = [1.0, 0.0], temperature = 0 }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\nregion.sides.top = {{ kind = \"symmetry\" }}\nregion.sides.bottom = {{ kind = \"symmetry\" }}\n\
             fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\nresolution.dx = 0.1\nresolution.far = {far}\nmethod.name = \"fixed\"\n\
             [[shapes]]\nkind = \"disc\"\ncentre = [3.2, 3.2]\nradius = 0.5\ntemperature = 1.0\n"
        )
    };
    let figures = |far: f64| {
        let mut around = AroundShapes::new(&loaded(&text(far))).unwrap();
        let solution = around.solve(&[]).unwrap();
        let all = [Figure::FlowRate, Figure::Force { shape: 0, along: 0 }, Figure::Heat { shape: 0 }];
        (around.flow.cloud.particles(), all.map(|figure| around.value(&solution, figure)))
    };
    let ((n, fine), (m, coarse)) = (figures(1.0), figures(4.0));
    println!("{n} particles {fine:?}, {m} particles {coarse:?}");
    assert!(3 * m < 2 * n, "{m} of {n} particles");
    for (a, b) in fine.iter().zip(&coarse) {
        assert!((a / b - 1.0).abs() < 1.5e-2, "{fine:?} and {coarse:?}");
    }
}

/// Square array of cylinders that fill a fifth of space, in creeping flow: F / (mu U) = 51.53 (Sangani and Acrivos 1982).
#[test]
fn the_drag_of_a_square_array_is_that_of_sangani_and_acrivos() {
    let text = "scene = \"custom\"\nregion.size = [1.0, 1.0]\nregion.periodic = [true, true]\nregion.acceleration = [1.0, 0.0]\n\
                fluid.viscosity = 1.0\nresolution.dx = 0.03125\nmethod.name = \"fixed\"\n\
                [[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.5]\nradius = 0.25231325\n";
    let mut around = AroundShapes::new(&loaded(text)).unwrap();
    let solution = around.solve(&[]).unwrap();
    let drag = 1.0 / around.value(&solution, Figure::FlowRate);
    assert!((drag / 51.53 - 1.0).abs() < 4e-3, "{drag}");
    // The fluid's body force is all that holds the cylinder, so by balance its force is exact; by its surface nearly so.
    let force = around.value(&solution, Figure::Force { shape: 0, along: 0 });
    let own = around.flow.measures.surface_force(&around.flow.at(&solution), 0, 0);
    assert!((force - 0.8).abs() < 1e-6 && (own - 0.8).abs() < 4e-3, "{force} and {own}");
}

/// Walls inside of the box are those of a narrower box.
#[test]
fn walls_that_reach_into_the_box_are_as_good_as_its_sides() {
    let plain = channel(0.02, "") + &shape("ellipse", &[0.5, 0.2, 0.08, 0.045, 20.0]);
    let thick = channel(0.02, "")
        .replace("size = [1.0, 0.4]", "size = [1.0, 0.5]")
        .replace("upper = [2.0, 0.0]", "upper = [2.0, 0.05]");
    let thick = thick
        .replace("lower = [-1.0, 0.4]", "lower = [-1.0, 0.45]")
        .replace("upper = [2.0, 0.6]", "upper = [2.0, 0.8]");
    let thick = thick + &shape("ellipse", &[0.5, 0.25, 0.08, 0.045, 20.0]);
    let figures = |text: &str| {
        let mut around = AroundShapes::new(&loaded(text)).unwrap();
        let solution = around.solve(&[]).unwrap();
        let all = [
            Figure::FlowRate,
            Figure::Force { shape: 2, along: 0 },
            Figure::Heat { shape: 2 },
            Figure::Heat { shape: 0 },
        ];
        (around.flow.cloud.particles(), all.map(|figure| around.value(&solution, figure)))
    };
    let ((n, plain), (m, thick)) = (figures(&plain), figures(&thick));
    assert_eq!(n, m);
    for (a, b) in plain.iter().zip(&thick) {
        assert!((a - b).abs() < 1e-6 * a.abs(), "{plain:?} and {thick:?}");
    }
}

#[test]
fn steps_of_the_search_hold_limits_and_find_the_minimum() {
    // Rosenbrock's valley in a disc that excludes its end: x^2 + y^2 <= 1.5.
    let judge = |x: &[f64]| {
        let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
        Point {
            x: x.to_vec(),
            value: a * a + 10.0 * b * b,
            gradient: vec![-2.0 * a - 40.0 * x[0] * b, 20.0 * b],
            limits: vec![Limited {
                value: x[0] * x[0] + x[1] * x[1] - 1.5,
                gradient: vec![2.0 * x[0], 2.0 * x[1]],
                is_equation: false,
            }],
        }
    };
    let mut search = Sqp::new(&[-0.5, 0.5], &[-2.0, -2.0], &[2.0, 2.0]);
    let mut evaluations = 0;
    while !search.is_done() && evaluations < 80 {
        let x = search.ask().to_vec();
        search.tell(Some(judge(&x)));
        evaluations += 1;
    }
    let best = search.best().unwrap();
    // By Lagrange's conditions the minimum is at (0.9072, 0.8228).
    assert!((best.x[0] - 0.9072).abs() < 2e-2 && (best.x[1] - 0.8228).abs() < 3e-2, "{:?} after {evaluations}", best.x);
    assert!(best.limits[0].value < 1e-3 && evaluations < 60);
}

/// An objective that changes by a per cent over the whole range is improved, too: its curvature is not that of the first guess.
#[test]
fn a_search_does_not_end_before_it_has_tried_anything() {
    let judge = |x: &[f64]| Point {
        x: x.to_vec(),
        value: 1.0 + 0.02 * (x[0] - 0.9).powi(2),
        gradient: vec![0.04 * (x[0] - 0.9)],
        limits: vec![],
    };
    let mut search = Sqp::new(&[0.5], &[0.0], &[1.0]);
    let mut evaluations = 0;
    while !search.is_done() && evaluations < 20 {
        let x = search.ask().to_vec();
        search.tell(Some(judge(&x)));
        evaluations += 1;
    }
    let best = search.best().unwrap();
    assert!((best.x[0] - 0.9).abs() < 0.05 && evaluations < 20, "{:?} after {evaluations}", best.x);
}

#[test]
fn a_search_raises_the_heat_at_a_fixed_area() {
    let mut text = channel(0.03, "objective.kind = \"shape-heat\"\nobjective.shapes = [2]\noptimise.epochs = 30\n");
    text += &shape("ellipse", &[0.5, 0.2, 0.06, 0.06, 0.0]);
    text += "[[limits]]\nkind = \"area\"\nshapes = [2]\nat_least = 0.01131\nat_most = 0.01131\n";
    for number in ["axes[0]", "axes[1]"] {
        text += &format!("[[variables]]\nnumber = \"shapes[2].{number}\"\nlower = 0.03\nupper = 0.1\n");
    }
    let config = loaded(&text);
    let found = Search::new(&config).unwrap().run(30, &mut |_, _| (), &mut |_| ()).unwrap();
    let (first, best) = (&found.history[0], &found.history[found.best]);
    assert!(best.objective > 1.015 * first.objective, "{} -> {}", first.objective, best.objective);
    assert!((best.variables[0] * best.variables[1] / 0.0036 - 1.0).abs() < 2e-3, "{:?}", best.variables);
    assert!(best.variables[0] > 0.07, "a slender ellipse along the flow, {:?}", best.variables);
}

#[test]
fn a_design_without_a_flow_is_never_the_best() {
    let epoch = |objective: f64, excess: f64, failure: Option<&str>| Epoch {
        variables: vec![],
        objective,
        gradient_norm: 0.0,
        excess,
        seconds: 0.0,
        round: 0,
        failure: failure.map(str::to_string),
    };
    let failed = epoch(f64::NAN, 0.0, Some("the particles fold"));
    let (outside, nearer) = (epoch(5.0, 0.5, None), epoch(1.0, 0.1, None));
    let (held, higher) = (epoch(2.0, 0.0, None), epoch(3.0, 0.0, None));
    let order = [&failed, &outside, &nearer, &held, &higher];
    for (i, a) in order.iter().enumerate() {
        for (j, b) in order.iter().enumerate() {
            assert_eq!(a.is_better(b, 1.0), i > j, "{a:?} and {b:?}");
        }
    }
    assert!(held.is_better(&higher, -1.0));
}

/// Between plates of which one moves from t = 0 on, u tends to a straight line; before, it is the series of Morris, Fox and Zhu (1997).
#[test]
fn a_flow_in_time_is_the_exact_one() {
    let text = "scene = \"custom\"\nregion.size = [0.5, 1.0]\nregion.periodic = [true, false]\nregion.acceleration = [0.0, 0.0]\n\
        region.sides.top = { kind = \"wall\", velocity = [1.0, 0.0] }\nfluid.viscosity = 1.0\nresolution.dx = 0.05\n\
        method.name = \"fixed\"\nmethod.flow = \"unsteady\"\ntime.step = 5e-4\n";
    for end in [0.05, 0.2] {
        let objective = format!(
            "time.end = {end}\nobjective.window = 0.0\nobjective.kind = \"velocity-x\"\nobjective.at = [0.2, 0.7]\n"
        );
        let around = AroundShapes::new(&loaded(&(text.to_string() + &objective))).unwrap();
        let (history, _) = around.march(&[], None, &mut |_, _| Ok(())).unwrap();
        let part = |n: usize| {
            let k = n as f64 * std::f64::consts::PI;
            2.0 / k * (-1f64).powi(n as i32) * (k * 0.7).sin() * (-k * k * end).exp()
        };
        let exact = 0.7 + (1..200).map(part).sum::<f64>();
        let found = history.objective(&around.window(&[], &history).unwrap());
        assert!((found / exact - 1.0).abs() < 4e-3, "{found} and {exact} in {} steps", history.sizes.len());
    }
}

/// A flow in time that becomes steady becomes that of Newton's method, with the same force and heat.
#[test]
fn a_flow_in_time_becomes_the_steady_one() {
    let text = channel(0.04, "").replace("viscosity = 0.006", "viscosity = 0.03") + &shape("disc", &[0.5, 0.18, 0.07]);
    let figures = |text: &str| {
        let mut around = AroundShapes::new(&loaded(text)).unwrap();
        let solution = match around.config().unsteady() {
            Some(_) => around.march(&[], None, &mut |_, _| Ok(())).unwrap().1,
            None => around.solve(&[]).unwrap(),
        };
        let of = |figure: Figure| around.value(&solution, figure);
        let measures = &around.flow.measures;
        [of(Figure::FlowRate), measures.surface_force(&around.flow.at(&solution), 2, 0)]
    };
    let steady = figures(&text);
    let late = figures(&format!("method.flow = \"unsteady\"\ntime.end = 6\nmethod.tolerance = 1e-3\n{text}"));
    for (a, b) in steady.iter().zip(&late) {
        assert!((a / b - 1.0).abs() < 2e-3, "{steady:?} and {late:?}");
    }
}

/// The heat through a square cavity with a hot and a cold wall (de Vahl Davis 1983), and its derivative.
#[test]
fn the_heated_cavity_has_its_nusselt_number() {
    for (rayleigh, nusselt) in [(1e3, 1.1178), (1e4, 2.2448), (1e5, 4.5216)] {
        let sets = [
            format!("fluid.expansion={}", 0.71 * rayleigh),
            format!("fluid.reference_velocity={}", 0.2 * f64::sqrt(rayleigh)),
            "resolution.dx=0.025".to_string(),
        ];
        let config = Config::load(Some("heated-cavity"), None, &sets).unwrap().config;
        let mut around = AroundShapes::new(&config).unwrap();
        let solution = around.solve(&[]).unwrap();
        let found = around.objective(&solution).0;
        assert!((found / nusselt - 1.0).abs() < 4e-3, "{rayleigh}: {found}, not {nusselt}");
    }
    // A warm disc in a closed cold box, by its place and radius.
    let text = "scene = \"custom\"\nregion.size = [1.0, 1.0]\nregion.periodic = [false, false]\nregion.acceleration = [0.0, -1.0]\n\
        fluid.viscosity = 0.7\nfluid.conductivity = 1.0\nfluid.expansion = 3000.0\nfluid.inlet_temperature = 0.0\n\
        fluid.reference_velocity = 10.0\ninitial.temperature = 0.0\nresolution.dx = 0.05\nmethod.name = \"fixed\"\n\
        region.sides.left = { kind = \"wall\", temperature = 0.0 }\nregion.sides.top = { kind = \"wall\", temperature = 0.0 }\n\
        objective.kind = \"shape-heat\"\n[[shapes]]\nkind = \"disc\"\ncentre = [0.45, 0.4]\nradius = 0.15\ntemperature = \"1 + x\"\n";
    let (mut around, solution) = solved(text);
    let numbers = around.flow.cloud.numbers();
    let wanted: Vec<(usize, usize)> = (0..3).map(|k| (0, k)).collect();
    for figure in [Figure::Heat { shape: 0 }, Figure::Force { shape: 0, along: 1 }, Figure::Torque { shape: 0 }] {
        let exact = around.flow.gradient(&solution, &[(figure, 1.0)], &wanted).unwrap().by_numbers;
        let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
        for k in 0..3 {
            let mut at = |by: f64| {
                let mut numbers = numbers.clone();
                numbers[0][k] += by;
                let moved = around.flow.solve(&numbers).unwrap();
                around.flow.value(&moved, figure)
            };
            let mut central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
            let difference = (4.0 * central(1e-5) - central(2e-5)) / 3.0;
            assert!((difference - exact[k]).abs() < 3e-6 * norm, "{figure:?} {k}: {} and {difference}", exact[k]);
        }
    }
}

/// A flow does not know where its period begins: not even where that cuts the shape.
#[test]
fn a_flow_is_the_same_wherever_its_period_begins() {
    let shape = |kind: &str, x: f64| match kind {
        "ellipse" => format!("centre = [{x}, 0.22]\naxes = [0.1, 0.06]\nangle = 25.0\n"),
        "box" => format!("lower = [{}, 0.15]\nupper = [{}, 0.25]\n", x - 0.1, x + 0.1),
        _ => format!("points = [[{}, 0.12], [{}, 0.17], [{x}, 0.3], [{}, 0.3]]\n", x - 0.1, x + 0.1, x - 0.1),
    };
    for kind in ["ellipse", "box", "b-spline"] {
        let figures = |x: f64| {
            let probe = format!("objective.kind = \"pressure\"\nobjective.at = [{}, 0.3]\n", (x + 0.15) % 1.0);
            let text = channel(0.02, &probe)
                + &format!("[[shapes]]\nkind = \"{kind}\"\n{}temperature = 1.0\n", shape(kind, x));
            let (around, solution) = solved(&text.replace("0.006", "0.02"));
            let all = [
                Figure::FlowRate,
                Figure::Force { shape: 2, along: 1 },
                Figure::Torque { shape: 2 },
                Figure::Heat { shape: 2 },
                Figure::Probe { field: 2, probe: 0 },
            ];
            all.map(|figure| around.flow.value(&solution, figure))
        };
        let middle = figures(0.5);
        for x in [0.02, 0.98] {
            for (found, wanted) in figures(x).iter().zip(&middle) {
                assert!((found - wanted).abs() < 1e-9, "{kind} at {x}: {found}, {wanted} in the middle");
            }
        }
    }
}

/// The torque of a shape without a centre of its own is about its centroid, also while it moves: particles that are carried along say
/// the same as those that are placed anew, and the gradient is theirs.
#[test]
fn torques_are_about_where_shapes_are() {
    let polygon = |up: f64| {
        let points = [[0.42, 0.13], [0.58, 0.17], [0.46, 0.26]].map(|[x, y]| format!("[{x}, {}]", y + up)).join(", ");
        channel(0.02, "").replace("0.006", "0.02")
            + &format!("[[shapes]]\nkind = \"polygon\"\npoints = [{points}]\ntemperature = 1.0\n")
    };
    let up = 0.01;
    let mut around = AroundShapes::new(&loaded(&polygon(0.0))).unwrap();
    let first = around.flow.cloud.numbers();
    let mut moved = first.clone();
    (0..3).for_each(|k| moved[2][2 * k + 1] += up);
    let mut values = |numbers: &[Vec<f64>]| {
        let solution = around.flow.solve(numbers).unwrap();
        [Figure::Torque { shape: 2 }, Figure::Force { shape: 2, along: 0 }]
            .map(|figure| around.flow.value(&solution, figure))
    };
    let ([before, drag], [carried, _]) = (values(&first), values(&moved));
    let (anew, solution) = solved(&polygon(up));
    let placed = anew.flow.value(&solution, Figure::Torque { shape: 2 });
    println!("torque {before}, carried {carried}, anew {placed}; drag {drag}");
    // About a centre that stays behind it would be off by the drag times the way.
    assert!((carried - placed).abs() < 0.05 * drag * up, "{carried}, placed anew {placed}");

    let wanted: Vec<(usize, usize)> = (0..6).map(|k| (2, k)).collect();
    let solution = around.flow.solve(&first).unwrap();
    let exact = around.flow.gradient(&solution, &[(Figure::Torque { shape: 2 }, 1.0)], &wanted).unwrap().by_numbers;
    let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
    for k in 0..6 {
        let mut at = |by: f64| {
            let mut numbers = first.clone();
            numbers[2][k] += by;
            let solution = around.flow.solve(&numbers).unwrap();
            around.flow.value(&solution, Figure::Torque { shape: 2 })
        };
        let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
        assert!((difference - exact[k]).abs() < 1e-6 * norm, "{k}: {} and {difference}", exact[k]);
    }
}

/// What flows out at corners, where a sum over the surface misses some of it, is in the heat of a shape with corners, and in that of no other
/// one; also where the surroundings are coarse.
#[test]
fn the_heat_at_corners_belongs_to_shapes_that_have_them() {
    let heat = |resolution: &str| {
        let shapes =
            "[[shapes]]\nkind = \"polygon\"\npoints = [[0.22, 0.13], [0.38, 0.17], [0.26, 0.26]]\ntemperature = 1.0\n\
            [[shapes]]\nkind = \"disc\"\ncentre = [0.72, 0.2]\nradius = 0.07\ntemperature = 1.0\n";
        let text = channel(0.02, resolution).replace("0.006", "0.02") + shapes;
        let (around, solution) = solved(&text);
        let at = around.flow.at(&solution);
        [2, 3].map(|shape| {
            (around.flow.value(&solution, Figure::Heat { shape }), around.flow.measures.surface_heat(&at, shape))
        })
    };
    let [fine, coarse] = ["resolution.surface = 0.0025\n", "resolution.far = 3.0\n"].map(heat);
    println!("{fine:?}, coarser {coarse:?}");
    let off = |k: usize| (coarse[k].0 / fine[k].0 - 1.0).abs();
    assert!(off(0) < 0.005 && off(1) < 0.01 && coarse[0].1 / fine[0].0 < 0.99);
}

/// A line around a body tells what linear and quadratic fields push and carry through it: by Gauss's theorem these are moments of the area
/// within. A fluid that is sped up with all that is in it pushes nothing.
#[test]
fn what_goes_through_a_line_around_a_body_is_that_of_exact_fields() {
    let bodies = shape("disc", &[0.35, 0.22, 0.08]) + &shape("ellipse", &[0.72, 0.18, 0.09, 0.05, 30.0]);
    let (around, solution) = solved(&(channel(0.02, "") + &bodies));
    let mut equations = around.flow.solver.equations.clone();
    equations.force = [0.0; 2];
    let (shaped, n) = (around.flow.at(&solution).shaped, equations.particles());
    let (a, b) = (0.7, -0.4);
    let mut state = State::at_rest(n);
    let mut d = Derivatives::zeros(n);
    for i in 0..n {
        let [x, y] = [0, 1].map(|e| shaped.position[e][i]);
        (state.fields[0][i], state.fields[1][i], state.fields[3][i]) = (a * y, b * x, x);
        (d.0[0][i][1], d.0[1][i][0], d.0[3][i][0]) = (a, b, 1.0);
        // The pressure of this flow, and one that speeds it up.
        state.fields[2][i] = 1.0 - 0.5 * a * b * (x * x + y * y) + 2.0 * x - 3.0 * y;
        d.0[2][i] = [2.0 - a * b * x, -3.0 - a * b * y, -a * b, 0.0, -a * b, 0.0];
    }
    let at = At { equations: &equations, shaped, state: &state, d: &d, defect: None };
    for (k, area) in [(2, PI * 0.0064), (3, PI * 0.0045)] {
        let points: Vec<usize> = (0..shaped.area.len())
            .filter(|&j| around.flow.cloud.places.boundary[j].on.is_some_and(|(on, _)| on == k))
            .collect();
        let line = |balanced: Balanced| Contour::around(&around.flow.cloud, k, points.clone(), balanced).unwrap();
        let centre = shaped.centre[k];
        let steady = line(Balanced::Steady).force(&at, [0.0; 2], centre);
        // -(2, -3) times the area within the line; what it holds beside the body is what a body force of 1 pushes with.
        let held = line(Balanced::Steady).force(&at, [1.0, 0.0], centre)[0] - steady[0];
        println!("{k}: {steady:?}, {held} of fluid, {area} of body");
        assert!((steady[0] + 2.0 * (held + area)).abs() < 2e-4 && (steady[1] - 3.0 * (held + area)).abs() < 2e-4);
        assert!(held > 2.0 * area && (steady[0] * 1.5 + steady[1]).abs() < 1e-12);
        let speeding = line(Balanced::InTime).force(&at, [0.0; 2], centre);
        assert!(speeding[0].abs() < 1e-12 && speeding[1].abs() < 1e-12, "{speeding:?}");
        // int u . grad T = a int y; what is conducted in at one side goes out at the other.
        let heat = line(Balanced::Steady).heat(&at);
        let middle = heat / (a * (held + area));
        println!("heat {heat}, y of the middle {middle}");
        assert!((middle - centre[1]).abs() < 0.03);
    }
}

/// Each of two bodies in a row has its own drag and lift, beside finite elements (`scripts/bodies_fem.py`, Taylor-Hood of second order),
/// although the hind one stands near the outflow.
#[test]
fn each_body_has_its_own_force() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.0125\ninitial.temperature = 0.0\n\
        fluid.viscosity = 0.0053\nfluid.conductivity = 0.01457\nfluid.inlet_temperature = 0.0\n\
        region.size = [1.0, 0.6]\nregion.acceleration = [0.0, 0.0]\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"0.43*4*y*(0.6 - y)/0.6^2\", 0], temperature = \"0\" }\n\
        region.sides.right = { kind = \"outflow\" }\n\
        [[shapes]]\nkind = \"spline\"\ncentre = [0.396, 0.312]\ntemperature = 1.792\n\
        radii = [0.05, 0.064, 0.056, 0.069, 0.064, 0.065, 0.056]\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.715, 0.326]\ntemperature = 0.772\nradius = 0.079\n";
    let (around, solution) = solved(text);
    for (shape, [drag, lift]) in [(0, [0.04530053, -0.00138089]), (1, [0.05039117, -0.00542453])] {
        let found = [0, 1].map(|along| around.flow.value(&solution, Figure::Force { shape, along }));
        println!("{shape}: {found:?} beside {drag} {lift}");
        assert!((found[0] - drag).abs() < 3e-3 * drag && (found[1] - lift).abs() < 2e-3 * drag, "{shape}: {found:?}");
    }
}

/// The force on a body while the flow starts, told by a line around it, is that of its surface; the surface's is the one that approaches it
/// as the spacing becomes finer.
#[test]
fn the_force_while_a_flow_starts_is_that_of_the_surface() {
    let off = |dx: f64| {
        let text = channel(dx, "method.flow = \"unsteady\"\ntime.end = 0.3\n")
            .replace("viscosity = 0.006", "viscosity = 0.03")
            + &shape("disc", &[0.5, 0.18, 0.07]);
        let around = AroundShapes::new(&loaded(&text)).unwrap();
        let solution = around.march(&[], None, &mut |_, _| Ok(())).unwrap().1;
        let force = around.value(&solution, Figure::Force { shape: 2, along: 0 });
        let own = around.flow.measures.surface_force(&around.flow.at(&solution), 2, 0);
        println!("{dx}: {force}, by its surface {own}");
        (own / force - 1.0).abs()
    };
    let (coarse, fine) = (off(0.04), off(0.02));
    assert!(coarse < 0.04 && fine < 0.6 * coarse, "{coarse} and {fine}");
}

/// What a disc gives to a fluid at rest around it is exact while it warms the first spacings (Carslaw and Jaeger 1959, 13.5: 4 alpha / pi^2 times
/// the integral of exp(-alpha t u^2 / R^2) / (u (J0^2 + Y0^2)), by scipy), with and without sound.
#[test]
fn the_heat_of_a_disc_that_warms_its_fluid_is_exact() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\nresolution.dx = 0.04\ntime.end = 0.4\n\
        region.size = [2.0, 2.0]\nregion.periodic = [false, false]\nregion.acceleration = [0.0, 0.0]\nfluid.viscosity = 0.01\n\
        fluid.conductivity = 0.01\ninitial.temperature = 0.0\nfluid.inlet_temperature = 0.0\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [1.0, 1.0]\nradius = 0.2\ntemperature = 1.0\n";
    for pressure in ["incompressible", "weakly-compressible"] {
        let around = AroundShapes::new(&loaded(&format!("method.pressure = \"{pressure}\"\n{text}"))).unwrap();
        let (history, _) = around.march(&[], None, &mut |_, _| Ok(())).unwrap();
        let k = history.figures.iter().position(|(name, _)| name == "shapes[0].heat").unwrap();
        for (time, exact) in [(0.2, 0.188124), (0.4, 0.141136)] {
            let moments = history.moments.windows(2).find(|two| two[1].time >= time - 1e-9).unwrap();
            let s = (time - moments[0].time) / (moments[1].time - moments[0].time);
            let found = moments[0].values[k] + s * (moments[1].values[k] - moments[0].values[k]);
            println!("{pressure}, {time}: {found} beside {exact}");
            assert!((found / exact - 1.0).abs() < 8e-3, "{pressure}, {time}: {found} beside {exact}");
        }
    }
}

/// The heat and the drag of a hot box in a flow in time, with and without sound, are those of the steady flow that it becomes, but for a drag that
/// is 2.7 % less with sound (four spacings). By its surface its heat is 10 % less in all of them.
#[test]
fn the_heat_of_a_box_in_time_becomes_that_of_the_steady_flow() {
    let text = |more: &str| {
        format!(
            "{more}scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.05\ninitial.temperature = 0.0\nfluid.viscosity = 0.05\n\
             fluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\nregion.size = [1.6, 0.8]\nregion.periodic = [false, false]\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [\"6*y*(0.8 - y)\", 0], temperature = 0 }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\n\
             [[shapes]]\nkind = \"box\"\nlower = [0.5, 0.3]\nupper = [0.7, 0.5]\ntemperature = 1.0\n"
        )
    };
    let figures = [Figure::Heat { shape: 0 }, Figure::Force { shape: 0, along: 0 }];
    let (steady, solution) = solved(&text(""));
    let known = figures.map(|figure| steady.value(&solution, figure));
    for pressure in ["incompressible", "weakly-compressible"] {
        let in_time = format!("method.flow = \"unsteady\"\nmethod.pressure = \"{pressure}\"\ntime.end = 3\n");
        let around = AroundShapes::new(&loaded(&text(&in_time))).unwrap();
        let solution = around.march(&[], None, &mut |_, _| Ok(())).unwrap().1;
        let found = figures.map(|figure| around.value(&solution, figure));
        let own = around.flow.measures.surface_heat(&around.flow.at(&solution), 0);
        println!("{pressure}: {found:?} beside {known:?}, by its surface {own}");
        assert!(
            (found[0] / known[0] - 1.0).abs() < 3e-3 && (found[1] / known[1] - 1.0).abs() < 0.03,
            "{pressure}: {found:?}"
        );
        assert!(own < 0.94 * known[0], "{own}");
    }
}

/// The force on a hot box with buoyancy, told by a line around it, hardly changes with the spacing; by its surface it is 4 and 2 % less.
#[test]
fn a_line_tells_the_force_with_buoyancy_too() {
    let lift = |dx: f64| {
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = {dx}\nregion.size = [1.0, 1.0]\nregion.periodic = [false, false]\n\
             region.acceleration = [0.0, -1.0]\nfluid.viscosity = 0.01\nfluid.conductivity = 0.01\nfluid.expansion = 1.0\n\
             fluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
             region.sides.left = {{ kind = \"wall\", temperature = 0 }}\nregion.sides.right = {{ kind = \"wall\", temperature = 0 }}\n\
             [[shapes]]\nkind = \"box\"\nlower = [0.35, 0.25]\nupper = [0.6, 0.5]\ntemperature = 1.0\n"
        );
        let (around, solution) = solved(&text);
        let own = around.flow.measures.surface_force(&around.flow.at(&solution), 0, 1);
        let found = around.value(&solution, Figure::Force { shape: 0, along: 1 });
        println!("{dx}: {found}, by its surface {own}");
        (found, own / found)
    };
    let ((coarse, by_surface), (fine, _)) = (lift(0.04), lift(0.02));
    assert!((coarse / fine - 1.0).abs() < 2e-3 && by_surface < 0.97, "{coarse} {fine} {by_surface}");
}

/// A polygon has its centroid, whatever its corners' number.
#[test]
fn centres_of_shapes_are_centroids() {
    let corners = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.5, 1.0], [0.0, 1.0]];
    let [x, y] = centroid_within(5, |k| corners[k]);
    assert!((x - 1.5).abs() < 1e-14 && (y - 0.5).abs() < 1e-14);
    // An L of two squares and one.
    let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
    let [x, y] = centroid_within(6, |k| corners[k]);
    assert!((x - 5.0 / 6.0).abs() < 1e-14 && (y - 5.0 / 6.0).abs() < 1e-14);
}

/// Where a surface meets a side of the box, whatever their angle, particles stay in the fluid, and the side's points are as close to
/// each other as the surface's.
#[test]
fn particles_stay_in_the_box_where_surfaces_meet_its_sides() {
    for (height, shape) in [
        (0.0, "kind = \"disc\"\ncentre = [0.8, 0.0]\nradius = 0.25\n"),
        (0.0, "kind = \"disc\"\ncentre = [0.8, 0.12]\nradius = 0.25\n"),
        (0.0, "kind = \"disc\"\ncentre = [0.8, -0.12]\nradius = 0.25\n"),
        (0.0, "kind = \"polygon\"\npoints = [[0.5, -0.2], [1.0, -0.2], [1.0, 0.3], [0.5, 0.3]]\n"),
        (1.0, "kind = \"disc\"\ncentre = [0.8, 1.0]\nradius = 0.25\n"),
    ] {
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nregion.size = [1.6, 1.0]\nregion.periodic = [true, false]\n\
             region.acceleration = [1.0, 0.0]\nfluid.viscosity = 0.05\nresolution.dx = 0.05\nobjective.kind = \"drag\"\n\
             [[shapes]]\n{shape}"
        );
        let around = AroundShapes::new(&loaded(&text)).unwrap();
        let places = &around.flow.cloud.places;
        let depth = |p: &[f64; 2]| p[1].min(1.0 - p[1]);
        let least = places.place[..places.inside].iter().map(depth).fold(f64::MAX, f64::min);
        assert!(least > 0.4 * 0.05 / 3.0, "{shape}: a particle is {least} from a side");
        // The gap between the surface's last point and the side's next one, on either side of the shape.
        let on_shape = |k: &usize| places.boundary[*k].on.is_some();
        let points = || 0..places.boundary.len();
        let place = |k: usize| places.place[places.boundary[k].particle];
        let ends = |k: &usize| on_shape(k) && depth(&place(*k)) < 0.02;
        for k in points().filter(ends) {
            let (at, gap) = (place(k), |j: usize| (place(j)[0] - place(k)[0]).hypot(place(j)[1] - place(k)[1]));
            let next = points().filter(|j| !on_shape(j)).map(gap).fold(f64::MAX, f64::min);
            assert!((at[1] - height).abs() < 0.02 && next < 0.03, "{shape}: {next} from {at:?} to the side");
        }
        assert!(points().filter(ends).count() >= 2, "{shape}: the surface meets the side");
    }
}

/// Asserts that an objective's derivatives by some of the variables are those of differences but for a share of the gradient's length.
fn assert_derivatives(config: &Config, wanted: &[usize], tolerance: f64) {
    let mut around = AroundShapes::new(config).unwrap();
    let first = around.first();
    let solution = around.solve(&first).unwrap();
    let (value, terms) = around.objective(&solution);
    let gradient = around.gradient(&solution, &terms).unwrap().by_variables;
    let norm = gradient.iter().map(|x| x * x).sum::<f64>().sqrt();
    for &k in wanted {
        let mut at = |by: f64| {
            let mut moved = first.clone();
            moved[k] += by;
            let solution = around.solve(&moved).unwrap();
            around.objective(&solution).0
        };
        let mut central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
        let difference = (4.0 * central(5e-4) - central(1e-3)) / 3.0;
        let of = &config.objective.kind;
        println!("{of:?} = {value} by {}: {} and {difference}", config.variables[k].number, gradient[k]);
        assert!((difference - gradient[k]).abs() < tolerance * norm, "{of:?}, {k}");
    }
}

/// A floor that meets the sides of the box may be shaped by the numbers that leave its ends in place, with the exact derivative.
#[test]
fn a_floor_may_be_shaped_between_its_ends() {
    let sets = ["resolution.dx=0.05".to_string()];
    let config = Config::load(Some("shaped-floor"), None, &sets).unwrap().config;
    assert_derivatives(&config, &[0, 2], 1e-7);
    // A point near a side takes the end along, which slides on the side.
    let mut sliding = config.clone();
    sliding.variables[0].number = "shapes[0].points[6][1]".into();
    assert_derivatives(&sliding, &[0], 1e-7);
}

#[test]
fn probes_read_an_exact_flow() {
    // Between plates at 0 and 0.4: u = y (0.4 - y) / (2 nu), p = 0, T = x / 1 is what the walls have.
    let text = "scene = \"custom\"\nregion.size = [1.0, 0.4]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
         fluid.viscosity = 0.2\nfluid.conductivity = 0.2\nfluid.inlet_temperature = 2.0\ninitial.temperature = 2.0\nresolution.dx = 0.05\n\
         method.name = \"fixed\"\nobjective.terms = [{ kind = \"velocity-x\", at = [0.33, 0.111] }, \
         { kind = \"velocity-x\", at = [0.8, 0.0], weight = 3.0 }, { kind = \"temperature\", at = [0.1, 0.2] }, \
         { kind = \"pressure\", at = [0.1, 0.2] }, { kind = \"velocity-y\", at = [0.1, 0.2] }]\n\
         [region.sides]\nbottom = { kind = \"wall\", temperature = 1.0 }\ntop = { kind = \"wall\", temperature = 4.0 }\n";
    let mut around = AroundShapes::new(&loaded(text)).unwrap();
    let solution = around.solve(&[]).unwrap();
    let expected = 0.111 * (0.4 - 0.111) / 0.4 + 2.5;
    let (found, terms) = around.objective(&solution);
    assert!((found - expected).abs() < 1e-8, "{found} and {expected}");
    assert_eq!(terms.len(), 5);
    assert!(around.summary(&solution).contains(&("objective_kind", "terms".into())));
}

/// A search for what is held says that no variable changes it.
#[test]
fn an_objective_that_nothing_changes_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let text = channel(0.04, "fluid.drive = \"flow-rate\"\nfluid.flow_rate = 0.2\nobjective.kind = \"flow-rate\"")
        + &shape("disc", &[0.5, 0.2, 0.06])
        + "[[variables]]\nnumber = \"shapes[2].radius\"\nlower = 0.04\nupper = 0.08\n";
    let codes = |text: &str| -> Vec<String> {
        std::fs::write(folder.path().join("scene.toml"), text).unwrap();
        let arguments = ["optimize", "scene.toml", "--no-verify", "--epochs", "2", "--out", "run", "--overwrite"];
        let done = hydrograd(folder.path(), &arguments);
        assert!(done.status.success(), "{done:?}");
        let summary = std::fs::read_to_string(folder.path().join("run/summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        let warnings = summary["warnings"].as_array().unwrap();
        warnings.iter().map(|warning| warning["code"].as_str().unwrap().to_string()).collect()
    };
    let is_told = |codes: &[String]| codes.contains(&"no-gradient".to_string());
    assert!(is_told(&codes(&text)));
    assert!(!is_told(&codes(&text.replace("objective.kind = \"flow-rate\"", "objective.kind = \"drag\""))));
}

#[test]
fn what_fixed_particles_cannot_do_is_refused_by_name() {
    let refuses = |text: &str, words: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), text).unwrap();
        let arguments = ["simulate", "scene.toml", "--out", "run"];
        refused(&arguments, &hydrograd(folder.path(), &arguments), words);
        assert!(!folder.path().join("run").exists(), "half-written output");
    };
    let base = channel(0.03, "");
    refuses(
        &(base.clone() + "[[shapes]]\nkind = \"where\"\npositive = \"0.01 - x^2\"\n"),
        &["shapes[2].kind", "where"],
    );
    refuses(
        &(base.clone() + "[[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.2]\nradius = 0.1\nfill = \"fluid\"\n"),
        &["fill"],
    );
    refuses(
        &(base.clone() + "[[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.2]\nradius = 0.002\n"),
        &["shapes[2]", "thin", "resolution.dx="],
    );
    refuses(&(base.clone() + &shape("disc", &[0.5, 0.9, 0.05])), &["shapes[2]", "outside of the box"]);
    let near = shape("disc", &[0.4, 0.2, 0.08]) + &shape("disc", &[0.565, 0.2, 0.08]);
    refuses(&(base.clone() + &near), &["shapes[2]", "near", "resolution.dx="]);
    let probe = |key: &str| channel(0.03, key) + &shape("disc", &[0.5, 0.2, 0.08]);
    refuses(&probe("objective.terms = [{ kind = \"pressure\" }]"), &["objective.terms[0]", "at = [x, y]"]);
    refuses(
        &probe("method.flow = \"unsteady\"\nfluid.drive = \"pumping-power\"\nfluid.pumping_power = 1.0"),
        &["fluid.drive", "flow=steady"],
    );
    let turning = base.clone() + "[[shapes]]\nkind = \"disc\"\ncentre = [0.5, 0.2]\nradius = 0.1\n";
    refuses(&(turning.clone() + "velocity = [\"t*y\", 0]\n"), &["shapes[2].velocity[0]", "`t` is unknown"]);
    refuses(&(turning + "velocity = [\"p1*y\", 0]\nparameters = [1.0]\n"), &["shapes[2].velocity", "p1", "parameters"]);
    refuses(&probe("objective.terms = [{ kind = \"drag\", at = [0.1, 0.1] }]"), &["objective.terms[0]", "only probes"]);
    refuses(
        &probe("objective.terms = [{ kind = \"pressure\", at = [1.1, 0.1] }]"),
        &["outside of the box", "0 ... 0.4"],
    );
    refuses(&probe("objective.terms = [{ kind = \"pressure\", at = [0.5, 0.2] }]"), &["not in the fluid"]);
    refuses(&channel(0.03, "region.inlet_until = 0.1"), &["region.inlet_until", "region.sides"]);
    // What nothing determines.
    let at_rest = base.replace("region.acceleration = [1.0, 0.0]\n", "region.acceleration = [0.0, 0.0]\n");
    let without_heat = |text: &str| {
        let text = text.replace("initial.temperature = 0.0\n", "");
        text.replace("temperature = 0.0\n[[", "[[").trim_end_matches("temperature = 0.0\n").to_string()
    };
    refuses(&without_heat(&at_rest), &["region.acceleration", "nothing moves this fluid", "fluid.drive"]);
    let heated = base.replace("]\ntemperature = 0.0\n", "]\nheat_flux = 0.1\n");
    refuses(&heated, &["initial.temperature", "given nowhere", "method.flow=unsteady"]);
    // A wall along the period, with a part of the fluid on each side.
    let plate = |lower: f64, upper: f64| {
        format!("[[shapes]]\nkind = \"box\"\nlower = [{lower:?}, 0.18]\nupper = [{upper:?}, 0.22]\n")
    };
    refuses(
        &(base.clone() + &plate(-1.0, 2.0)),
        &["shapes", "cut off", "nothing gives the pressure", "an outflow in each"],
    );
    refuses(&(base.clone() + &plate(0.0, 1.0)), &["shapes[2]", "as long as the period", "longer"]);
    refuses(
        &(channel(0.03, "region.sides.left = { kind = \"inflow\", velocity = [1, 0], temperature = 0 }")),
        &["region.sides.left.kind", "periodic"],
    );
    refuses(
        &channel(0.02, "").replace("\"fixed\"", "\"consistent\"\nresolution.surface = 0.01"),
        &["resolution.surface", "method.name=fixed"],
    );
}

/// A plate divides a box with an outflow. Below it there is only a heat flux, so any temperature could be added; factors of such a matrix are
/// made of rounding.
#[test]
fn a_part_without_a_temperature_is_told() {
    let text = "scene = \"custom\"\nregion.size = [1.0, 0.4]\nregion.periodic = [false, false]\nregion.acceleration = [0.0, 0.0]\n\
        fluid.viscosity = 0.02\nfluid.conductivity = 0.02\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\n\
        region.sides.right = { kind = \"outflow\" }\nregion.sides.top = { kind = \"wall\", temperature = 0.0 }\n\
        region.sides.bottom = { kind = \"wall\", heat_flux = 0.1 }\nresolution.dx = 0.04\nmethod.name = \"fixed\"\n\
        [[shapes]]\nkind = \"box\"\nlower = [-1.0, 0.18]\nupper = [2.0, 0.22]\n";
    let error = AroundShapes::new(&loaded(text)).unwrap().solve(&[]).err().unwrap().to_string();
    assert!(error.contains("is a temperature given in each part"), "{error}");
}

/// Where points of a coarser lattice were chosen before walls took some of them away, there were gaps along the sides, and at these places
/// of the disc no steady flow.
#[test]
fn a_slow_flow_among_coarser_particles_is_found_wherever_a_disc_is() {
    for x in [0.302, 0.36, 0.396, 0.404, 0.406, 0.408] {
        let [fine, coarse] = [1.0, 2.0].map(|far| {
            let text = format!(
                "scene = \"custom\"\nregion.size = [1.0, 1.0]\nregion.periodic = [false, false]\nfluid.viscosity = 0.05\n\
                 region.sides.left = {{ kind = \"inflow\", velocity = [0.5, 0] }}\nregion.sides.right = {{ kind = \"outflow\" }}\n\
                 region.sides.bottom = {{ kind = \"symmetry\" }}\nresolution.dx = 0.05\nresolution.far = {far:?}\n\
                 method.name = \"fixed\"\n[[shapes]]\nkind = \"disc\"\ncentre = [{x}, 0.536]\nradius = 0.083\n"
            );
            let mut around = AroundShapes::new(&loaded(&text)).unwrap();
            let solution = around.solve(&[]).unwrap();
            around.value(&solution, Figure::Force { shape: 0, along: 0 })
        });
        println!("{x}: {fine} {coarse}");
        assert!((coarse / fine - 1.0).abs() < 0.015, "drags {fine} and {coarse} with the disc at {x}");
    }
}

/// Particles saw each other through a thin wall that stands on a side: with a fin of a sixth of a spacing its drag was 0.121, with a quarter
/// 0.169. With dx = 0.005 it is what stands here.
#[test]
fn nothing_is_seen_through_a_thin_fin_on_a_side() {
    for (thickness, fine) in [(0.007, 0.21975), (0.01, 0.21978), (0.03, 0.22007)] {
        let text = format!(
            "scene = \"custom\"\nregion.size = [1.0, 0.4]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
             fluid.viscosity = 0.02\nresolution.dx = 0.04\nmethod.name = \"fixed\"\n\
             [[shapes]]\nkind = \"box\"\nlower = [0.48, -0.2]\nupper = [{}, 0.2]\n",
            0.48 + thickness
        );
        let mut around = AroundShapes::new(&loaded(&text)).unwrap();
        let solution = around.solve(&[]).unwrap();
        let drag = around.value(&solution, Figure::Force { shape: 0, along: 0 });
        println!("{thickness}: {drag}");
        assert!((drag / fine - 1.0).abs() < 0.005, "{thickness}: {drag}, and finer {fine}");
    }
}

/// A plate from the inflow to the outflow has a channel on each side of it, with half the flow of a plane one. It was seen through: its drag
/// was half as large.
#[test]
fn a_plate_that_divides_a_channel_has_the_drag_of_two() {
    let (depth, velocity, viscosity) = (0.18, 0.5, 0.006);
    let text = format!(
        "scene = \"custom\"\nregion.size = [1.0, 0.4]\nregion.periodic = [false, false]\nfluid.viscosity = {viscosity}\n\
         region.sides.left = {{ kind = \"inflow\", velocity = [\"{velocity}*max(6*max((0.18 - y)*y, (0.4 - y)*(y - 0.22))/0.0324, 0)\", 0] }}\n\
         region.sides.right = {{ kind = \"outflow\" }}\nresolution.dx = 0.02\nmethod.name = \"fixed\"\n\
         [[shapes]]\nkind = \"box\"\nlower = [-1.0, 0.18]\nupper = [2.0, 0.22]\n"
    );
    let mut around = AroundShapes::new(&loaded(&text)).unwrap();
    let solution = around.solve(&[]).unwrap();
    let drag = around.value(&solution, Figure::Force { shape: 0, along: 0 });
    // The stress on a wall of plane Poiseuille flow is 6 mu U / H, on both sides of a length of 1.
    let known = 2.0 * 6.0 * viscosity * velocity / depth;
    assert!((drag / known - 1.0).abs() < 0.02, "{drag}, known {known}");
}

/// The heat and the drag of a fin on a side of a channel, by lines that end on the side, beside finite elements (`scripts/fins_fem.py` with this
/// scene, 30 points and 0.03); by its surface they are 11 and 3 % less, since flux and pressure
/// are singular at its corners.
#[test]
fn a_line_from_side_to_side_tells_the_figures_of_a_fin() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.04\ninitial.temperature = 0.0\n\
        fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\n\
        region.size = [2.0, 1.0]\nregion.periodic = [false, false]\n\
        region.sides.left = { kind = \"inflow\", velocity = [\"4*y*(1 - y)\", 0], temperature = 0 }\n\
        region.sides.right = { kind = \"outflow\" }\n\
        [[shapes]]\nkind = \"box\"\nlower = [0.65, -0.3]\nupper = [0.8, 0.4]\ntemperature = 1.0\n";
    let (around, solution) = solved(text);
    let value = |figure: Figure| around.value(&solution, figure);
    let (heat, drag) = (value(Figure::Heat { shape: 0 }), value(Figure::Force { shape: 0, along: 0 }));
    let at = around.flow.at(&solution);
    let (own_heat, own_drag) =
        (around.flow.measures.surface_heat(&at, 0), around.flow.measures.surface_force(&at, 0, 0));
    println!("heat {heat} ({own_heat} by its surface), drag {drag} ({own_drag})");
    assert!((heat / 0.18019 - 1.0).abs() < 0.006 && (drag / 1.18725 - 1.0).abs() < 0.005, "{heat} {drag}");
    assert!(own_heat < 0.92 * heat && own_drag < 0.98 * drag);
}

/// The floor beside a fin that leans is none of it, although the fin is below it. With the point of the floor next to this fin as a part
/// of it, which had two fifths of a spacing of floor, its lift was 9 % off with one of the spacings. Finite elements of
/// `scripts/fins_fem.py`: drag 0.4318, lift -0.11125.
#[test]
fn the_floor_beside_a_fin_that_leans_is_not_its_own() {
    for dx in [0.02, 0.01562, 0.0125] {
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = {dx}\nfluid.viscosity = 0.05\n\
             region.size = [3.0, 0.5]\nregion.periodic = [false, false]\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [\"10.9168*y*(0.5 - y)\", 0] }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\n\
             [[shapes]]\nkind = \"polyline\"\npoints = [[1.3185, -0.1], [1.3695, 0.1486]]\nthickness = 0.0486\n"
        );
        let (around, solution) = solved(&text);
        let places = &around.flow.cloud.places;
        let sides = || places.boundary.iter().filter(|point| point.side.is_some());
        let behind = |point: &BoundaryPoint| {
            behind(&around.flow.cloud.ground.plane, dx, &places.polygons, places.place[point.particle], point.normal)
        };
        assert!(sides().all(|point| behind(point).is_none()), "{dx}");
        let lift = around.value(&solution, Figure::Force { shape: 0, along: 1 });
        let drag = around.value(&solution, Figure::Force { shape: 0, along: 0 });
        println!("{dx}: drag {drag}, lift {lift}");
        assert!((lift / -0.11125 - 1.0).abs() < 0.003 && (drag / 0.4318 - 1.0).abs() < 0.006, "{dx}: {drag}, {lift}");
    }
}

/// What ends at a side, or a little below it, is behind it; what leans there is where it is at the side.
#[test]
fn what_is_behind_a_side_is_known() {
    let plane = Plane { size: [2.0, 1.0], periodic: [false, false] };
    let polygon = |points: &[[f64; 2]]| {
        let on = |k: usize| {
            let (a, b) = (points[k], points[(k + 1) % points.len()]);
            OnOutline { place: a, along: [b[0] - a[0], b[1] - a[1]] }
        };
        Polygon::of(&(0..points.len()).map(on).collect::<Vec<_>>())
    };
    let plate = |top: f64| polygon(&[[0.2, -0.5], [1.8, -0.5], [1.8, top], [0.2, top]]);
    let fin = polygon(&[[0.9, -0.5], [1.0, -0.5], [1.3, 0.5], [1.2, 0.5]]);
    let of = |shapes: &[Polygon], x: f64| behind(&plane, 0.1, shapes, [x, 0.0], [0.0, 1.0]);
    for top in [0.0, -0.02] {
        let shapes = [plate(top)];
        assert_eq!([0.1, 0.3, 1.7, 1.9].map(|x| of(&shapes, x)), [None, Some(0), Some(0), None], "{top}");
    }
    assert_eq!(of(&[plate(-0.03)], 1.0), None);
    // The fin is between 1.05 and 1.15 at the floor, and between 1.0425 and 1.1425 a quarter of a spacing below it.
    let both = [plate(0.0), fin];
    assert_eq!([1.03, 1.045, 1.1, 1.16].map(|x| of(&both, x)), [Some(0), Some(0), Some(1), Some(0)]);
    assert_eq!([1.03, 1.045, 1.1, 1.16].map(|x| of(&both[1..], x)), [None, None, Some(0), None]);
}

/// A fin across the end of a period is the same fin elsewhere. Of such a fin the part beyond the end was left out.
#[test]
fn a_fin_may_stand_across_the_end_of_a_period() {
    let drag = |from: f64| {
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.04\nfluid.viscosity = 0.05\n\
             region.size = [1.0, 0.8]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
             [[shapes]]\nkind = \"box\"\nlower = [{from}, -0.3]\nupper = [{}, 0.4]\n",
            from + 0.15
        );
        let (around, solution) = solved(&text);
        around.value(&solution, Figure::Force { shape: 0, along: 0 })
    };
    let (inside, before, after) = (drag(0.4), drag(-0.08), drag(0.92));
    println!("{inside}, across the ends {before} and {after}");
    assert!((before / inside - 1.0).abs() < 1e-3 && (after / inside - 1.0).abs() < 1e-3);
}

/// Points of a side stand for all of it that is in the fluid, up to a fin.
#[test]
fn a_side_ends_where_a_fin_begins() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.04\nfluid.viscosity = 0.05\n\
        region.size = [1.0, 0.8]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
        [[shapes]]\nkind = \"box\"\nlower = [0.413, 0.5]\nupper = [0.545, 1.2]\n";
    let around = AroundShapes::new(&loaded(text)).unwrap();
    let top = around.flow.cloud.places.boundary.iter().filter(|point| point.side == Some(3));
    let length: f64 = top.map(|point| point.weight).sum();
    assert!((length - (1.0 - 0.132)).abs() < 1e-9, "{length}");
}

/// The figures of a fin change with a disc beside it as differences say: what goes through the line around it, and what its side has within.
#[test]
fn the_derivative_of_what_a_line_to_a_side_tells_is_that_of_differences() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.05\ninitial.temperature = 0.0\n\
        fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\n\
        region.size = [1.0, 0.8]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.3]\n\
        region.sides.top = { kind = \"wall\", temperature = 0.0 }\nobjective.shapes = [0]\n\
        [[shapes]]\nkind = \"polygon\"\npoints = [[0.2, -0.3], [0.3, -0.3], [0.36, 0.4], [0.3, 0.4]]\ntemperature = 1.0\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.7, 0.45]\nradius = 0.1\ntemperature = 0.7\n\
        [[variables]]\nnumber = \"shapes[1].centre[0]\"\nlower = 0.65\nupper = 0.75\n\
        [[variables]]\nnumber = \"shapes[1].radius\"\nlower = 0.08\nupper = 0.12\n";
    for kind in ["drag", "torque", "shape-heat"] {
        let config =
            loaded(&text.replace("objective.shapes", &format!("objective.kind = \"{kind}\"\nobjective.shapes")));
        assert_derivatives(&config, &[0, 1], 1e-7);
    }
}

/// Between walls of two temperatures that meet, heat passes without limit as the spacing becomes finer; where they agree nothing is warned of.
#[test]
fn a_step_of_the_temperature_where_walls_meet_is_told() {
    let steps = |bottom: &str| {
        let fin = "kind = \"box\"\nlower = [0.7, -0.3]\nupper = [0.85, 0.4]";
        let mut config = beside_an_inflow(fin, &[], "drag");
        config.region.sides = loaded(&format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\ninitial.temperature = 0.0\nregion.size = [2.0, 1.0]\n\
             region.periodic = [false, false]\nregion.sides.left = {{ kind = \"inflow\", velocity = [1, 0], temperature = 0 }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\nregion.sides.bottom = {{ kind = \"wall\"{bottom} }}\n"
        ))
        .region
        .sides;
        let around = AroundShapes::new(&config).unwrap();
        let cloud = &around.flow.cloud;
        cloud.temperature_steps(&cloud.shaped(&cloud.numbers()).unwrap().conditions)
    };
    let [cold, warm] = [", temperature = 0", ", temperature = 1"].map(steps);
    assert!(cold.len() == 1 && (cold[0].1 - 1.0).abs() < 1e-9, "{cold:?}");
    assert_eq!(warm, vec![(0, 0.0)]);
    assert_eq!(steps(""), vec![]);
}

/// How far fins are from each other is told, from where they are in the fluid: a gap of three spacings is a warning, and the floor is none.
#[test]
fn a_narrow_gap_between_fins_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let warnings = |gap: f64| {
        let from = 0.5 + gap;
        let text = format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.04\nfluid.viscosity = 0.05\n\
             region.size = [1.2, 0.6]\nregion.periodic = [true, false]\nregion.acceleration = [1.0, 0.0]\n\
             [[shapes]]\nkind = \"polygon\"\npoints = [[0.3, -0.5], [0.6, -0.5], [0.5, 0.0], [0.5, 0.3], [0.4, 0.3]]\n\
             [[shapes]]\nkind = \"box\"\nlower = [{from}, -0.3]\nupper = [{}, 0.25]\n",
            from + 0.1
        );
        let file = folder.path().join("fins.toml");
        std::fs::write(&file, text).unwrap();
        let out = folder.path().join(format!("{gap}"));
        let mut command = assert_cmd::Command::cargo_bin("hydrograd").unwrap();
        command.arg("simulate").arg(&file).arg("--out").arg(&out).assert().success();
        let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        summary["warnings"].as_array().unwrap().iter().find(|warning| warning["code"] == "narrow").cloned()
    };
    let narrow = warnings(0.12).unwrap();
    assert!((narrow["value"].as_f64().unwrap() - 3.0).abs() < 0.05, "{narrow}");
    assert_eq!(warnings(0.3), None);
}

/// A channel with an inflow, one shape in it, and as variables numbers of it.
fn beside_an_inflow(shape: &str, variables: &[(&str, f64, f64)], kind: &str) -> Config {
    let variable = |(number, lower, upper): &(&str, f64, f64)| {
        format!("[[variables]]\nnumber = \"shapes[0].{number}\"\nlower = {lower}\nupper = {upper}\n")
    };
    loaded(&format!(
        "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.05\ninitial.temperature = 0.0\n\
         fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\n\
         region.size = [2.0, 1.0]\nregion.periodic = [false, false]\n\
         region.sides.left = {{ kind = \"inflow\", velocity = [\"4*y*(1 - y)\", 0], temperature = \"0.3*y\" }}\n\
         region.sides.right = {{ kind = \"outflow\" }}\nobjective.kind = \"{kind}\"\nobjective.shapes = [0]\n\
         [[shapes]]\n{shape}\ntemperature = 1.0\n{}",
        variables.iter().map(variable).collect::<String>()
    ))
}

/// Numbers that move the ends of a wall along the sides that it stands on are variables like others: a box, an oblique fin, a bump, and a
/// plate that moves along an inflow, whose profile depends on the place.
#[test]
fn ends_of_walls_slide_along_sides() {
    let fin = "kind = \"box\"\nlower = [0.65, -0.3]\nupper = [0.8, 0.4]";
    let numbers = [("upper[1]", 0.3, 0.5), ("lower[0]", 0.6, 0.7), ("upper[0]", 0.75, 0.9)];
    assert_derivatives(&beside_an_inflow(fin, &numbers, "drag"), &[0, 1, 2], 1e-7);
    assert_derivatives(&beside_an_inflow(fin, &numbers, "shape-heat"), &[0, 1, 2], 1e-7);
    let oblique = "kind = \"polygon\"\npoints = [[0.6, -0.2], [0.9, -0.2], [1.0, 0.45], [0.85, 0.45]]";
    let numbers = [("points[2][0]", 0.95, 1.2), ("points[1][0]", 0.8, 1.0)];
    assert_derivatives(&beside_an_inflow(oblique, &numbers, "lift"), &[0, 1], 1e-7);
    let bump = "kind = \"disc\"\ncentre = [0.7, 0.1]\nradius = 0.25";
    let numbers = [("centre[0]", 0.6, 0.8), ("centre[1]", 0.0, 0.2), ("radius", 0.2, 0.3)];
    assert_derivatives(&beside_an_inflow(bump, &numbers, "torque"), &[0, 1, 2], 1e-7);
    let plate = "kind = \"box\"\nlower = [-0.3, 0.45]\nupper = [0.4, 0.6]";
    assert_derivatives(&beside_an_inflow(plate, &[("upper[1]", 0.55, 0.65)], "drag"), &[0], 1e-7);
}

/// So are those that move ends along other shapes, by the one and by the other: a fin on a plate, and two discs that are one body.
#[test]
fn ends_of_walls_slide_along_other_shapes() {
    let (fin, plate) = ("lower = [0.7, 0.02]\nupper = [0.8, 0.5]", "lower = [0.4, -0.2]\nupper = [1.3, 0.1]");
    let two = |first: &str, second: &str| format!("{first}\ntemperature = 1.0\n[[shapes]]\n{second}");
    let boxes = |a: &str, b: &str| two(&format!("kind = \"box\"\n{a}"), &format!("kind = \"box\"\n{b}"));
    let numbers = [("upper[1]", 0.45, 0.55), ("lower[0]", 0.65, 0.72)];
    assert_derivatives(&beside_an_inflow(&boxes(fin, plate), &numbers, "shape-heat"), &[0, 1], 1e-7);
    let numbers = [("upper[1]", 0.08, 0.12), ("upper[0]", 1.2, 1.4)];
    assert_derivatives(&beside_an_inflow(&boxes(plate, fin), &numbers, "drag"), &[0, 1], 1e-7);
    let disc = |x: f64, y: f64, radius: f64| format!("kind = \"disc\"\ncentre = [{x}, {y}]\nradius = {radius}");
    let numbers = [("centre[0]", 0.68, 0.72), ("centre[1]", 0.38, 0.42), ("radius", 0.14, 0.16)];
    let discs = two(&disc(0.7, 0.4, 0.15), &disc(0.86, 0.47, 0.13));
    assert_derivatives(&beside_an_inflow(&discs, &numbers, "drag"), &[0, 1, 2], 1e-7);
    assert_derivatives(&beside_an_inflow(&discs, &numbers, "shape-heat"), &[0, 1, 2], 1e-7);
}

/// The derivative while particles follow the shape is that of clouds placed anew, also where the side is hot in part, which stays as it is.
#[test]
fn the_derivative_by_the_ends_is_that_of_new_clouds() {
    let text = |from: f64, height: f64| {
        format!(
            "scene = \"custom\"\nmethod.name = \"fixed\"\nresolution.dx = 0.025\ninitial.temperature = 0.0\n\
             fluid.viscosity = 0.05\nfluid.conductivity = 0.05\nfluid.inlet_temperature = 0.0\n\
             region.size = [2.0, 1.0]\nregion.periodic = [false, false]\nobjective.target_x = 2.0\n\
             region.sides.left = {{ kind = \"inflow\", velocity = [\"4*y*(1 - y)\", 0], temperature = 0 }}\n\
             region.sides.right = {{ kind = \"outflow\" }}\nobjective.kind = \"heat-outflow\"\n\
             [[shapes]]\nkind = \"box\"\nlower = [0.4, -0.3]\nupper = [1.3, 0.0]\ntemperature = 1.0\n\
             [[shapes]]\nkind = \"box\"\nlower = [{from}, -0.2]\nupper = [0.9, {height}]\ntemperature = 1.0\n\
             [[variables]]\nnumber = \"shapes[1].lower[0]\"\nlower = 0.6\nupper = 0.85\n\
             [[variables]]\nnumber = \"shapes[1].upper[1]\"\nlower = 0.2\nupper = 0.6\n"
        )
    };
    let heat = |from: f64, height: f64| solved(&text(from, height)).0.objective(&solved(&text(from, height)).1).0;
    let (mut around, solution) = solved(&text(0.75, 0.4));
    let gradient = around.gradient(&solution, &around.objective(&solution).1).unwrap().by_variables;
    let step = 0.05;
    let new = [heat(0.75 + step, 0.4) - heat(0.75 - step, 0.4), heat(0.75, 0.4 + step) - heat(0.75, 0.4 - step)]
        .map(|change| change / (2.0 * step));
    println!("{gradient:?}, clouds placed anew {new:?}");
    let length = gradient[0].hypot(gradient[1]);
    assert!((0..2).all(|k| (gradient[k] - new[k]).abs() < 0.03 * length));
}

/// A disc that turns back and forth in a channel with a pulsating inflow, warm, with buoyancy.
const IN_TIME: &str = "scene = \"custom\"\nregion.size = [1.0, 0.5]\nregion.acceleration = [0.0, -1.0]\n\
    region.sides.left = { kind = \"inflow\", velocity = [\"(1 + 0.3*sin(5*t))*4*y*(0.5 - y)/0.25\", 0], temperature = 0 }\n\
    region.sides.right = { kind = \"outflow\" }\n\
    fluid.viscosity = 0.01\nfluid.conductivity = 0.01\nfluid.inlet_temperature = 0.0\nfluid.expansion = 0.5\n\
    initial.temperature = 0.0\ninitial.velocity = [\"4*y*(0.5 - y)/0.25\", \"0.1*sin(3*x)\"]\n\
    resolution.dx = 0.05\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\ntime.end = 0.3\nobjective.window = 0.2\n\
    [[shapes]]\nkind = \"disc\"\ncentre = [0.35, 0.23]\nradius = 0.08\ntemperature = 1.0\n\
    velocity = [\"0.5*cos(7*t)*(0.23 - y)\", \"0.5*cos(7*t)*(x - 0.35)\"]\n\
";

#[test]
fn the_gradient_of_a_flow_in_time_is_that_of_differences() {
    let variables = "[[variables]]\nnumber = \"shapes[0].centre[0]\"\nlower = 0.3\nupper = 0.4\n\
        [[variables]]\nnumber = \"shapes[0].centre[1]\"\nlower = 0.2\nupper = 0.3\n\
        [[variables]]\nnumber = \"shapes[0].radius\"\nlower = 0.05\nupper = 0.1\n";
    let text = IN_TIME.replace("    variables = []\n", "").replace("variables = []\n", "");
    let periodic = channel(
        0.05,
        "method.flow = \"unsteady\"\ntime.end = 0.2\ntime.step = 0.01\nfluid.drive = \"flow-rate\"\nfluid.flow_rate = 0.2\n",
    ) + &shape("disc", &[0.5, 0.18, 0.07]);
    let of_periodic = variables
        .replace("shapes[0]", "shapes[2]")
        .replace("0.3\nupper = 0.4", "0.4\nupper = 0.6")
        .replace("lower = 0.2", "lower = 0.1");
    // The same by amplitude and frequency of its turning, and by its place.
    let turned = text.replace("0.5*cos(7*t)", "p0*cos(p1*t)") + "parameters = [0.5, 7.0]\n";
    let of_turned: &str = "[[variables]]\nnumber = \"shapes[0].parameters[0]\"\nlower = 0.0\nupper = 1.0\n\
        [[variables]]\nnumber = \"shapes[0].parameters[1]\"\nlower = 1.0\nupper = 10.0\n\
        [[variables]]\nnumber = \"shapes[0].centre[1]\"\nlower = 0.2\nupper = 0.3\n";
    for (text, objective) in [
        (text.clone() + variables, "objective.kind = \"drag\"\n"),
        (text.clone() + variables, "objective.kind = \"shape-heat\"\n"),
        (turned.clone() + of_turned, "objective.kind = \"drag\"\n"),
        (corrected(&periodic) + &of_periodic, "objective.kind = \"pressure-drop\"\n"),
        (periodic + &of_periodic, "objective.kind = \"pressure-drop\"\n"),
        (corrected(&turned) + of_turned, "objective.kind = \"drag\"\n"),
        (corrected(&text) + variables, "objective.kind = \"shape-heat\"\n"),
    ] {
        let around = AroundShapes::new(&loaded(&(objective.to_string() + &text))).unwrap();
        let first = around.first();
        let (history, _) = around.march(&first, None, &mut |_, _| Ok(())).unwrap();
        assert!(history.sizes.len() > 10);
        let exact = around.march_gradient(&first, &history, Of::Objective).unwrap().by_variables;
        let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
        // With room for a few states only, most are made again.
        let frugal = around.go_back(&first, &history, Of::Objective, 1).unwrap().by_variables;
        let apart = exact.iter().zip(&frugal).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-12 * norm, "{exact:?} and {frugal:?}");
        for k in 0..first.len() {
            let difference = of_mean(&around, &first, &history.sizes, k, 1e-4);
            assert!((difference - exact[k]).abs() < 1e-6 * norm, "{objective} {k}: {} and {difference}", exact[k]);
        }
    }
}

/// A triangle and a disc in a stream over a wall that moves: steps a hundredth of what the flow allows have the drags of five times as long
/// ones, where pressures beside the corners grew without bounds.
#[test]
fn steps_may_be_far_shorter_than_the_flow_allows() {
    let text = "scene = \"custom\"\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\ntime.end = 0.004\nresolution.dx = 0.025\n\
        fluid.viscosity = 0.0168\nfluid.reference_velocity = 0.83\nobjective.kind = \"drag\"\nobjective.shapes = [0]\n\
        region.size = [1.0, 0.6]\nregion.sides.left = { kind = \"inflow\", velocity = [\"0.83*y*(1.2-y)/0.36 + 0.11*(1-y/0.6)^2\", 0] }\n\
        region.sides.right = { kind = \"outflow\" }\nregion.sides.bottom = { kind = \"wall\", velocity = [0.11, 0] }\n\
        region.sides.top = { kind = \"symmetry\" }\n\
        [[shapes]]\nkind = \"polygon\"\npoints = [[0.3283, 0.2513], [0.3996, 0.3515], [0.2771, 0.3632]]\n\
        [[shapes]]\nkind = \"disc\"\ncentre = [0.65, 0.274]\nradius = 0.059\n";
    let drags = |step: f64| {
        let around = AroundShapes::new(&loaded(&format!("time.step = {step}\n{text}"))).unwrap();
        let (history, last) =
            around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap_or_else(|error| panic!("{error}"));
        let found = [0, 1].map(|shape| around.value(&last, Figure::Force { shape, along: 0 }));
        println!("{} steps: {found:?}", history.sizes.len());
        found
    };
    let [short, long] = [2e-5, 1e-4].map(drags);
    for (short, long) in short.iter().zip(long) {
        assert!((short / long - 1.0).abs() < 0.05, "{short} and {long}");
    }
}
