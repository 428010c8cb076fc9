//! The error of a figure by its spacing, from its values at several spacings (Richardson's extrapolation with the safety of the grid
//! convergence index: Roache 1998; ASME V&V 20-2009, section 2).
//!
//! Where f(h) = f + c h^p, the error at h follows from another spacing r h: (f(r h) - f(h)) / (r^p - 1). The order p is that of
//! the method, not the one that three values show: figures of particles are not smooth enough in h for that. With several other
//! spacings the largest of their estimates counts.

/// The factor of safety of the grid convergence index where more than two spacings are compared.
pub const SAFETY: f64 = 1.25;
/// The same where only two are.
pub const SAFETY_OF_TWO: f64 = 3.0;

/// A figure at a spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    pub spacing: f64,
    pub value: f64,
}

/// The error at a spacing, given the same at other ones, coarser or finer; none without another.
pub fn error_at(own: Point, others: &[Point], order: f64) -> Option<f64> {
    let estimate = |one: &Point| (one.value - own.value).abs() / ((one.spacing / own.spacing).powf(order) - 1.0).abs();
    let others = others.iter().filter(|one| one.spacing != own.spacing && one.value.is_finite());
    others.map(estimate).reduce(f64::max).map(|error| SAFETY * error)
}

/// The order that a spacing and two coarser ones of some others show; none where the figure does not approach a limit from one side.
pub fn observed_order(own: Point, others: &[Point]) -> Option<f64> {
    let mut coarser: Vec<Point> = others.iter().filter(|one| one.spacing > own.spacing).copied().collect();
    coarser.sort_by(|a, b| a.spacing.total_cmp(&b.spacing));
    let [middle, .., coarsest] = coarser.as_slice() else { return None };
    let (near, far) = (middle.value - own.value, coarsest.value - own.value);
    let (r, s) = (middle.spacing / own.spacing, coarsest.spacing / own.spacing);
    let excess = |p: f64| (s.powf(p) - 1.0) / (r.powf(p) - 1.0) - far / near;
    // The quotient grows with the order.
    let (mut low, mut high) = (0.05, 10.0);
    if !(excess(low) < 0.0 && excess(high) > 0.0) {
        return None;
    }
    for _ in 0..60 {
        let p = 0.5 * (low + high);
        if excess(p) < 0.0 {
            low = p;
        } else {
            high = p;
        }
    }
    Some(0.5 * (low + high))
}
