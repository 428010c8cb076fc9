//! A smooth curve through values at times: cubics between neighbours, with the slopes of parabolas through three.
//!
//! Its values, slopes and integrals are linear in the values that it goes through. So they are given as weights of these, and are
//! their own derivatives. The curve has a continuous slope: its integral has two continuous derivatives by its ends, wherever these
//! lie between times. (With straight lines instead, differences of such an integral by its ends have errors of first order.)

/// Weights of some of the values.
pub type Weights = Vec<(usize, f64)>;

/// The sum of weighted values.
pub fn sum(weights: &[(usize, f64)], values: &[f64]) -> f64 {
    weights.iter().map(|&(k, weight)| weight * values[k]).sum()
}

/// What is asked of a cubic, at a share of its interval.
#[derive(Clone, Copy)]
enum Ask {
    Value,
    Slope,
    /// From the beginning of the interval.
    Integral,
}

/// Times of values, ascending, three at least.
#[derive(Debug, Clone, Copy)]
pub struct Curve<'a>(&'a [f64]);

impl<'a> Curve<'a> {
    /// None with fewer than three times.
    pub fn new(times: &'a [f64]) -> Option<Self> {
        (times.len() > 2).then_some(Self(times))
    }

    /// The slope at time k, of the parabola through it and its neighbours.
    fn slope_at(&self, k: usize) -> [(usize, f64); 3] {
        let first = k.saturating_sub(1).min(self.0.len() - 3);
        std::array::from_fn(|a| {
            let [a, b, c] = [a, (a + 1) % 3, (a + 2) % 3].map(|x| first + x);
            let t = |k: usize| self.0[k];
            (a, (2.0 * t(k) - t(b) - t(c)) / ((t(a) - t(b)) * (t(a) - t(c))))
        })
    }

    /// The interval of a time, and the share of it that is before the time.
    fn interval(&self, time: f64) -> (usize, f64) {
        let j = self.0.partition_point(|&t| t <= time).clamp(1, self.0.len() - 1) - 1;
        (j, (time - self.0[j]) / (self.0[j + 1] - self.0[j]))
    }

    fn of(&self, (j, x): (usize, f64), ask: Ask) -> Weights {
        let h = self.0[j + 1] - self.0[j];
        let (x2, x3, x4) = (x * x, x * x * x, x * x * x * x);
        // Of the values at both ends, and of the slopes there.
        let (values, slopes) = match ask {
            Ask::Value => ([1.0 - 3.0 * x2 + 2.0 * x3, 3.0 * x2 - 2.0 * x3], [h * (x - 2.0 * x2 + x3), h * (x3 - x2)]),
            Ask::Slope => {
                let steep = 6.0 * (x - x2) / h;
                ([-steep, steep], [1.0 - 4.0 * x + 3.0 * x2, 3.0 * x2 - 2.0 * x])
            }
            Ask::Integral => (
                [h * (x - x3 + 0.5 * x4), h * (x3 - 0.5 * x4)],
                [h * h * (0.5 * x2 - 2.0 / 3.0 * x3 + 0.25 * x4), h * h * (0.25 * x4 - x3 / 3.0)],
            ),
        };
        let mut all = vec![(j, values[0]), (j + 1, values[1])];
        for (k, slope) in [(j, slopes[0]), (j + 1, slopes[1])] {
            all.extend(self.slope_at(k).map(|(i, weight)| (i, slope * weight)));
        }
        all
    }

    pub fn value(&self, time: f64) -> Weights {
        self.of(self.interval(time), Ask::Value)
    }

    pub fn slope(&self, time: f64) -> Weights {
        self.of(self.interval(time), Ask::Slope)
    }

    /// The weight of every value in the integral from one time to another.
    pub fn integral(&self, from: f64, to: f64) -> Vec<f64> {
        let mut weights = vec![0.0; self.0.len()];
        let mut add = |at: (usize, f64), sign: f64| {
            self.of(at, Ask::Integral).into_iter().for_each(|(k, weight)| weights[k] += sign * weight);
        };
        let (first, last) = (self.interval(from), self.interval(to));
        (first.0..last.0).for_each(|j| add((j, 1.0), 1.0));
        add(first, -1.0);
        add(last, 1.0);
        weights
    }

    /// The time in an interval at which the curve has a value that is between those of its ends, by bisection.
    pub fn crossing(&self, j: usize, values: &[f64], level: f64) -> f64 {
        let above = |x: f64| sum(&self.of((j, x), Ask::Value), values) > level;
        let (mut low, mut high) = (0.0, 1.0);
        let rises = values[j + 1] > values[j];
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            *(if above(middle) == rises { &mut high } else { &mut low }) = middle;
        }
        self.0[j] + 0.5 * (low + high) * (self.0[j + 1] - self.0[j])
    }
}

/// The intervals in which values rise through a level, after they were below it by more than `band` (so that noise makes none).
pub fn rises(values: &[f64], level: f64, band: f64) -> Vec<usize> {
    let (mut is_low, mut found) = (false, vec![]);
    for (j, pair) in values.windows(2).enumerate() {
        is_low |= pair[0] < level - band;
        if is_low && pair[0] < level && pair[1] >= level {
            found.push(j);
            is_low = false;
        }
    }
    found
}
