//! The exact solution of heat conduction in a slab of two layers in contact.

use super::developed::bisected;
use std::f64::consts::PI;

/// Number of modes in the series; further modes have decayed at a time of 1e-4 / diffusivity.
const MODES: usize = 200;

/// The exact temperature: the steady solution and a series of modes of the composite slab (Carslaw and Jaeger 1959,
/// section 14.1; Ozisik 1993, chapter 8).
///
/// In layer 1, 0 < y < 1/2, a mode is sin(m y / a_1) / sin(m / 2 a_1), in layer 2 sin(m (1 - y) / a_2) / sin(m / 2 a_2), with
/// a = sqrt(diffusivity). With the effusivities e = k / a the flux is continuous where
///
/// e_1 cos(m / 2 a_1) sin(m / 2 a_2) + e_2 sin(m / 2 a_1) cos(m / 2 a_2) = 0,
///
/// and a mode decays as exp(-m^2 t).
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    conductivity: [f64; 2],
    modes: Vec<Mode>,
    /// a of both layers.
    roots: [f64; 2],
    /// Steady temperature of the interface.
    middle: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Mode {
    m: f64,
    /// Amplitudes of the sines in both layers.
    amplitude: [f64; 2],
}

impl Series {
    /// The series for ratios of the upper half's properties to the lower half's.
    pub fn new(conductivity_ratio: f64, capacity_ratio: f64) -> Self {
        let conductivity = [1.0, conductivity_ratio];
        let capacity = [1.0, capacity_ratio];
        let roots = [1.0, (conductivity_ratio / capacity_ratio).sqrt()];
        // Thickness over a, for both layers.
        let s = roots.map(|a| 0.5 / a);
        let effusivity: [f64; 2] = std::array::from_fn(|k| conductivity[k] / roots[k]);
        let condition = |m: f64| {
            effusivity[0] * (m * s[0]).cos() * (m * s[1]).sin() + effusivity[1] * (m * s[0]).sin() * (m * s[1]).cos()
        };
        let middle = conductivity[0] / (conductivity[0] + conductivity[1]);
        // The condition is (e_1 + e_2)/2 sin(m (s_1 + s_2)) + a smaller sine, so it changes sign once between two
        // adjacent points at which the first sine is 1 or -1.
        let between = |n: usize| {
            let at = |n: usize| (n as f64 + 0.5) * PI / (s[0] + s[1]);
            bisected([at(n), at(n + 1)], 80, condition)
        };
        let mode = |n: usize| {
            let m = between(n);
            let [p, q] = s.map(|s| m * s);
            // Amplitudes of the layers: continuous in temperature or, where both sines vanish, in flux.
            let share = match p.sin().abs().max(q.sin().abs()) > 1e-6 {
                true => [q.sin(), p.sin()],
                false => [effusivity[1] * q.cos(), -effusivity[0] * p.cos()],
            };
            // Integrals over a layer of thickness d = a s of sin^2(m x / a), and of sin and x sin, for the difference
            // between the initial and the steady temperature.
            let square = |k: usize, r: f64| roots[k] * (0.5 * s[k] - (2.0 * r).sin() / (4.0 * m));
            let one = |k: usize, r: f64| roots[k] * (1.0 - r.cos()) / m;
            let first = |k: usize, r: f64| roots[k] * roots[k] * (r.sin() - r * r.cos()) / (m * m);
            // T - T_end at the start: -(1 - 2 (1 - middle) y) in layer 1, -2 middle x in layer 2, x from the upper
            // wall.
            let given = capacity[0] * share[0] * (2.0 * (1.0 - middle) * first(0, p) - one(0, p))
                + capacity[1] * share[1] * (-2.0 * middle * first(1, q));
            let norm =
                capacity[0] * share[0] * share[0] * square(0, p) + capacity[1] * share[1] * share[1] * square(1, q);
            Mode { m, amplitude: share.map(|share| share * given / norm) }
        };
        Self { conductivity, roots, middle, modes: (0..MODES).map(mode).collect() }
    }

    /// The modes that have not decayed.
    fn alive(&self, time: f64) -> impl Iterator<Item = (&Mode, f64)> {
        self.modes.iter().map(move |mode| (mode, (-mode.m * mode.m * time).exp())).take_while(|(_, left)| *left > 1e-17)
    }

    pub fn temperature(&self, y: f64, time: f64) -> f64 {
        let (layer, x) = if y < 0.5 { (0, y) } else { (1, 1.0 - y) };
        let end = if layer == 0 { 1.0 - 2.0 * (1.0 - self.middle) * y } else { 2.0 * self.middle * x };
        let sine = |mode: &Mode| mode.amplitude[layer] * (mode.m * x / self.roots[layer]).sin();
        end + self.alive(time).map(|(mode, left)| sine(mode) * left).sum::<f64>()
    }

    /// The upward heat flux through the lower and the upper wall.
    pub fn wall_flux(&self, time: f64) -> [f64; 2] {
        let end = 2.0 * (1.0 - self.middle) * self.conductivity[0];
        let slope = |mode: &Mode, layer: usize| mode.amplitude[layer] * mode.m / self.roots[layer];
        let mut flux = [end; 2];
        for (mode, left) in self.alive(time) {
            flux[0] -= self.conductivity[0] * slope(mode, 0) * left;
            flux[1] += self.conductivity[1] * slope(mode, 1) * left;
        }
        flux
    }

    pub fn conductivity(&self) -> [f64; 2] {
        self.conductivity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_material_has_the_series_of_a_plate() {
        // T = 1 - y - sum 2/(n pi) sin(n pi y) exp(-n^2 pi^2 t) (Carslaw and Jaeger 1959, section 3.4).
        let series = Series::new(1.0, 1.0);
        for [y, t] in [[0.1, 0.003], [0.3, 0.01], [0.5, 0.05], [0.77, 0.1], [0.9, 1.0]] {
            let term = |n: f64| 2.0 / (n * PI) * (n * PI * y).sin() * (-n * n * PI * PI * t).exp();
            let plate = 1.0 - y - (1..300).map(|n| term(n as f64)).sum::<f64>();
            assert!((series.temperature(y, t) - plate).abs() < 1e-12, "{y}, {t}");
        }
        assert!(series.temperature(0.3, 0.0005).abs() < 1e-12, "the heat has not come yet");
        let flux = series.wall_flux(0.001);
        assert!((flux[0] - 1.0 / (PI * 0.001).sqrt()).abs() < 1e-6 && flux[1].abs() < 1e-9, "{flux:?}");
    }

    #[test]
    fn two_materials_obey_the_equation_and_the_interface() {
        for (k, c) in [(1000.0, 1000.0), (10.0, 1.0), (0.01, 0.5), (3.0, 7.0)] {
            let series = Series::new(k, c);
            let (h, alpha) = (1e-4, [1.0, k / c]);
            let t = 0.07 / alpha[1].max(1.0);
            for y in [0.05, 0.2, 0.41, 0.6, 0.8, 0.95] {
                let at = |y: f64, t: f64| series.temperature(y, t);
                let by_t = (at(y, t * 1.001) - at(y, t * 0.999)) / (0.002 * t);
                let spread = (at(y + h, t) - 2.0 * at(y, t) + at(y - h, t)) / (h * h);
                let residual = by_t - alpha[(y > 0.5) as usize] * spread;
                assert!(residual.abs() < 1e-3 * by_t.abs().max(1.0), "{k}, {c}: {residual} of {by_t} at {y}");
            }
            let near = |y: f64| series.temperature(y, t);
            assert!((near(0.5 - 1e-9) - near(0.5)).abs() < 1e-6);
            let slope = |y: f64| (near(y + 2.0 * h) - near(y)) / (2.0 * h);
            let (below, above) = (-slope(0.5 - 3.0 * h), -k * slope(0.5 + h));
            assert!((below - above).abs() < 0.02 * below.abs().max(0.05), "{k}, {c}: {below}, {above}");
            assert!((near(0.0) - 1.0).abs() < 1e-9 && near(1.0).abs() < 1e-9);
            // The steady flux is that of two resistances in series.
            let [lower, upper] = series.wall_flux(1e4);
            assert!((lower - 1.0 / (0.5 + 0.5 / k)).abs() < 1e-9 && (lower - upper).abs() < 1e-9);
            // The heat that has passed through the walls equals the heat in the slab.
            let held: f64 = (0..4000)
                .map(|j| (j as f64 + 0.5) / 4000.0)
                .map(|y| (if y < 0.5 { 1.0 } else { c }) * near(y) / 4000.0)
                .sum();
            let steps = 20_000;
            let come: f64 = (0..steps)
                .map(|j| {
                    // Even in sqrt(t), because the flux begins as 1/sqrt(t).
                    let (a, b) = (j as f64 / steps as f64, (j + 1) as f64 / steps as f64);
                    let [lower, upper] = series.wall_flux(t * (0.5 * (a + b)).powi(2));
                    (lower - upper) * t * (b * b - a * a)
                })
                .sum();
            // (The series of the flux is truncated at the start.)
            assert!((come / held - 1.0).abs() < 0.02, "{k}, {c}: {come} of {held}");
        }
    }
}
