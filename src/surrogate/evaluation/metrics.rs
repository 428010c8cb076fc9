//! How far predicted frames are from the true ones. All positions `[N, D]`, N the particles that count.
//!
//! Definitions as in LagrangeBench (Toshev et al. 2023, arXiv:2309.16342, section 4), except that walls, which every model
//! takes from the truth, count there and not here, unless [`Counted::All`] asks for it.

use crate::dataset::extent::Extent;
use crate::dataset::{kind, Heat, Metadata};
use crate::surrogate::predictor::Frame;

/// Which particles count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Counted {
    /// Those that the model moves.
    #[default]
    Moving,
    /// Walls too, as in LagrangeBench.
    All,
}

impl Counted {
    /// Their indices; padding never counts.
    pub fn of(self, kinds: &[i32]) -> Vec<usize> {
        let counts = |k: i32| match self {
            Self::Moving => !kind::is_kinematic(k),
            Self::All => k != kind::PADDING,
        };
        (0..kinds.len()).filter(|&i| counts(kinds[i])).collect()
    }
}

/// Rows of `[N, D]` or, with `width` 1, entries of `[N]`.
pub fn select(values: &[f64], width: usize, particles: &[usize]) -> Vec<f64> {
    particles.iter().flat_map(|&i| &values[i * width..(i + 1) * width]).copied().collect()
}

/// Mean over particles and dimensions of the squared distance along each (minimum image). Units: length^2.
pub fn mean_square(extent: &Extent, predicted: &[f64], truth: &[f64]) -> f64 {
    mean(extent.displacement(predicted, truth).into_iter().map(|x| x * x))
}

/// As [`mean_square`], of the distance itself. Units: length.
pub fn mean_absolute(extent: &Extent, predicted: &[f64], truth: &[f64]) -> f64 {
    mean(extent.displacement(predicted, truth).into_iter().map(f64::abs))
}

/// MSE_n: the mean over the first n steps; none if there are fewer.
pub fn first(per_step: &[f64], n: usize) -> Option<f64> {
    (n > 0 && n <= per_step.len()).then(|| mean(per_step[..n].iter().copied()))
}

/// E = dx^D sum_i |v_i|^2 with v the displacement from frame to frame over the time between them, dt `write_every`.
///
/// As LagrangeBench has it: twice the kinetic energy of a fluid of density 1.
pub fn kinetic_energy(metadata: &Metadata, to: &[f64], from: &[f64]) -> f64 {
    let extent = Extent::of(metadata);
    let time = metadata.dt * metadata.write_every as f64;
    let squares: f64 = extent.displacement(to, from).into_iter().map(|x| (x / time).powi(2)).sum();
    squares * metadata.dx.powi(metadata.dim as i32)
}

/// Mean over particles of (T - T_true)^2, `[N]` each. Units: temperature^2.
pub fn temperature_mean_square(predicted: &[f64], truth: &[f64]) -> f64 {
    mean(predicted.iter().zip(truth).map(|(a, b)| (a - b).powi(2)))
}

/// Half width, in spacings, of the strip in which outflowing heat is measured.
const STRIP: f64 = 3.0;

/// Heat that flows through x = `heat.target_x` per time (and depth, in 2D), over the heat capacity as everywhere:
/// Q = rho dx^D sum_i w(x_i - target_x) u_i (T_i - T_in), with w(s) = max(0, 1 - |s|/h)/h, h = 3 dx (its integral is 1),
/// u_i the displacement along x since the frame before over the time between, and rho = conductivity/(diffusivity c_p).
///
/// The hat w is continuous: particles enter and leave the strip without a jump. Not the solver's Q (of interpolated fluxes at
/// one time), and noisier; both sides of a comparison are measured in the same way.
pub fn outflow(metadata: &Metadata, heat: &Heat, particles: &[usize], to: &Frame, from: &Frame) -> Option<f64> {
    let extent = Extent::of(metadata);
    let temperature = to.temperature.as_ref()?;
    let (dimension, width) = (metadata.dim, STRIP * metadata.dx);
    let time = metadata.dt * metadata.write_every as f64;
    let flux = |&i: &usize| {
        let x = to.position[i * dimension];
        let hat = (1.0 - extent.shortest(0, x - heat.target_x).abs() / width).max(0.0) / width;
        let velocity = extent.shortest(0, x - from.position[i * dimension]) / time;
        hat * velocity * (temperature[i] - heat.inlet_temperature)
    };
    let sum: f64 = particles.iter().map(flux).sum();
    Some(heat.conductivity / (heat.diffusivity * heat.heat_capacity) * metadata.dx.powi(dimension as i32) * sum)
}

/// 0 for nothing.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}
