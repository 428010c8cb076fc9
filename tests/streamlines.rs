//! Streamlines of fields whose lines are known.

use hydrograd::numerics::streamlines::streamlines;
use std::f64::consts::TAU;

const SPACING: f64 = 0.1;

/// The least distance between places of different lines.
fn least_distance(lines: &[Vec<[f64; 2]>]) -> f64 {
    let mut least = f64::INFINITY;
    for (k, line) in lines.iter().enumerate() {
        for other in &lines[..k] {
            for a in line {
                least = other.iter().map(|b| (a[0] - b[0]).hypot(a[1] - b[1])).fold(least, f64::min);
            }
        }
    }
    least
}

#[test]
fn lines_of_a_vortex_are_circles_that_are_evenly_spaced() {
    let field = |[x, y]: [f64; 2]| (x.hypot(y) < 1.0).then_some([-y, x]);
    let lines = streamlines(&field, &[[0.5, 0.0]], SPACING, 1e-9);
    let mut radii: Vec<f64> = vec![];
    for line in &lines {
        let radius = |p: &[f64; 2]| p[0].hypot(p[1]);
        let first = radius(&line[0]);
        assert!(line.iter().all(|p| (radius(p) / first - 1.0).abs() < 0.01), "{first}");
        // Once around, and not twice.
        let length: f64 = line.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1])).sum();
        assert!((length / (TAU * first) - 1.0).abs() < 0.1, "radius {first}: {length}");
        radii.push(first);
    }
    radii.sort_by(f64::total_cmp);
    assert!((8..=11).contains(&radii.len()), "{radii:?}");
    assert!(radii.windows(2).all(|pair| (0.9..1.4).contains(&((pair[1] - pair[0]) / SPACING))), "{radii:?}");
    assert!(least_distance(&lines) > 0.5 * SPACING);
}

#[test]
fn lines_fill_a_stream_and_end_with_the_field() {
    // Nothing flows beyond the box, and at rest there are no lines.
    let inside = |p: [f64; 2]| (0..2).all(|d| (0.0..=1.0).contains(&p[d]));
    let lines = streamlines(&|p| inside(p).then_some([2.0, 1.0]), &[[0.5, 0.5]], SPACING, 1e-9);
    assert!(lines.iter().flatten().all(|p| inside(*p)));
    assert!(least_distance(&lines) > 0.5 * SPACING);
    for line in &lines {
        let [a, b] = [line[0], line[line.len() - 1]];
        let across = |p: [f64; 2]| (2.0 * p[1] - p[0]) / 5f64.sqrt();
        assert!(line.iter().all(|p| (across(*p) - across(a)).abs() < 1e-9));
        // From side to side.
        let is_at_side = |p: [f64; 2]| (0..2).any(|d| !(0.02..=0.98).contains(&p[d]));
        assert!(is_at_side(a) && is_at_side(b), "{a:?} ... {b:?}");
    }
    // Their distances cover the diagonal across the stream, 3 / sqrt(5), less the shortest ones in the corners.
    assert!((10..=14).contains(&lines.len()), "{}", lines.len());
    assert!(streamlines(&|_| Some([0.0, 0.0]), &[[0.5, 0.5]], SPACING, 1e-9).is_empty());
    assert!(streamlines(&|_| None, &[[0.5, 0.5]], SPACING, 0.0).is_empty());
}
