//! Sequential quadratic programming (Nocedal and Wright 2006, chapter 18) for a few limits and up to a hundred variables.
//!
//! Minimises f(x) where every g_i(x) <= 0 (or = 0), within lower <= x <= upper. Each step d minimises a quadratic model of
//! the Lagrangian under linearised limits; Powell's damped BFGS keeps the model convex, and a step that does not
//! lower the merit f + sum nu |violation| enough is halved. Every point is asked for and told, as of
//! [`super::optimisers::Optimiser`]; a point whose value is not finite shortens the step.

use crate::numerics::sparse_lu::dot;

/// A limit at a point: its value, its derivative, and whether it must be 0 instead of at most 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Limited {
    pub value: f64,
    pub gradient: Vec<f64>,
    pub is_equation: bool,
}

impl Limited {
    /// By how much the limit is exceeded.
    pub fn excess(&self) -> f64 {
        if self.is_equation {
            self.value.abs()
        } else {
            self.value.max(0.0)
        }
    }
}

/// What was found at a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    pub x: Vec<f64>,
    pub value: f64,
    pub gradient: Vec<f64>,
    pub limits: Vec<Limited>,
}

/// The state of a search.
#[derive(Debug, Clone)]
pub struct Sqp {
    /// The best point so far and the one that is asked for.
    at: Option<Point>,
    asked: Vec<f64>,
    /// The model's matrix, `[n, n]`.
    model: Vec<f64>,
    /// Multipliers of the last step, and the merit's weight.
    multipliers: Vec<f64>,
    weight: f64,
    step: Vec<f64>,
    share: f64,
    /// Where the next point may be.
    lower: Vec<f64>,
    upper: Vec<f64>,
    done: bool,
    has_model: bool,
}

/// The model's first curvature: with it the first step is a tenth of a unit along a gradient of one.
const FIRST: f64 = 10.0;
/// The least that it is taken for before curvatures are seen, in `FIRST`.
const LEAST: f64 = 1e-3;
/// Sweeps over the variables for a quadratic model, and rounds for its limits.
const SWEEPS: usize = 60;
const ROUNDS: usize = 40;
/// The expected decrease of the merit at which the search ends.
const WORTH: f64 = 3e-5;
/// The shortest share of a step.
const SHORTEST: f64 = 1.0 / 64.0;

impl Sqp {
    pub fn new(x: &[f64], lower: &[f64], upper: &[f64]) -> Self {
        let n = x.len();
        let mut model = vec![0.0; n * n];
        (0..n).for_each(|k| model[k * n + k] = FIRST);
        Self {
            at: None,
            asked: x.to_vec(),
            model,
            multipliers: vec![],
            weight: 1.0,
            step: vec![0.0; n],
            share: 1.0,
            lower: lower.to_vec(),
            upper: upper.to_vec(),
            done: false,
            has_model: false,
        }
    }

    /// The point to evaluate next.
    pub fn ask(&self) -> &[f64] {
        &self.asked
    }

    pub fn is_done(&self) -> bool {
        self.done
    }

    /// The best point so far.
    pub fn best(&self) -> Option<&Point> {
        self.at.as_ref()
    }

    /// Goes on from the best point within other bounds, where it is evaluated anew because the function has changed.
    pub fn renew(&mut self, lower: &[f64], upper: &[f64]) {
        (self.lower, self.upper) = (lower.to_vec(), upper.to_vec());
        if let Some(at) = self.at.take() {
            self.asked = at.x;
        }
        (self.step, self.share, self.done) = (vec![0.0; lower.len()], 1.0, false);
    }

    fn merit(&self, point: &Point) -> f64 {
        point.value + self.weight * point.limits.iter().map(Limited::excess).sum::<f64>()
    }

    /// Takes what was found at the point that was asked for; none: it cannot be evaluated.
    pub fn tell(&mut self, found: Option<Point>) {
        let Some(before) = self.at.clone() else {
            match found {
                Some(found) => {
                    self.at = Some(found);
                    self.propose();
                }
                None => self.done = true,
            }
            return;
        };
        let better = found.filter(|found| {
            let expected = self.expected(&before);
            found.value.is_finite() && self.merit(found) <= self.merit(&before) - 1e-4 * self.share * expected
        });
        let Some(found) = better else {
            self.share *= 0.4;
            if self.share < SHORTEST {
                self.done = true;
                return;
            }
            self.asked = before.x.iter().zip(&self.step).map(|(x, d)| x + self.share * d).collect();
            return;
        };
        self.learn(&before, &found);
        self.at = Some(found);
        self.propose();
    }

    /// The expected decrease of the merit by the whole step.
    fn expected(&self, at: &Point) -> f64 {
        let along = dot(&at.gradient, &self.step);
        let n = self.step.len();
        let bent: f64 = (0..n).map(|k| self.step[k] * dot(&self.model[k * n..(k + 1) * n], &self.step)).sum();
        let left: f64 = at
            .limits
            .iter()
            .map(|limit| Limited { value: limit.value + dot(&limit.gradient, &self.step), ..limit.clone() }.excess())
            .sum();
        let excess: f64 = at.limits.iter().map(Limited::excess).sum();
        -along - 0.5 * bent + self.weight * (excess - left)
    }

    /// Powell's damped BFGS with the Lagrangian's gradient.
    fn learn(&mut self, before: &Point, now: &Point) {
        let n = now.x.len();
        let lagrangian = |point: &Point, k: usize| {
            let of_limits = point.limits.iter().zip(&self.multipliers).map(|(limit, m)| m * limit.gradient[k]);
            point.gradient[k] + of_limits.sum::<f64>()
        };
        let s: Vec<f64> = (0..n).map(|k| now.x[k] - before.x[k]).collect();
        let y: Vec<f64> = (0..n).map(|k| lagrangian(now, k) - lagrangian(before, k)).collect();
        let square = dot(&s, &s);
        if square == 0.0 {
            return;
        }
        if !self.has_model {
            // The first curvature that was seen replaces the guess.
            let seen = (dot(&y, &y) / dot(&s, &y).abs().max(1e-12 * square)).clamp(1e-2 * FIRST, 1e2 * FIRST);
            self.model.fill(0.0);
            (0..n).for_each(|k| self.model[k * n + k] = seen);
            self.has_model = true;
        }
        let bs: Vec<f64> = (0..n).map(|k| dot(&self.model[k * n..(k + 1) * n], &s)).collect();
        let (sbs, sy) = (dot(&s, &bs), dot(&s, &y));
        let theta = if sy >= 0.2 * sbs { 1.0 } else { 0.8 * sbs / (sbs - sy) };
        let r: Vec<f64> = (0..n).map(|k| theta * y[k] + (1.0 - theta) * bs[k]).collect();
        let sr = dot(&s, &r);
        for i in 0..n {
            for j in 0..n {
                self.model[i * n + j] += r[i] * r[j] / sr - bs[i] * bs[j] / sbs;
            }
        }
    }

    /// The next step: the minimum of the model, limits by an augmented Lagrangian, bounds by clamping each variable.
    fn propose(&mut self) {
        let Some(at) = self.at.clone() else { return };
        let n = at.x.len();
        let low: Vec<f64> = (0..n).map(|k| (self.lower[k] - at.x[k]).min(0.0)).collect();
        let high: Vec<f64> = (0..n).map(|k| (self.upper[k] - at.x[k]).max(0.0)).collect();
        let mut d = vec![0.0; n];
        let mut multipliers = vec![0.0; at.limits.len()];
        let trace: f64 = (0..n).map(|k| self.model[k * n + k]).sum::<f64>() / n as f64;
        let penalty: Vec<f64> =
            at.limits.iter().map(|limit| 10.0 * trace / dot(&limit.gradient, &limit.gradient).max(1e-12)).collect();
        for _ in 0..ROUNDS {
            for _ in 0..SWEEPS {
                let mut most: f64 = 0.0;
                for k in 0..n {
                    let mut slope = at.gradient[k] + dot(&self.model[k * n..(k + 1) * n], &d);
                    let mut curvature = self.model[k * n + k];
                    for (i, limit) in at.limits.iter().enumerate() {
                        let force = multipliers[i] + penalty[i] * (limit.value + dot(&limit.gradient, &d));
                        if limit.is_equation || force > 0.0 {
                            slope += force * limit.gradient[k];
                            curvature += penalty[i] * limit.gradient[k] * limit.gradient[k];
                        }
                    }
                    let new = (d[k] - slope / curvature).clamp(low[k], high[k]);
                    most = most.max((new - d[k]).abs());
                    d[k] = new;
                }
                if most < 1e-10 {
                    break;
                }
            }
            for (i, limit) in at.limits.iter().enumerate() {
                let force = multipliers[i] + penalty[i] * (limit.value + dot(&limit.gradient, &d));
                multipliers[i] = if limit.is_equation { force } else { force.max(0.0) };
            }
        }
        let largest = multipliers.iter().fold(0.0, |most: f64, m| most.max(m.abs()));
        self.weight = self.weight.max(1.5 * largest);
        (self.multipliers, self.step, self.share) = (multipliers, d, 1.0);
        self.asked = at.x.iter().zip(&self.step).map(|(x, d)| x + d).collect();
        // A guessed curvature may be too large for what the objective depends on little: then nothing would ever be tried.
        if !self.has_model && self.expected(&at) < WORTH && trace > LEAST * FIRST {
            self.model.iter_mut().for_each(|curvature| *curvature *= 0.1);
            return self.propose();
        }
        self.done = self.expected(&at) < WORTH || self.step.iter().all(|d| d.abs() < 1e-9);
    }
}
