//! Parametrisations: each is its linear map, its adjoint, and what it promises about area, bounds and slopes.

use hydrograd::design::parametrisations::numbers::Numbers;
use hydrograd::design::parametrisations::{BSpline, Nodes, Polygon, TwoWalls};
use hydrograd::design::shape::{default_nodes, HotSection, Shape, MAX_SLOPE};
use hydrograd::design::Parametrisation;
use hydrograd::numerics::random::{stream, uniform};

const BOUND: f64 = 0.02;

/// Hot sections whose ends and columns stand to each other in different ways.
fn sections() -> Vec<HotSection> {
    let mut sections = vec![];
    for (from, to) in [(0.25, 0.75), (0.257, 0.741), (0.2137, 0.7003), (0.251, 0.2699)] {
        sections.extend([0.02, 0.01, 0.005, 1.0 / 30.0].map(|dx| HotSection { from, to, dx, length: 1.0 }));
    }
    sections
}

/// Every parametrisation over a section.
fn all(section: HotSection) -> Vec<Box<dyn Parametrisation>> {
    let nodes = match default_nodes(section.from, section.to, section.dx) {
        nodes if nodes.is_empty() => vec![0.5 * (section.from + section.to)],
        nodes => nodes,
    };
    let mut all: Vec<Box<dyn Parametrisation>> = vec![
        Box::new(Nodes::new(nodes, section, BOUND).unwrap()),
        Box::new(Nodes::new(vec![section.from, 0.3 * section.from + 0.7 * section.to], section, BOUND).unwrap()),
    ];
    for control_points in [4, 5, 8, 31] {
        all.push(Box::new(BSpline::new(control_points, section, BOUND).unwrap()));
    }
    all
}

fn numbers(seed: u64, count: usize, size: f64) -> Vec<f64> {
    let mut random = stream(seed, "numbers");
    (0..count).map(|_| size * (2.0 * uniform(&mut random) - 1.0)).collect()
}

fn each(mut test: impl FnMut(HotSection, &dyn Parametrisation, &str)) {
    for section in sections() {
        for one in all(section) {
            test(section, &*one, &format!("{} with {} variables over {section:?}", one.name(), one.variables()));
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn the_adjoint_is_that_of_the_map() {
    each(|section, one, name| {
        let x = numbers(1, one.variables(), BOUND);
        let bar = numbers(2, section.columns(), 1.0);
        let (heights, back) = (one.column_heights(&x), one.pull_back(&bar));
        assert_eq!((heights.len(), back.len()), (section.columns(), one.variables()), "{name}");
        let (there, back_again) = (dot(&heights, &bar), dot(&x, &back));
        assert!((there - back_again).abs() < 1e-15 * section.columns() as f64, "{name}: {there}, {back_again}");
        // Central differences; linear, so any step will do.
        for k in 0..one.variables() {
            let moved = |by: f64| {
                let mut x = x.clone();
                x[k] += by;
                dot(&one.column_heights(&x), &bar)
            };
            let difference = (moved(1.0) - moved(-1.0)) / 2.0;
            assert!((difference - back[k]).abs() < 1e-12, "{name}, variable {k}: {difference}, {}", back[k]);
        }
    });
}

#[test]
fn a_column_s_height_is_the_average_over_it() {
    let points = 2000;
    each(|section, one, name| {
        let mut x = numbers(3, one.variables(), BOUND);
        one.limits().project(&mut x);
        for (column, average) in one.column_heights(&x).into_iter().enumerate() {
            let at = |k: usize| one.height(&x, (column as f64 + (k as f64 + 0.5) / points as f64) * section.dx, 0.0);
            let sampled = (0..points).map(at).sum::<f64>() / points as f64;
            // A jump at an end of the section costs half a point; the midpoint rule's own error is much smaller.
            assert!((average - sampled).abs() < 1.2 * BOUND / points as f64, "{name}, column {column}");
        }
    });
}

/// The polygon of fixed particles has the area of the wall from one vertex to those beside, with its first moment; one with its vertices on
/// the wall cuts kinks off.
#[test]
fn a_polygon_keeps_the_wall_s_area() {
    let (section, offsets) = (HotSection { from: 0.25, to: 0.75, dx: 0.011, length: 1.1 }, [0.013, -0.02, 0.004]);
    // Kinks that are far from each other, anywhere between vertices.
    let nodes = Nodes::new(vec![0.3, 0.46, 0.6413], section, BOUND).unwrap();
    let wall = nodes.sampled(&offsets);
    let x: Vec<f64> = (0..100).map(|k| 0.011 * k as f64).collect();
    let heights = |keeps_area| {
        let polygon = Polygon { x: x.clone(), keeps_area };
        nodes.clone().as_polygon(Some(&polygon)).column_heights(&offsets)
    };
    let [kept, cut] = [heights(Some(0.011)), heights(None)];
    // Integrals of 1 and x times the difference of a polygon from the wall around a kink.
    let apart = |heights: &[f64], kink: f64| {
        let (from, pieces) = ((kink / 0.011) as usize - 4, 9 * 1000);
        let at = |k: usize| (k as f64 + 0.5) / 1000.0;
        let difference = |s: f64| {
            let (k, t) = (from + s as usize, s.fract());
            (1.0 - t) * heights[k] + t * heights[k + 1] - wall.surface(x[from] + 0.011 * s)
        };
        let integral = |power: i32| (0..pieces).map(|k| at(k).powi(power) * difference(at(k))).sum::<f64>() / 1000.0;
        [integral(0), integral(1)]
    };
    for kink in [0.3, 0.46, 0.6413] {
        let ([area, moment], [cut_off, _]) = (apart(&kept, kink), apart(&cut, kink));
        assert!(
            area.abs() < 0.01 * cut_off.abs() && moment.abs() < 0.05 * cut_off.abs(),
            "{kink}: {area}, {moment}, {cut_off}"
        );
    }
    // A straight wall is what it is.
    let straight = Nodes::new(vec![0.3, 0.7], section, BOUND).unwrap();
    let polygon = Polygon { x: x.clone(), keeps_area: Some(0.011) };
    let (heights, wall) = (straight.clone().as_polygon(Some(&polygon)).column_heights(&[0.0, 0.02]), [0.0, 0.02]);
    for (x, height) in x.iter().zip(heights).filter(|(x, _)| (0.32..0.68).contains(*x)) {
        assert!((height - straight.sampled(&wall).surface(*x)).abs() < 1e-16, "{x}: {height}");
    }
}

/// Sum of the column heights times their width: the same at any resolution.
#[test]
fn the_area_is_exact_at_every_resolution() {
    let coarse = HotSection { from: 0.257, to: 0.741, dx: 0.02, length: 1.0 };
    let fine = HotSection { dx: 0.005, ..coarse };
    let area = |section: HotSection, one: &dyn Parametrisation, x: &[f64]| {
        one.column_heights(x).iter().map(|height| height * section.dx).sum::<f64>()
    };
    let nodes = |section| Nodes::new(vec![0.26, 0.4, 0.41, 0.7], section, BOUND).unwrap();
    let x = numbers(4, 4, BOUND);
    assert!((area(coarse, &nodes(coarse), &x) - area(fine, &nodes(fine), &x)).abs() < 1e-16);
    for control_points in [4, 6, 17] {
        let spline = |section| BSpline::new(control_points, section, BOUND).unwrap();
        let x = numbers(5, control_points, BOUND);
        // The integral of N_j is (t_{j+4} - t_j) / 4: control points weighted by that.
        let span = (coarse.to - coarse.from) / (control_points - 3) as f64;
        let knot = |k: usize| coarse.from + span * (k.clamp(3, control_points) - 3) as f64;
        let exact: f64 = (0..control_points).map(|j| x[j] * (knot(j + 4) - knot(j)) / 4.0).sum();
        for section in [coarse, fine] {
            let found = area(section, &spline(section), &x);
            assert!((found - exact).abs() < 1e-16, "{control_points} control points: {found}, not {exact}");
        }
    }
}

#[test]
fn b_splines_sum_to_one_and_reproduce_lines() {
    for section in sections() {
        for control_points in [4, 5, 8, 31] {
            let spline = BSpline::new(control_points, section, BOUND).unwrap();
            let line: Vec<f64> = spline.positions().iter().map(|g| 0.3 - 2.0 * g).collect();
            let constant = vec![0.7; control_points];
            for k in 1..500 {
                let x = section.from + (section.to - section.from) * k as f64 / 500.0;
                let (first, values) = spline.basis(x);
                assert!(first + 4 <= control_points && values.iter().all(|value| *value >= 0.0));
                assert!((values.iter().sum::<f64>() - 1.0).abs() < 1e-14);
                assert!((spline.height(&constant, x, 0.0) - 0.7).abs() < 1e-14);
                assert!((spline.height(&line, x, 0.0) - (0.3 - 2.0 * x)).abs() < 1e-13, "{control_points} at {x}");
            }
            for x in [section.from, section.to, 0.0, 0.2, 0.99] {
                assert_eq!(spline.height(&constant, x, 0.0), 0.0, "outside the section");
            }
            // A column inside the section has the constant itself.
            let share = section.share();
            for (height, share) in spline.column_heights(&constant).iter().zip(&share) {
                assert!((height - 0.7 * share).abs() < 1e-15);
            }
        }
    }
    assert!(BSpline::new(3, sections()[0], BOUND).unwrap_err().to_string().contains("design.control_points = 3"));
}

/// de Boor's book, ch. X: a cubic B-spline on uniform knots is 1/6, 4/6, 1/6 at the inner ones.
#[test]
fn b_splines_have_the_known_values() {
    let section = HotSection { from: 0.0, to: 1.0, dx: 0.1, length: 1.0 };
    let spline = BSpline::new(13, section, BOUND).unwrap();
    let (first, values) = spline.basis(0.5);
    assert_eq!(first, 5);
    for (value, expected) in values.iter().zip([1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0, 0.0]) {
        assert!((value - expected).abs() < 1e-14, "{values:?}");
    }
    // Clamped: the curve begins and ends at its outer control points.
    let x = numbers(6, 13, 1.0);
    assert!(
        (spline.height(&x, 1e-13, 0.0) - x[0]).abs() < 1e-10
            && (spline.height(&x, 1.0 - 1e-13, 0.0) - x[12]).abs() < 1e-10
    );
}

#[test]
fn limits_on_variables_limit_the_wall() {
    each(|section, one, name| {
        let mut x = numbers(7, one.variables(), 3.0 * BOUND);
        one.limits().project(&mut x);
        one.check(&x).unwrap();
        let height = |k: usize| {
            let share = (k as f64 + 0.5) / 1000.0;
            one.height(&x, section.from + (section.to - section.from) * share, 0.0)
        };
        let step = (section.to - section.from) / 1000.0;
        for k in 0..1000 {
            assert!(height(k).abs() <= BOUND * (1.0 + 1e-12), "{name}");
            assert!(
                k == 0 || (height(k) - height(k - 1)).abs() <= MAX_SLOPE * step * (1.0 + 1e-9),
                "{name} is too steep"
            );
        }
        // The columns of the wall are what a file of it gives back, and such a file is a valid start shape.
        let sampled = one.sampled(&x);
        let checked = Shape::new(sampled.nodes.clone(), sampled.offsets.clone(), section.from, section.to).unwrap();
        checked.check_bound(BOUND).unwrap();
        x[0] = f64::NAN;
        assert!(one.check(&x).unwrap_err().to_string().contains("[0] = NaN"), "{name}");
    });
}

#[test]
fn the_penalty_s_gradient_is_its_derivative() {
    each(|_, one, name| {
        let x = numbers(8, one.variables(), BOUND);
        let (_, gradient) = one.penalty(5.0, &x);
        for k in 0..x.len() {
            let moved = |by: f64| {
                let mut x = x.clone();
                x[k] += by;
                one.penalty(5.0, &x).0
            };
            // Quadratic: central differences are exact.
            assert!(((moved(1e-2) - moved(-1e-2)) / 2e-2 - gradient[k]).abs() < 1e-12, "{name}");
        }
        assert_eq!(one.penalty(5.0, &vec![0.01; x.len()]).0, 0.0, "{name}: a flat wall costs nothing");
    });
}

#[test]
fn a_spline_s_own_file_gives_its_control_points_back() {
    for section in sections() {
        for control_points in [4, 8, 31] {
            let spline = BSpline::new(control_points, section, BOUND).unwrap();
            let mut x = numbers(9, control_points, BOUND);
            spline.limits().project(&mut x);
            let back = spline.fitted(&spline.sampled(&x));
            let gap = x.iter().zip(&back).map(|(x, b)| (x - b).abs()).fold(0.0, f64::max);
            assert!(gap < 1e-10, "{control_points} over {section:?}: {gap:e}");
            // Fewer nodes than control points: the curve goes through them.
            let nodes = vec![0.4 * section.from + 0.6 * section.to, 0.1 * section.from + 0.9 * section.to];
            let wall = Shape::new(nodes, vec![0.001, 0.0012], section.from, section.to).unwrap();
            let points = spline.fitted(&wall);
            for (node, offset) in wall.nodes.iter().zip(&wall.offsets) {
                assert!((spline.height(&points, *node, 0.0) - offset).abs() < 1e-10);
            }
            assert!(spline.fitted(&Shape { offsets: vec![0.0; 2], ..wall }).iter().all(|c| *c == 0.0));
        }
    }
}

#[test]
fn two_walls_are_one_and_another() {
    for section in sections() {
        let one = || BSpline::new(6, section, 0.02).unwrap();
        let both = TwoWalls::new(one());
        let variables = numbers(3, 12, 0.02);
        let (bottom, top) = variables.split_at(6);
        let one = one();
        let heights = [one.column_heights(bottom), one.column_heights(top)].concat();
        assert_eq!(both.column_heights(&variables), heights);
        let bar = numbers(4, heights.len(), 1.0);
        assert!((dot(&heights, &bar) - dot(&variables, &both.pull_back(&bar))).abs() < 1e-12);
        let sampled = both.sampled(&variables);
        assert_eq!(sampled.offsets, one.sampled(bottom).offsets);
        assert_eq!(sampled.top_wall().offsets, one.sampled(top).offsets);
        let penalty = |x: &[f64]| one.penalty(0.3, x).0;
        assert_eq!(both.penalty(0.3, &variables).0, penalty(bottom) + penalty(top));
        // Where one wall ends and the other begins nothing limits the step.
        let mut steps = vec![0.02; 6];
        steps.extend([-0.02; 6]);
        assert!(both.limits().contains(&steps));
        steps[8] = 0.03;
        let error = both.check(&steps).unwrap_err().to_string();
        assert!(error.contains("top wall") && error.contains("[2] = 0.03"), "{error}");
    }
}

#[test]
fn variables_of_numbers_are_shares_of_the_way() {
    let numbers = Numbers::new(vec![0.3, -1.0], vec![0.1, -2.0], vec![0.5, 2.0]);
    let start = numbers.start();
    assert!((start[0] - 0.5).abs() < 1e-15 && start[1] == 0.25, "{start:?}");
    assert_eq!(numbers.values(&numbers.start()), [0.3, -1.0]);
    let ends = numbers.values(&[0.0, 1.0]);
    assert!((ends[0] - 0.1).abs() < 1e-15 && (ends[1] - 2.0).abs() < 1e-15);
    assert_eq!(numbers.pull_back(&[1.0, 10.0]), [0.4, 40.0]);
    let changes = numbers.column_heights(&[1.0, 0.0]);
    assert!((changes[0] - 0.2).abs() < 1e-15 && (changes[1] + 1.0).abs() < 1e-15);
}
