//! Metrics of predicted frames. All positions are `[N, D]`, with N counted particles.
//!
//! Definitions are those of LagrangeBench (Toshev et al. 2023, arXiv:2309.16342, section 4), except that walls, for
//! which every model uses the truth, count only with [`Counted::All`].

use crate::dataset::extent::Extent;
use crate::dataset::{kind, Heat, Metadata};
use crate::surrogate::predictor::Frame;

/// The particles that count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Counted {
    /// Particles that the model moves.
    #[default]
    Moving,
    /// All particles including walls, as in LagrangeBench.
    All,
}

impl Counted {
    /// The indices of counted particles; padding never counts.
    pub fn of(self, kinds: &[i32]) -> Vec<usize> {
        let counts = |k: i32| match self {
            Self::Moving => !kind::is_kinematic(k),
            Self::All => k != kind::PADDING,
        };
        (0..kinds.len()).filter(|&i| counts(kinds[i])).collect()
    }
}

/// Rows of `[N, D]`, or with `width` 1 entries of `[N]`, for some particles.
pub fn select(values: &[f64], width: usize, particles: &[usize]) -> Vec<f64> {
    particles.iter().flat_map(|&i| &values[i * width..(i + 1) * width]).copied().collect()
}

/// Mean over particles and dimensions of the squared difference along each (minimum image). Units: length^2.
pub fn mean_square(extent: &Extent, predicted: &[f64], truth: &[f64]) -> f64 {
    mean(extent.displacement(predicted, truth).into_iter().map(|x| x * x))
}

/// Mean over particles and dimensions of the absolute difference along each. Units: length.
pub fn mean_absolute(extent: &Extent, predicted: &[f64], truth: &[f64]) -> f64 {
    mean(extent.displacement(predicted, truth).into_iter().map(f64::abs))
}

/// MSE_n: the mean over the first n steps; none if there are fewer.
pub fn first(per_step: &[f64], n: usize) -> Option<f64> {
    (n > 0 && n <= per_step.len()).then(|| mean(per_step[..n].iter().copied()))
}

/// E = dx^D sum_i |v_i|^2, where v is the displacement between frames over the time between them, dt `write_every`.
///
/// As in LagrangeBench it is twice the kinetic energy of a fluid of density 1.
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

/// Heat that flows through x = `heat.target_x` per time (and depth, in 2D), over the heat capacity:
/// Q = rho dx^D sum_i w(x_i - target_x) u_i (T_i - T_in), with w(s) = max(0, 1 - |s|/h)/h, h = 3 dx (its integral is 1),
/// u_i the displacement along x since the frame before over the time between, and rho = conductivity/(diffusivity c_p).
///
/// The hat function w is continuous, so particles enter and leave the strip without a jump. This is not the solver's Q
/// (of interpolated fluxes at one time), and noisier; both sides of a comparison are measured in the same way.
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

/// The mean; 0 without values.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}
