//! Developed flow between warm walls: the exact solution of the isothermal channel.

use crate::config::scene::UpperWall;

/// The velocity profile of developed flow.
pub fn parabola(y: f64) -> f64 {
    (4.0 * y * (1.0 - y)).max(0.0)
}
/// Mean of [`parabola`].
const MEAN_VELOCITY: f64 = 2.0 / 3.0;
/// Twice the height.
const HYDRAULIC_DIAMETER: f64 = 2.0;

/// The developed temperature profile: T_wall - T = f(y) exp(-b x) with
///
/// alpha (f'' + b^2 f) + b u f = 0, where f = 0 on a warm wall and f' = 0 on an adiabatic one.
///
/// b^2 is conduction along the channel. Without it, for large Peclet numbers, the Nusselt number is 7.5407, and with
/// one wall adiabatic 4.8608 (Shah and London 1978, tables 33 and 48).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Developed {
    diffusivity: f64,
    upper_wall: UpperWall,
    /// Nusselt number by the hydraulic diameter.
    pub nusselt: f64,
    /// The range of x in which the profile is developed; none if the warm walls end before.
    pub section: Option<[f64; 2]>,
}

/// The zero of a function between two places where its signs differ, after a number of bisections.
pub(super) fn bisected([mut low, mut high]: [f64; 2], times: usize, f: impl Fn(f64) -> f64) -> f64 {
    let below = f(low) > 0.0;
    for _ in 0..times {
        let half = 0.5 * (low + high);
        if (f(half) > 0.0) == below {
            low = half;
        } else {
            high = half;
        }
    }
    0.5 * (low + high)
}

/// Number of points across the channel in a solution.
const POINTS: usize = 1000;

impl Developed {
    /// The solution between walls that are warm from `hot[0]` to `hot[1]`. The profile is developed from where the next
    /// mode has decayed to 1 % to half a height before the end.
    pub fn new(diffusivity: f64, upper_wall: UpperWall, hot: [f64; 2]) -> Self {
        let mut developed = Self { diffusivity, upper_wall, nusselt: f64::NAN, section: None };
        let first = developed.decay(0);
        // With equal walls the second mode is odd about the centre line and is not excited.
        let next = developed.decay(if upper_wall == UpperWall::Isothermal { 2 } else { 1 });
        // D f'(0) over the mixed temperature.
        developed.nusselt = HYDRAULIC_DIAMETER / developed.across(first).1;
        let section = [hot[0] + 100_f64.ln() / (next - first), hot[1] - 0.5];
        developed.section = (section[1] - section[0] >= 0.5).then_some(section);
        developed
    }

    /// f and its slope at the upper wall for a value of b, from f = 0 and f' = 1 at the lower one, and the mean of u f
    /// over that of u, by the fourth-order Runge-Kutta method and Simpson's rule.
    fn across(&self, b: f64) -> ([f64; 2], f64) {
        let h = 1.0 / POINTS as f64;
        let bend = |y: f64, f: f64| -(b * b + b * parabola(y) / self.diffusivity) * f;
        let (mut f, mut slope, mut sum) = (0.0, 1.0, 0.0);
        for k in 0..POINTS {
            let y = k as f64 * h;
            let (f1, s1) = (slope, bend(y, f));
            let (f2, s2) = (slope + 0.5 * h * s1, bend(y + 0.5 * h, f + 0.5 * h * f1));
            let (f3, s3) = (slope + 0.5 * h * s2, bend(y + 0.5 * h, f + 0.5 * h * f2));
            let (f4, s4) = (slope + h * s3, bend(y + h, f + h * f3));
            let half = f + 0.5 * h * f2;
            let next = f + h / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4);
            sum += h / 6.0 * (parabola(y) * f + 4.0 * parabola(y + 0.5 * h) * half + parabola(y + h) * next);
            (f, slope) = (next, slope + h / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4));
        }
        ([f, slope], sum / MEAN_VELOCITY)
    }

    /// The decay rate b of the temperature difference: the smallest one (0), or the next ones.
    pub fn decay(&self, number: usize) -> f64 {
        let end = |b: f64| self.across(b).0[(self.upper_wall == UpperWall::Adiabatic) as usize];
        let step = 0.2 * self.diffusivity.min(1.0);
        let (mut low, mut left) = (0.0, number);
        loop {
            let high = low + step;
            if (end(low) > 0.0) != (end(high) > 0.0) {
                if left == 0 {
                    break;
                }
                left -= 1;
            }
            low = high;
        }
        bisected([low, low + step], 60, end)
    }

    /// The Nusselt number of particles with (x, V u, V, T_wall - T) by the heat balance of a part of the channel:
    /// (b U H + alpha b^2 H mean / mixed) D / (alpha walls). b is the slope of a line through the logarithm of the heat
    /// in slices. None where the flow is not developed.
    pub fn measured(&self, particles: impl Iterator<Item = [f64; 4]>) -> Option<f64> {
        let [from, to] = self.section?;
        let slices = (4.0 * (to - from)).floor().max(2.0) as usize;
        let width = (to - from) / slices as f64;
        // For each slice, the sums of V u, V u x, V u f, V f, V.
        let mut sums = vec![[0.0; 5]; slices];
        for [x, flow, volume, rest] in particles.filter(|[x, ..]| *x >= from && *x < to) {
            let slice = &mut sums[(((x - from) / width) as usize).min(slices - 1)];
            let terms = [flow, flow * x, flow * rest, volume * rest, volume];
            slice.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let points: Vec<[f64; 2]> = sums.iter().map(|s| [s[1] / s[0], (s[2] / s[0]).ln()]).collect();
        let mean = |k: usize| points.iter().map(|point| point[k]).sum::<f64>() / slices as f64;
        let (x, y) = (mean(0), mean(1));
        let (mut up, mut down) = (0.0, 0.0);
        for point in &points {
            up += (point[0] - x) * (point[1] - y);
            down += (point[0] - x).powi(2);
        }
        let b = -up / down;
        let shape = sums.iter().map(|s| s[3] / s[4] / (s[2] / s[0])).sum::<f64>() / slices as f64;
        let walls = if self.upper_wall == UpperWall::Isothermal { 2.0 } else { 1.0 };
        let per_height = b * MEAN_VELOCITY + self.diffusivity * b * b * shape;
        let nusselt = per_height * HYDRAULIC_DIAMETER / (self.diffusivity * walls);
        nusselt.is_finite().then_some(nusselt)
    }
}
