//! Limits of design variables: bounds for each, and a largest slope between neighbours.

use crate::error::BadInput;

/// The convex set `lower <= x <= upper`, `|x_{k+1} - x_k| <= slope (p_{k+1} - p_k)` with positions p.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
    /// Largest difference of the variables k and k + 1, where there is one; empty without a largest slope. It is slightly
    /// reduced, so that a wall passes its own check after rounding.
    steps: Vec<Option<f64>>,
}

/// Largest number of sweeps of Dykstra's algorithm. It converges linearly, usually within ten.
const SWEEPS: usize = 10_000;

impl Limits {
    /// Bounds without a largest slope.
    pub fn within(lower: Vec<f64>, upper: Vec<f64>) -> Self {
        Self { lower, upper, steps: vec![] }
    }

    /// `|x_k| <= bound`, and a largest `slope` between neighbours at increasing `positions`.
    pub fn symmetric(bound: f64, positions: &[f64], slope: f64) -> Self {
        let most = |pair: &[f64]| Some(slope * (pair[1] - pair[0]).abs() * (1.0 - 1e-12));
        let steps = positions.windows(2).map(most).collect();
        Self { lower: vec![-bound; positions.len()], upper: vec![bound; positions.len()], steps }
    }

    /// The part of the set within `radius` of `point` in each variable.
    pub fn near(&self, point: &[f64], radius: f64) -> Self {
        let lower = self.lower.iter().zip(point).map(|(lower, x)| lower.max(x - radius)).collect();
        let upper = self.upper.iter().zip(point).map(|(upper, x)| upper.min(x + radius)).collect();
        Self { lower, upper, steps: self.steps.clone() }
    }

    /// The limits of two independent walls, whose variables follow each other.
    pub fn twice(&self) -> Self {
        let twice = |numbers: &[f64]| [numbers, numbers].concat();
        let steps = [self.steps.as_slice(), &[None], &self.steps].concat();
        Self { lower: twice(&self.lower), upper: twice(&self.upper), steps }
    }

    /// Largest difference of the variables k and k + 1, if it is limited.
    fn most(&self, k: usize) -> Option<f64> {
        self.steps.get(k).copied().flatten()
    }

    /// Clamps `x` to its bounds.
    pub fn clamp(&self, x: &mut [f64]) {
        for (x, (lower, upper)) in x.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            *x = x.clamp(*lower, *upper);
        }
    }

    /// Moves `x` into the set, to the bit: to the bounds, then to the largest slope from the middle outwards. Points of
    /// the set do not change. It is fast, but does not give the nearest point as [`Self::nearest`] does.
    pub fn project(&self, x: &mut [f64]) {
        self.clamp(x);
        let middle = x.len() / 2;
        for k in middle + 1..x.len() {
            if let Some(most) = self.most(k - 1) {
                x[k] = x[k].clamp(x[k - 1] - most, x[k - 1] + most);
            }
        }
        for k in (0..middle).rev() {
            if let Some(most) = self.most(k) {
                x[k] = x[k].clamp(x[k + 1] - most, x[k + 1] + most);
            }
        }
    }

    /// Whether `x` is in the set.
    pub fn contains(&self, x: &[f64]) -> bool {
        let mut projected = x.to_vec();
        self.project(&mut projected);
        projected == x
    }

    /// Moves `x` to the nearest point of the set (Euclidean norm), by Dykstra's algorithm over three simple sets: the
    /// bounds, the pairs (0, 1), (2, 3), ... and the pairs (1, 2), (3, 4), ... (Boyle and Dykstra 1986).
    pub fn nearest(&self, x: &mut [f64]) {
        if self.steps.is_empty() {
            return self.clamp(x);
        }
        if self.contains(x) {
            return;
        }
        let scale = self.upper.iter().zip(&self.lower).map(|(u, l)| u - l).fold(0.0, f64::max);
        let mut corrections = [vec![0.0; x.len()], vec![0.0; x.len()], vec![0.0; x.len()]];
        for _ in 0..SWEEPS {
            let mut moved: f64 = 0.0;
            for (set, correction) in corrections.iter_mut().enumerate() {
                let asked: Vec<f64> = x.iter().zip(correction.iter()).map(|(x, c)| x + c).collect();
                let mut found = asked.clone();
                match set {
                    0 => self.clamp(&mut found),
                    _ => self.level_pairs(set - 1, &mut found),
                }
                for k in 0..x.len() {
                    moved = moved.max((asked[k] - found[k] - correction[k]).abs());
                    correction[k] = asked[k] - found[k];
                    x[k] = found[k];
                }
            }
            if moved <= 1e-13 * scale {
                break;
            }
        }
        self.project(x);
    }

    /// Moves `x` to the nearest point whose pairs (first, first + 1), (first + 2, first + 3), ... are not too steep.
    fn level_pairs(&self, first: usize, x: &mut [f64]) {
        for k in (first..x.len().saturating_sub(1)).step_by(2) {
            let difference = x[k + 1] - x[k];
            if let Some(most) = self.most(k).filter(|most| difference.abs() > *most) {
                let excess = 0.5 * (difference - most.copysign(difference));
                x[k] += excess;
                x[k + 1] -= excess;
            }
        }
    }

    /// Checks that `values` are finite, within bounds and not too steep. `what` is their name in messages.
    ///
    /// # Errors
    /// The first value or pair that violates this.
    pub fn check(&self, what: &str, values: &[f64]) -> Result<(), BadInput> {
        for (k, (&x, (&lower, &upper))) in values.iter().zip(self.lower.iter().zip(&self.upper)).enumerate() {
            if !x.is_finite() {
                let problem = format!("{what}[{k}] = {x} is not a number to compute with");
                return Err(BadInput::new(problem).allowed("finite numbers"));
            }
            let slack = 1e-12 * lower.abs().max(upper.abs());
            if x < lower - slack || x > upper + slack {
                let problem = format!("{what}[{k}] = {x} is out of bounds");
                return Err(BadInput::new(problem).allowed(format!("{lower} ... {upper} (design.bound)")));
            }
        }
        for k in 1..values.len() {
            let step = (values[k] - values[k - 1]).abs();
            if let Some(most) = self.most(k - 1).filter(|most| step > most * (1.0 + 2e-9)) {
                let problem = format!("{what} is too steep between [{}] and [{k}]", k - 1);
                return Err(BadInput::new(problem).allowed(format!("a step of at most {most:.6}")));
            }
        }
        Ok(())
    }
}
