//! Noise on the training inputs, which makes a model robust against its own errors.
//!
//! A random walk in the velocities (Sanchez-Gonzalez et al. 2020, as LagrangeBench): with z ~ N(0, 1) for each of the W - 1
//! velocities, velocity noise = cumsum(z) sigma/sqrt(W - 1), position noise its cumsum, 0 at the first frame; the frames to
//! be predicted get the last frame's. Kinematic particles get none. Temperatures get independent noise in every frame
//! of the window, and the target is measured from the noisy one, so that the model learns to remove it.

use crate::dataset::kind;

/// Adds the noise of `z` `[N, W - 1, D]` to positions `[frames][N, D]`, of which the first W are inputs.
pub fn walk(position: &mut [Vec<f64>], kinds: &[i32], z: &[f64], sigma: f64, frames: usize) {
    let steps = frames - 1;
    let dimension = z.len() / (steps * kinds.len());
    let scale = sigma / (steps as f64).sqrt();
    for (i, _) in kinds.iter().enumerate().filter(|(_, &k)| !kind::is_kinematic(k)) {
        for d in 0..dimension {
            let (mut velocity, mut shift) = (0.0, 0.0);
            for (frame, position) in position.iter_mut().enumerate().skip(1) {
                if frame < frames {
                    velocity += z[(i * steps + frame - 1) * dimension + d] * scale;
                    shift += velocity;
                }
                position[i * dimension + d] += shift;
            }
        }
    }
}

/// Adds noise of standard deviation `sigma` to the temperatures of the inputs, `[W][N]`, of fluid particles.
pub fn warm(temperature: &mut [Vec<f64>], kinds: &[i32], sigma: f64, mut next: impl FnMut() -> f64) {
    for temperature in temperature {
        for (t, _) in temperature.iter_mut().zip(kinds).filter(|(_, &k)| !kind::is_kinematic(k)) {
            *t += sigma * next();
        }
    }
}
