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
