//! Limits of design variables: bounds for each, and a largest slope between neighbours.

use crate::error::BadInput;

/// The convex set `lower <= x <= upper`, `|x_{k+1} - x_k| <= slope (p_{k+1} - p_k)` with positions p.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
    steepness: Option<Steepness>,
}

/// Largest slope between neighbours.
#[derive(Debug, Clone, PartialEq)]
struct Steepness {
    positions: Vec<f64>,
    slope: f64,
    /// The last variable of the bottom wall, if the top wall follows, which is independent of it.
    last_of_wall: Option<usize>,
}

/// Largest number of sweeps of Dykstra's algorithm. It converges linearly, usually within ten.
const SWEEPS: usize = 10_000;

impl Limits {
    /// Bounds without a largest slope.
    pub fn within(lower: Vec<f64>, upper: Vec<f64>) -> Self {
        Self { lower, upper, steepness: None }
    }

    /// `|x_k| <= bound`, and a largest `slope` between neighbours at increasing `positions`.
    pub fn symmetric(bound: f64, positions: &[f64], slope: f64) -> Self {
        let steepness = Some(Steepness { positions: positions.to_vec(), slope, last_of_wall: None });
        Self { lower: vec![-bound; positions.len()], upper: vec![bound; positions.len()], steepness }
    }

    /// The part of the set within `radius` of `point` in each variable.
    pub fn near(&self, point: &[f64], radius: f64) -> Self {
        let lower = self.lower.iter().zip(point).map(|(lower, x)| lower.max(x - radius)).collect();
        let upper = self.upper.iter().zip(point).map(|(upper, x)| upper.min(x + radius)).collect();
        Self { lower, upper, steepness: self.steepness.clone() }
    }

    /// The limits of two walls, whose variables follow each other.
    pub fn twice(&self) -> Self {
        let twice = |numbers: &[f64]| [numbers, numbers].concat();
        let steepness = self.steepness.as_ref().map(|one| Steepness {
            positions: twice(&one.positions),
            last_of_wall: Some(one.positions.len() - 1),
            slope: one.slope,
        });
        Self { lower: twice(&self.lower), upper: twice(&self.upper), steepness }
    }

    /// Largest difference of the variables k and k + 1, if it is limited. It is slightly reduced, so that a wall passes
    /// its own check after rounding.
    fn most(&self, k: usize) -> Option<f64> {
        let steepness = self.steepness.as_ref().filter(|steepness| steepness.last_of_wall != Some(k))?;
        let (from, to) = (steepness.positions[k], steepness.positions[k + 1]);
        Some(steepness.slope * (to - from).abs() * (1.0 - 1e-12))
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
        if self.steepness.is_none() {
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
