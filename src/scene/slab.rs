//! Heat conduction in a slab at rest, between two walls with temperatures of their own: of one material, or of two with a
//! jump of conductivity half way (Cleary and Monaghan 1999, section 5).
//!
//! Width, density, and the lower half's conductivity and heat capacity are 1, so times are in width^2 over the lower half's
//! diffusivity. The slab lies across y as [`super::poiseuille`]'s channel does, and has the upper wall's temperature 0 when
//! the lower wall takes on its temperature 1.

use super::assembly::{count, Lattice, Numerics, Parts, WallHeat};
use super::surface::Settings;
use super::{Exact, Scene};
use crate::config::scene::{Config, ShiftName};
use crate::numerics::lanes::Real;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::model::Materials;
use std::f64::consts::PI;
use std::sync::Arc;

/// The slab and how it is resolved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slab {
    /// Particles across it.
    pub rows: usize,
    /// Particles along it.
    pub columns: usize,
    /// Of the upper half, over that of the lower half.
    pub conductivity_ratio: f64,
    pub capacity_ratio: f64,
    pub numerics: Numerics,
}

impl Slab {
    /// The slab of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        // At rest nothing needs to be kept in order or slowed down.
        let usual = Numerics::from_config(config);
        let numerics = Numerics {
            consistent: usual.consistent.map(|settings| Settings { shift: ShiftName::None, ..settings }),
            background_pressure_factor: 0.0,
            transport_velocity: 0.0,
            artificial_viscosity: 0.0,
            jitter: 0.0,
            ..usual
        };
        let (conductivity_ratio, capacity_ratio) = (config.heat.conductivity_ratio, config.heat.capacity_ratio);
        Self { rows: count(config, 1.0), columns: 8, conductivity_ratio, capacity_ratio, numerics }
    }

    pub fn build<R: Real>(&self) -> Scene<R> {
        let lattice = Lattice::channel(self.columns, self.rows, self.numerics.wall_rows);
        let is_upper = |i: usize| 2 * lattice.rows(i)[1] >= lattice.cells[1];
        let of = |ratio: f64| (0..lattice.particles()).map(|i| R::of(if is_upper(i) { ratio } else { 1.0 })).collect();
        let materials = (self.conductivity_ratio != 1.0 || self.capacity_ratio != 1.0)
            .then(|| Materials { conductivity: of(self.conductivity_ratio), capacity: of(self.capacity_ratio) });
        let (walls, nowhere) = ([1.0, 0.0].map(WallHeat::isothermal), [f64::NEG_INFINITY, f64::INFINITY]);
        Parts {
            name: "slab",
            lattice,
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: 1.0,
            body_force: BodyForce::None,
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Slab(Arc::new(Series::new(self.conductivity_ratio, self.capacity_ratio))),
        }
        .warm(1.0, nowhere, walls, materials)
        .build(|_| [0.0; 3])
    }
}

/// Most modes that the series has; what is left out has died out at a time of 1e-4 / diffusivity.
const MODES: usize = 200;

/// The exact temperature: the steady one and a series of modes of the composite slab (Carslaw and Jaeger 1959, section 14.1;
/// Ozisik 1993, chapter 8).
///
/// In layer 1, 0 < y < 1/2, a mode is sin(m y / a_1) / sin(m / 2 a_1), in layer 2 sin(m (1 - y) / a_2) / sin(m / 2 a_2), with
/// a = sqrt(diffusivity); the flux is continuous where with the effusivities e = k / a
///
/// e_1 cos(m / 2 a_1) sin(m / 2 a_2) + e_2 sin(m / 2 a_1) cos(m / 2 a_2) = 0,
///
/// and it dies out as exp(-m^2 t).
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    conductivity: [f64; 2],
    modes: Vec<Mode>,
    /// a of both layers.
    roots: [f64; 2],
    /// Temperature of the interface in the end.
    middle: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Mode {
    m: f64,
    /// What the sines of both layers are multiplied with.
    amplitude: [f64; 2],
}

impl Series {
    /// Of a slab whose upper half has these over the lower half's.
    pub fn new(conductivity_ratio: f64, capacity_ratio: f64) -> Self {
        let conductivity = [1.0, conductivity_ratio];
        let capacity = [1.0, capacity_ratio];
        let roots = [1.0, (conductivity_ratio / capacity_ratio).sqrt()];
        // Thickness over root, and their sum.
        let s = roots.map(|a| 0.5 / a);
        let effusivity: [f64; 2] = std::array::from_fn(|k| conductivity[k] / roots[k]);
        let condition = |m: f64| {
            effusivity[0] * (m * s[0]).cos() * (m * s[1]).sin() + effusivity[1] * (m * s[0]).sin() * (m * s[1]).cos()
        };
        let middle = conductivity[0] / (conductivity[0] + conductivity[1]);
        // The condition is (e_1 + e_2)/2 sin(m (s_1 + s_2)) + a smaller sine: it changes its sign once between two neighbouring
        // places where the first sine is 1 or -1.
        let between = |n: usize| {
            let at = |n: usize| (n as f64 + 0.5) * PI / (s[0] + s[1]);
            let (mut low, mut high) = (at(n), at(n + 1));
            let below = condition(low) > 0.0;
            for _ in 0..80 {
                let half = 0.5 * (low + high);
                if (condition(half) > 0.0) == below {
                    low = half;
                } else {
                    high = half;
                }
            }
            0.5 * (low + high)
        };
        let mode = |n: usize| {
            let m = between(n);
            let [p, q] = s.map(|s| m * s);
            // Shares of the layers, continuous in the temperature or, where both sines vanish, in the flux.
            let share = match p.sin().abs().max(q.sin().abs()) > 1e-6 {
                true => [q.sin(), p.sin()],
                false => [effusivity[1] * q.cos(), -effusivity[0] * p.cos()],
            };
            // Integrals over a layer of thickness d = a s of sin^2(m x / a), and of sin times the start's difference to the end:
            // of sin, of x sin.
            let square = |k: usize, r: f64| roots[k] * (0.5 * s[k] - (2.0 * r).sin() / (4.0 * m));
            let one = |k: usize, r: f64| roots[k] * (1.0 - r.cos()) / m;
            let first = |k: usize, r: f64| roots[k] * roots[k] * (r.sin() - r * r.cos()) / (m * m);
            // T - T_end at the start: in layer 1 -(1 - 2 (1 - middle) y), in layer 2 -2 middle x, x from the upper wall.
            let given = capacity[0] * share[0] * (2.0 * (1.0 - middle) * first(0, p) - one(0, p))
                + capacity[1] * share[1] * (-2.0 * middle * first(1, q));
            let norm =
                capacity[0] * share[0] * share[0] * square(0, p) + capacity[1] * share[1] * share[1] * square(1, q);
            Mode { m, amplitude: share.map(|share| share * given / norm) }
        };
        Self { conductivity, roots, middle, modes: (0..MODES).map(mode).collect() }
    }

    /// Those modes that have not died out.
    fn alive(&self, time: f64) -> impl Iterator<Item = (&Mode, f64)> {
        self.modes.iter().map(move |mode| (mode, (-mode.m * mode.m * time).exp())).take_while(|(_, left)| *left > 1e-17)
    }

    /// At height y.
    pub fn temperature(&self, y: f64, time: f64) -> f64 {
        let (layer, x) = if y < 0.5 { (0, y) } else { (1, 1.0 - y) };
        let end = if layer == 0 { 1.0 - 2.0 * (1.0 - self.middle) * y } else { 2.0 * self.middle * x };
        let sine = |mode: &Mode| mode.amplitude[layer] * (mode.m * x / self.roots[layer]).sin();
        end + self.alive(time).map(|(mode, left)| sine(mode) * left).sum::<f64>()
    }

    /// Upwards, through the lower and the upper wall.
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

    /// Of both layers.
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
            // In the end the flux of two resistances in series.
            let [lower, upper] = series.wall_flux(1e4);
            assert!((lower - 1.0 / (0.5 + 0.5 / k)).abs() < 1e-9 && (lower - upper).abs() < 1e-9);
            // The heat that has come through the walls is what the slab holds.
            let held: f64 = (0..4000)
                .map(|j| (j as f64 + 0.5) / 4000.0)
                .map(|y| (if y < 0.5 { 1.0 } else { c }) * near(y) / 4000.0)
                .sum();
            let steps = 20_000;
            let come: f64 = (0..steps)
                .map(|j| {
                    // Evenly in sqrt(t), where the flux begins as 1/sqrt(t).
                    let (a, b) = (j as f64 / steps as f64, (j + 1) as f64 / steps as f64);
                    let [lower, upper] = series.wall_flux(t * (0.5 * (a + b)).powi(2));
                    (lower - upper) * t * (b * b - a * a)
                })
                .sum();
            // (The series of the flux is cut at the start.)
            assert!((come / held - 1.0).abs() < 0.02, "{k}, {c}: {come} of {held}");
        }
    }
}
