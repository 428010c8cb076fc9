//! L-BFGS-B (Byrd, Lu, Nocedal and Zhu 1995): quasi-Newton steps within bounds, for expensive functions.
//!
//! At a point x with gradient g, the function is approximated by the quadratic m(z) = g.z + z.B z / 2 of the step z. B
//! comes from the last ten pairs s = x' - x, y = g' - g with s.y > 0 by the BFGS formula
//!
//! ```text
//!   B <- B - (B s)(B s)' / (s.B s) + y y' / (s.y),      beginning with  B = theta I,  theta = y.y / s.y of the last pair
//! ```
//!
//! pair by pair, oldest first. (The paper's compact form of the same matrix is worthwhile for millions of variables; a
//! design has ten to a thousand.) The next point is found as in the paper. The first minimum of m along the projected
//! steepest descent (generalised Cauchy point, algorithm CP) determines the variables that stay at a bound. The minimum
//! of m over the others (section 5) is projected onto the bounds if that is still a descent (Morales and Nocedal 2011),
//! else the step is shortened. A line search goes towards that point.
//!
//! **Limits beyond bounds.** If neighbours are limited too, and the point violates these limits, m is instead minimised
//! over the whole convex set, by projected gradients with steps of Barzilai and Borwein (Schmidt, van den Berg,
//! Friedlander and Murphy 2009, algorithm 1). Both ends of the line search are in the set, and so are all points
//! between them, so no projection spoils a pair (s, y).
//!
//! **Line search.** Weak Wolfe conditions by bisection (Lewis and Overton 2013, algorithm 2.6), which also works for a
//! function with small jumps; close to a minimum, where differences of values are rounding, the approximate condition
//! by slopes (Hager and Zhang 2005, section 2). A value that is not finite counts as too high.
//!
//! The first step changes no variable by more than `first_step`: without a pair the scale of B is chosen accordingly.
//!
//! Why no crate: `argmin` has no bounds in its L-BFGS, `lbfgsb-rs-pure` calls a closure and hides its state, `lbfgsb`
//! wraps a C translation. None can be stopped between two evaluations of a line search and resume to the bit, and none
//! supports limits between neighbours.

use super::{count, numbers, Optimiser, Record};
use crate::design::limits::Limits;
use crate::error::BadInput;
use crate::io::tensor_file::TensorFile;

/// Number of pairs that are kept.
const MEMORY: usize = 10;
/// Constants of sufficient decrease and curvature in the Wolfe conditions.
const DECREASE: f64 = 1e-4;
const CURVATURE: f64 = 0.5;
/// Relative difference of values that is indistinguishable from rounding.
const INDISTINGUISHABLE: f64 = 1e-8;
/// Evaluations of a line search after which any decrease is accepted, and after which it has failed.
const PATIENCE: usize = 10;
const MOST_TRIES: usize = 40;
/// Smallest predicted decrease relative to the value that is worth an evaluation.
const NO_FALL: f64 = 1e-24;
/// Longest step of a line search, in multiples of the direction.
const LONGEST: f64 = 1e10;
/// Largest number of projected gradient steps within a set.
const SET_STEPS: usize = 500;

#[derive(Debug, Clone, PartialEq)]
pub struct LBfgsB {
    /// Largest change of a variable in the first step.
    pub first_step: f64,
    /// See [`Self::worth`].
    worth: f64,
    evaluations: usize,
    /// The last accepted point, with value and gradient.
    point: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
    /// Pairs (s, y), oldest first.
    pairs: Vec<Pair>,
    search: Search,
    /// The point to evaluate next.
    trial: Vec<f64>,
    done: bool,
}

/// A step s and the gradient's change y.
type Pair = (Vec<f64>, Vec<f64>);

/// A line search at point + step * direction.
#[derive(Debug, Clone, PartialEq)]
struct Search {
    direction: Vec<f64>,
    /// Slope along the direction at its start.
    slope: f64,
    step: f64,
    /// The bracket; `high` is [`f64::MAX`] while there is none.
    low: f64,
    high: f64,
    /// The step at which the limits end.
    longest: f64,
    tries: usize,
}

impl LBfgsB {
    /// Starts at `x`, which is within the limits.
    pub fn new(first_step: f64, x: &[f64]) -> Self {
        Self {
            first_step,
            worth: 0.0,
            evaluations: 0,
            point: x.to_vec(),
            value: 0.0,
            gradient: vec![0.0; x.len()],
            pairs: Vec::new(),
            search: Search { step: 0.0, ..Search::along(vec![0.0; x.len()], 0.0, 0.0) },
            trial: x.to_vec(),
            done: false,
        }
    }

    /// Ends the search when an accepted step lowers the value by less than this fraction of it.
    pub fn worth(self, worth: f64) -> Self {
        Self { worth, ..self }
    }

    /// Starts a line search from the present point.
    fn begin(&mut self, limits: &Limits) {
        loop {
            let direction = self.direction(limits);
            let slope = dot(&self.gradient, &direction);
            if slope < -NO_FALL * self.value.abs() {
                let longest = longest(&self.point, &direction, limits);
                self.search = Search::along(direction, slope, longest);
                return self.propose(limits);
            }
            if self.pairs.is_empty() {
                return self.finish();
            }
            self.pairs.clear();
        }
    }

    /// Chooses the trial point at the search's step.
    fn propose(&mut self, limits: &Limits) {
        self.trial = moved(&self.point, self.search.step, &self.search.direction);
        // Rounding may have violated the limits.
        limits.project(&mut self.trial);
        if self.trial == self.point || self.search.tries >= MOST_TRIES {
            if self.pairs.is_empty() {
                return self.finish();
            }
            self.pairs.clear();
            self.begin(limits);
        }
    }

    fn finish(&mut self) {
        self.done = true;
        self.trial.clone_from(&self.point);
    }

    /// Makes the trial point the present one, and updates the pairs.
    fn accept(&mut self, value: f64, gradient: &[f64]) {
        let s = moved(&self.trial, -1.0, &self.point);
        let y = moved(gradient, -1.0, &self.gradient);
        if dot(&s, &y) > 1e-10 * (dot(&s, &s) * dot(&y, &y)).sqrt() {
            if self.pairs.len() == MEMORY {
                self.pairs.remove(0);
            }
            self.pairs.push((s, y));
        }
        self.point.clone_from(&self.trial);
        self.value = value;
        self.gradient = gradient.to_vec();
    }

    /// The step from the present point to the minimum of the model within the limits.
    fn direction(&self, limits: &Limits) -> Vec<f64> {
        let model = Quadratic { gradient: &self.gradient, hessian: self.hessian() };
        let mut end = model.minimum_in_bounds(&self.point, limits);
        if !limits.contains(&end) {
            end = model.minimum_in_set(&self.point, limits);
        }
        moved(&end, -1.0, &self.point)
    }

    /// B, row by row.
    fn hessian(&self) -> Vec<Vec<f64>> {
        let n = self.point.len();
        let scale = match self.pairs.last() {
            Some((s, y)) => dot(y, y) / dot(s, y),
            None => self.gradient.iter().fold(0.0, |most: f64, g| most.max(g.abs())) / self.first_step,
        };
        let mut b: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| if i == j { scale } else { 0.0 }).collect()).collect();
        for (s, y) in &self.pairs {
            let bs = product(&b, s);
            let (sbs, sy) = (dot(s, &bs), dot(s, y));
            for i in 0..n {
                for j in 0..n {
                    b[i][j] += y[i] * y[j] / sy - bs[i] * bs[j] / sbs;
                }
            }
        }
        b
    }

    /// Whether a trial decreases sufficiently (DECREASE), or equals the value to rounding and has a slope of descent.
    fn falls(&self, value: f64, slope: f64) -> bool {
        let search = &self.search;
        value <= self.value + DECREASE * search.step * search.slope
            || (value <= self.value + INDISTINGUISHABLE * self.value.abs()
                && slope <= (2.0 * DECREASE - 1.0) * search.slope)
    }
}

impl Search {
    fn along(direction: Vec<f64>, slope: f64, longest: f64) -> Self {
        Self { direction, slope, step: 1.0, low: 0.0, high: f64::MAX, longest, tries: 0 }
    }

    /// Shortens a step whose value is too high or not finite.
    fn shorten(&mut self, rise: f64) {
        self.high = self.step;
        let middle = 0.5 * (self.low + self.high);
        // The parabola through value and slope at the start and the value here.
        let parabola = -0.5 * self.slope * self.step * self.step / (rise - self.slope * self.step);
        self.step = match self.low == 0.0 && parabola.is_finite() {
            true => parabola.clamp(0.1 * self.high, 0.5 * self.high),
            false => middle,
        };
    }

    /// Lengthens a step at which the function still falls steeply.
    fn lengthen(&mut self, slope: f64) {
        self.low = self.step;
        // The step at which the slope of a parabola is zero.
        let parabola = self.step * self.slope / (self.slope - slope);
        self.step = match self.high < f64::MAX {
            true => 0.5 * (self.low + self.high),
            false if parabola > self.step => parabola.clamp(2.0 * self.step, 10.0 * self.step).min(self.longest),
            false => (10.0 * self.step).min(self.longest),
        };
    }
}

impl Optimiser for LBfgsB {
    fn name(&self) -> &str {
        "l-bfgs-b"
    }

    fn ask(&self) -> &[f64] {
        &self.trial
    }

    fn tell(&mut self, limits: &Limits, value: f64, gradient: &[f64]) {
        if self.done {
            return;
        }
        self.evaluations += 1;
        let is_finite = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        if self.evaluations == 1 {
            if !is_finite {
                return self.finish();
            }
            (self.value, self.gradient) = (value, gradient.to_vec());
            return self.begin(limits);
        }
        let slope = dot(gradient, &self.search.direction);
        if !is_finite || !self.falls(value, slope) {
            self.search.shorten(value - self.value);
        } else if slope < CURVATURE * self.search.slope
            && self.search.step < self.search.longest
            && self.search.tries < PATIENCE
        {
            self.search.lengthen(slope);
        } else {
            let fall = self.value - value;
            self.accept(value, gradient);
            if fall < self.worth * value.abs() {
                return self.finish();
            }
            return self.begin(limits);
        }
        self.search.tries += 1;
        self.propose(limits);
    }

    fn is_done(&self) -> bool {
        self.done
    }

    fn save(&self, record: &mut Record) {
        let (n, pairs, search) = (self.point.len(), self.pairs.len(), &self.search);
        let rows = |of: fn(&Pair) -> &Vec<f64>| self.pairs.iter().flat_map(of).copied().collect();
        record.put("l-bfgs-b.point", &[n], self.point.clone());
        record.put("l-bfgs-b.gradient", &[n], self.gradient.clone());
        record.put("l-bfgs-b.s", &[pairs, n], rows(|(s, _)| s));
        record.put("l-bfgs-b.y", &[pairs, n], rows(|(_, y)| y));
        record.put("l-bfgs-b.direction", &[n], search.direction.clone());
        let scalars = [self.value, search.slope, search.step, search.low, search.high, search.longest];
        record.put("l-bfgs-b.scalars", &[scalars.len()], scalars.to_vec());
        record.note("l-bfgs-b.pairs", pairs);
        record.note("l-bfgs-b.evaluations", self.evaluations);
        record.note("l-bfgs-b.tries", search.tries);
        record.note("l-bfgs-b.done", usize::from(self.done));
    }

    fn restore(&mut self, file: &TensorFile) -> Result<(), BadInput> {
        let (n, pairs) = (self.trial.len(), count(file, "l-bfgs-b.pairs")?);
        self.point = numbers(file, "l-bfgs-b.point", &[n])?;
        self.gradient = numbers(file, "l-bfgs-b.gradient", &[n])?;
        let (s, y) = (numbers(file, "l-bfgs-b.s", &[pairs, n])?, numbers(file, "l-bfgs-b.y", &[pairs, n])?);
        let row = |of: &[f64], k: usize| of[k * n..(k + 1) * n].to_vec();
        self.pairs = (0..pairs).map(|k| (row(&s, k), row(&y, k))).collect();
        self.search.direction = numbers(file, "l-bfgs-b.direction", &[n])?;
        let scalars = numbers(file, "l-bfgs-b.scalars", &[6])?;
        self.value = scalars[0];
        let search = &mut self.search;
        (search.slope, search.step, search.low) = (scalars[1], scalars[2], scalars[3]);
        (search.high, search.longest) = (scalars[4], scalars[5]);
        search.tries = count(file, "l-bfgs-b.tries")?;
        self.evaluations = count(file, "l-bfgs-b.evaluations")?;
        self.done = count(file, "l-bfgs-b.done")? == 1;
        Ok(())
    }
}

/// m(z) = g.z + z.B z / 2.
struct Quadratic<'a> {
    gradient: &'a [f64],
    hessian: Vec<Vec<f64>>,
}

impl Quadratic<'_> {
    /// An approximate minimum of the model within the bounds: the minimum over the variables that are not at a bound at
    /// the generalised Cauchy point.
    fn minimum_in_bounds(&self, x: &[f64], limits: &Limits) -> Vec<f64> {
        let cauchy = self.cauchy_point(x, limits);
        let z = moved(&cauchy, -1.0, x);
        let slope = moved(self.gradient, 1.0, &product(&self.hessian, &z));
        let free: Vec<usize> =
            (0..x.len()).filter(|&i| limits.lower[i] < cauchy[i] && cauchy[i] < limits.upper[i]).collect();
        let part: Vec<Vec<f64>> = free.iter().map(|&i| free.iter().map(|&j| self.hessian[i][j]).collect()).collect();
        let down: Vec<f64> = free.iter().map(|&i| -slope[i]).collect();
        let Some(found) = solve(part, down) else {
            return cauchy;
        };
        let mut step = vec![0.0; x.len()];
        free.iter().zip(found).for_each(|(&i, v)| step[i] = v);
        let mut end = moved(&cauchy, 1.0, &step);
        limits.clamp(&mut end);
        if dot(self.gradient, &moved(&end, -1.0, x)) < 0.0 {
            return end;
        }
        let share = longest(&cauchy, &step, limits).min(1.0);
        let mut end = moved(&cauchy, share, &step);
        limits.clamp(&mut end);
        end
    }

    /// The first minimum of the model along the path of steepest descent, which bends at bounds.
    fn cauchy_point(&self, x: &[f64], limits: &Limits) -> Vec<f64> {
        let bound = |i: usize| if self.gradient[i] > 0.0 { limits.lower[i] } else { limits.upper[i] };
        let reach = |i: usize| match self.gradient[i] {
            0.0 => f64::INFINITY,
            g => (x[i] - bound(i)) / g,
        };
        let until: Vec<f64> = (0..x.len()).map(reach).collect();
        let mut d: Vec<f64> = self.gradient.iter().zip(&until).map(|(g, t)| if *t > 0.0 { -g } else { 0.0 }).collect();
        let (mut end, mut t) = (x.to_vec(), 0.0);
        loop {
            let bd = product(&self.hessian, &d);
            let slope = dot(self.gradient, &d) + dot(&moved(&end, -1.0, x), &bd);
            let curvature = dot(&d, &bd);
            if slope >= 0.0 || curvature <= 0.0 {
                return end;
            }
            let next = (0..x.len()).filter(|&i| d[i] != 0.0).map(|i| until[i]).fold(f64::INFINITY, f64::min);
            let step = -slope / curvature;
            if t + step < next {
                return moved(&end, step, &d);
            }
            end = moved(&end, next - t, &d);
            t = next;
            for i in (0..x.len()).filter(|&i| until[i] <= next) {
                if d[i] != 0.0 {
                    end[i] = bound(i);
                    d[i] = 0.0;
                }
            }
        }
    }

    /// An approximate minimum of the model within all limits, sufficient for descent.
    fn minimum_in_set(&self, x: &[f64], limits: &Limits) -> Vec<f64> {
        let mut end = x.to_vec();
        let mut slope = self.gradient.to_vec();
        let mut length = 1.0 / (0..x.len()).map(|i| self.hessian[i][i]).fold(0.0, f64::max);
        for _ in 0..SET_STEPS {
            let mut aim = moved(&end, -length, &slope);
            limits.nearest(&mut aim);
            let way = moved(&aim, -1.0, &end);
            let bent = product(&self.hessian, &way);
            let (fall, curvature) = (dot(&slope, &way), dot(&way, &bent));
            let far = dot(&moved(&end, -1.0, x), &moved(&end, -1.0, x));
            if fall >= 0.0 || curvature <= 0.0 || dot(&way, &way) <= 1e-20 * far {
                break;
            }
            let step = (-fall / curvature).min(1.0);
            end = moved(&end, step, &way);
            slope = moved(&slope, step, &bent);
            length = dot(&way, &way) / curvature;
        }
        limits.project(&mut end);
        end
    }
}

/// The longest step from x along d within the limits: to the bounds if there are no others, else one whole direction.
fn longest(x: &[f64], d: &[f64], limits: &Limits) -> f64 {
    let room = |i: usize| match d[i] {
        d if d > 0.0 => (limits.upper[i] - x[i]) / d,
        d if d < 0.0 => (limits.lower[i] - x[i]) / d,
        _ => f64::INFINITY,
    };
    let most = (0..x.len()).map(room).fold(LONGEST, f64::min);
    let mut there = moved(x, most, d);
    limits.clamp(&mut there);
    match limits.contains(&there) {
        true => most,
        false => most.min(1.0),
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// a + t b.
fn moved(a: &[f64], t: f64, b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + t * b).collect()
}

fn product(matrix: &[Vec<f64>], x: &[f64]) -> Vec<f64> {
    matrix.iter().map(|row| dot(row, x)).collect()
}

/// The solution of a x = b by Cholesky's decomposition; none if the symmetric matrix is not positive definite.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    for j in 0..n {
        for k in 0..j {
            for i in j..n {
                a[i][j] -= a[i][k] * a[j][k];
            }
        }
        let root = a[j][j].sqrt();
        if !(root > 0.0 && root.is_finite()) {
            return None;
        }
        for i in j..n {
            a[i][j] /= root;
        }
    }
    for i in 0..n {
        for k in 0..i {
            b[i] -= a[i][k] * b[k];
        }
        b[i] /= a[i][i];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            b[i] -= a[k][i] * b[k];
        }
        b[i] /= a[i][i];
    }
    Some(b)
}
