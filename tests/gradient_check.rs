//! The check of gradients itself: it passes right ones and finds wrong ones.

use hydrograd::adjoint::check::{check, cosine};

fn f(x: &[f64]) -> Result<f64, ()> {
    Ok(x[0].sin() * x[1].exp())
}

/// Along a direction in which hardly anything changes, differences are as good as along others.
#[test]
fn a_direction_across_the_gradient_is_no_error() {
    let x = [0.3, -0.2];
    let (value, right) = (f(&x).unwrap(), [x[0].cos() * x[1].exp(), x[0].sin() * x[1].exp()]);
    let across = vec![vec![-right[1], right[0] * (1.0 + 1e-9)]];
    let found = check(value, &right, &x, &across, &[1e-4, 1e-5], f).unwrap();
    assert!(found[0].gradient.abs() < 1e-8 && found[0].best().unwrap().error < 1e-8, "{found:?}");
}

#[test]
fn right_gradient_passes_and_wrong_one_does_not() {
    let x = [0.3, -0.2];
    let value = f(&x).unwrap();
    let right = [x[0].cos() * x[1].exp(), value];
    let steps: Vec<f64> = (1..8).map(|k| 10f64.powi(-k)).collect();
    let directions = [vec![1.0, 0.5], vec![-0.2, 0.9]];
    let good = check(value, &right, &x, &directions, &steps, f).unwrap();
    assert!(good.iter().all(|d| d.best().unwrap().error < 1e-8 && (d.order(value) - 2.0).abs() < 0.2));
    assert!((cosine(&good) - 1.0).abs() < 1e-12);
    let wrong = [right[0] * 1.01, right[1]];
    let bad = check(value, &wrong, &x, &directions, &steps, f).unwrap();
    assert!(bad.iter().all(|d| d.best().unwrap().error > 1e-3));
    // Over small steps the remainder is of first order.
    let last = &bad[0].points[4..6];
    let order = (last[0].remainder / last[1].remainder).log10();
    assert!((order - 1.0).abs() < 0.1, "{order}");
}
