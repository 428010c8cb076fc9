//! Means and standard deviations over a training split, for fluid particles, by minimum-image differences in f64.

use super::extent::Extent;
use super::metadata::Metadata;
use super::trajectory::{kind, Trajectory};

/// Mean and sum of squared deviations of a stream of numbers (Welford 1962).
#[derive(Debug, Clone, Copy, Default)]
pub struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    pub fn add(&mut self, x: f64) {
        self.count += 1.0;
        let before = x - self.mean;
        self.mean += before / self.count;
        self.squares += before * (x - self.mean);
    }

    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Standard deviation of the population; 1 if there is none to divide by (as in LagrangeBench).
    pub fn deviation(&self) -> f64 {
        let deviation = (self.squares / self.count.max(1.0)).sqrt();
        if deviation < 1e-7 {
            1.0
        } else {
            deviation
        }
    }
}

/// Statistics over trajectories.
#[derive(Debug, Clone, Default)]
pub struct Statistics {
    velocity: [Moments; 3],
    acceleration: [Moments; 3],
    temperature: Moments,
    change: Moments,
}

impl Statistics {
    /// Adds a trajectory; `metadata` has the box and the inlet.
    pub fn add(&mut self, metadata: &Metadata, trajectory: &Trajectory) {
        let (n, dimension) = (trajectory.particles, metadata.dim);
        let extent = Extent::of(metadata);
        let fluid: Vec<usize> = (0..n).filter(|&i| trajectory.kind[i] == kind::FLUID).collect();
        let mut before = vec![0.0; fluid.len() * dimension];
        for frame in 0..trajectory.frames {
            if let Some(now) = trajectory.temperature_of(frame) {
                fluid.iter().for_each(|&i| self.temperature.add(f64::from(now[i])));
            }
            let Some(last) = frame.checked_sub(1) else { continue };
            let (from, to) = (trajectory.position_of(last), trajectory.position_of(frame));
            for (place, &i) in fluid.iter().enumerate() {
                for d in 0..dimension {
                    let step = f64::from(to[i * dimension + d]) - f64::from(from[i * dimension + d]);
                    let step = extent.shortest(d, step);
                    self.velocity[d].add(step);
                    let earlier = std::mem::replace(&mut before[place * dimension + d], step);
                    if frame > 1 {
                        self.acceleration[d].add(step - earlier);
                    }
                }
            }
            if let (Some(old), Some(new)) = (trajectory.temperature_of(last), trajectory.temperature_of(frame)) {
                for &i in &fluid {
                    let (from, to) = (f64::from(from[i * dimension]), f64::from(to[i * dimension]));
                    // A reset by the inlet is not a change by the flow.
                    if !metadata.heat.as_ref().is_some_and(|heat| heat.resets(from, to, metadata.bounds[0])) {
                        self.change.add(f64::from(new[i]) - f64::from(old[i]));
                    }
                }
            }
        }
    }

    /// Writes the statistics into the metadata.
    pub fn write_to(&self, metadata: &mut Metadata) {
        let means = |moments: &[Moments]| moments[..metadata.dim].iter().map(Moments::mean).collect();
        let deviations = |moments: &[Moments]| moments[..metadata.dim].iter().map(Moments::deviation).collect();
        let (vel, acc) = (&self.velocity, &self.acceleration);
        let all: [Vec<f64>; 4] = [means(vel), deviations(vel), means(acc), deviations(acc)];
        [metadata.vel_mean, metadata.vel_std, metadata.acc_mean, metadata.acc_std] = all;
        if let Some(heat) = &mut metadata.heat {
            (heat.temperature_mean, heat.temperature_std) = (self.temperature.mean(), self.temperature.deviation());
            (heat.change_mean, heat.change_std) = (self.change.mean(), self.change.deviation());
        }
    }
}
