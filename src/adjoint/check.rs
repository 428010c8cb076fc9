//! The gradient check: compares an exact gradient with central differences along random directions, for several steps.
//!
//! For a direction d and a step h, (f(x + h d) - f(x - h d)) / 2h differs from g.d by O(h^2) truncation plus rounding
//! over h; the error has a minimum between. The Taylor remainder |f(x + h d) - f(x) - h g.d| falls as h^2 if and only if
//! g.d is the derivative.

/// The derivative along one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// The exact directional derivative g.d.
    pub gradient: f64,
    pub points: Vec<DifferenceStep>,
}

/// The central difference for one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DifferenceStep {
    pub step: f64,
    pub difference: f64,
    /// |difference - g.d| / (|g| |d|): relative to the largest derivative along a direction of this length, so that
    /// nothing is divided by that of a direction along which little changes.
    pub error: f64,
    /// |f(x + h d) - f(x) - h g.d|.
    pub remainder: f64,
}

impl Direction {
    /// The step with the smallest error.
    pub fn best(&self) -> Option<&DifferenceStep> {
        self.points.iter().min_by(|a, b| a.error.total_cmp(&b.error))
    }

    /// Order of the remainder: the steepest slope of log remainder over log step between adjacent steps where the
    /// remainder is above rounding. It is 2 for a right gradient, 1 for a wrong one.
    pub fn order(&self, value: f64) -> f64 {
        let floor = 1e3 * f64::EPSILON * value.abs();
        self.points
            .windows(2)
            .filter(|w| w.iter().all(|p| p.remainder > floor))
            .map(|w| (w[0].remainder / w[1].remainder).ln() / (w[0].step / w[1].step).ln())
            .fold(f64::NAN, f64::max)
    }
}

/// Compares `gradient` at `x` with differences of `f` along `directions`, for each of `steps` (largest first).
pub fn check<E>(
    value: f64,
    gradient: &[f64],
    x: &[f64],
    directions: &[Vec<f64>],
    steps: &[f64],
    mut f: impl FnMut(&[f64]) -> Result<f64, E>,
) -> Result<Vec<Direction>, E> {
    let mut results = Vec::new();
    let length = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    for d in directions {
        let scale = length(gradient) * length(d);
        let slope: f64 = gradient.iter().zip(d).map(|(g, d)| g * d).sum();
        let mut points = Vec::new();
        for &step in steps {
            let moved = |h: f64| -> Vec<f64> { x.iter().zip(d).map(|(x, d)| x + h * d).collect() };
            let (up, down) = (f(&moved(step))?, f(&moved(-step))?);
            let difference = (up - down) / (2.0 * step);
            points.push(DifferenceStep {
                step,
                difference,
                error: (difference - slope).abs() / scale,
                remainder: (up - value - step * slope).abs(),
            });
        }
        results.push(Direction { gradient: slope, points });
    }
    Ok(results)
}

/// Cosine between the directional derivatives by the gradient and by differences, each at its best step.
pub fn cosine(directions: &[Direction]) -> f64 {
    let pairs: Vec<(f64, f64)> =
        directions.iter().filter_map(|d| d.best().map(|p| (d.gradient, p.difference))).collect();
    let dot = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    dot(&|p| p.0 * p.1) / (dot(&|p| p.0 * p.0) * dot(&|p| p.1 * p.1)).sqrt()
}
