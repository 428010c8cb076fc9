//! Adam (Kingma and Ba 2015, algorithm 1) with moments that can be stored, and bounds by projection.
//!
//! m <- b1 m + (1-b1) g, v <- b2 v + (1-b2) g^2, x <- x - lr m^ / (sqrt(v^) + eps), m^ = m/(1-b1^t), v^ = v/(1-b2^t).
//! A step moves each variable by about `learning_rate`, whatever the gradient's scale: for wall offsets, 2e-2 is one
//! spacing per step at dx = 0.02.

#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    pub learning_rate: f64,
    pub first: Vec<f64>,
    pub second: Vec<f64>,
    pub steps: u64,
}

const FIRST_DECAY: f64 = 0.9;
const SECOND_DECAY: f64 = 0.999;
/// Smaller than any gradient that matters here (1e-4), larger than 0.
const EPSILON: f64 = 1e-12;

impl Adam {
    pub fn new(learning_rate: f64, variables: usize) -> Self {
        Self { learning_rate, first: vec![0.0; variables], second: vec![0.0; variables], steps: 0 }
    }

    /// One step against the gradient.
    pub fn step(&mut self, x: &mut [f64], gradient: &[f64]) {
        self.steps += 1;
        let first_share = 1.0 - FIRST_DECAY.powi(self.steps as i32);
        let second_share = 1.0 - SECOND_DECAY.powi(self.steps as i32);
        for k in 0..x.len() {
            let g = gradient[k];
            self.first[k] = FIRST_DECAY * self.first[k] + (1.0 - FIRST_DECAY) * g;
            self.second[k] = SECOND_DECAY * self.second[k] + (1.0 - SECOND_DECAY) * g * g;
            let (m, v) = (self.first[k] / first_share, self.second[k] / second_share);
            x[k] -= self.learning_rate * m / (v.sqrt() + EPSILON);
        }
    }
}

/// Projects offsets to |offset| <= bound and to neighbours no steeper than `slope`, sweeping from the middle outwards.
pub fn project(offsets: &mut [f64], nodes: &[f64], bound: f64, slope: f64) {
    offsets.iter_mut().for_each(|o| *o = o.clamp(-bound, bound));
    let middle = offsets.len() / 2;
    let mut limit = |from: usize, to: usize| {
        // A little inside, so that the shape passes its own check after rounding.
        let most = slope * (nodes[to] - nodes[from]).abs() * (1.0 - 1e-12);
        offsets[to] = offsets[to].clamp(offsets[from] - most, offsets[from] + most);
    };
    (middle + 1..nodes.len()).for_each(|k| limit(k - 1, k));
    (0..middle).rev().for_each(|k| limit(k + 1, k));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_steps_by_hand() {
        // The first step is lr * sign(g); the second, with g = (1, -1) then (1, 3), follows from the formulas.
        let mut adam = Adam::new(0.1, 2);
        let mut x = [0.0, 0.0];
        adam.step(&mut x, &[1.0, -1.0]);
        assert!((x[0] + 0.1).abs() < 1e-9 && (x[1] - 0.1).abs() < 1e-9);
        adam.step(&mut x, &[1.0, 3.0]);
        let (m, v) = ((0.9 * -0.1 + 0.1 * 3.0) / 0.19, (0.999 * 0.001 + 0.001 * 9.0) / (1.0 - 0.999f64.powi(2)));
        assert!((x[0] + 0.2).abs() < 1e-9);
        assert!((x[1] - (0.1 - 0.1 * m / v.sqrt())).abs() < 1e-9);
    }

    #[test]
    fn finds_the_minimum_of_a_quadratic_within_bounds() {
        let target = [0.3, -5.0, 0.02];
        let nodes = [0.0, 100.0, 200.0];
        let mut x = [0.0; 3];
        let mut adam = Adam::new(0.02, 3);
        for _ in 0..400 {
            let gradient: Vec<f64> = x.iter().zip(target).map(|(x, t)| 2.0 * (x - t)).collect();
            adam.step(&mut x, &gradient);
            project(&mut x, &nodes, 1.0, 2.0);
        }
        assert!((x[0] - 0.3).abs() < 1e-2 && x[1] == -1.0 && (x[2] - 0.02).abs() < 1e-2, "{x:?}");
    }

    #[test]
    fn projection_limits_slopes() {
        let nodes = [0.0, 0.01, 0.02, 0.03];
        let mut x = [0.05, -0.05, 0.05, 0.0];
        project(&mut x, &nodes, 0.04, 2.0);
        for k in 1..4 {
            assert!((x[k] - x[k - 1]).abs() <= 0.02, "{x:?}");
        }
        assert_eq!(x[2], 0.04);
    }
}
